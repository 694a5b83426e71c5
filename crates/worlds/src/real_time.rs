//! Real time: the processes keep their own time on a bus, and the bench listens.

use std::collections::BTreeMap;
use std::thread::ScopedJoinHandle;
use std::time::Duration;

use platform::clock::Clock;
use platform::real_time::RunError;
use scenario::disturbance::Disturbance;

use crate::blame::end_by_node;
use crate::bus_connection::{BusConnection, COLLECT_PERIOD, stop_signal};
use crate::child::NodeProcess;
use crate::disturbance_node::DisturbanceProducer;
use crate::error::{START_PATIENCE, WorldError};
use crate::nodes::{CONTROLLER, PLANT_EMULATOR};
use crate::played::{End, Played};
use crate::process_faults::{ProcessAction, ProcessFaults};
use crate::processes::{Processes, runtime};
use crate::silence::SilenceWatch;
use crate::stalls::StallRecorder;
use crate::supervisor::Supervisor;
use recording::capture::Capture;
use recording::latency::{Host, NodeReport};
use recording::masters::MasterWatch;
use recording::run_folder::RunFolder;
use rig::external::ExternalNode;
use rig::setup::Setup;

/// What the controller needs beyond the bring-up until current flows, with some to spare.
const ENABLE_PATIENCE: Duration = Duration::from_secs(5);

/// Plays the scenario in real time on a bus that is there, with controller and plant as processes unless they are external:
/// to its end, until a node under test ends it, or until what was recorded is enough.
///
/// # Errors
/// The bench or the bus failed, or the recording cannot be written.
pub fn play(
    setup: &Setup,
    folder: &RunFolder,
    capture: &mut Capture<'_>,
    connection: &mut BusConnection,
    is_enough: &mut dyn FnMut(&Capture<'_>) -> bool,
) -> Result<Played, WorldError> {
    let runtime = runtime()?;
    let _entered = runtime.enter();
    let mut processes = start_nodes(setup, folder, connection)?;
    let stalls = StallRecorder::start(setup, &processes)?;
    let mut bench = bench_node(setup)?;
    let mut bus = connection.join(&canopen::Node::filters(&bench))?;
    let (stopper, stop) = stop_signal()?;
    let mut run = Run {
        setup,
        folder,
        connection,
        capture,
        processes: &mut processes,
        stalls: &stalls,
        is_enough,
    };
    let (end, stopped) = std::thread::scope(|scope| {
        let bench = scope.spawn(|| platform::real_time::run(&mut bench, &mut *bus, &stop));
        let (end, stopped) = runtime.block_on(async {
            let end = tokio::select! {
                // Its error is reported below.
                () = ended(&bench) => Ok(End::Interrupted),
                end = run.follow() => end,
            };
            // However the run went, nothing may stay heated or running.
            (end, run.processes.stop().await)
        });
        drop(stopper);
        let bench = bench
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        let end = match bench {
            Err(RunError::Node(violation)) => Err(WorldError::Violation(violation)),
            bench => end.and_then(|end| bench.map(|_| end).map_err(WorldError::Bench)),
        };
        (end, stopped)
    });
    connection.collect(capture)?;
    if let Some(second_master) = bench.second_master() {
        return Err(WorldError::SecondMaster(second_master.to_owned()));
    }
    let (end, mut reports) = with_reports(end, stopped);
    if let Some(controller) = reports.get_mut(CONTROLLER)
        && !setup.scenario.fault.node.hang.is_empty()
    {
        // Suspended on purpose, a loop wakes up late.
        controller.late.clear();
    }
    let stalls = stalls.finish(connection, &mut reports);
    let end = end.or_else(|error| end_by_node(error, setup, capture).map(End::ByNode))?;
    Ok(Played {
        end,
        host: Some(Host {
            controller: reports.remove(CONTROLLER),
            plant_emulator: reports.remove(PLANT_EMULATOR),
            wall_clock_step: connection.wall_clock_step(),
            stalls,
        }),
    })
}

/// Starts the nodes that are not external.
fn start_nodes(
    setup: &Setup,
    folder: &RunFolder,
    connection: &BusConnection,
) -> Result<Processes, WorldError> {
    let mut processes = Vec::new();
    for (name, node) in [
        (PLANT_EMULATOR, ExternalNode::Drive),
        (CONTROLLER, ExternalNode::Controller),
    ] {
        if !setup.external.has(node) {
            let address = Some(connection.address());
            processes.push(NodeProcess::spawn(name, folder, address, None)?);
        }
    }
    Ok(Processes::new(processes))
}

/// The bench's own node, with a supervisor where there is a rig, and a watch for a second master of a drive that is real.
fn bench_node(setup: &Setup) -> Result<DisturbanceProducer, WorldError> {
    let mut orders = setup.scenario.clone();
    if !setup.external.has_fan() {
        // On a bus without the module its identifier may be somebody else's.
        orders.disturbance = Disturbance::default();
    }
    let supervisor = setup
        .rig
        .as_ref()
        .map(|rig| Supervisor::new(&rig.file, &rig.drive));
    let watch = |setup: &Setup| {
        let watch = MasterWatch::new(&setup.scenario, &setup.database, &setup.external);
        watch.map(MasterWatch::while_they_come)
    };
    let has_drive = setup.external.has(ExternalNode::Drive);
    let masters = has_drive.then(|| watch(setup)).transpose()?;
    let bench = DisturbanceProducer::new(&orders, &setup.database)?;
    Ok(bench.with_supervisor(supervisor).with_master_watch(masters))
}

/// Waits until the bench's own node has ended: it has stopped the drive, or failed.
async fn ended<T>(bench: &ScopedJoinHandle<'_, T>) {
    let mut ticks = tokio::time::interval(COLLECT_PERIOD);
    while !bench.is_finished() {
        ticks.tick().await;
    }
}

/// How the run ended, and the reports of the nodes. The first error is why the others stopped.
fn with_reports(
    mut end: Result<End, WorldError>,
    stopped: Vec<(String, Result<String, WorldError>)>,
) -> (Result<End, WorldError>, BTreeMap<String, NodeReport>) {
    let mut reports = BTreeMap::new();
    for (name, stopped) in stopped {
        match stopped {
            Ok(text) => {
                let report = report(&name, &text);
                reports.insert(name, report);
            }
            // One that was killed takes the other with it, which may be noticed first.
            Err(error) if end.is_ok() || error.is_from_outside() => end = Err(error),
            Err(_) => {}
        }
    }
    (end, reports)
}

/// What a node reported of itself at its end.
fn report(name: &str, text: &str) -> NodeReport {
    serde_json::from_str(text).unwrap_or_else(|_| NodeReport {
        refused: vec![format!("the {name} gave no report of its timing")],
        ..NodeReport::default()
    })
}

/// A run while it goes on.
struct Run<'a, 'b> {
    setup: &'a Setup,
    folder: &'a RunFolder,
    connection: &'a mut BusConnection,
    capture: &'a mut Capture<'b>,
    processes: &'a mut Processes,
    stalls: &'a StallRecorder,
    is_enough: &'a mut dyn FnMut(&Capture<'_>) -> bool,
}

