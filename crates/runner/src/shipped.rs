//! The scenarios and rig files that are part of the program, for who has no checkout.

use std::path::Path;

use scenario::nearest;

/// What comes before every name of a file that ends so.
const ENDING: &str = ".toml";

/// The files with their places below the folder that they are copied to, in order.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

/// A file that ships.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ShippedFile {
    /// Its place: `faults/sensor_stuck.toml`.
    pub place: &'static str,
    pub text: &'static str,
}

impl ShippedFile {
    /// The name by which commands find it: `faults/sensor_stuck`.
    pub(crate) fn name(&self) -> &'static str {
        self.place.strip_suffix(ENDING).unwrap_or(self.place)
    }

    fn is_scenario(&self) -> bool {
        self.place.ends_with(ENDING) && !self.is_rig()
    }

    fn is_rig(&self) -> bool {
        self.place.starts_with("rigs/")
    }
}

/// All files that ship.
pub(crate) fn files() -> impl Iterator<Item = ShippedFile> {
    FILES
        .iter()
        .map(|(place, text)| ShippedFile { place, text })
}

/// The file that ships by a name, with or without its ending.
pub(crate) fn file(name: &str) -> Option<ShippedFile> {
    files().find(|file| file.name() == name || file.place == name)
}

/// The scenario that a path means where no such file exists.
pub(crate) fn scenario(path: &Path) -> Option<ShippedFile> {
    let file = file(path.to_str()?).filter(ShippedFile::is_scenario)?;
    (!path.exists()).then_some(file)
}

/// The rig file that a path means where no such file exists.
pub(crate) fn rig(path: &Path) -> Option<ShippedFile> {
    let file = file(path.to_str()?).filter(ShippedFile::is_rig)?;
    (!path.exists()).then_some(file)
}

/// The name of a shipped file that was probably meant.
pub(crate) fn meant(name: &str) -> Option<&'static str> {
    nearest(name, files().map(|file| file.name()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig::setup::Setup;
    use worlds::catalogue::catalogue;

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

    /// They lie in no folder, so nothing lies beside them.
    #[test]
    fn scenarios_that_ship_are_valid_and_name_no_other_file() {
        let scenarios: Vec<ShippedFile> = files().filter(ShippedFile::is_scenario).collect();
        assert!(scenarios.len() > 70, "{} scenarios", scenarios.len());
        for file in scenarios {
            let setup = Setup::parse(Path::new(file.place), file.text.to_owned(), catalogue());
            let setup = setup.unwrap_or_else(|error| panic!("{}: {error:?}", file.place));
            assert!(setup.tables.is_empty(), "{}", file.place);
        }
    }
}
