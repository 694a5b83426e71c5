//! Finds rigs that the format can describe and this bench cannot serve.

use crate::check::Check;
use crate::node::Profile;
use crate::wiring::IO_OUTPUTS_MAX;
use dbc::names::{NAME_RULE, is_name};

impl Check<'_> {
    /// Finds io nodes without outputs, with more than fit in their frame, or with an output that has no valid name.
    pub(super) fn outputs_without_room(&mut self) {
        for (name, node) in &self.rig.node {
            let Some(outputs) = &node.outputs else {
                continue;
            };
            let path = format!("node.{name}.outputs");
            if outputs.0.is_empty() {
                let message = format!("`{name}` acts on no plant");
                let label = "OUTPUT = \"PLANT.PORT\" is missing";
                self.at_key(&path, message, label);
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
                self.at_key(&path, message, label);
            }
            for (output, _) in outputs.others().filter(|(output, _)| !is_name(output)) {
                let message = format!("`{output}` cannot be the name of an output");
                self.at_key(&format!("{path}.{output}"), message, NAME_RULE);
            }
        }
    }

    /// Finds plants that no node names, or that no drive of canrig emulates.
    pub(super) fn idle_plants(&mut self) {
        let rig = self.rig;
        let named = Vec::from_iter(rig.node.values().flat_map(|node| node.plants()));
        let mut drives = rig.node.iter();
        let is_one_ours = drives.any(|(name, node)| node.is_ours() && rig.plant_of(name).is_some());
        let has_drives = rig.of_kind(Profile::Drive).next().is_some();
        let is_moved = |plant: &str| {
            let mut drives = rig.of_kind(Profile::Drive);
            drives.any(|(drive, _)| rig.plant_of(drive) == Some(plant))
        };
        for plant in rig.plant.keys() {
            let (message, label) = if !named.contains(&plant.as_str()) {
                let label =
                    "an amplifier, a sensor, a record or an output of an io node is wired to it";
                (format!("no node names the plant `{plant}`"), label)
            } else if has_drives && !is_one_ours && !is_moved(plant) {
                let label = "no drive of this rig is canrig's";
                (format!("nobody emulates the plant `{plant}`"), label)
            } else {
                continue;
            };
            self.at_key(&format!("plant.{plant}"), message, label);
        }
    }
}
