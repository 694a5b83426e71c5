//! The rig: the nodes on the bus by name, the plants that they move, and the loops that the controller closes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{CommandObject, CurrentObject, Limits, PositionObject, Preflight, RealDrive, Timeouts};
use crate::bus::Bus;
use crate::identifiers::Identifiers;
use crate::load::only_one;
use crate::metrics::METRICS;
use crate::node::{Node, NodeIndex, NodeProgram, Nodes, Player, Profile};
use crate::plant::{I2t, PlantModel};
use crate::wiring::{
    IoWiring, LedBy, LoopFacts, Measured, Plausible, SharedWiring, TRAVEL_MILLIMETRES, Wiring,
};
use dbc::names::NAME_PATTERN;
use dbc::{CommandRange, Quantities, Quantity, Unit, plant_of_port};

/// Node-ID of the controller of the shipped rig.
pub const CONTROLLER_NODE_ID: u8 = 0x01;
/// Largest number of nodes: further ones would have no node-ID.
pub const NODES_MAX: usize = 127;
/// Largest number of loops: the controller has objects and identifiers for these.
pub const LOOPS_MAX: usize = 8;

/// A rig file.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    pub schema: u32,
    /// Short name of the rig.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Notes on the rig for its users.
    pub description: Option<String>,
    /// The bus and its cycle.
    #[serde(default)]
    pub bus: Bus,
    /// Values that several nodes share. A node's own keys come before these.
    #[serde(default, skip_serializing_if = "Defaults::is_empty")]
    pub defaults: Defaults,
    /// The plants by name, each with the table of its model: `[plant.NAME.MODEL]`.
    #[serde(default)]
    #[schemars(extend("propertyNames" = {"pattern": NAME_PATTERN}))]
    pub plant: BTreeMap<String, PlantModel>,
    /// The nodes by name.
    #[schemars(extend("propertyNames" = {"pattern": NAME_PATTERN}))]
    pub node: BTreeMap<String, RigNode>,
    /// The loops by name. A rig without drives has none.
    #[serde(default, rename = "loop")]
    #[schemars(extend("propertyNames" = {"pattern": NAME_PATTERN}))]
    pub loops: BTreeMap<String, RigLoop>,
}

impl Rig {
    /// Returns the plant that a drive moves.
    pub fn plant_of(&self, drive: &str) -> Option<&str> {
        plant_of_port(self.node.get(drive)?.amplifier_port()?)
    }

    /// Returns the plants that are emulated together with the one that a drive moves, and that plant, by name, with their files in
    /// the folder of the rig file: all plants that nodes connect. Plants that are connected with no drive go with those of the
    /// first drive.
    pub(crate) fn emulated_with(&self, drive: &str, rig: &Path) -> BTreeMap<String, PlantModel> {
        let mut groups: Vec<BTreeSet<&str>> = Vec::new();
        let nodes = self.node.values().map(RigNode::plants);
        let plants = self.plant.keys();
        let alone = plants.map(|name| BTreeSet::from([name.as_str()]));
        let ours = self.node.iter().filter(|(_, node)| node.is_ours());
        let first = ours.filter_map(|(name, _)| self.plant_of(name)).next();
        let is_moved = |plants: &BTreeSet<&str>| {
            let mut moved = self.node.keys().filter_map(|name| self.plant_of(name));
            moved.any(|plant| plants.contains(plant))
        };
        for mut plants in nodes.chain(alone) {
            plants.retain(|plant| self.plant.contains_key(*plant));
            let joined = groups.extract_if(.., |group| !group.is_disjoint(&plants));
            let joined = Vec::from_iter(joined.flatten());
            plants.extend(joined);
            groups.push(plants);
        }
        let plant = self.plant_of(drive);
        let is_own = |group: &BTreeSet<&str>| plant.is_some_and(|plant| group.contains(plant));
        let own = groups.iter().find(|group| is_own(group));
        let is_first = own
            .zip(first)
            .is_some_and(|(own, first)| own.contains(first));
        let is_its = |group: &BTreeSet<&str>| is_own(group) || is_first && !is_moved(group);
        let names = groups.into_iter().filter(is_its).flatten();
        let model = |name: &str| (name.to_owned(), self.plant[name].beside(rig));
        names.map(model).collect()
    }

