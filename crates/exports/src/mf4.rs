//! ASAM MDF 4.10: all signals over time, one row a cycle, as floating-point numbers, and all frames as bus logging.

mod bus;

use std::io::{self, Write};
use std::time::Duration;

use recording::frames::Frames;
use recording::run_folder::file as run_file;
use recording::timeline::{self, Column, Timeline};
use recording::work::Pass;

/// Address of the header block.
const HEADER_AT: usize = 64;
const HEADER_BYTES: usize = 104;
/// Length of the header of every block.
const BLOCK_HEADER_BYTES: usize = 24;

/// Channel types and data types of the standard.
const FIXED_LENGTH: u8 = 0;
const MASTER: u8 = 2;
const NO_SYNC: u8 = 0;
const TIME: u8 = 1;
const UNSIGNED_LITTLE_ENDIAN: u8 = 0;
const FLOAT_LITTLE_ENDIAN: u8 = 4;
const BYTES: u8 = 10;
const VALUE_BYTES: u32 = 8;
/// Separator between the parts of a channel's name.
const PATH_SEPARATOR: u16 = b'.' as u16;

/// Writes the file to an output with a buffer. Time 0 is that of the scenario; `start` is its time since the start of 1970. A
/// signal without a value is NaN. `dbc` gives the frames their meaning; it is attached as `frames.dbc`. The frames are read once
/// to count them, and once more for each kind.
///
/// # Errors
/// If the output does not take it.
pub fn write(
    output: impl Write,
    timelines: &[Timeline],
    frames: &Frames,
    dbc: &str,
    start: Duration,
) -> io::Result<()> {
    let mut signals = timeline::signals(timelines);
    if let Some(time) = signals.first_mut() {
        "time".clone_into(&mut time.name);
    }
    write_file(output, &signals, frames, dbc, start)
}

fn write_file(
    mut output: impl Write,
    signals: &[Column],
    frames: &Frames,
    dbc: &str,
    start: Duration,
) -> io::Result<()> {
    let mut file = Mf4File::new();
    let frame_groups = bus::groups(&mut file, frames);
    let data_group = file.signals(signals, frame_groups);
    let attachment = file.attachment(run_file::FRAMES, "text/plain", dbc.as_bytes());
    file.finish(data_group, attachment, start);
    let mut from = 0;
    for (to, data) in &file.data {
        output.write_all(&file.bytes[from..*to])?;
        match data {
            Data::Frames(kind) => bus::write_records(&mut output, frames, *kind, start)?,
            Data::Signals => write_rows(&mut output, signals)?,
        }
        from = *to;
    }
    output.write_all(&file.bytes[from..])
}

