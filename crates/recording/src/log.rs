//! What was on the bus: stamped frames, as `bus.log` holds them (`candump -L`).

use std::fmt;
use std::io::{self, BufRead, Write};
use std::str::FromStr;
use std::time::Duration;

use canopen::CanFrame;
use canopen::frame::{ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG};
use canopen::frame_bits::occupied_bits;

/// Longest line of a log that is read.
const LINE_LENGTH_MAX: u64 = 256;
/// So much after the last good line is read in search of another one.
const UNREADABLE_BYTES_MAX: usize = 1 << 20;

/// A frame and when its last bit passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamped {
    /// Time of the recording's clock: virtual time, or the wall clock's since 1970. Whole microseconds, as the log's.
    pub time: Duration,
    pub frame: CanFrame,
    /// Bits that it took from the bus. They follow from the frame, and are counted once.
    pub occupied_bits: u32,
}

impl Stamped {
    /// A frame with its time cut to the log's resolution, so that a log read back judges the same.
    #[must_use]
    pub fn new(time: Duration, frame: CanFrame) -> Self {
        Self::counted(time, frame, occupied_bits(&frame))
    }

    /// As [`Stamped::new`], with the [`occupied_bits`] that whoever sent the frame has counted.
    #[must_use]
    pub fn counted(time: Duration, frame: CanFrame, occupied_bits: u32) -> Self {
        Self {
            time: Duration::new(time.as_secs(), time.subsec_micros() * 1000),
            frame,
            occupied_bits,
        }
    }
}

/// One line of `candump -L`, with the interface written as `can0` in every world.
impl fmt::Display for Stamped {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, micros) = (self.time.as_secs(), self.time.subsec_micros());
        write!(formatter, "({seconds:010}.{micros:06}) can0 {}", self.frame)
    }
}

/// Why a line is no frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a line of candump -L: \"{line}\" ({reason})")]
pub struct LineError {
    line: String,
    reason: &'static str,
}

impl FromStr for Stamped {
    type Err = LineError;

    fn from_str(line: &str) -> Result<Self, LineError> {
        let fault = |reason| LineError {
            line: line.chars().take(80).collect(),
            reason,
        };
        let mut words = line.split_whitespace();
        let (stamp, _interface, frame) = match (words.next(), words.next(), words.next()) {
            (Some(stamp), Some(interface), Some(frame)) => (stamp, interface, frame),
            _ => return Err(fault("expected: (seconds.microseconds) interface id#data")),
        };
        let stamp = stamp
            .strip_prefix('(')
            .and_then(|stamp| stamp.strip_suffix(')'));
        let (seconds, micros) = stamp
            .and_then(|stamp| stamp.split_once('.'))
            .ok_or_else(|| fault("no time stamp"))?;
        let seconds: u64 = seconds
            .parse()
            .map_err(|_| fault("seconds are no number"))?;
        let micros = match micros.len() {
            6 => micros
                .parse::<u32>()
                .map_err(|_| fault("microseconds are no number"))?,
            _ => return Err(fault("microseconds need six digits")),
        };
        let frame = parse_frame(frame).map_err(fault)?;
        Ok(Self::new(Duration::new(seconds, micros * 1000), frame))
    }
}

fn parse_frame(text: &str) -> Result<CanFrame, &'static str> {
    let (id, data) = text
        .split_once('#')
        .ok_or("no '#' between identifier and data")?;
    let mut raw_id = hexadecimal(id).ok_or("identifier is not hexadecimal")?;
    match id.len() {
        3 if raw_id <= 0x7FF => {}
        // Of the flags, candump shows this one only.
        8 if raw_id & ERROR_FLAG != 0 && raw_id <= ERROR_FLAG | 0x1FFF_FFFF => {}
        8 if raw_id <= 0x1FFF_FFFF => raw_id |= EXTENDED_FLAG,
        _ => return Err("identifier needs three or eight digits"),
    }
    if data.starts_with('R') {
        if raw_id & ERROR_FLAG != 0 {
            return Err("an error frame asks for nothing");
        }
        return CanFrame::from_raw(raw_id | REMOTE_FLAG, 0, [0; 8]).ok_or("too long");
    }
    if data.starts_with('#') {
        return Err("a CAN FD frame");
    }
    if data.len() > 16 || data.len() % 2 != 0 || !data.is_ascii() {
        return Err("data need up to eight pairs of digits");
    }
    let mut bytes = [0; 8];
    for (place, byte) in bytes.iter_mut().enumerate().take(data.len() / 2) {
        let pair = &data[2 * place..2 * place + 2];
        let value = hexadecimal(pair).and_then(|value| u8::try_from(value).ok());
        *byte = value.ok_or("data are not hexadecimal")?;
    }
    let length = u8::try_from(data.len() / 2).unwrap_or(8);
    CanFrame::from_raw(raw_id, length, bytes).ok_or("too long")
}

