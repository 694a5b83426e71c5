//! What happens to one node, from the scenario.

use std::time::Duration;

use scenario::fault::{Fault, Faults, Group};

/// The current through the plant while its drive is dead.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Output {
    /// The amplifier keeps its last command.
    Hold,
    /// None: the amplifier is switched off with its drive.
    Zero,
}

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
    /// A fault of a node; `None` for one of its boot or its data sheet, and for an order that somebody gives it.
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
    /// The faults of one node, whose number on the bus this is.
    #[must_use]
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

    /// Without the faults of these kinds, which something else plays.
    #[must_use]
    pub fn without(mut self, is_played_elsewhere: impl Fn(&FaultKind) -> bool) -> Self {
        self.faults
            .retain(|fault| !is_played_elsewhere(&fault.kind));
        self
    }
}
