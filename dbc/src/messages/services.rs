//! Messages other than PDOs: emergencies, SDO channels, heartbeats, NMT, SYNC, the truth about an emulated plant, and set-points.
//!
//! The caller gives sender, receivers, identifier and rig-dependent names; labels and descriptions are here. Whoever composes a
//! bus calls these functions beside `compose`.

use super::Heading;
use super::words::to_labels;
use crate::coding::{Coding, Kind, Range};
use crate::database::{Message, Signal};
use crate::names::{MANUFACTURER_ERROR, NMT_STATE};
use crate::quantity::{Quantities, Quantity};

/// Identifier of SYNC and of NMT commands (CiA 301, 7.3.5).
const SYNC_IDENTIFIER: u32 = 0x080;
const NMT_IDENTIFIER: u32 = 0x000;
/// Quantity whose range the emergency causes call "the travel".
const POSITION: &str = "position";

/// Error codes that nodes of this bus send (CiA 301, table 26; CiA 402-2).
const ERROR_CODES: [(u16, &str); 17] = [
    (0x0000, "no error"),
    (0x1000, "generic error"),
    (0x2310, "continuous overcurrent"),
    (0x2350, "load level fault (I2t)"),
    (0x5000, "device hardware"),
    (0x6100, "internal software"),
    (0x7300, "sensor"),
    (0x8100, "communication"),
    (0x8110, "CAN overrun"),
    (0x8120, "CAN in error passive mode"),
    (0x8130, "heartbeat error"),
    (0x8140, "recovered from bus off"),
    (0x8150, "CAN-ID collision"),
    (0x8210, "PDO not processed due to length error"),
    (0x8220, "PDO length exceeded"),
    (0x8240, "unexpected SYNC data length"),
    (0x8250, "RPDO timeout"),
];
const NMT_COMMANDS: [(i64, &str); 5] = [
    (1, "start"),
    (2, "stop"),
    (128, "enter pre-operational"),
    (129, "reset node"),
    (130, "reset communication"),
];
const NMT_STATES: [(i64, &str); 4] = [
    (0, "boot-up"),
    (4, "stopped"),
    (5, "operational"),
    (127, "pre-operational"),
];
/// Command bytes of SDO requests and answers (CiA 301, 7.2.4.3).
const REQUESTS: [(i64, &str); 12] = [
    (0x00, "download segment, toggle 0"),
    (0x10, "download segment, toggle 1"),
    (0x21, "initiate segmented download"),
    (0x22, "expedited download, size not given"),
    (0x23, "expedited download, 4 bytes"),
    (0x27, "expedited download, 3 bytes"),
    (0x2B, "expedited download, 2 bytes"),
    (0x2F, "expedited download, 1 byte"),
    (0x40, "initiate upload"),
    (0x60, "upload segment, toggle 0"),
    (0x70, "upload segment, toggle 1"),
    (0x80, "abort"),
];
const ANSWERS: [(i64, &str); 10] = [
    (0x20, "download segment done, toggle 0"),
    (0x30, "download segment done, toggle 1"),
    (0x41, "initiate segmented upload"),
    (0x42, "expedited upload, size not given"),
    (0x43, "expedited upload, 4 bytes"),
    (0x47, "expedited upload, 3 bytes"),
    (0x4B, "expedited upload, 2 bytes"),
    (0x4F, "expedited upload, 1 byte"),
    (0x60, "download done"),
    (0x80, "abort"),
];

/// Returns a field of an unsigned number over all its values.
fn unsigned(name: &str, start_bit: u8, length_bits: u8, comment: &str) -> Signal {
    let highest = (1_u64 << length_bits) - 1;
    unsigned_within(
        name,
        (start_bit, length_bits),
        [0.0, highest as f64],
        comment,
    )
}

