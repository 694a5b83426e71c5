//! The meaning of a law's ports. A law of one loop reads `position` and `set_point` and writes `command`, in the unit of the
//! drive's target. A law of all loops reads `LOOP.position_UNIT` and `LOOP.set_point_UNIT` and writes `DRIVE.command`. Either may
//! name the drive's quantity instead, in any unit of it: `current_amperes`, `voltage_volts`. Every other output is a term of the
//! law, which is recorded.

use crate::nearest::meant_or_known;
use crate::wiring::LoopFacts;
use dbc::names::is_name;
use dbc::{Port, Ports, Quantities, Quantity, Unit, conversion};

/// Beginnings of the names of a law's ports.
const SET_POINT: &str = "set_point_";
const COMMAND: &str = "command";
/// Unit in which a number without one can be given, too.
const PERCENT: &str = "percent";
/// Ends of the names of a set-point's derivatives.
const VELOCITY: &str = "_per_second";
const ACCELERATION: &str = "_per_second_squared";

/// Inputs of a law of one loop, in the order of the [`LoopValue`]s. Positions are in metres in a loop in millimetres, else in the
/// unit of the loop.
pub const LOOP_INPUTS: [(&str, LoopValue); 6] = [
    ("position", LoopValue::Position),
    ("set_point", LoopValue::SetPoint),
    ("set_point_per_second", LoopValue::SetPointVelocity),
    (
        "set_point_per_second_squared",
        LoopValue::SetPointAcceleration,
    ),
    ("set_point_per_second_cubed", LoopValue::SetPointJerk),
    (
        "set_point_has_exact_derivatives",
        LoopValue::HasExactDerivatives,
    ),
];

/// Returns the name of the output of a law of one loop that commands the drive at this place of the loop, counted from 0.
pub fn loop_output(place: usize) -> String {
    match place {
        0 => COMMAND.to_owned(),
        place => format!("{COMMAND}_{}", place + 1),
    }
}

/// Value of a loop that a law reads.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum LoopValue {
    /// Position that the loop's drive measured; not a number in a cycle that brought no position.
    Position,
    /// Set-point of the position.
    SetPoint,
    /// First derivative of the set-point.
    SetPointVelocity,
    /// Second derivative of the set-point.
    SetPointAcceleration,
    /// Third derivative of the set-point.
    SetPointJerk,
    /// 1 if the derivatives of the set-point are exact, else 0.
    HasExactDerivatives,
}

/// Value that an input of a law reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Index of the loop.
    pub index: usize,
    /// Value of the loop.
    pub value: LoopValue,
    /// Factor from the loop's unit to the unit of the port.
    pub factor: f64,
}

/// Destination of an output of a law: a command to the drive of a loop, clamped to the drive's range, or a term of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Writing {
    /// Whether it is a command.
    pub is_command: bool,
    /// Index of the loop.
    pub index: usize,
    /// For a command: factor from the port's unit to the target's unit. For a term: factor from the law's unit to the unit in the
    /// term's name.
    pub factor: f64,
}

/// KeyContext of all ports of a law, in their order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LawWires {
    /// Values that the inputs read.
    pub inputs: Vec<Reading>,
    /// Destinations of the outputs.
    pub outputs: Vec<Writing>,
}

/// Problem of a law's ports.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
#[error("{message}: {label}")]
pub struct WrongPort {
    /// Description of the problem.
    pub message: String,
    /// Correct port.
    pub label: String,
}

impl LawWires {
    /// Finds the meaning of the ports of a law of all loops.
    ///
    /// # Errors
    /// The first port without a meaning, or the second one of a name; a drive that gets no command, or two.
    pub fn for_all_loops(ports: &Ports, loops: &[LoopFacts]) -> Result<Self, WrongPort> {
        let reading = |port: &Port| reading(port, loops);
        let writing = |port: &Port| writing(port, loops);
        let wires = Self::found(ports, reading, writing)?;
        each_drive_once(&ports.outputs, &wires.outputs, loops)?;
        Ok(wires)
    }

