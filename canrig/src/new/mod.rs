//! `canrig new`: writes the crate of a plant or a law, a rig file, a scenario, a controller in
//! another language, or the files of a repository that tests with canrig. A crate
//! compiles, has tests and plays a scenario without a change.
//!
//! The crates in `plant/` and `law/` are the skeletons; `my_plant` and `my_law` are renamed in the copies.

mod controller;
mod name;
mod project;
mod rig;
mod scenario;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use ::scenario::custom::Section;
use clap::{Args, Subcommand};
use dbc::names::is_name;

use self::scenario::ScenarioArgs;
use controller::ControllerArgs;
use name::{camel, require_crate_name};
use platform::unfinished::Unfinished;
use project::ProjectArgs;
use rig::RigArgs;
use runner::console::print;
use runner::exit::{Exit, Failure};
use runner::output::{unwritten, write_new};

/// Checkout that this program was built from. It may be gone, or on another machine.
const BUILT_FROM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
/// Placeholder in the skeletons for the path of that checkout.
const CHECKOUT: &str = "CANRIG";
/// Configuration of cargo: a crate is built as canrig is, so that both build their dependencies alike and may share them.
const CONFIG: &str = "# The profile is canrig's own, so that a target folder can be shared.\ninclude = [\"CANRIG/Cargo.toml\"]\n";
/// Largest size of a manifest.
const MANIFEST_BYTES_MAX: u64 = 1 << 20;
/// Folders that cargo and the bench write, for `.gitignore`.
const IGNORED: &str = "/target\n/runs\n";

/// Arguments of `new`.
#[derive(Args, Debug)]
pub(crate) struct NewArgs {
    /// Kind of files to write.
    #[command(subcommand)]
    pub what: What,
}

/// Kind of files to write.
#[derive(Debug, Subcommand)]
pub(crate) enum What {
    /// Write a crate for a plant, with a rig file that wires drives to it
    Plant(CrateArgs),
    /// Write a crate for a control law: from a position and a set-point to a current
    Law(LawArgs),
    /// Write a rig file of two drives, with a scenario
    Rig(RigArgs),
    /// Write a scenario with a step for a rig, with limits around what a play of it measures
    Scenario(ScenarioArgs),
    /// Add a rig, a scenario, a test and a workflow to a repository
    Project(ProjectArgs),
    /// Write a controller in C or Python, with a scenario and a test
    Controller(ControllerArgs),
}

/// The crate of a law to write.
#[derive(Args, Debug)]
pub(crate) struct LawArgs {
    /// 2: a law with ports that leads two loops together, with the rig file that has them
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub loops: u8,
    #[command(flatten)]
    pub of: CrateArgs,
}

/// The crate to write.
#[derive(Args, Debug)]
pub(crate) struct CrateArgs {
    /// Name of the plant or law, of its table in scenarios and of the crate: small letters, digits and underscores
    pub name: String,
    /// Folder of the crate, which must not be there yet [default: NAME]
    #[arg(long, value_name = "FOLDER")]
    pub path: Option<PathBuf>,
    /// Checkout of canrig that the crate depends on; the one that this program was built from if absent
    #[arg(long, value_name = "FOLDER")]
    pub canrig: Option<PathBuf>,
}

/// Files of a crate: the path in its folder, and the content. In both is a placeholder for the name of the plant or law.
struct Skeleton {
    section: Section,
    name: &'static str,
    files: &'static [(&'static str, &'static str)],
}

const PLANT: Skeleton = Skeleton {
    section: Section::Plant,
    name: "my_plant",
    files: &[
        ("Cargo.toml", include_str!("plant/manifest.toml")),
        ("README.md", include_str!("plant/README.md")),
        ("src/lib.rs", include_str!("plant/lib.rs")),
        ("src/main.rs", include_str!("plant/main.rs")),
        (
            "scenarios/my_plant.toml",
            include_str!("plant/scenario.toml"),
        ),
        (
            "scenarios/my_plant_rig.toml",
            include_str!("plant/rig.toml"),
        ),
    ],
};

const LAW: Skeleton = Skeleton {
    section: Section::Controller,
    name: "my_law",
    files: &[
        ("Cargo.toml", include_str!("law/manifest.toml")),
        ("README.md", include_str!("law/README.md")),
        ("src/lib.rs", include_str!("law/lib.rs")),
        ("src/main.rs", include_str!("law/main.rs")),
        ("scenarios/my_law.toml", include_str!("law/scenario.toml")),
    ],
};

const LAW_OF_LOOPS: Skeleton = Skeleton {
    files: &[
        ("Cargo.toml", include_str!("law/manifest.toml")),
        ("README.md", include_str!("law/loops/README.md")),
        ("src/lib.rs", include_str!("law/loops/lib.rs")),
        ("src/main.rs", include_str!("law/main.rs")),
        (
            "scenarios/my_law.toml",
            include_str!("law/loops/scenario.toml"),
        ),
        (
            "scenarios/my_law_rig.toml",
            include_str!("law/loops/rig.toml"),
        ),
    ],
    ..LAW
};

