//! Comparison with cantools, an independent implementation; `data/cantools_vectors.py` wrote the table. cantools also reads files
//! of [`Database::to_dbc`]: those in `data/written`, which `UPDATE_SNAPSHOTS=1 cargo test -p dbc --test cantools` writes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use can::CanFrame;
use can::frame::EXTENDED_FLAG;
use dbc::messages::{Carried, Heading, Pdo, compose};
use dbc::node_objects::{self, PLANT_OBJECTS, PlantSignals, TRUE_POSITION_OBJECT};
use dbc::{Coding, Database, Kind, Message, Range, Signal, carried_terms};

const VECTORS: &str = include_str!("data/cantools_vectors.csv");
const BYTE_ORDERS: &str = include_str!("data/byte_orders.dbc");

/// Frame of the table with the values of its signals.
#[derive(Default)]
struct Vector<'a> {
    message: &'a str,
    is_encoded: bool,
    values: Vec<(&'a str, f64)>,
}

/// Returns the databases whose files cantools has read.
fn written() -> [(&'static str, Database); 4] {
    let shipped = Database::shipped();
    [
        ("shipped.dbc", shipped.clone()),
        ("dc_motor.dbc", with_dc_motor()),
        ("own_law.dbc", composed(&[], &long_terms())),
        ("rig.dbc", real_drive()),
    ]
}

fn with_dc_motor() -> Database {
    let signal = |name: &str, unit: &str, steps_per_unit: f64, range: [f64; 2]| {
        let [minimum, maximum] = range;
        let range = Some(Range { minimum, maximum });
        let coding = Coding::little_endian(0, 16, Kind::Signed, 1.0 / steps_per_unit, range);
        let comment = format!("The motor's \"{name}\".");
        Signal::new(name.to_owned(), unit, &comment, coding)
    };
    let signals = [
        signal(
            "winding_temperature_celsius",
            "degC",
            1e2,
            [-273.15, 327.67],
        ),
        signal(
            "motor_speed_revolutions_per_minute",
            "rpm",
            1.0,
            [-32_768.0, 32_767.0],
        ),
        signal("spring_force_newtons", "N", 1e2, [-327.68, 327.67]),
    ];
    composed(&signals, &[])
}

/// Returns the shipped rig with this plant and this law.
fn composed(plant: &[Signal], terms: &[Signal]) -> Database {
    let shipped = Database::shipped();
    let position = shipped.definition("drive_tpdo2.true_position_millimetres");
    let position = position.unwrap().clone();
    let truth = PlantSignals {
        published: plant.iter().collect(),
        position: &position,
    };
    let objects = node_objects::drive(0x10, Some(truth), []);
    let numbered = PLANT_OBJECTS.into_iter().zip(plant);
    let mut carried: Carried = numbered
        .map(|(index, signal)| ((index, 0), vec![signal.clone()]))
        .collect();
    let first_bit = position.coding.starting_at(0);
    carried.insert(
        (TRUE_POSITION_OBJECT, 0),
        vec![Signal {
            coding: first_bit,
            ..position.clone()
        }],
    );
    let of_plant = compose(&objects, &carried, 1, |pdo| match pdo {
        Pdo::Transmit(number @ 2..) => Some(heading("drive", number, "the truth")),
        _ => None,
    });
    let loops = [(terms.to_vec(), [0x181, 0x281, 0x381, 0x481])];
    let objects = node_objects::controller(1, &loops, &[0x10], &[0x11]);
    let of_law = compose(&objects, &carried_terms(terms, 0), 1, |pdo| match pdo {
        Pdo::Transmit(number) => Some(heading("controller", number, "terms of the law")),
        Pdo::Receive(_) => None,
    });
    let messages = shipped.messages().iter().filter(|message| {
        let mut replaced = ["controller_tpdo", "drive_tpdo2", "drive_tpdo3"].into_iter();
        !replaced.any(|start| message.name.starts_with(start))
    });
    let messages = messages.cloned().chain(of_plant).chain(of_law);
    Database::from_messages(messages.collect())
}

fn heading(node: &str, number: u16, what: &str) -> Heading {
    let name = format!("{node}_tpdo{number}");
    Heading::new(name, node, ["bench"]).about(format!("TPDO{number} of {node}: {what}."))
}

/// Returns names that a DBC does not allow, and the same within its limits.
fn long_terms() -> Vec<Signal> {
    let names = [
        "derivative_part_of_the_current_amperes_squared",
        "derivative_part_of_the_current_amperes",
        "integral_part_amperes",
    ];
    let range = Some(Range {
        minimum: -3.402_823_5e38,
        maximum: 3.402_823_5e38,
    });
    let coding = Coding::little_endian(0, 32, Kind::Float32, 1.0, range);
    let term = |name: &str| Signal::new(name.to_owned(), "A", "Before\nclipping.", coding);
    names.map(term).to_vec()
}

/// Returns a drive that is not the emulator: other identifiers, another layout and scale, no current, no truth.
fn real_drive() -> Database {
    let feedback = |signal: &Signal| match &signal.name[..] {
        "position_millimetres" => Some(Coding::integer(0, 24, Kind::Signed, -12.5, 5000.0)),
        "current_amperes" => None,
        _ => Some(signal.coding.starting_at(signal.coding.start_bit + 32)),
    };
    let lay_out = |message: &mut Message| {
        (message.raw_id, message.length_bytes) = (0x290, 6);
        message.signals.retain_mut(|signal| {
            let coding = feedback(signal);
            signal.coding = coding.unwrap_or(signal.coding);
            coding.is_some()
        });
    };
    let is_of_plant = |name: &str| ["drive_tpdo2", "drive_truth"].contains(&name);
    let messages = Database::shipped().messages().iter();
    let mut messages = Vec::from_iter(messages.filter(|one| !is_of_plant(&one.name)).cloned());
    for message in &mut messages {
        match &*message.name {
            "drive_tpdo1" => lay_out(message),
            "drive_rpdo1" => message.raw_id = 0x320,
            "drive_heartbeat" => message.cycle_time_milliseconds = 20,
            _ => {}
        }
    }
    Database::from_messages(messages)
}

fn databases() -> BTreeMap<&'static str, Database> {
    let parsed = [
        ("sma_actuator.dbc", Database::shipped().clone()),
        ("byte_orders.dbc", Database::parse(BYTE_ORDERS).unwrap()),
    ];
    parsed.into_iter().chain(written()).collect()
}

