//! The wiring of a loop's drive to its plant, from the rig file.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::fault::Fault;
use crate::identifiers::Identifiers;
use crate::node::{Node, NodeIndex, Nodes};
use crate::rig::nodes::{Amplifier, FAN_OUTPUT, LOAD_OUTPUT, kind_of_output};
use dbc::{
    CommandRange, Port, Ports, Quantities, Quantity, conversion, local_name, plant_of_port,
    steps_for, symbol_of, unit_in,
};

/// Name of the rig that the shipped data sheets describe.
const RIG_OF_SHEETS: &str = "SMA wire actuator";
/// Largest number of outputs of an io node, which its RPDO1 holds.
pub const IO_OUTPUTS_MAX: usize = 4;
/// Steps of a true position (0x2103) for one unit.
pub const TRUE_STEPS_PER_UNIT: f64 = 1e6;
/// Travel in millimetres, unless a sensor has another range.
pub(crate) const TRAVEL_MILLIMETRES: f64 = 60.0;

/// Signal of a sensor, on the bus.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Measured quantity.
    pub quantity: Quantity,
    /// Lowest value, in that unit.
    pub min: f64,
    /// Highest value; 60 mm if absent.
    pub max: Option<f64>,
    /// Size of one count, in that unit; the default of the unit if absent.
    pub increment: Option<f64>,
    /// Number of cycles from one publication of its true value, and of its plant, to the next; 1 if absent.
    pub truth_every_cycles: Option<u8>,
}

impl Measured {
    /// Returns the lowest and the highest value, within which set-points lie.
    pub fn range(&self) -> [f64; 2] {
        [self.min, self.max.unwrap_or(TRAVEL_MILLIMETRES)]
    }

    /// Returns the counts (0x6064) for one unit.
    pub fn counts_per_unit(&self) -> f64 {
        let resolution = self.increment.map(|increment| 1.0 / increment);
        resolution.unwrap_or_else(|| self.quantity.unit.counts())
    }

    /// Checks whether 32 bits do not hold a true value in the range in millionths of the unit: then it is a float.
    pub fn is_true_float(&self) -> bool {
        let ends = self.range().map(|end| end.abs() * TRUE_STEPS_PER_UNIT);
        ends.into_iter().any(|end| end > f64::from(i32::MAX))
    }
}

/// Facts of a loop of a rig for the other loops.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopFacts {
    /// Name of the loop.
    pub name: String,
    /// First drive of the loop.
    pub drive: String,
    /// Drive whose signal it follows.
    pub followed: String,
    /// Whether a law commands its drive, which is else only followed.
    pub is_commanded: bool,
    /// Plant that its drive moves, if canrig emulates both; else empty.
    pub emulated: String,
    /// Quantities that it follows and commands.
    pub quantities: Quantities,
    /// Range of the commands to its drive.
    pub commands: CommandRange,
    /// Law of another loop that leads its drive.
    pub led_by: Option<LedBy>,
    /// Plants that it moves or measures.
    pub touched: BTreeSet<String>,
}

impl LoopFacts {
    /// Checks whether the law of a loop leads its drive beside that of the loop.
    pub(crate) fn is_led_by(&self, loop_name: &str) -> bool {
        let by = self.led_by.as_ref();
        by.is_some_and(|by| by.loop_name == loop_name)
    }
}

/// Facts of a rig that its loops share.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SharedWiring {
    /// Name of the rig; empty without a rig file.
    pub rig: String,
    /// Nodes of the run.
    pub nodes: Nodes,
    /// All loops of the rig, in the order of their names.
    pub loops: Vec<LoopFacts>,
    /// All io nodes of the rig, in the order of their names.
    pub io: Vec<IoWiring>,
}

impl SharedWiring {
    /// Returns the name of a node as a device; see [`device_name`].
    pub fn device_name(&self, node: &str) -> Option<String> {
        device_name(&self.rig, node)
    }

