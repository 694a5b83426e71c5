//! Aliases of cargo: `cargo xtask ci` runs what a change must pass, `cargo xtask update` writes what is generated.

use std::path::Path;
use std::process::{Command, ExitCode};

/// Environment and arguments of the tests that write files: schemas and pages of keys, snapshots of runs, DBC files.
const WRITERS: [(&str, &[&str]); 3] = [
    ("UPDATE_SCHEMA", &["-p", "scenario"]),
    ("UPDATE_SNAPSHOTS", &["-p", "canrig", "--test", "tests"]),
    ("UPDATE_SNAPSHOTS", &["-p", "dbc", "--test", "cantools"]),
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let is_done = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["ci"] => succeeds(&mut Command::new(root().join(".ci/run"))),
        ["update"] => WRITERS.into_iter().all(|(variable, tests)| {
            let mut cargo = Command::new("cargo");
            cargo.args(["test", "--release"]).args(tests);
            succeeds(cargo.env(variable, "1").current_dir(root()))
        }),
        _ => {
            #[expect(clippy::print_stderr, reason = "the usage of a program")]
            {
                eprintln!(
                    "usage: cargo xtask ci        all that a change must pass\n       \
                     cargo xtask update    writes schemas, pages of keys and snapshots"
                );
            }
            return ExitCode::from(2);
        }
    };
    ExitCode::from(u8::from(!is_done))
}

fn succeeds(command: &mut Command) -> bool {
    command.status().is_ok_and(|status| status.success())
}

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