    /// Returns the sensor and the amplifier of a drive.
    pub(crate) fn parts_of(&self, drive: &str) -> (Sensor, Amplifier) {
        let node = self.node.get(drive);
        let sensor = node.and_then(|node| node.sensor.clone());
        let amplifier = node.and_then(|node| node.amplifier.clone());
        (sensor.unwrap_or_default(), amplifier.unwrap_or_default())
    }

    /// Checks whether one law leads all drives; then no key need name its loop.
    pub(crate) fn has_only_loop(&self) -> bool {
        only_one(self.leading()).is_some()
    }

    /// Returns the loops with a law.
    fn leading(&self) -> impl Iterator<Item = &RigLoop> {
        self.loops.values().filter(|one| one.led_by.is_none())
    }

    /// Returns the drive that a loop leads; empty if the rig has no such loop.
    pub fn drive_of_loop(&self, name: &str) -> &str {
        let drive = self.loops.get(name).and_then(RigLoop::first);
        drive.unwrap_or_default()
    }

    /// Adds a loop for each drive of a loop but its first one, and for a drive that a loop follows and no loop leads; see
    /// [`RigLoop::led_by`].
    pub(crate) fn add_led_drives(&mut self) {
        let mut led = Vec::new();
        let is_led = |drive: &str| {
            let mut drives = self.loops.values().flat_map(RigLoop::drives);
            drives.any(|led| led == drive)
        };
        let mut only_followed = BTreeSet::new();
        for (name, one) in &self.loops {
            let followed = one.followed();
            let is_new = !is_led(followed) && only_followed.insert(followed);
            // A drive that is only followed comes after all drives that the law commands.
            let drives = one.drives().chain(is_new.then_some(followed));
            for (place, drive) in drives.enumerate().skip(1) {
                let led_by = Some(LedBy {
                    loop_name: name.clone(),
                    place,
                });
                let alone = self.one_drive_loop(drive);
                led.push((drive.to_owned(), RigLoop { led_by, ..alone }));
            }
        }
        self.loops.extend(led);
    }

    /// Returns a loop of one drive, which follows the signal of this drive.
    fn one_drive_loop(&self, drive: &str) -> RigLoop {
        let Quantities { feedback, output } = self.quantities_of(drive);
        RigLoop {
            feedback: format!("{drive}.{}", feedback.name),
            outputs: vec![format!("{drive}.{}", output.name)],
            led_by: None,
            identifiers: Identifiers::default(),
        }
    }

    /// Returns what a drive measures, and what it can be commanded.
    pub(crate) fn quantities_of(&self, drive: &str) -> Quantities {
        let node = self.node.get(drive);
        node.map(RigNode::quantities).unwrap_or_default()
    }

    /// Checks whether an io node acts on the plant that a drive moves.
    pub fn acts_on(&self, io: &str, drive: &str) -> bool {
        let moved = self.plant_of(drive).zip(self.node.get(io));
        moved.is_some_and(|(plant, io)| io.plants().contains(plant))
    }

    /// Returns the plants that a loop moves or measures.
    fn plants_touched(&self, one: &RigLoop) -> BTreeSet<String> {
        let nodes = one.drives().filter_map(|name| self.node.get(name));
        let ports = nodes.flat_map(|node| [node.amplifier_port(), node.sensor_port()]);
        let followed = self.node.get(one.followed());
        let all = ports.chain(followed.map(RigNode::sensor_port));
        let plants = all.flatten().filter_map(plant_of_port);
        plants.map(str::to_owned).collect()
    }

