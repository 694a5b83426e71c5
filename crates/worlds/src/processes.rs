//! Controller and plant as processes, in lock-step or in real time.

use std::time::Duration;

use platform::bus::{Bus, BusAddress};
use platform::lockstep::{ANSWER_PATIENCE, Failure, Remote, Setting, channel};
use platform::private_bus::PrivateBus;
use platform::scheduling::OneProcessor;

use crate::bus_choice::RunBus;
use crate::child::{END_PATIENCE, NodeProcess, Stopped};
use crate::error::WorldError;
use crate::law_process;
use crate::lockstep;
use crate::names;
use crate::played::{End, Played};
use crate::programs::{Guests, Hosting};
use plan::Plan;
use recording::capture::Capture;
use recording::run_folder::RunFolder;

/// Nodes that are processes of their own, the manager last; without external nodes.
pub(super) struct Processes {
    pub(super) all: Vec<NodeProcess>,
    manager: String,
}

impl Processes {
    pub(super) fn new(all: Vec<NodeProcess>, plan: &Plan) -> Self {
        let manager = plan.controller().name.clone();
        Self { all, manager }
    }

    /// Returns the process of a node, unless the node is external.
    pub(super) fn get_mut(&mut self, name: &str) -> Option<&mut NodeProcess> {
        let mut processes = self.all.iter_mut();
        processes.find(|process| process.name() == name)
    }

    /// Returns the error for one of them that has ended before its time.
    pub(super) fn early_end(&mut self) -> Option<WorldError> {
        let mut processes = self.all.iter_mut().rev();
        processes.find_map(|process| process.early_end(Duration::ZERO))
    }

    /// Stops the manager, or all others.
    pub(super) fn stop(&mut self, are_managers: bool) -> Vec<Stopped> {
        let is_one = |process: &&mut NodeProcess| (process.name() == self.manager) == are_managers;
        let those = self.all.iter_mut().rev().filter(is_one);
        those.map(NodeProcess::stop).collect()
    }
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
    lockstep::end_of(played, plan, capture).map(Played::in_virtual_time)
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
            let mut private = PrivateBus::start().map_err(WorldError::Private)?;
            let address = BusAddress::Private(private.process());
            (Some(private.join(&[])?), Some(address), Some(private))
        }
    };
    let mut processes = Vec::new();
    let mut channels = Vec::new();
    for name in names::played(plan) {
        let (ours, theirs) = channel().map_err(WorldError::spawn(name))?;
        let process = NodeProcess::spawn(name, plan, folder, address.as_ref(), Some(theirs));
        processes.push(process.map_err(WorldError::spawn(name))?);
        channels.push((name, ours));
    }
    let mut processes = Processes::new(processes, plan);
    let played = (|| -> Result<End, WorldError> {
        let mut remotes = Vec::new();
        let patience = ANSWER_PATIENCE + law_process::processes_patience(plan);
        for (name, channel) in channels {
            let remote = Remote::accept(name, channel, Some(patience), Setting::default());
            remotes.push(remote.map_err(|failure| WorldError::Participant {
                name: name.to_owned(),
                failure,
            })?);
        }
        let wire = wire.as_mut().map(|wire| &mut **wire as &mut dyn Bus);
        lockstep::play_nodes(plan, &mut remotes, guests, capture, wire)
    })();
    if capture.watch().is_interrupted() {
        processes.all.iter().for_each(NodeProcess::terminate);
    }
    with_end(played, &mut processes)
}

/// Stops the processes of a run; returns the end of the run, or the first error.
fn with_end(played: Result<End, WorldError>, processes: &mut Processes) -> Result<End, WorldError> {
    // The end of a process says more than its missing answer.
    let played = played.map_err(|error| match &error {
        WorldError::Participant {
            name,
            failure: Failure::Ended,
        } => {
            let process = processes.get_mut(name);
            let ended = process.and_then(|process| process.early_end(END_PATIENCE));
            ended.unwrap_or(error)
        }
        _ => error,
    });
    let stopped = [true, false].map(|are_managers| processes.stop(are_managers));
    let mut ended = stopped.into_iter().flatten().map(|stopped| stopped.ended);
    played.and_then(|end| ended.try_for_each(|ended| ended).map(|()| end))
}
