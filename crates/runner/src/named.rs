//! What a user names to say which nodes are on a bus: a rig file, a scenario, or the folder of a run.

use std::path::Path;

use scenario::rig::RigFile;
use scenario::rig::nodes::Rig;
use scenario::{Scenario, read_text};

use crate::console::print_diagnostic;
use crate::exit::Exit;
use crate::recorded::{read_played, refuse};
use crate::scenarios::{load, read_rig};
use rig::FILE_BYTES_MAX;
use rig::setup::Setup;
use worlds::catalogue::catalogue;

/// The loops on that bus; prints what is wrong.
///
/// # Errors
/// The exit code for it.
pub fn setups_of(path: &Path) -> Result<Vec<Setup>, Exit> {
    if path.is_dir() {
        let played = read_played(path, catalogue()).map_err(refuse)?;
        return Ok(played.0);
    }
    let invalid = |error| {
        print_diagnostic(error);
        Exit::CannotStart
    };
    let text = read_text(path, FILE_BYTES_MAX);
    // Who asks for nodes names a rig, unless it is a scenario. What cannot be read may be the name of one that ships.
    let is_rig =
        |text: &String| Rig::is_meant(text) || !RigFile::is_meant(text) && !Scenario::may_be(text);
    if text.as_ref().is_ok_and(is_rig) {
        return rig::loops::of_rig(path, catalogue()).map_err(invalid);
    }
    if RigFile::is_meant(&text.unwrap_or_default()) {
        let setup = read_rig(path).and_then(Setup::of_rig);
        return setup.map(|setup| vec![setup]).map_err(|error| {
            print_diagnostic(error);
            Exit::CannotStart
        });
    }
    load(path, &[])
}
