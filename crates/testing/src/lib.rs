//! Plans from the texts of scenarios, for the tests of all rooms that are not below `plan`, and of
//! those beside it.
//!
//! A text that is not valid ends the test with what `canrig check` would say.

use std::io::ErrorKind;
use std::path::Path;

use plan::Plan;
use plan::catalogue::Catalogue;
use scenario::{Beside, Trial, without_colours};

/// Returns the plan of a scenario on a shipped rig, by the shipped actuator's signals.
///
/// # Panics
/// The text is not valid.
pub fn plan(text: &str) -> Plan {
    plan_beside(text, &[], &Catalogue::shipped())
}

/// Returns the plan of a scenario beside files, by a catalogue of plants and laws.
///
/// # Panics
/// The text or a file is not valid.
pub fn plan_beside(text: &str, files: &[(&str, &str)], catalogue: &Catalogue) -> Plan {
    let read = |name: &str| {
        let file = files.iter().find(|(file, _)| *file == name);
        let (_, text) = file.ok_or(ErrorKind::NotFound)?;
        Ok((*text).to_owned())
    };
    let beside = Beside::new(Path::new("scenario.toml"));
    let plan = Plan::parse(&beside, text.to_owned(), read, catalogue);
    plan.unwrap_or_else(|error| panic!("{}\n{text}", without_colours(&error)))
}

/// Returns what the nodes of a loop are built from, by its drive, for rooms that know no plan.
///
/// # Panics
/// The text is not valid, or has no loop with such a drive.
pub fn part(text: &str, drive: &str) -> Trial {
    let loops = plan(text).loops.into_iter();
    let mut loops = loops.filter(|one| one.drive().name == drive);
    let found = loops.next();
    found
        .unwrap_or_else(|| panic!("no loop has the drive {drive}"))
        .trial
}
