//! Virtual time: the coordinator moves the nodes, in this process or in others.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use platform::bus::Bus;
use platform::clock::Clock;
use platform::lockstep::{Failure, Local, Participant};

use crate::after_end;
use crate::bench_node::BenchNode;
use crate::blame::end_by_node;
use crate::bus_model::faults::BusFaults;
use crate::coordinator::{Coordinator, Wire};
use crate::error::{START_PATIENCE, STOP_PATIENCE, WorldError};
use crate::law_process::LawPlace;
use crate::names::{self, BENCH};
use crate::nodes;
use crate::played::End;
use crate::programs::{Guests, Hosting};
use plan::Plan;
use recording::capture::Capture;
use recording::foreign::Foreign;

/// Number of events between two looks at the clock.
const EVENTS_PER_LOOK: u64 = 32;
/// Wall time between two flushes and checks for the user's request to stop: a plant may take long for each event.
const FLUSH_PERIOD: Duration = Duration::from_millis(20);

const NO_START: WorldError = WorldError::NoStart {
    patience: START_PATIENCE,
};

/// Runs the scenario in this process, with its external programs.
///
/// # Errors
/// If the bench failed, or the recording cannot be written.
pub fn simulate(
    plan: &Plan,
    hosting: &Hosting<'_>,
    capture: &mut Capture<'_>,
) -> Result<End, WorldError> {
    let laws = LawPlace {
        logs: hosting.logs.map(Path::to_owned),
        ..LawPlace::of(plan)
    };
    let played = Guests::seat(plan, hosting).and_then(|mut guests| {
        let played = play_here(plan, laws, &mut guests, capture);
        guests.finish(played)
    });
    end_of(played, plan, capture)
}

/// Returns the end of a run. The user's request to stop is the reason for every later error, since no node is waited for then.
///
/// # Errors
/// If the bench failed.
pub(crate) fn end_of(
    played: Result<End, WorldError>,
    plan: &Plan,
    capture: &Capture<'_>,
) -> Result<End, WorldError> {
    match played {
        Err(error) if capture.watch().is_interrupted() && !error.is_of_recording() => {
            Ok(End::Interrupted)
        }
        played => played.or_else(|error| end_by_node(error, plan, capture).map(End::ByNode)),
    }
}

fn play_here(
    plan: &Plan,
    laws: LawPlace,
    guests: &mut Guests,
    capture: &mut Capture<'_>,
) -> Result<End, WorldError> {
    let mut ours = Vec::new();
    for name in names::played(plan) {
        let node = if name == plan.controller().name {
            nodes::faulty_controller(plan, laws.clone())?
        } else {
            nodes::plant_emulator(plan, name)?
        };
        ours.push((name, node));
    }
    let ours = ours.iter_mut();
    let mut ours = Vec::from_iter(ours.map(|(name, node)| Local::new(*name, &mut **node)));
    play_nodes(plan, &mut ours, guests, capture, None)
}

/// Plays the loops with these nodes of canrig's, the guests, and the bench's own node. They are asked in this order: drives, the
/// bench's own node, the controller.
///
/// # Errors
/// As [`play`]; with the violation of a limit, if the bench's own node gave up for it.
pub(crate) fn play_nodes<P: Participant>(
    plan: &Plan,
    ours: &mut [P],
    guests: &mut Guests,
    capture: &mut Capture<'_>,
    bus: Option<&mut dyn Bus>,
) -> Result<End, WorldError> {
    let mut bench = BenchNode::new(plan)?;
    let mut seat = Local::new(BENCH, &mut bench);
    let (plain, mut faulty) = guests.participants();
    let mut all: Vec<&mut dyn Participant> = Vec::new();
    all.extend(ours.iter_mut().map(|one| one as &mut dyn Participant));
    all.extend(plain.into_iter().map(|one| one as &mut dyn Participant));
    all.extend(faulty.iter_mut().map(|one| one as &mut dyn Participant));
    all.push(&mut seat);
    let manager = &plan.controller().name;
    all.sort_by_key(|one| (one.name() == manager, one.name() == BENCH));
    let played = play(plan, all, capture, bus);
    let gave_up = |failure: &Failure| matches!(failure, Failure::GaveUp(_));
    match (played, bench.violation()) {
        (Err(WorldError::Participant { failure, .. }), Some(violation)) if gave_up(&failure) => {
            Err(violation)
        }
        (played, _) => played,
    }
}

