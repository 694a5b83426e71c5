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

/// Where an emulated drive says in which unit its positions are.
const SI_UNIT_POSITION: &str = "[60A8]";
/// What the shipped data sheet says of that in words.
const MICROMETRES: &str = "Positions count micrometres (0x60A8).";

/// What of a drive's data sheet is the rig's.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct OfDrive {
    /// When it publishes the truth about its plant.
    pub truth: TruthPace,
    /// The unit of its positions (0x60A8, CiA 303-2), with its word, where it is another than the micrometre.
    pub si_position: Option<(u32, String)>,
}

/// An EDS for one node of a rig, with the node's name and number in it, and for a drive when it publishes the truth about its
/// plant, and in which unit it measures.
#[must_use]
pub fn of_node(eds: &str, name: &str, node_id: u8, drive: Option<&OfDrive>) -> String {
    let si_position = drive.and_then(|drive| drive.si_position.as_ref());
    let own_default = |section: &str| {
        let truth = drive?.truth;
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
            None if is_default && section == SI_UNIT_POSITION && si_position.is_some() => {
                let code = si_position.map_or(0, |(code, _)| *code);
                text += &format!("DefaultValue=0x{code:08X}");
            }
            None if line.ends_with(MICROMETRES) && si_position.is_some() => {
                let unit = si_position.map_or("", |(_, unit)| unit.as_str());
                let words = format!("Positions are in {unit} as 0x60A8 says.");
                text += &line.replace(MICROMETRES, &words);
            }
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
