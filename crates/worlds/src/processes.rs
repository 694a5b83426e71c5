//! Controller and plant as processes, in lock-step or in real time.

use std::future::{Future, pending, poll_fn};
use std::task::Poll;

use platform::bus::{Bus, BusAddress};
use platform::lockstep::{ANSWER_PATIENCE, Local, LockstepError, Remote, Setting, channel};
use platform::private_bus::PrivateBus;
use platform::scheduling::OneProcessor;
use tokio::runtime::Runtime;

use crate::bench_node::BenchNode;
use crate::blame::end_by_node;
use crate::bus_choice::RunBus;
use crate::child::NodeProcess;
use crate::coordinator::CoordinatorError;
use crate::error::WorldError;
use crate::fmu_plant::more_patience;
use crate::law_process;
use crate::lockstep::{self, Role};
use crate::names::{self, BENCH};
use crate::played::{End, Played};
use crate::programs::{Guests, Hosting};
use plan::Plan;
use recording::capture::Capture;
use recording::run_folder::RunFolder;

/// Process that was stopped.
pub(super) struct Stopped {
    pub(super) name: String,
    /// Report of a node of canrig's on itself.
    pub(super) report: Option<String>,
    /// Error if it ended badly.
    pub(super) ended: Result<(), WorldError>,
}

/// Nodes that are processes of their own, the manager last; without external nodes.
pub(super) struct Processes {
    all: Vec<NodeProcess>,
    manager: String,
}

impl Processes {
    pub(super) fn new(all: Vec<NodeProcess>, plan: &Plan) -> Self {
        let manager = plan.controller().name.clone();
        Self { all, manager }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &NodeProcess> {
        self.all.iter()
    }

    /// Returns the process of a node, unless the node is external.
    pub(super) fn get_mut(&mut self, name: &str) -> Option<&mut NodeProcess> {
        let mut processes = self.all.iter_mut();
        processes.find(|process| process.name() == name)
    }

    /// Waits until one of them ends before its time; returns the error for it.
    pub(super) async fn early_end(&mut self) -> WorldError {
        let mut ends: Vec<_> = self
            .all
            .iter_mut()
            .rev()
            .map(|process| Box::pin(process.early_end()))
            .collect();
        poll_fn(|context| {
            let mut polls = ends.iter_mut().map(|end| end.as_mut().poll(context));
            polls.find(Poll::is_ready).unwrap_or(Poll::Pending)
        })
        .await
    }

    /// Waits for the end of a participant's process.
    async fn early_end_by_name(&mut self, name: &str) -> WorldError {
        match self.get_mut(name) {
            Some(process) => process.early_end().await,
            None => pending().await,
        }
    }

    /// Stops all, the manager first.
    pub(super) async fn stop(&mut self) -> Vec<Stopped> {
        let mut stopped = self.stop_manager().await;
        stopped.extend(self.stop_others().await);
        stopped
    }

    /// Stops the manager.
    pub(super) async fn stop_manager(&mut self) -> Vec<Stopped> {
        self.stop_those(true).await
    }

    /// Stops all but the manager.
    pub(super) async fn stop_others(&mut self) -> Vec<Stopped> {
        self.stop_those(false).await
    }

    async fn stop_those(&mut self, are_managers: bool) -> Vec<Stopped> {
        let mut stopped = Vec::new();
        let is_one = |process: &NodeProcess| (process.name() == self.manager) == are_managers;
        let those = self.all.iter_mut().filter(|process| is_one(process));
        for process in those.rev() {
            let (report, ended) = process.stop().await;
            stopped.push(Stopped {
                name: process.name().to_owned(),
                report,
                ended,
            });
        }
        stopped
    }
}

/// Makes the runtime in which processes are watched. It runs on the calling thread, whose end would end the processes.
pub(super) fn runtime() -> Result<Runtime, WorldError> {
    let built = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    built.map_err(|source| WorldError::Spawn {
        name: BENCH.to_owned(),
        source,
    })
}

/// Plays the loops in lock-step, with the controller and each plant as a process. On a CAN interface the frames cross it.
///
/// # Errors
/// If a process or the bus failed, or the recording cannot be written.
pub fn in_lockstep(
    plan: &Plan,
    folder: &RunFolder,
    hosting: &Hosting<'_>,
    capture: &mut Capture<'_>,
    bus: &RunBus,
) -> Result<Played, WorldError> {
    // Before the start of any process, since it inherits the processor.
    let _here = OneProcessor::stay();
    let played = Guests::seat(plan, hosting).and_then(|mut guests| {
        let played = play(plan, folder, &mut guests, capture, bus);
        guests.finish(played)
    });
    let end = played.or_else(|error| end_by_node(error, plan, capture).map(End::ByNode))?;
    Ok(Played::in_virtual_time(end))
}

fn play(
    plan: &Plan,
    folder: &RunFolder,
    guests: &mut Guests,
    capture: &mut Capture<'_>,
    bus: &RunBus,
) -> Result<End, WorldError> {
    // The coordinator only sends, so it needs no filters.
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
    let runtime = runtime()?;
    let _entered = runtime.enter();
    let mut processes = Vec::new();
    let mut channels = Vec::new();
    let emulators = names::played_emulators(plan);
    let count = emulators.len();
    let controller = plan.controller();
    let controller = (!plan.is_external(controller)).then_some(controller.name.as_str());
    for name in emulators.into_iter().chain(controller) {
        let (ours, theirs) = channel().map_err(|source| WorldError::Spawn {
            name: name.to_owned(),
            source,
        })?;
        let process = NodeProcess::spawn(name, plan, folder, address.as_ref(), Some(theirs))?;
        processes.push(process);
        channels.push((name, ours));
    }
    let mut processes = Processes::new(processes, plan);
    let played = (|| -> Result<End, WorldError> {
        let mut remotes = Vec::new();
        let patience = ANSWER_PATIENCE + more_patience(plan) + law_process::more_patience(plan)[0];
        for (name, channel) in channels {
            let remote = Remote::accept(name, channel, Some(patience), Setting::default());
            remotes.push(remote.map_err(CoordinatorError::from)?);
        }
        let mut bench = BenchNode::new(plan)?;
        let mut seat = Local::new(BENCH, &mut bench);
        let (emulators, manager) = remotes.split_at_mut(count);
        let drives = emulators.iter_mut().map(|one| Role::plant(plan, one));
        let manager = manager.first_mut().map(|one| Role::controller(one));
        let mut guests = guests.participants();
        let roles = lockstep::in_order(drives, &mut guests, &mut seat, manager);
        let wire = wire.as_mut().map(|wire| &mut **wire as &mut dyn Bus);
        let played = lockstep::play(plan, roles, capture, wire);
        lockstep::or_violation(played, &bench)
    })();
    runtime.block_on(with_end(played, &mut processes))
}

/// Returns the end of a run whose processes are still to be stopped.
async fn with_end(
    played: Result<End, WorldError>,
    processes: &mut Processes,
) -> Result<End, WorldError> {
    let error = match played {
        Ok(end) => {
            let stopped = processes.stop().await;
            let mut ended = stopped.into_iter().map(|stopped| stopped.ended);
            return ended.try_for_each(|ended| ended).map(|()| end);
        }
        // The end of a process says more than its missing answer.
        Err(WorldError::Coordinator(CoordinatorError::Participant(LockstepError::Ended {
            name,
        }))) if processes.get_mut(&name).is_some() => processes.early_end_by_name(&name).await,
        Err(error) => error,
    };
    // The remaining processes end before the error is reported, which is the first one.
    let _ = processes.stop().await;
    Err(error)
}