/// Plays the loops with these participants. The last one is the manager. It is the first to stop, since it switches the current
/// off and stops the others while they still listen. With a `bus` the winner of each arbitration is sent on it.
///
/// # Errors
/// If a participant or the wire failed, or the recording cannot be written.
pub fn play(
    plan: &Plan,
    participants: Vec<&mut dyn Participant>,
    capture: &mut Capture<'_>,
    bus: Option<&mut dyn Bus>,
) -> Result<End, WorldError> {
    let names = participants.iter().map(|one| one.name().to_owned());
    let names = Vec::from_iter(names);
    let faults = BusFaults::new(plan, &names)?;
    let bitrate = plan.shared.run.bus.bitrate_kilobits_per_second;
    // For as long as the participants are borrowed.
    let bus = bus.map(|bus| bus as &mut dyn Bus);
    let wire = Wire { capture, bus };
    let coordinator = Coordinator::new(bitrate, participants, faults, wire);
    let mut run = Run { plan, coordinator };
    let ended = run.follow();
    // Faults end with the scenario: what they hit afterwards is of no duty.
    let hits = run.coordinator.take_hits();
    let reasons = run.coordinator.take_reasons();
    let capture = &mut *run.coordinator.wire.capture;
    capture.hits_on_bus = hits;
    capture.unrecorded.reasons = reasons;
    // Each frame is that of a participant or of a fault.
    capture.unrecorded.foreign = Some(Foreign::default());
    let mut left = BTreeSet::from_iter(0..names.len());
    // The participant whose loss ended the run: its process has ended or hangs, or it gave up.
    if let Err(WorldError::Participant { name, .. }) = &ended
        && let Some(dead) = names.iter().position(|other| other == name)
    {
        run.coordinator.wire.capture.break_off();
        run.coordinator.leave_out(dead);
        left.remove(&dead);
        let manager = BTreeSet::from_iter(left.take(&(names.len() - 1)));
        // The end of the run is known, whatever happens now.
        let _ = run.stop(&manager, &names);
        let _ = run.ask_drives();
        let _ = run.stop(&left, &names);
        return ended;
    }
    let end = ended?;
    run.stop(&left, &names)?;
    Ok(end)
}

/// Run in progress.
struct Run<'a, 'b, 'c> {
    plan: &'b Plan,
    coordinator: Coordinator<'a, 'b, 'c>,
}

impl Run<'_, '_, '_> {
    /// Moves the participants until the scenario is over, the user stops it, or an error occurs.
    fn follow(&mut self) -> Result<End, WorldError> {
        self.coordinator.horizon = START_PATIENCE;
        let mut until = None;
        let clock = Clock::start();
        let (mut flushed, mut seen) = (Duration::ZERO, 0);
        for event in 0_u64.. {
            let Some(now) = self.coordinator.step()? else {
                return self.end_without_event(until.is_some());
            };
            match until {
                Some(until) if now >= until => break,
                Some(_) => {}
                // A fault that keeps the scenario from beginning is played to its end.
                None if now > START_PATIENCE && self.plan.has_faults() => break,
                None if now > START_PATIENCE => return Err(NO_START),
                None => {
                    let zero = self.coordinator.wire.capture.zero();
                    until = zero.map(|zero| zero + self.plan.duration());
                    if let Some(until) = until {
                        self.coordinator.horizon = until;
                    }
                }
            }
            if event % EVENTS_PER_LOOK != 0 || clock.now() < flushed + FLUSH_PERIOD {
                continue;
            }
            flushed = clock.now();
            let capture = &mut *self.coordinator.wire.capture;
            // A compressed log takes a flush without frames for silence, and writes its buffer: its bytes would depend on the
            // machine.
            if !capture.since(&mut seen).is_empty() {
                capture.flush()?;
            }
            if capture.watch().is_interrupted() {
                return Ok(End::Interrupted);
            }
        }
        Ok(End::Completed)
    }

    /// Ends a run in which no node has a frame to send or a timer left.
    fn end_without_event(&self, has_begun: bool) -> Result<End, WorldError> {
        match has_begun {
            // A fault may keep the scenario from beginning.
            false if self.plan.has_faults() => Ok(End::Completed),
            false => Err(NO_START),
            // The controller owes the next SYNC.
            true => Err(WorldError::Participant {
                name: self.plan.controller().name.clone(),
                failure: Failure::Waits,
            }),
        }
    }

    /// Lets the drives without a controller run until their watches have run out, and asks them then whether they are off.
    fn ask_drives(&mut self) -> Result<(), WorldError> {
        let coordinator = &mut self.coordinator;
        for (requests, time) in after_end::rounds(self.plan) {
            for request in requests {
                coordinator.put(request)?;
            }
            coordinator.run_until(coordinator.now + time)?;
            coordinator.settle()?;
        }
        Ok(())
    }

    /// Asks these participants for their safe states, the last first, and waits for each.
    fn stop(&mut self, left: &BTreeSet<usize>, names: &[String]) -> Result<(), WorldError> {
        let coordinator = &mut self.coordinator;
        coordinator.settle()?;
        for index in left.iter().copied().rev() {
            coordinator.stop(index)?;
            let give_up = coordinator.now + STOP_PATIENCE;
            while !coordinator.is_stopped(index) {
                let is_late = coordinator.step()?.is_none_or(|now| now > give_up);
                // A participant that a fault keeps from ending is left as it is.
                if is_late && self.plan.has_faults() {
                    break;
                }
                if is_late {
                    return Err(WorldError::NoStop {
                        name: names[index].clone(),
                        patience: STOP_PATIENCE,
                    });
                }
            }
        }
        Ok(())
    }
}
