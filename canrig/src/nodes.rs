//! The nodes of the shipped rig, built from a scenario.

use ::faults::{Faulty, Kind, Plan};
use canopen::Node;
use controller::ControllerNode;
use dbc::Database;
use plant_emulator::catalogue;
use platform::bus::{self, Bus, BusAddress};
use platform::hub;
use platform::process::inherited_channel;
use platform::real_time::RunReport;
use platform::scheduling::Scheduling;
use platform::stop::StopSignal;
use platform::{lockstep, real_time, scheduling};
use scenario::fault::Faults;
use scenario::{ControllerView, Scenario};

use crate::cli::{NodeArgs, Role};
use crate::console::{complain, say};
use crate::exit::Exit;
use crate::rig::LoadedRig;
use crate::timing::{NodeReport, Quantiles};
use crate::world::WorldError;

/// The rig with its drive and its disturbance module.
///
/// # Errors
/// The scenario's plant cannot be emulated.
pub fn plant_emulator(scenario: &Scenario) -> Result<Box<dyn Node>, WorldError> {
    catalogue::emulator(scenario).map_err(|error| WorldError::Node {
        name: "plant-emulator",
        reason: error.to_string(),
    })
}

/// The manager with its control law, for the drive of a rig or the emulated one.
///
/// # Errors
/// The scenario's controller cannot be set up.
pub fn controller(
    view: &ControllerView,
    rig: Option<&LoadedRig>,
) -> Result<ControllerNode, WorldError> {
    let made = match rig {
        Some(loaded) => ControllerNode::on_rig(view, &loaded.rig, &loaded.eds),
        None => ControllerNode::new(view),
    };
    made.map_err(|error| WorldError::Node {
        name: "controller",
        reason: error.to_string(),
    })
}

/// The manager as it behaves in a scenario with faults, which it cannot see; `is_played_elsewhere` are those that happen
/// to its process. `make` makes it, also after a crash.
///
/// # Errors
/// It cannot be made.
pub fn faulty_controller(
    make: impl Fn() -> Result<ControllerNode, WorldError> + Send + 'static,
    faults: &Faults,
    is_played_elsewhere: impl Fn(&Kind) -> bool,
) -> Result<Box<dyn Node>, WorldError> {
    let node = make()?;
    if faults.is_empty() {
        return Ok(Box::new(node));
    }
    let plan = Plan::of(faults, scenario::fault::node::Node::Controller);
    let renew = move |node: &mut ControllerNode| {
        // It could be set up once, so it can again.
        if let Ok(new) = make() {
            *node = new;
        }
    };
    let plan = plan.without(is_played_elsewhere);
    let faulty = Faulty::new(node, plan, Database::shipped(), renew)?;
    Ok(Box::new(faulty))
}

/// The controller's process: what happens to a process in real time is done to it from outside.
fn hosted_controller(args: &NodeArgs) -> Result<Box<dyn Node>, String> {
    let view = ControllerView::load(&args.scenario).map_err(|error| error.to_string())?;
    let scenario = Scenario::load(&args.scenario).map_err(|error| error.to_string())?;
    let rig = args.rig.as_deref().map(LoadedRig::load).transpose();
    let rig = rig.map_err(|error| error.to_string())?;
    let is_real_time = args.host.lockstep.is_none();
    let is_of_process = |kind: &Kind| is_real_time && matches!(kind, Kind::Crash(_) | Kind::Hang);
    let make = move || controller(&view, rig.as_ref());
    faulty_controller(make, &scenario.fault, is_of_process).map_err(|error| error.to_string())
}

/// Runs one node as this process: what the hidden subcommand `node` does.
#[must_use]
pub fn host(args: &NodeArgs) -> Exit {
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
            complain(&reason);
            Exit::BenchFailed
        }
    }
}

/// What the bench is told at the end.
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
            Some(bus::open(address, &node.filters()).map_err(|error| error.to_string())?)
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
            say(&serde_json::to_string(&report).map_err(|error| error.to_string())?);
            Ok(())
        }
        (None, None) => Err("a node needs --bus or --lockstep".to_owned()),
    }
}
