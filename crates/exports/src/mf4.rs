//! ASAM MDF 4.10: all signals over time, one row a cycle, as floating-point numbers.

use std::io::{self, Write};
use std::time::Duration;

use recording::timeline::Timeline;
use recording::work::Way;

/// Where the header block has its place.
const HEADER_AT: usize = 64;
const HEADER_BYTES: usize = 104;
/// Where the block of the data has its place.
const DATA_AT: usize = HEADER_AT + HEADER_BYTES;
const BLOCK_HEADER_BYTES: usize = 24;

/// Channel types and data types of the standard.
const FIXED_LENGTH: u8 = 0;
const MASTER: u8 = 2;
const NO_SYNC: u8 = 0;
const TIME: u8 = 1;
const FLOAT_LITTLE_ENDIAN: u8 = 4;
const VALUE_BYTES: u32 = 8;

/// Writes the file to an output that has a buffer. Time 0 is that of the scenario; `start` is when that was, since the beginning
/// of 1970. Where a signal has no value it is NaN.
///
/// # Errors
/// The output does not take it.
pub fn write(mut output: impl Write, timeline: &Timeline, start: Duration) -> io::Result<()> {
    let mut signals = vec![
        ("time", "s", &timeline.time_seconds),
        (
            "set_point_millimetres",
            "mm",
            &timeline.set_point_millimetres,
        ),
    ];
    let columns = timeline.columns.iter();
    signals
        .extend(columns.map(|column| (column.name.as_str(), column.unit.as_str(), &column.values)));
    let rows = timeline.time_seconds.len();
    let mut file = Mf4File::new(rows * signals.len() * VALUE_BYTES as usize);
    let mut next = 0;
    for (place, (name, unit, _)) in signals.iter().enumerate().rev() {
        next = file.channel(next, place, name, unit);
    }
    let record_bytes = u32::try_from(signals.len()).unwrap_or(0) * VALUE_BYTES;
    let group = file.channel_group(next, wide(rows), record_bytes);
    let data_group = file.block(b"##DG", &[0, group, wide(DATA_AT), 0], &[0; 8]);
    let nanos = u64::try_from(start.as_nanos()).unwrap_or(0);
    let history = file.history(nanos);
    output.write_all(&file.head(data_group, history, nanos))?;
    // Each row has one number of every signal.
    let mut way = Way::new(wide(rows));
    for row in 0..rows {
        way.go(1);
        for (_, _, values) in &signals {
            output.write_all(&values[row].to_le_bytes())?;
        }
    }
    output.write_all(&file.bytes)
}

/// A file that grows block by block behind its data; a block links to earlier ones only.
struct Mf4File {
    data_bytes: usize,
    bytes: Vec<u8>,
}

impl Mf4File {
    fn new(data_bytes: usize) -> Self {
        Self {
            data_bytes,
            bytes: Vec::new(),
        }
    }

    /// Appends a block; its address.
    fn block(&mut self, name: &[u8; 4], links: &[u64], data: &[u8]) -> u64 {
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        let address = DATA_AT + BLOCK_HEADER_BYTES + self.data_bytes + self.bytes.len();
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

    /// The description of one signal; the first is the time.
    fn channel(&mut self, next: u64, place: usize, name: &str, unit: &str) -> u64 {
        let name = self.text(b"##TX", name);
        let unit = if unit.is_empty() {
            0
        } else {
            self.text(b"##TX", unit)
        };
        let (kind, sync) = if place == 0 {
            (MASTER, TIME)
        } else {
            (FIXED_LENGTH, NO_SYNC)
        };
        let mut data = vec![kind, sync, FLOAT_LITTLE_ENDIAN, 0];
        let offset = u32::try_from(place).unwrap_or(0) * VALUE_BYTES;
        for number in [offset, VALUE_BYTES * 8, 0, 0] {
            data.extend_from_slice(&number.to_le_bytes());
        }
        // Neither precision nor attachments, ranges or limits.
        data.resize(data.len() + 4 + 6 * 8, 0);
        self.block(b"##CN", &[next, 0, name, 0, 0, 0, unit, 0], &data)
    }

    fn channel_group(&mut self, first_channel: u64, rows: u64, record_bytes: u32) -> u64 {
        let mut data = vec![0; 8];
        data.extend_from_slice(&rows.to_le_bytes());
        data.extend_from_slice(&[0; 8]);
        data.extend_from_slice(&record_bytes.to_le_bytes());
        data.extend_from_slice(&[0; 4]);
        self.block(b"##CG", &[0, first_channel, 0, 0, 0, 0], &data)
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

    /// What comes before the data, with the header of their block.
    fn head(&self, data_group: u64, history: u64, nanos: u64) -> Vec<u8> {
        let mut data = nanos.to_le_bytes().to_vec();
        // UTC; no classes, flags, angles or distances.
        data.resize(32, 0);
        let mut head = b"MDF     4.10    canrig  \0\0\0\0".to_vec();
        head.extend_from_slice(&410u16.to_le_bytes());
        head.resize(HEADER_AT, 0);
        head.extend(block(b"##HD", &[data_group, history, 0, 0, 0, 0], &data));
        head.extend(block_header(b"##DT", 0, self.data_bytes));
        head
    }
}

/// What every block begins with.
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

    #[test]
    fn blocks_have_the_lengths_of_the_standard() {
        let mut file = Mf4File::new(16);
        let begin = DATA_AT + BLOCK_HEADER_BYTES + 16;
        let length = |file: &Mf4File, address: u64| {
            let address = usize::try_from(address).unwrap() - begin;
            assert_eq!(address % 8, 0);
            u64::from_le_bytes(file.bytes[address + 8..address + 16].try_into().unwrap())
        };
        let channel = file.channel(0, 1, "a", "");
        assert_eq!(length(&file, channel), 160);
        let group = file.channel_group(0, 5, 16);
        assert_eq!(length(&file, group), 104);
        let history = file.history(0);
        assert_eq!(length(&file, history), 56);
        let head = file.head(0, 0, 0);
        assert_eq!(head.len(), DATA_AT + BLOCK_HEADER_BYTES);
        assert_eq!(
            (&head[64..68], &head[DATA_AT..DATA_AT + 4]),
            (&b"##HD"[..], &b"##DT"[..])
        );
    }
}
