//! Faults of one node, from the scenario.

use std::time::Duration;

use scenario::fault::{Actor, Fault, Faults, Group};

/// Fault of a node in scenario time.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedFault {
    /// Start of the fault.
    pub from: Duration,
    /// End of the fault; `Duration::MAX` if it never ends.
    pub until: Duration,
    /// The fault itself.
    pub fault: Fault,
}

impl PlannedFault {
    /// Makes a fault of a node; `None` for a fault of its boot or its data sheet, and for an order that is sent to it.
    fn new(fault: &Fault) -> Option<Self> {
        let from_seconds = fault
            .from_seconds
            .filter(|_| fault.kind.actor != Actor::Message)?;
        let until = fault.until_seconds;
        Some(Self {
            from: Duration::from_secs_f64(from_seconds),
            until: until.map_or(Duration::MAX, Duration::from_secs_f64),
            fault: fault.clone(),
        })
    }

    /// Returns the name of its kind.
    pub fn name(&self) -> &'static str {
        self.fault.kind.name
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
}
