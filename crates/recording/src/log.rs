//! Log of a bus: stamped frames, as `bus.log` holds them (`candump -L`).

use std::collections::VecDeque;
use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::os::fd::AsRawFd;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use can::CanFrame;
use can::frame::{ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG};
use can::frame_bits::occupied_bits;

use crate::pieces::{Damaged, PieceReader};
use crate::work::Measured;

/// Longest line of a log that is read.
const LINE_LENGTH_MAX: u64 = 256;
/// Number of bytes after the last good line that are searched for another one.
const UNREADABLE_BYTES_MAX: usize = 1 << 20;
/// Smallest number of bytes that a strange line counts for: its reason takes room, too.
const STRANGE_BYTES_MIN: usize = 64;
/// Largest number of strange lines in a log.
const UNREADABLE_LINES_MAX: usize = 1000;
/// Upper bound of a step of the clock in a run.
pub(crate) const STEP_MAX: Duration = Duration::from_millis(500);
/// Largest number of frames far ahead of the one above them that may be no frames.
const AHEAD_MAX: usize = 16;
/// Number of digits of the seconds since 1970 until the year 2286.
const SECONDS_DIGITS_MAX: usize = 10;

/// Frame with the time at which its last bit passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamped {
    /// Time on the recording's clock: virtual time, or the wall clock's since 1970. Whole microseconds, as in the log.
    pub time: Duration,
    pub frame: CanFrame,
    /// Number of bits for which it occupied the bus. It follows from the frame, and is counted once.
    pub occupied_bits: u32,
}

impl Stamped {
    /// Makes a frame with its time cut to the log's resolution, so that a log read back judges the same.
    pub fn new(time: Duration, frame: CanFrame) -> Self {
        Self::counted(time, frame, occupied_bits(&frame))
    }

    /// As [`Stamped::new`], with the [`occupied_bits`] that the caller has counted already.
    pub fn counted(time: Duration, frame: CanFrame, occupied_bits: u32) -> Self {
        Self {
            time: Duration::new(time.as_secs(), time.subsec_micros() * 1000),
            frame,
            occupied_bits,
        }
    }

    /// Appends a line of `candump -L` with its end, and the interface written as `can0` in every world.
    pub fn push_to(&self, text: &mut String) {
        text.push('(');
        push_decimal(text, self.time.as_secs(), SECONDS_DIGITS_MAX);
        text.push('.');
        push_decimal(text, self.time.subsec_micros().into(), 6);
        text.push_str(") can0 ");
        self.frame.push_to(text);
        text.push('\n');
    }
}

/// Appends the last digits of a number.
fn push_decimal(text: &mut String, number: u64, digits: usize) {
    let mut shown = [b'0'; 20];
    let mut rest = number;
    for digit in shown[..digits].iter_mut().rev() {
        *digit += u8::try_from(rest % 10).expect("a digit");
        rest /= 10;
    }
    text.push_str(str::from_utf8(&shown[..digits]).expect("digits"));
}

/// Parses a line of `candump -L` into its interface and its frame, `None` for one of CAN FD.
fn parse_line(line: &str) -> Result<(&str, Option<Stamped>), &'static str> {
    let mut parts = line.split_whitespace();
    let (Some(stamp), Some(interface), Some(frame)) = (parts.next(), parts.next(), parts.next())
    else {
        return Err("expected: (seconds.microseconds) interface id#data");
    };
    let stamp = stamp
        .strip_prefix('(')
        .and_then(|stamp| stamp.strip_suffix(')'));
    let time = parse_time(stamp.ok_or("no time stamp")?)?;
    let frame = parse_frame(frame)?;
    Ok((interface, frame.map(|frame| Stamped::new(time, frame))))
}

/// Parses a time in seconds, with six digits behind the point.
pub(crate) fn parse_time(text: &str) -> Result<Duration, &'static str> {
    let (seconds, micros) = text.split_once('.').ok_or("no time stamp")?;
    if seconds.len() > SECONDS_DIGITS_MAX {
        return Err("seconds have more than ten digits");
    }
    if micros.len() != 6 {
        return Err("microseconds need six digits");
    }
    let seconds = seconds.parse().map_err(|_| "seconds are no number")?;
    let micros: u32 = micros.parse().map_err(|_| "microseconds are no number")?;
    Ok(Duration::new(seconds, micros * 1000))
}