    /// Returns its nodes, some of which programs play; `None` without a controller.
    pub(crate) fn nodes(&self, programs: &BTreeMap<String, NodeProgram>) -> Option<Nodes> {
        Nodes::new(self.node.iter().map(|(name, node)| {
            let canopen = Node::canopen(name, node.node_id, node.kind);
            match programs.get(name) {
                Some(program) => canopen.played_by(Player::Program(program.clone())),
                None if node.external => canopen.played_by(Player::Expected),
                None => canopen,
            }
        }))
    }

    /// Returns what its loops share, with the nodes of the run.
    pub(crate) fn shared(&self, nodes: &Nodes) -> Arc<SharedWiring> {
        let io = self.of_kind(Profile::Io).filter_map(|(name, node)| {
            Some(IoWiring {
                node: nodes.find(name)?,
                outputs: node.outputs.clone().unwrap_or_default().0,
            })
        });
        Arc::new(SharedWiring {
            rig: self.name.clone(),
            nodes: nodes.clone(),
            loops: self.loops.iter().map(|one| self.as_known(one)).collect(),
            io: io.collect(),
        })
    }

    /// Returns the wiring of a drive of a rig whose loops share these facts.
    pub(crate) fn wiring_in(&self, shared: &Arc<SharedWiring>, drive: &str) -> Wiring {
        let index = |name: &str| -> Option<(NodeIndex, &RigNode)> {
            Some((shared.nodes.find(name)?, self.node.get(name)?))
        };
        let Some((drive_index, node)) = index(drive) else {
            return Wiring::default();
        };
        let plant = self.plant_of(drive).unwrap_or_default();
        let in_full = |port: &String| match plant_of_port(port) {
            Some(_) => port.clone(),
            None => format!("{plant}.{port}"),
        };
        let others = self.node.iter().filter(|(name, _)| {
            name.as_str() != drive && !plant.is_empty() && self.plant_of(name) == Some(plant)
        });
        let others = Vec::from_iter(others.map(|(_, node)| node));
        let inputs = others.iter().filter_map(|other| other.amplifier_port());
        let (loop_name, rig_loop) = self.loop_of(drive).unzip();
        let followed = rig_loop.map_or(drive, RigLoop::followed);
        let (followed, followed_node) = index(followed).unwrap_or((drive_index, node));
        let recorded = node.record.as_ref();
        Wiring {
            drive: drive_index,
            followed,
            plant: plant.to_owned(),
            input: node.amplifier_port().unwrap_or_default().to_owned(),
            output: node.sensor_port().unwrap_or_default().to_owned(),
            sensor: node.measured(),
            feedback: followed_node.measured(),
            amplifier: node.amplifier.clone().unwrap_or_default(),
            quantities: Quantities {
                feedback: followed_node.measured_quantity(),
                output: node.commanded_quantity(),
            },
            record: recorded.map(|ports| ports.iter().map(in_full).collect()),
            beside: inputs.map(str::to_owned).collect(),
            is_second: others.iter().any(|other| other.node_id < node.node_id),
            plausible: node.plausible.unwrap_or_default(),
            led_by: rig_loop.and_then(|one| one.led_by.clone()),
            identifiers: rig_loop.map(|one| one.identifiers).unwrap_or_default(),
            loop_name: loop_name.cloned().unwrap_or_default(),
            shared: Arc::clone(shared),
        }
    }

    /// Returns the loop whose first drive this is.
    pub(crate) fn loop_of(&self, drive: &str) -> Option<(&String, &RigLoop)> {
        let is_its = |one: &RigLoop| one.first() == Some(drive);
        self.loops.iter().find(|(_, one)| is_its(one))
    }

