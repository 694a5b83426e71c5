//! The controller's knowledge of the plant: only the positions that the drive sends.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use recording::log::Stamped;
use toml::{Table, Value};

use crate::support::{canrig, only_run, output};

const SMA_ACTUATOR: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"wire\"\nduration_seconds = 1.0\n[controller.sliding_mode]\n\
     [[reference.step]]\nat_seconds = 0.1\nposition_millimetres = 20.0\n";
const DC_MOTOR: &str = "schema = 1\nrig = \"dc_motor\"\nname = \"motor\"\nduration_seconds = 0.5\n\
     [controller.pid]\n\
     proportional_amperes_per_metre = 22.8\n\
     integral_amperes_per_metre_second = 37.9\n\
     derivative_ampere_seconds_per_metre = 3.59\n\
     [[reference.step]]\nat_seconds = 0.1\nposition_millimetres = 20.0\n";
/// NMT, SYNC, EMCY, the PDOs of node 1, the drive's RPDO1, the requests to both nodes, and the heartbeat.
const OF_THE_CONTROLLER: [u16; 11] = [
    0x000, 0x080, 0x081, 0x181, 0x281, 0x381, 0x481, 0x210, 0x610, 0x611, 0x701,
];
const FEEDBACK: u16 = 0x190;

#[test]
fn the_controller_knows_of_the_wire_what_its_positions_show() {
    let compared = compared(SMA_ACTUATOR);
    // The plastic law and cooling have no effect on the first second of a cold wire.
    assert!(compared.diverging >= 15, "{compared:?}");
    assert!(compared.after_truth >= 5, "{compared:?}");
}

#[test]
fn the_controller_knows_of_the_motor_what_its_positions_show() {
    let compared = compared(DC_MOTOR);
    assert!(compared.diverging >= 9, "{compared:?}");
    assert!(compared.after_truth >= 1, "{compared:?}");
}

/// Differences between the run without a changed parameter and those with one.
#[derive(Debug, Default)]
struct Compared {
    /// Number of parameters that the position shows.
    diverging: usize,
    /// Number of these that another signal on the bus showed earlier, which the controller must not read.
    after_truth: usize,
}

/// Changes each parameter of the plant by itself. Up to the first different position the controller must send the same
/// frames.
#[track_caller]
fn compared(text: &str) -> Compared {
    let folder = tempfile::tempdir().unwrap();
    let document: Table = toml::from_str(text).unwrap();
    let plant = plant(folder.path(), text);
    let nominal = frames(folder.path(), "nominal", &text_on(&document, &plant)).unwrap();
    let mut compared = Compared::default();
    let parameters = parameters(&plant, "");
    assert!(parameters.len() >= 15, "{parameters:?}");
    for (path, value) in parameters {
        let other = [1.02, 0.98].into_iter().find_map(|factor| {
            let mut plant = plant.clone();
            *at(&mut plant, &path) = changed(&value, factor);
            frames(folder.path(), &path, &text_on(&document, &plant))
        });
        let other = other.unwrap_or_else(|| panic!("{path} can have no other value"));
        let position = first_difference(&nominal, &other, |id| id == FEEDBACK);
        let controller = first_difference(&nominal, &other, |id| OF_THE_CONTROLLER.contains(&id));
        let anything = first_difference(&nominal, &other, |_| true);
        match (position, controller) {
            (Some(position), Some(controller)) => {
                assert!(controller > position, "{path}: {controller:?} {position:?}");
            }
            (None, controller) => assert_eq!(controller, None, "{path}"),
            (Some(_), None) => {}
        }
        compared.diverging += usize::from(position.is_some());
        compared.after_truth += usize::from(position.is_some() && anything < position);
    }
    compared
}