    /// Finds the meaning of the ports of a law of one loop. `unit` is the loop's unit, `targets` are the targets of the led drives.
    /// Each output's index is the drive's place in the loop.
    ///
    /// # Errors
    /// As [`LawWires::for_all_loops`].
    pub fn for_one_loop(
        ports: &Ports,
        unit: &Unit,
        targets: &[Quantity],
    ) -> Result<Self, WrongPort> {
        let inside = conversion(unit.word(), unit.law_word()).unwrap_or(1.0);
        let reading = |port: &Port| loop_reading(port, inside);
        let writing = |port: &Port| loop_writing(port, inside, targets);
        let wires = Self::found(ports, reading, writing)?;
        let is_first = |writing: &Writing| writing.is_command && writing.index == 0;
        if wires.outputs.iter().any(is_first) {
            Ok(wires)
        } else {
            let message = "the law commands no drive".to_owned();
            let target = targets.first().cloned().unwrap_or_else(Quantity::current);
            let label = format!("add an output `{COMMAND}` or `{}`", target.key());
            Err(wrong(message, label))
        }
    }

    /// Returns the terms of the loop with this index, each with the index of its output, and a factor from that to the unit of its
    /// name.
    pub fn terms<'a>(
        &'a self,
        index: usize,
        outputs: &'a [Port],
    ) -> impl Iterator<Item = (usize, &'a Port, f64)> {
        let wired = self.outputs.iter().zip(outputs).enumerate();
        let terms = wired.filter(move |(_, (one, _))| !one.is_command && one.index == index);
        terms.map(|(output, (writing, port))| (output, port, writing.factor))
    }

    fn found(
        ports: &Ports,
        reading: impl Fn(&Port) -> Result<Reading, WrongPort>,
        writing: impl Fn(&Port) -> Result<Writing, WrongPort>,
    ) -> Result<Self, WrongPort> {
        each_once(&ports.inputs)?;
        each_once(&ports.outputs)?;
        let outputs = ports.outputs.iter().map(writing);
        Ok(Self {
            inputs: ports.inputs.iter().map(reading).collect::<Result<_, _>>()?,
            outputs: outputs.collect::<Result<_, _>>()?,
        })
    }
}

/// Splits an output name after `word`: drive place (from 0) and rest. `command_2` and `current_2_amperes` belong to the second
/// drive.
fn split_drive_number<'a>(output: &'a str, word: &str) -> Option<(usize, &'a str)> {
    let rest = output.strip_prefix(word)?;
    let number = rest.strip_prefix('_').unwrap_or_default();
    let digits = number.split('_').next().unwrap_or_default();
    let place = digits.parse::<usize>().ok().filter(|number| *number > 1);
    match place {
        // No leading zeros: `command_02` is a term.
        Some(number) if number.to_string() == digits => {
            Some((number - 1, &rest[1 + digits.len()..]))
        }
        _ => Some((0, rest)),
    }
}

/// Finds the led drive that an output commands, and the factor to that drive's target unit; `None` for a term. An output is a
/// command if its name is `command`, or the target's name with a unit of that quantity (`current_milliamperes`). `command_9` is a
/// command even without a ninth drive; `current_9_amperes` is then a term.
fn find_command(output: &str, targets: &[Quantity]) -> Option<(usize, f64)> {
    if let Some((place, "")) = split_drive_number(output, COMMAND) {
        return Some((place, 1.0));
    }
    targets.iter().enumerate().find_map(|(place, target)| {
        let (number, rest) = split_drive_number(output, &target.name)?;
        let factor = match rest.strip_prefix('_') {
            // A number without a unit can only be given in percent; any other word is not its unit.
            Some(unit) if target.unit.word().is_empty() && unit != PERCENT => return None,
            Some(unit) => conversion(unit, target.unit.word())?,
            None if rest.is_empty() && target.unit.word().is_empty() => 1.0,
            None => return None,
        };
        (number == place).then_some((place, factor))
    })
}

fn loop_reading(port: &Port, inside: f64) -> Result<Reading, WrongPort> {
    let mut inputs = LOOP_INPUTS.iter();
    let Some((_, value)) = inputs.find(|(name, _)| *name == port.name) else {
        let message = format!("a law of one loop cannot read `{}`", port.name);
        let known = LOOP_INPUTS.iter().map(|(name, _)| name);
        return Err(wrong(message, meant_or_known(&port.name, known)));
    };
    let factor = match value {
        LoopValue::HasExactDerivatives => 1.0,
        _ => inside,
    };
    Ok(Reading {
        index: 0,
        value: *value,
        factor,
    })
}

