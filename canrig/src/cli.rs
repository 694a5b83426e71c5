//! The command line.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use platform::bus::BusAddress;

use crate::external::ExternalNode;
use crate::identify::start::Start;
use crate::new::NewArgs;
use crate::recordings::args::{CompareArgs, CoverageArgs, ExportArgs, ReplayArgs, ReportArgs};
use crate::sweep::args::{MergeArgs, SweepArgs};
use crate::tools::ToolBus;
use crate::tools::nodes::LISTEN_SECONDS;
use crate::viewer::ViewerArgs;

const EXAMPLES: &str = "\
Examples:
  canrig run scenarios/step.toml             two processes on a bus, judged
  canrig run scenarios/ --clock lockstep     every scenario, in virtual time
  canrig run step.toml --bus vcan0           over the kernel's SocketCAN
  canrig run step.toml --bus can0 --external drive
                                             with a real drive
  canrig run step.toml --rig rig.toml --dry-run
                                             only the checks before current flows
  canrig run scenarios/step.toml --viewer    and watch it while it runs
  canrig simulate scenarios/step.toml        in one process, at once
  canrig identify RUN                        the plant from a recording
  canrig reproduce                           every experiment of the paper, on one page
  canrig torture scenarios/torture.toml      does anything break it?
  canrig sweep scenarios/sweeps/plants.toml  a run for each of many values
  canrig check scenarios/                    are the files valid?
  canrig report runs/* --output all.html     several runs on one page
  canrig replay RUN                          judge a recording again
  canrig replay RUN --viewer --speed 0.1     and watch it in slow motion
  canrig compare RUN OTHER_RUN               where do two runs diverge?
  canrig coverage runs/* --requirements requirements.csv
                                             which requirement is tested, and met?
  canrig export RUN -f blf -o run.blf        for another program
  canrig new plant pendulum                  a plant of your own, in a crate of its own
  canrig new law fuzzy                       a control law of your own
  canrig doctor                              is this machine fit for real time?
  canrig nodes --bus vcan0                   who is on the bus?
  canrig sdo read drive 0x6064               one object of a node in a run
  canrig sdo write 0x10 1017 50 --bus can0   and change one
  canrig monitor --only drive --changes      live traffic, decoded

Exit codes:
  0 pass · 1 a limit was not met, or runs diverge · 2 usage
  3 scenario or recording invalid · 4 bus or process failed
  5 inconclusive (timing not trustworthy, or a limit on what nobody tells)
  70 internal error · 130 interrupted";

const COVERAGE_EXITS: &str = "\
Exit codes:
  0 every requirement is met · 1 one failed, its run broke off, or nothing tests it
  3 a run folder or the list is invalid · 4 the page cannot be written · 5 one is inconclusive, none worse";

const SWEEP_EXITS: &str = "\
Exit codes, of the worst run:
  0 pass · 1 a limit was not met · 3 values make no valid scenario, or the file is none; for merge: a run is missing
  4 a run broke off, or a file cannot be written · 5 inconclusive · 70 internal error · 130 interrupted";

/// Proves a controller against a plant over a CAN bus, before the real drive is on the table.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Play scenarios with controller and plant as processes on a CAN bus, and judge them
    Run(RunArgs),
    /// Play scenarios in one process and virtual time, and judge them
    Simulate(SimulateArgs),
    /// Make report.html again from run folders, or one page that compares several
    Report(ReportArgs),
    /// Judge a recording again, from its bus.log alone
    Replay(ReplayArgs),
    /// Find out where two runs diverge
    Compare(CompareArgs),
    /// Show which requirement is tested by which scenario, and what came of it
    #[command(after_help = COVERAGE_EXITS)]
    Coverage(CoverageArgs),
    /// Write a recording in another program's format
    Export(ExportArgs),
    /// Find the plant's parameters from recordings
    Identify(IdentifyArgs),
    /// Play every experiment of the paper and write one page with its figures and numbers
    Reproduce(ReproduceArgs),
    /// Play random mixes of faults in virtual time, and shrink what breaks an invariant to a minimal scenario
    Torture(TortureArgs),
    /// Play a scenario many times, with the values that its [sweep] says, on all cores; goes on where it was stopped
    #[command(after_help = SWEEP_EXITS)]
    Sweep(SweepArgs),
    /// Put the parts of a sweep together that `sweep --shard` played
    #[command(after_help = SWEEP_EXITS)]
    Merge(MergeArgs),
    /// Check scenario and rig files without playing them
    Check(CheckArgs),
    /// Write the crate of a plant or a control law of your own, with a bench that knows it
    New(NewArgs),
    /// Look at what of this machine serves a test bench, and how to mend what does not
    Doctor(DoctorArgs),
    /// Print the JSON Schema of scenario files, for editors
    Schema {
        /// That of rig files instead
        #[arg(long)]
        rig: bool,
    },
    /// List the nodes on a bus: number, NMT state, device type, identity, and which EDS describes them
    Nodes(NodesArgs),
    /// Read or write an object of a node, without disturbing a running controller
    Sdo(SdoArgs),
    /// Show live traffic, one line per frame, decoded by DBC and EDS
    Monitor(MonitorArgs),
    /// Print what makes your shell complete canrig's commands and options
    Completions {
        /// The shell
        #[arg(value_enum)]
        shell: clap_complete::Shell,
    },
    /// Write the manual pages
    Man {
        /// The folder for them, such as ~/.local/share/man/man1
        #[arg(value_name = "FOLDER")]
        folder: PathBuf,
    },
    /// One node of the bench as a process of its own; `run` starts these
    #[command(hide = true)]
    Node(NodeArgs),
    /// The helper that makes a private bus; `run` starts it
    #[command(hide = true)]
    PrivateBus {
        /// File descriptor of the channel to the bench
        channel: i32,
    },
}

/// Scenarios and what to do with their results.
#[derive(Args, Debug)]
pub struct PlayArgs {
    /// Scenario files, or folders of them
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<PathBuf>,
    /// Where run folders are made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Print the verdicts as JSON instead of tables
    #[arg(long)]
    pub json: bool,
    /// Print nothing but failures
    #[arg(long, short, conflicts_with = "json")]
    pub quiet: bool,
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub viewer: ViewerArgs,
}

/// Arguments of `run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub play: PlayArgs,
    /// The bus: `auto`, `private` (a vcan that only this run sees), `embedded` (a socket private to you) or a CAN
    /// interface such as `vcan0`
    #[arg(long, value_name = "BUS", default_value = "auto")]
    pub bus: BusChoice,
    /// Which time the processes live in
    #[arg(long, value_enum, default_value_t = ClockChoice::RealTime)]
    pub clock: ClockChoice,
    /// Nodes that canrig does not start but expects on the bus, such as a real drive. Limits on what then nobody tells are
    /// not judged, and end a run that fails no other in exit code 5
    #[arg(long, value_enum, value_name = "NODE", value_delimiter = ',')]
    pub external: Vec<ExternalNode>,
    /// The rig file of a real drive, which is then external: its bus, objects, scaling, time-outs and hard limits. Without it,
    /// `rig.toml` beside the first scenario goes with --external drive
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// End after the pre-flight of an external drive: interface, nodes, objects, direction under a slow heating ramp, stop
    #[arg(long)]
    pub dry_run: bool,
    /// In the pre-flight, do not heat the wire until the load moves
    #[arg(long)]
    pub no_heating: bool,
    /// Fail unless the bus is the kernel's own, so that a CI job cannot skip it silently
    #[arg(long)]
    pub require_vcan: bool,
}

/// Arguments of `simulate`.
#[derive(Args, Debug)]
pub struct SimulateArgs {
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub play: PlayArgs,
}

/// Arguments of `identify`.
#[derive(Args, Debug)]
pub struct IdentifyArgs {
    /// Run folders, or logs of `candump -L` (then with --scenario); all of one plant
    #[arg(required = true, value_name = "RUN")]
    pub recordings: Vec<PathBuf>,
    /// What to find: the paper's letters or the keys of the scenario's [plant], separated by commas
    #[arg(long, value_name = "LIST", default_value = "C,h,As,Af,Ms,Mf")]
    pub parameters: String,
    /// Where to start: `section3` (the paper's a-priori values), `nominal`, or a file with a [plant] table
    #[arg(long, value_name = "START", default_value = "section3")]
    pub start: Start,
    /// What the other parameters are: `nominal`, `scenario` (the recording's [plant]), or a file with a [plant] table
    #[arg(long, value_name = "PLANT", default_value = "nominal")]
    pub known: KnownChoice,
    /// The scenario that was played, for logs; it gives cycle time and sensor
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// The DBC of the recordings, if not the rig's own
    #[arg(long, value_name = "FILE")]
    pub dbc: Option<PathBuf>,
    /// Where the folder with the result is made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Print nothing but failures
    #[arg(long, short)]
    pub quiet: bool,
}

/// Arguments of `reproduce`.
#[derive(Args, Debug)]
pub struct ReproduceArgs {
    /// Where the folder with the page is made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Fewer plants, frequencies and settings: to see that everything works
    #[arg(long)]
    pub reduced: bool,
    /// Print the numbers as JSON instead of a table
    #[arg(long)]
    pub json: bool,
    /// Print nothing but failures
    #[arg(long, short, conflicts_with = "json")]
    pub quiet: bool,
}

/// What is taken as known of the plant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KnownChoice {
    /// The nominal plant.
    Nominal,
    /// The plant of the first recording's scenario.
    Scenario,
    /// The plant of a file.
    File(PathBuf),
}

impl FromStr for KnownChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "nominal" => Self::Nominal,
            "scenario" => Self::Scenario,
            path => Self::File(path.into()),
        })
    }
}

/// Arguments of `torture`.
#[derive(Args, Debug)]
pub struct TortureArgs {
    /// The scenario that the faults meet; its own faults and limits are left out
    pub scenario: PathBuf,
    /// How many mixes
    #[arg(long, value_name = "COUNT", default_value_t = 1000)]
    pub runs: usize,
    /// What they are drawn from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    pub seed: u64,
    /// Where the folders of failing cases are made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

/// Arguments of `check`.
#[derive(Args, Debug)]
pub struct CheckArgs {
    /// Scenario or rig files, or folders of them
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<PathBuf>,
}

/// The bus that a tool joins.
#[derive(Args, Debug)]
pub struct ToolBusArgs {
    /// The bus: `embedded` (that of your only running `canrig run`), `embedded:/path` or `private:number` (a
    /// run tells its own), or a CAN interface such as `vcan0`
    #[arg(long, value_name = "BUS", default_value_t = ToolBus::Running)]
    pub bus: ToolBus,
}

/// Arguments of `nodes`.
#[derive(Args, Debug)]
pub struct NodesArgs {
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub bus: ToolBusArgs,
    /// More EDS files to recognise nodes by, besides those of the rig
    #[arg(long, value_name = "FILE")]
    pub eds: Vec<PathBuf>,
    /// How long to listen for heartbeats before nodes are asked
    #[arg(long, value_name = "SECONDS", default_value_t = LISTEN_SECONDS, value_parser = seconds)]
    pub listen: f64,
}

/// Arguments of `sdo`.
#[derive(Args, Debug)]
pub struct SdoArgs {
    /// What to do with the object.
    #[command(subcommand)]
    pub action: SdoAction,
}

/// What to do with an object.
#[derive(Debug, Subcommand)]
pub enum SdoAction {
    /// Read an object
    Read(ObjectArgs),
    /// Write an object
    Write {
        #[command(flatten)]
        #[expect(
            missing_docs,
            reason = "clap shows the doc comment of a flattened field as help"
        )]
        object: ObjectArgs,
        /// The value, in the object's type: a number (decimal, 0x, 0b), text, or bytes in hexadecimal digits
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
}

/// An object of a node.
#[derive(Args, Debug)]
pub struct ObjectArgs {
    /// The node: its number (16, 0x10) or `controller`, `drive`, `disturbance`
    pub node: String,
    /// The object: index and sub-index (6064, 0x1018:02) or its name in the EDS ("Statusword")
    pub object: String,
    /// The node's EDS, if it is none of the rig's
    #[arg(long, value_name = "FILE")]
    pub eds: Option<PathBuf>,
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub bus: ToolBusArgs,
}

/// Arguments of `monitor`.
#[derive(Args, Debug)]
pub struct MonitorArgs {
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub bus: ToolBusArgs,
    /// Show only these: parts of names (drive, sync, heartbeat) or identifiers (0x190)
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Leave these out
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub except: Vec<String>,
    /// Show a frame only when its content has changed
    #[arg(long)]
    pub changes: bool,
    /// Show the bytes too
    #[arg(long)]
    pub raw: bool,
    /// End after so many lines
    #[arg(long, value_name = "LINES")]
    pub count: Option<u64>,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    /// A DBC file instead of the rig's
    #[arg(long, value_name = "FILE")]
    pub dbc: Option<PathBuf>,
}

/// A time from 0 to a day.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text
        .parse()
        .map_err(|_| "a number of seconds is expected")?;
    if (0.0..=86_400.0).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("0 to 86400 seconds are possible".to_owned())
    }
}

/// Arguments of `doctor`.
#[derive(Args, Debug)]
pub struct DoctorArgs {
    /// End with exit code 4 when something is amiss
    #[arg(long)]
    pub strict: bool,
}

/// Which time the processes live in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ClockChoice {
    /// The machine's clock
    RealTime,
    /// Virtual time: a verdict that no busy machine can bend
    Lockstep,
}

/// Which bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusChoice {
    /// The best that this machine permits.
    Auto,
    /// A vcan in a namespace of the run's own.
    Private,
    /// A socket in a folder of the user's own, served by canrig.
    Embedded,
    /// A CAN interface of the kernel.
    Interface(String),
}

impl FromStr for BusChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "private" => Ok(Self::Private),
            "embedded" => Ok(Self::Embedded),
            name => match name.parse() {
                Ok(BusAddress::Interface(interface)) => Ok(Self::Interface(interface)),
                Ok(BusAddress::Embedded(_) | BusAddress::Private(_)) => {
                    Err("canrig makes such a bus itself; say `embedded` or `private`".to_owned())
                }
                Err(error) => Err(error.to_string()),
            },
        }
    }
}

/// Arguments of `node`.
#[derive(Args, Debug)]
pub struct NodeArgs {
    /// Which node
    #[arg(value_enum)]
    pub role: Role,
    /// The scenario
    #[arg(long)]
    pub scenario: PathBuf,
    /// The rig file; none for the emulated drive
    #[arg(long)]
    pub rig: Option<PathBuf>,
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub host: HostArgs,
}

/// Which node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Role {
    /// The manager with its control law
    Controller,
    /// The rig
    PlantEmulator,
}

/// Where a node lives.
#[derive(Args, Debug)]
pub struct HostArgs {
    /// The bus, such as `can0` or `embedded:/path`; in lock-step only where frames cross a real bus
    #[arg(long)]
    pub bus: Option<BusAddress>,
    /// File descriptor of the side channel; its presence means lock-step
    #[arg(long)]
    pub lockstep: Option<i32>,
}