    /// Returns the io nodes that act on some of these plants.
    pub fn io_on(&self, has_plant: impl Fn(&str) -> bool) -> impl Iterator<Item = &IoWiring> {
        let acts = move |io: &&IoWiring| io.plants().any(&has_plant);
        self.io.iter().filter(acts)
    }
}

/// Returns the name of a node as a device (0x1008): that of its rig comes first. `None` for the devices of the shipped data
/// sheets, which have their names there, and without a rig file.
pub fn device_name(rig: &str, node: &str) -> Option<String> {
    /// Most characters of the rig's name, so that a line of an EDS holds the whole.
    const RIG_MAX: usize = 120;
    if rig == RIG_OF_SHEETS {
        return None;
    }
    // A comment of an EDS begins with a semicolon.
    let rig = rig.chars().take(RIG_MAX).collect::<String>();
    let rig = rig.replace(';', ",");
    (!rig.trim().is_empty()).then(|| format!("{} {node}", rig.trim()))
}

/// Wiring of the drive of a loop, from the rig file; that of the shipped rig by default.
#[derive(Clone, Debug, PartialEq)]
pub struct Wiring {
    /// Drive of the loop.
    pub drive: NodeIndex,
    /// Drive whose signal the loop follows: mostly its own.
    pub followed: NodeIndex,
    /// Name of the plant that it moves; empty without a rig file.
    pub plant: String,
    /// Input that its amplifier drives, as `PLANT.PORT`; the first one if empty.
    pub input: String,
    /// Output that its sensor reads, of the same plant or another one; the first one if empty.
    pub output: String,
    /// Signal of its sensor.
    pub sensor: Measured,
    /// Signal that its loop follows: of its sensor, or of the sensor of another drive.
    pub feedback: Measured,
    /// Amplifier of the drive.
    pub amplifier: Amplifier,
    /// Quantities that its loop follows and commands.
    pub quantities: Quantities,
    /// Outputs that it publishes, each as `PLANT.PORT`; its own outputs if absent.
    pub record: Option<Vec<String>>,
    /// Inputs of the same plant that other drives drive.
    pub beside: Vec<String>,
    /// Whether another drive of the plant has a lower node-ID.
    pub is_second: bool,
    /// Limits of plausible positions; a limit that is absent is not watched.
    pub plausible: Plausible,
    /// Law that leads the drive, if it is that of another drive.
    pub led_by: Option<LedBy>,
    /// Identifiers of its frames other than those that CiA 301 gives it.
    pub identifiers: Identifiers,
    /// Name of its loop; empty without a rig file.
    pub loop_name: String,
    /// Facts that all loops of the rig share.
    pub shared: Arc<SharedWiring>,
}

/// Law that leads the drive of another loop.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct LedBy {
    /// Name of the loop.
    pub loop_name: String,
    /// Place among the drives of the loop, from 1 on: the first one, at 0, leads.
    pub place: usize,
}

impl Default for Wiring {
    fn default() -> Self {
        Self {
            drive: Nodes::DEFAULT_DRIVE,
            followed: Nodes::DEFAULT_DRIVE,
            plant: String::new(),
            input: String::new(),
            output: String::new(),
            sensor: Measured::default(),
            feedback: Measured::default(),
            amplifier: Amplifier::default(),
            quantities: Quantities::default(),
            record: None,
            beside: Vec::new(),
            is_second: false,
            plausible: Plausible::default(),
            led_by: None,
            identifiers: Identifiers::default(),
            loop_name: String::new(),
            shared: Arc::default(),
        }
    }
}

impl Wiring {
    /// Replaces the nodes of the run by the same ones, played otherwise.
    pub fn set_nodes(&mut self, nodes: &Nodes) {
        if self.shared.nodes != *nodes {
            Arc::make_mut(&mut self.shared).nodes = nodes.clone();
        }
    }