/// Writes the rows, each with one number of every signal.
fn write_rows(output: &mut impl Write, signals: &[Column]) -> io::Result<()> {
    let rows = signals.first().map_or(0, |time| time.values.len());
    let mut pass = Pass::new(wide(rows));
    let mut columns: Vec<_> = signals.iter().map(|signal| signal.values.iter()).collect();
    for _ in 0..rows {
        pass.advance(1);
        for value in columns.iter_mut().filter_map(Iterator::next) {
            output.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Channel with the place of its bits in a record.
#[derive(Clone, Copy, Default)]
struct Channel<'a> {
    name: &'a str,
    unit: &'a str,
    data_type: u8,
    byte: u32,
    bit: u32,
    bits: u32,
    flags: u32,
    /// Address of the first of its component channels; 0 if it has none.
    parts: u64,
}

impl<'a> Channel<'a> {
    fn float(name: &'a str, unit: &'a str, byte: u32) -> Self {
        Self {
            name,
            unit,
            data_type: FLOAT_LITTLE_ENDIAN,
            byte,
            bits: VALUE_BYTES * 8,
            ..Self::default()
        }
    }
}

/// Format of the records of a channel group.
#[derive(Default)]
struct Records {
    count: usize,
    bytes: u32,
    flags: u16,
    /// Address of their source; 0 if they have none.
    source: u64,
}

/// Content of a data block, which is written when all blocks are known.
enum Data {
    Frames(bus::Kind),
    Signals,
}

/// File that grows block by block; a block links to earlier ones only.
struct Mf4File {
    /// All blocks, without the data.
    bytes: Vec<u8>,
    /// Data, each with its place in the bytes.
    data: Vec<(usize, Data)>,
    /// Length of all data; records are as long as some blocks of eight bytes.
    data_bytes: usize,
}

impl Mf4File {
    fn new() -> Self {
        let mut bytes = b"MDF     4.10    canrig  \0\0\0\0".to_vec();
        bytes.extend_from_slice(&410u16.to_le_bytes());
        bytes.resize(HEADER_AT + HEADER_BYTES, 0);
        Self {
            bytes,
            data: Vec::new(),
            data_bytes: 0,
        }
    }

    /// Appends a block; returns its address.
    fn block(&mut self, name: &[u8; 4], links: &[u64], data: &[u8]) -> u64 {
        let address = self.next();
        self.bytes.extend(block(name, links, data));
        address
    }

    /// Appends a block for these records, whose bytes come later; returns its address.
    fn data(&mut self, data: Data, records: &Records) -> u64 {
        let address = self.next();
        let bytes = records.count * records.bytes as usize;
        self.bytes.extend(block_header(b"##DT", 0, bytes));
        self.data.push((self.bytes.len(), data));
        self.data_bytes += bytes;
        address
    }

    /// Returns the address of the next block.
    fn next(&mut self) -> u64 {
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        wide(self.bytes.len() + self.data_bytes)
    }

    /// Appends a text, or one with markup; returns its address.
    fn text(&mut self, name: &[u8; 4], text: &str) -> u64 {
        let mut data = text.as_bytes().to_vec();
        data.push(0);
        data.resize(data.len().next_multiple_of(8), 0);
        self.block(name, &[], &data)
    }

    /// Appends a group of all signals, before the group `next`.
    fn signals(&mut self, signals: &[Column], next: u64) -> u64 {
        let mut records = Records {
            count: signals.first().map_or(0, |time| time.values.len()),
            ..Records::default()
        };
        let mut channels = Vec::new();
        for signal in signals {
            channels.push(Channel::float(&signal.name, &signal.unit, records.bytes));
            records.bytes += VALUE_BYTES;
        }
        let data = self.data(Data::Signals, &records);
        let first = self.channels(&channels);
        self.data_group(next, first, data, &records)
    }

    /// Appends the descriptions of the channels of a group, of which the first is the time; returns the address of the first.
    fn channels(&mut self, channels: &[Channel]) -> u64 {
        let Some((time, others)) = channels.split_first() else {
            return 0;
        };
        let next = self.fixed_channels(others);
        self.channel(next, time, MASTER, TIME)
    }

    fn fixed_channels(&mut self, channels: &[Channel]) -> u64 {
        let last_first = channels.iter().rev();
        last_first.fold(0, |next, channel| {
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
        // No precision, attachments, ranges and limits.
        data.resize(data.len() + 4 + 6 * 8, 0);
        let links = [next, channel.parts, name, 0, 0, 0, unit, 0];
        self.block(b"##CN", &links, &data)
    }

    /// Appends a group of channels with their records, before the data group `next`.
    fn data_group(&mut self, next: u64, first_channel: u64, data: u64, records: &Records) -> u64 {
        let mut group = vec![0; 8];
        group.extend_from_slice(&wide(records.count).to_le_bytes());
        group.extend_from_slice(&records.flags.to_le_bytes());
        group.extend_from_slice(&PATH_SEPARATOR.to_le_bytes());
        group.extend_from_slice(&[0; 4]);
        group.extend_from_slice(&records.bytes.to_le_bytes());
        group.extend_from_slice(&[0; 4]);
        let links = [0, first_channel, 0, records.source, 0, 0];
        let group = self.block(b"##CG", &links, &group);
        self.block(b"##DG", &[next, group, data, 0], &[0; 8])
    }

    /// Appends a file within the file.
    fn attachment(&mut self, name: &str, mime_type: &str, content: &[u8]) -> u64 {
        /// Flag of a content that is embedded, neither compressed nor hashed.
        const EMBEDDED: u64 = 1;
        let [name, mime_type] = [name, mime_type].map(|text| self.text(b"##TX", text));
        let mut data = EMBEDDED.to_le_bytes().to_vec();
        data.resize(data.len() + 16, 0);
        // Original length and stored length are the same.
        for _ in 0..2 {
            data.extend_from_slice(&wide(content.len()).to_le_bytes());
        }
        data.extend_from_slice(content);
        self.block(b"##AT", &[0, name, mime_type, 0], &data)
    }

    /// Appends the history with the program that wrote the file, as the standard demands.
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

    /// Appends the last block, and fills in the header.
    fn finish(&mut self, data_group: u64, attachment: u64, start: Duration) {
        let nanos = u64::try_from(start.as_nanos()).unwrap_or(0);
        let history = self.history(nanos);
        let mut data = nanos.to_le_bytes().to_vec();
        // UTC; no classes, flags, angles or distances.
        data.resize(32, 0);
        let header = block(b"##HD", &[data_group, history, 0, attachment, 0, 0], &data);
        self.bytes[HEADER_AT..HEADER_AT + HEADER_BYTES].copy_from_slice(&header);
    }
}

fn block_header(name: &[u8; 4], links: usize, rest_bytes: usize) -> Vec<u8> {
    let mut bytes = name.to_vec();
    bytes.extend_from_slice(&[0; 4]);
    bytes.extend_from_slice(&wide(BLOCK_HEADER_BYTES + rest_bytes).to_le_bytes());
    bytes.extend_from_slice(&wide(links).to_le_bytes());
    bytes
}

fn block(name: &[u8; 4], links: &[u64], data: &[u8]) -> Vec<u8> {
    let mut bytes = block_header(name, links.len(), 8 * links.len() + data.len());
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
    use can::CanFrame;
    use recording::log::Stamped;
    use recording::timeline::Series;

    fn number(file: &[u8], at: u64) -> u64 {
        let at = usize::try_from(at).unwrap();
        u64::from_le_bytes(file[at..at + 8].try_into().unwrap())
    }

    fn name(file: &[u8], at: u64) -> &[u8] {
        let at = usize::try_from(at).unwrap();
        &file[at..at + 4]
    }

    #[test]
    fn blocks_have_the_lengths_of_the_standard() {
        let mut file = Mf4File::new();
        assert_eq!(file.bytes.len(), HEADER_AT + HEADER_BYTES);
        let length = |file: &Mf4File, address: u64| {
            assert_eq!(address % 8, 0);
            number(&file.bytes, address + 8)
        };
        let channel = file.channels(&[Channel::float("a", "", 0)]);
        assert_eq!(length(&file, channel), 160);
        let records = Records {
            count: 5,
            bytes: 16,
            flags: 0,
            source: 0,
        };
        let data_group = file.data_group(0, 0, 0, &records);
        let group = number(&file.bytes, data_group + 32);
        assert_eq!(length(&file, group), 104);
        let history = file.history(0);
        assert_eq!(length(&file, history), 56);
        file.finish(0, 0, Duration::ZERO);
        assert_eq!(name(&file.bytes, 64), b"##HD");
    }

    #[test]
    fn each_group_links_to_data_that_are_as_long_as_its_records() {
        let at = |micros| Duration::from_micros(micros);
        let remote = CanFrame::from_raw(0x4000_0190, 0, [0; 8]).unwrap();
        let frames: Vec<Stamped> = (0..1000)
            .map(|micros| match micros % 4 {
                0 => Stamped::new(at(micros), remote),
                _ => Stamped::new(at(micros), CanFrame::new(0x190, &[1, 2])),
            })
            .collect();
        let signals = ["time", "position"].map(|name| Column {
            name: name.to_owned(),
            unit: String::new(),
            is_term: false,
            values: Series::from(vec![0.0, 0.5, 1.0]),
        });
        let mut file = Vec::new();
        let dbc = "VERSION \"\"\n";
        write_file(&mut file, &signals, &frames.into(), dbc, at(250)).unwrap();
        let attached = number(&file, 64 + 24 + 3 * 8);
        assert_eq!(name(&file, attached), b"##AT");
        let content = usize::try_from(attached).unwrap() + 24 + 4 * 8 + 40;
        assert_eq!(&file[content..content + dbc.len()], dbc.as_bytes());
        assert_eq!(
            number(&file, attached + 8),
            (24 + 4 * 8 + 40 + dbc.len()) as u64
        );
        let mut groups = Vec::new();
        let mut next = number(&file, 64 + 24);
        while next != 0 {
            assert_eq!(name(&file, next), b"##DG");
            let [group, data] = [32, 40].map(|link| number(&file, next + link));
            assert_eq!(
                (name(&file, group), name(&file, data)),
                (&b"##CG"[..], &b"##DT"[..])
            );
            groups.push((number(&file, group + 80), number(&file, data + 8) - 24));
            next = number(&file, next + 24);
        }
        assert_eq!(groups, [(3, 3 * 16), (750, 750 * 24), (250, 250 * 24)]);
    }
}
