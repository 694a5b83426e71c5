//! Checks that the drives and io nodes of a rig file are wired to ports that its plants have.

use std::collections::BTreeSet;

use dbc::node_objects::PLANT_OBJECTS;
use dbc::{Port, Ports, Unit, conversion, local_name, plant_of_port, unit_in};
use scenario::rig::nodes::{FAN_OUTPUT, kind_of_output};
use scenario::{Objection, Scenario, Trial, meant_or_known, nearest};

use crate::catalogue::Catalogue;

/// Largest number of ports of a plant.
const PORTS_MAX: usize = 256;
/// Bits of a published port, for which frames have room.
const BITS: usize = 16;
/// Largest number of outputs that a drive can publish: TPDO2, with the true position, and TPDO3 hold them.
const RECORDED_MAX: usize = PLANT_OBJECTS.len();
/// Largest number of ports that are listed if a port is missing.
const LISTED_MAX: usize = 20;
/// Tolerance for rounding a range from one unit to another.
const RANGE_TOLERANCE: f64 = 1e-6;

const INPUT: &str = "input";
const OUTPUT: &str = "output";

/// Finds the first problem of a rig's wiring.
pub(crate) fn objection(scenario: &Scenario, catalogue: &Catalogue) -> Option<Objection> {
    let mut loops = scenario.loops.iter();
    loops.find_map(|one| loop_objection(scenario, one, catalogue))
}

fn loop_objection(scenario: &Scenario, one: &Trial, catalogue: &Catalogue) -> Option<Objection> {
    let rig = &scenario.shared.rig;
    let drive = one.wiring.drive().name.as_str();
    if !rig.node.get(drive)?.is_ours() {
        return None;
    }
    rig.plant_of(drive)?;
    let sweep = scenario.shared.sweep.as_ref();
    let found = one.plants.iter().find_map(|(name, plant)| {
        let unsound = catalogue.objection_to_plant(name, plant, sweep);
        unsound.or_else(|| plant_objection(name, &catalogue.plant_ports(plant)?))
    });
    if found.is_some() {
        return found;
    }
    let ports = catalogue.ports(one)?;
    let wired = Wired {
        drive,
        ports: &ports,
        trial: one,
    };
    wired.check().err()
}

/// Finds a port that a plant cannot have.
fn plant_objection(plant: &str, ports: &Ports) -> Option<Objection> {
    let count = ports.inputs.len() + ports.outputs.len();
    let at_plant = |message: String, label: String| {
        Some(Objection::new(format!("plant.{plant}"), message, label))
    };
    if count > PORTS_MAX {
        let message = format!("the plant `{plant}` has {count} ports");
        return at_plant(message, format!("at most {PORTS_MAX}"));
    }
    let (port, reason) = ports.flaw()?;
    let message = format!("the port `{}` of the plant `{plant}` {reason}", port.name);
    at_plant(message, "this plant".to_owned())
}

/// Describes the unit of a port.
fn counted(unit: &str) -> String {
    match unit {
        "" => "a number without a unit".to_owned(),
        unit => format!("in {unit}"),
    }
}

/// Drive of a loop, and ports of the plants that are emulated with it.
struct Wired<'a> {
    drive: &'a str,
    ports: &'a Ports,
    trial: &'a Trial,
}

