//! What a rig file can say and this bench does not serve.

use super::Check;
use crate::error::Problem;
use crate::own::is_name;
use crate::rig::nodes::{NodeKind, Outputs, plant_of_port};
use crate::wiring::IO_OUTPUTS_MAX;

impl Check<'_> {
    pub(super) fn unserved(&self) -> Vec<Problem> {
        let mut problems = self.loops_of_several_drives();
        problems.extend(self.split_drives());
        problems.extend(self.split_outputs());
        problems.extend(self.outputs_without_room());
        problems.extend(self.second_outputs());
        problems.extend(self.idle_plants());
        problems
    }

    /// A drive whose law leads others must be canrig's, and so must they: the rig file of another one has one loop.
    fn loops_of_several_drives(&self) -> Vec<Problem> {
        let several = self
            .rig
            .loops
            .iter()
            .filter(|(_, one)| one.drives.len() > 1);
        let problems = several.flat_map(|(name, one)| {
            let drives = one.drives.iter().enumerate();
            let external = drives.filter(|(_, drive)| {
                let node = self.rig.node.get(*drive);
                node.is_some_and(|node| node.external)
            });
            external.map(move |(place, drive)| {
                let path = format!("loop.{name}.outputs.{place}");
                let message = format!("the external drive `{drive}` is one of several of a loop");
                self.document
                    .problem(&path, message, "needs a loop of its own")
            })
        });
        problems.collect()
    }

    /// Drives that move one plant and measure another.
    fn split_drives(&self) -> Vec<Problem> {
        let drives = self.rig.node.iter().filter_map(|(name, node)| {
            let sensor = node.sensor.as_ref()?.port.as_deref()?;
            let (measured, moved) = (plant_of_port(sensor)?, self.rig.plant_of(name)?);
            (measured != moved).then(|| {
                let path = format!("node.{name}.sensor.port");
                let message =
                    format!("the drive `{name}` moves `{moved}` and measures `{measured}`");
                let problem = self
                    .document
                    .problem(&path, message, "the plant that it measures");
                let moves = self.document.span(&format!("node.{name}.amplifier.port"));
                problem.with_place(moves, "the plant that it moves")
            })
        });
        drives.collect()
    }

    /// Io nodes whose outputs act on two plants, or on none.
    fn split_outputs(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        for (name, outputs) in self.outputs() {
            let path = format!("node.{name}.outputs");
            let mut plants = outputs.0.values().filter_map(|port| plant_of_port(port));
            let first = plants.next();
            let message = match (first, plants.find(|plant| Some(*plant) != first)) {
                (None, _) => format!("`{name}` acts on no plant"),
                (Some(first), Some(second)) => {
                    format!("`{name}` acts on `{first}` and on `{second}`")
                }
                _ => continue,
            };
            problems.push(self.problem(&path, message, "one plant for each io node"));
        }
        problems
    }

    /// Io nodes with more outputs than their frame has room for, or with one that has no name.
    fn outputs_without_room(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        for (name, outputs) in self.outputs() {
            let path = format!("node.{name}.outputs");
            let others = outputs.others().count();
            let room = match others == outputs.0.len() {
                true => IO_OUTPUTS_MAX,
                // Fan and load have their places, whether one of them is wired or both.
                false => IO_OUTPUTS_MAX - 2,
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

    /// Io nodes that share a plant.
    fn second_outputs(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut firsts: Vec<(&str, &str)> = Vec::new();
        for (name, outputs) in self.outputs() {
            let Some(plant) = outputs.plant() else {
                continue;
            };
            match firsts.iter().find(|(_, other)| *other == plant) {
                None => firsts.push((name, plant)),
                Some((first, _)) => {
                    let message = format!("`{first}` and `{name}` both act on `{plant}`");
                    let problem = self.problem(&format!("node.{name}"), message, "the second one");
                    let first = self.document.key_span(&format!("node.{first}"));
                    problems.push(problem.with_place(first, "the first one"));
                }
            }
        }
        problems
    }

    fn outputs(&self) -> impl Iterator<Item = (&str, &Outputs)> {
        let nodes = self.rig.node.iter();
        nodes.filter_map(|(name, node)| Some((name.as_str(), node.outputs.as_ref()?)))
    }

    fn idle_plants(&self) -> Vec<Problem> {
        let drives = Vec::from_iter(self.of_kind(NodeKind::Drive));
        let is_moved = |plant: &str| {
            drives
                .iter()
                .any(|drive| self.rig.plant_of(drive) == Some(plant))
        };
        let idle = self.rig.plant.keys().filter(|plant| !is_moved(plant));
        let problems = idle.map(|plant| {
            let message = format!("no drive moves the plant `{plant}`");
            let label = format!("write amplifier.port = \"{plant}.PORT\" into a drive");
            self.problem(&format!("plant.{plant}"), message, label)
        });
        problems.collect()
    }
}
