//! Faults of one node, from the scenario.

use std::time::Duration;

use scenario::fault::{Fault, Faults, Group};

/// Current through the plant while its drive is dead.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Output {
    /// The amplifier keeps its last command.
    Hold,
    /// The current is zero: the amplifier is switched off with its drive.
    Zero,
}

/// Kind of a node's fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// The node is dead; at the end of the fault it boots anew.
    Crash(Output),
    /// The node is frozen; at the end of the fault it continues.
    Hang,
    /// The node boots anew at once.
    Restart,
    /// The frames of the node leave it later by this time.
    Slow(Duration),
    /// The node's clock is fast by this fraction of the time.
    Drift(f64),
    /// The heartbeats of the node do not leave it.
    LostHeartbeat,
}

/// Fault in scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedFault {
    /// Start of the fault.
    pub from: Duration,
    /// End of the fault; `Duration::MAX` if it never ends.
    pub until: Duration,
    /// Kind of the fault.
    pub kind: FaultKind,
}

impl PlannedFault {
    /// Makes a fault of a node; `None` for a fault of its boot or its data sheet, and for an order that is sent to it.
    fn new(fault: &Fault) -> Option<Self> {
        let kind = match fault.kind.name {
            "crash" if fault.says("output", "hold") => FaultKind::Crash(Output::Hold),
            "crash" => FaultKind::Crash(Output::Zero),
            "hang" => FaultKind::Hang,
            "slow_cycle" => {
                let seconds = fault.number("delay_milliseconds") * 1e-3;
                FaultKind::Slow(Duration::from_secs_f64(seconds))
            }
            "clock_drift" => FaultKind::Drift(fault.number("parts_per_million") * 1e-6),
            "lost_heartbeat" => FaultKind::LostHeartbeat,
            "restart" => FaultKind::Restart,
            _ => return None,
        };
        let until = fault.until_seconds;
        Some(Self {
            from: Duration::from_secs_f64(fault.from_seconds?),
            until: until.map_or(Duration::MAX, Duration::from_secs_f64),
            kind,
        })
    }

    /// Returns whether it acts at a scenario time.
    pub fn acts_at(&self, time: Duration) -> bool {
        (self.from..self.until).contains(&time)
    }
}

/// All faults of one node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// Node-ID.
    pub number: u8,
    /// Delay of its boot after the others.
    pub late_boot: Duration,
    /// Other faults.
    pub faults: Vec<PlannedFault>,
}

impl FaultPlan {
    /// Returns the faults of the node with the node-ID `number`.
    pub fn new(faults: &Faults, number: u8) -> Self {
        let boots = faults.of("late_boot");
        let late_boot = boots
            .map(|fault| fault.number("delay_seconds"))
            .fold(0.0, f64::max);
        Self {
            number,
            late_boot: Duration::from_secs_f64(late_boot),
            faults: faults
                .in_group(Group::Node)
                .filter_map(PlannedFault::new)
                .collect(),
        }
    }

    /// Removes the faults that `is_played_elsewhere` accepts.
    #[must_use]
    pub fn without(mut self, is_played_elsewhere: impl Fn(&FaultKind) -> bool) -> Self {
        self.faults
            .retain(|fault| !is_played_elsewhere(&fault.kind));
        self
    }
}
