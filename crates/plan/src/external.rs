//! Nodes of a run that canrig does not start but expects on the bus: a real drive, a foreign controller.

use std::collections::BTreeSet;

use scenario::meant_or_known;
use scenario::node::Node;

/// The nodes of a run that are external, by node-ID.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct External(BTreeSet<u8>);

impl External {
    /// Whether a node is external.
    #[must_use]
    pub fn has(&self, node: &Node) -> bool {
        self.0.contains(&node.id)
    }

    /// Makes a node external.
    pub(crate) fn insert(&mut self, node_id: u8) {
        self.0.insert(node_id);
    }

    /// Whether canrig starts all nodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// The refusal of an external node that a run does not have.
#[must_use]
pub fn no_such_node(name: &str, known: &[&str]) -> String {
    let meant = meant_or_known(name, known);
    format!("--external {name}: there is no such node; {meant}")
}
