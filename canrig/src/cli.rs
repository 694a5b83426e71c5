//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory, Parser, Subcommand};
use platform::{keeper, private_bus, process};

use crate::demo::{DemoArgs, demo};
use crate::doctor::{DoctorArgs, doctor};
use crate::eds::{EdsArgs, eds};
use crate::fmu::{FmuArgs, fmu};
use crate::host::{NodeArgs, host};
use crate::manual::{CompletionsArgs, ManArgs, completions, man};
use crate::new::{NewArgs, new};
use crate::schema::{SchemaArgs, schema};
use crate::tools::monitor::{MonitorArgs, monitor};
use crate::tools::nodes::{NodesArgs, nodes};
use crate::tools::sdo::{SdoArgs, sdo};
use campaigns::coverage::{CoverageArgs, coverage};
use campaigns::engine::command::{SubmitArgs, submit};
use campaigns::sweep::command::{SweepArgs, sweep};
use campaigns::sweep::merge::{MergeArgs, merge};
use campaigns::torture::command::{TortureArgs, torture};
use paper::identify::command::{IdentifyArgs, identify};
use paper::reproduce::command::{ReproduceArgs, reproduce};
use runner::commands::check::{CheckArgs, check};
use runner::commands::compare::{CompareArgs, compare};
use runner::commands::examples::{ExamplesArgs, examples};
use runner::commands::export::{ExportArgs, export};
use runner::commands::replay::{ReplayArgs, replay};
use runner::commands::report::{ReportArgs, report};
use runner::commands::run::{RunArgs, run};
use runner::commands::signals::{SignalsArgs, signals};
use runner::commands::simulate::{SimulateArgs, simulate};
use runner::console::{print, print_error};
use runner::exit::{Exit, Failure};
use worlds::fmu_worker;
use worlds::law_worker;

/// Visible commands by group, in the order of the help.
const GROUPS: [(&str, &[&str]); 5] = [
    (
        "Play",
        &["demo", "run", "simulate", "check", "examples", "doctor"],
    ),
    (
        "Look",
        &[
            "report", "replay", "compare", "coverage", "export", "signals",
        ],
    ),
    ("Bus tools", &["nodes", "sdo", "monitor"]),
    (
        "Campaigns",
        &[
            "sweep",
            "merge",
            "submit",
            "torture",
            "identify",
            "reproduce",
        ],
    ),
    (
        "Make",
        &["new", "eds", "fmu", "schema", "completions", "man"],
    ),
];

const EXITS: &str = "\
Exit codes:
  0 pass · 1 a limit was not met, a node under test failed, or runs diverge
  2 the command line is wrong
  3 a file is invalid, a program cannot be started, or the pre-flight failed
  4 canrig or the bus failed, or another bench has the bus
  5 inconclusive: the computer stalled, or a limit is on a value that no node sends
  70 internal error · 130 interrupted";

const COVERAGE_EXITS: &str = "\
Exit codes:
  0 every requirement is met · 1 a requirement failed, its run broke off, or no scenario tests it
  3 a run folder or the list is invalid · 4 the page cannot be written
  5 a requirement is inconclusive, and none is worse";

const SWEEP_EXITS: &str = "\
Exit codes, of the worst run:
  0 pass · 1 a limit was not met
  3 the file, or the scenario with a combination of values, is invalid
  4 a run broke off, or a file cannot be written · 5 inconclusive · 70 internal error
  130 interrupted";

const MERGE_EXITS: &str = "\
Exit codes, of the worst run:
  0 pass · 1 a limit was not met
  3 a run is missing or invalid, or a part belongs to another sweep
  4 a run broke off, or a file cannot be written · 5 inconclusive · 70 internal error";

const SUBMIT_EXITS: &str = "\
Exit codes, of the worst run:
  0 pass · 1 a limit was not met
  3 the file is invalid, or the campaign was submitted otherwise before
  4 the engine is not there or refuses, parts were lost too often, a run broke off, or a file cannot be written
  5 inconclusive · 70 internal error
  130 interrupted: the job continues, and --resume waits for it";