/// Returns a field of an unsigned number within a range.
fn unsigned_within(
    name: &str,
    (start_bit, length_bits): (u8, u8),
    [minimum, maximum]: [f64; 2],
    comment: &str,
) -> Signal {
    let range = Some(Range { minimum, maximum });
    let coding = Coding::little_endian(start_bit, length_bits, Kind::Unsigned, 1.0, range);
    Signal::new(name.to_owned(), "", comment, coding)
}

/// Composes the NMT commands, with the names of the nodes by node-ID.
pub fn nmt_command<'a>(
    heading: Heading,
    nodes: impl IntoIterator<Item = (u8, &'a str)>,
) -> Message {
    let all = [(0, "all nodes")].into_iter();
    let nodes = nodes.into_iter().map(|(id, name)| (i64::from(id), name));
    let mut nodes = to_labels(all.chain(nodes));
    nodes.sort();
    nodes.dedup_by_key(|(id, _)| *id);
    let comment = "Node that shall obey; 0 is every node.";
    let signals = vec![
        Signal {
            labels: to_labels(NMT_COMMANDS),
            ..unsigned("nmt_command", 0, 8, "Command specifier.")
        },
        Signal {
            labels: nodes,
            ..unsigned_within("nmt_node_id", (8, 8), [0.0, 127.0], comment)
        },
    ];
    heading.message(NMT_IDENTIFIER, 2, signals)
}

/// Composes SYNC with its counter.
pub fn sync(heading: Heading, period_milliseconds: u64) -> Message {
    let comment = "Counts from 1 to 240, then again from 1.";
    let counter = unsigned_within("sync_counter", (0, 8), [1.0, 240.0], comment);
    Message {
        cycle_time_milliseconds: period_milliseconds,
        ..heading.message(SYNC_IDENTIFIER, 1, vec![counter])
    }
}

/// Composes the emergencies of a node. A drive's error code is an object, too (0x603F). `causes` are the labels of the
/// manufacturer-specific error field.
pub fn emergency(
    heading: Heading,
    identifier: u32,
    is_drive: bool,
    causes: Vec<(i64, String)>,
) -> Message {
    let codes = ERROR_CODES.map(|(code, text)| (i64::from(code), text));
    let object = |address: &str| address.to_owned();
    let signals = vec![
        Signal {
            labels: to_labels(codes),
            object: if is_drive {
                object("0x603F:00")
            } else {
                String::new()
            },
            ..unsigned(
                "error_code",
                0,
                16,
                "Error code (CiA 301, table 26; CiA 402-2).",
            )
        },
        Signal {
            object: object("0x1001:00"),
            ..unsigned(
                "error_register",
                16,
                8,
                "Bits: 0 generic, 1 current, 2 voltage, 3 temperature, 4 communication, 5 device profile, 7 manufacturer.",
            )
        },
        Signal {
            labels: causes,
            ..unsigned(
                MANUFACTURER_ERROR,
                24,
                40,
                "Manufacturer-specific part, little-endian.",
            )
        },
    ];
    heading.message(identifier, 8, signals)
}

/// Returns the causes for which the controller gives up, for a drive with these quantities. The second byte is the cause.
fn causes(of: &Quantities) -> Vec<(i64, String)> {
    let (measured, commanded) = (&of.feedback.name, &of.output.name);
    let place = if measured == POSITION {
        "the travel"
    } else {
        "its range"
    };
    let texts = [
        format!("no {measured} from the drive"),
        format!("{measured} outside {place}"),
        format!("{measured} changes faster than the plant moves"),
        format!("{measured} stands still under a large {commanded}"),
        "the drive left operation enabled".to_owned(),
        "the drive reports an emergency".to_owned(),
        "the drive left NMT state operational".to_owned(),
        "ordered to another NMT state".to_owned(),
        "the drive could not be brought up".to_owned(),
        "a limit of the rig is violated".to_owned(),
        "the law failed".to_owned(),
    ];
    let numbers = (1..).map(|number: i64| number << 8);
    numbers.zip(texts).collect()
}

