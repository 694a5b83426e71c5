//! The names of messages and signals that the bench itself reads or writes.
//!
//! A message is named by its node and its service, the terms of a law by controller and loop. Names are built here and looked up
//! as a whole. A signal whose name follows from the quantities of a loop has a pattern, such as `{signal}_{unit}`, which the loop
//! fills.

use crate::{Database, Message, SignalHandle, SignalMissing};

/// Name of canrig's own node.
pub const BENCH: &str = "bench";
/// Set-point of a loop.
pub const SET_POINT: &str = "set_point_{unit}";
/// Emergencies of a node.
pub const EMERGENCY: &str = "emergency";
/// Heartbeats of a node.
pub const HEARTBEAT: &str = "heartbeat";
/// Answers of an SDO server.
pub const SDO_ANSWER: &str = "sdo_answer";
/// Requests to an SDO server.
pub const SDO_REQUEST: &str = "sdo_request";
/// Requests on the second channel of a drive, and its answers.
pub const SDO2_REQUEST: &str = "sdo2_request";
/// As [`SDO2_REQUEST`].
pub const SDO2_ANSWER: &str = "sdo2_answer";
/// Feedback of a drive: statusword, position, current.
pub const TPDO1: &str = "tpdo1";
/// Commands to a drive, outputs of an io node.
pub const RPDO1: &str = "rpdo1";
/// Signals of the plant of an emulated drive that come before its true position.
pub const TPDO2: &str = "tpdo2";
/// The other signals of that plant; a plant with two or fewer has no such message.
pub const TPDO3: &str = "tpdo3";
/// The report of an emulated plant about itself, in scenarios with faults.
pub const TRUTH: &str = "truth";
/// The messages of a controller, other than those of its laws.
pub const CONTROLLER_SERVICES: [&str; 4] = [EMERGENCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT];
/// The messages of an io node.
pub const IO_SERVICES: [&str; 5] = [EMERGENCY, RPDO1, SDO_ANSWER, SDO_REQUEST, HEARTBEAT];
/// Messages in which an emulated drive publishes the truth about its plant.
pub const PLANT_SERVICES: [&str; 3] = [TPDO2, TPDO3, TRUTH];
/// Services with their function codes (CiA 301, 7.3.5), in the order in which a node's messages are added. An emulated drive has
/// a message for each.
pub const SERVICES: [(&str, u32); 11] = [
    (EMERGENCY, 0x080),
    (TPDO1, 0x180),
    (RPDO1, 0x200),
    (TPDO2, 0x280),
    (TPDO3, 0x380),
    (SDO_ANSWER, 0x580),
    (SDO_REQUEST, 0x600),
    (SDO2_REQUEST, 0x680),
    (SDO2_ANSWER, 0x6C0),
    (TRUTH, 0x6A0),
    (HEARTBEAT, 0x700),
];
/// Largest number of TPDOs for the terms of a law.
pub const TERMS_MAX: usize = 4;
/// SYNC.
pub const SYNC: &str = "sync";
/// Message with the NMT commands.
pub const NMT_COMMAND: &str = "nmt_command";

/// State bits of a drive's statusword.
pub const STATUSWORD: &str = "statusword_state";
/// Bits 0 to 3 of the controlword: the command to the drive's state machine.
pub const CONTROLWORD: &str = "controlword_command";
/// Position that a drive measures.
pub const POSITION: &str = "{signal}_{unit}";
/// Position before the sensor.
pub const TRUE_POSITION: &str = "true_{signal}_{unit}";
/// Output of its amplifier that a drive measures.
pub const OUTPUT: &str = "{command}_{command_unit}";
/// Command to a drive.
pub const TARGET: &str = "target_{command}_{command_unit}";
/// Output of the amplifier that really acts, in the report of an emulated plant about itself.
pub const PLANT_OUTPUT: &str = "plant_{command}_{command_unit}";
/// State of a node, in its heartbeat.
pub const NMT_STATE: &str = "nmt_state";
/// Names of what the drive of the shipped DBC measures and commands.
pub(crate) const SHIPPED_SIGNAL: &str = "position";
pub(crate) const SHIPPED_COMMAND: &str = "current";
/// Signal of an EMCY with the bytes of the maker.
pub const MANUFACTURER_ERROR: &str = "manufacturer_error";
/// Factor on the convection coefficient, an output of an io node.
pub const CONVECTION_FACTOR: &str = "convection_factor";
/// Mass added to the load, an output of an io node.
pub const ADDED_LOAD: &str = "added_load_grams";
/// Temperature of the SMA actuator's wire.
pub const WIRE_TEMPERATURE: &str = "wire_temperature_celsius";

