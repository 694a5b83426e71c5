//! The EDS files of the rig.

/// The controller, node 0x01 (`controller.eds`).
pub const CONTROLLER_EDS: &str = include_str!("../controller.eds");
/// The drive, node 0x10, CiA 402 (`drive.eds`).
pub const DRIVE_EDS: &str = include_str!("../drive.eds");
/// The disturbance node 0x11, CiA 401 (`disturbance.eds`).
pub const DISTURBANCE_EDS: &str = include_str!("../disturbance.eds");

/// Their names, the nodes that they are of, and themselves.
pub(crate) const SHIPPED: [(&str, u8, &str); 3] = [
    ("controller", 0x01, CONTROLLER_EDS),
    ("drive", 0x10, DRIVE_EDS),
    ("disturbance", 0x11, DISTURBANCE_EDS),
];
