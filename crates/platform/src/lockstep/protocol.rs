//! The packets of the side channel: little-endian, one message each, bounded.
//!
//! | message | direction | layout |
//! |---|---|---|
//! | Hello | process → coordinator | 1, version `u8`, filter count `u16`, next deadline `u64`, filters, silent filters |
//! | Advance | coordinator → process | 2, 0, frame count `u16`, to `u64`, until `u64`, frames |
//! | Stop | coordinator → process | 3, 0, 0 `u16`, at `u64` |
//! | Done | process → coordinator | 4, progress `u8`, frame count `u16`, next deadline `u64`, reached `u64`, frames, failure text |
//! | Audience | coordinator → process | 5, 0, filter count `u16`, 0 `u64`, filters accepted, silent filters |
//!
//! Times are nanoseconds; a deadline of all ones is none. A frame is its time `u64`, identifier with the kernel's flags
//! `u32`, length `u8` and 8 data bytes, a filter its id `u32` and mask `u32`. Progress is 0 running, 1 stopped, 2 failed; only a failure has a text.

use std::time::Duration;

use canopen::{CanFrame, Filter, Progress};

use super::answer::Answer;
use super::audience::Audience;

/// Frames in one message, at most.
pub const FRAMES_MAX: usize = 2048;

/// Bytes of a failure's text, at most.
const TEXT_MAX: usize = 1024;
/// Filters of a node, at most (the kernel's `CAN_RAW_FILTER_MAX`).
const FILTERS_MAX: usize = 512;
const HEADER_BYTES: usize = 12;
const TIME_BYTES: usize = 8;
const FRAME_BYTES: usize = 21;

/// No message is longer.
pub(super) const PACKET_MAX: usize =
    HEADER_BYTES + TIME_BYTES + FRAMES_MAX * FRAME_BYTES + TEXT_MAX;

const VERSION: u8 = 2;
const HELLO: u8 = 1;
const ADVANCE: u8 = 2;
const STOP: u8 = 3;
const DONE: u8 = 4;
const AUDIENCE: u8 = 5;
const NO_DEADLINE: u64 = u64::MAX;

/// What is wrong with a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProtocolError {
    /// The message ends in the middle of a field, or is empty.
    #[error("the message ends too early ({length} bytes)")]
    TooShort {
        /// Its length.
        length: usize,
    },
    /// The message goes on after its end.
    #[error("the message has {excess} bytes too many")]
    TooLong {
        /// Bytes after the end.
        excess: usize,
    },
    /// Another message was due.
    #[error("message kind {kind} where {expected} was due")]
    UnexpectedKind {
        /// The kind that came.
        kind: u8,
        /// The kinds that were due.
        expected: &'static str,
    },
    /// The other end is another version.
    #[error("protocol version {theirs}, ours is {VERSION}: build both ends from the same source")]
    Version {
        /// The other end's version.
        theirs: u8,
    },
    /// More items than a message may hold.
    #[error("{count} {what} (limit {limit})")]
    TooMany {
        /// How many.
        count: usize,
        /// Of what.
        what: &'static str,
        /// The limit.
        limit: usize,
    },
    /// A field outside its values.
    #[error("{field} is {value}")]
    BadValue {
        /// The field.
        field: &'static str,
        /// Its value.
        value: u8,
    },
    /// A time that does not fit 64 bits of nanoseconds.
    #[error("{time:?} exceeds 584 years")]
    TimeTooLarge {
        /// The time.
        time: Duration,
    },
}

/// What a process reports of itself first.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Hello {
    pub(super) filters: Vec<Filter>,
    pub(super) silent_filters: Vec<Filter>,
    pub(super) next_deadline: Option<Duration>,
}

/// What the coordinator asks of a process. Its frames are left in the caller's buffer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Request {
    Advance { to: Duration, until: Duration },
    Stop { at: Duration },
    Audience(Audience),
}

/// Writes a Hello over `packet`.
pub(super) fn encode_hello(packet: &mut Vec<u8>, hello: &Hello) -> Result<(), ProtocolError> {
    let count = limited(hello.filters.len(), "filters", FILTERS_MAX)?;
    let deadline = deadline_nanoseconds(hello.next_deadline)?;
    write_header(packet, HELLO, VERSION, count, deadline);
    write_filters(packet, &hello.filters);
    write_filters(packet, &hello.silent_filters);
    Ok(())
}

