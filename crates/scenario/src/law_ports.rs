//! What the ports of a law stand for: `LOOP.position_UNIT` and `LOOP.set_point_UNIT` that it reads, `DRIVE.current_amperes` that it
//! writes, and its own terms, `LOOP.NAME`, which are recorded.

use crate::nearest::meant_or_known;
use crate::own::is_name;
use crate::port::{Port, Ports, Unit, conversion};
use crate::wiring::LoopOfRig;

/// Thousandths of a loop's unit: inside the bench positions are in thousands of it.
const UNITS_INSIDE: f64 = 1e3;
const AMPERES: &str = "amperes";
/// Beginnings of the names of what a law reads and writes.
const POSITION: &str = "position_";
const SET_POINT: &str = "set_point_";
const CURRENT: &str = "current_";
/// Ends of the names of a set-point's derivatives.
const VELOCITY: &str = "_per_second";
const ACCELERATION: &str = "_per_second_squared";

/// A quantity that a law reads.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Quantity {
    /// What the loop's drive measured; not a number in a cycle that brought no position.
    Position,
    /// What it should be.
    SetPoint,
    /// The set-point's first derivative.
    SetPointVelocity,
    /// The set-point's second derivative.
    SetPointAcceleration,
}

/// What an input of a law reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The place of the loop.
    pub of_loop: usize,
    /// What of it.
    pub quantity: Quantity,
    /// What one inside the bench is at the port.
    pub factor: f64,
}

/// Where an output of a law goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Writing {
    /// To the drive of the loop at this place, from the smallest to the largest current; one of the port is so many amperes.
    Current {
        /// The place of the loop.
        of_loop: usize,
        /// Amperes of one at the port.
        factor: f64,
    },
    /// To the terms of the loop at this place.
    Term(usize),
}

/// What all ports of a law stand for, in their order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LawWires {
    /// The inputs.
    pub inputs: Vec<Reading>,
    /// The outputs.
    pub outputs: Vec<Writing>,
}

/// What is wrong with a law's ports.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
#[error("{message}: {label}")]
pub struct WrongPort {
    /// What is wrong.
    pub message: String,
    /// What would be right.
    pub label: String,
}

impl LawWires {
    /// Finds what the ports of a law stand for among the loops of a rig. A loop has room for so many terms.
    ///
    /// # Errors
    /// The first port that stands for nothing, or is there twice; a drive that gets no command.
    pub fn new(ports: &Ports, loops: &[LoopOfRig], terms_max: usize) -> Result<Self, WrongPort> {
        let Ports { inputs, outputs } = ports;
        for ports in [inputs, outputs] {
            each_once(ports)?;
        }
        let inputs = inputs.iter().map(|port| reading(port, loops));
        let inputs = inputs.collect::<Result<_, _>>()?;
        let written = outputs.iter().map(|port| writing(port, loops));
        let written = written.collect::<Result<Vec<_>, _>>()?;
        each_drive_once(outputs, &written, loops)?;
        for (place, one) in loops.iter().enumerate() {
            let is_its = |writing: &&Writing| **writing == Writing::Term(place);
            let count = written.iter().filter(is_its).count();
            if count > terms_max {
                let message = format!("{count} terms of the loop `{}`", one.name);
                return Err(wrong(
                    message,
                    format!("its frames have room for {terms_max}"),
                ));
            }
        }
        Ok(Self {
            inputs,
            outputs: written,
        })
    }
}

/// The terms that a law writes for a loop, each with its name there.
pub fn terms_of<'a>(
    ports: &'a Ports,
    of_loop: &'a LoopOfRig,
) -> impl Iterator<Item = (&'a str, &'a Port)> {
    ports.outputs.iter().filter_map(|port| {
        let (owner, name) = port.name.split_once('.')?;
        let is_its = owner == of_loop.name || owner == of_loop.drive;
        (is_its && amperes_of(name).is_none()).then_some((name, port))
    })
}

fn wrong(message: String, label: String) -> WrongPort {
    WrongPort { message, label }
}

/// Ports with names of their own, and ranges that are some.
fn each_once(ports: &[Port]) -> Result<(), WrongPort> {
    for (place, port) in ports.iter().enumerate() {
        let name = &port.name;
        if ports[..place].iter().any(|other| other.name == *name) {
            let message = format!("the law's port `{name}` is there twice");
            return Err(wrong(message, "each has a name of its own".to_owned()));
        }
        let [min, max] = port.range;
        if min.is_nan() || max.is_nan() || min >= max {
            let message =
                format!("the law's port `{name}` has a range that ends where it has not begun");
            return Err(wrong(message, format!("it is from {min} to {max}")));
        }
    }
    Ok(())
}

