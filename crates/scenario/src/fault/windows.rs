//! All faults of a scenario as one list: where they stand in the file, when they act, what they are called.

use super::lasting::Lasting;
use super::node::Node;
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
    /// What happens, for people.
    pub text: String,
}

impl FaultWindow {
    fn new(group: &'static str, kind: &'static str, index: usize, whose: Option<Node>) -> Self {
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

/// Adds the windows of kinds that last.
macro_rules! lasting {
    ($windows:ident, $faults:expr, $group:literal: $($kind:ident),*) => {
        $($windows.extend($faults.$kind.iter().enumerate().map(|(index, fault)| {
            FaultWindow::new($group, stringify!($kind), index, None).lasting(fault)
        }));)*
    };
    ($windows:ident, $faults:expr, of node: $($kind:ident),*) => {
        $($windows.extend($faults.$kind.iter().enumerate().map(|(index, fault)| {
            FaultWindow::new("node", stringify!($kind), index, Some(fault.node)).lasting(fault)
        }));)*
    };
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
        lasting!(windows, self.bus, "bus": lose, delay, duplicate, reorder, corrupt, bit_error, babble, load);
        lasting!(windows, self.node, of node: crash, hang, slow_cycle, clock_drift, lost_heartbeat);
        windows.extend(self.node_instants());
        lasting!(windows, self.sensor, "sensor": offset, drift, noise, spikes, lost_bits, stuck);
        lasting!(windows, self.amplifier, "amplifier": saturated, stuck_on, dead);
        lasting!(windows, self.plant, "plant": ageing, broken_wire, jammed_pulley, dropped_load);
        windows
    }

    /// Faults of nodes that happen at one instant or at the boot.
    fn node_instants(&self) -> Vec<FaultWindow> {
        let node = |kind, index, whose| FaultWindow::new("node", kind, index, Some(whose));
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