    /// Returns a node of the run.
    pub fn node(&self, index: NodeIndex) -> &Node {
        &self.shared.nodes[index]
    }

    /// Returns the controller, which leads all loops.
    pub fn controller(&self) -> &Node {
        self.node(self.shared.nodes.manager())
    }

    /// Returns the drive of its loop.
    pub fn drive(&self) -> &Node {
        self.node(self.drive)
    }

    /// Returns the drive whose signal its loop follows.
    pub fn followed_drive(&self) -> &Node {
        self.node(self.followed)
    }

    /// Returns the number of its loop among those of the rig, from 0.
    pub fn loop_number(&self) -> u8 {
        let is_its = |one: &LoopFacts| one.name == self.loop_name;
        let mut loops = self.shared.loops.iter();
        let number = loops.position(is_its).unwrap_or_default();
        u8::try_from(number).unwrap_or(u8::MAX)
    }

    /// Returns the facts of its loop that the others know; `None` without a rig file.
    fn own(&self) -> Option<&LoopFacts> {
        let mut loops = self.shared.loops.iter();
        loops.find(|one| one.name == self.loop_name)
    }

    /// Returns the plants that its loop moves or measures.
    pub(crate) fn touched(&self) -> impl Iterator<Item = &String> {
        self.own().into_iter().flat_map(|own| &own.touched)
    }

    /// Checks whether its loop moves or measures a plant.
    pub(crate) fn touches(&self, plant: &str) -> bool {
        self.touched().any(|touched| touched == plant)
    }

    /// Checks whether the output of an io node on a port acts on its loop.
    pub(crate) fn is_disturbed_at(&self, port: &str) -> bool {
        plant_of_port(port).is_some_and(|plant| self.touches(plant))
    }

    /// Checks whether the output of an io node on a port is a signal of its loop: it acts there, or on no loop.
    pub fn has_output(&self, port: &str) -> bool {
        let plant = plant_of_port(port).unwrap_or_default();
        let mut loops = self.shared.loops.iter();
        self.touches(plant) || !loops.any(|one| one.touched.contains(plant))
    }

    /// Returns the io nodes with outputs that are signals of its loop.
    pub fn io_nodes(&self) -> impl Iterator<Item = NodeIndex> {
        let is_here = |io: &&IoWiring| io.outputs.values().any(|port| self.has_output(port));
        let io = self.shared.io.iter().filter(is_here);
        io.map(|io| io.node)
    }

    /// Returns controller, drive and io nodes of its loop, in this order.
    pub fn all_nodes(&self) -> impl Iterator<Item = NodeIndex> {
        let controller = self.shared.nodes.manager();
        [controller, self.drive].into_iter().chain(self.io_nodes())
    }

    /// Checks whether a signal of a node of its loop is one of the loop: outputs of an io node are those of the loops on which they
    /// act.
    pub fn has_signal(&self, node: Option<NodeIndex>, signal: &str) -> bool {
        let mut nodes = self.shared.io.iter();
        let io = nodes.find(|io| Some(io.node) == node);
        io.is_none_or(|io| match io.outputs.get(signal) {
            Some(port) => self.has_output(port),
            None => kind_of_output(signal).is_none(),
        })
    }

    /// Checks whether a fault belongs to its loop, as the loop of a drive and a plant: it happens to them, to an io node of the
    /// loop, or to no drive, plant or io node in particular.
    pub(crate) fn is_hit_by(&self, fault: &Fault, drive: NodeIndex, plant: &str) -> bool {
        let Some(index) = fault.node else {
            return fault.plant.as_deref().is_none_or(|name| name == plant);
        };
        let node = self.node(index);
        let is_own_io = || self.io_nodes().any(|io| io == index);
        index == drive || !node.is_drive() && (!node.is_io() || is_own_io())
    }

