//! Names of the nodes whose frames are read.

use plan::{ControlLoop, Shared, each_once};

/// Names of the nodes on a bus, as one loop sees them.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeNames {
    /// Name of the loop, if there are several.
    loop_name: Option<String>,
    /// All nodes of the run by node-ID and name, those of the loop first.
    nodes: Vec<(u8, String)>,
}

impl NodeNames {
    pub(crate) fn new(shared: &Shared, one: &ControlLoop) -> Self {
        let here = one
            .trial
            .wiring
            .all_nodes()
            .map(|node| (node.id, node.name.clone()));
        let all = shared.rig.node.iter();
        let mut all = Vec::from_iter(all.map(|(name, node)| (node.node_id, name.clone())));
        all.sort();
        Self {
            loop_name: one.loop_name().map(str::to_owned),
            nodes: each_once(here.chain(all)),
        }
    }

    /// Returns the name of the loop, if there are several.
    pub(crate) fn loop_name(&self) -> Option<&str> {
        self.loop_name.as_deref()
    }

    /// Returns the name of a node.
    pub(crate) fn name(&self, id: u8) -> Option<&str> {
        let mut nodes = self.nodes.iter();
        let (_, name) = nodes.find(|(known, _)| *known == id)?;
        Some(name)
    }

    /// Returns the names of all nodes, those of the loop first.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|(_, name)| name.as_str())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use scenario::node::{LoopNodes, Node, Part};

    use super::*;

    /// Returns the names for two loops with a drive each, as one of them sees the bus.
    pub(crate) fn two_loops(name: &str) -> NodeNames {
        let nodes = |drive: &str, id| {
            let controller = (1, "controller".to_owned());
            let io = (id + 0x10, format!("{drive}_io"));
            [controller, (id, drive.to_owned()), io]
        };
        let all = [("x_1", nodes("left", 0x12)), ("y", nodes("right", 0x13))];
        let (_, here) = all.iter().find(|(one, _)| *one == name).unwrap();
        let others = all.iter().flat_map(|(_, nodes)| nodes);
        NodeNames {
            loop_name: Some(name.to_owned()),
            nodes: each_once(here.iter().chain(others).cloned()),
        }
    }

    #[test]
    fn a_node_has_one_name_whichever_loop_sees_it() {
        let y = two_loops("y");
        let right = Node::new("right", 0x13, Part::Drive);
        assert_eq!(right.in_sentence(), "right");
        assert_eq!((y.name(0x13), y.name(0x14)), (Some("right"), None));
        assert_eq!(LoopNodes::default().drive.in_sentence(), "the drive");
        let names = Vec::from_iter(y.nodes());
        let expected = ["controller", "right", "right_io", "left", "left_io"];
        assert_eq!(names, expected);
    }
}
