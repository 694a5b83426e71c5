//! Which node-IDs nodes can have.

use std::collections::BTreeMap;

use super::Check;
use crate::error::Problem;
use crate::rig::nodes::EMULATED_NODE_ID_MAX;

impl Check<'_> {
    /// Each once, and none of an emulated node beyond those whose other identifiers are free.
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
            if id > EMULATED_NODE_ID_MAX && !node.external {
                let message =
                    format!("the emulated node `{name}` cannot have the node-ID {id} (0x{id:X})");
                let label = format!("at most {EMULATED_NODE_ID_MAX} (0x{EMULATED_NODE_ID_MAX:X})");
                let problem = self.document.problem(&path, message, label);
                problems.push(problem.with_help(
                    "the second SDO channel and the truth frames of an emulated node have identifiers of nodes 32 and 64 further on",
                ));
            }
            taken.entry(id).or_insert(name);
        }
        problems
    }
}