    /// Returns the number of cycles from one publication of the truth about its plant to the next.
    pub fn truth_every_cycles(&self) -> u8 {
        self.sensor.truth_every_cycles.unwrap_or(1)
    }

    /// Returns the name of its loop among several; empty for an only loop.
    pub fn loop_among_several(&self) -> &str {
        match self.shared.loops.len() {
            0 | 1 => "",
            _ => &self.loop_name,
        }
    }

    /// Returns its loop, followed by those of the further drives that its law leads, in their order.
    pub fn led_loops(&self) -> Vec<LoopFacts> {
        let place = |one: &LoopFacts| match &one.led_by {
            Some(by) if by.loop_name == self.loop_name => Some(by.place),
            _ => (one.name == self.loop_name).then_some(0),
        };
        let led = self.shared.loops.iter();
        let mut led = Vec::from_iter(led.filter(|one| place(one).is_some()).cloned());
        led.sort_by_key(place);
        led
    }

    /// Returns the number of drives that its law commands.
    pub fn drives_commanded(&self) -> usize {
        let led = self.led_loops();
        let commanded = led.iter().filter(|one| one.is_commanded);
        commanded.count().max(1)
    }

    /// Returns the loop whose law commands its drive, if that is another one.
    pub fn leader(&self) -> Option<&LoopFacts> {
        let by = self.led_by.as_ref()?;
        self.own().filter(|own| own.is_commanded)?;
        let mut loops = self.shared.loops.iter();
        loops.find(|one| one.name == by.loop_name)
    }

    /// Returns the command ranges of the drives that the law leads, starting with this drive; with `None`, of each loop's first
    /// drive.
    pub fn command_ranges(&self, drives: Option<usize>) -> Vec<CommandRange> {
        let Some(drives) = drives else {
            return self.shared.loops.iter().map(|one| one.commands).collect();
        };
        let led = self.led_loops().into_iter();
        let mut ranges = Vec::from_iter(led.map(|one| one.commands));
        ranges.resize(drives, self.amplifier.range());
        ranges
    }

    /// Returns the target quantities of `drives` drives that the law leads, starting with this drive.
    pub fn targets(&self, drives: usize) -> Vec<Quantity> {
        let led = self.led_loops().into_iter();
        let mut targets = Vec::from_iter(led.map(|one| one.quantities.output));
        targets.resize(drives, self.quantities.output.clone());
        targets
    }

    /// Returns the quantities of this drive's own sensor and amplifier. `quantities` are those of the loop, which may follow another
    /// drive.
    pub fn drive_quantities(&self) -> Quantities {
        Quantities {
            feedback: self.sensor.quantity.clone(),
            output: self.quantities.output.clone(),
        }
    }

    /// Returns the name, in its loop, of a signal that its own drive measures: with the name of the drive if the loop follows
    /// another one.
    pub fn name_in_loop(&self, measured: &str) -> String {
        if self.follows_itself() {
            measured.to_owned()
        } else {
            format!("{}.{measured}", self.drive().name)
        }
    }

    /// Checks whether its loop follows its own sensor.
    pub fn follows_itself(&self) -> bool {
        self.followed == self.drive
    }

    /// Returns the index of the output that the sensor reads.
    pub fn measured(&self, ports: &Ports) -> Option<usize> {
        named_or_first(&self.output, &ports.outputs)
    }

    /// Returns the index of the input that the amplifier drives.
    pub fn driven(&self, ports: &Ports) -> Option<usize> {
        named_or_first(&self.input, &ports.inputs)
    }

