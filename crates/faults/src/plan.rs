//! What happens to one node, from the scenario.

use std::time::Duration;

use scenario::fault::node::{Node, Output};
use scenario::fault::{Faults, Lasting};

/// How a node fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// Dead; at its end it boots anew.
    Crash(Output),
    /// Frozen; at its end it goes on.
    Hang,
    /// Boots anew at once.
    Restart,
    /// What it says leaves it later.
    Slow(Duration),
    /// Its clock is fast by so much of the time.
    Drift(f64),
    /// Its heartbeats do not leave it.
    LostHeartbeat,
}

/// One fault in scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedFault {
    /// Begins.
    pub from: Duration,
    /// Ends; `Duration::MAX` if never.
    pub until: Duration,
    /// How.
    pub kind: FaultKind,
}

impl PlannedFault {
    fn new(fault: &impl Lasting, kind: FaultKind) -> Self {
        Self {
            from: Duration::from_secs_f64(fault.start_seconds()),
            until: fault
                .end_seconds()
                .map_or(Duration::MAX, Duration::from_secs_f64),
            kind,
        }
    }

    /// Whether it acts at a scenario time.
    #[must_use]
    pub fn acts_at(&self, time: Duration) -> bool {
        (self.from..self.until).contains(&time)
    }
}

/// All that happens to one node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// The node's number on the bus.
    pub number: u8,
    /// How long after the others it boots.
    pub late_boot: Duration,
    /// The rest.
    pub faults: Vec<PlannedFault>,
}

impl FaultPlan {
    /// The faults of a node, in scenario time.
    #[must_use]
    pub fn new(faults: &Faults, node: Node) -> Self {
        let all = &faults.node;
        let mut planned = Vec::new();
        for fault in all.crash.iter().filter(|fault| fault.node == node) {
            planned.push(PlannedFault::new(fault, FaultKind::Crash(fault.output)));
        }
        for fault in all.hang.iter().filter(|fault| fault.node == node) {
            planned.push(PlannedFault::new(fault, FaultKind::Hang));
        }
        for fault in all.slow_cycle.iter().filter(|fault| fault.node == node) {
            let delay = Duration::from_secs_f64(fault.delay_milliseconds * 1e-3);
            planned.push(PlannedFault::new(fault, FaultKind::Slow(delay)));
        }
        for fault in all.clock_drift.iter().filter(|fault| fault.node == node) {
            let rate = fault.parts_per_million * 1e-6;
            planned.push(PlannedFault::new(fault, FaultKind::Drift(rate)));
        }
        for fault in all.lost_heartbeat.iter().filter(|fault| fault.node == node) {
            planned.push(PlannedFault::new(fault, FaultKind::LostHeartbeat));
        }
        for fault in all.restart.iter().filter(|fault| fault.node == node) {
            let at = Duration::from_secs_f64(fault.at_seconds);
            planned.push(PlannedFault {
                from: at,
                until: at,
                kind: FaultKind::Restart,
            });
        }
        let boots = all.late_boot.iter().filter(|fault| fault.node == node);
        let late_boot = boots.map(|fault| fault.delay_seconds).fold(0.0, f64::max);
        Self {
            number: node.number(),
            late_boot: Duration::from_secs_f64(late_boot),
            faults: planned,
        }
    }

    /// Without the faults of these kinds, which something else plays.
    #[must_use]
    pub fn without(mut self, is_played_elsewhere: impl Fn(&FaultKind) -> bool) -> Self {
        self.faults
            .retain(|fault| !is_played_elsewhere(&fault.kind));
        self
    }
}