/// Returns the failure of files that exist already.
fn exists(path: &Path) -> Failure {
    let path = path.display();
    Exit::Usage.because(format!(
        "{path} is there already; nothing is overwritten, so name another folder with --path"
    ))
}

/// Refuses a name for files that are no crate.
fn require_name(name: &str, of: &str) -> Result<(), Failure> {
    let refused = || {
        format!(
            "`{name}` cannot be the name of a {of}; use small letters, digits and underscores, a letter first"
        )
    };
    is_name(name)
        .then_some(())
        .ok_or_else(|| Exit::Usage.because(refused()))
}

/// Writes the requested files, and prints the next steps.
pub(crate) fn new(args: &NewArgs) -> Result<Exit, Failure> {
    print(&match &args.what {
        What::Plant(of) => written(&PLANT, of)?,
        What::Law(LawArgs { loops: 1, of }) => written(&LAW, of)?,
        What::Law(LawArgs { of, .. }) => written(&LAW_OF_LOOPS, of)?,
        What::Rig(args) => rig::written(args)?,
        What::Scenario(args) => scenario::written(args)?,
        What::Project(args) => return project::write(args),
        What::Controller(args) => controller::written(args)?,
    });
    Ok(Exit::Pass)
}

/// Writes a crate, and returns the next steps for the user.
fn written(skeleton: &Skeleton, args: &CrateArgs) -> Result<String, Failure> {
    let name = args.name.as_str();
    require_crate_name(name, skeleton.section)?;
    let folder = args.path.clone().unwrap_or_else(|| PathBuf::from(name));
    let checkout = checkout(args.canrig.as_deref())?;
    let mut files = skeleton.renamed(name, &checkout);
    // The versions that canrig is tested with; cargo adds the new crate.
    match fs::read_to_string(checkout.join("Cargo.lock")) {
        Ok(lock) => files.push(("Cargo.lock".to_owned(), lock)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => {
            return Err(Exit::CannotStart.because(format!("the Cargo.lock of canrig: {error}")));
        }
    }
    in_new_folder(&folder, |folder| write_files(folder, files))?;
    let (folder, checkout) = (folder.display(), checkout.display());
    Ok(format!(
        "{folder} is a crate now, which depends on canrig in {checkout}. Test and play it:\n  cd {folder}\n  cargo test --release\n  cargo run --release -- simulate scenarios/{name}.toml\n\
         The first build takes as long as canrig's own, unless CARGO_TARGET_DIR names canrig's target folder."
    ))
}

/// Makes a new folder with the files that `write` puts into it. The folder appears complete, or not at all.
fn in_new_folder(
    folder: &Path,
    write: impl FnOnce(&Path) -> Result<(), Failure>,
) -> Result<(), Failure> {
    if let Some(parent) = folder.parent() {
        fs::create_dir_all(parent).map_err(|error| unwritten(parent, &error))?;
    }
    let failed = |path: &Path, error: io::Error| match error.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty => exists(path),
        _ => unwritten(path, &error),
    };
    if folder.symlink_metadata().is_ok() {
        return Err(exists(folder));
    }
    // Of two processes that start at once, one succeeds.
    let partial = folder.with_added_extension("partial");
    let begin = || fs::create_dir(&partial).map_err(|source| failed(&partial, source));
    let ((), _unfinished) = Unfinished::begin(begin, |()| partial.clone())?;
    let written = write(&partial)
        .and_then(|()| fs::rename(&partial, folder).map_err(|source| failed(folder, source)));
    if written.is_err() {
        // A remainder does no harm.
        let _ = fs::remove_dir_all(&partial);
    }
    written
}

/// Writes files into a folder: the path in the folder, and the content.
fn write_files(
    folder: &Path,
    files: impl IntoIterator<Item = (impl AsRef<Path>, String)>,
) -> Result<(), Failure> {
    for (file, text) in files {
        write_new(&folder.join(file), &text)?;
    }
    Ok(())
}

/// Returns the absolute path of the checkout to depend on.
fn checkout(named: Option<&Path>) -> Result<PathBuf, Failure> {
    let is_canrig = |path: &Path| {
        let manifest = ::scenario::read_text(&path.join("canrig/Cargo.toml"), MANIFEST_BYTES_MAX);
        manifest.is_ok_and(|text| text.contains("name = \"canrig\""))
    };
    let path = named.unwrap_or(Path::new(BUILT_FROM));
    match path.canonicalize() {
        Ok(path) if is_canrig(&path) => Ok(path),
        _ if named.is_none() => Err(Exit::Usage.because(
            "the sources that this canrig was built from are not on this machine; name a checkout with --canrig FOLDER",
        )),
        _ => Err(Exit::Usage.because(format!(
            "`{}` is not a checkout of canrig (no canrig/Cargo.toml in it)",
            path.display()
        ))),
    }
}

