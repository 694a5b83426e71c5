//! Real time: the processes keep their own time on a bus, and the bench listens.

use std::thread::ScopedJoinHandle;
use std::time::Duration;

use platform::clock::Clock;
use platform::real_time::RunError;
use platform::scheduling;
use scenario::disturbance::Disturbance;

use super::child::NodeProcess;
use super::line::{COLLECT_PERIOD, Line, stop_signal};
use super::processes::{Processes, runtime};
use super::strikes::{Strike, Strikes};
use super::{CONTROLLER, End, PLANT_EMULATOR, Played, START_PATIENCE, WorldError};
use crate::disturbance_node::DisturbanceProducer;
use crate::supervisor::Supervisor;
use recording::capture::Capture;
use recording::latency::{Host, NodeReport};
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
    line: &mut Line,
    is_enough: &mut dyn FnMut(&Capture<'_>) -> bool,
) -> Result<Played, WorldError> {
    let (scenario, external) = (&setup.scenario, &setup.external);
    let runtime = runtime()?;
    let _entered = runtime.enter();
    let start = |name, node| {
        let is_ours = !external.has(node);
        is_ours
            .then(|| NodeProcess::spawn(name, folder, Some(&line.address), None))
            .transpose()
    };
    let mut processes = Processes {
        plant_emulator: start(PLANT_EMULATOR, ExternalNode::Drive)?,
        controller: start(CONTROLLER, ExternalNode::Controller)?,
    };
    let mut orders = scenario.clone();
    if !external.has_fan() {
        // On a bus without the module its identifier may be somebody else's.
        orders.disturbance = Disturbance::default();
    }
    let supervisor = setup.rig.as_ref();
    let supervisor = supervisor.map(|rig| Supervisor::new(&rig.rig, &rig.drive));
    let bench = DisturbanceProducer::new(&orders, &setup.database)?;
    let mut bench = bench.with_supervisor(supervisor);
    let mut voice = line.voice(&canopen::Node::filters(&bench))?;
    let (stopper, stop) = stop_signal()?;
    let ended = std::thread::scope(|scope| {
        let bench = scope.spawn(|| platform::real_time::run(&mut bench, &mut *voice, &stop));
        let end = runtime.block_on(async {
            let run = follow(setup, folder, line, capture, &mut processes, is_enough);
            let end = tokio::select! {
                // Its error is told below.
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
    ended.map(|(end, [controller, plant_emulator])| Played {
        end,
        host: Some(Host {
            controller: controller.map(|text| report(CONTROLLER, &text)),
            plant_emulator: plant_emulator.map(|text| report(PLANT_EMULATOR, &text)),
            wall_clock_step: line.wall_clock_step(),
            load: scheduling::machine_load(),
        }),
    })
}

/// Waits until the bench's own node has ended: it has stopped the drive, or failed.
async fn ended<T>(bench: &ScopedJoinHandle<'_, T>) {
    let mut ticks = tokio::time::interval(COLLECT_PERIOD);
    while !bench.is_finished() {
        ticks.tick().await;
    }
}

/// What a node said of itself at its end.
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
    line: &mut Line,
    capture: &mut Capture<'_>,
    processes: &mut Processes,
    is_enough: &mut dyn FnMut(&Capture<'_>) -> bool,
) -> Result<End, WorldError> {
    let scenario = &setup.scenario;
    let duration = Duration::from_secs_f64(scenario.duration_seconds);
    let patience = start_patience(setup);
    let clock = Clock::start();
    let mut last_heard = Duration::ZERO;
    let mut strikes = Strikes::new(scenario);
    let mut ticks = tokio::time::interval(COLLECT_PERIOD);
    loop {
        tokio::select! {
            error = processes.early_end() => return Err(error),
            _ = ticks.tick() => {}
        }
        let now = clock.now();
        if line.collect(capture)? {
            last_heard = now;
        }
        if capture.is_interrupted() {
            return Ok(End::Interrupted);
        }
        if is_enough(capture) {
            return Ok(End::Completed);
        }
        while let Some(strike) = capture.scenario_time().and_then(|time| strikes.due(time)) {
            // Faults of an external controller are refused before the run.
            let Some(controller) = &mut processes.controller else {
                break;
            };
            match strike {
                Strike::Kill => controller.strike().await?,
                Strike::Freeze => controller.freeze(true)?,
                Strike::Thaw => controller.freeze(false)?,
                Strike::Start => {
                    *controller =
                        NodeProcess::spawn(CONTROLLER, folder, Some(&line.address), None)?;
                }
            }
        }
        match capture.scenario_time() {
            Some(time) if time >= duration => return Ok(End::Completed),
            Some(_) if now - last_heard > SILENCE_MAX => {
                return Err(WorldError::Silent {
                    silence: SILENCE_MAX,
                });
            }
            // A fault that keeps the scenario from beginning is seen to its end.
            None if now > patience && !scenario.fault.is_empty() => {
                return Ok(End::Completed);
            }
            None if now > patience => return Err(WorldError::NoStart { patience }),
            _ => {}
        }
    }
}

/// The drive of a rig may take its time, as its controller knows.
fn start_patience(setup: &Setup) -> Duration {
    let bring_up = setup.rig.as_ref().map(|rig| rig.rig.timeouts.bring_up());
    bring_up.map_or(START_PATIENCE, |bring_up| {
        START_PATIENCE.max(bring_up + ENABLE_PATIENCE)
    })
}