/// The loop at which a port is, and the rest of its name.
fn owner<'a>(port: &'a Port, loops: &[LoopOfRig]) -> Result<(usize, &'a str), WrongPort> {
    let (owner, name) = port.name.split_once('.').unwrap_or((&port.name, ""));
    let is_it = |one: &LoopOfRig| one.name == owner || one.drive == owner;
    let place = loops.iter().position(is_it).ok_or_else(|| {
        let message = format!("the law's port `{}` is of no loop and no drive", port.name);
        let known = loops.iter().map(|one| one.name.as_str());
        wrong(message, meant_or_known(owner, &Vec::from_iter(known)))
    })?;
    match is_name(name) {
        true => Ok((place, name)),
        false => {
            let message = format!("the law's port `{}` names nothing", port.name);
            let label = format!(
                "loop and quantity with a dot between them, as in \"{owner}.{POSITION}{}\"",
                loops[place].unit
            );
            Err(wrong(message, label))
        }
    }
}

fn reading(port: &Port, loops: &[LoopOfRig]) -> Result<Reading, WrongPort> {
    let (of_loop, name) = owner(port, loops)?;
    let one = &loops[of_loop];
    let found = if let Some(unit) = name.strip_prefix(POSITION) {
        factor(&one.unit, unit).map(|factor| (Quantity::Position, factor))
    } else if one.is_led {
        None
    } else {
        name.strip_prefix(SET_POINT)
            .and_then(|unit| set_point(&one.unit, unit))
    };
    let Some((quantity, factor)) = found else {
        let message = format!("a law cannot read `{}`", port.name);
        return Err(wrong(message, readable(one)));
    };
    Ok(Reading {
        of_loop,
        quantity,
        factor,
    })
}

/// What a law can read of a loop, for people.
fn readable(one: &LoopOfRig) -> String {
    let (name, unit) = (&one.name, &one.unit);
    let position = format!("`{name}.{POSITION}{unit}`");
    match one.is_led {
        true => format!("of this drive it is {position}"),
        false => format!(
            "of this loop there are {position}, `{name}.{SET_POINT}{unit}`, and that with `{VELOCITY}` and `{ACCELERATION}`"
        ),
    }
}

/// The quantity of a set-point whose name ends so.
fn set_point(of_loop: &Unit, end: &str) -> Option<(Quantity, f64)> {
    let derivative = |quantity, by: &str| {
        let unit = end.strip_suffix(by)?;
        Some((quantity, factor(of_loop, unit)?))
    };
    let itself = factor(of_loop, end).map(|factor| (Quantity::SetPoint, factor));
    itself
        .or_else(|| derivative(Quantity::SetPointAcceleration, ACCELERATION))
        .or_else(|| derivative(Quantity::SetPointVelocity, VELOCITY))
}

/// What one inside the bench is in a unit.
fn factor(of_loop: &Unit, unit: &str) -> Option<f64> {
    conversion(of_loop.word(), unit).map(|factor| factor * UNITS_INSIDE)
}

/// How many amperes one is at a port with this name; none where it is no current.
fn amperes_of(name: &str) -> Option<f64> {
    conversion(name.strip_prefix(CURRENT)?, AMPERES)
}

fn writing(port: &Port, loops: &[LoopOfRig]) -> Result<Writing, WrongPort> {
    let (of_loop, name) = owner(port, loops)?;
    Ok(match amperes_of(name) {
        Some(factor) => Writing::Current { of_loop, factor },
        None => Writing::Term(of_loop),
    })
}