impl Skeleton {
    /// Returns the files of a crate of this name.
    fn renamed(&self, name: &str, checkout: &Path) -> Vec<(String, String)> {
        let checkout = escaped(&checkout.display().to_string());
        let renamed = |text: &str| {
            let snake_case = text.replace(self.name, name);
            let both_cases = snake_case.replace(&camel(self.name), &camel(name));
            both_cases.replace(CHECKOUT, &checkout)
        };
        let shared = [(".cargo/config.toml", CONFIG), (".gitignore", IGNORED)];
        let files = self.files.iter().chain(&shared);
        files
            .map(|(path, text)| (renamed(path), renamed(text)))
            .collect()
    }
}

/// Escapes a text for the quotes of a TOML string.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(folder: &Path, name: &str) -> CrateArgs {
        CrateArgs {
            name: name.to_owned(),
            path: Some(folder.join("deep/down")),
            canrig: None,
        }
    }

    pub(super) fn require_exists(failure: &Failure, folder: &Path) {
        let expected = exists(folder);
        assert_eq!(failure.exit, expected.exit);
        assert_eq!(failure.reason, expected.reason);
    }

    #[test]
    fn a_folder_appears_whole_or_not_at_all() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("deep/new");
        let failed = in_new_folder(&folder, |partial| {
            fs::write(partial.join("half"), "of it").unwrap();
            assert!(!folder.exists());
            Err(unwritten(partial, &io::Error::other("the disk is full")))
        });
        assert_eq!(failed.unwrap_err().exit, Exit::BenchFailed);
        let left = || fs::read_dir(parent.path().join("deep")).unwrap().count();
        assert_eq!(left(), 0);
        let write = |partial: &Path| write_files(partial, [("file", "all".to_owned())]);
        assert!(in_new_folder(&folder, write).is_ok());
        assert!(folder.join("file").exists() && left() == 1);
        let again = in_new_folder(&folder, |_| unreachable!("it is there"));
        require_exists(&again.unwrap_err(), &folder);
    }

    #[test]
    fn a_crate_is_written_once_and_nothing_of_the_skeleton_s_name_is_left() {
        for skeleton in [&PLANT, &LAW, &LAW_OF_LOOPS] {
            let folder = tempfile::tempdir().unwrap();
            let args = args(folder.path(), "swing_arm");
            let written_to = folder.path().join("deep/down");
            let said = written(skeleton, &args).unwrap();
            assert!(said.contains("simulate scenarios/swing_arm.toml"), "{said}");
            let scenario = written_to.join("scenarios/swing_arm.toml");
            let text = fs::read_to_string(&scenario).unwrap();
            let names_it = [".swing_arm]", "swing_arm_rig.toml"];
            assert!(names_it.iter().any(|name| text.contains(name)), "{text}");
            let program = fs::read_to_string(written_to.join("src/main.rs")).unwrap();
            assert!(program.contains("::<SwingArm>()"), "{program}");
            for (path, text) in skeleton.renamed("x1", folder.path()) {
                assert!(!text.to_lowercase().contains("my_"), "{path}");
                assert!(!text.contains("CANRIG"), "{path}");
            }
            let again = written(skeleton, &args).unwrap_err();
            require_exists(&again, &written_to);
            assert_eq!(fs::read_to_string(&scenario).unwrap(), text);
        }
    }

    #[test]
    fn what_is_no_checkout_is_refused_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let args = CrateArgs {
            canrig: Some(folder.path().to_owned()),
            ..args(folder.path(), "swing_arm")
        };
        let refused = written(&PLANT, &args).unwrap_err();
        assert!(refused.reason.contains("is not a checkout"), "{refused}");
        assert!(!folder.path().join("deep").exists());
    }

    #[test]
    fn the_walk_throughs_show_what_the_skeletons_say() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
        for (page, skeletons) in [
            ("your-plant.md", &[PLANT][..]),
            ("your-law.md", &[LAW, LAW_OF_LOOPS]),
            ("law-of-all-loops.md", &[LAW, LAW_OF_LOOPS]),
        ] {
            let page = fs::read_to_string(folder.join(page)).unwrap();
            let prose = page.split("```").step_by(2);
            let lines: usize = prose.map(|text| text.lines().count()).sum();
            assert!(lines < 100, "a walk is short");
            let files = skeletons.iter().flat_map(|one| one.files);
            let is_told = |path: &str| path.starts_with("src/") || path.starts_with("scenarios/");
            let told = files.filter(|(path, _)| is_told(path));
            let texts = Vec::from_iter(told.map(|(_, text)| text));
            for block in page.split("```").skip(1).step_by(2) {
                let (kind, code) = block.split_once('\n').unwrap();
                let is_shown = texts.iter().any(|text| text.contains(code));
                assert!(is_shown || kind == "sh", "not in the skeleton:\n{code}");
            }
        }
    }
}
