//! Protocol between canrig and a node at a *bus seat*, byte by byte; see `docs/reference/seats.md`. The module [`crate::seat`]
//! defines the frame of a message.

use std::time::Duration;

use can::{CanFrame, Filter, FilterSet, Node, Progress};

use super::participant::Answer;
use crate::clock::nanoseconds;
use crate::seat::{
    FAILED, Header, Kind, MAGIC, Misread, NEVER, STOPPED, VERSION, bytes_at, fitting_text,
    read_hello_at, split, write_name,
};

/// Largest number of frames in one message.
pub const FRAMES_MAX: usize = 1024;

/// Seat of a node, in HELLO.
const BUS_SEAT: u8 = 0;
/// Flag in HELLO: the node gets error frames.
const ERRORS_TOO: u8 = 2;
/// Largest number of filters of a node (the kernel's `CAN_RAW_FILTER_MAX`).
pub(super) const FILTERS_MAX: usize = 512;
const FILTER_BYTES: usize = 8;
/// Bytes of a record: a frame of up to 8 bytes with its time.
const RECORD_BYTES: usize = 24;
/// Offsets of the parts of a message.
const FLAGS_AT: usize = 17;
const COUNT_AT: usize = 2;
const FILTERS_AT: usize = 56;
const BODY_AT: usize = 16;
const RECORDS_AT: usize = 24;

/// HELLO of a node: its properties before the first step.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hello {
    /// Identifiers that the node listens to.
    pub filters: Vec<Filter>,
    /// Frames that the node takes in silence, see [`can::Node::silent_filters`].
    pub silent_filters: Vec<Filter>,
    /// Time of its first tick.
    pub next_deadline: Option<Duration>,
}

impl Hello {
    /// Returns the HELLO of a new node.
    pub(super) fn of(node: &dyn Node) -> Self {
        Self {
            filters: node.filters_as_configured(),
            silent_filters: node.silent_filters(),
            next_deadline: node.next_deadline(),
        }
    }
}

/// Description of a run for a node, in WELCOME.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Setting {
    /// Time of the run, later than 0 for a node that restarts.
    pub now: Duration,
    /// Bit rate of the bus.
    pub bits_per_second: u32,
    /// Seed of the run.
    pub seed: u64,
    /// The node-ID.
    pub node_id: u8,
}

/// Question of canrig. Its frames are in the caller's buffer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Request {
    Grant { to: Duration, until: Duration },
    Stop { at: Duration },
}

/// The bounds of an answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) number: u32,
    pub(super) from: Duration,
    pub(super) to: Duration,
    pub(super) until: Duration,
    /// Whether a fault has halted the node, so that its actions before `to` are late.
    pub(super) was_halted: bool,
}

/// Writes HELLO.
pub(super) fn encode_hello(packet: &mut Vec<u8>, hello: &Hello) -> Result<(), Misread> {
    let header = Header {
        a: VERSION,
        count: counted(hello.filters.len(), FILTERS_MAX, "filters", COUNT_AT)?,
        number: MAGIC,
        time: deadline(hello.next_deadline),
        ..Header::of(Kind::Hello)
    };
    let silent = hello.silent_filters.len();
    let silent = counted(silent, FILTERS_MAX, "silent filters", FLAGS_AT + 1)?;
    header.begin(packet);
    packet.extend_from_slice(&[BUS_SEAT, 0]);
    packet.extend_from_slice(&silent.to_le_bytes());
    packet.extend_from_slice(&[0; 4]);
    write_name(packet, "");
    write_filters(packet, &hello.filters);
    write_filters(packet, &hello.silent_filters);
    Ok(())
}

/// Reads HELLO.
pub(super) fn decode_hello(packet: &[u8]) -> Result<Hello, Misread> {
    let (header, rest) = read_hello_at(packet, BUS_SEAT)?;
    let count = counted(header.count.into(), FILTERS_MAX, "filters", COUNT_AT)?;
    let flags = packet[FLAGS_AT];
    if flags & !ERRORS_TOO != 0 {
        let what = format!("flags 0x{flags:02X}, and 0x{ERRORS_TOO:02X} alone is known");
        return Err(Misread::new(FLAGS_AT, what));
    }
    let silent = u16::from_le_bytes([packet[FLAGS_AT + 1], packet[FLAGS_AT + 2]]);
    let silent = counted(silent.into(), FILTERS_MAX, "silent filters", FLAGS_AT + 1)?;
    let expected = usize::from(count) + usize::from(silent);
    ends_at(packet, FILTERS_AT + expected * FILTER_BYTES)?;
    let mut filters = filters(rest);
    let silent_filters = filters.split_off(count.into());
    if flags & ERRORS_TOO != 0 {
        filters.push(Filter::ERRORS);
    }
    Ok(Hello {
        filters,
        silent_filters,
        next_deadline: time_or_never(header.time),
    })
}