/// Tests a controller against a plant over a CAN bus: simulated, in real time, and with real hardware.
#[derive(Debug, Parser)]
#[command(version, after_help = EXITS, max_term_width = 100)]
pub(crate) struct Cli {
    /// Subcommand to execute.
    #[command(subcommand)]
    pub command: Command,
}

/// Subcommand.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Play a step, a fault and a law from a file, and say what to type next
    Demo(DemoArgs),
    /// Play scenarios with controller and plant as processes on a CAN bus, and judge them
    Run(RunArgs),
    /// Play scenarios in one process, in virtual time, and judge them
    Simulate(SimulateArgs),
    /// Write the pages of run folders again, and an overview of several runs
    Report(ReportArgs),
    /// Judge a recording again, from its frames (bus.log)
    Replay(ReplayArgs),
    /// Find out where two runs diverge
    Compare(CompareArgs),
    /// Show which scenarios test each requirement, and whether it is met
    #[command(after_help = COVERAGE_EXITS)]
    Coverage(CoverageArgs),
    /// Write a recording in the format of another program
    Export(ExportArgs),
    /// Identify the parameters of the shape-memory-alloy wire from recordings
    Identify(IdentifyArgs),
    /// Play every experiment of the paper on the shape-memory-alloy wire
    Reproduce(ReproduceArgs),
    /// Play random combinations of faults, and reduce each that breaks an invariant
    Torture(TortureArgs),
    /// Play a scenario with each combination of values in its [sweep] table
    #[command(after_help = SWEEP_EXITS)]
    Sweep(SweepArgs),
    /// Merge the parts of a sweep or of torture that were played with `--shard`
    #[command(after_help = MERGE_EXITS)]
    Merge(MergeArgs),
    /// Give the parts of a sweep or of torture to an engine, wait, and merge them
    #[command(after_help = SUBMIT_EXITS)]
    Submit(SubmitArgs),
    /// Check scenario and rig files without playing them
    Check(CheckArgs),
    /// List, print or copy the scenarios and rig files that ship with canrig
    Examples(ExamplesArgs),
    /// List the signals of the bus, of a scenario or of a run
    Signals(SignalsArgs),
    /// Write a plant, a law, a rig, a scenario, a controller or a repository of your own
    New(NewArgs),
    /// Check whether this machine has what a test bench needs
    Doctor(DoctorArgs),
    /// Print the JSON Schema of scenario or rig files, for editors
    Schema(SchemaArgs),
    /// List the nodes on a bus, with state, device type, identity and EDS
    Nodes(NodesArgs),
    /// Read or write an object of a node; a running controller is not disturbed
    Sdo(SdoArgs),
    /// Show live traffic, one line per frame, decoded by DBC and EDS
    Monitor(MonitorArgs),
    /// Write the EDS of each node of a rig, for other programs
    Eds(EdsArgs),
    /// List the contents of an FMU, print its table for a rig, or export a plant as an FMU
    Fmu(FmuArgs),
    /// Print the completions of canrig's commands and options for a shell
    Completions(CompletionsArgs),
    /// Write the manual pages
    Man(ManArgs),
    /// One node of the bench as a process of its own; `run` starts these
    #[command(hide = true)]
    Node(NodeArgs),
    /// The process that alone loads an FMU; runs start it
    #[command(hide = true)]
    FmuWorker {
        /// Folder of the FMU's files
        folder: PathBuf,
    },
    /// The process that starts, keeps and ends the program of a law; runs start it
    #[command(hide = true)]
    ProgramKeeper {
        /// File of what the program prints
        #[arg(long)]
        log: Option<PathBuf>,
        /// File that is removed when the program has ended
        #[arg(long)]
        part: Option<PathBuf>,
        /// The program and its arguments
        #[arg(last = true)]
        command: Vec<OsString>,
    },
    /// The process that alone loads the library or the FMU of a law; runs start it
    #[command(hide = true)]
    LawWorker {
        /// The library, or the FMU
        file: PathBuf,
        /// The folder with the files of an FMU
        folder: Option<PathBuf>,
    },
    /// The helper that makes a private bus; `run` starts it
    #[command(hide = true)]
    PrivateBus,
}

