//! Real time: the processes keep their own time on a bus, and the bench listens.

use std::thread::ScopedJoinHandle;
use std::time::Duration;

use platform::clock::Clock;
use platform::real_time::RunError;
use platform::scheduling;
use scenario::disturbance::Disturbance;

use crate::bus_connection::{BusConnection, COLLECT_PERIOD, stop_signal};
use crate::child::NodeProcess;
use crate::disturbance_node::DisturbanceProducer;
use crate::error::{START_PATIENCE, WorldError};
use crate::nodes::{CONTROLLER, PLANT_EMULATOR};
use crate::played::{End, Played};
use crate::process_faults::{ProcessAction, ProcessFaults};
use crate::processes::{Processes, runtime};
use crate::supervisor::Supervisor;
use recording::capture::Capture;
use recording::latency::{Host, NodeReport};
use recording::masters::MasterWatch;
use recording::run_folder::RunFolder;
use rig::external::ExternalNode;
use rig::setup::Setup;

/// What the controller needs beyond the bring-up until current flows, with some to spare.
const ENABLE_PATIENCE: Duration = Duration::from_secs(5);
/// A bus without a frame for so long has lost its manager.
const SILENCE_MAX: Duration = Duration::from_secs(2);

/// Plays the scenario in real time on a bus that is there, with controller and plant as processes unless they are external:
/// to its end, or until what was recorded is enough.
///
/// # Errors
/// A process or the bus failed, or the recording cannot be written.
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
    let mut bench = bench_node(setup)?;
    let mut bus = connection.join(&canopen::Node::filters(&bench))?;
    let (stopper, stop) = stop_signal()?;
    let ended = std::thread::scope(|scope| {
        let bench = scope.spawn(|| platform::real_time::run(&mut bench, &mut *bus, &stop));
        let end = runtime.block_on(async {
            let run = follow(
                setup,
                folder,
                connection,
                capture,
                &mut processes,
                is_enough,
            );
            let end = tokio::select! {
                // Its error is reported below.
                () = ended(&bench) => Ok(End::Interrupted),
                end = run => end,
            };
            // However the run went, nothing may stay heated or running.
            let stopped = processes.stop().await;
            match end {
                Ok(end) => stopped.map(|reports| (end, reports)),
                Err(error) => Err(error),
            }
        });
        drop(stopper);
        let bench = bench
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match bench {
            Err(RunError::Node(violation)) => Err(WorldError::Violation(violation)),
            bench => end.and_then(|end| bench.map(|_| end).map_err(WorldError::Bench)),
        }
    });
    if let Some(second_master) = bench.second_master() {
        return Err(WorldError::SecondMaster(second_master.to_owned()));
    }
    ended.map(|(end, [controller, plant_emulator])| Played {
        end,
        host: Some(Host {
            controller: controller.map(|text| report(CONTROLLER, &text)),
            plant_emulator: plant_emulator.map(|text| report(PLANT_EMULATOR, &text)),
            wall_clock_step: connection.wall_clock_step(),
            load: scheduling::machine_load(),
        }),
    })
}

/// Starts the nodes that are not external.
fn start_nodes(
    setup: &Setup,
    folder: &RunFolder,
    connection: &BusConnection,
) -> Result<Processes, WorldError> {
    let start = |name, node| {
        let is_ours = !setup.external.has(node);
        is_ours
            .then(|| NodeProcess::spawn(name, folder, Some(connection.address()), None))
            .transpose()
    };
    Ok(Processes {
        plant_emulator: start(PLANT_EMULATOR, ExternalNode::Drive)?,
        controller: start(CONTROLLER, ExternalNode::Controller)?,
    })
}