    /// Returns the facts of a loop for the other loops.
    fn as_known(&self, (name, one): (&String, &RigLoop)) -> LoopFacts {
        let drive = one.first().unwrap_or_default();
        let (_, amplifier) = self.parts_of(drive);
        let ours = self.node.get(drive).filter(|node| node.is_ours());
        let emulated = ours.and_then(|_| self.plant_of(drive));
        LoopFacts {
            name: name.clone(),
            quantities: Quantities {
                feedback: self.quantities_of(one.followed()).feedback,
                output: self.quantities_of(drive).output,
            },
            commands: amplifier.range(),
            led_by: one.led_by.clone(),
            touched: self.plants_touched(one),
            drive: drive.to_owned(),
            followed: one.followed().to_owned(),
            is_commanded: self
                .leading()
                .flat_map(RigLoop::drives)
                .any(|led| led == drive),
            emulated: emulated.unwrap_or_default().to_owned(),
        }
    }

    /// Returns the controller with its name.
    pub fn controller(&self) -> Option<(&str, &RigNode)> {
        self.of_kind(Profile::Manager).next()
    }

    /// Returns the nodes of a kind by name.
    pub(crate) fn of_kind(&self, kind: Profile) -> impl Iterator<Item = (&str, &RigNode)> {
        let nodes = self.node.iter().filter(move |(_, node)| node.kind == kind);
        nodes.map(|(name, node)| (name.as_str(), node))
    }

    /// Checks whether a name, which then has several words, is that of a limit on what a drive measures or gets.
    pub(crate) fn has_limit(&self, name: &str) -> bool {
        let drives = self.of_kind(Profile::Drive).filter(|_| name.contains('_'));
        let mut measured = drives.map(|(_, node)| node.quantities());
        measured.any(|one| METRICS.iter().any(|metric| one.name(metric.name) == name))
    }

    /// Checks whether a program plays the controller.
    pub fn is_led_by_program(&self) -> bool {
        let controller = self.controller();
        controller.is_some_and(|(_, node)| node.program.is_some())
    }

    /// Returns the facts about an external drive; `None` for a drive that canrig emulates.
    pub fn real_drive(&self, drive: &str) -> Option<RealDrive> {
        let node = self.node.get(drive).filter(|node| !node.is_ours())?;
        let default = RealDrive::new(node.limits?);
        Some(RealDrive {
            node_id: node.node_id,
            mode_of_operation: node.mode_of_operation.unwrap_or(default.mode_of_operation),
            command: node.command.clone().unwrap_or_default(),
            position: node.position.clone().unwrap_or_default(),
            current: node.current.clone().unwrap_or_default(),
            limits: default.limits,
            timeouts: node.timeouts.unwrap_or_default(),
            preflight: node.preflight.unwrap_or_default(),
        })
    }

