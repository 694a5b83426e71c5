//! The rigs that ship: rig files like any other, compiled in as text.

/// The rigs by name, each with its text.
const RIGS: [(&str, &str); 6] = [
    (
        "dc_motor",
        include_str!("../../../../scenarios/rigs/dc_motor.toml"),
    ),
    (
        "four_drives",
        include_str!("../../../../scenarios/rigs/four_drives.toml"),
    ),
    (
        "press",
        include_str!("../../../../scenarios/rigs/press.toml"),
    ),
    (
        "sma_actuator",
        include_str!("../../../../scenarios/rigs/sma_actuator.toml"),
    ),
    (
        "sma_pair",
        include_str!("../../../../scenarios/rigs/sma_pair.toml"),
    ),
    (
        "two_axes",
        include_str!("../../../../scenarios/rigs/two_axes.toml"),
    ),
];

/// Returns the text of the rig of a name.
pub fn text(name: &str) -> Option<&'static str> {
    let mut rigs = RIGS.iter();
    rigs.find(|(rig, _)| *rig == name).map(|(_, text)| *text)
}

/// Returns the names.
pub fn names() -> [&'static str; 6] {
    RIGS.map(|(name, _)| name)
}

/// Folder in a run folder for a rig that does not lie in the scenario's own folder.
pub const FOLDER: &str = "rig";

/// Returns the name, in a run folder, of the copy of a shipped rig, or of a rig file that replaced it.
pub fn copied_name(name: &str) -> String {
    if name.ends_with(".toml") {
        format!("{FOLDER}/{name}")
    } else {
        format!("{FOLDER}/{name}.toml")
    }
}
