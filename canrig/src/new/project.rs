//! `canrig new project`: adds a rig, a scenario, a test and a workflow to a repository.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use runner::console::{print, print_problem};
use runner::exit::{Exit, Failure};
use runner::output::write_new;

const RIG: &str = include_str!("project/rig.toml");
const STEP: &str = include_str!("project/step.toml");
const TEST: &str = include_str!("project/test_step.py");
const GITHUB: &str = include_str!("project/github.yml");
const GITLAB: &str = include_str!("project/gitlab.yml");

/// Host of a repository.
#[derive(Clone, Copy, Debug, Eq, PartialEq, ValueEnum)]
pub(crate) enum Host {
    /// GitHub Actions
    Github,
    /// GitLab CI
    Gitlab,
}

impl Host {
    /// Returns place and content of its workflow, and where a user sets the variable.
    fn workflow(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Github => (
                ".github/workflows/bench.yml",
                GITHUB,
                "the variables of the repository (Settings, Secrets and variables, Actions)",
            ),
            Self::Gitlab => (
                ".gitlab-ci.yml",
                GITLAB,
                "the variables of the project (Settings, CI/CD)",
            ),
        }
    }
}

/// The repository.
#[derive(Args, Debug)]
pub(crate) struct ProjectArgs {
    /// Root of the repository
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub folder: PathBuf,
    /// Host whose workflow is written
    #[arg(long, value_enum, default_value_t = Host::Github)]
    pub ci: Host,
}

/// Writes the files that are not there yet, names those that are, and prints the next steps.
pub(super) fn write(args: &ProjectArgs) -> Result<Exit, Failure> {
    let (workflow, text, variables) = args.ci.workflow();
    let files = [
        ("scenarios/rig.toml", RIG),
        ("scenarios/step.toml", STEP),
        ("scenarios/test_step.py", TEST),
        (workflow, text),
    ];
    let mut exit = Exit::Pass;
    let is_here = args.folder == Path::new(".");
    let folder = if is_here { Path::new("") } else { &args.folder };
    for (name, text) in files {
        let path = folder.join(name);
        let place = path.display();
        if path.symlink_metadata().is_ok() {
            print_problem(format!("{place} is there already, and stays as it is"));
            exit = Exit::CannotStart;
        } else {
            write_new(&path, text)?;
            print(&format!("wrote {place}"));
        }
    }
    let go = match is_here {
        true => String::new(),
        false => format!("  cd {}\n", folder.display()),
    };
    print(&format!(
        "Play the scenario, then all tests (they need the wheel):\n{go}  canrig simulate scenarios/step.toml\n  \
         pytest --canrig scenarios/\nThe workflow installs the wheel that CANRIG_WHEEL names: set it among {variables}.\n\
         Runs leave the folder runs/: add it to .gitignore."
    ));
    Ok(exit)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use plan::Plan;
    use worlds::catalogue::catalogue;

    use super::*;

    fn args(folder: &Path, ci: Host) -> ProjectArgs {
        ProjectArgs {
            folder: folder.to_owned(),
            ci,
        }
    }

    #[test]
    fn a_file_that_exists_is_left_and_the_others_are_written() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(
            write(&args(folder.path(), Host::Github)).unwrap(),
            Exit::Pass
        );
        Plan::load(&folder.path().join("scenarios/step.toml"), catalogue()).unwrap();
        let step = folder.path().join("scenarios/step.toml");
        fs::write(&step, "mine").unwrap();
        let again = write(&args(folder.path(), Host::Gitlab)).unwrap();
        assert_eq!(again, Exit::CannotStart);
        assert_eq!(fs::read_to_string(&step).unwrap(), "mine");
        assert!(folder.path().join(".gitlab-ci.yml").exists());
    }

    /// `tests/system/test_pipelines.py` plays the workflows of the page.
    #[test]
    fn the_workflows_are_those_of_the_book() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/ci.md");
        let page = fs::read_to_string(page).unwrap();
        for text in [GITHUB, GITLAB] {
            assert!(page.contains(&format!("```yaml\n{text}```")));
        }
    }
}
