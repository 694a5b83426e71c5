//! Nodes of a run that canrig does not start but expects on the bus: a real drive, a foreign controller.

use std::fmt;

use scenario::fault::{Fault, Group};
use scenario::{Scenario, meant_or_known};

/// A node that may be somebody else's.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum ExternalNode {
    /// The drive, and with it the actuator: the emulator is not started
    Drive,
    /// The controller
    Controller,
    /// The fan and load module; needs `drive` too, since a real fan cannot cool an emulated wire
    Fan,
}

impl ExternalNode {
    const ALL: [Self; 3] = [Self::Drive, Self::Controller, Self::Fan];

    /// Its name on a bench with one drive.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Drive => "drive",
            Self::Controller => "controller",
            Self::Fan => "fan",
        }
    }
}

/// The nodes of a run that are somebody else's, sorted.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct External(Vec<ExternalNode>);

impl External {
    /// These nodes.
    ///
    /// # Errors
    /// Why they cannot be external together.
    pub fn new(nodes: &[ExternalNode]) -> Result<Self, &'static str> {
        let mut nodes = nodes.to_vec();
        nodes.sort_unstable();
        nodes.dedup();
        let external = Self(nodes);
        if external.has(ExternalNode::Fan) && !external.has(ExternalNode::Drive) {
            return Err(
                "--external fan needs --external drive: a real fan cannot cool an emulated wire",
            );
        }
        Ok(external)
    }

    /// These nodes of a bench with one drive, by their names.
    ///
    /// # Errors
    /// A name is no node's, or why they cannot be external together.
    pub fn of_names(names: &[String]) -> Result<Self, String> {
        let known = ExternalNode::ALL.map(ExternalNode::name);
        let node = |name: &String| {
            let node = ExternalNode::ALL.into_iter().find(|one| one.name() == name);
            node.ok_or_else(|| no_such_node(name, &known))
        };
        let nodes = names.iter().map(node).collect::<Result<Vec<_>, _>>()?;
        Self::new(&nodes).map_err(str::to_owned)
    }

    /// The nodes.
    pub fn nodes(&self) -> impl Iterator<Item = ExternalNode> {
        self.0.iter().copied()
    }

    /// The same with the drive external.
    #[must_use]
    pub fn with_drive(self) -> Self {
        if self.has(ExternalNode::Drive) {
            return self;
        }
        let mut nodes = self.0;
        nodes.insert(0, ExternalNode::Drive);
        Self(nodes)
    }

    /// The same, whose drive is external, with the fan and load module external too.
    #[must_use]
    pub(crate) fn with_fan(mut self) -> Self {
        self.0.push(ExternalNode::Fan);
        self
    }

    /// Whether a node is somebody else's.
    #[must_use]
    pub fn has(&self, node: ExternalNode) -> bool {
        self.0.contains(&node)
    }

    /// True when canrig starts all nodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether somebody plays the fan and load module: the emulator, or a real one.
    #[must_use]
    pub fn has_fan(&self) -> bool {
        !self.has(ExternalNode::Drive) || self.has(ExternalNode::Fan)
    }

    /// Refuses a fault of the scenario that would happen to a node that canrig does not start.
    ///
    /// # Errors
    /// Which fault, and why not.
    pub fn admits(&self, scenario: &Scenario) -> Result<(), String> {
        let own = scenario.own_faults();
        // The order is given over the bus, to whoever is there.
        let mut happening = own.filter(|fault| fault.kind.name != "nmt_stop");
        match happening.find(|fault| self.has(whose(fault))) {
            None => Ok(()),
            Some(fault) => Err(format!(
                "{} cannot be played: the {} is external, so nothing fails there on purpose",
                fault.kind.heading(),
                whose(fault).name()
            )),
        }
    }
}

/// What to say of an external node that is not there.
pub(crate) fn no_such_node(name: &str, known: &[&str]) -> String {
    let meant = meant_or_known(name, known);
    format!("--external {name}: there is no such node; {meant}")
}

/// Where a fault happens: sensor, amplifier, wire and mechanics are the emulated drive's.
fn whose(fault: &Fault) -> ExternalNode {
    match fault.is_at_controller() && fault.kind.group == Group::Node {
        true => ExternalNode::Controller,
        false => ExternalNode::Drive,
    }
}

/// `drive, fan`
impl fmt::Display for External {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.0.iter().map(|node| node.name()).collect();
        formatter.write_str(&names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "schema = 1\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n";

    fn admits(nodes: &[ExternalNode], fault: &str) -> Result<(), String> {
        let text = format!("{HEAD}{fault}");
        let scenario = Scenario::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap();
        External::new(nodes).unwrap().admits(&scenario)
    }

    #[test]
    fn a_fan_is_external_only_beside_an_external_drive() {
        use ExternalNode::{Drive, Fan};
        assert!(External::new(&[Fan]).is_err());
        let external = External::new(&[Fan, Drive, Fan]).unwrap();
        assert_eq!(external.to_string(), "drive, fan");
    }

    #[test]
    fn no_fault_happens_to_a_node_that_is_external() {
        use ExternalNode::{Controller, Drive};
        let stuck = "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n";
        let crash = |node| format!("[[fault.node.crash]]\nfrom_seconds = 1.0\nnode = \"{node}\"\n");
        let stop = "[[fault.node.nmt_stop]]\nat_seconds = 1.0\nnode = \"drive\"\n";
        let refused = admits(&[Drive], stuck).unwrap_err();
        assert!(refused.starts_with("[[fault.sensor.stuck]] cannot be played: the drive"));
        assert!(admits(&[Drive], &crash("drive")).is_err());
        assert!(admits(&[Controller], &crash("controller")).is_err());
        assert!(admits(&[Controller], &crash("drive")).is_ok());
        assert!(admits(&[Drive], &crash("controller")).is_ok());
        assert!(admits(&[Drive], stop).is_ok());
        assert!(admits(&[Controller], stuck).is_ok());
    }
}
