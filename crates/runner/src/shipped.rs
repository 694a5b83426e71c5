//! The scenarios and rig files that are part of the program, for users without a checkout.

use std::io;
use std::path::Path;

use scenario::nearest;

/// Ending of files, which the names of scenarios and rigs omit.
const ENDING: &str = ".toml";

/// Files with their places below the folder to which they are copied, in order.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

/// File that ships.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ShippedFile {
    /// Place of the file: `faults/sensor_stuck.toml`.
    pub place: &'static str,
    pub text: &'static str,
}

impl ShippedFile {
    /// Returns the name by which commands find the file: `faults/sensor_stuck`.
    pub(crate) fn name(&self) -> &'static str {
        self.place.strip_suffix(ENDING).unwrap_or(self.place)
    }

    fn is_scenario(&self) -> bool {
        self.place.ends_with(ENDING) && !self.is_rig()
    }

    /// Returns whether the file names another file, as a table or as its rig.
    pub(crate) fn names(&self, other: &Self) -> bool {
        let folder = Path::new(self.place).parent().unwrap_or(Path::new(""));
        let beside = Path::new(other.place).strip_prefix(folder);
        let is_named = |name: &Path| self.text.contains(&format!("\"{}\"", name.display()));
        beside.is_ok_and(is_named)
    }

    /// Returns the text of a file in the same folder.
    pub(crate) fn beside(&self, name: &str) -> io::Result<String> {
        let place = Path::new(self.place).with_file_name(name);
        let found = place.to_str().and_then(file);
        found.map_or_else(
            || Err(io::ErrorKind::NotFound.into()),
            |file| Ok(file.text.to_owned()),
        )
    }

    fn is_rig(&self) -> bool {
        self.place.starts_with("rigs/")
    }
}

pub(crate) fn files() -> impl Iterator<Item = ShippedFile> {
    FILES
        .iter()
        .map(|(place, text)| ShippedFile { place, text })
}

/// Returns the file that ships by a name, with or without its ending.
pub(crate) fn file(name: &str) -> Option<ShippedFile> {
    files().find(|file| file.name() == name || file.place == name)
}

/// Returns the scenario that a path means if no such file exists.
pub(crate) fn scenario(path: &Path) -> Option<ShippedFile> {
    let file = file(path.to_str()?).filter(ShippedFile::is_scenario)?;
    (!path.exists()).then_some(file)
}

/// Returns the rig file that a path means if no such file exists.
pub(crate) fn rig(path: &Path) -> Option<ShippedFile> {
    let file = file(path.to_str()?).filter(ShippedFile::is_rig)?;
    (!path.exists()).then_some(file)
}

/// Returns the name of a shipped file that was probably meant.
pub(crate) fn meant(name: &str) -> Option<&'static str> {
    nearest(name, files().map(|file| file.name()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::play::ValueArgs;

    #[test]
    fn scenarios_have_names_and_no_file_hides_behind_one() {
        let step = file("step").unwrap();
        assert_eq!(step, file("step.toml").unwrap());
        assert_eq!(
            file("faults/sensor_stuck").unwrap().name(),
            "faults/sensor_stuck"
        );
        assert_eq!(scenario(Path::new("step")), Some(step));
        assert_eq!(scenario(Path::new("rigs/rig")), None);
        assert_eq!(rig(Path::new("rigs/rig")), file("rigs/rig.toml"));
        assert_eq!(rig(Path::new("step")), None);
        assert_eq!(scenario(Path::new("requirements.csv")), None);
        assert_eq!(meant("stepp"), Some("step"));
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(scenario(folder.path()), None);
    }

    /// The files lie in no folder, so the files that they name must ship, too.
    #[test]
    fn scenarios_that_ship_are_valid() {
        let scenarios: Vec<ShippedFile> = files().filter(ShippedFile::is_scenario).collect();
        assert!(scenarios.len() > 70, "{} scenarios", scenarios.len());
        for file in scenarios {
            let read = crate::scenarios::load(Path::new(file.name()), &ValueArgs::default());
            assert!(read.is_ok(), "{}: {:?}", file.place, read.err());
        }
    }

    #[test]
    fn a_scenario_names_its_rig_and_its_tables() {
        let courses = file("four_drives_courses").unwrap();
        let named = files().filter(|other| courses.names(other));
        let named = Vec::from_iter(named.map(|file| file.place));
        assert_eq!(named, ["four_drives_x.csv"]);
    }
}