/// Parses a frame; returns `None` for one of CAN FD.
fn parse_frame(text: &str) -> Result<Option<CanFrame>, &'static str> {
    let (id, data) = text
        .split_once('#')
        .ok_or("no '#' between identifier and data")?;
    let mut raw_id = hexadecimal(id).ok_or("identifier is not hexadecimal")?;
    match id.len() {
        3 if raw_id <= 0x7FF => {}
        // Candump shows only this flag.
        8 if raw_id & ERROR_FLAG != 0 && raw_id <= ERROR_FLAG | 0x1FFF_FFFF => {}
        8 if raw_id <= 0x1FFF_FFFF => raw_id |= EXTENDED_FLAG,
        3 => return Err("identifier is beyond 7FF"),
        8 => return Err("identifier is beyond 1FFFFFFF, or 3FFFFFFF of an error frame"),
        _ => return Err("identifier needs three or eight digits"),
    }
    if let Some(length) = data.strip_prefix('R') {
        let length = match length.as_bytes() {
            [] => 0,
            [digit @ b'0'..=b'8'] => digit - b'0',
            _ => return Err("a remote frame's length is one digit, at most 8"),
        };
        return Ok(CanFrame::from_raw(raw_id | REMOTE_FLAG, length, [0; 8]));
    }
    if data.starts_with('#') {
        return Ok(None);
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
    Ok(CanFrame::from_raw(raw_id, length, bytes))
}

/// Parses a number that consists of digits only, without a sign.
fn hexadecimal(digits: &str) -> Option<u32> {
    let is_plain = digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_plain.then(|| u32::from_str_radix(digits, 16).ok())?
}

/// Parts of a log that are no frames.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unread {
    /// Number of CAN FD frames, which are not kept.
    pub fd_frames: u64,
    /// Lines between others that are no frames.
    pub unreadable: Vec<UnreadableLine>,
    /// Place and reason of a break in the log, for the user.
    pub broken: Option<String>,
}

/// Line of a log that is no frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnreadableLine {
    number: u64,
    reason: String,
    /// Time of the frame before it; `None` if there is none.
    before: Option<Duration>,
}

impl fmt::Display for UnreadableLine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "line {}: {}", self.number, self.reason)
    }
}

impl Unread {
    /// Describes the unreadable lines between the first frame and `end`, for the user.
    pub fn unreadable_until(&self, end: Duration) -> Option<String> {
        let is_within = |line: &&UnreadableLine| line.before.is_some_and(|before| before < end);
        let mut lines = self.unreadable.iter().filter(is_within);
        let first = lines.next()?;
        Some(match lines.count() {
            0 => format!("a line of the log is no frame, {first}"),
            more => format!(
                "{} lines of the log are no frames, the first {first}",
                more + 1
            ),
        })
    }

    /// Describes the unreadable parts of the log, for the user.
    pub fn remarks(&self) -> Vec<String> {
        let unreadable = self.unreadable_until(Duration::MAX);
        let broken = self.broken.as_ref();
        let text = broken.map(|broken| format!("the log breaks off ({broken})"));
        unreadable.into_iter().chain(text).collect()
    }
}

/// Reads a log whose writer may have been killed, so that its end may be cut in the middle of a line. A last line without its end
/// is not taken, since a shorter frame looks whole. Lines between others that are no frames are skipped.
///
/// # Errors
/// If the file cannot be read, or is no log of `candump -L`: more than 1000 lines are no frames.
pub fn read_cut_log(input: impl BufRead) -> io::Result<(Vec<Stamped>, Unread)> {
    let mut reader = LogReader::new(Box::new(input));
    let mut frames = Vec::new();
    while let Some(stamped) = reader.next_frame()? {
        frames.push(stamped);
    }
    Ok((frames, reader.finish()))
}

/// Extension of a compressed log's name.
const COMPRESSED: &str = "zst";

