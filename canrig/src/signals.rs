//! The signals of the DBC that the bench itself reads or writes, as `message.signal`.

pub use dbc::SignalMissing;
pub use dbc::scenario_clock::STATUSWORD;

/// Position of the load as the drive measures it.
pub const POSITION: &str = "drive_tpdo1.position_millimetres";
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

/// The messages that only the emulated plant sends.
pub const EMULATED_MESSAGES: [&str; 2] = ["drive_tpdo2", "plant_truth"];

/// The messages whose signals become columns, in this order.
pub const COLUMN_MESSAGES: [&str; 8] = [
    "drive_tpdo1",
    "drive_rpdo1",
    "drive_tpdo2",
    "controller_tpdo1",
    "controller_tpdo2",
    "controller_tpdo3",
    "controller_tpdo4",
    "disturbance_rpdo1",
];
