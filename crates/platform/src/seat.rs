//! Protocol of seats between canrig and a program, version 1, byte by byte; see `docs/reference/seats.md`.
//!
//! A message is one packet of a `SOCK_SEQPACKET` socket: a header of 16 bytes, and a body that depends on its kind. Numbers are
//! little-endian, times are nanoseconds, and reserved bytes are sent as 0 and ignored. A law has a *port seat*: numbers in,
//! numbers out. A node has a *bus seat*: time and frames ([`crate::lockstep`]).

use std::os::fd::AsFd;

use rustix::io::Errno;
use rustix::net::RecvFlags;

/// Longest message.
pub const MESSAGE_BYTES_MAX: usize = 128 << 10;
/// Version of the protocol.
pub const VERSION: u8 = 1;
/// Number in HELLO: `CRIG` in its bytes.
pub const MAGIC: u32 = 0x4749_5243;
/// Time of an event that never comes.
pub const NEVER: u64 = u64::MAX;
/// Flag in `a` of STEP: some value that the law reads is missing, and not a number.
pub const IS_MISSING: u8 = 1;
/// Flag in `a` of DONE: the program has stopped.
pub const STOPPED: u8 = 1;
/// Flag in `a` of DONE and VALUES: the program has failed; a text follows that says why.
pub const FAILED: u8 = 2;
/// Seat of a law, in HELLO.
pub const PORT_SEAT: u8 = 1;

const HEADER_BYTES: usize = 16;
const HELLO_BYTES: usize = 8 + NAME_BYTES;
const NAME_BYTES: usize = 32;
/// Longest text of a failure.
const TEXT_BYTES_MAX: usize = 1_024;

/// Kind of a message.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
#[repr(u8)]
pub enum Kind {
    /// The program introduces itself.
    Hello = 1,
    /// canrig describes the run.
    Welcome = 2,
    /// canrig grants a node time, with the frames for it.
    Grant = 3,
    /// The program has reached its time, is ready for the next message, or has stopped.
    Done = 4,
    /// canrig asks it to stop.
    Stop = 5,
    /// canrig gives the values that a law reads in a cycle.
    Step = 6,
    /// The program gives the values that a law writes.
    Values = 7,
}

/// Header of every message.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub struct Header {
    /// Kind of the message, as in [`Kind`].
    pub kind: u8,
    /// Flags or version, depending on the kind.
    pub a: u8,
    /// Number of items that follow.
    pub count: u16,
    /// Number of a question, repeated in its answer.
    pub number: u32,
    /// Time in nanoseconds.
    pub time: u64,
}

impl Header {
    /// Makes a header of this kind.
    pub fn of(kind: Kind) -> Self {
        Self {
            kind: kind as u8,
            ..Self::default()
        }
    }

    /// Begins a message with this header.
    pub fn begin(&self, message: &mut Vec<u8>) {
        message.clear();
        message.extend_from_slice(&[self.kind, self.a]);
        message.extend_from_slice(&self.count.to_le_bytes());
        message.extend_from_slice(&self.number.to_le_bytes());
        message.extend_from_slice(&self.time.to_le_bytes());
    }

    /// Splits a message into its header and body.
    ///
    /// # Errors
    /// If the message is shorter than a header.
    pub fn split(message: &[u8]) -> Result<(Self, &[u8]), Misread> {
        let Some((header, body)) = message.split_first_chunk::<HEADER_BYTES>() else {
            return Err(Misread::new(
                message.len(),
                format!("a message has {HEADER_BYTES} bytes at least, and this one ends here"),
            ));
        };
        let header = Self {
            kind: header[0],
            a: header[1],
            count: u16::from_le_bytes(bytes_at(header, 2)),
            number: u32::from_le_bytes(bytes_at(header, 4)),
            time: u64::from_le_bytes(bytes_at(header, 8)),
        };
        Ok((header, body))
    }
}

/// Returns some bytes of a message; zeros beyond its end.
pub(crate) fn bytes_at<const COUNT: usize>(message: &[u8], at: usize) -> [u8; COUNT] {
    let bytes = message.get(at..).and_then(|rest| rest.first_chunk());
    bytes.copied().unwrap_or([0; COUNT])
}

/// Error in a message: its first wrong byte, and the reason.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
#[error("byte {byte}: {what}")]
pub struct Misread {
    byte: usize,
    what: String,
}

impl Misread {
    pub(crate) fn new(byte: usize, what: String) -> Self {
        Self { byte, what }
    }
}

/// Splits a message of the given kind into its header and body.
pub(crate) fn split(message: &[u8], kind: Kind) -> Result<(Header, &[u8]), Misread> {
    let (header, body) = Header::split(message)?;
    if header.kind != kind as u8 {
        let name = format!("{kind:?}").to_uppercase();
        let what = format!("kind {}, where {name} is {}", header.kind, kind as u8);
        return Err(Misread::new(0, what));
    }
    Ok((header, body))
}