/// Returns whether a log of this name is compressed.
pub(crate) fn is_compressed(path: &Path) -> bool {
    path.extension().is_some_and(|end| end == COMPRESSED)
}

/// Log for repeated reading. It stays open, so that it remains the same file if another takes its name meanwhile.
#[derive(Clone, Debug)]
pub(crate) struct OpenLog {
    file: Arc<File>,
    is_compressed: bool,
}

impl OpenLog {
    pub(crate) fn new(file: File, is_compressed: bool) -> Self {
        Self {
            file: Arc::new(file),
            is_compressed,
        }
    }

    /// # Errors
    /// If the file cannot be opened.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        Ok(Self::new(scenario::open_file(path)?, is_compressed(path)))
    }

    /// Returns its text from the first line on.
    fn text(&self) -> io::Result<Box<dyn BufRead>> {
        let bytes = self.file.metadata()?.len();
        // A file of its own, which each reader reads from its start.
        let file = File::open(format!("/proc/self/fd/{}", self.file.as_raw_fd()))?;
        Ok(if self.is_compressed {
            Box::new(BufReader::new(PieceReader::new(file, bytes)))
        } else {
            Box::new(BufReader::new(Measured::new(file, bytes)))
        })
    }

    /// Returns its frames from the first one on.
    ///
    /// # Errors
    /// If the system refuses the file.
    pub(crate) fn frames(&self) -> io::Result<LogReader<'static>> {
        Ok(LogReader::new(self.text()?))
    }
}

/// Frame with the number of its line.
struct Numbered {
    number: u64,
    stamped: Stamped,
}

/// Reader of a log, frame by frame.
pub(crate) struct LogReader<'a> {
    input: Box<dyn BufRead + 'a>,
    interface: Option<String>,
    line: Vec<u8>,
    number: u64,
    latest: Option<Duration>,
    /// Frames below the latest that are far ahead of it, until it is known whether one below goes
    /// on from it.
    ahead: VecDeque<Numbered>,
    /// Frames that are read again.
    again: VecDeque<Numbered>,
    unread: Unread,
    /// Lines that are strange if a good line follows; otherwise the log breaks off there.
    open: Vec<UnreadableLine>,
    open_bytes: usize,
    is_at_end: bool,
}

impl<'a> LogReader<'a> {
    fn new(input: Box<dyn BufRead + 'a>) -> Self {
        Self {
            input,
            interface: None,
            line: Vec::new(),
            number: 0,
            latest: None,
            ahead: VecDeque::new(),
            again: VecDeque::new(),
            unread: Unread::default(),
            open: Vec::new(),
            open_bytes: 0,
            is_at_end: false,
        }
    }

    /// Returns the next frame that is no earlier than the latest; `None` at the end. Frames far
    /// ahead of the latest are no frames if one soon below them goes on from it.
    ///
    /// # Errors
    /// If the file cannot be read, or is no log.
    pub(crate) fn next_frame(&mut self) -> io::Result<Option<Stamped>> {
        loop {
            let Some(next) = self.next_whole()? else {
                if let Some(first) = self.first_ahead()? {
                    return Ok(Some(first));
                }
                if self.interface.is_none() {
                    refuse_many(&self.open)?;
                }
                return Ok(None);
            };
            let time = next.stamped.time;
            let Some(latest) = self.latest else {
                self.accept(&next.stamped)?;
                return Ok(Some(next.stamped));
            };
            let goes_on = time + STEP_MAX >= latest;
            match self.ahead.front() {
                Some(first) if goes_on && first.stamped.time > time + STEP_MAX => {
                    for one in std::mem::take(&mut self.ahead) {
                        let why =
                            "it is later than a frame below, which goes on from the one above";
                        self.put_aside_line(one.number, why.to_owned());
                    }
                }
                None if time <= latest + STEP_MAX => {}
                _ if goes_on => {
                    self.ahead.push_back(next);
                    if self.ahead.len() <= AHEAD_MAX {
                        continue;
                    }
                    return self.first_ahead();
                }
                _ => {}
            }
            // A part of the log is there twice, or in the wrong place.
            if !goes_on {
                let why = "it is earlier than the frame above";
                self.put_aside_line(next.number, why.to_owned());
                continue;
            }
            self.accept(&next.stamped)?;
            return Ok(Some(next.stamped));
        }
    }

