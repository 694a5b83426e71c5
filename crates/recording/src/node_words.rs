//! What people call the nodes whose frames are read: in a scenario of one drive by what they are, among several loops by the rig's
//! names.

use std::collections::BTreeMap;

use dbc::Database;
use rig::plan::{ControlLoop, LoopNodes, Shared};
use scenario::events::LoopWords;

const HEARTBEAT: &str = "heartbeat";
const HEARTBEATS: u32 = 0x700;
/// Nodes whose messages have the name of their loop before them where the loop is another one.
const OF_OTHERS: [&str; 2] = ["drive", "disturbance"];

/// The names of the nodes on a bus, as one loop sees them.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeWords {
    /// Which of several loops it is.
    own: Option<LoopWords>,
    /// What its module is called.
    module: Option<String>,
    /// The nodes of all loops.
    of_loops: BTreeMap<String, LoopNodes>,
    /// The names of several loops' nodes by node-ID.
    by_id: BTreeMap<u8, String>,
}

impl NodeWords {
    pub(crate) fn new(shared: &Shared, one: &ControlLoop) -> Self {
        let LoopNodes {
            controller,
            drive,
            io,
        } = &one.nodes;
        let Some(names) = &one.loop_name else {
            return Self::default();
        };
        let mut words = Self {
            own: Some(LoopWords {
                name: names.name.clone(),
                controller: controller.name.clone(),
                drive: drive.name.clone(),
            }),
            module: io.as_ref().map(|io| io.name.clone()),
            of_loops: shared.nodes_of_loops.clone(),
            by_id: BTreeMap::new(),
        };
        words.by_id = words.ids(&one.database);
        words
    }

    /// The senders of the heartbeats.
    fn ids(&self, database: &Database) -> BTreeMap<u8, String> {
        let messages = database.messages().iter();
        let heartbeats = messages.filter(|message| message.name.ends_with(HEARTBEAT));
        let ids = heartbeats.filter_map(|message| {
            let id = u8::try_from(message.raw_id.checked_sub(HEARTBEATS)?).ok()?;
            Some((id, self.of_message(&message.name).1))
        });
        ids.collect()
    }

    /// The loop and its nodes, where there are several.
    pub(crate) fn of_loop(&self) -> Option<&LoopWords> {
        self.own.as_ref()
    }

    /// The controller, within a sentence.
    pub(crate) fn controller(&self) -> &str {
        let own = self.own.as_ref().map(|own| own.controller.as_str());
        own.filter(|name| *name != "controller")
            .unwrap_or("the controller")
    }

    /// The own drive, within a sentence.
    pub(crate) fn drive(&self) -> &str {
        self.own.as_ref().map_or("the drive", |own| &own.drive)
    }

    /// The own module, within a sentence.
    pub(crate) fn module(&self) -> &str {
        self.module.as_deref().unwrap_or("the disturbance module")
    }

    /// One of several loops' nodes.
    pub(crate) fn of_node(&self, id: u8) -> Option<&str> {
        self.by_id.get(&id).map(String::as_str)
    }

    /// Whose a message is: as a scenario of one drive names the node, and for people. Messages of other loops begin with their names.
    pub(crate) fn of_message(&self, message: &str) -> (String, String) {
        let others = self.of_loops.keys().filter_map(|name| {
            let rest = message.strip_prefix(name.as_str())?.strip_prefix('_')?;
            let (kind, _) = rest.split_once('_')?;
            OF_OTHERS.contains(&kind).then_some((name.as_str(), kind))
        });
        // The name of a loop may begin with that of another one.
        if let Some((name, kind)) = others.max_by_key(|(name, _)| name.len()) {
            let shown = self.node_of(name, kind);
            return (shown.clone(), shown);
        }
        let kind = message.split('_').next().unwrap_or_default();
        let own = self.own.as_ref();
        let shown = own.map_or_else(|| kind.to_owned(), |own| self.node_of(&own.name, kind));
        (kind.to_owned(), shown)
    }

    fn node_of(&self, loop_name: &str, kind: &str) -> String {
        let Some(nodes) = self.of_loops.get(loop_name) else {
            return kind.to_owned();
        };
        let name = match kind {
            "drive" => &nodes.drive.name,
            "disturbance" => nodes.io.as_ref().map_or(kind, |io| &io.name),
            "controller" => &nodes.controller.name,
            other => other,
        };
        name.to_owned()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use scenario::node::{Node, Part};

    use super::*;

    /// Two loops with a drive each, as one of them sees the bus.
    pub(crate) fn of_two_loops(own: &str) -> NodeWords {
        let nodes = |drive: &str| LoopNodes {
            controller: Node::new("controller", 1, Part::Controller),
            drive: Node::new(drive, 2, Part::Drive),
            io: Some(Node::new(&format!("{drive}_io"), 3, Part::Io)),
        };
        let of_loops = BTreeMap::from(
            [("x_1", "left"), ("y", "right")].map(|(name, drive)| (name.to_owned(), nodes(drive))),
        );
        NodeWords {
            own: Some(LoopWords {
                name: own.to_owned(),
                controller: "controller".to_owned(),
                drive: of_loops[own].drive.name.clone(),
            }),
            module: of_loops[own].io.as_ref().map(|io| io.name.clone()),
            of_loops,
            by_id: BTreeMap::from([(0x01, "controller".to_owned()), (0x13, "right".to_owned())]),
        }
    }

    #[test]
    fn a_node_has_one_name_whichever_loop_sees_it() {
        let (x, y) = (of_two_loops("x_1"), of_two_loops("y"));
        let shown = |words: &NodeWords, message: &str| words.of_message(message).1;
        assert_eq!(shown(&NodeWords::default(), "drive_heartbeat"), "drive");
        for (of_x, of_y, name) in [
            ("drive_heartbeat", "x_1_drive_heartbeat", "left"),
            (
                "disturbance_emergency",
                "x_1_disturbance_emergency",
                "left_io",
            ),
            ("y_drive_tpdo1", "drive_tpdo1", "right"),
            ("controller_heartbeat", "controller_heartbeat", "controller"),
        ] {
            assert_eq!(shown(&x, of_x), name);
            assert_eq!(shown(&y, of_y), name);
        }
        // A name that has the word for a kind in it, and one that begins with another one.
        let named = |name: &str| LoopNodes {
            drive: Node::new(&format!("drive of {name}"), 2, Part::Drive),
            ..x.of_loops["y"].clone()
        };
        let names = ["gantry", "gantry_drive_left", "gantry_drive_right"];
        let gantry = NodeWords {
            of_loops: names.map(|name| (name.to_owned(), named(name))).into(),
            ..NodeWords::default()
        };
        for name in names {
            let message = format!("{name}_drive_emergency");
            assert_eq!(shown(&gantry, &message), format!("drive of {name}"));
        }
        // What a scenario of one drive calls it.
        assert_eq!(y.of_message("drive_emergency").0, "drive");
        assert_eq!((y.drive(), y.module()), ("right", "right_io"));
        assert_eq!((y.of_node(0x13), y.of_node(0x14)), (Some("right"), None));
    }
}
