//! Text of a compressed log, piece by piece. Each piece is first read to its checksum, so that no part of a damaged piece is
//! taken.

use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::mem;

use zstd::Decoder;

use crate::work::Pass;

/// First bytes of every piece (RFC 8878, 3.1.1).
const MAGIC: [u8; 4] = 0xFD2F_B528_u32.to_le_bytes();
/// Bytes of the file in memory: a second of a full bus has half of it.
const BUFFER_BYTES: usize = 1 << 17;
/// Longest text of a piece that is held in memory: a second of a bus has some hundred kilobytes. The output of another compressor
/// may be one piece of any length; such a piece is read twice.
const HELD_BYTES_MAX: usize = 1 << 22;

/// Number of bytes that are searched for the next piece; a damaged log has no longer gap.
const SKIPPED_BYTES_MAX: u64 = 1 << 26;

/// Damaged part of a compressed log. The parts after it can be read.
#[derive(Debug, thiserror::Error)]
#[error("{bytes} bytes from byte {begin} on are damaged: {reason}")]
pub(crate) struct Damaged {
    begin: u64,
    bytes: u64,
    reason: io::Error,
}

impl Damaged {
    /// Returns the damage behind an error of [`PieceReader`], if there is one.
    pub(crate) fn of(error: &io::Error) -> Option<&Self> {
        error.get_ref()?.downcast_ref()
    }
}

/// Reader of the text. It returns an error for each damaged part, and continues with the next piece.
pub(crate) struct PieceReader<R> {
    state: State<R>,
    /// Text of the latest piece, if it is held, with the position up to which it was taken.
    held: Cursor<Vec<u8>>,
    pass: Pass,
}

enum State<R> {
    Between(BufReader<R>),
    Within(Decoder<'static, BufReader<R>>),
    /// State after a refusal of the system.
    Failed,
}

impl<R: Read + Seek> PieceReader<R> {
    /// Makes a reader of the pieces of a file of `bytes` bytes.
    pub(crate) fn new(input: R, bytes: u64) -> Self {
        Self {
            state: State::Between(BufReader::with_capacity(BUFFER_BYTES, input)),
            held: Cursor::default(),
            pass: Pass::new(bytes),
        }
    }

    /// Goes to the next whole piece; returns `false` at the end of the file.
    fn next_piece(&mut self, mut input: BufReader<R>) -> io::Result<bool> {
        let begin = input.stream_position()?;
        if input.fill_buf()?.is_empty() {
            self.state = State::Between(input);
            return Ok(false);
        }
        let mut text = mem::take(&mut self.held).into_inner();
        let checked = read_to_end(&mut input, &mut text);
        if checked.is_err() {
            input.seek(SeekFrom::Start(begin + 1))?;
            skip_to_magic(&mut input)?;
        }
        let end = input.stream_position()?;
        if end <= begin {
            return Err(io::Error::other("it has become shorter"));
        }
        match checked {
            Ok(true) => {
                self.pass.reach(end);
                self.held = Cursor::new(text);
                self.state = State::Between(input);
            }
            Ok(false) => {
                input.seek(SeekFrom::Start(begin))?;
                self.state = State::Within(Decoder::with_buffer(input)?.single_frame());
            }
            Err(reason) => {
                self.pass.reach(end);
                self.state = State::Between(input);
                let damaged = Damaged {
                    begin,
                    bytes: end - begin,
                    reason,
                };
                return Err(io::Error::new(io::ErrorKind::InvalidData, damaged));
            }
        }
        Ok(true)
    }
}

impl<R: Read + Seek> Read for PieceReader<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            let held = self.held.read(bytes)?;
            if held > 0 || bytes.is_empty() {
                return Ok(held);
            }
            match mem::replace(&mut self.state, State::Failed) {
                State::Failed => return Err(io::Error::other("the file could not be read")),
                State::Between(input) => {
                    if !self.next_piece(input)? {
                        return Ok(0);
                    }
                }
                State::Within(mut piece) => match piece.read(bytes)? {
                    0 => self.state = State::Between(piece.finish()),
                    read => {
                        self.pass.reach(piece.get_mut().stream_position()?);
                        self.state = State::Within(piece);
                        return Ok(read);
                    }
                },
            }
        }
    }
}

/// Reads a piece to its end with its checksum; returns whether all its text is held.
fn read_to_end(input: &mut impl BufRead, text: &mut Vec<u8>) -> io::Result<bool> {
    let mut piece = Decoder::with_buffer(input)?.single_frame();
    text.clear();
    piece
        .by_ref()
        .take(HELD_BYTES_MAX as u64)
        .read_to_end(text)?;
    Ok(io::copy(&mut piece, &mut io::sink())? == 0)
}

