//! `canrig node`: one node as a process of its own.

use std::path::PathBuf;

use canopen::Node;
use clap::{Args, ValueEnum};
use faults::FaultKind;
use platform::bus::{Bus, BusAddress};
use platform::hub;
use platform::process::inherited_channel;
use platform::real_time::RunReport;
use platform::scheduling::Scheduling;
use platform::stop::StopSignal;
use platform::{lockstep, real_time, scheduling};
use scenario::{ControllerView, Scenario};

use recording::latency::{NodeReport, Quantiles};
use rig::rig_file::LoadedRig;
use runner::console::{print, print_error};
use runner::exit::Exit;
use worlds::nodes::{controller, faulty_controller, plant_emulator};

/// Arguments of `node`.
#[derive(Args, Debug)]
pub(crate) struct NodeArgs {
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
    pub host: HostArgs,
}

/// Which node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Role {
    /// The manager with its control law
    Controller,
    /// The rig
    PlantEmulator,
}

/// Where a node lives.
#[derive(Args, Debug)]
pub(crate) struct HostArgs {
    /// The bus, such as `can0` or `embedded:/path`; in lock-step only where frames cross a real bus
    #[arg(long)]
    pub bus: Option<BusAddress>,
    /// File descriptor of the side channel; its presence means lock-step
    #[arg(long)]
    pub lockstep: Option<i32>,
}

/// The controller's process: what happens to a process in real time is done to it from outside.
fn hosted_controller(args: &NodeArgs) -> Result<Box<dyn Node>, String> {
    let view = ControllerView::load(&args.scenario).map_err(|error| error.to_string())?;
    let scenario = Scenario::load(&args.scenario).map_err(|error| error.to_string())?;
    let rig = args
        .rig
        .as_deref()
        .map(LoadedRig::load)
        .transpose()
        .map_err(|error| error.to_string())?;
    let is_real_time = args.host.lockstep.is_none();
    let is_of_process =
        |kind: &FaultKind| is_real_time && matches!(kind, FaultKind::Crash(_) | FaultKind::Hang);
    let make = move || controller(&view, rig.as_ref());
    faulty_controller(make, &scenario.fault, is_of_process).map_err(|error| error.to_string())
}

/// Runs one node as this process: what the hidden subcommand `node` does.
#[must_use]
pub(crate) fn host(args: &NodeArgs) -> Exit {
    let hosted = match args.role {
        Role::Controller => hosted_controller(args).and_then(|mut node| run_node(&mut *node, args)),
        Role::PlantEmulator => Scenario::load(&args.scenario)
            .map_err(|error| error.to_string())
            .and_then(|scenario| plant_emulator(&scenario).map_err(|error| error.to_string()))
            .and_then(|mut node| run_node(&mut *node, args)),
    };
    match hosted {
        Ok(()) => Exit::Pass,
        Err(reason) => {
            print_error(&reason);
            Exit::BenchFailed
        }
    }
}

/// What the bench receives at the end.
fn node_report(report: &RunReport, scheduling: &Scheduling) -> NodeReport {
    NodeReport {
        ticks: report.ticks,
        overruns: report.overruns,
        wake_up_lateness_microseconds: Quantiles::of(&report.lateness_nanoseconds, 1000),
        frames_dropped: report.frames_dropped,
        frames_delayed: report.frames_delayed,
        refused: scheduling.refusals().map(ToString::to_string).collect(),
    }
}

fn run_node(node: &mut dyn Node, args: &NodeArgs) -> Result<(), String> {
    let ended = run_on_bus(node, args);
    if let Some(BusAddress::Embedded(socket)) = &args.host.bus {
        hub::remove_orphaned(socket);
    }
    ended
}

fn run_on_bus(node: &mut dyn Node, args: &NodeArgs) -> Result<(), String> {
    let stop = StopSignal::from_parent().map_err(|error| error.to_string())?;
    let is_real_time = args.host.lockstep.is_none();
    // Before the bus: who enters a private one loses the right to the priority, but not the priority.
    let fifo = is_real_time.then(|| scheduling::request_fifo(scheduling::NODE_PRIORITY));
    let mut bus = match &args.host.bus {
        Some(address) => {
            Some(platform::open(address, &node.filters()).map_err(|error| error.to_string())?)
        }
        None => None,
    };
    let bus = bus.as_mut().map(|bus| &mut **bus as &mut dyn Bus);
    match (args.host.lockstep, bus) {
        (Some(number), wire) => {
            let channel = inherited_channel(number).map_err(|error| error.to_string())?;
            lockstep::follow(node, channel, wire).map_err(|error| error.to_string())
        }
        (None, Some(bus)) => {
            let scheduling = Scheduling {
                fifo: fifo.unwrap_or(Ok(())),
                memory: scheduling::lock_memory(),
            };
            let report = real_time::run(node, bus, &stop).map_err(|error| error.to_string())?;
            let report = node_report(&report, &scheduling);
            print(&serde_json::to_string(&report).map_err(|error| error.to_string())?);
            Ok(())
        }
        (None, None) => Err("a node needs --bus or --lockstep".to_owned()),
    }
}