/// Writes WELCOME.
pub(super) fn encode_welcome(
    packet: &mut Vec<u8>,
    setting: &Setting,
    quiet: &[Filter],
) -> Result<(), Misread> {
    let header = Header {
        a: VERSION,
        count: counted(quiet.len(), FILTERS_MAX, "quiet filters", COUNT_AT)?,
        time: nanoseconds(setting.now),
        ..Header::of(Kind::Welcome)
    };
    header.begin(packet);
    packet.extend_from_slice(&setting.bits_per_second.to_le_bytes());
    // The protocol has no frames with a faster data phase yet.
    packet.extend_from_slice(&setting.bits_per_second.to_le_bytes());
    packet.extend_from_slice(&setting.seed.to_le_bytes());
    packet.extend_from_slice(&[setting.node_id, 0, 0, 0, 0, 0, 0, 0]);
    write_filters(packet, quiet);
    Ok(())
}

/// Reads the quiet filters of WELCOME.
pub(super) fn decode_welcome(packet: &[u8]) -> Result<Vec<Filter>, Misread> {
    let (header, body) = split(packet, Kind::Welcome)?;
    ends_at(packet, 40 + usize::from(header.count) * FILTER_BYTES)?;
    Ok(filters(&body[24..]))
}

/// Writes GRANT.
pub(super) fn encode_grant(
    packet: &mut Vec<u8>,
    asked: &Asked,
    frames: &[(Duration, CanFrame)],
) -> Result<(), Misread> {
    let header = Header {
        a: asked.was_halted.into(),
        count: counted(frames.len(), FRAMES_MAX, "frames", COUNT_AT)?,
        number: asked.number,
        time: nanoseconds(asked.to),
        ..Header::of(Kind::Grant)
    };
    header.begin(packet);
    packet.extend_from_slice(&nanoseconds(asked.until).to_le_bytes());
    write_records(packet, frames);
    Ok(())
}

/// Writes STOP.
pub(super) fn encode_stop(packet: &mut Vec<u8>, asked: &Asked) {
    let header = Header {
        number: asked.number,
        time: nanoseconds(asked.to),
        ..Header::of(Kind::Stop)
    };
    header.begin(packet);
}

/// Reads GRANT or STOP with its number; `frames` is overwritten with the delivered frames.
pub(super) fn decode_request(
    packet: &[u8],
    frames: &mut Vec<(Duration, CanFrame)>,
) -> Result<(u32, Request), Misread> {
    frames.clear();
    let (header, _) = Header::split(packet)?;
    let time = Duration::from_nanos(header.time);
    if header.kind == Kind::Stop as u8 {
        ends_at(packet, BODY_AT)?;
        return Ok((header.number, Request::Stop { at: time }));
    }
    let (header, body) = split(packet, Kind::Grant)?;
    let until = time_in(packet, body)?;
    let rest = read_records(packet, header.count.into(), frames)?;
    ends_at(packet, packet.len() - rest.len())?;
    Ok((header.number, Request::Grant { to: time, until }))
}

/// Writes DONE.
pub(super) fn encode_done(
    packet: &mut Vec<u8>,
    number: u32,
    answer: &Answer,
) -> Result<(), Misread> {
    let (a, text) = match &answer.progress {
        Progress::Running => (0, ""),
        Progress::Stopped => (STOPPED, ""),
        Progress::Failed(text) => (FAILED, fitting_text(text)),
    };
    let header = Header {
        a,
        count: counted(answer.frames.len(), FRAMES_MAX, "frames", COUNT_AT)?,
        number,
        time: deadline(answer.next_deadline),
        ..Header::of(Kind::Done)
    };
    header.begin(packet);
    packet.extend_from_slice(&nanoseconds(answer.reached).to_le_bytes());
    write_records(packet, &answer.frames);
    packet.extend_from_slice(text.as_bytes());
    Ok(())
}

/// Reads DONE into the answer. After a frame of the node that is not quiet, it must not have continued.
pub(super) fn decode_done(
    packet: &[u8],
    asked: &Asked,
    quiet: &FilterSet,
    answer: &mut Answer,
) -> Result<(), Misread> {
    let (header, body) = split(packet, Kind::Done)?;
    if header.number != asked.number {
        let what = format!("number {}, and {} was asked", header.number, asked.number);
        return Err(Misread::new(4, what));
    }
    answer.frames.clear();
    answer.next_deadline = time_or_never(header.time);
    answer.reached = time_in(packet, body)?;
    let rest = read_records(packet, header.count.into(), &mut answer.frames)?;
    answer.progress = match header.a {
        0 => Progress::Running,
        STOPPED => Progress::Stopped,
        FAILED => Progress::Failed(String::from_utf8_lossy(rest).into_owned()),
        a => return Err(Misread::new(1, format!("{a}, which is neither 0, 1 nor 2"))),
    };
    if header.a != FAILED {
        ends_at(packet, packet.len() - rest.len())?;
    }
    is_possible(asked, quiet, answer)
}