    /// Makes a rig of one real drive and external io nodes.
    pub fn with_one_drive<'a>(
        &self,
        drive: &str,
        real: &RealDrive,
        io: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        let io = Vec::from_iter(io);
        let mut rig = Self {
            name: drive.to_owned(),
            description: None,
            defaults: Defaults::default(),
            ..self.clone()
        };
        let plant = self.plant_of(drive).filter(|_| !io.is_empty());
        rig.plant.retain(|name, _| Some(name.as_str()) == plant);
        rig.node.retain(|name, node| {
            let is_io = io.contains(&name.as_str());
            node.external |= is_io;
            if let Some(outputs) = &mut node.outputs {
                outputs.0.retain(|_, port| plant_of_port(port) == plant);
            }
            is_io || name == drive || node.kind == Profile::Manager
        });
        if let Some(node) = rig.node.get_mut(drive) {
            node.mode_of_operation = Some(real.mode_of_operation);
            node.command = Some(real.command.clone());
            node.position = Some(real.position.clone());
            node.current = Some(real.current.clone());
            node.limits = Some(real.limits);
            node.timeouts = Some(real.timeouts);
            node.preflight = Some(real.preflight);
            if rig.plant.is_empty() {
                node.amplifier = None;
                node.record = None;
                let sensor = node.sensor.as_mut();
                sensor.into_iter().for_each(|sensor| sensor.port = None);
            }
        }
        // A drive that the law of another one leads has a loop of its own name.
        let name = self.loop_of(drive).map_or(drive, |(name, _)| name);
        rig.loops = BTreeMap::from([(name.to_owned(), self.one_drive_loop(drive))]);
        rig
    }

    /// Returns notes on values that are allowed and may be mistakes.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for (name, node) in self.node.iter().filter(|(_, node)| node.is_ours()) {
            let Some(amplifier) = &node.amplifier else {
                continue;
            };
            let (rated, CommandRange { min, max, .. }) = (amplifier.rated(), amplifier.range());
            if amplifier.i2t.is_none() && node.commanded_quantity() == Quantity::current() {
                notes.push(format!(
                    "`{name}` has no i2t: its amplifier may give its largest current for ever"
                ));
            }
            let span = max - min;
            if rated > span {
                notes.push(format!(
                    "one step of a command to `{name}` is {:.1} permille of its amplifier's range: rated = {span} or less makes it finer",
                    rated / span
                ));
            }
        }
        notes
    }

    /// Returns the text of the rig file.
    ///
    /// # Panics
    /// Never: every value has a form in TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("tables of plain data")
    }

    /// Returns the io nodes with an output of this name.
    pub(crate) fn io_with<'a>(&'a self, output: &'a str) -> impl Iterator<Item = &'a str> {
        let nodes = self.node.iter();
        let with = nodes.filter(move |(_, node)| {
            let outputs = node.outputs.as_ref();
            outputs.is_some_and(|outputs| outputs.port(output).is_some())
        });
        with.map(|(name, _)| name.as_str())
    }
}

/// Values that several nodes share.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Defaults {
    /// Values of each drive, unless its own table says otherwise.
    pub drive: Option<DriveDefaults>,
}

impl Defaults {
    fn is_empty(&self) -> bool {
        self.drive.is_none()
    }
}

/// Values of each drive, unless its own table says otherwise.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct DriveDefaults {
    /// The amplifier.
    pub amplifier: Option<Amplifier>,
    /// The sensor.
    pub sensor: Option<Sensor>,
    /// Number of cycles from one publication of the truth about the plant to the next, which leaves room on the bus; 1 if absent.
    #[schemars(range(min = 1, max = 240))]
    pub truth_every_cycles: Option<u8>,
    /// Limits of plausible positions.
    pub plausible: Option<Plausible>,
}

