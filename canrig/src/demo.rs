//! `canrig demo`: plays a step, a fault and a law from a file in lock-step, with nothing but the
//! program.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::{Args, Parser};
use recording::run_folder::file;
use runner::commands::run::{RunArgs, run};
use runner::console::print;
use runner::exit::{Exit, Failure};
use runner::output::write_new;

const STEP: Part = Part {
    title: "1. A step: a PID makes a DC motor lift a load by 25 mm.",
    scenario: "motor_step.toml",
    source: "motor_step.toml",
    files: &[(
        "motor_step.toml",
        include_str!("../../scenarios/motor_step.toml"),
    )],
};
const FAULT: Part = Part {
    title: "2. A fault: the motor jams, and the controller must take the current away.",
    scenario: "motor_jams.toml",
    source: "motor_jams.toml",
    files: &[(
        "motor_jams.toml",
        include_str!("../../scenarios/motor_jams.toml"),
    )],
};
const PYTHON: Part = Part {
    title: "3. The PID of the step again, from the file pid.py.",
    scenario: "pid_in_python.toml",
    source: "pid.py",
    files: &[
        (
            "pid_in_python.toml",
            include_str!("../../docs/examples/pid_in_python.toml"),
        ),
        ("pid.py", include_str!("../../docs/examples/pid.py")),
        ("canrig_law.py", include_str!("../../python/canrig/law.py")),
        (
            "canrig_node.py",
            include_str!("../../python/canrig/node.py"),
        ),
    ],
};
const C: Part = Part {
    title: "3. The PID of the step again, from the file pid.c (there is no python3 here, but cc).",
    scenario: "pid_in_c.toml",
    source: "pid_in_c.toml",
    files: &[
        (
            "pid_in_c.toml",
            include_str!("../../docs/examples/pid_in_python.toml"),
        ),
        ("pid.c", include_str!("../../docs/examples/pid.c")),
        ("canrig_law.h", include_str!("../../include/canrig_law.h")),
    ],
};
/// Texts in the files of the repository, and what takes their place here: the modules of the wheel
/// lie beside the law, and schemas do not.
const RENAMED: [(&str, &str); 5] = [
    ("#:schema ./schema.json\n", ""),
    ("import canrig.law\n", "import canrig_law\n"),
    ("canrig.law.register(Pid)", "canrig_law.register(Pid)"),
    ("from .node import", "from canrig_node import"),
    ("cc -O2 -shared -fPIC -I include", "cc -O2 -shared -fPIC"),
];
/// The same for the scenario of a law in C.
const PYTHON_TO_C: [(&str, &str); 3] = [
    ("[controller.program", "[controller.library"),
    ("command = [\"python3\", \"pid.py\"]", "file = \"pid.so\""),
    ("a PID in Python", "a PID in C"),
];
/// Arguments of the compiler.
const COMPILE: [&str; 7] = ["-O2", "-shared", "-fPIC", "-o", "pid.so", "pid.c", "-lm"];
/// Succeeds with a Python that the law needs.
const CHECK_PYTHON: &str = "import sys; sys.exit(sys.version_info < (3, 9))";

/// Arguments of `demo`.
#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// Folder of the files, new or empty
    #[arg(value_name = "FOLDER", default_value = "canrig-demo")]
    pub folder: PathBuf,
    /// Open the report of the step
    #[arg(long)]
    pub open: bool,
}

/// Scenario with its files.
struct Part {
    title: &'static str,
    scenario: &'static str,
    /// File that a user changes to see another result.
    source: &'static str,
    /// Names and contents.
    files: &'static [(&'static str, &'static str)],
}

/// Arguments of `canrig run`, as a user types them.
#[derive(Parser)]
#[command(no_binary_name = true)]
struct Run {
    #[command(flatten)]
    args: RunArgs,
}

/// Writes the scenarios, plays them, and prints what to type next.
pub(crate) fn demo(args: &DemoArgs) -> Result<Exit, Failure> {
    let folder = &args.folder;
    require_empty(folder)?;
    let law = law();
    let mut worst = Exit::Pass;
    for part in [Some(&STEP), Some(&FAULT), law].into_iter().flatten() {
        worst = worst.max(part.play(folder)?);
        if worst == Exit::Interrupted {
            return Ok(worst);
        }
    }
    if law.is_none() {
        print(
            "\n3. A law from a file is left out: neither Python 3.9 (python3) nor a C compiler (cc) is on PATH.",
        );
    }
    print(&next_steps(folder, law));
    if args.open {
        open(&page(folder, &STEP)?)?;
    }
    Ok(worst)
}

/// Refuses a folder with files, and a file in its place.
fn require_empty(folder: &Path) -> Result<(), Failure> {
    let place = folder.display();
    let is_empty = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => true,
        Err(error) => {
            return Err(Exit::Usage.because(format!(
                "`{place}` cannot be the folder of the demo: {error}; name another folder: canrig demo FOLDER"
            )));
        }
    };
    is_empty.then_some(()).ok_or_else(|| {
        Exit::Usage.because(format!(
            "`{place}` is not empty, and nothing is overwritten; name another folder: canrig demo FOLDER"
        ))
    })
}

