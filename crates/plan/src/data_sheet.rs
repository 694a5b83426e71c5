//! The data sheets (EDS) that the bench knows: those of the rig, and those that the user names.

use std::path::Path;

use canopen::eds::IDENTITY;
use canopen::object_dictionary::Entry;
use canopen::{ObjectDictionary, eds};
use scenario::rig::nodes::CONTROLLER_NODE_ID;
use scenario::rig::object_address;

/// Longest file that a user names, other than scenarios and recordings.
pub const FILE_BYTES_MAX: u64 = 1 << 20;
/// Second SDO server channel.
const SECOND_CHANNEL: u16 = 0x1201;
/// NMT startup; bit 0 makes a node the NMT manager (CiA 302-2).
const NMT_STARTUP: u16 = 0x1F80;
/// Bit 31 of a COB-ID: the channel does not exist.
const INVALID: u32 = 0x8000_0000;
/// Objects that a message about an ambiguous name lists.
const CANDIDATES_MAX: usize = 8;

/// Reason why a data sheet cannot be used, or why a text of the user names no node or no object.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DataSheetError(pub(crate) String);

/// An EDS, read for one node-ID.
#[derive(Clone, Debug)]
pub struct DataSheet {
    /// Name of the file.
    pub name: String,
    /// Name of the node.
    pub node_name: String,
    /// Node-ID for which it was read.
    pub node_id: u8,
    /// Objects with their defaults.
    pub dictionary: ObjectDictionary,
}

/// Returns the data sheets of the rig.
///
/// # Panics
/// Never: tests read the files that are compiled in.
pub fn rig_data_sheets() -> Vec<DataSheet> {
    let shipped = [
        ("controller", CONTROLLER_NODE_ID, dbc::CONTROLLER_EDS),
        ("drive", 0x10, dbc::DRIVE_EDS),
        ("disturbance", 0x11, dbc::DISTURBANCE_EDS),
    ];
    let read = |(node_name, node_id, text)| {
        DataSheet::parse(format!("{node_name}.eds"), node_name, node_id, text)
            .expect("the file is compiled in and tested")
    };
    shipped.map(read).into()
}

/// Returns the node-ID of a node that the user names by number or, on the rig, by name.
///
/// # Errors
/// The text is neither.
pub fn node_id(text: &str, sheets: &[DataSheet]) -> Result<u8, DataSheetError> {
    if let Some(sheet) = sheets.iter().find(|sheet| sheet.node_name == text) {
        return Ok(sheet.node_id);
    }
    let number = match text.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    };
    number.filter(|id| (1..=127).contains(id)).ok_or_else(|| {
        let names = sheets.iter().map(|sheet| sheet.node_name.as_str());
        let names = Vec::from_iter(names);
        let nearest = scenario::nearest(text, names.iter().copied());
        let meant =
            nearest.map_or_else(String::new, |name| format!("; did you mean \"{name}\"?"));
        DataSheetError(format!(
            "\"{text}\" is not a node: give a number from 1 to 127 (such as 16 or 0x10), or one of {}{meant}",
            names.join(", ")
        ))
    })
}

impl DataSheet {
    /// Reads a file for a node.
    ///
    /// # Errors
    /// The file cannot be read or is not an EDS.
    pub fn load(path: &Path, node_id: u8) -> Result<Self, DataSheetError> {
        let file = path.display();
        let text = scenario::read_sheet(path, FILE_BYTES_MAX)
            .map_err(|error| DataSheetError(format!("`{file}` cannot be read: {error}")))?;
        let sheet = Self::parse(file.to_string(), &format!("node {node_id}"), node_id, &text)?;
        let name = path.file_name().unwrap_or(path.as_os_str());
        Ok(Self {
            name: name.to_string_lossy().into_owned(),
            ..sheet
        })
    }

    /// Reads the text of a file for a node; `name` names the file.
    pub(crate) fn parse(
        name: String,
        node_name: &str,
        node_id: u8,
        text: &str,
    ) -> Result<Self, DataSheetError> {
        let parsed = eds::parse(text, node_id);
        let dictionary = parsed.map_err(|error| DataSheetError(format!("{name}: {error}")))?;
        Ok(Self {
            name,
            node_name: node_name.to_owned(),
            node_id,
            dictionary,
        })
    }

    /// Returns the request and answer identifiers of the second SDO channel, if the data sheet has one.
    pub fn second_channel(&self) -> Option<(u16, u16)> {
        let id = |sub_index| {
            let cob_id = self.dictionary.unsigned(SECOND_CHANNEL, sub_index)?;
            let id = u16::try_from(cob_id & 0x7FF).ok()?;
            (cob_id & INVALID == 0 && id != 0).then_some(id)
        };
        Some((id(1)?, id(2)?))
    }

    /// Checks whether it describes an NMT manager.
    pub fn is_manager(&self) -> bool {
        let startup = self.dictionary.unsigned(NMT_STARTUP, 0);
        startup.is_some_and(|startup| startup & 1 == 1)
    }

    /// Returns how many of type, vendor and product of a device the sheet gives as the device does; `None` if it gives one of
    /// them otherwise. What it leaves out, or gives as 0, is not known.
    pub fn agreement(&self, identity: [u32; 3]) -> Option<usize> {
        let mut agreement = 0;
        for ((index, sub_index), found) in IDENTITY.into_iter().zip(identity) {
            match self.dictionary.unsigned(index, sub_index).unwrap_or(0) {
                expected if expected == found => agreement += 1,
                0 => {}
                _ => return None,
            }
        }
        Some(agreement).filter(|agreement| *agreement > 0)
    }