/// A number of digits only: no sign.
fn hexadecimal(digits: &str) -> Option<u32> {
    let is_plain = digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_plain.then(|| u32::from_str_radix(digits, 16).ok())?
}

/// Writes frames as `candump -L` does, to an output that has a buffer.
///
/// # Errors
/// The file cannot be written.
pub fn write_log(mut output: impl Write, frames: &[Stamped]) -> io::Result<()> {
    frames
        .iter()
        .try_for_each(|stamped| writeln!(output, "{stamped}"))
}

/// Reads a log of `candump -L`.
///
/// # Errors
/// The file cannot be read, or a line is no frame; the message has the line's number.
pub fn read_log(mut input: impl BufRead) -> io::Result<Vec<Stamped>> {
    let mut frames = Vec::new();
    let mut line = String::new();
    for number in 1.. {
        line.clear();
        if io::Read::take(&mut input, LINE_LENGTH_MAX).read_line(&mut line)? == 0 {
            break;
        }
        let parsed = line.trim_end().parse().map_err(|error| {
            io::Error::new(
                io::ErrorKind::InvalidData,
                format!("line {number}: {error}"),
            )
        });
        frames.push(parsed?);
    }
    Ok(frames)
}

/// What a log holds, as far as it can be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// The frames before the break.
    pub frames: Vec<Stamped>,
    /// Where and why the log breaks off, for people.
    pub broken: Option<String>,
}

/// Reads a log whose writer may have been killed: its end may be cut in the middle of a line. A last line without its
/// end is not taken, since a shorter frame looks whole.
///
/// # Errors
/// The file cannot be read, holds frames of two interfaces, or good lines follow soon after a bad one: then it is
/// damaged, or no log of `candump -L`.
pub fn read_cut_log(mut input: impl BufRead) -> io::Result<Log> {
    let mut log = Log::default();
    let mut interface = None;
    let mut unreadable_bytes = 0;
    let mut line = Vec::new();
    for number in 1u64.. {
        line.clear();
        if io::Read::take(&mut input, LINE_LENGTH_MAX).read_until(b'\n', &mut line)? == 0 {
            break;
        }
        if log.broken.is_some() {
            unreadable_bytes += line.len();
            if unreadable_bytes > UNREADABLE_BYTES_MAX {
                break;
            }
        }
        match (whole_line(&line, &mut interface), &log.broken) {
            (Ok(None), _) => {}
            (Ok(Some(stamped)), None) => log.frames.push(stamped),
            (Ok(Some(_)), Some(broken)) => return Err(invalid(broken.clone())),
            (Err(reason), _) => {
                log.broken.get_or_insert(format!("line {number}: {reason}"));
            }
        }
    }
    Ok(log)
}

/// The frame of a line; none in an empty line. The first line decides on the interface.
fn whole_line(line: &[u8], interface: &mut Option<String>) -> Result<Option<Stamped>, String> {
    let text = str::from_utf8(line).map_err(|_| "not text".to_owned())?;
    let is_ended = text.ends_with('\n');
    let text = text.trim();
    if text.is_empty() {
        return Ok(None);
    }
    if !is_ended {
        return Err("cut before its end".to_owned());
    }
    let stamped = text.parse().map_err(|error: LineError| error.to_string())?;
    let name = text.split_whitespace().nth(1).unwrap_or_default();
    let first = interface.get_or_insert_with(|| name.to_owned());
    if first == name {
        Ok(Some(stamped))
    } else {
        Err(format!(
            "a frame of {name} among those of {first}; take one interface out of the log first"
        ))
    }
}