fn loop_writing(port: &Port, inside: f64, targets: &[Quantity]) -> Result<Writing, WrongPort> {
    if port.name.contains('.') {
        let message = format!("a term cannot be called `{}`", port.name);
        return Err(wrong(message, "a law of one loop names no loop".to_owned()));
    }
    let term = if port.is_position { 1.0 / inside } else { 1.0 };
    let commanded = find_command(&port.name, targets);
    let (index, factor) = commanded.unwrap_or((0, term));
    Ok(Writing {
        is_command: commanded.is_some(),
        index,
        factor,
    })
}

fn wrong(message: String, label: String) -> WrongPort {
    WrongPort { message, label }
}

/// Checks that the names of ports differ, and that their ranges are not empty.
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

/// Returns the index of the loop to which a port belongs, and the rest of the port's name.
fn owner<'a>(port: &'a Port, loops: &[LoopFacts]) -> Result<(usize, &'a str), WrongPort> {
    let (owner, name) = port.name.split_once('.').unwrap_or((&port.name, ""));
    let is_it = |one: &LoopFacts| one.name == owner || one.drive == owner;
    let place = loops.iter().position(is_it).ok_or_else(|| {
        let message = format!("the law's port `{}` is of no loop and no drive", port.name);
        let known = loops.iter().map(|one| one.name.as_str());
        wrong(message, meant_or_known(owner, known))
    })?;
    if is_name(name) {
        Ok((place, name))
    } else {
        let message = format!("the law's port `{}` names nothing", port.name);
        let label = format!(
            "loop and quantity with a dot between them, as in \"{owner}.{}_{}\"",
            loops[place].quantities.feedback.name, loops[place].quantities.feedback.unit
        );
        Err(wrong(message, label))
    }
}

/// Finds the meaning of an input of a law that names loops.
///
/// # Errors
/// The port has no meaning.
pub fn reading(port: &Port, loops: &[LoopFacts]) -> Result<Reading, WrongPort> {
    let (index, name) = owner(port, loops)?;
    let one = &loops[index];
    let Quantities { feedback, .. } = &one.quantities;
    let rest = name.strip_prefix(feedback.name.as_str());
    // By the name of a drive it would be that of another.
    let is_followed = one.followed == one.drive || port.name.starts_with(&format!("{}.", one.name));
    let found = if !is_followed {
        None
    } else if let Some(unit) = rest.and_then(|rest| rest.strip_prefix('_')) {
        conversion(feedback.unit.word(), unit).map(|factor| (LoopValue::Position, factor))
    } else if one.led_by.is_some() {
        None
    } else {
        name.strip_prefix(SET_POINT)
            .and_then(|unit| set_point(&feedback.unit, unit))
    };
    let Some((value, factor)) = found else {
        let message = format!("a law cannot read `{}`", port.name);
        return Err(wrong(message, readable(one)));
    };
    Ok(Reading {
        index,
        value,
        factor,
    })
}

/// Describes the quantities of a loop that a law can read.
fn readable(one: &LoopFacts) -> String {
    let feedback = &one.quantities.feedback;
    let (name, unit) = (&one.name, &feedback.unit);
    let position = format!("`{name}.{}`", feedback.key());
    if one.led_by.is_some() {
        format!("of this drive it is {position}")
    } else {
        format!(
            "of this loop there are {position}, `{name}.{SET_POINT}{unit}`, and that with `{VELOCITY}` and `{ACCELERATION}`"
        )
    }
}

/// Returns the quantity of a set-point whose name has this end, with its factor.
fn set_point(from: &Unit, end: &str) -> Option<(LoopValue, f64)> {
    let derivative = |value, by: &str| {
        let unit = end.strip_suffix(by)?;
        Some((value, conversion(from.word(), unit)?))
    };
    let itself = conversion(from.word(), end).map(|factor| (LoopValue::SetPoint, factor));
    itself
        .or_else(|| derivative(LoopValue::SetPointAcceleration, ACCELERATION))
        .or_else(|| derivative(LoopValue::SetPointVelocity, VELOCITY))
}

/// Finds the meaning of an output of a law that names loops and drives.
///
/// # Errors
/// The port has no meaning.
pub fn writing(port: &Port, loops: &[LoopFacts]) -> Result<Writing, WrongPort> {
    let (index, name) = owner(port, loops)?;
    let drives = Vec::from_iter((0..).map_while(|place| drive_of(&loops[index], place, loops)));
    let targets = drives.iter().map(|drive| &loops[*drive].quantities.output);
    let commanded = find_command(name, &Vec::from_iter(targets.cloned()));
    let command = commanded.and_then(|(place, factor)| Some((*drives.get(place)?, factor)));
    let (index, factor) = command.unwrap_or((index, 1.0));
    Ok(Writing {
        is_command: command.is_some(),
        index,
        factor,
    })
}

