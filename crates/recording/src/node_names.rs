//! Descriptions of the nodes whose frames are read: their names on the rig, and `the drive` for a node that is called `drive`.

use std::borrow::Cow;
use std::collections::BTreeMap;

use plan::{ControlLoop, Shared};
use scenario::node::LoopNodes;

/// Names of the nodes on a bus, as one loop sees them.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeNames {
    /// Name of the loop, if there are several.
    loop_name: Option<String>,
    nodes: LoopNodes,
    /// Names of all nodes of the run by node-ID.
    by_id: BTreeMap<u8, String>,
}

impl NodeNames {
    pub(crate) fn new(shared: &Shared, one: &ControlLoop) -> Self {
        let nodes = &one.nodes;
        let all = nodes.all().map(|node| (node.id, node.name.clone()));
        let others = shared
            .rig
            .node
            .iter()
            .map(|(name, node)| (node.node_id, name.clone()));
        Self {
            loop_name: one.loop_name().map(str::to_owned),
            nodes: nodes.clone(),
            by_id: all.chain(others).collect(),
        }
    }

    /// Returns the name of the loop, if there are several.
    pub(crate) fn loop_name(&self) -> Option<&str> {
        self.loop_name.as_deref()
    }

    /// Returns the name of the controller, within a sentence.
    pub(crate) fn controller(&self) -> Cow<'_, str> {
        self.nodes.controller.in_sentence()
    }

    /// Returns the name of the drive, within a sentence.
    pub(crate) fn drive(&self) -> Cow<'_, str> {
        self.nodes.drive.in_sentence()
    }

    /// Returns the name of a node.
    pub(crate) fn name(&self, id: u8) -> Option<&str> {
        self.by_id.get(&id).map(String::as_str)
    }

    /// Returns the names of all nodes, those of the loop first.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &str> {
        let here = self.nodes.all().map(|node| node.name.as_str());
        let is_other = |name: &&str| self.nodes.all().all(|node| node.name != **name);
        let others = self.by_id.values().map(String::as_str).filter(is_other);
        here.chain(others)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use scenario::node::{Node, Part};

    use super::*;

    /// Returns the names for two loops with a drive each, as one of them sees the bus.
    pub(crate) fn two_loops(name: &str) -> NodeNames {
        let nodes = |drive: &str, id| LoopNodes {
            controller: Node::new("controller", 1, Part::Controller),
            drive: Node::new(drive, id, Part::Drive),
            followed: Node::new(drive, id, Part::Drive),
            io: vec![Node::new(&format!("{drive}_io"), id + 0x10, Part::Io)],
        };
        let all = [("x_1", nodes("left", 0x12)), ("y", nodes("right", 0x13))];
        let (_, here) = all.iter().find(|(one, _)| *one == name).unwrap();
        let by_id = all.iter().flat_map(|(_, nodes)| nodes.all());
        NodeNames {
            loop_name: Some(name.to_owned()),
            nodes: here.clone(),
            by_id: by_id.map(|node| (node.id, node.name.clone())).collect(),
        }
    }

    #[test]
    fn a_node_has_one_name_whichever_loop_sees_it() {
        let y = two_loops("y");
        assert_eq!(y.drive(), "right");
        assert_eq!((y.name(0x13), y.name(0x14)), (Some("right"), None));
        assert_eq!(NodeNames::default().drive(), "the drive");
        let names = Vec::from_iter(y.nodes());
        let expected = ["controller", "right", "right_io", "left", "left_io"];
        assert_eq!(names, expected);
    }
}