fn invalid(reason: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_line_reads_as_candump_writes_it() {
        let stamped = Stamped::new(
            Duration::from_micros(1_234_567),
            CanFrame::new(0x190, &[1, 0xAB]),
        );
        assert_eq!(stamped.to_string(), "(0000000001.234567) can0 190#01AB");
        assert_eq!("(0000000001.234567) vcan0 190#01AB R".parse(), Ok(stamped));
    }

    #[test]
    fn a_bad_line_is_named_by_its_number() {
        let error =
            read_log("(0.000001) can0 123#\n(0.000002) can0 9999#00\n".as_bytes()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "line 2: not a line of candump -L: \"(0.000002) can0 9999#00\" (identifier needs three or eight digits)"
        );
    }

    #[test]
    fn an_identifier_has_no_sign_and_no_flag_that_candump_does_not_show() {
        for frame in [
            "70145677#0102",
            "+12#00",
            "123#+1",
            "-123#00",
            "E0000001#00",
            "20000004#R",
        ] {
            let line = format!("(0.000001) can0 {frame}");
            assert!(line.parse::<Stamped>().is_err(), "{line}");
        }
        let error = "(0000000000.000001) can0 20000004#0001000000000000";
        assert_eq!(error.parse::<Stamped>().unwrap().to_string(), error);
    }

    const LOG: &str = "(0.000001) can0 123#\n(0.000002) can0 190#0102\n";

    #[test]
    fn a_log_cut_at_any_byte_reads_up_to_there() {
        let whole = read_cut_log(LOG.as_bytes()).unwrap();
        assert_eq!((whole.frames.len(), &whole.broken), (2, &None));
        for length in 0..LOG.len() {
            let log = read_cut_log(&LOG.as_bytes()[..length]).unwrap();
            let lines = LOG[..length].matches('\n').count();
            assert_eq!(log.frames, whole.frames[..lines]);
            assert_eq!(
                log.broken.is_some(),
                !LOG[..length].ends_with('\n') && length > 0
            );
        }
        let zeros = [LOG.as_bytes(), &[0; 5000]].concat();
        let log = read_cut_log(&zeros[..]).unwrap();
        assert_eq!((log.frames.len(), log.broken.is_some()), (2, true));
        // What never ends is not read for ever.
        let endless = io::Read::chain(LOG.as_bytes(), io::BufReader::new(io::repeat(0)));
        let log = read_cut_log(endless).unwrap();
        assert_eq!((log.frames.len(), log.broken.is_some()), (2, true));
    }

    #[test]
    fn a_log_damaged_in_the_middle_or_of_two_interfaces_is_refused() {
        let damaged = LOG.replace("123#", "1#");
        let error = read_cut_log(damaged.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 1: "), "{error}");
        let two = format!("(0.0) can1 123#\n{LOG}").replace("0.0)", "0.000000)");
        let log = read_cut_log(two.as_bytes()).unwrap();
        assert!(
            log.broken
                .unwrap()
                .contains("a frame of can0 among those of can1")
        );
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_log(id in 0u32..0x7FF, extended: bool, data in prop::collection::vec(any::<u8>(), 0..=8), micros in 0u64..1 << 50) {
            let mut bytes = [0; 8];
            bytes[..data.len()].copy_from_slice(&data);
            let id = if extended { id << 10 | EXTENDED_FLAG } else { id };
            let frame = CanFrame::from_raw(id, u8::try_from(data.len()).unwrap(), bytes).unwrap();
            let stamped = Stamped::new(Duration::from_micros(micros), frame);
            prop_assert_eq!(stamped.to_string().parse(), Ok(stamped));
        }

        #[test]
        fn arbitrary_text_never_panics(text in ".{0,100}") {
            let _ = text.parse::<Stamped>();
        }
    }
}