/// Reads a Hello.
pub(super) fn decode_hello(packet: &[u8]) -> Result<Hello, ProtocolError> {
    let mut reader = Reader::new(packet);
    reader.expect_kind(HELLO, "hello")?;
    let theirs = reader.u8()?;
    if theirs != VERSION {
        return Err(ProtocolError::Version { theirs });
    }
    let count = limited(usize::from(reader.u16()?), "filters", FILTERS_MAX)?;
    let next_deadline = reader.deadline()?;
    let (filters, silent_filters) = reader.two_lists_of_filters(count)?;
    Ok(Hello {
        filters,
        silent_filters,
        next_deadline,
    })
}

/// Writes an Audience over `packet`.
pub(super) fn encode_audience(
    packet: &mut Vec<u8>,
    audience: &Audience,
) -> Result<(), ProtocolError> {
    let limit = 2 * FILTERS_MAX;
    let count = limited(audience.accepted.filters().len(), "filters", limit)?;
    limited(audience.silent.filters().len(), "filters", limit)?;
    write_header(packet, AUDIENCE, 0, count, 0);
    write_filters(packet, audience.accepted.filters());
    write_filters(packet, audience.silent.filters());
    Ok(())
}

/// Writes an Advance over `packet`.
pub(super) fn encode_advance(
    packet: &mut Vec<u8>,
    to: Duration,
    until: Duration,
    frames: &[(Duration, CanFrame)],
) -> Result<(), ProtocolError> {
    let count = limited(frames.len(), "frames", FRAMES_MAX)?;
    write_header(packet, ADVANCE, 0, count, nanoseconds(to)?);
    packet.extend_from_slice(&nanoseconds(until)?.to_le_bytes());
    write_frames(packet, frames)
}

/// Writes a Stop over `packet`.
pub(super) fn encode_stop(packet: &mut Vec<u8>, at: Duration) -> Result<(), ProtocolError> {
    write_header(packet, STOP, 0, 0, nanoseconds(at)?);
    Ok(())
}

/// Reads an Advance, a Stop or an Audience; `frames` is overwritten with the frames delivered.
pub(super) fn decode_request(
    packet: &[u8],
    frames: &mut Vec<(Duration, CanFrame)>,
) -> Result<Request, ProtocolError> {
    let mut reader = Reader::new(packet);
    let kind = reader.u8()?;
    reader.u8()?;
    let count = reader.u16()?;
    let time = Duration::from_nanos(reader.u64()?);
    frames.clear();
    let request = match kind {
        ADVANCE => {
            let until = Duration::from_nanos(reader.u64()?);
            reader.frames(count, frames)?;
            Request::Advance { to: time, until }
        }
        STOP => Request::Stop { at: time },
        AUDIENCE => {
            let (accepted, silent) = reader.two_lists_of_filters(usize::from(count))?;
            Request::Audience(Audience {
                accepted: accepted.into(),
                silent: silent.into(),
            })
        }
        _ => {
            return Err(ProtocolError::UnexpectedKind {
                kind,
                expected: "advance, stop or audience",
            });
        }
    };
    reader.end()?;
    Ok(request)
}

/// Writes a Done over `packet`.
pub(super) fn encode_done(packet: &mut Vec<u8>, answer: &Answer) -> Result<(), ProtocolError> {
    let count = limited(answer.frames.len(), "frames", FRAMES_MAX)?;
    let (progress, text) = match &answer.progress {
        Progress::Running => (0, ""),
        Progress::Stopped => (1, ""),
        Progress::Failed(text) => (2, shortened(text)),
    };
    let deadline = deadline_nanoseconds(answer.next_deadline)?;
    write_header(packet, DONE, progress, count, deadline);
    packet.extend_from_slice(&nanoseconds(answer.reached)?.to_le_bytes());
    write_frames(packet, &answer.frames)?;
    packet.extend_from_slice(text.as_bytes());
    Ok(())
}

/// Reads a Done over the answer before.
pub(super) fn decode_done(packet: &[u8], answer: &mut Answer) -> Result<(), ProtocolError> {
    let mut reader = Reader::new(packet);
    reader.expect_kind(DONE, "done")?;
    let progress = reader.u8()?;
    let count = reader.u16()?;
    answer.next_deadline = reader.deadline()?;
    answer.reached = Duration::from_nanos(reader.u64()?);
    reader.frames(count, &mut answer.frames)?;
    answer.progress = match progress {
        0 => Progress::Running,
        1 => Progress::Stopped,
        2 => Progress::Failed(String::from_utf8_lossy(reader.rest()).into_owned()),
        value => {
            return Err(ProtocolError::BadValue {
                field: "progress",
                value,
            });
        }
    };
    reader.end()
}

