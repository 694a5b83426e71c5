//! The misses that a fault of the scenario explains: a fault excuses the frames that it touches, not all of its window.

use plan::ControlLoop;
use recording::timeline::{TIME_TOLERANCE_SECONDS, Timeline};
use scenario::expect::Emergency;
use scenario::fault::{Fault, Touch};
use scenario::node::Part;

use super::breaches::{Breach, Duty};

/// Longest reaction of a node to what a fault takes from it: the drive waits 100 ms for a heartbeat.
const REACTION_SECONDS: f64 = 0.2;
/// Least number of periods of that reaction, including the last ones of a controller that gives up.
const REACTION_PERIODS: f64 = 5.0;
/// Delay, in periods, below which a late frame still comes in its cycle.
const LATE_PERIODS: f64 = 0.5;

/// Stretch of time in which frames of a node, or of all nodes, may be missing.
struct Touched {
    node: Option<Part>,
    only_heartbeats: bool,
    from_seconds: f64,
    until_seconds: f64,
}

/// Explanations of misses by the faults of a scenario, in a recording.
pub(super) struct ScenarioFaults {
    touched: Vec<Touched>,
    /// Times at which the controller reported, during a fault, its reason to give up.
    reports_seconds: Vec<f64>,
    reaction_seconds: f64,
}

impl ScenarioFaults {
    pub(super) fn new(timeline: &Timeline, one: &ControlLoop) -> Self {
        let period_seconds = timeline.period_seconds;
        let is_felt = |fault: &&Fault| {
            let seconds = fault.number("delay_milliseconds") / 1e3;
            seconds + TIME_TOLERANCE_SECONDS >= LATE_PERIODS * period_seconds
        };
        let is_late = |fault: &&Fault| fault.kind.touch == Touch::Late;
        let faults = one
            .faults()
            .filter(|fault| !is_late(fault) || is_felt(fault));
        let faults = Vec::from_iter(faults);
        let drive = one.trial.wiring.nodes.drive.id;
        let touched = faults.iter().flat_map(|fault| touched(fault, drive));
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
        Self {
            reports_seconds: reports.filter(|at| is_in_a_fault(*at)).collect(),
            touched: touched.collect(),
            reaction_seconds: reaction_seconds + TIME_TOLERANCE_SECONDS,
        }
    }

    /// Returns whether a fault explains a breach: it touches the frame, or the controller gives up because of it and says so.
    pub(super) fn explain(&self, breach: &Breach) -> bool {
        let part = breach.duty.node();
        let (from, until) = (breach.from_seconds, breach.until_seconds);
        let is_heartbeat = matches!(breach.duty, Duty::Heartbeat(_));
        let is_near = |begins: f64, ends: f64| {
            until + TIME_TOLERANCE_SECONDS >= begins && from <= ends + self.reaction_seconds
        };
        let touches = |touched: &Touched| {
            touched.node.is_none_or(|touched| touched == part)
                && (is_heartbeat || !touched.only_heartbeats)
                && is_near(touched.from_seconds, touched.until_seconds)
        };
        let is_reported = |at: &f64| is_near(*at, *at);
        self.touched.iter().any(touches) || self.reports_seconds.iter().any(is_reported)
    }
}

/// Returns the span of a fault. A fault of the boot begins with the recording, and has ended at time 0.
pub(crate) fn span(fault: &Fault) -> (f64, f64) {
    match fault.from_seconds {
        None => (f64::NEG_INFINITY, 0.0),
        Some(from) => (from, fault.until_seconds.unwrap_or(f64::INFINITY)),
    }
}

/// Returns the frames of a loop's controller and drive that a fault touches. The drive of another loop is not its drive.
fn touched(fault: &Fault, drive: u8) -> Vec<Touched> {
    let (from_seconds, until_seconds) = span(fault);
    let node = fault.node.as_ref();
    let part = node.map(|node| node.part);
    let is_elsewhere = node.is_some_and(|node| node.part == Part::Drive && node.id != drive);
    let touched = |node, until_seconds| Touched {
        node,
        only_heartbeats: false,
        from_seconds,
        until_seconds,
    };
    match fault.kind.touch {
        Touch::Nothing => Vec::new(),
        Touch::All => vec![touched(None, until_seconds)],
        Touch::Node | Touch::Late if is_elsewhere => Vec::new(),
        Touch::Node | Touch::Late => vec![touched(part, until_seconds)],
        Touch::Heartbeats => {
            let other = match part {
                Some(Part::Controller) => Part::Drive,
                _ => Part::Controller,
            };
            let heartbeats = Touched {
                only_heartbeats: true,
                ..touched(part, until_seconds)
            };
            // The others notice the fault when it begins.
            let noticed = touched(Some(other), from_seconds);
            let missing = (!is_elsewhere).then_some(heartbeats);
            [Some(noticed), missing].into_iter().flatten().collect()
        }
    }
}
