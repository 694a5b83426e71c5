//! Ports of a plant to which a drive is wired, with their indices, found once.

use dbc::names::TRUE_POSITION;
use dbc::node_objects::PLANT_OBJECTS;
use dbc::{Coding, Kind, Port, Ports, Signal, conversion};
use scenario::wiring::{TRUE_STEPS_PER_UNIT, Wiring};

use crate::InvalidEmulator;
use crate::objects::{SIGNED_16, UNSIGNED_16};

/// An output that a drive publishes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Published {
    /// Its signal in the messages of the drive.
    pub(crate) signal: Signal,
    /// Index of the output.
    pub(crate) output: usize,
    pub(crate) steps_per_unit: f64,
    /// Range of the 16 bits of the signal.
    pub(crate) range: [i32; 2],
}

/// The ports of one drive.
#[derive(Clone, Debug)]
pub(crate) struct Wires {
    /// Index of the input that the amplifier drives.
    pub(crate) input: usize,
    /// Factor from the unit of the amplifier's output to the input's.
    pub(crate) input_per_output: f64,
    /// Index of the output that the sensor reads.
    pub(crate) output: usize,
    /// One unit of the sensor, in the unit of the output.
    pub(crate) sensor_unit: f64,
    /// Counts of 0x6064 for one unit of the output.
    pub(crate) counts_per_output: f64,
    /// Steps of the true position (0x2103), millionths of the sensor's unit or, as a float, whole ones, for one unit of the output.
    pub(crate) true_steps_per_output: f64,
    /// Whether the true position is a float.
    pub(crate) is_true_float: bool,
    /// Contents of TPDO2 and TPDO3.
    pub(crate) published: Vec<Published>,
    /// Signal of the true position.
    pub(crate) true_position: Signal,
}

impl Wires {
    /// Finds the ports that a rig file names.
    pub(crate) fn new(ports: &Ports, wiring: &Wiring) -> Result<Self, InvalidEmulator> {
        let unknown =
            |name: &str| InvalidEmulator::Other(format!("the plant has no port `{name}`"));
        let input = wiring.driven(ports).ok_or_else(|| unknown(&wiring.input))?;
        let output = wiring
            .measured(ports)
            .ok_or_else(|| unknown(&wiring.output))?;
        let port = &ports.outputs[output];
        let factors = conversion(&port.unit, wiring.sensor.quantity.unit.word())
            .zip(conversion(wiring.sensor.quantity.unit.word(), &port.unit));
        let (units_per_output, sensor_unit) = factors.ok_or_else(|| {
            let (port, unit) = (&port.name, &wiring.sensor.quantity.unit);
            InvalidEmulator::Other(format!("the port `{port}` cannot be measured in {unit}"))
        })?;
        let recorded = wiring.recorded(ports).map_err(|name| unknown(&name))?;
        let (count, most) = (recorded.len(), PLANT_OBJECTS.len());
        if count > most {
            return Err(InvalidEmulator::Other(format!(
                "the drive would publish {count} outputs of the plant (limit {most})"
            )));
        }
        let output_unit = wiring.quantities.output.unit.word();
        let is_true_float = wiring.sensor.is_true_float();
        let true_steps = if is_true_float {
            1.0
        } else {
            TRUE_STEPS_PER_UNIT
        };
        let kind = if is_true_float {
            Kind::Float32
        } else {
            Kind::Signed
        };
        let coding = Coding::little_endian(0, 32, kind, 1.0 / true_steps, None);
        let true_position = wiring.drive_quantities().name(TRUE_POSITION);
        Ok(Self {
            true_position: Signal::new(true_position, "", "", coding),
            input,
            input_per_output: conversion(output_unit, &ports.inputs[input].unit).unwrap_or(1.0),
            output,
            sensor_unit,
            counts_per_output: wiring.sensor.counts_per_unit() * units_per_output,
            true_steps_per_output: true_steps * units_per_output,
            is_true_float,
            published: recorded
                .into_iter()
                .map(|(output, port)| published(output, port, wiring))
                .collect(),
        })
    }
}

fn published(output: usize, port: &Port, wiring: &Wiring) -> Published {
    let has_sign = port.range[0] < 0.0;
    let coding = Coding::of_output(port.steps_per_unit, port.range);
    Published {
        signal: Signal::new(wiring.recorded_name(port), "", "", coding),
        output,
        steps_per_unit: port.steps_per_unit,
        range: if has_sign { SIGNED_16 } else { UNSIGNED_16 },
    }
}

#[cfg(test)]
mod tests {
    use scenario::wiring::Measured;

    use super::*;
    use dbc::{Quantity, Unit};

    #[test]
    fn a_port_that_is_not_there_and_a_unit_that_does_not_fit_are_refused() {
        let ports = Ports {
            inputs: vec![Port::input("flexor_current_amperes", [0.0, 1.0])],
            outputs: vec![Port::output("angle_degrees", [-60.0, 60.0])],
        };
        let wiring = Wiring {
            sensor: Measured {
                quantity: Quantity::position(Unit::Degrees),
                ..Measured::default()
            },
            ..Wiring::default()
        };
        let wires = Wires::new(&ports, &wiring).unwrap();
        assert_eq!((wires.sensor_unit, wires.counts_per_output), (1.0, 1e3));
        let fails = |wiring: &Wiring| Wires::new(&ports, wiring).unwrap_err().to_string();
        let wrong = Wiring {
            input: "flexor_current".to_owned(),
            ..wiring
        };
        assert_eq!(fails(&wrong), "the plant has no port `flexor_current`");
        assert_eq!(
            fails(&Wiring::default()),
            "the port `angle_degrees` cannot be measured in millimetres"
        );
    }
}