fn write_header(packet: &mut Vec<u8>, kind: u8, second: u8, count: usize, time: u64) {
    let count = u16::try_from(count).expect("limits of counts fit 16 bits");
    packet.clear();
    packet.push(kind);
    packet.push(second);
    packet.extend_from_slice(&count.to_le_bytes());
    packet.extend_from_slice(&time.to_le_bytes());
}

fn write_filters(packet: &mut Vec<u8>, filters: &[Filter]) {
    for filter in filters {
        packet.extend_from_slice(&filter.id.to_le_bytes());
        packet.extend_from_slice(&filter.mask.to_le_bytes());
    }
}

fn write_frames(
    packet: &mut Vec<u8>,
    frames: &[(Duration, CanFrame)],
) -> Result<(), ProtocolError> {
    for (at, frame) in frames {
        let length = u8::try_from(frame.data().len()).expect("a frame has at most 8 bytes");
        packet.extend_from_slice(&nanoseconds(*at)?.to_le_bytes());
        packet.extend_from_slice(&frame.raw_id().to_le_bytes());
        packet.push(length);
        packet.extend_from_slice(&frame.buffer());
    }
    Ok(())
}

fn limited(count: usize, what: &'static str, limit: usize) -> Result<usize, ProtocolError> {
    if count > limit {
        return Err(ProtocolError::TooMany { count, what, limit });
    }
    Ok(count)
}

fn nanoseconds(time: Duration) -> Result<u64, ProtocolError> {
    u64::try_from(time.as_nanos()).map_err(|_| ProtocolError::TimeTooLarge { time })
}

fn deadline_nanoseconds(deadline: Option<Duration>) -> Result<u64, ProtocolError> {
    deadline.map_or(Ok(NO_DEADLINE), nanoseconds)
}

/// The longest start of `text` that fits.
fn shortened(text: &str) -> &str {
    let mut end = text.len().min(TEXT_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

/// Reads fields from the front of a message.
struct Reader<'a> {
    rest: &'a [u8],
    length: usize,
}

impl<'a> Reader<'a> {
    fn new(packet: &'a [u8]) -> Self {
        Self {
            rest: packet,
            length: packet.len(),
        }
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], ProtocolError> {
        let (head, rest) = self
            .rest
            .split_first_chunk::<N>()
            .ok_or(ProtocolError::TooShort {
                length: self.length,
            })?;
        self.rest = rest;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, ProtocolError> {
        self.bytes().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Result<u16, ProtocolError> {
        self.bytes().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, ProtocolError> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, ProtocolError> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn deadline(&mut self) -> Result<Option<Duration>, ProtocolError> {
        let value = self.u64()?;
        Ok((value != NO_DEADLINE).then(|| Duration::from_nanos(value)))
    }

    fn expect_kind(&mut self, due: u8, expected: &'static str) -> Result<(), ProtocolError> {
        let kind = self.u8()?;
        if kind != due {
            return Err(ProtocolError::UnexpectedKind { kind, expected });
        }
        Ok(())
    }

    fn frames(
        &mut self,
        count: u16,
        frames: &mut Vec<(Duration, CanFrame)>,
    ) -> Result<(), ProtocolError> {
        let count = limited(usize::from(count), "frames", FRAMES_MAX)?;
        frames.clear();
        for _ in 0..count {
            let at = Duration::from_nanos(self.u64()?);
            let id = self.u32()?;
            let length = self.u8()?;
            let frame =
                CanFrame::from_raw(id, length, self.bytes()?).ok_or(ProtocolError::BadValue {
                    field: "frame length",
                    value: length,
                })?;
            frames.push((at, frame));
        }
        Ok(())
    }

    fn filter(&mut self) -> Result<Filter, ProtocolError> {
        Ok(Filter {
            id: self.u32()?,
            mask: self.u32()?,
        })
    }

    /// The first `count` filters, and all that follow.
    fn two_lists_of_filters(
        &mut self,
        count: usize,
    ) -> Result<(Vec<Filter>, Vec<Filter>), ProtocolError> {
        let first = (0..count)
            .map(|_| self.filter())
            .collect::<Result<_, _>>()?;
        let mut second = Vec::new();
        while !self.rest.is_empty() {
            second.push(self.filter()?);
        }
        Ok((first, second))
    }

    fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.rest)
    }

    fn end(&self) -> Result<(), ProtocolError> {
        if !self.rest.is_empty() {
            return Err(ProtocolError::TooLong {
                excess: self.rest.len(),
            });
        }
        Ok(())
    }
}
