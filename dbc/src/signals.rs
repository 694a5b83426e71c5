//! The signals of the DBC that the bench itself reads or writes, as `message.signal`.

use crate::{Database, Signal, SignalHandle, SignalMissing};

pub use crate::scenario_clock::STATUSWORD;

/// Position of the load as the drive measures it, in millimetres; [`Database::position`] finds it in any unit.
pub const POSITION: &str = "drive_tpdo1.position_millimetres";
/// The name of a position before its unit.
const POSITION_IN: &str = "position_";
/// Current through the wire as the drive measures it.
pub const CURRENT: &str = "drive_tpdo1.current_amperes";
/// Current that the controller asks for.
pub const TARGET_CURRENT: &str = "drive_rpdo1.target_current_amperes";
/// State of the disturbance node, in its heartbeat.
pub const FAN_STATE: &str = "disturbance_heartbeat.nmt_state";
/// Commands to the disturbance node.
pub const DISTURBANCE_MESSAGE: &str = "disturbance_rpdo1";
/// Factor on the convection coefficient, to the disturbance node.
pub const CONVECTION_FACTOR: &str = "disturbance_rpdo1.convection_factor";
/// Mass added to the load, to the disturbance node.
pub const ADDED_LOAD: &str = "disturbance_rpdo1.added_load_grams";

/// Signals of the emulated plant that stand before the true position.
pub const PLANT_SIGNALS: &str = "drive_tpdo2";
/// The emulated plant's other signals; a plant with two or fewer has no such message.
pub const OTHER_PLANT_SIGNALS: &str = "drive_tpdo3";
/// Position of the load before the sensor.
pub const TRUE_POSITION: &str = "true_position_millimetres";
/// Its name before the unit.
const TRUE_POSITION_IN: &str = "true_position_";
/// Temperature of the SMA actuator's wire, by which its frames differ from those of other plants.
pub const WIRE_TEMPERATURE: &str = "wire_temperature_celsius";

/// The messages whose signals become columns, in this order.
pub const COLUMN_MESSAGES: [&str; 9] = [
    "drive_tpdo1",
    "drive_rpdo1",
    PLANT_SIGNALS,
    OTHER_PLANT_SIGNALS,
    "controller_tpdo1",
    "controller_tpdo2",
    "controller_tpdo3",
    "controller_tpdo4",
    "disturbance_rpdo1",
];

/// Messages that not every rig has: a plant or a law with few signals of its own needs fewer.
pub const OPTIONAL_MESSAGES: [&str; 5] = [
    OTHER_PLANT_SIGNALS,
    "controller_tpdo1",
    "controller_tpdo2",
    "controller_tpdo3",
    "controller_tpdo4",
];

/// What only an emulated plant publishes; a real drive knows none of it, and may use the identifiers for something else.
pub const TRUTH_MESSAGES: [&str; 3] = [PLANT_SIGNALS, OTHER_PLANT_SIGNALS, "plant_truth"];

impl Database {
    /// The position that the drive measures, in whatever unit.
    ///
    /// # Errors
    /// There is none.
    pub fn position(&self) -> Result<SignalHandle, SignalMissing> {
        let (message, _) = POSITION.split_once('.').unwrap_or_default();
        let position = self.message(message).and_then(|message| {
            let mut signals = message.signals.iter();
            let position = signals.find(|signal| signal.name.starts_with(POSITION_IN));
            position.map(|position| message.handle(position))
        });
        position.ok_or_else(|| SignalMissing::new(POSITION))
    }
}

/// The emulated plant's own signals, which no real drive measures: the columns of its messages less the true position.
pub fn plant_signals(database: &Database) -> impl Iterator<Item = &Signal> {
    let messages = [PLANT_SIGNALS, OTHER_PLANT_SIGNALS]
        .into_iter()
        .filter_map(|name| database.message(name));
    let signals = messages.flat_map(|message| &message.signals);
    signals.filter(|signal| !signal.name.starts_with(TRUE_POSITION_IN))
}

/// Messages that hold the terms of a law, in this order.
pub const LAW_MESSAGES: [&str; 4] = [
    "controller_tpdo1",
    "controller_tpdo2",
    "controller_tpdo3",
    "controller_tpdo4",
];

/// The terms of the law.
pub fn law_signals(database: &Database) -> impl Iterator<Item = &Signal> {
    let messages = LAW_MESSAGES.into_iter();
    messages
        .filter_map(|name| database.message(name))
        .flat_map(|message| &message.signals)
}
