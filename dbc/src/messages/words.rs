//! Words whose bits have meanings of their own: statusword and controlword of a drive.
//!
//! [`word`] maps an object's index to the signals of the object's bits. `compose` calls it for each object that a PDO maps.

use canopen::cia402::{CONTROLWORD, Command, STATUSWORD, State};

use crate::coding::{Coding, Kind, Range};
use crate::database::Signal;

/// Values of statusword bits 0 to 6, which hold the state; bit 4 (voltage enabled) does not affect the state.
const STATES: std::ops::Range<u16> = 0..0x80;
/// Values of the bits that hold the command.
const COMMANDS: std::ops::Range<u16> = 0..0x10;

/// Bits of a word, from the first one on.
struct Bits {
    name: &'static str,
    start: u8,
    length: u8,
    labels: fn() -> Vec<(i64, String)>,
    comment: &'static str,
}

const STATUS_BITS: [Bits; 8] = [
    Bits {
        name: "statusword_state",
        start: 0,
        length: 7,
        labels: states,
        comment: "State of the CiA 402 state machine; bit 4 (voltage enabled) does not matter, bit 5 is 0 during a quick stop.",
    },
    flag("statusword_warning", 7, "A warning is present."),
    plain("statusword_bit_8", 8, 1, "Manufacturer-specific, not used."),
    flag("statusword_remote", 9, "The controlword is processed."),
    flag(
        "statusword_target_reached",
        10,
        "Reserved in cyclic synchronous torque mode; 1 when a halt or quick stop has brought the output to 0.",
    ),
    flag(
        "statusword_internal_limit_active",
        11,
        "The output of the amplifier was limited.",
    ),
    flag(
        "statusword_follows_command",
        12,
        "Bit 12 in cyclic synchronous torque mode: the drive follows the target torque.",
    ),
    plain(
        "statusword_bits_13_to_15",
        13,
        3,
        "Bit 13 mode-specific, bits 14 and 15 manufacturer-specific; not used.",
    ),
];

const CONTROL_BITS: [Bits; 5] = [
    Bits {
        name: "controlword_command",
        start: 0,
        length: 4,
        labels: commands,
        comment: "Bits 0 to 3: command to the CiA 402 state machine.",
    },
    plain(
        "controlword_bits_4_to_6",
        4,
        3,
        "Mode-specific, reserved in cyclic synchronous torque mode.",
    ),
    flag(
        "controlword_fault_reset",
        7,
        "A rising edge resets a fault.",
    ),
    flag("controlword_halt", 8, "Halt."),
    plain(
        "controlword_bits_9_to_15",
        9,
        7,
        "Reserved and manufacturer-specific, not used.",
    ),
];

/// Words by their index.
const WORDS: [(u16, &[Bits]); 2] = [(STATUSWORD, &STATUS_BITS), (CONTROLWORD, &CONTROL_BITS)];

const fn flag(name: &'static str, start: u8, comment: &'static str) -> Bits {
    Bits {
        name,
        start,
        length: 1,
        labels: yes_or_no,
        comment,
    }
}

const fn plain(name: &'static str, start: u8, length: u8, comment: &'static str) -> Bits {
    Bits {
        name,
        start,
        length,
        labels: Vec::new,
        comment,
    }
}

/// Returns the signals of a word; `None` for an object whose bits have no meaning of their own.
pub fn word(index: u16) -> Option<Vec<Signal>> {
    let (_, bits) = WORDS.iter().find(|(word, _)| *word == index)?;
    let signals = bits.iter().map(|bits| {
        let highest = (1_u32 << bits.length) - 1;
        let range = Range {
            minimum: 0.0,
            maximum: highest.into(),
        };
        let coding =
            Coding::little_endian(bits.start, bits.length, Kind::Unsigned, 1.0, Some(range));
        Signal {
            labels: (bits.labels)(),
            ..Signal::new(bits.name.to_owned(), "", bits.comment, coding)
        }
    });
    Some(signals.collect())
}

/// Returns the labels of a bit.
pub fn yes_or_no() -> Vec<(i64, String)> {
    to_labels([(0, "no"), (1, "yes")])
}

/// Returns labels from their texts.
pub(crate) fn to_labels<'a>(
    labels: impl IntoIterator<Item = (i64, &'a str)>,
) -> Vec<(i64, String)> {
    let labels = labels.into_iter();
    labels
        .map(|(value, text)| (value, text.to_owned()))
        .collect()
}

fn states() -> Vec<(i64, String)> {
    let state = |bits: u16| Some((bits.into(), state_text(State::from_statusword(bits)?)));
    to_labels(STATES.filter_map(state))
}

/// Returns the name of a state (CiA 402-2, figure 6).
fn state_text(state: State) -> &'static str {
    match state {
        State::NotReadyToSwitchOn => "not ready to switch on",
        State::SwitchOnDisabled => "switch on disabled",
        State::ReadyToSwitchOn => "ready to switch on",
        State::SwitchedOn => "switched on",
        State::OperationEnabled => "operation enabled",
        State::QuickStopActive => "quick stop active",
        State::FaultReactionActive => "fault reaction active",
        State::Fault => "fault",
    }
}

fn commands() -> Vec<(i64, String)> {
    let command = |bits: u16| (bits.into(), command_text(Command::decode(bits)));
    to_labels(COMMANDS.map(command))
}

/// Returns the name of a command (CiA 402-2, table 27).
fn command_text(command: Command) -> &'static str {
    match command {
        Command::Shutdown => "shutdown",
        Command::SwitchOn => "switch on, disable operation",
        Command::EnableOperation => "enable operation",
        Command::DisableVoltage => "disable voltage",
        Command::QuickStop => "quick stop",
        Command::FaultReset => "fault reset",
    }
}