/// Checks that an answer keeps to the granted time.
fn is_possible(asked: &Asked, quiet: &FilterSet, answer: &Answer) -> Result<(), Misread> {
    let earliest = match answer.progress {
        Progress::Running => asked.to,
        _ => asked.from,
    };
    let (mut latest, mut last) = (asked.until, asked.from);
    for (place, (time, frame)) in answer.frames.iter().enumerate() {
        let at = RECORDS_AT + place * RECORD_BYTES;
        if *time < last || *time > answer.reached {
            let reached = answer.reached;
            let what =
                format!("frame {frame} at {time:?}, which lies outside {last:?} to {reached:?}");
            return Err(Misread::new(at, what));
        }
        if frame.is_error() {
            let what = format!("frame {frame} is an error frame, which no node sends");
            return Err(Misread::new(at + 8, what));
        }
        last = *time;
        if !quiet.accepts(frame) {
            latest = latest.min(last.max(asked.to));
        }
    }
    if answer.reached < earliest || answer.reached > latest {
        let what = format!(
            "it reached {:?}, which lies outside {earliest:?} to {latest:?}",
            answer.reached
        );
        return Err(Misread::new(BODY_AT, what));
    }
    Ok(())
}

fn write_filters(packet: &mut Vec<u8>, filters: &[Filter]) {
    for filter in filters {
        packet.extend_from_slice(&filter.id.to_le_bytes());
        packet.extend_from_slice(&filter.mask.to_le_bytes());
    }
}

fn filters(bytes: &[u8]) -> Vec<Filter> {
    let filter = |bytes: &[u8; FILTER_BYTES]| Filter {
        id: u32::from_le_bytes(bytes_at(bytes, 0)),
        mask: u32::from_le_bytes(bytes_at(bytes, 4)),
    };
    bytes.as_chunks().0.iter().map(filter).collect()
}

fn write_records(packet: &mut Vec<u8>, frames: &[(Duration, CanFrame)]) {
    for (at, frame) in frames {
        let mut record = [0; RECORD_BYTES];
        record[..8].copy_from_slice(&nanoseconds(*at).to_le_bytes());
        record[8..12].copy_from_slice(&frame.raw_id().to_le_bytes());
        record[12] = frame.length();
        record[16..].copy_from_slice(&frame.buffer());
        packet.extend_from_slice(&record);
    }
}

/// Reads the records of a message; returns the bytes after them.
fn read_records<'a>(
    packet: &'a [u8],
    count: usize,
    frames: &mut Vec<(Duration, CanFrame)>,
) -> Result<&'a [u8], Misread> {
    counted(count, FRAMES_MAX, "frames", COUNT_AT)?;
    let length = count * RECORD_BYTES;
    let Some((records, rest)) = packet[RECORDS_AT..].split_at_checked(length) else {
        return Err(short(packet, RECORDS_AT + length));
    };
    let records = records.as_chunks::<RECORD_BYTES>().0.iter();
    for (place, record) in records.enumerate() {
        let at = RECORDS_AT + place * RECORD_BYTES;
        let time = u64::from_le_bytes(bytes_at(record, 0));
        let id = u32::from_le_bytes(bytes_at(record, 8));
        let [length, flags] = bytes_at(record, 12);
        let data = bytes_at(record, 16);
        let frame = CanFrame::from_raw(id, length, data).filter(|_| flags == 0);
        let Some(frame) = frame else {
            let what = format!(
                "a frame of {length} bytes with flags 0x{flags:02X}: frames have at most 8 bytes and no flags here"
            );
            return Err(Misread::new(at + 12, what));
        };
        frames.push((Duration::from_nanos(time), frame));
    }
    Ok(rest)
}

/// Returns the time after a header.
fn time_in(packet: &[u8], body: &[u8]) -> Result<Duration, Misread> {
    let time = body
        .first_chunk()
        .ok_or_else(|| short(packet, RECORDS_AT))?;
    Ok(Duration::from_nanos(u64::from_le_bytes(*time)))
}

/// Refuses a message of another length.
fn ends_at(packet: &[u8], end: usize) -> Result<(), Misread> {
    match packet.len() {
        length if length < end => Err(short(packet, end)),
        length if length > end => Err(Misread::new(
            end,
            format!("the message ends here, and {} bytes follow", length - end),
        )),
        _ => Ok(()),
    }
}

fn short(packet: &[u8], end: usize) -> Misread {
    let length = packet.len();
    Misread::new(
        length,
        format!("the message has {end} bytes, and this one ends here"),
    )
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "limits of counts fit 16 bits"
)]
fn counted(count: usize, limit: usize, what: &str, byte: usize) -> Result<u16, Misread> {
    if count > limit {
        let what = format!("{count} {what}, where {limit} is the limit");
        return Err(Misread::new(byte, what));
    }
    Ok(count as u16)
}

fn deadline(deadline: Option<Duration>) -> u64 {
    deadline.map_or(NEVER, nanoseconds)
}

fn time_or_never(time: u64) -> Option<Duration> {
    (time != NEVER).then(|| Duration::from_nanos(time))
}