/// Returns the causes for which the controller of these drives gives up: each drive has a name, a node-ID and quantities. With
/// several drives each drive has separate causes, with the drive's node-ID in the lowest byte.
pub fn causes_at(drives: &[(&str, u8, Quantities)]) -> Vec<(i64, String)> {
    if let [(_, _, only)] = drives {
        return causes(only);
    }
    let mut all = causes(&Quantities::default());
    for (name, id, quantities) in drives {
        let own = causes(quantities).into_iter();
        all.extend(own.map(|(cause, text)| (cause | i64::from(*id), format!("{text} ({name})"))));
    }
    all
}

/// Composes requests to an SDO server, or its answers.
pub fn sdo(heading: Heading, identifier: u32, is_request: bool) -> Message {
    let commands = if is_request {
        to_labels(REQUESTS)
    } else {
        to_labels(ANSWERS)
    };
    let signals = vec![
        Signal {
            labels: commands,
            ..unsigned("command", 0, 8, "Command byte (CiA 301, 7.2.4.3).")
        },
        unsigned(
            "object_index",
            8,
            16,
            "Index of the object; not in segments and blocks, whose bytes 1 to 7 are data.",
        ),
        unsigned(
            "object_sub_index",
            24,
            8,
            "Sub-index of the object; not in segments and blocks.",
        ),
        unsigned(
            "data_bytes",
            32,
            32,
            "Data, size or abort code, little-endian.",
        ),
    ];
    heading.message(identifier, 8, signals)
}

/// Composes boot-up and heartbeats of a node.
pub fn heartbeat(heading: Heading, identifier: u32, period_milliseconds: u64) -> Message {
    let state = Signal {
        labels: to_labels(NMT_STATES),
        ..unsigned(NMT_STATE, 0, 8, "NMT state; 0 once, at boot-up.")
    };
    Message {
        cycle_time_milliseconds: period_milliseconds,
        ..heading.message(identifier, 1, vec![state])
    }
}

/// Time between two messages with the truth about a plant.
const TRUTH_MILLISECONDS: u64 = 10;

/// Composes the truth about the plant of an emulated drive, whose amplifier gives this `output`.
pub fn truth(heading: Heading, identifier: u32, output: Signal) -> Message {
    let celsius = Range {
        minimum: -273.15,
        maximum: 327.67,
    };
    let celsius = Coding::little_endian(16, 16, Kind::Signed, 0.01, Some(celsius));
    let seconds = Range {
        minimum: 0.0,
        maximum: 429_496.729_5,
    };
    let seconds = Coding::little_endian(32, 32, Kind::Unsigned, 1e-4, Some(seconds));
    let signals = vec![
        output,
        Signal::new(
            "plant_peak_temperature_celsius".to_owned(),
            "degC",
            "Highest temperature of the heated part since the message before.",
            celsius,
        ),
        Signal::new(
            "plant_time_seconds".to_owned(),
            "s",
            "When, on the emulator's clock: a full bus may carry the message later.",
            seconds,
        ),
    ];
    Message {
        cycle_time_milliseconds: TRUTH_MILLISECONDS,
        ..heading.message(identifier, 8, signals)
    }
}

/// Composes the set-point of a loop and its first derivative.
pub fn set_point(heading: Heading, identifier: u32, of: &Quantity, name: &str) -> Message {
    let symbol = of.unit.symbol();
    let float = |name: String, unit: &str, start_bit, comment: &str| {
        let coding = Coding::little_endian(start_bit, 32, Kind::Float32, 1.0, None);
        Signal::new(name, unit, comment, coding)
    };
    let rate = format!("{name}_per_second");
    let signals = vec![
        float(name.to_owned(), symbol, 0, "Set-point."),
        float(rate, &format!("{symbol}/s"), 32, "Its first derivative."),
    ];
    heading.message(identifier, 8, signals)
}