/// Returns the command line, whose help lists the commands by group.
pub(crate) fn command_line() -> clap::Command {
    let command_line = Cli::command();
    let mut list = String::new();
    for (group, names) in GROUPS {
        list += &format!("\n{group}:\n");
        for name in names {
            let command = command_line.find_subcommand(name);
            let about = command
                .and_then(clap::Command::get_about)
                .map(ToString::to_string)
                .unwrap_or_default();
            list += &format!("  {name:<12}{about}\n");
        }
    }
    command_line.help_template(format!(
        "{{about}}\n\n{{usage-heading}} {{usage}}\n{list}\n\
         `canrig COMMAND --help` has the options of a command.{{after-help}}"
    ))
}

/// Executes the subcommand.
pub(crate) fn execute(command: Command) -> Result<Exit, Failure> {
    match command {
        Command::Demo(args) => demo(&args),
        Command::Run(args) => run(&args),
        Command::Simulate(args) => simulate(&args),
        Command::Report(args) => report(&args),
        Command::Replay(args) => replay(&args),
        Command::Compare(args) => compare(&args),
        Command::Coverage(args) => coverage(&args),
        Command::Export(args) => export(&args),
        Command::Identify(args) => identify(&args),
        Command::Reproduce(args) => reproduce(&args),
        Command::Torture(args) => torture(&args),
        Command::Sweep(args) => sweep(&args),
        Command::Merge(args) => merge(&args),
        Command::Submit(args) => submit(&args),
        Command::Check(args) => check(&args),
        Command::Examples(args) => examples(&args),
        Command::Signals(args) => signals(&args),
        Command::New(args) => new(&args),
        Command::Doctor(args) => Ok(doctor(&args)),
        Command::Schema(args) => Ok(schema(&args)),
        Command::Nodes(args) => nodes(&args),
        Command::Sdo(args) => sdo(&args),
        Command::Monitor(args) => monitor(args),
        Command::Eds(args) => eds(&args),
        Command::Fmu(args) => fmu(&args),
        Command::FmuWorker { folder } => Ok(served(fmu_worker::serve(&folder))),
        Command::LawWorker { file, folder } => {
            let ended = law_worker::serve(&file, folder.as_deref());
            Ok(served(
                ended.inspect_err(|error| print_error(&error.to_string())),
            ))
        }
        Command::ProgramKeeper { log, part, command } => {
            let told = keeper::keep(log, part, &command);
            Ok(served(told.map(|told| print(&told))))
        }
        Command::Completions(args) => completions(&args, &mut command_line()),
        Command::Man(args) => man(&args, command_line()),
        Command::Node(args) => Ok(host(&args)),
        Command::PrivateBus => {
            let channel = process::channel_from_parent();
            Ok(served(channel.and_then(private_bus::serve)))
        }
    }
}

/// Returns the exit code of a helper, which tells its parent what went wrong by another way.
fn served<E>(ended: Result<(), E>) -> Exit {
    ended.map_or(Exit::BenchFailed, |()| Exit::Pass)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_help_lists_each_visible_command_in_one_group_and_one_line() {
        let command_line = command_line();
        let visible = command_line
            .get_subcommands()
            .filter(|one| !one.is_hide_set());
        let mut visible: Vec<&str> = visible.map(clap::Command::get_name).collect();
        let mut grouped = GROUPS.map(|(_, names)| names).concat();
        visible.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(visible, grouped);
        let help = command_line.clone().render_help().to_string();
        assert!(
            help.lines().all(|line| line.chars().count() <= 100),
            "{help}"
        );
    }

    #[test]
    fn an_option_has_two_lines_of_help_at_most() {
        fn long(command: &clap::Command, place: &str, found: &mut Vec<String>) {
            for argument in command.get_arguments() {
                let help = argument
                    .get_help()
                    .map(ToString::to_string)
                    .unwrap_or_default();
                // Two lines of 100 columns, without the column of the options.
                if help.chars().count() > 140 {
                    found.push(format!("{place} {}: {help}", argument.get_id()));
                }
            }
            for below in command.get_subcommands().filter(|one| !one.is_hide_set()) {
                long(below, &format!("{place} {}", below.get_name()), found);
            }
        }
        let mut found = Vec::new();
        long(&command_line(), "canrig", &mut found);
        assert_eq!(found, Vec::<String>::new());
    }
}