/// Returns the index in `loops` of a loop's drive at `place`; place 0 is the loop's first drive.
fn drive_of(one: &LoopFacts, place: usize, loops: &[LoopFacts]) -> Option<usize> {
    loops.iter().position(|other| match (place, &other.led_by) {
        (0, _) => other.name == one.name,
        (_, Some(by)) => by.loop_name == one.name && by.place == place,
        (_, None) => false,
    })
}

/// Checks that each drive gets one command.
fn each_drive_once(
    ports: &[Port],
    written: &[Writing],
    loops: &[LoopFacts],
) -> Result<(), WrongPort> {
    for (place, one) in loops.iter().enumerate() {
        let written = ports.iter().zip(written);
        let mut commands = written.filter(|(_, one)| one.is_command && one.index == place);
        let drive = &one.drive;
        match (commands.next(), commands.next()) {
            (Some(_), None) if one.is_commanded => {}
            (None, _) if !one.is_commanded => {}
            (None, _) => {
                let message = format!("the law does not command the drive `{drive}`");
                let target = one.quantities.output.key();
                let label = format!("add an output `{drive}.{COMMAND}` or `{drive}.{target}`");
                return Err(wrong(message, label));
            }
            (Some((first, _)), Some((second, _))) => {
                let message = format!("the law commands the drive `{drive}` twice");
                let label = format!("by `{}` and by `{}`", first.name, second.name);
                return Err(wrong(message, label));
            }
            (Some((port, _)), None) => {
                let message =
                    format!("the law commands the drive `{drive}`, which is only followed");
                return Err(wrong(message, format!("leave out `{}`", port.name)));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::wiring::LedBy;
    use dbc::CommandRange;

    fn loops() -> Vec<LoopFacts> {
        let led_by = LedBy {
            loop_name: "angle".to_owned(),
            place: 1,
        };
        let one = |name: &str, drive: &str, unit, is_led: bool| LoopFacts {
            name: name.to_owned(),
            drive: drive.to_owned(),
            followed: drive.to_owned(),
            is_commanded: true,
            emulated: String::new(),
            quantities: Quantities::of_position(unit),
            commands: CommandRange::default(),
            led_by: is_led.then(|| led_by.clone()),
            touched: BTreeSet::new(),
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

    fn wired(inputs: &[&str]) -> Result<Vec<(usize, LoopValue, f64)>, String> {
        let wires = LawWires::for_all_loops(&ports(inputs, &CURRENTS), &loops())
            .map_err(|wrong| wrong.to_string())?;
        let inputs = wires.inputs.into_iter();
        Ok(inputs
            .map(|one| (one.index, one.value, one.factor))
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
            (0, LoopValue::Position, 1.0),
            (0, LoopValue::Position, 1.0 / 360.0),
            (1, LoopValue::Position, 1.0),
            (2, LoopValue::Position, 1e-3),
            (2, LoopValue::SetPoint, 1.0),
            (2, LoopValue::SetPointVelocity, 1e-3),
            (0, LoopValue::SetPointAcceleration, 1.0),
        ];
        assert_eq!(read, Ok(expected));
    }

    #[test]
    fn outputs_are_currents_and_terms() {
        let mut outputs = Vec::from(CURRENTS);
        outputs.push("lift.current_error_amperes");
        let ports = ports(&[], &outputs);
        let wires = LawWires::for_all_loops(&ports, &loops()).unwrap();
        let written = |is_command, index, factor| Writing {
            is_command,
            index,
            factor,
        };
        let expected = [
            written(true, 1, 1e-3),
            written(true, 2, 1.0),
            written(false, 2, 1.0),
        ];
        assert_eq!(wires.outputs[1..], expected);
        let terms = wires.terms(2, &ports.outputs);
        let names = terms.map(|(_, port, _)| port.local_name());
        assert_eq!(Vec::from_iter(names), ["current_error_amperes"]);
        assert_eq!(wires.terms(0, &ports.outputs).count(), 0);
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
    fn each_drive_gets_one_command() {
        let said = |outputs: &[&str]| {
            let wires = LawWires::for_all_loops(&ports(&[], outputs), &loops());
            wires.unwrap_err().to_string()
        };
        assert_eq!(
            said(&CURRENTS[..2]),
            "the law does not command the drive `lift`: add an output `lift.command` or `lift.current_amperes`"
        );
        let with = |more: &[&'static str]| Vec::from_iter(CURRENTS.iter().chain(more).copied());
        assert_eq!(
            said(&with(&["angle.current_amperes"])),
            "the law commands the drive `flexor` twice: by `flexor.current_amperes` and by `angle.current_amperes`"
        );
        assert!(said(&with(&["lift.a", "lift.a"])).contains("is there twice"));
        let mut backwards = ports(&[], &CURRENTS);
        backwards.outputs[0].range = [1.0, 0.0];
        let said = LawWires::for_all_loops(&backwards, &loops()).unwrap_err();
        assert!(
            said.message
                .contains("`flexor.current_amperes` has a range"),
            "{said}"
        );
    }

    #[test]
    fn a_law_of_one_loop_sees_metres_or_the_unit_of_its_loop() {
        let terms = [
            Port::position_term("reference_millimetres"),
            Port::term("gain"),
        ];
        let inputs = LOOP_INPUTS.map(|(name, _)| name);
        let mut ports = ports(&inputs, &["command", "current_2_milliamperes"]);
        ports.outputs.extend(terms);
        let targets = [Quantity::current(), Quantity::current()];
        let factors = |unit| {
            let wires = LawWires::for_one_loop(&ports, &unit, &targets).unwrap();
            let read = Vec::from_iter(wires.inputs.iter().map(|reading| reading.factor));
            let terms = wires.terms(0, &ports.outputs);
            let names = Vec::from_iter(terms.map(|(_, port, _)| port.name.as_str()));
            assert_eq!(names, ["reference_millimetres", "gain"]);
            (read, wires.outputs)
        };
        let term = |factor| Writing {
            is_command: false,
            index: 0,
            factor,
        };
        let command = |index, factor| Writing {
            is_command: true,
            index,
            factor,
        };
        let (read, written) = factors(Unit::Millimetres);
        assert_eq!(read, [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1.0]);
        assert_eq!(
            written,
            [command(0, 1.0), command(1, 1e-3), term(1e3), term(1.0)]
        );
        let (read, written) = factors(Unit::Degrees);
        assert_eq!(read, [1.0; 6]);
        assert_eq!(
            written,
            [command(0, 1.0), command(1, 1e-3), term(1.0), term(1.0)]
        );
    }

    #[test]
    fn an_output_is_a_command_by_its_word_or_by_the_target_of_its_drive() {
        let targets = [
            Quantity::current(),
            Quantity::of_port("motor.added_load_kilograms"),
            Quantity::of_port("wire.convection_factor"),
        ];
        for (output, found) in [
            ("command", Some((0, 1.0))),
            ("command_2", Some((1, 1.0))),
            ("command_9", Some((8, 1.0))),
            ("current_amperes", Some((0, 1.0))),
            ("current_milliamperes", Some((0, 1e-3))),
            ("mass_2_grams", Some((1, 1e-3))),
            ("convection_factor_3", Some((2, 1.0))),
            ("convection_factor_3_percent", Some((2, 0.01))),
            ("convection_factor_3_permille", None),
            ("current_2_amperes", None),
            ("mass_kilograms", None),
            ("voltage_volts", None),
            ("command_1", None),
            ("command_02", None),
            ("command_x", None),
            ("commanded", None),
            ("current", None),
        ] {
            assert_eq!(find_command(output, &targets), found, "{output}");
        }
    }

    #[test]
    fn a_law_of_one_loop_reads_that_loop_and_commands_its_first_drive() {
        let said = |inputs: &[&str], outputs: &[&str]| {
            let ports = ports(inputs, outputs);
            let targets = [Quantity::of_port("a.heater_volts")];
            let wires = LawWires::for_one_loop(&ports, &Unit::Millimetres, &targets);
            wires.unwrap_err().to_string()
        };
        assert_eq!(
            said(&["positon"], &["command"]),
            "a law of one loop cannot read `positon`: did you mean `position`?"
        );
        assert_eq!(
            said(&[], &["current_amperes"]),
            "the law commands no drive: add an output `command` or `voltage_volts`"
        );
    }
}
