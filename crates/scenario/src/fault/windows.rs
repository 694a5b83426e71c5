//! All faults of a scenario as one list: where they stand in the file, when they act, which frames they touch, what they are called.

use super::bus::{Delay, Lose, OfFrames, Station};
use super::lasting::Lasting;
use super::node::{ClockDrift, Crash, Hang, LostHeartbeat, Node, SlowCycle};
use super::table::Faults;

/// Where a fault stands, which is also its name: `fault.sensor.stuck.0`.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Place {
    /// The group: `sensor`.
    pub group: &'static str,
    /// The kind: `stuck`.
    pub kind: &'static str,
    /// Which of its kind.
    pub index: usize,
}

impl Place {
    /// The path in the document.
    #[must_use]
    pub fn path(&self) -> String {
        format!("fault.{}.{}.{}", self.group, self.kind, self.index)
    }
}

/// The cyclic frames that a fault can keep from the bus. What a node does about a fault it reports itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Touch {
    /// None.
    Nothing,
    /// Those of all nodes.
    All,
    /// Those of a node.
    Of(Node),
    /// Those of a node, or of all, which come so much later.
    Late(Option<Node>, f64),
    /// Heartbeats of a node: the nodes that watch it may stop.
    HeartbeatsOf(Node),
}

/// When a fault acts.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultWindow {
    /// Where it stands.
    pub place: Place,
    /// Begins; before the start of the scenario, if it is about how a node boots.
    pub from_seconds: Option<f64>,
    /// Ends; with the run if absent. What happens at an instant ends at that instant.
    pub until_seconds: Option<f64>,
    /// The node that fails; none where a part of the rig or the bus does.
    pub node: Option<Node>,
    /// The frames that it touches.
    pub touch: Touch,
    /// What happens, for people.
    pub text: String,
}

impl FaultWindow {
    fn new(
        group: &'static str,
        kind: &'static str,
        index: usize,
        (whose, touch): (Option<Node>, Touch),
    ) -> Self {
        let name = kind.replace('_', " ");
        let text = match whose {
            Some(node) => format!("fault: {} {name}", node.name()),
            None => format!("fault: {group} {name}"),
        };
        Self {
            place: Place { group, kind, index },
            from_seconds: None,
            until_seconds: None,
            node: whose,
            touch,
            text,
        }
    }

    /// What happens, for people who see several loops: which node it happens to.
    #[must_use]
    pub fn text_of(&self, controller: &str, drive: &str) -> String {
        let Place { group, kind, .. } = self.place;
        let name = kind.replace('_', " ");
        match self.node {
            Some(Node::Controller) => format!("fault: {controller} {name}"),
            Some(Node::Drive) => format!("fault: {drive} {name}"),
            None if group == "bus" => self.text.clone(),
            None => format!("fault: {drive} {group} {name}"),
        }
    }

    fn lasting(mut self, fault: &impl Lasting) -> Self {
        self.from_seconds = Some(fault.start_seconds());
        self.until_seconds = fault.end_seconds();
        self
    }

    fn instant(mut self, at_seconds: f64) -> Self {
        self.from_seconds = Some(at_seconds);
        self.until_seconds = Some(at_seconds);
        self
    }
}

/// Adds the windows of kinds that last, each with the frames that it touches.
macro_rules! lasting {
    ($windows:ident, $faults:expr, $group:literal: $($kind:ident $touch:expr),*) => {
        $($windows.extend($faults.$kind.iter().enumerate().map(|(index, fault)| {
            let touch = ($touch)(fault);
            FaultWindow::new($group, stringify!($kind), index, (None, touch)).lasting(fault)
        }));)*
    };
    ($windows:ident, $faults:expr, of node: $($kind:ident $touch:expr),*) => {
        $($windows.extend($faults.$kind.iter().enumerate().map(|(index, fault)| {
            let touch = ($touch)(fault);
            FaultWindow::new("node", stringify!($kind), index, (Some(fault.node), touch)).lasting(fault)
        }));)*
    };
}

/// The node whose frames a fault of frames at a station touches; none where it touches those of all.
fn node_at(station: Option<Station>) -> Option<Node> {
    match station? {
        Station::Controller => Some(Node::Controller),
        Station::Drive => Some(Node::Drive),
        Station::Bench => None,
    }
}

/// What is wrong behind the drive's software touches no frame.
fn nothing<T>(_: &T) -> Touch {
    Touch::Nothing
}

impl Faults {
    /// True without any fault.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.windows().is_empty()
    }

    /// All faults, in the order of the format.
    #[must_use]
    pub fn windows(&self) -> Vec<FaultWindow> {
        let mut windows = Vec::new();
        lasting!(windows, self.bus, "bus":
            // What the receiver misses it does not answer.
            lose |fault: &Lose| node_at(fault.station()).map_or(Touch::Nothing, Touch::Of),
            delay |fault: &Delay| Touch::Late(node_at(fault.station()), fault.delay_milliseconds / 1e3),
            duplicate |_| Touch::Nothing, reorder |_| Touch::All, corrupt |_| Touch::All,
            bit_error |_| Touch::All, babble |_| Touch::All, load |_| Touch::All);
        lasting!(windows, self.node, of node:
            crash |fault: &Crash| Touch::Of(fault.node), hang |fault: &Hang| Touch::Of(fault.node),
            slow_cycle |fault: &SlowCycle| Touch::Late(Some(fault.node), fault.delay_milliseconds / 1e3),
            clock_drift |fault: &ClockDrift| Touch::Of(fault.node),
            lost_heartbeat |fault: &LostHeartbeat| Touch::HeartbeatsOf(fault.node));
        windows.extend(self.node_instants());
        lasting!(windows, self.sensor, "sensor":
            offset nothing, drift nothing, noise nothing, spikes nothing, lost_bits nothing, stuck nothing);
        lasting!(windows, self.amplifier, "amplifier": saturated nothing, stuck_on nothing, dead nothing);
        lasting!(windows, self.plant, "plant":
            ageing nothing, broken_wire nothing, jammed_pulley nothing, dropped_load nothing);
        windows
    }

    /// Faults of nodes that happen at one instant or at the boot.
    fn node_instants(&self) -> Vec<FaultWindow> {
        let node = |kind, index, whose| {
            FaultWindow::new("node", kind, index, (Some(whose), Touch::Of(whose)))
        };
        let mut windows = Vec::new();
        for (index, fault) in self.node.restart.iter().enumerate() {
            windows.push(node("restart", index, fault.node).instant(fault.at_seconds));
        }
        for (index, fault) in self.node.nmt_stop.iter().enumerate() {
            windows.push(node("nmt_stop", index, fault.node).instant(fault.at_seconds));
        }
        for (index, fault) in self.node.late_boot.iter().enumerate() {
            windows.push(node("late_boot", index, fault.node));
        }
        for index in 0..self.node.wrong_identity.len() {
            windows.push(node("wrong_identity", index, Node::Drive));
        }
        for index in 0..self.node.wrong_node_id.len() {
            windows.push(node("wrong_node_id", index, Node::Drive));
        }
        windows
    }
}