/// Returns the tables of the plant and of its drive's sensor and amplifier, with all defaults.
fn plant(folder: &Path, text: &str) -> Table {
    let path = folder.join("plant.toml");
    fs::write(&path, text).unwrap();
    let plan = plan::Plan::load(&path, worlds::catalogue::catalogue()).unwrap();
    let scenario = &plan.only_loop().unwrap().trial;
    let part = |name: &str, table: Value| Table::from_iter([(name.to_owned(), table)]);
    let (sensor, amplifier) = (&scenario.sensor, &scenario.amplifier);
    let numbers = |numbers: &[(&str, f64)], resolution_bits: u32| {
        let numbers = numbers
            .iter()
            .map(|(name, number)| ((*name).to_owned(), Value::from(*number)));
        let bits = ("resolution_bits".to_owned(), Value::from(resolution_bits));
        Value::from(Table::from_iter(numbers.chain([bits])))
    };
    let sensor_numbers = [("max", sensor.span()), ("noise_rms", sensor.noise_rms())];
    let mut drive = part("sensor", numbers(&sensor_numbers, sensor.resolution_bits()));
    // The command range of the drive is known to the controller.
    let amplifier_numbers = numbers(&[], amplifier.resolution_bits());
    drive.extend(part("amplifier", amplifier_numbers));
    let plants = match &scenario.plant().dc_motor {
        Some(motor) => part("motor", Value::try_from(motor).unwrap()),
        None => part(
            "wire",
            Value::try_from(scenario.plant().actuator()).unwrap(),
        ),
    };
    let mut tables = part("plant", plants.into());
    tables.extend(part("node", part("drive", drive.into()).into()));
    tables
}

fn text_on(document: &Table, plant: &Table) -> String {
    let mut document = document.clone();
    document.extend(plant.clone());
    toml::to_string(&document).unwrap()
}

/// Returns all numbers of a table, by their paths.
fn parameters(table: &Table, before: &str) -> BTreeMap<String, Value> {
    let numbers_below = |(key, value): (&String, &Value)| match value {
        Value::Table(below) => parameters(below, &format!("{before}{key}.")),
        Value::Float(_) | Value::Integer(_) => {
            BTreeMap::from([(format!("{before}{key}"), value.clone())])
        }
        _ => BTreeMap::new(),
    };
    table.iter().flat_map(numbers_below).collect()
}

fn at<'a>(table: &'a mut Table, path: &str) -> &'a mut Value {
    match path.split_once('.') {
        Some((first, rest)) => at(table[first].as_table_mut().unwrap(), rest),
        None => &mut table[path],
    }
}

fn changed(value: &Value, factor: f64) -> Value {
    match value {
        Value::Integer(number) if factor < 1.0 => Value::Integer(number - 1),
        Value::Integer(number) => Value::Integer(number + 1),
        Value::Float(number) if *number == 0.0 => Value::Float(factor - 0.9),
        other => Value::Float(other.as_float().unwrap() * factor),
    }
}

/// Returns the frames on the bus; `None` if the plant is invalid.
fn frames(folder: &Path, name: &str, text: &str) -> Option<Vec<Stamped>> {
    let path = folder.join(format!("{name}.toml"));
    fs::write(&path, text).unwrap();
    let runs = folder.join(name);
    let (code, _, stderr) = output(canrig(&runs, "simulate").arg(&path));
    assert!(code != Some(101), "{stderr}");
    (code != Some(3)).then(|| {
        let log = fs::read(only_run(&runs).join("bus.log")).unwrap();
        let (frames, unread) = recording::log::read_cut_log(log.as_slice()).unwrap();
        assert_eq!(unread, recording::log::Unread::default());
        frames
    })
}

/// Returns the time at which the first frame of these identifiers differs.
fn first_difference(
    one: &[Stamped],
    other: &[Stamped],
    is_looked_at: impl Fn(u16) -> bool,
) -> Option<Duration> {
    let is_looked_at = |stamped: &&Stamped| stamped.frame.standard_id().is_some_and(&is_looked_at);
    let (mut ones, mut others) = (
        one.iter().filter(is_looked_at),
        other.iter().filter(is_looked_at),
    );
    loop {
        match (ones.next(), others.next()) {
            (Some(one), Some(other)) if one.frame == other.frame => {}
            (None, None) => return None,
            (one, other) => {
                return one
                    .into_iter()
                    .chain(other)
                    .map(|stamped| stamped.time)
                    .min();
            }
        }
    }
}
