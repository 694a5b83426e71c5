//! Finds rigs that the format can describe and this bench cannot serve.

use super::Check;
use crate::custom::is_name;
use crate::error::Problem;
use crate::rig::nodes::NodeKind;
use crate::wiring::IO_OUTPUTS_MAX;

impl Check<'_> {
    pub(super) fn unserved(&self) -> Vec<Problem> {
        let mut problems = self.outputs_without_room();
        problems.extend(self.idle_plants());
        problems
    }

    /// Finds io nodes without outputs, with more than fit in their frame, or with an output that has no valid name.
    fn outputs_without_room(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        for (name, node) in &self.rig.node {
            let Some(outputs) = &node.outputs else {
                continue;
            };
            let path = format!("node.{name}.outputs");
            if outputs.0.is_empty() {
                let message = format!("`{name}` acts on no plant");
                let label = "OUTPUT = \"PLANT.PORT\" is missing";
                problems.push(self.problem(&path, message, label));
            }
            let others = outputs.others().count();
            let room = if others == outputs.0.len() {
                IO_OUTPUTS_MAX
            } else {
                // Fan and load have their places, whether one of them is wired or both.
                IO_OUTPUTS_MAX - 2
            };
            if others > room {
                let message = format!("`{name}` has {others} outputs besides fan and load");
                let label = format!("its frame has room for {room}");
                problems.push(self.problem(&path, message, label));
            }
            let nameless = outputs.others().filter(|(output, _)| !is_name(output));
            problems.extend(nameless.map(|(output, _)| {
                let message = format!("`{output}` cannot be the name of an output");
                let label = "small letters, digits and underscores, a letter first";
                self.problem(&format!("{path}.{output}"), message, label)
            }));
        }
        problems
    }

    /// Finds plants that no node names, or that no drive of canrig emulates.
    fn idle_plants(&self) -> Vec<Problem> {
        let nodes = self.rig.node.values();
        let named = Vec::from_iter(nodes.flat_map(|node| node.plants()));
        let mut drives = self.rig.node.iter();
        let is_one_ours =
            drives.any(|(name, node)| node.is_ours() && self.rig.plant_of(name).is_some());
        let is_moved = |plant: &str| {
            let mut drives = self.nodes_of_kind(NodeKind::Drive);
            drives.any(|drive| self.rig.plant_of(drive) == Some(plant))
        };
        let problems = self.rig.plant.keys().filter_map(|plant| {
            let (message, label) = if !named.contains(&plant.as_str()) {
                let label =
                    "an amplifier, a sensor, a record or an output of an io node is wired to it";
                (format!("no node names the plant `{plant}`"), label)
            } else if !is_one_ours && !is_moved(plant) {
                let label = "no drive of this rig is canrig's";
                (format!("nobody emulates the plant `{plant}`"), label)
            } else {
                return None;
            };
            Some(self.problem(&format!("plant.{plant}"), message, label))
        });
        problems.collect()
    }
}
