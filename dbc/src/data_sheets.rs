//! The EDS files of the rig.

/// The controller, node 0x01 (`controller.eds`).
pub const CONTROLLER_EDS: &str = include_str!("../controller.eds");
/// The drive, node 0x10, CiA 402 (`drive.eds`).
pub const DRIVE_EDS: &str = include_str!("../drive.eds");
/// The disturbance node 0x11, CiA 401 (`disturbance.eds`).
pub const DISTURBANCE_EDS: &str = include_str!("../disturbance.eds");

/// Where an emulated drive's TPDOs that hold the truth about its plant say in which cycles they are sent: in every so many,
/// and from which SYNC on.
const TRUTH_EVERY: [&str; 2] = ["[1801sub2]", "[1802sub2]"];
const TRUTH_START: [&str; 2] = ["[1801sub6]", "[1802sub6]"];

/// When a TPDO is sent (CiA 301, 7.5.2.37).
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct TruthPace {
    /// Its transmission type: in every so many cycles, 1 to 240.
    pub every_cycles: u8,
    /// The counter of the first SYNC at which it is; 0 for any.
    pub sync_start: u8,
}

/// An EDS for one node of a rig, with the node's name and number in it, and for a drive when it publishes the truth about its
/// plant.
#[must_use]
pub fn of_node(eds: &str, name: &str, node_id: u8, truth: Option<TruthPace>) -> String {
    let own_default = |section: &str| {
        let truth = truth?;
        let is_in = |places: [&str; 2]| places.contains(&section);
        let every = is_in(TRUTH_EVERY).then_some(truth.every_cycles);
        every.or(is_in(TRUTH_START).then_some(truth.sync_start))
    };
    let mut section = "";
    let mut text = String::with_capacity(eds.len());
    for line in eds.lines() {
        if line.starts_with('[') {
            section = line;
        }
        let is_default = line.starts_with("DefaultValue=");
        match own_default(section).filter(|_| is_default) {
            Some(value) => text += &format!("DefaultValue={value}"),
            None if line.starts_with("FileName=") => text += &format!("FileName={name}.eds"),
            None => text += line,
        }
        text.push('\n');
    }
    // The standard's spelling (CiA 306-1, DCF).
    text + &format!("\n[DeviceComissioning]\nNodeID=0x{node_id:02X}\nNodeName={name}\n")
}

/// Their names, the nodes that they are of, and themselves.
pub(crate) const SHIPPED: [(&str, u8, &str); 3] = [
    ("controller", 0x01, CONTROLLER_EDS),
    ("drive", 0x10, DRIVE_EDS),
    ("disturbance", 0x11, DISTURBANCE_EDS),
];
