//! Checks the names of plants, nodes and loops, and the node-IDs.

use std::collections::BTreeMap;

use crate::check::Check;
use crate::rig::nodes::RigLoop;
use crate::schema;
use dbc::names::{NAME_RULE, is_name};

/// Names that a loop cannot have: they mean something else in the place of a loop's name.
const NOT_A_LOOP: [&str; 2] = ["all", "contour"];
/// Names that no node can have: faults of the bus name canrig's own node `bench`, a process of a node `bus` would write to the log
/// of the recording, and the cause of a loss that is no node is `host` or `fault`.
const NOT_A_NODE: [&str; 4] = ["bench", "bus", "fault", "host"];
/// Names that no plant can have: its emulator's log has the plant's name, and these are the names of other logs in the same
/// folder.
const NOT_A_PLANT: [&str; 3] = ["bench", "bus", "controller"];
/// Tables of a scenario that have the tables of loops among other keys.
const BESIDE_LOOPS: [&str; 2] = ["controller", "expect"];

impl Check<'_> {
    /// Checks that other files can use each name, and that each name has one meaning.
    pub(super) fn names(&mut self) {
        let rig = self.rig;
        let named = [
            ("plant", Vec::from_iter(rig.plant.keys()), &NOT_A_PLANT[..]),
            ("node", Vec::from_iter(rig.node.keys()), &NOT_A_NODE),
            ("loop", Vec::from_iter(rig.loops.keys()), &[]),
        ];
        let mut taken: BTreeMap<&str, String> = BTreeMap::new();
        for (kind, names, reserved) in named {
            for name in names {
                let path = format!("{kind}.{name}");
                if !is_name(name) {
                    let message = format!("`{name}` can be no name of a {kind}");
                    self.at_key(&path, message, NAME_RULE);
                }
                let is_key = |table: &&str| schema::is_key(table, name);
                // A further drive of a law is a loop by its own name.
                let mut further = rig.loops.values().flat_map(|one| one.drives().skip(1));
                let is_loop =
                    kind == "loop" || further.any(|drive| kind == "node" && drive == name);
                let is_no_loop = BESIDE_LOOPS.iter().any(is_key)
                    || NOT_A_LOOP.contains(&name.as_str())
                    || rig.has_limit(name);
                if is_loop && is_no_loop || reserved.contains(&name.as_str()) {
                    let message = format!("a {kind} cannot be called `{name}`");
                    let label = "canrig uses this name itself, for a key, a node or a log";
                    self.at_key(&path, message, label);
                }
                // Wrong drives are reported elsewhere; until then it is open whether one of them is the loop's own.
                let may_be_called_so =
                    |one: &RigLoop| one.first() == Some(name) || !self.is_led_rightly(one);
                let is_named_after_drive =
                    kind == "loop" && rig.loops.get(name).is_some_and(may_be_called_so);
                if let Some(first) = taken.get(name.as_str()).filter(|_| !is_named_after_drive) {
                    let message = format!("`{name}` is the name of two things");
                    let place = self.document.key_span(first);
                    let label = format!("a {kind} here");
                    let problem = self.document.key_problem(&path, message, label);
                    let first = first.split('.').next().unwrap_or_default();
                    let label = format!("a {first} here");
                    self.add([problem.with_place(place, &label)]);
                }
                taken.entry(name).or_insert(path);
            }
        }
    }

    /// Checks that each node-ID is given once.
    pub(super) fn node_ids(&mut self) {
        let mut taken: BTreeMap<u8, &str> = BTreeMap::new();
        for (name, node) in &self.rig.node {
            let id = node.node_id;
            let path = format!("node.{name}.node_id");
            if let Some(other) = taken.get(&id) {
                let message =
                    format!("`{other}` and `{name}` have the same node-ID {id} (0x{id:X})");
                self.twice([&format!("node.{other}.node_id"), &path], message, "here");
            }
            taken.entry(id).or_insert(name);
        }
    }

    /// Checks whether a loop has drives, and all of them are its own.
    fn is_led_rightly(&self, one: &RigLoop) -> bool {
        let is_named = |drive: &str| {
            let leaders = self.rig.loops.values().flat_map(RigLoop::drives);
            self.rig.node.contains_key(drive)
                && leaders.filter(|other| *other == drive).count() == 1
        };
        !one.outputs.is_empty() && one.drives().all(is_named)
    }
}
