//! MCAP with messages of ROS 2: each message of the bus as a topic with its signals, every raw frame, and the events as a log.

mod cdr;
mod schema;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};
use std::time::Duration;

use dbc::{Database, SignalHandle};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use recording::events::{Event, Level};
use recording::frames::Frames;
use recording::log::Stamped;
use recording::occurrences::Occurrence;

use crate::{ID_BITS, signals};
use cdr::Cdr;

/// Topic of the received frames, as the driver of ROS 2 for SocketCAN names it.
const FRAMES_TOPIC: &str = "/from_can_bus";
/// Topic in which ROS 2 collects the reports of nodes.
const LOG_TOPIC: &str = "/rosout";
const FRAME_ID: &str = "can0";
/// Approximate size of the messages in one chunk, in bytes.
const CHUNK_BYTES_MIN: u64 = WriteOptions::DEFAULT_CHUNK_SIZE;
const CHUNK_BYTES_MAX: u64 = 6 * CHUNK_BYTES_MIN;

/// Writes the file to an output with a buffer. Times are those of the frames, in nanoseconds; the scenario began at `zero` on
/// their clock, which is written into the metadata. A signal is NaN if a frame is too short for it. The file is not compressed.
/// The frames are read twice, since the topics come before their messages.
///
/// # Errors
/// If the output does not take it, or there are more than 65 000 messages.
pub fn write(
    output: impl Write,
    frames: &Frames,
    database: &Database,
    events: &[Occurrence<Event>],
    zero: Duration,
) -> io::Result<()> {
    let write = || -> Result<(), McapError> {
        let mut file = McapFile::new(output, frames.len(), zero)?;
        let mut topics = topics(&mut file, frames, database)?;
        let raw = file.topic(FRAMES_TOPIC, "can_msgs/msg/Frame", schema::FRAME)?;
        let log = file.topic(LOG_TOPIC, "rcl_interfaces/msg/Log", schema::LOG)?;
        let timed = events
            .iter()
            .map(|event| (at(event.time_seconds, zero), &**event));
        let mut rest = timed.peekable();
        for stamped in frames.iter() {
            while let Some((time, event)) = rest.next_if(|(time, _)| *time <= stamped.time) {
                file.message(log, time, log_message(time, event).bytes())?;
            }
            file.message(raw, stamped.time, frame_message(&stamped).bytes())?;
            if let Some(topic) = topics.get_mut(&stamped.frame.raw_id()) {
                file.message(topic.id, stamped.time, topic.decode(&stamped))?;
            }
        }
        for (time, event) in rest {
            file.message(log, time, log_message(time, event).bytes())?;
        }
        file.writer.finish()?;
        Ok(())
    };
    write().map_err(|error| match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    })
}

struct McapFile<W: Write> {
    writer: Writer<NoSeek<W>>,
    /// Number of messages of each topic so far.
    sequences: BTreeMap<u16, u32>,
}

impl<W: Write> McapFile<W> {
    fn new(output: W, frames: usize, zero: Duration) -> Result<Self, McapError> {
        let version = env!("CARGO_PKG_VERSION");
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(chunk_bytes(frames)))
            .disable_seeking(true)
            .profile("ros2")
            .library(format!("canrig {version}"));
        let mut writer = options.create(NoSeek::new(output))?;
        let zero = zero.as_nanos().to_string();
        writer.write_metadata(&Metadata {
            name: "canrig".to_owned(),
            metadata: BTreeMap::from([("scenario_zero_nanoseconds".to_owned(), zero)]),
        })?;
        Ok(Self {
            writer,
            sequences: BTreeMap::new(),
        })
    }

    /// Adds a topic with messages of a kind; returns its number.
    fn topic(&mut self, name: &str, kind: &str, schema: &str) -> Result<u16, McapError> {
        let schema = self.writer.add_schema(kind, "ros2msg", schema.as_bytes())?;
        self.writer
            .add_channel(schema, name, "cdr", &BTreeMap::new())
    }

    fn message(&mut self, topic: u16, time: Duration, data: &[u8]) -> Result<(), McapError> {
        let sequence = self.sequences.entry(topic).or_default();
        let nanos = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader {
            channel_id: topic,
            sequence: *sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        *sequence = sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, data)
    }
}

/// Returns the size of a chunk. The writer holds one chunk, and an index of all: the longer a recording, the longer its chunks.
fn chunk_bytes(frames: usize) -> u64 {
    let bytes = u64::try_from(frames / 8).unwrap_or(u64::MAX);
    bytes.clamp(CHUNK_BYTES_MIN, CHUNK_BYTES_MAX)
}

/// Message of the bus whose signals are fields.
struct Topic {
    id: u16,
    signals: Vec<SignalHandle>,
    cdr: Cdr,
}

impl Topic {
    fn decode(&mut self, stamped: &Stamped) -> &[u8] {
        self.cdr.clear();
        for signal in &self.signals {
            let value = signal.decode(&stamped.frame).unwrap_or(f64::NAN);
            self.cdr.push_f64(value);
        }
        if self.signals.is_empty() {
            // ROS 2 pads a message without fields.
            self.cdr.push_u8(0);
        }
        self.cdr.bytes()
    }
}