/// Skips to the possible start of a piece, or to the end of the file if there is none nearby.
fn skip_to_magic<R: Read + Seek>(input: &mut BufReader<R>) -> io::Result<()> {
    let mut latest = [0; MAGIC.len()];
    for byte in input.by_ref().take(SKIPPED_BYTES_MAX).bytes() {
        latest.rotate_left(1);
        latest[MAGIC.len() - 1] = byte?;
        if latest == MAGIC {
            return input.seek_relative(-4);
        }
    }
    input.seek(SeekFrom::End(0)).map(|_| ())
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn piece(text: &str) -> Vec<u8> {
        let mut encoder = zstd::Encoder::new(Vec::new(), 3).unwrap();
        encoder.include_checksum(true).unwrap();
        io::Write::write_all(&mut encoder, text.as_bytes()).unwrap();
        encoder.finish().unwrap()
    }

    /// Returns the text, and the number of its damaged parts.
    fn read(bytes: &[u8]) -> (String, usize) {
        let mut pieces = PieceReader::new(Cursor::new(bytes), bytes.len() as u64);
        let (mut text, mut damaged) = (Vec::new(), 0);
        let mut some = [0; 7];
        loop {
            match pieces.read(&mut some) {
                Ok(0) => return (String::from_utf8(text).unwrap(), damaged),
                Ok(read) => text.extend(&some[..read]),
                Err(error) => {
                    assert!(Damaged::of(&error).is_some(), "{error}");
                    damaged += 1;
                }
            }
        }
    }

    #[test]
    fn a_damaged_piece_is_left_out_and_the_others_are_whole() {
        let texts = ["one one one one\n", "two\n", "three 3 3 3 3 3\n"];
        let pieces = texts.map(piece);
        let whole = pieces.concat();
        assert_eq!(read(&whole), (texts.concat(), 0));
        let middle = pieces[0].len()..pieces[0].len() + pieces[1].len();
        for place in middle.clone() {
            for bit in 0..8 {
                let mut bytes = whole.clone();
                bytes[place] ^= 1 << bit;
                let (text, damaged) = read(&bytes);
                // A bit in its header may have no meaning, or say that there is no checksum: then the text is whole.
                let is_whole = text == texts.concat();
                let is_without = text == [texts[0], texts[2]].concat() && damaged > 0;
                assert!(is_whole || is_without, "{place} {bit}: {text}");
            }
        }
        for cut in middle.start + 1..middle.end {
            assert_eq!(read(&whole[..cut]), (texts[0].to_owned(), 1), "{cut}");
        }
        assert_eq!(read(b""), (String::new(), 0));
        assert_eq!(read(b"no log at all"), (String::new(), 1));
    }

    #[test]
    fn a_file_that_becomes_shorter_is_no_damage() {
        let lines =
            (0..100_000_u32).map(|number| format!("{:08x}\n", number.wrapping_mul(2_654_435_761)));
        let pieces = piece(&lines.collect::<String>()).repeat(3);
        let mut file = tempfile::tempfile().unwrap();
        io::Write::write_all(&mut file, &pieces).unwrap();
        // At the end of the first piece, and within the second.
        let first = pieces.len() / 3;
        for bytes in [0, 1000, first, pieces.len() / 2] {
            file.set_len(0).unwrap();
            file.rewind().unwrap();
            io::Write::write_all(&mut file, &pieces).unwrap();
            file.rewind().unwrap();
            let mut pieces = PieceReader::new(file.try_clone().unwrap(), pieces.len() as u64);
            pieces.read_exact(&mut [0; 900_000]).unwrap();
            file.set_len(bytes as u64).unwrap();
            let error = io::copy(&mut pieces, &mut io::sink()).unwrap_err();
            let is_damage = Damaged::of(&error).is_some();
            assert_eq!(is_damage, bytes > first, "{bytes}: {error}");
        }
    }

    #[test]
    fn what_is_no_log_is_not_searched_for_ever() {
        let [first, last] = ["one\n", "two\n"].map(piece);
        let nothing = vec![0; usize::try_from(SKIPPED_BYTES_MAX).unwrap()];
        let enough = [&first[..], &nothing[..nothing.len() / 2], &last].concat();
        assert_eq!(read(&enough), ("one\ntwo\n".to_owned(), 1));
        let too_much = [&first[..], &nothing, &last].concat();
        assert_eq!(read(&too_much), ("one\n".to_owned(), 1));
    }

    #[test]
    fn a_log_that_another_tool_compressed_is_one_piece() {
        let text = "(0.000001) can0 123#\n".repeat(300_000);
        assert!(text.len() > HELD_BYTES_MAX);
        let compressed = piece(&text);
        let mut pieces = PieceReader::new(Cursor::new(&compressed), compressed.len() as u64);
        let mut half = vec![0; text.len() / 2];
        pieces.read_exact(&mut half).unwrap();
        let gone = pieces.pass.done as f64 / compressed.len() as f64;
        assert!((0.3..0.7).contains(&gone), "{gone}");
        assert_eq!(read(&compressed), (text, 0));
    }
}
