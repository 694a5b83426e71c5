//! Nodes of a run that canrig does not play itself: a real drive, a foreign controller, a program that it starts.

use std::collections::BTreeMap;

use scenario::node::Node;

/// External nodes of a run by node-ID, each with whether canrig starts a program for it.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub struct External(BTreeMap<u8, bool>);

impl External {
    /// Checks whether a node is external.
    pub fn has(&self, node: &Node) -> bool {
        self.0.contains_key(&node.id)
    }

    /// Checks whether a node is a program that canrig starts.
    pub fn is_program(&self, node: &Node) -> bool {
        self.0.get(&node.id) == Some(&true)
    }

    /// Makes a node external; `is_program` marks one for which canrig starts a program.
    pub(crate) fn insert(&mut self, node_id: u8, is_program: bool) {
        self.0.insert(node_id, is_program);
    }
}
