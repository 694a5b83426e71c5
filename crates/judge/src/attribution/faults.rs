//! The misses that a fault of the scenario explains: a fault excuses the frames that it touches, not all of its window.

use std::collections::BTreeSet;

use plan::ControlLoop;
use recording::timeline::{TIME_TOLERANCE_SECONDS, Timeline};
use scenario::expect::Emergency;
use scenario::fault::{Fault, Touch};
use scenario::node::Part;
use scenario::wiring::LoopFacts;

use super::breaches::Duty;

/// Longest reaction of a node to what a fault takes from it: the drive waits 100 ms for a heartbeat.
const REACTION_SECONDS: f64 = 0.2;
/// Least number of periods of that reaction, including the last ones of a controller that gives up.
const REACTION_PERIODS: f64 = 5.0;
/// Delay, in periods, below which a late frame still comes in its cycle.
const LATE_PERIODS: f64 = 0.5;

/// Explanations of misses by the faults of a scenario, in a recording.
pub(crate) struct ScenarioFaults<'a> {
    faults: Vec<&'a Fault>,
    /// Node-ID of the loop's drive; that of another loop is not its drive.
    drive: u8,
    /// Drives that share its CAN controller, for they are emulated with it.
    emulated_with: BTreeSet<&'a str>,
    /// Times at which the controller reported, during a fault, its reason to give up.
    reports_seconds: Vec<f64>,
    reaction_seconds: f64,
}

impl<'a> ScenarioFaults<'a> {
    pub(super) fn new(timeline: &Timeline, one: &'a ControlLoop) -> Self {
        let period_seconds = timeline.period_seconds;
        let is_late_enough = |fault: &Fault| {
            let seconds = fault.number("delay_milliseconds") / 1e3;
            seconds + TIME_TOLERANCE_SECONDS >= LATE_PERIODS * period_seconds
        };
        let is_felt = |fault: &&Fault| fault.kind.touch != Touch::Late || is_late_enough(fault);
        let faults = Vec::from_iter(one.faults().filter(is_felt));
        let watch = one.real_drive.as_ref().map_or(0.0, |drive| {
            f64::from(drive.real.timeouts.controller_lost_milliseconds) / 1e3
        });
        let reaction_seconds =
            f64::max(2.0 * watch, REACTION_SECONDS).max(REACTION_PERIODS * period_seconds);
        let is_in_a_fault = |at: f64| {
            let acts = |fault: &&Fault| {
                let (from, until) = span(fault);
                at >= from && at <= until + reaction_seconds
            };
            faults.iter().any(acts)
        };
        let controller = &one.nodes.controller.name;
        let is_report = |emergency: &Emergency| emergency.node == *controller;
        let events = timeline.events.iter();
        let reports = events
            .filter(|event| event.emergency.as_ref().is_some_and(is_report))
            .map(|event| event.time_seconds);
        let plants = &one.trial.plants;
        let shared = |other: &&LoopFacts| {
            let plant = &*other.emulated;
            one.is_ours(Part::Drive) && !plant.is_empty() && plants.contains_key(plant)
        };
        let emulated_with = one.trial.wiring.shared.loops.iter().filter(shared);
        Self {
            emulated_with: emulated_with.map(|other| &*other.drive).collect(),
            reports_seconds: reports.filter(|at| is_in_a_fault(*at)).collect(),
            faults,
            drive: one.trial.wiring.nodes.drive.id,
            reaction_seconds: reaction_seconds + TIME_TOLERANCE_SECONDS,
        }
    }

    /// Returns whether a fault explains a breach: it touches the frame, or the controller gives up because of it and says so.
    pub(crate) fn explain(&self, duty: Duty, from_seconds: f64, until_seconds: f64) -> bool {
        let is_near = |begins: f64, ends: f64| {
            until_seconds + TIME_TOLERANCE_SECONDS >= begins
                && from_seconds <= ends + self.reaction_seconds
        };
        let owing = duty.node();
        let touches = |fault: &&Fault| {
            let (from, until) = span(fault);
            let node = fault.node.as_ref();
            let is_at = |part| node.is_some_and(|node| node.part == part);
            let is_received = fault.kind.touch == Touch::Receiver;
            let is_here = node.is_none_or(|node| {
                let is_shared = || self.emulated_with.contains(&*node.name);
                node.part != Part::Drive || node.id == self.drive || is_received && is_shared()
            });
            let is_of_node = is_here && (node.is_none() || is_at(owing));
            let other = if is_at(Part::Controller) {
                Part::Drive
            } else {
                Part::Controller
            };
            match fault.kind.touch {
                Touch::Nothing => false,
                Touch::All => is_near(from, until),
                Touch::Node | Touch::Receiver | Touch::Late => is_of_node && is_near(from, until),
                // The others notice the fault when it begins.
                Touch::Heartbeats => {
                    let is_heartbeat = matches!(duty, Duty::Heartbeat(_));
                    is_heartbeat && is_of_node && is_near(from, until)
                        || owing == other && is_near(from, from)
                }
            }
        };
        let is_reported = |at: &f64| is_near(*at, *at);
        self.faults.iter().any(touches) || self.reports_seconds.iter().any(is_reported)
    }
}

/// Returns the span of a fault. A fault of the boot begins with the recording, and has ended at time 0.
pub(crate) fn span(fault: &Fault) -> (f64, f64) {
    match fault.from_seconds {
        None => (f64::NEG_INFINITY, 0.0),
        Some(from) => (from, fault.until_seconds.unwrap_or(f64::INFINITY)),
    }
}
