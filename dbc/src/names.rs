//! The names of messages and signals that the bench itself reads or writes.
//!
//! A message is named by its node and its service, the terms of a law by controller and loop. Names are built here and looked up
//! as a whole.

use crate::{Database, Message, SignalHandle, SignalMissing};

/// Name of canrig's own node.
pub const BENCH: &str = "bench";
/// Set-point of a loop, in millimetres.
pub const SET_POINT: &str = "set_point_millimetres";
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
pub const OF_CONTROLLER: [&str; 4] = [EMERGENCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT];
/// The messages of an io node.
pub const OF_IO: [&str; 5] = [EMERGENCY, RPDO1, SDO_ANSWER, SDO_REQUEST, HEARTBEAT];
/// Messages of a drive, including those of an emulated one.
pub const OF_DRIVE: [&str; 11] = [
    EMERGENCY,
    TPDO1,
    RPDO1,
    TPDO2,
    TPDO3,
    SDO_ANSWER,
    SDO_REQUEST,
    SDO2_REQUEST,
    SDO2_ANSWER,
    TRUTH,
    HEARTBEAT,
];
/// Largest number of TPDOs for the terms of a law.
pub const TERMS_MAX: usize = 4;
/// SYNC.
pub const SYNC: &str = "sync";

/// State bits of a drive's statusword.
pub const STATUSWORD: &str = "statusword_state";
/// Position that a drive measures, in millimetres.
pub const POSITION: &str = "position_millimetres";
/// Position before the sensor, in millimetres.
pub const TRUE_POSITION: &str = "true_position_millimetres";
/// Current that a drive measures.
pub const CURRENT: &str = "current_amperes";
/// Current that the controller commands.
pub const TARGET_CURRENT: &str = "target_current_amperes";
/// Current that really flows, in the report of an emulated plant about itself.
pub const PLANT_CURRENT: &str = "plant_current_amperes";
/// State of a node, in its heartbeat.
pub const NMT_STATE: &str = "nmt_state";
/// Factor on the convection coefficient, an output of an io node.
pub const CONVECTION_FACTOR: &str = "convection_factor";
/// Mass added to the load, an output of an io node.
pub const ADDED_LOAD: &str = "added_load_grams";
/// Temperature of the SMA actuator's wire.
pub const WIRE_TEMPERATURE: &str = "wire_temperature_celsius";

/// Returns the name of a message of a node.
#[must_use]
pub fn message(node: &str, service: &str) -> String {
    format!("{node}_{service}")
}

/// Returns the name of a message with terms of the law of a loop, by its place from 0; the loop's name is empty if it is the only
/// one.
#[must_use]
pub fn terms(controller: &str, loop_name: &str, place: usize) -> String {
    let number = place + 1;
    match loop_name {
        "" => format!("{controller}_tpdo{number}"),
        name => format!("{controller}_{name}_tpdo{number}"),
    }
}

/// Returns the name of the message with the set-point of a loop; the loop's name is empty if it is the only one.
#[must_use]
pub fn set_point(loop_name: &str) -> String {
    match loop_name {
        "" => "bench_set_point".to_owned(),
        name => format!("bench_{name}_set_point"),
    }
}

impl Database {
    /// Returns a signal of a message, both by name.
    ///
    /// # Errors
    /// The signal does not exist.
    pub fn signal_of(&self, message: &str, signal: &str) -> Result<SignalHandle, SignalMissing> {
        self.require(&format!("{message}.{signal}"))
    }

    /// Returns the messages in which a drive publishes its plant's own signals.
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