/// Reads the table: frames by file, direction and frame text.
fn vectors() -> BTreeMap<[&'static str; 3], Vector<'static>> {
    let mut vectors: BTreeMap<_, Vector<'_>> = BTreeMap::new();
    for line in VECTORS.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let &[file, direction, frame, message, signal, value] = &fields[..] else {
            panic!("{line}");
        };
        let vector = vectors.entry([file, direction, frame]).or_default();
        vector.message = message;
        vector.is_encoded = direction == "encode";
        vector.values.push((signal, value.parse().unwrap()));
    }
    vectors
}

/// Returns a frame from candump's notation.
fn frame(text: &str) -> CanFrame {
    let (id, data) = text.split_once('#').unwrap();
    let flag = if id.len() == 8 { EXTENDED_FLAG } else { 0 };
    let id = u32::from_str_radix(id, 16).unwrap() | flag;
    let mut payload = [0; 8];
    for (place, byte) in payload[..data.len() / 2].iter_mut().enumerate() {
        *byte = u8::from_str_radix(&data[2 * place..2 * place + 2], 16).unwrap();
    }
    CanFrame::from_raw(id, u8::try_from(data.len() / 2).unwrap(), payload).unwrap()
}

/// Compares up to the last places, since cantools multiplies where this crate divides.
fn is_same(ours: f64, theirs: f64) -> bool {
    ours == theirs
        || ours.is_nan() && theirs.is_nan()
        || (ours - theirs).abs() <= 4.0 * f64::EPSILON * theirs.abs()
}

#[test]
fn cantools_has_read_the_files_that_are_written() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/written");
    for (name, database) in written() {
        let (path, text) = (folder.join(name), database.to_dbc());
        if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
            fs::write(&path, &text).unwrap();
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), text, "{name}");
        assert_eq!(Database::parse(&text), Ok(database), "{name}");
    }
}

#[test]
fn frames_decode_to_the_values_of_cantools() {
    let databases = databases();
    let mut checked = 0;
    for ([file, _, text], vector) in vectors() {
        let database = &databases[file];
        let frame = frame(text);
        let message = database.message_of(&frame).unwrap();
        assert_eq!(message.name, vector.message);
        let decoded = message.decode(&frame).count();
        assert_eq!(decoded, vector.values.len(), "{text}");
        for (signal, theirs) in vector.values {
            let path = format!("{}.{signal}", vector.message);
            let ours = database.signal(&path).unwrap().decode(&frame).unwrap();
            assert!(
                is_same(ours, theirs),
                "{path} in {text}: {ours} and {theirs}"
            );
            checked += 1;
        }
    }
    assert!(checked > 1000, "{checked}");
}

#[test]
fn values_encode_to_the_frames_of_cantools() {
    let databases = databases();
    let mut checked = 0;
    for ([file, _, text], vector) in vectors()
        .into_iter()
        .filter(|(_, vector)| vector.is_encoded)
    {
        let database = &databases[file];
        let mut builder = database.builder(vector.message).unwrap();
        for (signal, value) in vector.values {
            let handle = database
                .signal(&format!("{}.{signal}", vector.message))
                .unwrap();
            builder.set(&handle, value);
        }
        assert_eq!(builder.frame(), frame(text), "{}", vector.message);
        checked += 1;
    }
    assert!(checked > 100, "{checked}");
}