/// Each drive gets one command.
fn each_drive_once(
    ports: &[Port],
    written: &[Writing],
    loops: &[LoopOfRig],
) -> Result<(), WrongPort> {
    for (place, one) in loops.iter().enumerate() {
        let is_command = |writing: &Writing| matches!(writing, Writing::Current { of_loop, .. } if *of_loop == place);
        let commands = ports.iter().zip(written);
        let mut commands = commands.filter(|(_, writing)| is_command(writing));
        let drive = &one.drive;
        match (commands.next(), commands.next()) {
            (Some(_), None) => {}
            (None, _) => {
                let message = format!("the law does not command the drive `{drive}`");
                let label = format!("it has no output `{drive}.{CURRENT}{AMPERES}`");
                return Err(wrong(message, label));
            }
            (Some((first, _)), Some((second, _))) => {
                let message = format!("the law commands the drive `{drive}` twice");
                let label = format!("by `{}` and by `{}`", first.name, second.name);
                return Err(wrong(message, label));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loops() -> Vec<LoopOfRig> {
        let one = |name: &str, drive: &str, unit, is_led| LoopOfRig {
            name: name.to_owned(),
            drive: drive.to_owned(),
            unit,
            is_led,
        };
        vec![
            one("angle", "flexor", Unit::Degrees, false),
            one("extensor", "extensor", Unit::Degrees, true),
            one("lift", "lift", Unit::Millimetres, false),
        ]
    }

    fn ports(inputs: &[&str], outputs: &[&str]) -> Ports {
        Ports {
            inputs: inputs
                .iter()
                .map(|name| Port::input(name, [-9.0, 9.0]))
                .collect(),
            outputs: outputs
                .iter()
                .map(|name| Port::output(name, [0.0, 1.0]))
                .collect(),
        }
    }

    const CURRENTS: [&str; 3] = [
        "flexor.current_amperes",
        "extensor.current_milliamperes",
        "lift.current_amperes",
    ];

    fn wired(inputs: &[&str]) -> Result<Vec<(usize, Quantity, f64)>, String> {
        let wires = LawWires::new(&ports(inputs, &CURRENTS), &loops(), 6);
        let wires = wires.map_err(|wrong| wrong.to_string())?;
        let inputs = wires.inputs.into_iter();
        Ok(inputs
            .map(|one| (one.of_loop, one.quantity, one.factor))
            .collect())
    }

    #[test]
    fn ports_stand_for_what_their_names_say_in_their_units() {
        let read = wired(&[
            "angle.position_degrees",
            "flexor.position_revolutions",
            "extensor.position_degrees",
            "lift.position_metres",
            "lift.set_point_millimetres",
            "lift.set_point_metres_per_second",
            "angle.set_point_degrees_per_second_squared",
        ]);
        let expected = vec![
            (0, Quantity::Position, 1e3),
            (0, Quantity::Position, 1e3 / 360.0),
            (1, Quantity::Position, 1e3),
            (2, Quantity::Position, 1.0),
            (2, Quantity::SetPoint, 1e3),
            (2, Quantity::SetPointVelocity, 1.0),
            (0, Quantity::SetPointAcceleration, 1e3),
        ];
        assert_eq!(read, Ok(expected));
    }

    #[test]
    fn outputs_are_currents_and_terms() {
        let mut outputs = Vec::from(CURRENTS);
        outputs.push("lift.current_error_amperes");
        let ports = ports(&[], &outputs);
        let wires = LawWires::new(&ports, &loops(), 6).unwrap();
        let milli = Writing::Current {
            of_loop: 1,
            factor: 1e-3,
        };
        assert_eq!(
            wires.outputs[1..],
            [
                milli,
                Writing::Current {
                    of_loop: 2,
                    factor: 1.0
                },
                Writing::Term(2)
            ]
        );
        let loops = loops();
        let terms = terms_of(&ports, &loops[2]).map(|(name, _)| name);
        assert_eq!(Vec::from_iter(terms), ["current_error_amperes"]);
        assert_eq!(terms_of(&ports, &loops[0]).count(), 0);
    }

    #[test]
    fn what_stands_for_nothing_is_named_with_what_would_be_right() {
        let said = |name: &str| wired(&[name]).unwrap_err();
        assert_eq!(
            said("lyft.position_millimetres"),
            "the law's port `lyft.position_millimetres` is of no loop and no drive: did you mean `lift`?"
        );
        assert_eq!(
            said("angle.position_millimetres"),
            "a law cannot read `angle.position_millimetres`: of this loop there are `angle.position_degrees`, `angle.set_point_degrees`, and that with `_per_second` and `_per_second_squared`"
        );
        assert_eq!(
            said("extensor.set_point_degrees"),
            "a law cannot read `extensor.set_point_degrees`: of this drive it is `extensor.position_degrees`"
        );
        assert!(said("lift").contains("names nothing"), "{}", said("lift"));
    }

    #[test]
    fn each_drive_gets_one_command_and_each_loop_so_many_terms() {
        let said = |outputs: &[&str]| {
            let wires = LawWires::new(&ports(&[], outputs), &loops(), 2);
            wires.unwrap_err().to_string()
        };
        assert_eq!(
            said(&CURRENTS[..2]),
            "the law does not command the drive `lift`: it has no output `lift.current_amperes`"
        );
        let with = |more: &[&'static str]| Vec::from_iter(CURRENTS.iter().chain(more).copied());
        assert_eq!(
            said(&with(&["angle.current_amperes"])),
            "the law commands the drive `flexor` twice: by `flexor.current_amperes` and by `angle.current_amperes`"
        );
        assert_eq!(
            said(&with(&["lift.a", "lift.b", "lift.c"])),
            "3 terms of the loop `lift`: its frames have room for 2"
        );
        assert!(said(&with(&["lift.a", "lift.a"])).contains("is there twice"));
        let mut backwards = ports(&[], &CURRENTS);
        backwards.outputs[0].range = [1.0, 0.0];
        let said = LawWires::new(&backwards, &loops(), 6).unwrap_err();
        assert!(
            said.message
                .contains("`flexor.current_amperes` has a range"),
            "{said}"
        );
    }
}
