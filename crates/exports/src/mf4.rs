//! ASAM MDF 4.10: all signals over time, one row a cycle, as floating-point numbers, and all frames as bus logging.

mod bus;

use std::time::Duration;

use recording::log::Stamped;
use recording::timeline::Timeline;

/// Where the header block has its place.
const HEADER_AT: usize = 64;
const HEADER_BYTES: usize = 104;

/// Channel types and data types of the standard.
const FIXED_LENGTH: u8 = 0;
const MASTER: u8 = 2;
const NO_SYNC: u8 = 0;
const TIME: u8 = 1;
const UNSIGNED_LITTLE_ENDIAN: u8 = 0;
const FLOAT_LITTLE_ENDIAN: u8 = 4;
const BYTES: u8 = 10;
const VALUE_BYTES: u32 = 8;
/// Between the parts of a channel's name.
const PATH_SEPARATOR: u16 = b'.' as u16;

/// The file. Time 0 is that of the scenario; `start` is when that was, since the beginning of 1970. Where a signal has
/// no value it is NaN.
#[must_use]
pub fn to_mf4(timeline: &Timeline, frames: &[Stamped], start: Duration) -> Vec<u8> {
    let mut file = Mf4File::new();
    let frame_groups = bus::frames(&mut file, frames, start);
    let data_group = file.signals(timeline, frame_groups);
    let nanos = u64::try_from(start.as_nanos()).unwrap_or(0);
    let history = file.history(nanos);
    file.finish(data_group, history, nanos)
}

/// A channel, and where its bits are in a record.
#[derive(Clone, Copy)]
struct Channel<'a> {
    name: &'a str,
    unit: &'a str,
    data_type: u8,
    byte: u32,
    bit: u32,
    bits: u32,
    flags: u32,
    /// The first of the channels that it is made of; 0 without.
    parts: u64,
}

impl<'a> Channel<'a> {
    fn float(name: &'a str, unit: &'a str, byte: u32) -> Self {
        Self {
            name,
            unit,
            data_type: FLOAT_LITTLE_ENDIAN,
            byte,
            bit: 0,
            bits: VALUE_BYTES * 8,
            flags: 0,
            parts: 0,
        }
    }
}

/// What makes the records of a channel group.
struct Records {
    count: usize,
    bytes: u32,
    flags: u16,
    /// Whence they come; 0 if that is nowhere.
    source: u64,
}

/// A file that grows block by block; a block links to earlier ones only.
struct Mf4File {
    bytes: Vec<u8>,
}

impl Mf4File {
    fn new() -> Self {
        let mut bytes = b"MDF     4.10    canrig  \0\0\0\0".to_vec();
        bytes.extend_from_slice(&410u16.to_le_bytes());
        bytes.resize(HEADER_AT + HEADER_BYTES, 0);
        Self { bytes }
    }

    /// Appends a block; its address.
    fn block(&mut self, name: &[u8; 4], links: &[u64], data: &[u8]) -> u64 {
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        let address = self.bytes.len();
        self.bytes.extend(block(name, links, data));
        wide(address)
    }

    /// A text, or one with markup.
    fn text(&mut self, name: &[u8; 4], text: &str) -> u64 {
        let mut data = text.as_bytes().to_vec();
        data.push(0);
        data.resize(data.len().next_multiple_of(8), 0);
        self.block(name, &[], &data)
    }

    /// A group of all signals, before the group `next`.
    fn signals(&mut self, timeline: &Timeline, next: u64) -> u64 {
        let set_point = &timeline.set_point_millimetres;
        let mut signals = vec![
            ("time", "s", &timeline.time_seconds),
            ("set_point_millimetres", "mm", set_point),
        ];
        let columns = timeline.columns.iter();
        signals.extend(
            columns.map(|column| (column.name.as_str(), column.unit.as_str(), &column.values)),
        );
        let values: Vec<&[f64]> = signals.iter().map(|signal| signal.2.as_slice()).collect();
        let data = self.data(&values);
        let mut byte = 0;
        let mut channels = Vec::new();
        for (name, unit, _) in &signals {
            channels.push(Channel::float(name, unit, byte));
            byte += VALUE_BYTES;
        }
        let first = self.channels(&channels);
        let records = Records {
            count: timeline.time_seconds.len(),
            bytes: byte,
            flags: 0,
            source: 0,
        };
        self.data_group(next, first, data, &records)
    }

    /// The rows: each has one number of every signal.
    fn data(&mut self, signals: &[&[f64]]) -> u64 {
        let rows = signals.first().map_or(0, |signal| signal.len());
        let mut data = Vec::with_capacity(rows * signals.len() * VALUE_BYTES as usize);
        for row in 0..rows {
            for signal in signals {
                data.extend_from_slice(&signal[row].to_le_bytes());
            }
        }
        self.block(b"##DT", &[], &data)
    }