    /// Returns the outputs that the drive publishes: those that the rig file names, else its own. If a plant has one drive, all
    /// of its outputs are the drive's, except the one that its sensor reads. If it has several, a drive has the outputs whose
    /// names begin like that of its input, and the first drive also those that begin like no drive's input. Outputs without a
    /// range, and those that need a `record`, are not published by default.
    ///
    /// # Errors
    /// A name that is not an output.
    pub fn recorded<'a>(&self, ports: &'a Ports) -> Result<Vec<(usize, &'a Port)>, String> {
        let places = match &self.record {
            Some(names) => {
                let place = |name: &String| ports.output(name).ok_or_else(|| name.clone());
                names.iter().map(place).collect::<Result<Vec<_>, _>>()?
            }
            None => self.default_outputs(ports),
        };
        let ports = places
            .into_iter()
            .map(|place| (place, &ports.outputs[place]));
        Ok(ports.collect())
    }

    /// Returns the name of a port that the drive publishes: the plant's name for it, after the name of the plant if that is
    /// another one.
    pub fn recorded_name(&self, port: &Port) -> String {
        match plant_of_port(&port.name) {
            Some(plant) if plant != self.plant => port.name.replace('.', "_"),
            _ => port.local_name().to_owned(),
        }
    }

    /// Checks whether a signal that the drive publishes is an output of its plant.
    pub fn is_of_plant(&self, signal: &str) -> bool {
        let is_its = |port: &String| {
            plant_of_port(port) == Some(self.plant.as_str()) && local_name(port) == signal
        };
        let recorded = self.record.as_ref();
        recorded.is_none_or(|all| all.iter().any(is_its))
    }

    fn default_outputs(&self, ports: &Ports) -> Vec<usize> {
        let measured = self.measured(ports);
        let driven = self.driven(ports).map(|place| &ports.inputs[place]);
        let prefix = driven.map_or("", |port| beginning(&port.name));
        let driven_plant = driven.map(|port| plant_of_port(&port.name).unwrap_or_default());
        let plant = driven_plant.unwrap_or(&self.plant);
        let is_here = |port: &Port| match beginning(&port.name) {
            _ if plant_of_port(&port.name).unwrap_or_default() != plant => false,
            _ if self.beside.is_empty() => true,
            name if name == prefix => true,
            name => !self.is_second && self.beside.iter().all(|other| beginning(other) != name),
        };
        let all = ports.outputs.iter().enumerate();
        let outputs = all
            .filter(|(_, port)| port.is_published && port.has_range() && is_here(port))
            .filter(|(place, _)| Some(*place) != measured);
        outputs.map(|(place, _)| place).collect()
    }
}

/// Outputs of an io node, each with the input that it drives, as `PLANT.PORT`.
#[derive(Clone, Debug, PartialEq)]
pub struct IoWiring {
    /// Io node with these outputs.
    pub node: NodeIndex,
    /// Inputs on which its outputs act, by the names of the outputs.
    pub outputs: BTreeMap<String, String>,
}

impl IoWiring {
    /// Returns the plants on which its outputs act.
    pub fn plants(&self) -> impl Iterator<Item = &str> {
        self.outputs.values().filter_map(|port| plant_of_port(port))
    }

    /// Returns the outputs in the order of their places, without those that fit no port. Fan and load have the first two, whether
    /// one of them is wired or both.
    pub fn outputs(&self, ports: &Ports) -> Vec<IoOutput> {
        let wired = |name: &str| ports.input(self.outputs.get(name)?);
        let is_other = |name: &&String| kind_of_output(name).is_none();
        let first = [fan(), load()]
            .into_iter()
            .filter(|_| !self.outputs.keys().all(|name| is_other(&name)))
            .map(|port| {
                let input = wired(&port.name);
                Some(IoOutput::new(port, input, ports))
            });
        let others = self.outputs.keys().filter(is_other).map(|name| {
            let input = wired(name)?;
            let port = output_like(name, &ports.inputs[input])?;
            Some(IoOutput::new(port, Some(input), ports))
        });
        let outputs = (0..)
            .zip(first.chain(others))
            .filter_map(|(place, output)| Some(IoOutput { place, ..output? }));
        outputs.collect()
    }
}