/// The bench's own node, with a supervisor where there is a rig, and a watch for a second master of a drive that is real.
fn bench_node(setup: &Setup) -> Result<DisturbanceProducer, WorldError> {
    let mut orders = setup.scenario.clone();
    if !setup.external.has_fan() {
        // On a bus without the module its identifier may be somebody else's.
        orders.disturbance = Disturbance::default();
    }
    let supervisor = setup.rig.as_ref();
    let supervisor = supervisor.map(|rig| Supervisor::new(&rig.file, &rig.drive));
    let watch = |setup: &Setup| MasterWatch::new(&setup.scenario, &setup.database, &setup.external);
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

/// What a node reported of itself at its end.
fn report(name: &str, text: &str) -> NodeReport {
    serde_json::from_str(text).unwrap_or_else(|_| NodeReport {
        refused: vec![format!("the {name} gave no report of its timing")],
        ..NodeReport::default()
    })
}

/// Collects frames until the scenario is over, the user stops it, or something fails.
async fn follow(
    setup: &Setup,
    folder: &RunFolder,
    connection: &mut BusConnection,
    capture: &mut Capture<'_>,
    processes: &mut Processes,
    is_enough: &mut dyn FnMut(&Capture<'_>) -> bool,
) -> Result<End, WorldError> {
    let clock = Clock::start();
    let mut last_frame = Duration::ZERO;
    let mut faults = ProcessFaults::new(&setup.scenario);
    let mut ticks = tokio::time::interval(COLLECT_PERIOD);
    loop {
        tokio::select! {
            error = processes.early_end() => return Err(error),
            _ = ticks.tick() => {}
        }
        let now = clock.now();
        if connection.collect(capture)? {
            last_frame = now;
        }
        if capture.is_interrupted() {
            return Ok(End::Interrupted);
        }
        if is_enough(capture) {
            return Ok(End::Completed);
        }
        let controller = processes.controller.as_mut();
        play_faults(
            &mut faults,
            controller,
            capture.scenario_time(),
            folder,
            connection,
        )
        .await?;
        let silence = now - last_frame;
        if is_over(setup, capture.scenario_time(), now, silence)? {
            return Ok(End::Completed);
        }
    }
}

/// Does to the controller's process what the scenario's faults say by now. Faults of an external controller were refused
/// before the run.
async fn play_faults(
    faults: &mut ProcessFaults,
    controller: Option<&mut NodeProcess>,
    scenario_time: Option<Duration>,
    folder: &RunFolder,
    connection: &BusConnection,
) -> Result<(), WorldError> {
    let (Some(controller), Some(time)) = (controller, scenario_time) else {
        return Ok(());
    };
    while let Some(action) = faults.due(time) {
        match action {
            ProcessAction::Kill => controller.kill_by_fault().await?,
            ProcessAction::Suspend => controller.suspend(true)?,
            ProcessAction::Resume => controller.suspend(false)?,
            ProcessAction::Start => {
                *controller =
                    NodeProcess::spawn(CONTROLLER, folder, Some(connection.address()), None)?;
            }
        }
    }
    Ok(())
}

/// Whether the scenario has come to its end.
///
/// # Errors
/// It never will: it did not begin, or its manager is gone.
fn is_over(
    setup: &Setup,
    scenario_time: Option<Duration>,
    now: Duration,
    silence: Duration,
) -> Result<bool, WorldError> {
    let scenario = &setup.scenario;
    let patience = start_patience(setup);
    match scenario_time {
        Some(time) if time >= Duration::from_secs_f64(scenario.duration_seconds) => Ok(true),
        Some(_) if silence > SILENCE_MAX => Err(WorldError::Silent {
            silence: SILENCE_MAX,
        }),
        // A fault that keeps the scenario from beginning is seen to its end.
        None if now > patience && !scenario.fault.is_empty() => Ok(true),
        None if now > patience => Err(WorldError::NoStart { patience }),
        _ => Ok(false),
    }
}

/// The drive of a rig may take its time, as its controller knows.
fn start_patience(setup: &Setup) -> Duration {
    let bring_up = setup.rig.as_ref().map(|rig| rig.file.timeouts.bring_up());
    bring_up.map_or(START_PATIENCE, |bring_up| {
        START_PATIENCE.max(bring_up + ENABLE_PATIENCE)
    })
}