/// Adds a topic for each message on the bus; returns them by raw identifier.
fn topics(
    file: &mut McapFile<impl Write>,
    frames: &Frames,
    database: &Database,
) -> Result<BTreeMap<u32, Topic>, McapError> {
    // Inserted one by one, since a collected set holds all items from which it is made.
    let mut ids = BTreeSet::new();
    for stamped in frames.iter() {
        ids.insert(stamped.frame.raw_id());
    }
    let messages = database.messages().iter();
    let mut topics = BTreeMap::new();
    for message in messages.filter(|message| ids.contains(&message.raw_id)) {
        let kind = schema::kind(&message.name);
        let name = format!("/{}", message.name);
        let topic = Topic {
            id: file.topic(&name, &kind, &schema::definition(message))?,
            signals: signals(message),
            cdr: Cdr::new(),
        };
        topics.insert(message.raw_id, topic);
    }
    Ok(topics)
}

/// Returns the time of an event on the clock of the frames, in whole microseconds like theirs.
fn at(time_seconds: f64, zero: Duration) -> Duration {
    let since = Duration::try_from_secs_f64(time_seconds.abs()).unwrap_or_default();
    let micros = (since.as_nanos() + 500) / 1000;
    let since = Duration::from_micros(u64::try_from(micros).unwrap_or(u64::MAX));
    if time_seconds < 0.0 {
        zero.saturating_sub(since)
    } else {
        zero.saturating_add(since)
    }
}

/// Serialises a `can_msgs/msg/Frame`.
fn frame_message(Stamped { time, frame, .. }: &Stamped) -> Cdr {
    let mut cdr = Cdr::new();
    cdr.push_time(*time);
    cdr.push_text(FRAME_ID);
    cdr.push_u32(frame.raw_id() & ID_BITS);
    for flag in [frame.is_remote(), frame.is_extended(), frame.is_error()] {
        cdr.push_u8(flag.into());
    }
    cdr.push_u8(frame.length());
    for byte in frame.buffer() {
        cdr.push_u8(byte);
    }
    cdr
}

/// Serialises an `rcl_interfaces/msg/Log`.
fn log_message(time: Duration, event: &Event) -> Cdr {
    let mut cdr = Cdr::new();
    cdr.push_time(time);
    cdr.push_u8(match event.level {
        Level::Info => schema::INFO,
        Level::Warning => schema::WARN,
        Level::Error => schema::ERROR,
    });
    cdr.push_text("canrig");
    cdr.push_text(&event.text);
    // No file, function and line.
    cdr.push_text("");
    cdr.push_text("");
    cdr.push_u32(0);
    cdr
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;
    use mcap::MessageStream;

    fn example() -> Vec<u8> {
        let at = |millis, id, data: &[u8]| {
            Stamped::new(Duration::from_millis(millis), CanFrame::new(id, data))
        };
        let frames = [
            at(5, 0x080, &[]),
            at(10, 0x190, &[0x37, 0x02, 0x10, 0x27, 0, 0, 0xF4, 0x01]),
            at(12, 0x190, &[0x37, 0x02]),
            at(13, 0x7E5, &[1, 0xAB]),
        ];
        let events = [(-0.004, "before"), (9.0, "after")]
            .map(|(time, text)| Occurrence::new(time, Event::new(Level::Warning, text)));
        let zero = Duration::from_millis(10);
        let frames = frames.to_vec().into();
        let mut file = Vec::new();
        write(&mut file, &frames, Database::shipped(), &events, zero).unwrap();
        file
    }

    #[test]
    fn frames_signals_and_events_stand_in_the_order_of_time() {
        let file = example();
        let messages: Vec<_> = MessageStream::new(&file)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        let topics = messages.iter().map(|message| {
            let millis = message.log_time / 1_000_000;
            (millis, message.channel.topic.as_str(), message.sequence)
        });
        let expected = [
            (5, "/from_can_bus", 0),
            (5, "/sync", 0),
            (6, "/rosout", 0),
            (10, "/from_can_bus", 1),
            (10, "/drive_tpdo1", 0),
            (12, "/from_can_bus", 2),
            (12, "/drive_tpdo1", 1),
            (13, "/from_can_bus", 3),
            (9010, "/rosout", 1),
        ];
        assert_eq!(topics.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_message_has_its_signals_as_numbers() {
        let file = example();
        let messages = MessageStream::new(&file).unwrap().map(Result::unwrap);
        let mut tpdos = messages.filter(|message| message.channel.topic == "/drive_tpdo1");
        let values = |data: &[u8]| {
            let (numbers, rest) = data[4..].as_chunks();
            assert!(rest.is_empty());
            let values = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes));
            values.collect::<Vec<_>>()
        };
        let whole = values(&tpdos.next().unwrap().data);
        assert_eq!(whole[whole.len() - 2..], [10.0, 0.5]);
        let short = values(&tpdos.next().unwrap().data);
        assert_eq!(short[0], whole[0]);
        assert!(short[short.len() - 2].is_nan());
    }

    #[test]
    fn two_files_of_a_recording_are_the_same_bytes() {
        assert_eq!(example(), example());
    }
}
