//! Lines of JSON with a checksum: `{"checksum":"0123456789abcdef","row":{…}}`. A line that anything happened to is none.

use std::io::{self, BufRead, BufReader, Read};

use scenario::hexadecimal;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

/// How each line begins. No text in a line has it, since quotes in JSON texts are escaped.
const BEGIN: &str = "{\"checksum\":\"";
/// Digits of a checksum.
const DIGITS: usize = 16;
/// Longest line; a row has some hundred bytes, with a hundred checks some ten thousand.
const LINE_BYTES_MAX: u64 = 1 << 20;

/// A kind of lines, and what each is true for: the checksum of one line is another one under another key.
#[derive(Debug)]
pub(super) struct Seal {
    member: &'static str,
    key: String,
}

impl Seal {
    pub(super) fn new(member: &'static str, key: String) -> Self {
        Self { member, key }
    }

    /// The line of a value, with its end.
    pub(super) fn close(&self, value: &impl Serialize) -> String {
        let text = serde_json::to_string(value).expect("plain data");
        let (checksum, member) = (self.checksum(&text), self.member);
        format!("{BEGIN}{checksum}\",\"{member}\":{text}}}\n")
    }

    /// The value of a line without its end; none where it is not as it was written.
    pub(super) fn open<T: DeserializeOwned>(&self, line: &[u8]) -> Option<T> {
        let line = str::from_utf8(line).ok()?.strip_prefix(BEGIN)?;
        let (checksum, line) = line.split_at_checked(DIGITS)?;
        let line = line.strip_prefix("\",\"")?.strip_prefix(self.member)?;
        let text = line.strip_prefix("\":")?.strip_suffix('}')?;
        if self.checksum(text) != checksum {
            return None;
        }
        serde_json::from_str(text).ok()
    }

    fn checksum(&self, text: &str) -> String {
        let mut hasher = Sha256::new();
        for part in [self.member, &self.key, text] {
            hasher.update((part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        hexadecimal(&hasher.finalize()[..DIGITS / 2])
    }
}

/// Whether these bytes may be the beginning of a line whose end was never written.
pub(super) fn is_torn(bytes: &[u8]) -> bool {
    let begin = BEGIN.as_bytes();
    !bytes.ends_with(b"\n") && (bytes.starts_with(begin) || begin.starts_with(bytes))
}

/// A part of a file: bytes from one place on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) offset: u64,
    pub(super) length: usize,
}

/// The lines of a file, one at a time.
pub(super) struct Lines<R> {
    input: BufReader<R>,
    /// The bytes of the line, with its end if it has one.
    pub(super) bytes: Vec<u8>,
    /// Its number, from 1.
    pub(super) number: usize,
    /// Where it stands in the file.
    pub(super) offset: u64,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(input: R) -> Self {
        Self {
            input: BufReader::new(input),
            bytes: Vec::new(),
            number: 0,
            offset: 0,
        }
    }

    /// Goes to the next line; false at the end of the file. One that is too long comes in parts, which have its number.
    pub(super) fn advance(&mut self) -> io::Result<bool> {
        let is_begun = !self.bytes.is_empty() && !self.bytes.ends_with(b"\n");
        self.number += usize::from(!is_begun);
        self.offset += self.bytes.len() as u64;
        self.bytes.clear();
        let mut input = self.input.by_ref().take(LINE_BYTES_MAX);
        input.read_until(b'\n', &mut self.bytes)?;
        Ok(!self.bytes.is_empty())
    }

    /// The line without its end; none where it is torn.
    pub(super) fn whole(&self) -> Option<&[u8]> {
        self.bytes.strip_suffix(b"\n")
    }

    /// The parts of the line that begin as lines do, each with its place, and what is before them: where the end of a line is
    /// damaged, the next one goes on behind it.
    pub(super) fn parts(&self) -> impl Iterator<Item = (&[u8], Place)> {
        let begins = self.bytes.windows(BEGIN.len()).enumerate().skip(1);
        let begins = begins.filter(|(_, window)| *window == BEGIN.as_bytes());
        let starts: Vec<usize> = [0].into_iter().chain(begins.map(|(at, _)| at)).collect();
        let ends = starts.clone().into_iter().skip(1).chain([self.bytes.len()]);
        starts.into_iter().zip(ends).map(move |(start, end)| {
            let place = Place {
                offset: self.offset + start as u64,
                length: end - start,
            };
            (&self.bytes[start..end], place)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seal(key: &str) -> Seal {
        Seal::new("row", key.to_owned())
    }

    #[test]
    fn a_line_that_comes_in_parts_is_counted_once() {
        let long = vec![b'x'; 2 * usize::try_from(LINE_BYTES_MAX).unwrap()];
        let text = [b"a\n", long.as_slice(), b"\nb\n"].concat();
        let mut lines = Lines::new(text.as_slice());
        let mut numbers = Vec::new();
        while lines.advance().unwrap() {
            numbers.push(lines.number);
        }
        assert_eq!(numbers, [1, 2, 2, 2, 3]);
    }

    #[test]
    fn a_line_is_json_and_only_its_own_seal_opens_it() {
        let line = seal("a").close(&"with \"quotes\"\n");
        let whole = line.strip_suffix('\n').unwrap();
        let json: serde_json::Value = serde_json::from_str(whole).unwrap();
        assert_eq!(json["row"], "with \"quotes\"\n");
        let open = |seal: &Seal| seal.open::<String>(whole.as_bytes());
        assert_eq!(open(&seal("a")).as_deref(), Some("with \"quotes\"\n"));
        assert_eq!(open(&seal("b")), None);
        assert_eq!(open(&Seal::new("header", "a".to_owned())), None);
    }

    #[test]
    fn a_line_with_any_other_byte_is_not_opened() {
        let line = seal("a").close(&[1.5, 2.0]);
        let whole = line.trim_end().as_bytes();
        for place in 0..whole.len() {
            for other in (0..=u8::MAX).filter(|other| *other != whole[place]) {
                let mut damaged = whole.to_vec();
                damaged[place] = other;
                assert_eq!(
                    seal("a").open::<[f64; 2]>(&damaged),
                    None,
                    "{place} {other}"
                );
            }
        }
    }
}
