//! Checks the node-IDs of nodes.

use std::collections::BTreeMap;

use super::Check;
use crate::error::Problem;

impl Check<'_> {
    /// Checks that each node-ID is given once.
    pub(super) fn node_ids(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut taken: BTreeMap<u8, &str> = BTreeMap::new();
        for (name, node) in &self.rig.node {
            let id = node.node_id;
            let path = format!("node.{name}.node_id");
            if let Some(other) = taken.get(&id) {
                let message =
                    format!("`{other}` and `{name}` have the same node-ID {id} (0x{id:X})");
                let problem = self.document.problem(&path, message, "and here");
                let first = self.document.span(&format!("node.{other}.node_id"));
                problems.push(problem.with_place(first, "here"));
            }
            taken.entry(id).or_insert(name);
        }
        problems
    }
}
