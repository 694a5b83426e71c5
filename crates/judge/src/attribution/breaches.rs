//! The duties of the nodes, and every breach of one: a frame that did not come when it was due.

use std::iter::Peekable;

use plan::ControlLoop;
use recording::timeline::Timeline;
use scenario::node::NodeIndex;

/// Duty of a node towards the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Duty {
    /// A SYNC one period after the last.
    Sync,
    /// A position for each SYNC.
    Position,
    /// A command for each position, before the next one.
    Command,
    /// A heartbeat within the time that the others wait for it.
    Heartbeat(NodeIndex),
    /// To leave the nodes in operation: an external controller may stop them by NMT.
    Nmt,
    /// To lead: not to disable the drive, change how it communicates, or flood the bus.
    Lead,
    /// To stay in the state into which the manager put this node.
    State(NodeIndex),
}

impl Duty {
    /// Returns the node of a loop that has the duty.
    pub(crate) fn node(self, one: &ControlLoop) -> NodeIndex {
        match self {
            Self::Sync | Self::Command | Self::Nmt | Self::Lead => one.controller_index(),
            Self::Position => one.drive_index(),
            Self::Heartbeat(node) | Self::State(node) => node,
        }
    }

    /// Returns its place among several duties in a text: those of the controller come before the same ones of the drive.
    pub(crate) fn place(self, one: &ControlLoop) -> (usize, bool) {
        let kind = match self {
            Self::Sync => 0,
            Self::Position => 1,
            Self::Command => 2,
            Self::Heartbeat(_) => 3,
            Self::Nmt => 4,
            Self::Lead => 5,
            Self::State(_) => 6,
        };
        (kind, self.node(one) != one.controller_index())
    }

    /// Returns whether an external node has the duty.
    pub(crate) fn is_of_external(self, one: &ControlLoop) -> bool {
        one.node(self.node(one)).is_external()
    }

    /// Returns the name in `verdict.json`, which is also what is missing after a breach.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Sync => "sync",
            Self::Position => "position",
            Self::Command => "command",
            Self::Heartbeat(_) => "heartbeat",
            Self::Nmt => "nmt",
            Self::Lead => "lead",
            Self::State(_) => "state",
        }
    }

    /// Describes a breach: `no SYNC`.
    pub(crate) fn breach(self) -> &'static str {
        match self {
            Self::Sync => "no SYNC",
            Self::Position => "no position",
            Self::Command => "no command",
            Self::Heartbeat(_) => "no heartbeat",
            Self::Nmt => "no position since it stopped the drive by NMT",
            Self::Lead => "no position since it took the drive out of operation",
            Self::State(_) => "no cycle since it left its state",
        }
    }

    /// Describes how a node left its duties: `left its state at 1.234 s`.
    pub(crate) fn departure(self, at_seconds: f64) -> String {
        let what = match self {
            Self::Sync => "no SYNC in its time",
            Self::Position => "no position in its time",
            Self::Command => "no command in its time",
            Self::Heartbeat(_) => "no heartbeat in its time",
            Self::Nmt => "stopped a node by NMT",
            Self::Lead => "took the drive out of operation",
            Self::State(_) => "left its state",
        };
        format!("{what} at {at_seconds:.3} s")
    }
}

/// Breach of a duty, from the time when its frame was due to the time when it came or was given up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Breach {
    pub(crate) duty: Duty,
    /// Number of the cycle.
    pub(crate) cycle: u64,
    pub(crate) from_seconds: f64,
    pub(crate) until_seconds: f64,
    /// Whether the frame came, but too late.
    pub(crate) is_late: bool,
}

impl Breach {
    /// Returns the breach of a single cycle.
    fn in_cycle(duty: Duty, cycle: u64, timeline: &Timeline) -> Self {
        Self {
            duty,
            cycle,
            from_seconds: timeline.cycle_start_seconds(cycle),
            until_seconds: timeline.cycle_start_seconds(cycle + 1),
            is_late: false,
        }
    }
}

/// Returns the cycles without a SYNC or a position, among those that were due.
pub(super) fn missed_cycles(timeline: &Timeline, due: u64) -> impl Iterator<Item = Breach> {
    let cycles = timeline.cycle.iter();
    let mut rows = cycles.zip(timeline.measured_position()).peekable();
    let missing =
        (0..due).filter_map(
            move |cycle| match rows.next_if(|(number, _)| *number <= cycle) {
                None => Some((cycle, Duty::Sync)),
                Some((_, position)) => position.is_nan().then_some((cycle, Duty::Position)),
            },
        );
    missing.map(move |(cycle, duty)| Breach::in_cycle(duty, cycle, timeline))
}

/// Returns those due cycles in which the command breaks its duty. Both sequences are in order.
pub(super) fn command_breaches(
    timeline: &Timeline,
    breaking: impl Iterator<Item = u64>,
    due: impl Iterator<Item = u64>,
    are_late: bool,
) -> impl Iterator<Item = Breach> {
    let mut breaking = breaking.peekable();
    let cycles = due.filter(move |cycle| has_next(&mut breaking, *cycle));
    cycles.map(move |cycle| Breach {
        is_late: are_late,
        ..Breach::in_cycle(Duty::Command, cycle, timeline)
    })
}

/// Returns the cycles with a position.
pub(super) fn served(timeline: &Timeline) -> impl Iterator<Item = u64> {
    let rows = timeline.cycle.iter().zip(timeline.position());
    rows.filter_map(|(cycle, position)| (!position.is_nan()).then_some(cycle))
}

/// Checks whether the coming cycles, which are in order, contain a cycle.
pub(super) fn has_next(cycles: &mut Peekable<impl Iterator<Item = u64>>, wanted: u64) -> bool {
    while cycles.next_if(|cycle| *cycle < wanted).is_some() {}
    cycles.peek() == Some(&wanted)
}