/// A node on the bus.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "RigNode")]
pub struct RigNode {
    /// Kind of the node.
    pub kind: Profile,
    /// Its node-ID.
    #[schemars(range(min = 1, max = 127))]
    pub node_id: u8,
    /// Of a drive: the amplifier and the port of the plant that it drives.
    pub amplifier: Option<Amplifier>,
    /// Of a drive: the sensor and the port of the plant that it reads.
    pub sensor: Option<Sensor>,
    /// Of a drive: number of cycles from one publication of the truth about the plant to the next, which leaves room on the bus;
    /// 1 if absent.
    #[schemars(range(min = 1, max = 240))]
    pub truth_every_cycles: Option<u8>,
    /// Of a drive: limits of plausible positions. A limit that is left out is not watched.
    pub plausible: Option<Plausible>,
    /// Of a drive: the outputs of its plant that it publishes, at most 6, by the names of their ports, or outputs of any other
    /// plant, as `PLANT.PORT`. If absent: all of a plant with one drive but `turns_not_remembered`; where a plant has several,
    /// those whose names begin like that of the drive's input, and for the first drive also those that no drive's input begins
    /// like.
    #[schemars(length(max = 6), inner(length(min = 1, max = 64)))]
    pub record: Option<Vec<String>>,
    /// Of an io node: its outputs, each with the port of a plant on which it acts.
    pub outputs: Option<Outputs>,
    /// The node is external: canrig expects it on the bus. A drive with `limits` always is, and an external one needs them; an
    /// external io node acts on the plant of an external drive.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub external: bool,
    /// A program in any language that plays the node, with its arguments, without a shell: canrig starts it. It is searched on
    /// `PATH`; one with a `/` in its name is a file in the folder of this file or below it, where the program runs. A drive that
    /// is a program needs the same keys as an external one.
    #[schemars(length(min = 1, max = 64), inner(length(min = 1, max = 4096)))]
    pub program: Option<Vec<String>>,
    /// Of an external drive: its EDS, beside the rig file; that of the emulated drive if left out.
    #[schemars(length(min = 1, max = 200))]
    pub eds: Option<String>,
    /// Of an external drive: written to 0x6060 before it is enabled; 10, cyclic synchronous torque, if left out. Negative modes
    /// are the maker's own. Modes of a position or a speed, as 8 and 9, are refused: the command is a current.
    #[schemars(range(min = -128, max = 127))]
    pub mode_of_operation: Option<i8>,
    /// Of an external drive: the object of the current command.
    pub command: Option<CommandObject>,
    /// Of an external drive: the object of the position.
    pub position: Option<PositionObject>,
    /// Of an external drive: the object of the measured current; `object = ""` if it sends none.
    pub current: Option<CurrentObject>,
    /// Of an external drive: hard limits, which apply whatever a scenario says.
    pub limits: Option<Limits>,
    /// Of an external drive: the times for which drive and controller wait for each other.
    pub timeouts: Option<Timeouts>,
    /// Of an external drive: the checks of it before the first scenario.
    pub preflight: Option<Preflight>,
}

impl RigNode {
    /// Checks whether canrig itself plays the node.
    pub fn is_ours(&self) -> bool {
        !self.external && self.program.is_none()
    }

    /// Returns what its sensor measures and what its amplifier gives.
    pub fn quantities(&self) -> Quantities {
        Quantities {
            feedback: self.measured_quantity(),
            output: self.commanded_quantity(),
        }
    }

    /// Returns what its sensor measures; a position in millimetres without a sensor.
    pub(crate) fn measured_quantity(&self) -> Quantity {
        let sensor = self.sensor.as_ref();
        sensor.map(Sensor::quantity).unwrap_or_default()
    }

    /// Returns what its amplifier gives: a current, unless its port says otherwise.
    pub(crate) fn commanded_quantity(&self) -> Quantity {
        let port = self.amplifier_port();
        port.map_or_else(Quantity::current, Quantity::of_port)
    }

    /// Returns the port that its amplifier drives.
    pub(crate) fn amplifier_port(&self) -> Option<&str> {
        self.amplifier.as_ref()?.port.as_deref()
    }

    /// Returns the port that its sensor reads.
    fn sensor_port(&self) -> Option<&str> {
        self.sensor.as_ref()?.port.as_deref()
    }

    /// Returns the signal of its sensor with its range.
    pub(crate) fn measured(&self) -> Measured {
        let sensor = self.sensor.clone().unwrap_or_default();
        Measured {
            quantity: self.measured_quantity(),
            min: sensor.min.unwrap_or_default(),
            max: sensor.max,
            increment: sensor.position_increment,
            truth_every_cycles: self.truth_every_cycles,
        }
    }

    /// Returns the plants that the node connects: by its amplifier, its sensor, its outputs, and its record.
    pub(crate) fn plants(&self) -> BTreeSet<&str> {
        let parts = [self.amplifier_port(), self.sensor_port()];
        let outputs = self.outputs.iter().flat_map(|outputs| outputs.0.values());
        let named = outputs.chain(self.record.iter().flatten());
        let ports = parts.into_iter().flatten().chain(named.map(String::as_str));
        ports.filter_map(plant_of_port).collect()
    }
}