/// Checks the HELLO of a law.
///
/// # Errors
/// If it is no HELLO, or for another seat or version.
pub fn read_hello(message: &[u8]) -> Result<(), Misread> {
    read_hello_at(message, PORT_SEAT).map(drop)
}

/// Returns the header of a HELLO at a seat, and the bytes after the name of the program.
pub(crate) fn read_hello_at(message: &[u8], seat: u8) -> Result<(Header, &[u8]), Misread> {
    let (header, body) = split(message, Kind::Hello)?;
    let Header { a, number, .. } = header;
    if a != VERSION {
        let what = format!("version {a}, where {VERSION} is spoken");
        return Err(Misread::new(1, what));
    }
    if number != MAGIC {
        let what = format!("0x{number:08X}, not 0x{MAGIC:08X}");
        return Err(Misread::new(4, what));
    }
    let Some((hello, rest)) = body.split_first_chunk::<HELLO_BYTES>() else {
        let length = HEADER_BYTES + HELLO_BYTES;
        let what = format!("HELLO has {length} bytes, and this one ends here");
        return Err(Misread::new(message.len(), what));
    };
    if hello[0] != seat {
        let whose = match seat {
            PORT_SEAT => "a law's",
            _ => "a node's",
        };
        let what = format!("seat {}, and {whose} is {seat}", hello[0]);
        return Err(Misread::new(HEADER_BYTES, what));
    }
    Ok((header, rest))
}

/// Writes HELLO at a port seat.
pub fn write_hello(message: &mut Vec<u8>, name: &str) {
    let header = Header {
        a: VERSION,
        number: MAGIC,
        ..Header::of(Kind::Hello)
    };
    header.begin(message);
    message.extend_from_slice(&[PORT_SEAT, 0, 0, 0, 0, 0, 0, 0]);
    write_name(message, name);
}

/// Writes the name in a HELLO, padded.
pub(crate) fn write_name(message: &mut Vec<u8>, name: &str) {
    let mut padded = [0; NAME_BYTES];
    let name = &name.as_bytes()[..name.len().min(NAME_BYTES - 1)];
    padded[..name.len()].copy_from_slice(name);
    message.extend_from_slice(&padded);
}

/// Writes WELCOME at a port seat, with the law's inputs, outputs and parameters as JSON.
pub fn write_welcome(message: &mut Vec<u8>, seed: u64, json: &[u8]) {
    let header = Header {
        a: VERSION,
        ..Header::of(Kind::Welcome)
    };
    header.begin(message);
    // The bit rates, and the node-ID after the seed, are for bus seats.
    message.extend_from_slice(&[0; 8]);
    message.extend_from_slice(&seed.to_le_bytes());
    message.extend_from_slice(&[0; 8]);
    message.extend_from_slice(json);
}

/// Returns the JSON of a WELCOME, and the seed.
///
/// # Errors
/// If it is no WELCOME.
pub fn read_welcome(message: &[u8]) -> Result<(&[u8], u64), Misread> {
    let (_, body) = split(message, Kind::Welcome)?;
    let json = body.get(24..).ok_or_else(|| {
        let what = "WELCOME has 40 bytes and JSON, and this one ends here".to_owned();
        Misread::new(message.len(), what)
    })?;
    Ok((json, u64::from_le_bytes(bytes_at(body, 8))))
}

/// Writes DONE: the program is ready, or has stopped.
pub fn write_done(message: &mut Vec<u8>, number: u32, a: u8) {
    let header = Header {
        a,
        number,
        time: NEVER,
        ..Header::of(Kind::Done)
    };
    header.begin(message);
    // A bus seat writes the time that it reached here.
    message.extend_from_slice(&[0; 8]);
}

/// Body of an answer, or the text of a program that has failed.
pub type Told<'a> = Result<&'a [u8], String>;

/// Reads a program's answer to WELCOME (DONE) or to STEP (VALUES), checked against the number of the question.
///
/// # Errors
/// If it is no such answer.
pub fn read_answer(message: &[u8], kind: Kind, number: u32) -> Result<Told<'_>, Misread> {
    let (header, body) = split(message, kind)?;
    if header.number != number {
        let what = format!("number {}, and {number} was asked", header.number);
        return Err(Misread::new(4, what));
    }
    match header.a {
        0 => Ok(Ok(body)),
        FAILED => {
            let text = &body[..body.len().min(TEXT_BYTES_MAX)];
            Ok(Err(String::from_utf8_lossy(text).into_owned()))
        }
        a => {
            let what = format!("{a}, which is neither 0 nor {FAILED}");
            Err(Misread::new(1, what))
        }
    }
}

