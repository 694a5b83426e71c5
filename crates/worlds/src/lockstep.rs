//! Virtual time: the coordinator moves the nodes, in this process or in others.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use platform::bus::Bus;
use platform::clock::Clock;
use platform::lockstep::{Local, Participant};

use crate::after_end::{self, ANSWER_TIME};
use crate::bench_node::BenchNode;
use crate::blame::end_by_node;
use crate::bus_model::faults::BusFaults;
use crate::coordinator::{Coordinator, CoordinatorError, Wire};
use crate::error::{START_PATIENCE, STOP_PATIENCE, WorldError};
use crate::law_process::LawPlace;
use crate::names::{self, BENCH};
use crate::nodes;
use crate::played::End;
use crate::programs::{Guests, Hosting, Seated};
use plan::Plan;
use recording::capture::Capture;

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
    played.or_else(|error| end_by_node(error, plan, capture).map(End::ByNode))
}

fn play_here(
    plan: &Plan,
    laws: LawPlace,
    guests: &mut Guests,
    capture: &mut Capture<'_>,
) -> Result<End, WorldError> {
    let mut ours = Vec::new();
    for name in names::played_emulators(plan) {
        ours.push((name, nodes::plant_emulator(plan, name)?));
    }
    let mut bench = BenchNode::new(plan)?;
    let controller = plan.controller();
    if !plan.is_external(controller) {
        let views = nodes::controller_views(plan);
        let make = move || nodes::make_controller(&views, &laws);
        let node = nodes::faulty_controller(make, plan, |_| false)?;
        ours.push((controller.name.as_str(), node));
    }
    let ours = ours.iter_mut();
    let mut ours = Vec::from_iter(ours.map(|(name, node)| Local::new(*name, &mut **node)));
    let mut seat = Local::new(BENCH, &mut bench);
    let mut guests = guests.participants();
    let participants = in_order(plan, ours.iter_mut(), &mut guests, &mut seat);
    let played = play(plan, participants, capture, None);
    or_violation(played, &bench)
}

/// Returns the end of a run, or the violation of a limit for which the bench's own node gave up.
pub(crate) fn or_violation(
    played: Result<End, WorldError>,
    bench: &BenchNode,
) -> Result<End, WorldError> {
    match (played, bench.violation()) {
        (Err(WorldError::Coordinator(CoordinatorError::Failed { .. })), Some(violation)) => {
            Err(violation)
        }
        (played, _) => played,
    }
}

/// Returns the participants in the order in which they are asked: drives, canrig's own node, the controller.
pub(crate) fn in_order<'a, P: Participant + 'a>(
    plan: &Plan,
    ours: impl Iterator<Item = &'a mut P>,
    guests: &'a mut [Seated<'_>],
    bench: &'a mut dyn Participant,
) -> Vec<&'a mut dyn Participant> {
    let ours = ours.map(|one| one as &mut dyn Participant);
    let guests = guests.iter_mut().map(Seated::participant);
    let mut all = Vec::from_iter(ours.chain(guests).chain([bench]));
    let manager = &plan.controller().name;
    all.sort_by_key(|one| (one.name() == manager, one.name() == BENCH));
    all
}

