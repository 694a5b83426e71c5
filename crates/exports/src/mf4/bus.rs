//! Frames in the standard's bus logging, from which other programs decode signals by `frames.dbc`.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;

use recording::frames::Frames;
use recording::log::Stamped;

use crate::MARKED_ID_BITS;

use super::{BYTES, Channel, Data, Mf4File, Records, UNSIGNED_LITTLE_ENDIAN};

/// Type of a source: a bus, and the kind of the bus.
const BUS: u8 = 2;
const CAN: u8 = 2;
/// Flags of a channel group: raw events of a bus.
const BUS_EVENTS: u16 = 0b110;
/// Flag of a channel: an event of a bus.
const BUS_EVENT: u32 = 1 << 10;

/// Number of the only bus.
const BUS_CHANNEL: u8 = 1;
/// Offset of the frame in a record, after the time.
const FRAME_AT: u32 = 8;
const RECORD_BYTES: u32 = 24;

/// Parts of a frame.
const PARTS: [Channel<'static>; 7] = [
    part("ID", UNSIGNED_LITTLE_ENDIAN, 8, 29),
    Channel {
        bit: 7,
        ..part("IDE", UNSIGNED_LITTLE_ENDIAN, 11, 1)
    },
    part("BusChannel", UNSIGNED_LITTLE_ENDIAN, 12, 8),
    part("DLC", UNSIGNED_LITTLE_ENDIAN, 13, 8),
    part("DataLength", UNSIGNED_LITTLE_ENDIAN, 14, 8),
    part("Dir", UNSIGNED_LITTLE_ENDIAN, 15, 1),
    part("DataBytes", BYTES, 16, 64),
];

/// Returns a part of a frame, from the first bit of a byte on.
const fn part(name: &str, data_type: u8, byte: u32, bits: u32) -> Channel<'_> {
    Channel {
        name,
        unit: "",
        data_type,
        byte,
        bit: 0,
        bits,
        flags: BUS_EVENT,
        parts: 0,
    }
}

/// Kinds of frames, each of which has a group.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Error,
    Remote,
    Data,
}

impl Kind {
    fn of(stamped: &Stamped) -> Self {
        match (stamped.frame.is_error(), stamped.frame.is_remote()) {
            (true, _) => Self::Error,
            (false, true) => Self::Remote,
            (false, false) => Self::Data,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Data => "CAN_DataFrame",
            Self::Remote => "CAN_RemoteFrame",
            Self::Error => "CAN_ErrorFrame",
        }
    }
}

/// Appends one group for each present kind of frame; returns the address of the first.
pub(super) fn groups(file: &mut Mf4File, frames: &Frames) -> u64 {
    let mut counts: BTreeMap<Kind, usize> = BTreeMap::new();
    for stamped in frames.iter() {
        *counts.entry(Kind::of(&stamped)).or_default() += 1;
    }
    let kinds = counts.into_iter();
    kinds.fold(0, |next, (kind, count)| group(file, kind, count, next))
}

fn group(file: &mut Mf4File, kind: Kind, count: usize, next: u64) -> u64 {
    let mut records = Records {
        count,
        bytes: RECORD_BYTES,
        flags: BUS_EVENTS,
        ..Records::default()
    };
    let data = file.data(Data::Frames(kind), &records);
    let first = channels(file, kind.name());
    let path = file.text(b"##TX", "CAN1");
    records.source = file.block(b"##SI", &[path, path, 0], &[BUS, CAN, 0, 0, 0, 0, 0, 0]);
    file.data_group(next, first, data, &records)
}

/// Writes one record for each frame of a kind. Times are of the scenario, which began at `zero` on the clock of the frames.
pub(super) fn write_records(
    output: &mut impl Write,
    frames: &Frames,
    kind: Kind,
    zero: Duration,
) -> io::Result<()> {
    let is_of_kind = |stamped: &Stamped| Kind::of(stamped) == kind;
    for Stamped { time, frame, .. } in frames.iter().filter(is_of_kind) {
        let seconds = time.as_secs_f64() - zero.as_secs_f64();
        output.write_all(&seconds.to_le_bytes())?;
        let id = frame.raw_id() & MARKED_ID_BITS;
        output.write_all(&id.to_le_bytes())?;
        let length = frame.length();
        // Direction: received, like all frames of the recorder.
        output.write_all(&[BUS_CHANNEL, length, length, 0])?;
        output.write_all(&frame.buffer())?;
    }
    Ok(())
}

/// Appends the time, and a frame that is made of its parts.
fn channels(file: &mut Mf4File, name: &str) -> u64 {
    let names = PARTS.map(|part| format!("{name}.{}", part.name));
    let named = PARTS.into_iter().zip(&names);
    let parts = named.map(|(part, name)| Channel { name, ..part });
    let frame = Channel {
        name,
        data_type: BYTES,
        byte: FRAME_AT,
        bits: (RECORD_BYTES - FRAME_AT) * 8,
        flags: BUS_EVENT,
        parts: file.fixed_channels(&Vec::from_iter(parts)),
        ..Channel::default()
    };
    file.channels(&[Channel::float("time", "s", 0), frame])
}