/// Output of an io node: 16 bits that drive an input of a plant.
#[derive(Clone, Debug, PartialEq)]
pub struct IoOutput {
    /// Port in the unit and under the name of the output.
    pub port: Port,
    /// Place among the outputs of its node.
    pub place: usize,
    /// Index of the plant's input; `None` if it drives none.
    pub input: Option<usize>,
    /// Steps for one unit of the plant's input.
    steps_per_input: f64,
}

impl IoOutput {
    fn new(port: Port, input: Option<usize>, ports: &Ports) -> Self {
        let unit = input.map_or("", |input| ports.inputs[input].unit.as_str());
        let factor = conversion(&port.unit, unit).unwrap_or(1.0);
        Self {
            steps_per_input: port.steps_per_unit / factor,
            port,
            place: 0,
            input,
        }
    }

    /// Returns the value of the plant's input for a value in steps, which the lowest one limits.
    pub fn input_value(&self, steps: f64) -> f64 {
        let least = self.port.range[0] * self.port.steps_per_unit;
        steps.max(least) / self.steps_per_input
    }

    /// Returns its place and its name as the node's data sheet has them, and the value while no node commands it in steps, cut to
    /// 16 bits.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "`as` cuts to the ends of the type, which is what is wanted"
    )]
    pub fn in_sheet(&self) -> (usize, &str, i16) {
        let at_rest = libm::round(self.port.at_rest * self.port.steps_per_unit) as i16;
        (self.place, &self.port.name, at_rest)
    }
}

/// Returns the fan as an output.
fn fan() -> Port {
    Port::input(FAN_OUTPUT, [0.0, 30.0])
        .in_steps(1e3)
        .resting_at(1.0)
        .with_comment("Multiplies the convection coefficient; 1 is still air.")
}

/// Returns the load as an output.
fn load() -> Port {
    Port::input(LOAD_OUTPUT, [-3_276.8, 3_276.7])
        .in_steps(10.0)
        .with_comment("Added to the load; may be negative.")
}

/// Returns an output of this name that drives a port, in the unit in the name, or in that of the port if there is none; `None` if
/// the units are of different quantities.
fn output_like(name: &str, port: &Port) -> Option<Port> {
    let (unit, symbol) = match unit_in(name) {
        "" => (port.unit.as_str(), port.symbol.as_str()),
        unit => (unit, symbol_of(unit)),
    };
    let factor = conversion(unit, &port.unit)?;
    let range = port.range.map(|end| end / factor);
    Some(Port {
        name: name.to_owned(),
        unit: unit.to_owned(),
        symbol: symbol.to_owned(),
        range,
        at_rest: port.at_rest / factor,
        steps_per_unit: steps_for(range),
        ..port.clone()
    })
}

/// Returns the index of the port of a name, of the first one if the name is empty.
fn named_or_first(name: &str, ports: &[Port]) -> Option<usize> {
    let is_it = |port: &Port| name.is_empty() || port.name == name;
    ports.iter().position(is_it)
}

/// Returns the first word of the name of a port.
fn beginning(port: &str) -> &str {
    local_name(port).split('_').next().unwrap_or_default()
}

/// Limits of a plausible measured position: a position outside them does not count, and too many in a row end the run. Positions
/// are in the sensor's unit, rates in it per second. A limit that is left out is not watched.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Plausible {
    /// The lowest plausible position.
    #[schemars(range(min = -1e9, max = 1e9))]
    pub min: Option<f64>,
    /// The highest plausible position.
    #[schemars(range(min = -1e9, max = 1e9))]
    pub max: Option<f64>,
    /// The fastest motion, per second.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub rate_max: Option<f64>,
    /// Allowance for noise and quantisation of two samples, added to the motion; 0 if absent.
    #[schemars(range(min = 0.0, max = 1e9))]
    pub jump: Option<f64>,
    /// Time for which a position above `max` is believed if it got there without a jump, in seconds: a load that was thrown up
    /// comes back.
    #[schemars(range(min = 0.0, max = 3_600.0))]
    pub thrown_seconds: Option<f64>,
    /// Detection of a position that does not move under a large current without a reason.
    pub stall: Option<Stall>,
}