/// Returns the part whose law this machine can start; `None` without Python and without a C
/// compiler.
fn law() -> Option<&'static Part> {
    let succeeds = |program: &str, arguments: &[&str]| {
        let mut command = Command::new(program);
        let command = command.args(arguments).stdin(Stdio::null());
        let ended = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
        ended.is_ok_and(|status| status.success())
    };
    if succeeds("python3", &["-c", CHECK_PYTHON]) {
        Some(&PYTHON)
    } else if succeeds("cc", &["--version"]) {
        Some(&C)
    } else {
        None
    }
}

/// Compiles the law in C.
fn compile(folder: &Path) -> Result<(), Failure> {
    print(&format!("$ cc {}", COMPILE.join(" ")));
    let failed = |why: &str| Exit::CannotStart.because(format!("cc does not compile pid.c: {why}"));
    let mut cc = Command::new("cc");
    let ended = cc.args(COMPILE).current_dir(folder).output();
    let ended = ended.map_err(|error| failed(&error.to_string()))?;
    if ended.status.success() {
        Ok(())
    } else {
        Err(failed(&String::from_utf8_lossy(&ended.stderr)))
    }
}

impl Part {
    /// Returns the name of the folder of its run folder.
    fn runs(&self) -> PathBuf {
        Path::new("runs").join(self.scenario.trim_end_matches(".toml"))
    }

    /// Writes its files, plays its scenario in lock-step, and returns the exit.
    fn play(&self, folder: &Path) -> Result<Exit, Failure> {
        print(&format!("\n{}", self.title));
        for (name, text) in self.files {
            write_new(&folder.join(name), &self.renamed(text))?;
        }
        if self.scenario == C.scenario {
            compile(folder)?;
        }
        let [scenario, runs] = [Path::new(self.scenario), &self.runs()].map(|one| folder.join(one));
        let words = [
            scenario.as_os_str(),
            "--clock".as_ref(),
            "lockstep".as_ref(),
        ];
        let output = ["--output".as_ref(), runs.as_os_str()];
        print(&format!(
            "$ canrig run {} --clock lockstep",
            scenario.display()
        ));
        run(&Run::parse_from(words.into_iter().chain(output)).args)
    }

    /// Returns a file as it is in the folder of the demo.
    fn renamed(&self, text: &str) -> String {
        let to_c: &[_] = match self.scenario == C.scenario {
            true => &PYTHON_TO_C,
            false => &[],
        };
        let all = RENAMED.iter().chain(to_c);
        all.fold(text.to_owned(), |text, (old, new)| text.replace(old, new))
    }
}

/// Returns the report of a part that was played.
fn page(folder: &Path, part: &Part) -> Result<PathBuf, Failure> {
    let runs = folder.join(part.runs());
    let unread = |error| Exit::BenchFailed.because(format!("`{}`: {error}", runs.display()));
    let run = fs::read_dir(&runs).map_err(unread)?.flatten().next();
    let run = run.map_or_else(|| runs.clone(), |entry| entry.path());
    Ok(run.join(file::REPORT))
}

/// Opens a page in the user's browser.
fn open(page: &Path) -> Result<(), Failure> {
    let place = page.display();
    let failed = |why: String| {
        Exit::BenchFailed.because(format!(
            "`{place}` cannot be opened: xdg-open {why}; open it in a browser"
        ))
    };
    let status = Command::new("xdg-open").arg(page).status();
    let status = status.map_err(|error| failed(format!("cannot be started ({error})")))?;
    match status.success() {
        true => Ok(()),
        false => Err(failed(format!("ended with {status}"))),
    }
}

/// Returns the paths of the files, and the commands that a user types next.
fn next_steps(folder: &Path, law: Option<&Part>) -> String {
    let parts = [Some(&STEP), Some(&FAULT), law].into_iter().flatten();
    let pages = parts.filter_map(|part| page(folder, part).ok());
    let pages = pages.map(|page| format!("\n  {}", page.display()));
    let pages = Vec::from_iter(pages).concat();
    let folder = folder.display();
    let (scenario, change) = match law {
        Some(law) => (law.scenario, law.source),
        None => (STEP.scenario, STEP.source),
    };
    format!(
        "\nThe files are in {folder}. The reports open in any browser:\n{pages}\n\n\
         Next, play another step; play again at each change of {change}; play in real time:\n\n  cd {folder}\n  \
         canrig simulate {scenario} --set reference.step[0].position_millimetres=20\n  \
         canrig simulate {scenario} --watch\n  canrig run {}",
        STEP.scenario
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_text_that_is_renamed_is_in_a_file() {
        for (old, _) in RENAMED.iter().chain(&PYTHON_TO_C) {
            let parts = [STEP, FAULT, PYTHON, C];
            let mut files = parts.iter().flat_map(|part| part.files);
            assert!(files.any(|(_, text)| text.contains(old)), "{old}");
        }
        for (name, text) in PYTHON.files {
            let text = PYTHON.renamed(text);
            let is_of_wheel =
                |line: &str| line.starts_with("import canrig.") || line.starts_with("from .");
            assert!(!text.lines().any(is_of_wheel), "{name}");
        }
    }

    #[test]
    fn a_folder_with_files_is_refused_and_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        assert!(require_empty(folder.path()).is_ok());
        assert!(require_empty(&folder.path().join("new")).is_ok());
        let file = folder.path().join("mine");
        fs::write(&file, "mine").unwrap();
        for place in [folder.path(), &file] {
            let error = require_empty(place).unwrap_err();
            assert_eq!(error.exit, Exit::Usage);
            assert!(error.reason.contains("name another"), "{error}");
        }
    }
}