/// Rule of [`is_name`], in words.
pub const NAME_RULE: &str = "up to 64 small letters, digits and underscores, a letter first";
/// Pattern of [`is_name`].
pub const NAME_PATTERN: &str = "^[a-z][a-z0-9_]{0,63}$";
const NAME_CHARACTERS_MAX: usize = 64;

/// Names of the shipped DBC that follow from the quantities of its loop.
const SHIPPED: [(&str, &str); 5] = [
    ("position_millimetres", POSITION),
    ("true_position_millimetres", TRUE_POSITION),
    ("current_amperes", OUTPUT),
    ("target_current_amperes", TARGET),
    ("plant_current_amperes", PLANT_OUTPUT),
];

/// Checks whether a text can be the name of a signal, a node or a table: small letters, digits and underscores, a letter first.
pub fn is_name(text: &str) -> bool {
    let is_part = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
    text.len() <= NAME_CHARACTERS_MAX
        && text.starts_with(|first: char| first.is_ascii_lowercase())
        && text.bytes().all(is_part)
}

/// Returns the pattern of a name of the shipped DBC; `None` if the name is the same in each loop.
pub fn pattern(shipped: &str) -> Option<&'static str> {
    let mut names = SHIPPED.into_iter();
    names.find_map(|(name, pattern)| (name == shipped).then_some(pattern))
}

/// Returns the name of a message of a node.
pub fn message(node: &str, service: &str) -> String {
    format!("{node}_{service}")
}

/// Returns the name of a message with terms of the law of a loop, by its place from 0; the loop's name is empty if it is the only
/// one.
pub fn terms(controller: &str, loop_name: &str, place: usize) -> String {
    let number = place + 1;
    match loop_name {
        "" => format!("{controller}_tpdo{number}"),
        name => format!("{controller}_{name}_tpdo{number}"),
    }
}

/// Returns the name of the message with the set-point of a loop; the loop's name is empty if it is the only one.
pub fn set_point(loop_name: &str) -> String {
    match loop_name {
        "" => "bench_set_point".to_owned(),
        name => format!("bench_{name}_set_point"),
    }
}

impl Database {
    /// Returns what the frames with an identifier are, for the user: `SYNC`, `NMT`, or the name of their message.
    pub fn purpose(&self, identifier: u16) -> &str {
        let raw_id = u32::from(identifier);
        let mut messages = self.messages().iter();
        let message = messages.find(|message| message.raw_id == raw_id);
        match message.map(|message| message.name.as_str()) {
            Some(SYNC) => "SYNC",
            Some(NMT_COMMAND) => "NMT",
            Some(name) => name,
            None => "of no message",
        }
    }

    /// Returns a signal of a message, both by name.
    ///
    /// # Errors
    /// The signal does not exist.
    pub fn signal_of(&self, message: &str, signal: &str) -> Result<SignalHandle, SignalMissing> {
        self.require(&format!("{message}.{signal}"))
    }

    /// Returns the messages in which a drive publishes the signals of its plant.
    pub fn plant_messages(&self, drive: &str) -> impl Iterator<Item = &Message> {
        let names = [TPDO2, TPDO3].map(|service| message(drive, service));
        names.into_iter().filter_map(|name| self.message(&name))
    }

    /// Returns the messages with the terms of the law of a loop.
    pub fn term_messages(
        &self,
        controller: &str,
        loop_name: &str,
    ) -> impl Iterator<Item = &Message> {
        let places = 0..TERMS_MAX;
        let names = places.map(|place| terms(controller, loop_name, place));
        Vec::from_iter(names.filter_map(|name| self.message(&name))).into_iter()
    }
}