    /// Finds the object that the user names, as `6064`, `0x6064:00` or by its name in the EDS. Case does not matter; a part of
    /// the name is enough if it is unambiguous.
    ///
    /// # Errors
    /// There is no such object, or there are several.
    pub fn find(&self, text: &str) -> Result<(u16, u8), DataSheetError> {
        if let Some(place) = parse_place(text) {
            return Ok(place);
        }
        let wanted = text.to_lowercase();
        let is_exact = |entry: &&Entry| entry.name.to_lowercase() == wanted;
        let is_part = |entry: &&Entry| entry.name.to_lowercase().contains(&wanted);
        let entries = || self.dictionary.entries().iter();
        let mut found: Vec<&Entry> = entries().filter(is_exact).collect();
        if found.is_empty() {
            found = entries().filter(is_part).collect();
        }
        match found.as_slice() {
            [entry] => Ok((entry.index, entry.sub_index)),
            [] => Err(DataSheetError(self.unknown(text))),
            several => Err(DataSheetError(ambiguous(text, several))),
        }
    }

    /// Describes the problem of a name that no object has.
    fn unknown(&self, text: &str) -> String {
        let entries = self.dictionary.entries();
        let nearest = scenario::nearest(text, entries.iter().map(|entry| entry.name.as_str()));
        let meant = entries
            .iter()
            .find(|entry| Some(entry.name.as_str()) == nearest)
            .map_or_else(String::new, |entry| {
                let (name, index, sub_index) = (&entry.name, entry.index, entry.sub_index);
                format!("; did you mean \"{name}\" (0x{index:04X}:{sub_index:02X})?")
            });
        format!(
            "{} has no object \"{text}\": give an index such as 0x6064:00, or a name from the EDS{meant}",
            self.name
        )
    }
}

fn ambiguous(text: &str, several: &[&Entry]) -> String {
    let mut message = format!("\"{text}\" is the name of {} objects:", several.len());
    for entry in several.iter().take(CANDIDATES_MAX) {
        let (index, sub_index, name) = (entry.index, entry.sub_index, &entry.name);
        message += &format!("\n  0x{index:04X}:{sub_index:02X}  {name}");
    }
    if several.len() > CANDIDATES_MAX {
        message += "\n  ...";
    }
    message
}

/// Parses index and sub-index in hexadecimal digits, with or without `0x`; without a sub-index it is 0.
fn parse_place(text: &str) -> Option<(u16, u8)> {
    let digits = |text| str::strip_prefix(text, "0x").unwrap_or(text);
    let (index, sub_index) = text.split_once(':').unwrap_or((text, "0"));
    object_address(&format!("0x{}:{}", digits(index), digits(sub_index))).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive() -> DataSheet {
        rig_data_sheets().remove(1)
    }

    #[test]
    fn objects_are_found_by_place_and_by_name() {
        for (text, place) in [
            ("6064", (0x6064, 0)),
            ("0x6064", (0x6064, 0)),
            ("1018:2", (0x1018, 2)),
            ("0x1018:0x02", (0x1018, 2)),
            ("60C2:01", (0x60C2, 1)),
            ("Statusword", (0x6041, 0)),
            ("position actual value", (0x6064, 0)),
            ("target torq", (0x6071, 0)),
            // The EDS does not have it, but it is a place: the node accepts or refuses it.
            ("FFFF:FF", (0xFFFF, 0xFF)),
        ] {
            assert_eq!(drive().find(text).unwrap(), place, "{text}");
        }
    }

    #[test]
    fn unknown_and_ambiguous_names_say_what_there_is() {
        let unknown = drive().find("warp factor").unwrap_err().to_string();
        assert!(
            unknown.contains("drive.eds has no object \"warp factor\""),
            "{unknown}"
        );
        assert!(!unknown.contains("did you mean"), "{unknown}");
        let misspelt = drive().find("Statuswrd").unwrap_err().to_string();
        assert!(
            misspelt.contains("did you mean \"Statusword\" (0x6041:00)?"),
            "{misspelt}"
        );
        let ambiguous = drive().find("option code").unwrap_err().to_string();
        assert!(ambiguous.contains("6 objects"), "{ambiguous}");
        assert!(
            ambiguous.contains("0x605A:00  Quick stop option code"),
            "{ambiguous}"
        );
    }

    #[test]
    fn nodes_are_found_by_number_and_by_name() {
        let sheets = rig_data_sheets();
        for (text, id) in [("16", 16), ("0x10", 16), ("drive", 16), ("controller", 1)] {
            assert_eq!(node_id(text, &sheets).unwrap(), id);
        }
        for text in ["0", "128", "motor", "-1", "0x"] {
            assert!(node_id(text, &sheets).is_err(), "{text}");
        }
        let misspelt = node_id("drvie", &sheets).unwrap_err().to_string();
        assert!(misspelt.contains("did you mean \"drive\"?"), "{misspelt}");
    }

    #[test]
    fn only_the_drive_has_a_second_channel_and_only_the_controller_manages() {
        let sheets = rig_data_sheets();
        let channels: Vec<_> = sheets.iter().map(DataSheet::second_channel).collect();
        assert_eq!(channels, [None, Some((0x690, 0x6D0)), None]);
        let managers: Vec<_> = sheets.iter().map(DataSheet::is_manager).collect();
        assert_eq!(managers, [true, false, false]);
    }
}