/// Plays the loops with these participants. The last one is the manager. It is the first to stop, since it switches the current
/// off and stops the others while they still listen. With a `wire` the winner of each arbitration is sent on it.
///
/// # Errors
/// If a participant or the wire failed, or the recording cannot be written.
pub fn play(
    plan: &Plan,
    participants: Vec<&mut dyn Participant>,
    capture: &mut Capture<'_>,
    wire: Option<&mut dyn Bus>,
) -> Result<End, WorldError> {
    let names = participants.iter().map(|one| one.name().to_owned());
    let names = Vec::from_iter(names);
    let faults = BusFaults::new(plan, &names)?;
    let bitrate = plan.shared.run.bus.bitrate_kilobits_per_second;
    let mut coordinator = Coordinator::new(bitrate, participants, faults);
    let mut wire = Wire { capture, bus: wire };
    let (end, is_faulty) = (plan.duration(), plan.has_faults());
    let ended = run_until(&mut coordinator, &mut wire, end, is_faulty);
    let mut left = BTreeSet::from_iter(0..names.len());
    // The participant whose loss ended the run: its process has ended or hangs, or it gave up.
    if let Err(WorldError::Coordinator(error)) = &ended
        && let Some(dead) = names
            .iter()
            .position(|name| error.participant() == Some(name))
    {
        wire.capture.break_off();
        coordinator.leave_out(dead);
        left.remove(&dead);
        let manager = BTreeSet::from_iter(left.take(&(names.len() - 1)));
        // The end of the run is known, whatever happens now.
        let _ = stop(&mut coordinator, &mut wire, &names, &manager, is_faulty);
        let _ = ask_drives(plan, &mut coordinator, &mut wire);
        let _ = stop(&mut coordinator, &mut wire, &names, &left, is_faulty);
        return ended;
    }
    let end = ended?;
    stop(&mut coordinator, &mut wire, &names, &left, is_faulty)?;
    Ok(end)
}

/// Lets the drives without a controller run until their watches have run out, and asks them then whether they are off.
fn ask_drives(
    plan: &Plan,
    coordinator: &mut Coordinator<'_>,
    wire: &mut Wire<'_, '_, '_>,
) -> Result<(), WorldError> {
    go_on(coordinator, wire, after_end::watch(plan))?;
    for round in after_end::requests(plan) {
        for request in round {
            coordinator.put(request, wire)?;
        }
        go_on(coordinator, wire, ANSWER_TIME)?;
    }
    Ok(())
}

fn go_on(
    coordinator: &mut Coordinator<'_>,
    wire: &mut Wire<'_, '_, '_>,
    time: Duration,
) -> Result<(), WorldError> {
    let until = coordinator.now() + time;
    coordinator.set_horizon(until);
    while coordinator.step(wire)?.is_some_and(|now| now < until) {}
    Ok(coordinator.settle(wire)?)
}

/// Asks these participants for their safe states, the last first, and waits for each.
fn stop(
    coordinator: &mut Coordinator<'_>,
    wire: &mut Wire<'_, '_, '_>,
    names: &[String],
    left: &BTreeSet<usize>,
    is_faulty: bool,
) -> Result<(), WorldError> {
    coordinator.settle(wire)?;
    for index in left.iter().copied().rev() {
        coordinator.stop(index)?;
        let give_up = coordinator.now() + STOP_PATIENCE;
        while !coordinator.is_stopped(index) {
            let is_late = coordinator.step(wire)?.is_none_or(|now| now > give_up);
            // A participant that a fault keeps from ending is left as it is.
            if is_late && is_faulty {
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

fn run_until(
    coordinator: &mut Coordinator<'_>,
    wire: &mut Wire<'_, '_, '_>,
    end: Duration,
    is_faulty: bool,
) -> Result<End, WorldError> {
    coordinator.set_horizon(START_PATIENCE);
    let mut until = None;
    let clock = Clock::start();
    let (mut flushed, mut seen) = (Duration::ZERO, 0);
    for event in 0_u64.. {
        let Some(now) = coordinator.step(wire)? else {
            return Err(NO_START);
        };
        match until {
            Some(until) if now >= until => break,
            Some(_) => {}
            // A fault that keeps the scenario from beginning is played to its end.
            None if now > START_PATIENCE && is_faulty => break,
            None if now > START_PATIENCE => return Err(NO_START),
            None => {
                until = wire.capture.zero().map(|zero| zero + end);
                if let Some(until) = until {
                    coordinator.set_horizon(until);
                }
            }
        }
        if event % EVENTS_PER_LOOK != 0 || clock.now() < flushed + FLUSH_PERIOD {
            continue;
        }
        flushed = clock.now();
        // A compressed log takes a flush without frames for silence, and writes its buffer: its bytes would depend on the
        // machine.
        if !wire.capture.since(&mut seen).is_empty() {
            wire.capture.flush()?;
        }
        if wire.capture.is_interrupted() {
            return Ok(End::Interrupted);
        }
    }
    Ok(End::Completed)
}
