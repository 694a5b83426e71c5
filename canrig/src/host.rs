//! One node as a process of its own: `canrig node`, which a run starts, and `controller` and `plant-emulator`, which a hand starts.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use can::Node;
use clap::{Args, Command, CommandFactory, FromArgMatches, Parser, ValueEnum};
use platform::bus::{Bus, BusAddress};
use platform::hub;
use platform::process::channel_from_parent;
use platform::real_time::{RunError, RunReport};
use platform::stop::StopSignal;
use platform::{lockstep, real_time, scheduling};
use scenario::without_colours;

use crate::bench::Bench;
use crate::cli::Cli;
use plan::Plan;
use recording::latency::{NodeReport, Quantiles};
use runner::console::{print, print_error};
use runner::exit::{Exit, Failure};
use worlds::catalogue::catalogue;
use worlds::law_process::LawPlace;
use worlds::names::emulator_names;
use worlds::nodes::{faulty_controller, plant_emulator};

/// Arguments of `node`.
#[derive(Args, Debug)]
pub(crate) struct NodeArgs {
    /// Node to play
    #[arg(value_enum)]
    pub role: Role,
    /// The scenario
    #[arg(long)]
    pub scenario: PathBuf,
    /// The plant that it emulates, where a scenario has several
    #[arg(long)]
    pub plant: Option<String>,
    /// The folder in which the processes of the laws run
    #[arg(long)]
    pub laws_in: Option<PathBuf>,
    /// The bus, such as `can0` or `embedded:/path`; in lock-step only where frames cross a real bus
    #[arg(long)]
    pub bus: Option<BusAddress>,
    /// Lock-step; the standard input is the side channel
    #[arg(long)]
    pub lockstep: bool,
}

/// Node that the process plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Role {
    /// The manager with its control law
    Controller,
    /// The rig
    PlantEmulator,
}

/// Arguments of a node that is started by hand.
#[derive(Parser)]
#[command(version)]
struct HandArgs {
    /// The bus, such as `can0` or `embedded:/path/to/socket`
    #[arg(long)]
    bus: BusAddress,
    /// The scenario
    #[arg(long)]
    scenario: PathBuf,
    /// The plant that is emulated, where a scenario has several
    #[arg(long)]
    plant: Option<String>,
}

/// Plays the node of this name on a bus until Ctrl-C, for a program that is started by hand or on another machine. Its exit codes
/// are 0, 2 for a wrong command line, 3 for a node that cannot be set up, 4 for one that ended.
pub fn by_hand(name: &'static str, about: &'static str) -> ExitCode {
    // The helpers of FMUs and laws are processes of the same program.
    let is_helper = |word| (Cli::command().find_subcommand(word)).is_some_and(Command::is_hide_set);
    if std::env::args_os().nth(1).is_some_and(is_helper) {
        return Bench::new().main();
    }
    let command = HandArgs::command().name(name).about(about);
    let parsed = HandArgs::from_arg_matches(&command.get_matches());
    let HandArgs {
        bus,
        scenario,
        plant,
    } = parsed.unwrap_or_else(|error| error.exit());
    let args = NodeArgs {
        role: Role::from_str(name, false).expect("the name of a role"),
        scenario,
        plant,
        laws_in: None,
        bus: None,
        lockstep: false,
    };
    let refused = scheduling::request_fifo(scheduling::NODE_PRIORITY).err();
    let hosted = hosted(&args, &Arc::default());
    let ended = hosted.and_then(|mut node| run_by_hand(&mut *node, &bus, refused));
    exit(ended).into()
}

/// Returns the failure of a node that cannot be set up, so that the run does not begin.
fn in_plan(error: impl ToString) -> Failure {
    Exit::CannotStart.because(error)
}

/// Returns the failure of the bus or the system, not of the node.
fn on_bus(error: impl ToString) -> Failure {
    Exit::BenchFailed.because(error)
}

/// Returns the failure of a node's loop. The exit code tells the bench which part has caused it.
fn in_loop(error: RunError) -> Failure {
    match error {
        RunError::Bus(_) | RunError::System(_) => on_bus(error),
        RunError::Node(_) => Exit::VerdictFailed.because(error),
    }
}

/// Makes the controller.
fn hosted_controller(
    args: &NodeArgs,
    plan: &Plan,
    late: &Arc<AtomicU64>,
) -> Result<Box<dyn Node>, Failure> {
    let planned = LawPlace::of(plan);
    // The scenario is the copy in the folder of the run.
    let run = args.scenario.parent().map(Path::to_owned);
    let place = LawPlace {
        folder: args.laws_in.clone().unwrap_or(planned.folder),
        logs: run.filter(|_| args.laws_in.is_some()),
        is_real_time: !args.lockstep,
        late: Arc::clone(late),
        ..planned
    };
    faulty_controller(plan, place).map_err(in_plan)
}

