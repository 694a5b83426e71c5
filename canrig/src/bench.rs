//! A bench with custom plants and laws: every command of canrig, which treats them like the shipped ones.

use std::error::Error;
use std::ffi::OsString;
use std::panic::AssertUnwindSafe;
use std::process::ExitCode;

use clap::FromArgMatches;
use controller::catalogue::{LawRow, register_laws};
use controller::law::Law;
use plant_emulator::catalogue::{PlantRow, register_plants};
use plant_emulator::plant::Plant;
use platform::terminal::printable;
use recording::frames::LogChanged;

use crate::cli::{self, Cli, command_line};
use crate::fmu::export::{self, OwnModel};
use runner::console;
use runner::exit::Exit;

/// Number of files, sockets and pipes that a run has open at once, with a reserve.
const OPEN_FILES: u64 = 64;

/// The program before it runs, with its plants and laws.
///
/// The nodes are processes of the same program, so all of them know the same plants and laws.
#[derive(Default)]
#[must_use = "`main` runs it"]
pub struct Bench {
    plants: Vec<PlantRow>,
    models: Vec<OwnModel>,
    laws: Vec<LawRow>,
}

impl Bench {
    /// Returns canrig with the plants and laws that ship.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a plant. Rig files choose it by a table `[plant.NAME.MODEL]`, and scenarios without a rig file by
    /// `[plant.MODEL]`.
    pub fn plant<P: Plant>(mut self) -> Self {
        self.plants.push(PlantRow::of::<P>());
        self.models.push(fmu_plants::plant::<P>);
        self
    }

    /// Adds a law. Scenarios choose it by a table `[controller.NAME]`, or `[controller.all.NAME]` if it leads all loops
    /// of a rig.
    pub fn law<L: Law>(mut self) -> Self {
        self.laws.push(LawRow::of::<L>());
        self
    }

    /// Executes the command line. A panic ends in exit code 70 and a message, after the stack was unwound. An invalid
    /// plant or law ends in the same way.
    pub fn main(self) -> ExitCode {
        std::panic::set_hook(Box::new(console::print_panic));
        // The remains of the bench after a panic are dropped with it.
        let run = AssertUnwindSafe(|| match self.register() {
            Ok(()) => from_command_line(),
            Err(error) => {
                let reason = format!("this bench cannot begin: {error}");
                console::failed(Exit::Internal.because(reason))
            }
        });
        let exit = std::panic::catch_unwind(run).unwrap_or_else(|panic| {
            if panic.is::<LogChanged>() {
                Exit::BenchFailed
            } else {
                Exit::Internal
            }
        });
        let exit = match console::unprinted() {
            None => exit,
            Some(reason) => exit.max(console::failed(
                Exit::BenchFailed.because(format!("standard output cannot be written: {reason}")),
            )),
        };
        exit.into()
    }

    /// Registers the plants and laws. An invalid one is a mistake of the bench's author, not of its user.
    fn register(self) -> Result<(), Box<dyn Error>> {
        register_laws(self.laws)?;
        register_plants(self.plants)?;
        export::register(self.models);
        Ok(())
    }
}

fn from_command_line() -> Exit {
    // Each file is printed on one line, and some CI systems take commands from the beginning of a line.
    let has_line_end = |word: &OsString| word.as_encoded_bytes().contains(&b'\n');
    if let Some(word) = std::env::args_os().find(has_line_end) {
        return console::failed(Exit::Usage.because(format!(
            "{word:?} has a line end in it: write it in one line, or rename the file"
        )));
    }
    let parsed = |words: Vec<OsString>| {
        let matches = command_line().try_get_matches_from(words)?;
        Cli::from_arg_matches(&matches)
    };
    match parsed(std::env::args_os().collect()) {
        Ok(cli) => execute(cli),
        Err(error) => {
            // The texts for --help and --version come as errors too. The parser repeats parts of the command line,
            // between its own colours.
            let printable = |word: OsString| printable(&word.to_string_lossy()).into_owned().into();
            match parsed(std::env::args_os().map(printable).collect()) {
                Err(shown) => console::print_parsed(&shown),
                Ok(_) => console::print_error(&error.render().to_string()),
            }
            if error.use_stderr() {
                Exit::Usage
            } else {
                Exit::Pass
            }
        }
    }
}

fn execute(cli: Cli) -> Exit {
    // If the signal is not ignored, a limit on the size of files ends the program.
    let _ = platform::stop::take_long_files_as_errors();
    // Without it a signal ends the program too, with another code.
    let _ = platform::stop::end_at_once(Exit::Interrupted.code());
    match platform::process::require_open_files(OPEN_FILES) {
        Ok(()) => {
            platform::memory::keep_freed();
            cli::execute(cli.command).unwrap_or_else(console::failed)
        }
        Err(error) => {
            console::print_error(&error);
            Exit::BenchFailed
        }
    }
}
