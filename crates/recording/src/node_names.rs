//! Names of the nodes whose frames are read.

use plan::{Plan, each_once};

/// Names of the nodes on a bus.
#[derive(Debug, Default)]
pub(crate) struct NodeNames {
    /// Whether the plan has several loops.
    pub(crate) has_several_loops: bool,
    /// All nodes of the run by node-ID and name.
    nodes: Vec<(u8, String)>,
}

impl NodeNames {
    pub(crate) fn new(plan: &Plan) -> Self {
        let here = plan.nodes().map(|node| (node.id, node.name.clone()));
        let rig = plan.shared.rig.node.iter();
        let all = rig.map(|(name, node)| (node.node_id, name.clone()));
        Self {
            has_several_loops: plan.loops.len() > 1,
            nodes: each_once(here.chain(all)),
        }
    }

    /// Returns the name of a node.
    pub(crate) fn name(&self, id: u8) -> Option<&str> {
        let mut nodes = self.nodes.iter();
        let (_, name) = nodes.find(|(known, _)| *known == id)?;
        Some(name)
    }

    /// Returns the names of all nodes.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|(_, name)| name.as_str())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use scenario::node::{LoopNodes, Node, Part};

    use super::*;

    /// Returns the names for two loops with a drive each.
    pub(crate) fn two_loops() -> NodeNames {
        let nodes = [(1, "controller"), (0x12, "left"), (0x13, "right")];
        NodeNames {
            has_several_loops: true,
            nodes: nodes.map(|(id, name)| (id, name.to_owned())).into(),
        }
    }

    #[test]
    fn a_node_is_found_by_its_node_id() {
        let y = two_loops();
        let right = Node::new("right", 0x13, Part::Drive);
        assert_eq!(right.in_sentence(), "right");
        assert_eq!((y.name(0x13), y.name(0x14)), (Some("right"), None));
        assert_eq!(LoopNodes::default().drive.in_sentence(), "the drive");
        let names = Vec::from_iter(y.nodes());
        let expected = ["controller", "left", "right"];
        assert_eq!(names, expected);
    }
}