    /// Takes the first of the frames far ahead as the one that goes on, and reads the others again.
    fn first_ahead(&mut self) -> io::Result<Option<Stamped>> {
        let first = self.ahead.pop_front();
        while let Some(last) = self.ahead.pop_back() {
            self.again.push_front(last);
        }
        let Some(Numbered { stamped, .. }) = first else {
            return Ok(None);
        };
        self.accept(&stamped)?;
        Ok(Some(stamped))
    }

    /// Takes a frame as the latest: the strange lines above it are among others.
    fn accept(&mut self, stamped: &Stamped) -> io::Result<()> {
        self.open.sort_by_key(|line| line.number);
        self.unread.unreadable.append(&mut self.open);
        self.open_bytes = 0;
        refuse_many(&self.unread.unreadable)?;
        self.latest = Some(stamped.time);
        Ok(())
    }

    /// Returns the next line that is a frame, wherever it belongs; `None` at the end.
    fn next_whole(&mut self) -> io::Result<Option<Numbered>> {
        if let Some(again) = self.again.pop_front() {
            return Ok(Some(again));
        }
        while self.read_line()? {
            if self.line.trim_ascii().is_empty() {
                // It has no meaning, but there may not be too many.
                self.open_bytes += self.line.len();
                if self.open_bytes > UNREADABLE_BYTES_MAX {
                    self.put_aside("nothing but blank lines".to_owned());
                }
                continue;
            }
            match whole_line(&self.line, &mut self.interface) {
                Ok(Some(stamped)) => {
                    let number = self.number;
                    return Ok(Some(Numbered { number, stamped }));
                }
                Ok(None) => {
                    self.unread.unreadable.append(&mut self.open);
                    self.open_bytes = 0;
                    refuse_many(&self.unread.unreadable)?;
                    self.unread.fd_frames += 1;
                }
                Err(reason) => self.put_aside(reason),
            }
        }
        Ok(None)
    }

    /// Reads the next line; returns `false` at the end.
    fn read_line(&mut self) -> io::Result<bool> {
        while !self.is_at_end {
            self.line.clear();
            self.number += 1;
            let mut input = Read::take(&mut self.input, LINE_LENGTH_MAX);
            match input.read_until(b'\n', &mut self.line) {
                Ok(0) => self.is_at_end = true,
                Ok(_) => return Ok(true),
                Err(error) if Damaged::of(&error).is_some() => self.put_aside(error.to_string()),
                Err(error) => return Err(error),
            }
        }
        Ok(false)
    }

    fn put_aside(&mut self, reason: String) {
        self.put_aside_line(self.number, reason);
    }

    fn put_aside_line(&mut self, number: u64, reason: String) {
        self.open.push(UnreadableLine {
            number,
            reason,
            before: self.latest,
        });
        self.open_bytes += self.line.len().max(STRANGE_BYTES_MIN);
        self.is_at_end |= self.open_bytes > UNREADABLE_BYTES_MAX;
    }

    /// Returns the parts that were no frames.
    pub(crate) fn finish(self) -> Unread {
        Unread {
            broken: self.open.first().map(ToString::to_string),
            ..self.unread
        }
    }
}

/// Refuses a file with too many lines that are no frames.
fn refuse_many(unreadable: &[UnreadableLine]) -> io::Result<()> {
    match unreadable.first() {
        Some(first) if unreadable.len() > UNREADABLE_LINES_MAX => Err(invalid(format!(
            "{first}; more than {UNREADABLE_LINES_MAX} lines are no frames"
        ))),
        _ => Ok(()),
    }
}