fn hosted_emulator(args: &NodeArgs, plan: &Plan) -> Result<Box<dyn Node>, Failure> {
    let names = emulator_names(&plan.loops);
    let plant = match (args.plant.as_deref(), &names[..]) {
        (None, [only]) => only,
        (Some(named), names) if names.contains(&named) => named,
        (_, [_]) => return Err(in_plan("there is one plant: leave out --plant")),
        (_, names) => {
            let known = names.join("`, `");
            let reason = format!("name a plant of the scenario by --plant: `{known}`");
            return Err(in_plan(reason));
        }
    };
    plant_emulator(plan, plant).map_err(in_plan)
}

/// Runs one node as this process, for the hidden subcommand `node`.
pub(crate) fn host(args: &NodeArgs) -> Exit {
    let is_real_time = !args.lockstep;
    // Before the node: the worker of an FMU gets a priority if this thread has one. And before the bus: a process that
    // enters a private one loses the right to the priority, but not the priority.
    let fifo = is_real_time.then(|| scheduling::request_fifo(scheduling::NODE_PRIORITY));
    let refused = fifo.and_then(Result::err);
    let late = Arc::default();
    let hosted = hosted(args, &late);
    exit(hosted.and_then(|mut node| {
        let ended = run_node(&mut *node, args, refused, &late);
        if let Some(BusAddress::Embedded(socket)) = &args.bus {
            hub::remove_orphaned(socket);
        }
        ended
    }))
}

fn hosted(args: &NodeArgs, late: &Arc<AtomicU64>) -> Result<Box<dyn Node>, Failure> {
    let loaded = Plan::load(&args.scenario, catalogue());
    let plan = loaded.map_err(|error| in_plan(without_colours(&error)))?;
    match args.role {
        Role::Controller => hosted_controller(args, &plan, late),
        Role::PlantEmulator => hosted_emulator(args, &plan),
    }
}

fn exit(ended: Result<(), Failure>) -> Exit {
    match ended {
        Ok(()) => Exit::Pass,
        Err(Failure { exit, reason, .. }) => {
            print_error(&reason);
            exit
        }
    }
}

fn run_by_hand(
    node: &mut dyn Node,
    address: &BusAddress,
    refused_priority: Option<String>,
) -> Result<(), Failure> {
    let stop = StopSignal::from_signals().map_err(on_bus)?;
    let mut bus = platform::open(address, &node.filters()).map_err(on_bus)?;
    for refused in refusals(refused_priority) {
        print_error(&format!("warning: {refused}"));
    }
    let report = real_time::run(node, &mut *bus, &stop).map_err(on_bus)?;
    print_error(&report.to_string());
    Ok(())
}

/// Locks the memory; returns all means of real time that the system refused.
fn refusals(priority: Option<String>) -> impl Iterator<Item = String> {
    priority.into_iter().chain(scheduling::lock_memory().err())
}

/// Returns the report that the bench receives at the end.
fn node_report(report: RunReport, refused: Vec<String>, late: &AtomicU64) -> NodeReport {
    NodeReport {
        ticks: report.ticks,
        overruns: report.overruns,
        wake_up_lateness_microseconds: Quantiles::new(&report.lateness_nanoseconds, 1000),
        frames_dropped: report.frames_dropped,
        frames_delayed: report.frames_delayed,
        late_answers: late.load(Ordering::Relaxed),
        refused,
        sent: report.sent_frames().collect(),
        late: report.late,
    }
}

fn run_node(
    node: &mut dyn Node,
    args: &NodeArgs,
    refused_priority: Option<String>,
    late: &AtomicU64,
) -> Result<(), Failure> {
    let stop = StopSignal::from_parent().map_err(on_bus)?;
    let filters = if args.lockstep {
        node.filters_as_configured()
    } else {
        node.filters()
    };
    let opened = args
        .bus
        .as_ref()
        .map(|address| platform::open(address, &filters));
    let mut wire = opened.transpose().map_err(on_bus)?;
    let bus = wire.as_mut().map(|bus| &mut **bus as &mut dyn Bus);
    match (args.lockstep, bus) {
        (true, wire) => {
            let channel = channel_from_parent().map_err(on_bus)?;
            lockstep::follow(node, channel, wire).map_err(on_bus)
        }
        (false, Some(bus)) => {
            let refused = refusals(refused_priority).collect();
            let (report, ended) = real_time::run_reporting(node, bus, &stop);
            let report = node_report(report, refused, late);
            print(&serde_json::to_string(&report).map_err(on_bus)?);
            ended.map_err(in_loop)
        }
        (false, None) => Err(in_plan("a node needs --bus or --lockstep")),
    }
}