impl Wired<'_> {
    /// Returns the port of this name, which must be an input or an output.
    fn find(&self, path: &str, name: &str, wanted: &str) -> Result<&Port, Objection> {
        let Ports { inputs, outputs } = self.ports;
        let (ports, other, others) = match wanted {
            INPUT => (inputs, OUTPUT, outputs),
            _ => (outputs, INPUT, inputs),
        };
        let has_name = |port: &&Port| port.name == name;
        if let Some(port) = ports.iter().find(has_name) {
            return Ok(port);
        }
        let (plant, port) = (plant_of_port(name).unwrap_or_default(), local_name(name));
        let all = ports.iter().chain(others);
        let plants = BTreeSet::from_iter(all.filter_map(|port| plant_of_port(&port.name)));
        if !plants.contains(plant) {
            let message = format!("the rig has no plant `{plant}`");
            return Err(Objection::new(path, message, meant_or_known(plant, plants)));
        }
        let is_its = |port: &&Port| plant_of_port(&port.name) == Some(plant);
        let names = || ports.iter().filter(is_its).map(Port::local_name);
        let listed = Vec::from_iter(names().take(LISTED_MAX)).join(", ");
        let mut label = format!("{wanted}s of `{plant}`: {listed}");
        let message = if others.iter().any(|port| port.name == name) {
            format!("the port `{name}` is an {other}, and an {wanted} is needed here")
        } else {
            if let Some(meant) = nearest(port, names()) {
                label = format!("did you mean \"{plant}.{meant}\"?");
            }
            format!("the plant `{plant}` has no port `{port}`")
        };
        Err(Objection::new(path, message, label))
    }

    fn check(&self) -> Result<(), Objection> {
        self.amplifier()?;
        self.sensor()?;
        let Trial { wiring, plants, .. } = self.trial;
        for io in wiring.shared.io_on(|plant| plants.contains_key(plant)) {
            let mut outputs = io.outputs.iter();
            let name = &wiring.node(io.node).name;
            outputs.try_for_each(|(output, port)| self.output(name, output, port))?;
        }
        self.record()
    }

    fn amplifier(&self) -> Result<(), Objection> {
        let path = format!("node.{}.amplifier.port", self.drive);
        let wiring = &self.trial.wiring;
        let port = self.find(&path, &wiring.input, INPUT)?;
        let unit = &wiring.quantities.output.unit;
        // A port name without a unit leaves nothing to compare.
        if unit.word().is_empty() || conversion(unit.word(), &port.unit).is_some() {
            return Ok(());
        }
        let message = format!("an amplifier cannot drive `{}`", port.local_name());
        let label = format!("it is {}, not in {unit}", counted(&port.unit));
        Err(Objection::new(path, message, label))
    }

    fn sensor(&self) -> Result<(), Objection> {
        let path = format!("node.{}.sensor.port", self.drive);
        let wiring = &self.trial.wiring;
        let port = self.find(&path, &wiring.output, OUTPUT)?;
        let unit = &wiring.sensor.quantity.unit;
        if let Some(factor) = conversion(&port.unit, unit.word()) {
            return self.range(port, factor);
        }
        let fitting = Unit::fitting_port(&port.unit);
        let message = format!("`{}` cannot be measured in {unit}", port.local_name());
        let units = fitting.iter().map(|unit| format!("unit = \"{unit}\""));
        let mut label = format!("write {}", Vec::from_iter(units).join(" or "));
        if port.unit.is_empty() {
            label += ", or a word of yours, as in unit = \"fraction\"";
        }
        let path = format!("node.{}.sensor.unit", self.drive);
        Err(Objection::new(path, message, label))
    }

    /// Checks the range of a sensor against that of its port: one unit of the port is `factor` of the sensor's.
    fn range(&self, port: &Port, factor: f64) -> Result<(), Objection> {
        let wiring = &self.trial.wiring;
        let [min, max] = wiring.sensor.range();
        let [lowest, highest] = port.range.map(|end| end * factor);
        let (name, unit) = (port.local_name(), &wiring.sensor.quantity.unit);
        let is_wider = lowest < min - RANGE_TOLERANCE || highest > max + RANGE_TOLERANCE;
        let (message, label) = match port.has_range() {
            // The sensor's own range may be a part of the port's.
            true if wiring.sensor.max.is_none() && is_wider => (
                format!("the sensor of `{}` has no range", self.drive),
                format!("`{name}` goes from {lowest} to {highest} {unit}: write min and max"),
            ),
            true if max <= lowest || min >= highest => (
                format!("`{name}` is never where its sensor measures, from {min} to {max} {unit}"),
                format!("it goes from {lowest} to {highest} {unit}"),
            ),
            _ => return Ok(()),
        };
        let path = format!("node.{}.sensor", self.drive);
        Err(Objection::new(path, message, label))
    }

    /// Checks an output of an io node.
    fn output(&self, io: &str, output: &str, name: &str) -> Result<(), Objection> {
        let path = format!("node.{io}.outputs.{output}");
        let port = self.find(&path, name, INPUT)?;
        let (name, unit) = (port.local_name(), unit_in(output));
        let has_unit = !unit.is_empty() || output == FAN_OUTPUT;
        if has_unit && conversion(unit, &port.unit).is_none() {
            let message = format!("`{output}` is {}, and `{name}` is not", counted(unit));
            let counted = counted(&port.unit);
            let label = format!("it is {counted}: call the output like the port, `{name}`");
            return Err(Objection::new(path, message, label));
        }
        if !port.has_range() && kind_of_output(output).is_none() {
            let message = format!("nobody knows which values `{name}` can have");
            return Err(Objection::new(path, message, "the port has no range"));
        }
        Ok(())
    }

    /// Checks the outputs that the drive publishes of its plant.
    fn record(&self) -> Result<(), Objection> {
        let (wiring, drive) = (&self.trial.wiring, self.drive);
        let path = format!("node.{drive}.record");
        for (place, name) in wiring.record.iter().flatten().enumerate() {
            let path = format!("{path}.{place}");
            let port = self.find(&path, name, OUTPUT)?;
            if !port.has_range() {
                let message = format!("`{}` cannot be published", port.local_name());
                return Err(Objection::new(path, message, "it has no range"));
            }
        }
        let recorded = wiring.recorded(self.ports).unwrap_or_default();
        let count = recorded.len();
        if count <= RECORDED_MAX {
            return Ok(());
        }
        let message = format!(
            "`{drive}` would publish {count} outputs of `{}`: {} bits",
            wiring.plant,
            count * BITS
        );
        let label = format!("its frames have room for {}", RECORDED_MAX * BITS);
        let names = recorded
            .iter()
            .take(RECORDED_MAX)
            .map(|(_, port)| format!("\"{}\"", port.local_name()));
        let names = Vec::from_iter(names).join(", ");
        let path = match wiring.record {
            Some(_) => path,
            None => format!("node.{drive}"),
        };
        let help = format!("choose up to {RECORDED_MAX}: record = [{names}]");
        Err(Objection::new(path, message, label).with_help(help))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use dbc::Quantity;
    use scenario::node::{Node, Nodes, Profile};

    use super::*;
    use scenario::wiring::{IoWiring, Measured, SharedWiring, Wiring};

    fn ports() -> Ports {
        Ports {
            inputs: vec![
                Port::input("current_amperes", [-1.0, 1.0]),
                Port::input("brake_newtons", [0.0, 9.0]),
            ],
            outputs: vec![
                Port::output("angle_degrees", [-60.0, 60.0]),
                Port::output("winding_celsius", [0.0, 100.0]),
            ],
        }
    }

    fn found(ports: &Ports, change: impl FnOnce(&mut Wiring)) -> Option<String> {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let mut scenario = Trial::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        scenario.wiring = Wiring {
            plant: "joint".to_owned(),
            input: "joint.current_amperes".to_owned(),
            output: "joint.angle_degrees".to_owned(),
            sensor: Measured {
                quantity: Quantity::position(Unit::Degrees),
                min: -60.0,
                max: Some(60.0),
                ..Measured::default()
            },
            ..Wiring::default()
        };
        scenario.set_plant(scenario::plant::PlantModel::default());
        change(&mut scenario.wiring);
        let joined = Ports::joined([("joint", ports.clone())]);
        let wired = Wired {
            drive: "motor",
            ports: &joined,
            trial: &scenario,
        };
        let found = plant_objection("joint", ports).or_else(|| wired.check().err());
        found.map(|found| format!("{}: {}: {}", found.path, found.message, found.label))
    }

    #[test]
    fn wires_to_ports_that_fit_are_passed() {
        assert_eq!(found(&ports(), |_| {}), None);
        assert_eq!(
            found(&ports(), |wiring| wiring.sensor.quantity.unit =
                Unit::Revolutions),
            None
        );
    }

    #[test]
    fn what_is_wired_wrongly_is_named_with_what_would_be_right() {
        let set = |field: fn(&mut Wiring) -> &mut String, name: &'static str| {
            found(&ports(), move |wiring| {
                *field(wiring) = format!("joint.{name}")
            })
            .unwrap()
        };
        assert_eq!(
            set(|wiring| &mut wiring.input, "curent_amperes"),
            "node.motor.amplifier.port: the plant `joint` has no port `curent_amperes`: did you mean \"joint.current_amperes\"?"
        );
        let elsewhere = |wiring: &mut Wiring| wiring.output = "joynt.angle_degrees".to_owned();
        assert_eq!(
            found(&ports(), elsewhere).unwrap(),
            "node.motor.sensor.port: the rig has no plant `joynt`: did you mean `joint`?"
        );
        assert_eq!(
            set(|wiring| &mut wiring.input, "angle_degrees"),
            "node.motor.amplifier.port: the port `joint.angle_degrees` is an output, and an input is needed here: inputs of `joint`: current_amperes, brake_newtons"
        );
        assert_eq!(
            set(|wiring| &mut wiring.input, "brake_newtons"),
            "node.motor.amplifier.port: an amplifier cannot drive `brake_newtons`: it is in newtons, not in amperes"
        );
        assert_eq!(
            set(|wiring| &mut wiring.output, "current_amperes"),
            "node.motor.sensor.port: the port `joint.current_amperes` is an input, and an output is needed here: outputs of `joint`: angle_degrees, winding_celsius"
        );
        assert_eq!(
            found(&ports(), |wiring| wiring.sensor.quantity.unit =
                Unit::Millimetres)
            .unwrap(),
            "node.motor.sensor.unit: `angle_degrees` cannot be measured in millimetres: write unit = \"degrees\" or unit = \"revolutions\""
        );
        assert_eq!(
            found(&ports(), |wiring| {
                let module = Node::canopen("module", 0x11, Profile::Io);
                let manager = Node::canopen("controller", 0x01, Profile::Manager);
                let nodes = Nodes::new([manager, module]).unwrap();
                let io = IoWiring {
                    node: nodes.find("module").unwrap(),
                    outputs: BTreeMap::from([(
                        "added_load_grams".to_owned(),
                        "joint.brake_newtons".to_owned(),
                    )]),
                };
                wiring.shared = Arc::new(SharedWiring {
                    io: vec![io],
                    nodes,
                    ..SharedWiring::default()
                });
            })
            .unwrap(),
            "node.module.outputs.added_load_grams: `added_load_grams` is in grams, and `brake_newtons` is not: it is in newtons: call the output like the port, `brake_newtons`"
        );
    }

    #[test]
    fn a_sensor_measures_where_its_port_can_be() {
        let slide = |range: [f64; 2]| {
            let mut ports = ports();
            ports.outputs[0] = Port::output("slide_metres", range);
            ports
        };
        let in_millimetres = |wiring: &mut Wiring, min: f64, max: Option<f64>| {
            wiring.output = "joint.slide_metres".to_owned();
            wiring.sensor.quantity.unit = Unit::Millimetres;
            (wiring.sensor.min, wiring.sensor.max) = (min, max);
        };
        let of = |range, min, max| found(&slide(range), |wiring| in_millimetres(wiring, min, max));
        for range in [[0.0, 0.06], [0.0, 0.02], [f64::NEG_INFINITY, f64::INFINITY]] {
            assert_eq!(of(range, 0.0, None), None, "{range:?}");
        }
        assert_eq!(of([-0.1, 0.2], 0.0, Some(100.0)), None, "a part of it");
        assert_eq!(
            of([0.0, 0.2], 0.0, None).unwrap(),
            "node.motor.sensor: the sensor of `motor` has no range: `slide_metres` goes from 0 to 200 millimetres: write min and max"
        );
        assert_eq!(
            of([-0.2, 0.0], 0.0, Some(60.0)).unwrap(),
            "node.motor.sensor: `slide_metres` is never where its sensor measures, from 0 to 60 millimetres: \
             it goes from -200 to 0 millimetres"
        );
    }

    #[test]
    fn ports_that_are_none_are_refused_with_their_plant() {
        let many = (0..1000).map(|number| Port::output(&format!("a{number}"), [0.0, 1.0]));
        let mut crowd = ports();
        crowd.outputs.extend(many);
        let said = found(&crowd, |_| {}).unwrap();
        assert_eq!(
            said,
            "plant.joint: the plant `joint` has 1004 ports: at most 256"
        );
        let mut backwards = ports();
        backwards.outputs[1].range = [100.0, 0.0];
        let said = found(&backwards, |_| {}).unwrap();
        assert!(
            said.contains("`winding_celsius` of the plant `joint` has a range that ends"),
            "{said}"
        );
        let mut double = ports();
        double.outputs[1].name = "current_amperes".to_owned();
        assert!(found(&double, |_| {}).unwrap().contains("is there twice"));
        let mut seven = ports();
        let more = (0..7).map(|number| Port::output(&format!("a{number}"), [0.0, 1.0]));
        seven.outputs.extend(more);
        let said = found(&seven, |_| {}).unwrap();
        assert_eq!(
            said,
            "node.motor: `motor` would publish 8 outputs of `joint`: 128 bits: its frames have room for 96"
        );
    }
}
