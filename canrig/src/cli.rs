//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory, Parser, Subcommand};
use platform::{keeper, private_bus, process};

use crate::doctor::{DoctorArgs, doctor};
use crate::eds::{EdsArgs, eds};
use crate::fmu::play::{PlayArgs, play};
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
use runner::exit::Exit;
use worlds::fmu_worker;
use worlds::law_worker;

const EXAMPLES: &str = "\
Examples:
  canrig run scenarios/step.toml             two processes on a bus, judged
  canrig run scenarios/ --clock lockstep     every scenario, in virtual time
  canrig run step.toml --bus vcan0           over the kernel's SocketCAN
  canrig run step.toml --bus can0 --external drive
                                             with a real drive
  canrig run step.toml --rig desk.toml --bus can0 --dry-run
                                             only the checks before current flows
  canrig run scenarios/step.toml --viewer    and watch it while it runs
  canrig simulate scenarios/step.toml        in one process, at once
  canrig simulate step --set reference.step[0].position_millimetres=20
                                             one that ships, with another value
  canrig simulate step -- ./controller       your own controller in place of the law
  canrig examples --to scenarios             all that ship, as files
  canrig identify RUN                        the wire's parameters from a recording
  canrig reproduce                           the paper's experiments, on one page
  canrig torture scenarios/torture.toml      which mixes of faults break an invariant?
  canrig sweep scenarios/sweeps/plants.toml  one run for each combination of values
  canrig submit big.toml --engine slurm --parts 100
                                             and on the machines of a cluster
  canrig check scenarios/                    are the files valid?
  canrig signals my.toml                     which signals can [expect] name?
  canrig report runs/* --output all.html     several runs on one page
  canrig replay RUN                          judge a recording again
  canrig replay RUN --viewer --speed 0.1     and watch it in slow motion
  canrig compare RUN OTHER_RUN               where do two runs diverge?
  canrig coverage runs/* --requirements requirements.csv
                                             which requirement is tested, and met?
  canrig export RUN -f blf -o run.blf        the frames as Vector's binary log
  canrig new plant hot_plate                 a plant of your own, in a crate of its own
  canrig new law fuzzy                       a control law of your own
  canrig new controller lift --language c    a controller of your own, in C or Python
  canrig fmu motor.fmu                       a plant from a modelling tool: its ports
  canrig fmu --export dc_motor -o motor.fmu  one of ours, for another tool
  canrig doctor                              what does this machine lack?
  canrig nodes --bus vcan0                   who is on the bus?
  canrig sdo read drive 6064:00              one object of a node in a run
  canrig sdo write 16 1017:00 50 --bus can0  and change one
  canrig monitor --only drive --changes      live traffic, decoded

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
  3 a run is missing or invalid, or a part is that of another sweep
  4 a run broke off, or a file cannot be written · 5 inconclusive · 70 internal error";

const SUBMIT_EXITS: &str = "\
Exit codes, of the worst run:
  0 pass · 1 a limit was not met
  3 the file is invalid, or the campaign was submitted otherwise before
  4 the engine is not there or refuses, parts were lost too often, a run broke off, or a file cannot be written
  5 inconclusive · 70 internal error
  130 interrupted: the job goes on, and --resume waits for it";

/// Tests a controller against a plant over a CAN bus: simulated, in real time, and with real hardware.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES, max_term_width = 100)]
pub(crate) struct Cli {
    /// Subcommand to execute.
    #[command(subcommand)]
    pub command: Command,
}

/// Subcommand.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Play scenarios with controller and plant as processes on a CAN bus, and judge them
    Run(RunArgs),
    /// Play scenarios in one process, in virtual time, and judge them
    Simulate(SimulateArgs),
    /// Write the pages of run folders again, and a page that compares several runs
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
    /// Play every experiment of the paper on the shape-memory-alloy wire, and write one page with its figures and numbers
    Reproduce(ReproduceArgs),
    /// Play random combinations of faults in virtual time, and reduce each one that breaks an invariant to a minimal scenario
    Torture(TortureArgs),
    /// Play a scenario with each combination of values in its [sweep] table, on all cores; an interrupted sweep is continued
    #[command(after_help = SWEEP_EXITS)]
    Sweep(SweepArgs),
    /// Merge the parts of a sweep, or of torture, that were played with `--shard`
    #[command(after_help = MERGE_EXITS)]
    Merge(MergeArgs),
    /// Give the parts of a sweep, or of torture, to an engine that runs them on many machines; wait, and merge them
    #[command(after_help = SUBMIT_EXITS)]
    Submit(SubmitArgs),
    /// Check scenario and rig files without playing them
    Check(CheckArgs),
    /// List the scenarios and rig files that ship with canrig, print one, or copy them to a folder
    Examples(ExamplesArgs),
    /// List the signals of the bus, of a scenario or of a run: name, unit, sender, message, range
    Signals(SignalsArgs),
    /// Write a crate for a plant or a control law of your own, with a program that knows it
    New(NewArgs),
    /// Check whether this machine has what a test bench needs, and print the commands that install what is missing
    Doctor(DoctorArgs),
    /// Print the JSON Schema of scenario or rig files, for editors
    Schema(SchemaArgs),
    /// List the nodes on a bus: number, NMT state, device type, identity, and which EDS describes them
    Nodes(NodesArgs),
    /// Read or write an object of a node; a running controller is not disturbed
    Sdo(SdoArgs),
    /// Show live traffic, one line per frame, decoded by DBC and EDS
    Monitor(MonitorArgs),
    /// Write the EDS of each node of a rig, for other programs
    Eds(EdsArgs),
    /// List what an FMU (FMI 2.0, 3.0) says of itself, print its table for a rig file, or write a plant as an FMU
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
        /// File descriptor of the channel to the plant
        channel: i32,
    },
    /// The process that starts, keeps and ends the program of a law; runs start it
    #[command(hide = true)]
    ProgramKeeper {
        /// File of what the program prints
        #[arg(long)]
        log: Option<PathBuf>,
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
    /// An FMU by itself, as CSV
    #[command(hide = true)]
    FmuPlay(PlayArgs),
    /// The helper that makes a private bus; `run` starts it
    #[command(hide = true)]
    PrivateBus {
        /// File descriptor of the channel to the bench
        channel: i32,
    },
}

/// Executes the subcommand.
#[must_use]
pub(crate) fn execute(cli: Cli) -> Exit {
    match cli.command {
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
        Command::Doctor(args) => doctor(&args),
        Command::Schema(args) => schema(&args),
        Command::Nodes(args) => nodes(&args),
        Command::Sdo(args) => sdo(&args),
        Command::Monitor(args) => monitor(args),
        Command::Eds(args) => eds(&args),
        Command::Fmu(args) => fmu(&args),
        Command::FmuPlay(args) => play(&args),
        Command::FmuWorker { channel } => {
            fmu_worker::serve(channel).map_or(Exit::BenchFailed, |()| Exit::Pass)
        }
        Command::LawWorker { file, folder } => match law_worker::serve(&file, folder.as_deref()) {
            Ok(()) => Exit::Pass,
            Err(error) => {
                print_error(&error.to_string());
                Exit::BenchFailed
            }
        },
        Command::ProgramKeeper { log, command } => {
            let told = keeper::keep(log, &command);
            told.map_or(Exit::BenchFailed, |told| {
                print(&told);
                Exit::Pass
            })
        }
        Command::Completions(args) => completions(&args, &mut Cli::command()),
        Command::Man(args) => man(&args, Cli::command()),
        Command::Node(args) => host(&args),
        Command::PrivateBus { channel } => {
            let served = process::inherited_channel(channel).and_then(private_bus::serve);
            served.map_or(Exit::BenchFailed, |()| Exit::Pass)
        }
    }
}