impl Run<'_, '_> {
    /// Collects frames until the scenario is over, the user stops it, or something fails.
    async fn follow(&mut self) -> Result<End, WorldError> {
        let clock = Clock::start();
        let mut silence = SilenceWatch::new(self.setup)?;
        let mut faults = ProcessFaults::new(&self.setup.scenario);
        let mut ticks = tokio::time::interval(COLLECT_PERIOD);
        loop {
            tokio::select! {
                error = self.processes.early_end() => return Err(error),
                _ = ticks.tick() => {}
            }
            let now = clock.now();
            self.connection.collect(self.capture)?;
            if self.capture.is_interrupted() {
                return Ok(End::Interrupted);
            }
            if (self.is_enough)(self.capture) {
                return Ok(End::Completed);
            }
            self.play_faults(&mut faults).await?;
            if is_over(self.setup, self.capture.scenario_time(), now)? {
                return Ok(End::Completed);
            }
            silence.check(now, self.capture)?;
        }
    }

    /// Does to the controller's process what the scenario's faults say by now. Faults of an external controller were refused
    /// before the run.
    async fn play_faults(&mut self, faults: &mut ProcessFaults) -> Result<(), WorldError> {
        let controller = self.processes.get_mut(CONTROLLER);
        let (Some(controller), Some(time)) = (controller, self.capture.scenario_time()) else {
            return Ok(());
        };
        while let Some(action) = faults.due(time) {
            match action {
                ProcessAction::Kill => controller.kill_by_fault().await?,
                ProcessAction::Suspend => controller.suspend(true)?,
                ProcessAction::Resume => controller.suspend(false)?,
                ProcessAction::Start => {
                    let address = self.connection.address();
                    *controller = NodeProcess::spawn(CONTROLLER, self.folder, Some(address), None)?;
                    self.stalls.watch(controller);
                }
            }
        }
        Ok(())
    }
}

/// Whether the scenario has come to its end.
///
/// # Errors
/// It never will, since it did not begin.
fn is_over(
    setup: &Setup,
    scenario_time: Option<Duration>,
    now: Duration,
) -> Result<bool, WorldError> {
    let scenario = &setup.scenario;
    let patience = start_patience(setup);
    match scenario_time {
        Some(time) => Ok(time >= Duration::from_secs_f64(scenario.duration_seconds)),
        // A fault that keeps the scenario from beginning is seen to its end.
        None if now > patience && !scenario.fault.is_empty() => Ok(true),
        None if now > patience => Err(WorldError::NoStart { patience }),
        None => Ok(false),
    }
}

/// The drive of a rig may take its time, as its controller knows.
fn start_patience(setup: &Setup) -> Duration {
    let bring_up = setup.rig.as_ref().map(|rig| rig.file.timeouts.bring_up());
    bring_up.map_or(START_PATIENCE, |bring_up| {
        START_PATIENCE.max(bring_up + ENABLE_PATIENCE)
    })
}
