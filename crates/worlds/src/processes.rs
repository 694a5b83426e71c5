//! Controller and plant as processes, in lock-step or in real time.

use dbc::Database;
use platform::bus::{Bus, BusAddress};
use platform::lockstep::{Local, LockstepError, Remote, channel};
use platform::private_bus::PrivateBus;
use platform::scheduling::OneProcessor;
use scenario::Scenario;
use tokio::runtime::Runtime;

use crate::blame::end_by_node;
use crate::bus_choice::RunBus;
use crate::child::NodeProcess;
use crate::coordinator::CoordinatorError;
use crate::disturbance_node::DisturbanceProducer;
use crate::error::WorldError;
use crate::lockstep::{self, Roles};
use crate::nodes::{BENCH, CONTROLLER, PLANT_EMULATOR};
use crate::played::{End, Played};
use recording::capture::Capture;
use recording::run_folder::RunFolder;
use rig::setup::Setup;

/// The nodes that are processes of their own; none where somebody else's is on the bus.
pub(super) struct Processes {
    pub(super) plant_emulator: Option<NodeProcess>,
    pub(super) controller: Option<NodeProcess>,
}

impl Processes {
    /// Waits until one of them ends before its time; the error that says so.
    pub(super) async fn early_end(&mut self) -> WorldError {
        tokio::select! {
            error = early_end(&mut self.controller) => error,
            error = early_end(&mut self.plant_emulator) => error,
        }
    }

    /// Waits for the end of a participant's process.
    async fn early_end_of(&mut self, name: &str) -> WorldError {
        let process = match name {
            CONTROLLER => &mut self.controller,
            _ => &mut self.plant_emulator,
        };
        early_end(process).await
    }

    /// Stops both, the manager first; the reports of controller and emulator.
    pub(super) async fn stop(&mut self) -> [Result<Option<String>, WorldError>; 2] {
        let controller = stop(&mut self.controller).await;
        let plant_emulator = stop(&mut self.plant_emulator).await;
        [controller, plant_emulator]
    }
}

async fn early_end(process: &mut Option<NodeProcess>) -> WorldError {
    match process {
        Some(process) => process.early_end().await,
        None => std::future::pending().await,
    }
}

async fn stop(process: &mut Option<NodeProcess>) -> Result<Option<String>, WorldError> {
    match process {
        Some(process) => process.stop().await.map(Some),
        None => Ok(None),
    }
}

/// The runtime in which processes are watched. It lives on the calling thread, whose end would end the processes.
pub(super) fn runtime() -> Result<Runtime, WorldError> {
    let built = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    built.map_err(|source| WorldError::Spawn {
        name: BENCH,
        source,
    })
}

/// Plays the scenario in lock-step, with controller and plant as processes. On a CAN interface the frames cross it.
///
/// # Errors
/// A process or the bus failed, or the recording cannot be written.
pub fn in_lockstep(
    setup: &Setup,
    folder: &RunFolder,
    capture: &mut Capture<'_>,
    bus: &RunBus,
) -> Result<Played, WorldError> {
    let played = play(&setup.scenario, folder, capture, bus);
    let end = played.or_else(|error| end_by_node(error, setup, capture).map(End::ByNode))?;
    Ok(Played::in_virtual_time(end))
}

fn play(
    scenario: &Scenario,
    folder: &RunFolder,
    capture: &mut Capture<'_>,
    bus: &RunBus,
) -> Result<End, WorldError> {
    // The coordinator only sends; without filters nothing comes in.
    let (mut wire, address, _private) = match bus {
        RunBus::Embedded { .. } => (None, None, None),
        RunBus::Interface(name) => {
            let address = BusAddress::Interface(name.clone());
            (Some(platform::open(&address, &[])?), Some(address), None)
        }
        RunBus::Private => {
            let mut private = PrivateBus::start()?;
            let address = BusAddress::Private(private.process());
            (Some(private.join(&[])?), Some(address), Some(private))
        }
    };
    let _here = OneProcessor::stay();
    let runtime = runtime()?;
    let _entered = runtime.enter();
    let start = |name| {
        let (ours, theirs) = channel().map_err(|source| WorldError::Spawn { name, source })?;
        Ok::<_, WorldError>((
            NodeProcess::spawn(name, folder, address.as_ref(), Some(theirs))?,
            ours,
        ))
    };
    let (plant_emulator, plant_channel) = start(PLANT_EMULATOR)?;
    let (controller, controller_channel) = start(CONTROLLER)?;
    let mut processes = Processes {
        plant_emulator: Some(plant_emulator),
        controller: Some(controller),
    };
    let played = (|| -> Result<End, WorldError> {
        let mut plant_emulator =
            Remote::accept(PLANT_EMULATOR, plant_channel).map_err(CoordinatorError::from)?;
        let mut controller =
            Remote::accept(CONTROLLER, controller_channel).map_err(CoordinatorError::from)?;
        let mut bench = DisturbanceProducer::new(scenario, Database::shipped())?;
        let roles = Roles {
            plant_emulator: &mut plant_emulator,
            bench: &mut Local::new(BENCH, &mut bench),
            controller: &mut controller,
        };
        lockstep::play(
            scenario,
            roles,
            capture,
            wire.as_mut().map(|wire| &mut **wire as &mut dyn Bus),
        )
    })();
    runtime.block_on(async {
        let error = match played {
            Ok(end) => {
                let stopped = processes.stop().await;
                return stopped
                    .into_iter()
                    .collect::<Result<Vec<_>, _>>()
                    .map(|_| end);
            }
            // How a process ended says more than that it does not answer.
            Err(WorldError::Coordinator(CoordinatorError::Participant(LockstepError::Ended {
                name,
            }))) => processes.early_end_of(&name).await,
            Err(error) => error,
        };
        // Whoever is left has ended before the error is reported, which is the first one.
        let _ = processes.stop().await;
        Err(error)
    })
}