    /// The descriptions of the channels of a group, of which the first is the time; the address of the first.
    fn channels(&mut self, channels: &[Channel]) -> u64 {
        let Some((time, others)) = channels.split_first() else {
            return 0;
        };
        let next = self.fixed_channels(others);
        self.channel(next, time, MASTER, TIME)
    }

    fn fixed_channels(&mut self, channels: &[Channel]) -> u64 {
        let channels = channels.iter().rev();
        channels.fold(0, |next, channel| {
            self.channel(next, channel, FIXED_LENGTH, NO_SYNC)
        })
    }

    fn channel(&mut self, next: u64, channel: &Channel, kind: u8, sync: u8) -> u64 {
        let name = self.text(b"##TX", channel.name);
        let unit = match channel.unit {
            "" => 0,
            unit => self.text(b"##TX", unit),
        };
        let bit = u8::try_from(channel.bit).unwrap_or(0);
        let mut data = vec![kind, sync, channel.data_type, bit];
        for number in [channel.byte, channel.bits, channel.flags, 0] {
            data.extend_from_slice(&number.to_le_bytes());
        }
        // Neither precision nor attachments, ranges or limits.
        data.resize(data.len() + 4 + 6 * 8, 0);
        let links = [next, channel.parts, name, 0, 0, 0, unit, 0];
        self.block(b"##CN", &links, &data)
    }

    /// A group of channels with their records, before the data group `next`.
    fn data_group(&mut self, next: u64, first_channel: u64, data: u64, records: &Records) -> u64 {
        let group = self.channel_group(first_channel, records);
        self.block(b"##DG", &[next, group, data, 0], &[0; 8])
    }

    fn channel_group(&mut self, first_channel: u64, records: &Records) -> u64 {
        let mut data = vec![0; 8];
        data.extend_from_slice(&wide(records.count).to_le_bytes());
        data.extend_from_slice(&records.flags.to_le_bytes());
        data.extend_from_slice(&PATH_SEPARATOR.to_le_bytes());
        data.extend_from_slice(&[0; 4]);
        data.extend_from_slice(&records.bytes.to_le_bytes());
        data.extend_from_slice(&[0; 4]);
        let links = [0, first_channel, 0, records.source, 0, 0];
        self.block(b"##CG", &links, &data)
    }

    /// Who wrote the file; the standard demands it.
    fn history(&mut self, nanos: u64) -> u64 {
        let version = env!("CARGO_PKG_VERSION");
        let comment = format!(
            "<FHcomment><TX>recorded on a CAN bus</TX><tool_id>canrig</tool_id><tool_vendor>canrig</tool_vendor>\
             <tool_version>{version}</tool_version></FHcomment>"
        );
        let comment = self.text(b"##MD", &comment);
        let mut data = nanos.to_le_bytes().to_vec();
        data.extend_from_slice(&[0; 8]);
        self.block(b"##FH", &[0, comment], &data)
    }

    fn finish(mut self, data_group: u64, history: u64, nanos: u64) -> Vec<u8> {
        let mut data = nanos.to_le_bytes().to_vec();
        // UTC; no classes, flags, angles or distances.
        data.resize(32, 0);
        let header = block(b"##HD", &[data_group, history, 0, 0, 0, 0], &data);
        self.bytes[HEADER_AT..HEADER_AT + HEADER_BYTES].copy_from_slice(&header);
        self.bytes
    }
}

fn block(name: &[u8; 4], links: &[u64], data: &[u8]) -> Vec<u8> {
    let length = 24 + 8 * links.len() + data.len();
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(name);
    bytes.extend_from_slice(&[0; 4]);
    bytes.extend_from_slice(&wide(length).to_le_bytes());
    bytes.extend_from_slice(&wide(links.len()).to_le_bytes());
    for link in links {
        bytes.extend_from_slice(&link.to_le_bytes());
    }
    bytes.extend_from_slice(data);
    bytes
}

fn wide(number: usize) -> u64 {
    u64::try_from(number).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_the_lengths_of_the_standard() {
        let mut file = Mf4File::new();
        assert_eq!(file.bytes.len(), HEADER_AT + HEADER_BYTES);
        let length = |file: &Mf4File, address: u64| {
            let address = usize::try_from(address).unwrap();
            assert_eq!(address % 8, 0);
            u64::from_le_bytes(file.bytes[address + 8..address + 16].try_into().unwrap())
        };
        let channel = file.channels(&[Channel::float("a", "", 0)]);
        assert_eq!(length(&file, channel), 160);
        let records = Records {
            count: 5,
            bytes: 16,
            flags: 0,
            source: 0,
        };
        let group = file.channel_group(0, &records);
        assert_eq!(length(&file, group), 104);
        let history = file.history(0);
        assert_eq!(length(&file, history), 56);
        let bytes = file.finish(0, 0, 0);
        assert_eq!(&bytes[64..68], b"##HD");
    }
}