/// Parses a line into its frame, `None` for one of CAN FD. The first frame decides on the interface.
fn whole_line(line: &[u8], interface: &mut Option<String>) -> Result<Option<Stamped>, String> {
    let text = str::from_utf8(line)
        .map_err(|_| "not text".to_owned())?
        .strip_suffix('\n')
        .ok_or("cut before its end")?
        .trim();
    let (name, frame) = parse_line(text).map_err(|reason| {
        let shown: String = text.chars().take(80).collect();
        format!("not a line of candump -L: \"{shown}\" ({reason})")
    })?;
    let first = interface.get_or_insert_with(|| name.to_owned());
    if first == name {
        return Ok(frame);
    }
    Err(format!(
        "a frame of {name} among those of {first}; take one interface out of the log first"
    ))
}

fn invalid(reason: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(line: &str) -> Result<Stamped, &'static str> {
        let (_, frame) = parse_line(line)?;
        frame.ok_or("a CAN FD frame")
    }

    /// Returns the line of a frame, without its end.
    fn shown(stamped: &Stamped) -> String {
        let mut line = String::new();
        stamped.push_to(&mut line);
        line.trim_end().to_owned()
    }

    #[test]
    fn a_line_reads_as_candump_writes_it() {
        let stamped = Stamped::new(
            Duration::from_micros(1_234_567),
            CanFrame::new(0x190, &[1, 0xAB]),
        );
        assert_eq!(shown(&stamped), "(0000000001.234567) can0 190#01AB");
        assert_eq!(parse("(0000000001.234567) vcan0 190#01AB R"), Ok(stamped));
    }

    #[test]
    fn a_bad_line_is_named_by_its_number() {
        let log = "(0.000001) can0 123#\n(0.000002) can0 9999#00\n";
        let (_, unread) = read_cut_log(log.as_bytes()).unwrap();
        assert_eq!(
            unread.broken.unwrap(),
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
            "190#R9",
            "190#R08",
            "190#R-1",
        ] {
            let line = format!("(0.000001) can0 {frame}");
            assert!(parse(&line).is_err(), "{line}");
        }
        for (id, limit) in [("70145677", "1FFFFFFF"), ("800", "7FF")] {
            let reason = parse(&format!("(0.000001) can0 {id}#00")).unwrap_err();
            let start = format!("identifier is beyond {limit}");
            assert!(reason.starts_with(&start), "{reason}");
        }
        let error = "(0000000000.000001) can0 20000004#0001000000000000";
        assert_eq!(shown(&parse(error).unwrap()), error);
    }

    #[test]
    fn a_remote_frame_keeps_its_length() {
        let full = "(0000000000.000001) can0 190#R8";
        let read = parse(full).unwrap();
        assert_eq!((shown(&read).as_str(), read.frame.data().len()), (full, 8));
        let without = "(0000000000.000001) can0 190#R";
        assert_eq!(shown(&parse(without).unwrap()), without);
    }

    /// A socket may give both flags; candump shows the one in the identifier and the other in place of the data.
    #[test]
    fn an_error_message_that_is_also_a_remote_frame_is_readable() {
        let flags = ERROR_FLAG | REMOTE_FLAG | 4;
        let both = CanFrame::from_raw(flags, 8, [0, 1, 0, 0, 0, 0, 0, 0]).unwrap();
        let written = Stamped::new(Duration::from_micros(1), both);
        assert_eq!(parse(&shown(&written)), Ok(written));
        let by_candump = parse("(0.000001) can0 20000004#R8").unwrap();
        assert!(by_candump.frame.is_error());
    }

    const LOG: &str = "(0.000001) can0 123#\n(0.000002) can0 190#0102\n";

    #[test]
    fn a_log_cut_at_any_byte_reads_up_to_there() {
        let (whole, unread) = read_cut_log(LOG.as_bytes()).unwrap();
        assert_eq!((whole.len(), unread.broken), (2, None));
        for length in 0..LOG.len() {
            let (frames, unread) = read_cut_log(&LOG.as_bytes()[..length]).unwrap();
            let lines = LOG[..length].matches('\n').count();
            assert_eq!(frames, whole[..lines]);
            assert_eq!(
                unread.broken.is_some(),
                !LOG[..length].ends_with('\n') && length > 0
            );
        }
        let zeros = [LOG.as_bytes(), &[0; 5000]].concat();
        let (frames, unread) = read_cut_log(&zeros[..]).unwrap();
        assert_eq!((frames.len(), unread.broken.is_some()), (2, true));
        // An endless file is not read for ever.
        let endless = io::Read::chain(LOG.as_bytes(), io::BufReader::new(io::repeat(0)));
        let (frames, unread) = read_cut_log(endless).unwrap();
        assert_eq!((frames.len(), unread.broken.is_some()), (2, true));
    }

    #[test]
    fn unreadable_lines_among_the_others_are_passed_over_and_named() {
        let odd = "(0.000003) can0 1#\n(0.000004) can0 190#0102\nodd\n(0.000005) can0 191#\n";
        let (frames, unread) = read_cut_log(format!("{LOG}{odd}").as_bytes()).unwrap();
        assert_eq!((frames.len(), unread.unreadable.len()), (4, 2));
        assert_eq!(unread.broken, None);
        let all = unread.unreadable_until(Duration::MAX).unwrap();
        let start = "2 lines of the log are no frames, the first line 3: not a line of candump -L";
        assert!(all.starts_with(start), "{all}");
        // Between 2 and 4 µs, and between 4 and 5.
        let until = |micros| unread.unreadable_until(Duration::from_micros(micros));
        assert!(
            until(4)
                .unwrap()
                .starts_with("a line of the log is no frame, line 3: ")
        );
        assert_eq!(until(2), None);
        // Lines before all frames do not hide any of them.
        let (headed, unread) = read_cut_log(format!("# of Monday\n{LOG}").as_bytes()).unwrap();
        assert_eq!((headed.len(), unread.unreadable.len()), (2, 1));
        assert_eq!(unread.unreadable_until(Duration::MAX), None);
    }

    #[test]
    fn a_part_that_is_there_twice_is_read_once() {
        let line = |millis: u64| {
            let frame = CanFrame::new(0x190, &millis.to_le_bytes());
            shown(&Stamped::new(Duration::from_millis(millis), frame)) + "\n"
        };
        let whole: String = (0..300).map(|number| line(10 * number)).collect();
        let (frames, unread) = read_cut_log(format!("{whole}{whole}").as_bytes()).unwrap();
        assert_eq!(frames.len(), 300 + 51);
        let (once, _) = read_cut_log(whole.as_bytes()).unwrap();
        assert_eq!(frames[..300], once);
        let first = &unread.unreadable[0];
        assert_eq!(
            first.to_string(),
            "line 301: it is earlier than the frame above"
        );
        // A clock that is stepped back is no wrong order.
        let stepped: String = [0, 400, 0, 400, 800].map(line).concat();
        let (frames, unread) = read_cut_log(stepped.as_bytes()).unwrap();
        assert_eq!((frames.len(), unread.unreadable.len()), (5, 0));
    }

    /// A few time stamps far ahead are strange, and so are all lines below more of them: more than
    /// a thousand are refused by name.
    #[test]
    fn a_time_stamp_far_ahead_is_no_frame_s() {
        let line = |millis: u64| {
            let frame = CanFrame::new(0x190, &millis.to_le_bytes());
            shown(&Stamped::new(Duration::from_millis(millis), frame)) + "\n"
        };
        let sound = Vec::from_iter((1..2000).map(|number| line(10 * number)));
        let ahead = |count: usize| {
            let mut lines = sound.clone();
            for line in &mut lines[100..100 + count] {
                line.replace_range(1..18, "0000009000.000000");
            }
            lines.concat()
        };
        for count in [1, 3, AHEAD_MAX] {
            let (frames, unread) = read_cut_log(ahead(count).as_bytes()).unwrap();
            assert_eq!(
                (frames.len(), unread.unreadable.len()),
                (1999 - count, count)
            );
            assert_eq!(
                unread.unreadable[0].to_string(),
                "line 101: it is later than a frame below, which goes on from the one above"
            );
            let until = |millis| unread.unreadable_until(Duration::from_millis(millis));
            assert!(until(1000).is_none() && until(1001).is_some());
        }
        let many = ahead(AHEAD_MAX + 1);
        let cut = many.lines().take(1000).map(|line| format!("{line}\n"));
        let (frames, unread) = read_cut_log(String::from_iter(cut).as_bytes()).unwrap();
        let broken = "line 118: it is earlier than the frame above";
        assert_eq!(
            (frames.len(), unread.broken.as_deref()),
            (117, Some(broken))
        );
        let error = read_cut_log((many + &line(9_000_010)).as_bytes()).unwrap_err();
        assert!(error.to_string().starts_with(broken), "{error}");
        // After a silence all frames are far ahead, also at the end.
        let after = |count: usize| {
            let late = (0..count as u64).map(|number| line(60_000 + 10 * number));
            let log = sound.concat() + &String::from_iter(late);
            let (frames, unread) = read_cut_log(log.as_bytes()).unwrap();
            assert_eq!((frames.len(), unread), (1999 + count, Unread::default()));
        };
        [1, AHEAD_MAX, AHEAD_MAX + 1, 200]
            .into_iter()
            .for_each(after);
    }

    #[test]
    fn a_time_stamp_beyond_ten_digits_is_none() {
        let line = format!("({}.999999) can0 123#\n", u64::MAX);
        let (frames, unread) = read_cut_log(format!("{LOG}{line}{LOG}").as_bytes()).unwrap();
        let reason = unread.unreadable[0].to_string();
        assert_eq!((frames.len(), unread.unreadable.len()), (4, 1));
        assert!(
            reason.ends_with("(seconds have more than ten digits)"),
            "{reason}"
        );
    }

    #[test]
    fn blank_lines_do_not_go_on_for_ever() {
        let (frames, unread) = read_cut_log(format!("{LOG}\n\n{LOG}").as_bytes()).unwrap();
        assert_eq!((frames.len(), unread), (4, Unread::default()));
        for (blank, expected) in [(UNREADABLE_BYTES_MAX, 4), (UNREADABLE_BYTES_MAX + 1, 2)] {
            let log = format!("{LOG}{}{LOG}", "\n".repeat(blank));
            let (frames, _) = read_cut_log(log.as_bytes()).unwrap();
            assert_eq!(frames.len(), expected, "{blank}");
        }
        let endless = io::Read::chain(LOG.as_bytes(), io::BufReader::new(io::repeat(b'\n')));
        let (frames, unread) = read_cut_log(endless).unwrap();
        assert_eq!(frames.len(), 2);
        assert!(unread.broken.unwrap().contains("nothing but blank lines"));
    }

    #[test]
    fn fd_frames_are_counted() {
        let log = format!("{LOG}(0.000003) can0 123##1AABB\n(0.000004) can0 191#\n");
        let (frames, unread) = read_cut_log(log.as_bytes()).unwrap();
        assert_eq!((frames.len(), unread.fd_frames), (3, 1));
        assert!(unread.unreadable.is_empty() && unread.broken.is_none());
    }

    #[test]
    fn a_log_of_two_interfaces_and_a_file_that_is_no_log_are_refused() {
        let line = |number: usize, name| format!("(0.{number:06}) {name} 123#\n");
        let other: String = (0..=UNREADABLE_LINES_MAX)
            .map(|number| line(number, "can1"))
            .collect();
        let mixed = format!("{LOG}{other}{LOG}");
        let error = read_cut_log(mixed.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 3: a frame of can1"), "{error}");
        assert!(
            error.ends_with("more than 1000 lines are no frames"),
            "{error}"
        );
        let text = "no frame\n".repeat(UNREADABLE_LINES_MAX + 1);
        assert!(read_cut_log(text.as_bytes()).is_err());
        let two = format!("(0.0) can1 123#\n{LOG}").replace("0.0)", "0.000000)");
        let (_, unread) = read_cut_log(two.as_bytes()).unwrap();
        assert!(
            unread
                .broken
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
            let mut text = String::new();
            [stamped, stamped].iter().for_each(|one| one.push_to(&mut text));
            let read = read_cut_log(text.as_bytes()).unwrap();
            prop_assert_eq!(read, (vec![stamped, stamped], Unread::default()));
        }

        #[test]
        fn arbitrary_text_never_panics(text in ".{0,100}") {
            let _ = parse(&text);
        }
    }
}