/// The amplifier of a drive.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "RigAmplifier")]
pub struct Amplifier {
    /// The port that it drives, as in `"wire.current_amperes"`. The port's unit decides the output quantity: a current, always in
    /// amperes; else what the unit measures, in this unit: a voltage, a mass. A percentage or a number without a unit takes the port's
    /// name.
    #[schemars(length(min = 1, max = 200))]
    pub port: Option<String>,
    /// The rated current (0x6075), or the rated value of another output quantity, in the unit of that quantity. Commands and
    /// measured values are in thousandths of it; 1 if absent.
    #[schemars(range(min = 0.001, max = 1_000_000.0))]
    pub rated: Option<f64>,
    /// The smallest output: 0, or negative for an amplifier that drives both ways; 0 if absent.
    #[schemars(range(min = -32_767_000.0, max = 0.0))]
    pub min: Option<f64>,
    /// The largest output; the rated value if absent. It is at most 32.767 times that, as `min` is.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 32_767_000.0))]
    pub max: Option<f64>,
    /// Resolution of its digital-to-analogue converter over the full range; 0 leaves the command's own 1 permille.
    #[schemars(range(min = 0, max = 24))]
    pub resolution_bits: Option<u32>,
    /// Its I²t protection, only for an amplifier that gives a current; none if absent.
    pub i2t: Option<I2t>,
}

/// The sensor of a drive.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "RigSensor")]
pub struct Sensor {
    /// The port that it reads, as in `"wire.position_metres"`.
    #[schemars(length(min = 1, max = 200))]
    pub port: Option<String>,
    /// The name of the measured quantity, as in `"speed"`: that of the signal, of set-points and of limits. `position` if absent.
    #[schemars(length(min = 1, max = 64))]
    pub signal: Option<String>,
    /// The unit of the other keys, of all values of the drive's signal, and of its loop's set-points and limits: one of the port's
    /// quantity, such as `millimetres`, `degrees` or `revolutions_per_minute`. `millimetres` if absent.
    #[schemars(length(min = 1, max = 64))]
    pub unit: Option<String>,
    /// The lowest position that its converter can give, and the lowest set-point; 0 if absent.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub min: Option<f64>,
    /// The highest position that its converter can give, and the highest set-point; 60 mm if absent.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub max: Option<f64>,
    /// Resolution of its converter.
    #[schemars(range(min = 1, max = 24))]
    pub resolution_bits: Option<u32>,
    /// Size of a count of the drive's position object (0x6064), in the sensor's unit; if absent a thousandth of the unit, or a
    /// millionth of a revolution. A converter whose steps are less than half of it is refused.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub position_increment: Option<f64>,
    /// Standard deviation of normal noise before conversion.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub noise_rms: Option<f64>,
}

impl Amplifier {
    /// Returns the rated value, of which commands are thousandths (paper: 1 A).
    pub fn rated(&self) -> f64 {
        self.rated.unwrap_or(1.0)
    }

    /// Returns the range of commands (paper: 0 to 1 A).
    pub fn range(&self) -> CommandRange {
        let (min, rated) = (self.min.unwrap_or_default(), self.rated());
        CommandRange::of_rated(rated, min, self.max.unwrap_or(rated))
    }

    /// Returns the resolution of its converter; 0 leaves the command's own 1 permille (paper: 10 bits; default 0, since the frame
    /// already rounds to 1 permille).
    pub fn resolution_bits(&self) -> u32 {
        self.resolution_bits.unwrap_or_default()
    }
}

impl Sensor {
    /// Returns the resolution of its converter (paper: 10).
    pub fn resolution_bits(&self) -> u32 {
        self.resolution_bits.unwrap_or(10)
    }

    /// Returns the lowest and the highest position of its converter, which clips there (assumed: 0 to 60 mm).
    pub fn range(&self) -> [f64; 2] {
        let max = self.max.unwrap_or(TRAVEL_MILLIMETRES);
        [self.min.unwrap_or_default(), max]
    }

