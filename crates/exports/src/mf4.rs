//! ASAM MDF 4.10: all signals over time, one row a cycle, as floating-point numbers.

use std::time::Duration;

use recording::timeline::Timeline;

/// Where the header block has its place.
const HEADER_AT: usize = 64;
const HEADER_BYTES: usize = 104;

/// Channel types and data types of the standard.
const FIXED_LENGTH: u8 = 0;
const MASTER: u8 = 2;
const NO_SYNC: u8 = 0;
const TIME: u8 = 1;
const FLOAT_LITTLE_ENDIAN: u8 = 4;
const VALUE_BYTES: u32 = 8;

/// The file. Time 0 is that of the scenario; `start` is when that was, since the beginning of 1970. Where a signal has
/// no value it is NaN.
#[must_use]
pub fn to_mf4(timeline: &Timeline, start: Duration) -> Vec<u8> {
    let mut file = Mf4File::new();
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
    let data = file.data(
        &signals
            .iter()
            .map(|signal| signal.2.as_slice())
            .collect::<Vec<_>>(),
    );
    let mut next = 0;
    for (place, (name, unit, _)) in signals.iter().enumerate().rev() {
        next = file.channel(next, place, name, unit);
    }
    let rows = u64::try_from(timeline.time_seconds.len()).unwrap_or(0);
    let record_bytes = u32::try_from(signals.len()).unwrap_or(0) * VALUE_BYTES;
    let group = file.channel_group(next, rows, record_bytes);
    let data_group = file.block(b"##DG", &[0, group, data, 0], &[0; 8]);
    let nanos = u64::try_from(start.as_nanos()).unwrap_or(0);
    let history = file.history(nanos);
    file.finish(data_group, history, nanos)
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
        let channel = file.channel(0, 1, "a", "");
        assert_eq!(length(&file, channel), 160);
        let group = file.channel_group(0, 5, 16);
        assert_eq!(length(&file, group), 104);
        let history = file.history(0);
        assert_eq!(length(&file, history), 56);
        let bytes = file.finish(0, 0, 0);
        assert_eq!(&bytes[64..68], b"##HD");
    }
}