/// A position that does not move under a large current. Positions at an end of the travel, from which the current pushes
/// outward, do not count.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Stall {
    /// RMS from which on the current is large, in amperes, or in the unit of what else the amplifier gives.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000_000.0))]
    pub current_rms: f64,
    /// Time for which the position is watched, in seconds.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 3_600.0))]
    pub seconds: f64,
    /// Smallest change of the position that is a motion.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub motion: f64,
    /// Position below which the stall is detected: above it the plant may be at the end of the effect of a current.
    #[schemars(range(min = -1e9, max = 1e9))]
    pub below: Option<f64>,
    /// Distance from the set-point above which the stall is detected, at the largest current: for a plant that a current holds,
    /// as a motor does.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub away: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::Unit;

    #[test]
    fn a_device_is_named_after_its_rig_and_node() {
        let named = |rig: &str| {
            let shared = SharedWiring {
                rig: rig.to_owned(),
                ..SharedWiring::default()
            };
            shared.device_name("drive")
        };
        let shipped = crate::rig::shipped::text("sma_actuator").unwrap();
        let shipped = crate::rig::nodes::Rig::parse(shipped, "rig.toml").unwrap();
        assert_eq!(named(&shipped.name), None);
        assert_eq!(named("DC motor").as_deref(), Some("DC motor drive"));
        assert_eq!(named("a ; b").as_deref(), Some("a , b drive"));
        assert_eq!(named(""), None);
        let long = named(&"ä".repeat(200)).unwrap();
        assert_eq!(long.chars().count(), 126);
    }

    fn joint() -> Ports {
        let input = |name| Port::input(name, [0.0, 1.0]);
        let output = |name| Port::output(name, [-90.0, 90.0]);
        Ports {
            inputs: ["flexor_current_amperes", "extensor_current_amperes"]
                .map(input)
                .into(),
            outputs: [
                "angle_degrees",
                "flexor_temperature_celsius",
                "extensor_temperature_celsius",
                "speed_degrees_per_second",
            ]
            .map(output)
            .into(),
        }
    }

    fn wiring(input: &str, beside: &[&str], is_second: bool) -> Wiring {
        Wiring {
            input: input.to_owned(),
            output: "angle_degrees".to_owned(),
            sensor: Measured {
                quantity: Quantity::position(Unit::Degrees),
                ..Measured::default()
            },
            beside: beside.iter().map(|name| (*name).to_owned()).collect(),
            is_second,
            ..Wiring::default()
        }
    }

    #[test]
    fn each_output_is_published_by_one_drive() {
        let names = |wiring: &Wiring| {
            let ports = joint();
            let recorded = wiring.recorded(&ports).unwrap().into_iter();
            Vec::from_iter(recorded.map(|(_, port)| port.name.clone()))
        };
        let [flexor, extensor] = ["flexor_current_amperes", "extensor_current_amperes"];
        assert_eq!(
            names(&wiring(flexor, &[extensor], false)),
            ["flexor_temperature_celsius", "speed_degrees_per_second"]
        );
        assert_eq!(
            names(&wiring(extensor, &[flexor], true)),
            ["extensor_temperature_celsius"]
        );
        assert_eq!(names(&wiring(flexor, &[], false)).len(), 3);
        let named = Wiring {
            record: Some(vec!["speed_degrees_per_second".to_owned()]),
            ..wiring(flexor, &[], false)
        };
        assert_eq!(names(&named), ["speed_degrees_per_second"]);
        let wrong = Wiring {
            record: Some(vec!["speed".to_owned()]),
            ..named
        };
        assert_eq!(wrong.recorded(&joint()).unwrap_err(), "speed");
    }
}