    /// Returns the span of its converter.
    pub fn span(&self) -> f64 {
        let [lowest, highest] = self.range();
        highest - lowest
    }

    /// Returns the standard deviation of normal noise before conversion (assumed: 0).
    pub fn noise_rms(&self) -> f64 {
        self.noise_rms.unwrap_or_default()
    }

    fn quantity(&self) -> Quantity {
        let unit = self.unit.as_deref();
        let unit = unit.map_or(Unit::Millimetres, Unit::from_word);
        match &self.signal {
            Some(signal) => Quantity::new(signal, unit),
            None => Quantity::position(unit),
        }
    }
}

/// The outputs of an io node by name, each with the port of a plant that it drives: `convection_factor` of `[[disturbance.fan]]`,
/// as in `"wire.convection_factor"`; `added_load_grams` of `[[disturbance.load]]`; and any other name for
/// `[[disturbance.output]]`, as in `valve_percent = "tank.valve_percent"`, whose end is its unit. At most 4, in 16 bits each; 2
/// together with fan or load.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Outputs(pub BTreeMap<String, String>);

/// The output on which the fan acts.
pub const FAN_OUTPUT: &str = "convection_factor";
/// The output on which the load acts.
pub const LOAD_OUTPUT: &str = "added_load_grams";
/// Outputs that disturbances have names for.
const OUTPUT_OF_KINDS: [(&str, &str); 2] = [("fan", FAN_OUTPUT), ("load", LOAD_OUTPUT)];

/// Returns the output that the disturbances of a kind set.
pub(crate) fn output_of_kind(kind: &str) -> Option<&'static str> {
    let mut kinds = OUTPUT_OF_KINDS.iter();
    kinds
        .find(|(name, _)| *name == kind)
        .map(|(_, output)| *output)
}

/// Returns the kind of the disturbances that set an output alone: the fan's or the load's.
pub fn kind_of_output(output: &str) -> Option<&'static str> {
    let mut kinds = OUTPUT_OF_KINDS.iter();
    kinds
        .find(|(_, name)| *name == output)
        .map(|(kind, _)| *kind)
}

impl Outputs {
    /// Returns the port of an output.
    pub(crate) fn port(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// Returns the outputs other than fan and load.
    pub(crate) fn others(&self) -> impl Iterator<Item = (&String, &String)> {
        let outputs = self.0.iter();
        outputs.filter(|(name, _)| kind_of_output(name).is_none())
    }
}

impl RigLoop {
    /// Returns the drive whose signal the loop follows.
    pub(crate) fn followed(&self) -> &str {
        self.feedback.split('.').next().unwrap_or_default()
    }

    /// Returns the drives of its outputs; its law leads the first one.
    pub(crate) fn drives(&self) -> impl Iterator<Item = &str> {
        let drives = self.outputs.iter().map(|output| output.split('.').next());
        drives.map(Option::unwrap_or_default)
    }

    /// Returns the drive that its law leads.
    pub(crate) fn first(&self) -> Option<&str> {
        self.drives().next()
    }
}

/// A loop that the controller closes.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "RigLoop")]
pub struct RigLoop {
    /// The signal that follows the set-point, as in `"drive.position"`: of any drive, whether this loop, another one or no loop
    /// moves it.
    #[schemars(length(min = 1, max = 200))]
    pub feedback: String,
    /// The currents of the drives that move it, or other quantities of their amplifiers, in the order in which its law commands
    /// them, as in `"drive.current"`.
    #[schemars(length(min = 1, max = 8))]
    pub outputs: Vec<String>,
    /// Law of another loop that leads the drive of this one. The loader adds such a loop for each further drive of a loop; it is
    /// played, recorded and judged under its own name.
    #[serde(skip)]
    pub led_by: Option<LedBy>,
    /// Identifiers of its frames other than those that CiA 301 gives its nodes, put in by the loader.
    #[serde(skip)]
    pub identifiers: Identifiers,
}