/// Writes a message of numbers: STEP or VALUES.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a message has less than 65 536 numbers"
)]
pub fn write_numbers(message: &mut Vec<u8>, header: Header, before: Option<f64>, numbers: &[f64]) {
    let count = numbers.len() as u16;
    Header { count, ..header }.begin(message);
    for number in before.iter().chain(numbers) {
        message.extend_from_slice(&number.to_le_bytes());
    }
}

/// Returns the numbers of a body, without an incomplete one at its end.
pub fn numbers(body: &[u8]) -> impl ExactSizeIterator<Item = f64> {
    let number = |bytes: &[u8; 8]| f64::from_le_bytes(*bytes);
    body.as_chunks::<8>().0.iter().map(number)
}

/// Reads the VALUES that answer the STEP with this number.
///
/// # Errors
/// If it is no such answer, or does not hold `count` values.
pub fn read_values<'a>(message: &'a [u8], number: u32, count: usize) -> Result<Told<'a>, Misread> {
    let told = read_answer(message, Kind::Values, number)?;
    let stated = u16::from_le_bytes([message[2], message[3]]);
    match &told {
        Ok(body) if usize::from(stated) != count || body.len() != 8 * count => {
            let bytes = body.len();
            let what = format!("{stated} values in {bytes} bytes, where the law writes {count}");
            Err(Misread::new(2, what))
        }
        _ => Ok(told),
    }
}

/// Writes a program's failure as VALUES or DONE.
pub fn write_failure(message: &mut Vec<u8>, header: Header, text: &str) {
    Header {
        a: FAILED,
        ..header
    }
    .begin(message);
    message.extend_from_slice(fitting_text(text).as_bytes());
}

/// Returns the longest start of a failure's text that fits.
pub(crate) fn fitting_text(text: &str) -> &str {
    &text[..text.floor_char_boundary(TEXT_BYTES_MAX)]
}

/// Receives one packet into `packet`; empty if the other end is closed.
pub(crate) fn receive_packet(channel: impl AsFd, packet: &mut Vec<u8>) -> Result<(), Errno> {
    packet.clear();
    loop {
        let spare = rustix::buffer::spare_capacity(packet);
        match rustix::net::recv(channel.as_fd(), spare, RecvFlags::empty()) {
            Ok(_) | Err(Errno::CONNRESET | Errno::PIPE) => return Ok(()),
            Err(Errno::INTR) => {}
            Err(errno) => return Err(errno),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hello_has_these_bytes() {
        let mut message = Vec::new();
        write_hello(&mut message, "pid");
        let head = [1, 1, 0, 0, b'C', b'R', b'I', b'G', 0, 0, 0, 0, 0, 0, 0, 0];
        let seat = [1, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(&message[..27], [&head[..], &seat, b"pid"].concat());
        assert_eq!(message.len(), 56);
        assert_eq!(read_hello(&message), Ok(()));
    }

    #[test]
    fn what_is_no_hello_is_named_with_its_byte() {
        let mut hello = Vec::new();
        write_hello(&mut hello, "pid");
        for (place, said) in [
            (0, "byte 0: kind 99, where HELLO is 1"),
            (1, "byte 1: version 99, where 1 is spoken"),
            (5, "byte 4: 0x47496343, not 0x47495243"),
            (16, "byte 16: seat 99, and a law's is 1"),
        ] {
            let mut wrong = hello.clone();
            wrong[place] = 99;
            assert_eq!(read_hello(&wrong).unwrap_err().to_string(), said);
        }
        assert!(read_hello(&hello[..50]).is_err());
        assert!(read_hello(b"GET / HTTP/1.1").is_err());
    }

    #[test]
    fn an_answer_is_that_of_its_number() {
        let mut message = Vec::new();
        let header = Header {
            number: 7,
            ..Header::of(Kind::Values)
        };
        write_numbers(&mut message, header, None, &[1.5, -2.0]);
        assert_eq!(message.len(), 32);
        let body = read_values(&message, 7, 2).unwrap().unwrap();
        assert_eq!(Vec::from_iter(numbers(body)), [1.5, -2.0]);
        for (number, count, said) in [
            (6, 2, "byte 4: number 7, and 6 was asked"),
            (8, 2, "byte 4: number 7, and 8 was asked"),
            (7, 3, "byte 2: 2 values in 16 bytes, where the law writes 3"),
        ] {
            let error = read_values(&message, number, count).unwrap_err();
            assert_eq!(error.to_string(), said);
        }
        write_failure(&mut message, header, "no gain");
        let failed = read_values(&message, 7, 2).unwrap();
        assert_eq!(failed, Err("no gain".to_owned()));
    }

    #[test]
    fn a_welcome_carries_its_json_behind_the_seed() {
        let mut message = Vec::new();
        write_welcome(&mut message, 5, b"{}");
        assert_eq!(message[24], 5);
        assert_eq!(read_welcome(&message).unwrap(), (&b"{}"[..], 5));
        assert!(read_welcome(&message[..30]).is_err());
    }
}
