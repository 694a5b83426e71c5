//! `canrig new rig`: writes a rig file of two drives, and a scenario that plays on it without a change.

use std::path::PathBuf;

use clap::Args;
use runner::exit::Failure;

use super::{in_new_folder, require_name, write_files};

/// Placeholder in the files for the rig's name.
const NAME: &str = "my_rig";
const RIG: &str = include_str!("rig/rig.toml");
const SCENARIO: &str = include_str!("rig/scenario.toml");

/// The rig to write.
#[derive(Args, Debug)]
pub(crate) struct RigArgs {
    /// Name of the rig and of its file: small letters, digits and underscores
    pub name: String,
    /// Folder of the files, which must not be there yet [default: NAME]
    #[arg(long, value_name = "FOLDER")]
    pub path: Option<PathBuf>,
}

/// Writes the files, and returns the next steps for the user.
pub(super) fn written(args: &RigArgs) -> Result<String, Failure> {
    let name = &args.name;
    require_name(name, "rig")?;
    let folder = args.path.clone().unwrap_or_else(|| PathBuf::from(name));
    in_new_folder(&folder, |folder| write_files(folder, files(name)))?;
    let folder = folder.display();
    Ok(format!(
        "{folder} holds a rig of two drives and a scenario. Check and play them:\n  canrig check {folder}\n  canrig simulate {folder}/{name}_steps.toml"
    ))
}

/// Returns the files: name and content.
fn files(name: &str) -> [(String, String); 2] {
    let renamed = |text: &str| text.replace(NAME, name);
    [
        (format!("{name}.toml"), renamed(RIG)),
        (format!("{name}_steps.toml"), renamed(SCENARIO)),
    ]
}

#[cfg(test)]
mod tests {
    use std::fs;

    use plan::Plan;
    use scenario::rig::nodes::Rig;
    use worlds::catalogue::catalogue;

    use super::*;

    fn args(folder: &std::path::Path, name: &str) -> RigArgs {
        RigArgs {
            name: name.to_owned(),
            path: Some(folder.join("deep/down")),
        }
    }

    #[test]
    fn a_rig_is_written_once_and_its_scenario_is_valid() {
        let temporary = tempfile::tempdir().unwrap();
        let args = args(temporary.path(), "gantry");
        let said = written(&args).unwrap();
        assert!(said.contains("deep/down/gantry_steps.toml"), "{said}");
        let folder = temporary.path().join("deep/down");
        let plan = Plan::load(&folder.join("gantry_steps.toml"), catalogue()).unwrap();
        assert_eq!(plan.loops.len(), 2);
        let rig = fs::read_to_string(folder.join("gantry.toml")).unwrap();
        assert_eq!(Rig::parse(&rig, "gantry.toml").unwrap().name, "gantry");
        assert!(!rig.contains("my_"), "{rig}");
        let again = written(&args).unwrap_err();
        super::super::tests::require_exists(&again, &folder);
    }

    #[test]
    fn what_can_be_no_name_is_refused_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["", "Gantry", "../gantry", "two axes"] {
            let error = written(&args(folder.path(), name)).unwrap_err();
            assert!(
                error.reason.contains("cannot be the name of a rig"),
                "{error}"
            );
        }
        assert!(!folder.path().join("deep").exists());
    }
}
