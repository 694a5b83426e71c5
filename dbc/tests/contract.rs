//! DBC, EDS and default PDO mapping describe the same frames.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;

use canopen::ObjectDictionary;
use canopen::cia402::{MODES, Mode};
use canopen::eds;
use canopen::object_dictionary::{Access, DataType, Entry};
use dbc::{ByteOrder, CONTROLLER_EDS, DISTURBANCE_EDS, DRIVE_EDS, Database, Kind, Message, Signal};

/// Nodes: name in the DBC, node-ID and EDS of each.
const NODES: [(&str, u8, &str); 3] = [
    ("controller", 0x01, CONTROLLER_EDS),
    ("drive", 0x10, DRIVE_EDS),
    ("disturbance", 0x11, DISTURBANCE_EDS),
];

/// Count of each mapped object, from the text of the EDS: object, name in the EDS, DBC signal (its beginning if the object is
/// split into bits), physical value per count, unit.
const OBJECTS: [(&str, &str, &str, f64, &str); 19] = [
    (
        "0x2101:00",
        "Wire temperature",
        "wire_temperature_celsius",
        0.01,
        "degC",
    ),
    (
        "0x2102:00",
        "Martensite fraction",
        "martensite_fraction",
        1.0 / 50_000.0,
        "",
    ),
    (
        "0x2103:00",
        "True position",
        "true_position_millimetres",
        1e-6,
        "mm",
    ),
    (
        "0x2200:00",
        "Reference position",
        "reference_position_millimetres",
        1e-3,
        "mm",
    ),
    (
        "0x2201:00",
        "Reference velocity",
        "reference_velocity_millimetres_per_second",
        1e-3,
        "mm/s",
    ),
    (
        "0x2202:00",
        "Estimated temperature",
        "estimated_temperature_celsius",
        0.01,
        "degC",
    ),
    (
        "0x2203:00",
        "Estimated martensite fraction",
        "estimated_martensite_fraction",
        1.0 / 50_000.0,
        "",
    ),
    (
        "0x2204:00",
        "Estimated velocity",
        "estimated_velocity_millimetres_per_second",
        1e-3,
        "mm/s",
    ),
    (
        "0x2205:00",
        "Sliding variable",
        "sliding_variable_metres_per_second_squared",
        1.0,
        "m/s^2",
    ),
    ("0x2206:00", "Saturation flags", "saturation_", 1.0, ""),
    (
        "0x2207:00",
        "Equivalent part",
        "equivalent_part_amperes_squared",
        1.0,
        "A^2",
    ),
    (
        "0x2208:00",
        "Switching part",
        "switching_part_amperes_squared",
        1.0,
        "A^2",
    ),
    ("0x6040:00", "Controlword", "controlword_", 1.0, ""),
    ("0x6041:00", "Statusword", "statusword_", 1.0, ""),
    (
        "0x6064:00",
        "Position actual value",
        "position_millimetres",
        1e-3,
        "mm",
    ),
    (
        "0x6071:00",
        "Target torque",
        "target_current_amperes",
        1e-3,
        "A",
    ),
    (
        "0x6078:00",
        "Current actual value",
        "current_amperes",
        1e-3,
        "A",
    ),
    (
        "0x6411:01",
        "Convection factor",
        "convection_factor",
        1e-3,
        "",
    ),
    ("0x6411:02", "Added load", "added_load_grams", 0.1, "g"),
];
/// Period of SYNC unless a scenario gives another; the controller writes it to 0x1006 when it leads.
const SYNC_PERIOD_MICROSECONDS: i128 = 1000;

/// A PDO as the object dictionary describes it by default.
struct Pdo {
    message: String,
    is_transmitted: bool,
    cob_id: u32,
    transmission_type: i128,
    mapped: Vec<(u16, u8, u8)>,
}

fn node(name: &str) -> ObjectDictionary {
    let (_, id, text) = NODES.into_iter().find(|node| node.0 == name).unwrap();
    eds::parse(text, id).unwrap()
}

/// Returns a number in the section `[DeviceInfo]` of the EDS.
fn device_number(name: &str, key: &str) -> i128 {
    let (_, _, text) = NODES.into_iter().find(|node| node.0 == name).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    let number = line.unwrap().strip_prefix('=').unwrap();
    match number.strip_prefix("0x") {
        Some(digits) => i128::from_str_radix(digits, 16).unwrap(),
        None => number.parse().unwrap(),
    }
}

fn integer(dictionary: &ObjectDictionary, index: u16, sub_index: u8) -> i128 {
    dictionary
        .integer(index, sub_index)
        .unwrap_or_else(|| panic!("{index:#06x}:{sub_index:02x} is missing"))
}

/// Returns the identifier in a COB-ID.
fn identifier(dictionary: &ObjectDictionary, index: u16, sub_index: u8) -> u32 {
    u32::try_from(integer(dictionary, index, sub_index) & 0x1FFF_FFFF).unwrap()
}

fn pdos(name: &str, dictionary: &ObjectDictionary) -> Vec<Pdo> {
    let areas = [(0x1400, 0x1600, "rpdo"), (0x1800, 0x1A00, "tpdo")];
    let mut pdos = Vec::new();
    for (communication, mapping, kind) in areas {
        for number in 0..512 {
            if dictionary.integer(communication + number, 1).is_none() {
                continue;
            }
            let count = integer(dictionary, mapping + number, 0);
            let mapped = (1..=u8::try_from(count).unwrap()).map(|sub_index| {
                let entry = integer(dictionary, mapping + number, sub_index);
                let [bits, sub, low, high] = u32::try_from(entry).unwrap().to_le_bytes();
                (u16::from_le_bytes([low, high]), sub, bits)
            });
            let cob_id = integer(dictionary, communication + number, 1);
            assert_eq!(cob_id >> 31 & 1, 0, "the PDO is valid by default");
            pdos.push(Pdo {
                message: format!("{name}_{kind}{}", number + 1),
                is_transmitted: kind == "tpdo",
                cob_id: identifier(dictionary, communication + number, 1),
                transmission_type: integer(dictionary, communication + number, 2),
                mapped: mapped.collect(),
            });
        }
    }
    pdos
}

fn entry(dictionary: &ObjectDictionary, index: u16, sub_index: u8) -> &Entry {
    dictionary.entry(dictionary.find(index, sub_index).unwrap())
}

/// Returns the lowest and highest count of an object.
fn limits(entry: &Entry) -> Option<(f64, f64)> {
    let bits = 8 * entry.data_type.size_bytes()?;
    let (low, high): (i128, i128) = match entry.data_type {
        DataType::Real32 => return Some((-3.402_823_5e38, 3.402_823_5e38)),
        kind if kind.is_signed() => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
        _ => (0, (1 << bits) - 1),
    };
    let low = entry.low_limit.unwrap_or(low);
    let high = entry.high_limit.unwrap_or(high);
    Some((low as f64, high as f64))
}

/// Checks a signal that is a whole object: type, scale, range, unit and name follow from the object.
fn check_whole(signal: &Signal, entry: &Entry, factor: f64) {
    let kind = match entry.data_type {
        DataType::Real32 => Kind::Float32,
        kind if kind.is_signed() => Kind::Signed,
        _ => Kind::Unsigned,
    };
    assert_eq!(signal.coding.kind, kind, "{}", signal.name);
    let (low, high) = limits(entry).unwrap();
    let range = signal.coding.range.unwrap();
    let is_near =
        |physical: f64, count: f64| (physical - count * factor).abs() <= 1e-9 * count.abs();
    assert!(is_near(range.minimum, low), "{} from {low}", signal.name);
    assert!(is_near(range.maximum, high), "{} to {high}", signal.name);
}

/// Checks a signal that shares an object with others: plain bits.
fn check_part(signal: &Signal) {
    let coding = signal.coding;
    assert_eq!(coding.kind, Kind::Unsigned, "{}", signal.name);
    let range = coding.range.unwrap();
    let highest = f64::from((1_u32 << coding.length_bits) - 1);
    assert_eq!(
        (range.minimum, range.maximum),
        (0.0, highest),
        "{}",
        signal.name
    );
}

/// Compares the signals of one message with one mapped object at its place in the payload.
fn check_object(message: &Message, entry: &Entry, first_bit: u32, bits: u8) {
    let object = format!("{:#06X}:{:02X}", entry.index, entry.sub_index).replace("0X", "0x");
    let (_, name, signal_name, factor, unit) = OBJECTS
        .into_iter()
        .find(|described| described.0 == object)
        .unwrap_or_else(|| panic!("{object} is mapped but not described in this test"));
    assert_eq!(entry.name, name, "{object}");
    let signals: Vec<&Signal> = message
        .signals
        .iter()
        .filter(|signal| signal.object == object)
        .collect();
    let covered = signals
        .iter()
        .fold(0, |covered, signal| covered | signal.coding.occupied_bits());
    let place = u64::MAX >> (64 - u32::from(bits)) << first_bit;
    assert_eq!(covered, place, "{} in {}", object, message.name);
    for signal in &signals {
        assert_eq!(signal.coding.byte_order, ByteOrder::LittleEndian);
        assert_eq!(signal.coding.factor, factor, "{}", signal.name);
        assert_eq!(signal.coding.offset, 0.0, "{}", signal.name);
        assert_eq!(signal.unit, unit, "{}", signal.name);
    }
    if let [signal] = signals[..] {
        assert_eq!(signal.name, signal_name);
        check_whole(signal, entry, factor);
    } else {
        for signal in signals {
            assert!(signal.name.starts_with(signal_name), "{}", signal.name);
            check_part(signal);
        }
    }
}

/// Returns the cycle time of a transmission type (CiA 301, table 72).
fn cycle_time_milliseconds(transmission_type: i128, sync_period_microseconds: i128) -> u64 {
    match transmission_type {
        1..=240 => u64::try_from(transmission_type * sync_period_microseconds / 1000).unwrap(),
        _ => 0,
    }
}

#[test]
fn every_pdo_is_laid_out_as_its_default_mapping_says() {
    let database = Database::shipped();
    for (name, _, _) in NODES {
        let dictionary = node(name);
        for pdo in pdos(name, &dictionary) {
            let message = database.message(&pdo.message).unwrap();
            assert_eq!(message.raw_id, pdo.cob_id, "{}", pdo.message);
            let cycle_time =
                cycle_time_milliseconds(pdo.transmission_type, SYNC_PERIOD_MICROSECONDS);
            assert_eq!(
                message.cycle_time_milliseconds, cycle_time,
                "{}",
                pdo.message
            );
            let mut bit = 0;
            for &(index, sub_index, bits) in &pdo.mapped {
                let entry = entry(&dictionary, index, sub_index);
                assert_eq!(entry.data_type.size_bytes(), Some(usize::from(bits) / 8));
                assert!(entry.is_pdo_mappable, "{index:#06x}");
                let is_receivable = entry.access == Access::ReadWriteWrite;
                assert_eq!(is_receivable, !pdo.is_transmitted, "{index:#06x}");
                check_object(message, entry, bit, bits);
                bit += u32::from(bits);
            }
            assert_eq!(u32::from(message.length_bytes) * 8, bit, "{}", pdo.message);
            let in_objects = message
                .signals
                .iter()
                .all(|signal| !signal.object.is_empty());
            assert!(in_objects, "{} has a signal without an object", pdo.message);
            if pdo.is_transmitted {
                assert_eq!(message.sender.as_deref(), Some(name));
            } else {
                let is_received =
                    |signal: &Signal| signal.receivers.iter().any(|node| node == name);
                assert!(message.signals.iter().all(is_received), "{}", pdo.message);
            }
        }
    }
}

#[test]
fn the_frames_are_those_of_the_nodes_and_no_others() {
    let database = Database::shipped();
    // The truth belongs to no node: its identifier is none that CiA 301 predefines.
    let mut expected = BTreeSet::from([
        (0x000, "nmt_command".to_owned(), 2),
        (0x6B0, "drive_truth".to_owned(), 8),
    ]);
    let controller = node("controller");
    assert_eq!(
        integer(&controller, 0x1005, 0) >> 30 & 1,
        1,
        "produces SYNC"
    );
    expected.insert((identifier(&controller, 0x1005, 0), "sync".to_owned(), 1));
    for (name, id, _) in NODES {
        let dictionary = node(name);
        assert_eq!(
            identifier(&dictionary, 0x1005, 0),
            identifier(&controller, 0x1005, 0)
        );
        assert_eq!(
            integer(&dictionary, 0x1019, 0),
            integer(&controller, 0x1019, 0)
        );
        let mut expect =
            |id, frame: &str, length| expected.insert((id, format!("{name}_{frame}"), length));
        expect(identifier(&dictionary, 0x1014, 0), "emergency", 8);
        expect(0x700 + u32::from(id), "heartbeat", 1);
        for (index, channel) in [(0x1200, "sdo"), (0x1201, "sdo2")] {
            if dictionary.integer(index, 1).is_some() {
                expect(
                    identifier(&dictionary, index, 1),
                    &format!("{channel}_request"),
                    8,
                );
                expect(
                    identifier(&dictionary, index, 2),
                    &format!("{channel}_answer"),
                    8,
                );
            }
        }
        for pdo in pdos(name, &dictionary) {
            let bits: u32 = pdo.mapped.iter().map(|mapped| u32::from(mapped.2)).sum();
            expected.insert((pdo.cob_id, pdo.message, u8::try_from(bits / 8).unwrap()));
        }
    }
    let actual: BTreeSet<_> = database
        .messages()
        .iter()
        .map(|message| (message.raw_id, message.name.clone(), message.length_bytes))
        .collect();
    assert_eq!(actual, expected);
}

#[test]
fn the_identifiers_are_those_of_the_design() {
    let database = Database::shipped();
    let frames = [
        ("sync", 0x080),
        ("drive_tpdo1", 0x190),
        ("drive_rpdo1", 0x210),
        ("drive_tpdo2", 0x290),
        ("disturbance_rpdo1", 0x211),
        ("controller_tpdo1", 0x181),
        ("controller_tpdo2", 0x281),
        ("controller_tpdo3", 0x381),
        ("controller_tpdo4", 0x481),
        ("controller_emergency", 0x081),
        ("drive_heartbeat", 0x710),
        ("drive_sdo_request", 0x610),
        ("drive_sdo_answer", 0x590),
    ];
    for (name, id) in frames {
        assert_eq!(database.message(name).unwrap().raw_id, id, "{name}");
    }
}

#[test]
fn cycle_times_of_sync_and_heartbeats_are_those_of_the_eds() {
    let database = Database::shipped();
    let cycle_time =
        |message: &str| i128::from(database.message(message).unwrap().cycle_time_milliseconds);
    assert_eq!(cycle_time("sync") * 1000, SYNC_PERIOD_MICROSECONDS);
    for (name, _, _) in NODES {
        let period = integer(&node(name), 0x1017, 0);
        assert_eq!(cycle_time(&format!("{name}_heartbeat")), period, "{name}");
    }
}

#[test]
fn the_sync_counter_counts_to_its_overflow_which_all_transmission_types_divide() {
    let database = Database::shipped();
    let overflow = integer(&node("controller"), 0x1019, 0);
    let range = database
        .definition("sync.sync_counter")
        .unwrap()
        .coding
        .range
        .unwrap();
    assert_eq!((range.minimum, range.maximum), (1.0, overflow as f64));
    for (name, _, _) in NODES {
        for pdo in pdos(name, &node(name)) {
            let is_synchronous = pdo.transmission_type <= 240;
            assert!(
                !is_synchronous || overflow % pdo.transmission_type == 0,
                "{}",
                pdo.message
            );
        }
    }
}

#[test]
fn the_controller_talks_to_the_server_channels_of_its_slaves() {
    let controller = node("controller");
    for (client, name, id) in [(0x1280, "drive", 0x10), (0x1281, "disturbance", 0x11)] {
        let slave = node(name);
        assert_eq!(
            identifier(&controller, client, 1),
            identifier(&slave, 0x1200, 1)
        );
        assert_eq!(
            identifier(&controller, client, 2),
            identifier(&slave, 0x1200, 2)
        );
        assert_eq!(integer(&controller, client, 3), id);
    }
    let watched = [
        integer(&controller, 0x1016, 1),
        integer(&controller, 0x1016, 2),
    ];
    assert_eq!(watched.map(|entry| entry >> 16), [0x10, 0x11]);
}

#[test]
fn each_eds_agrees_with_itself() {
    for (name, _, _) in NODES {
        let dictionary = node(name);
        let number = |key| device_number(name, key);
        let identity = ["VendorNumber", "ProductNumber", "RevisionNumber"].map(number);
        let object = [1, 2, 3].map(|sub_index| integer(&dictionary, 0x1018, sub_index));
        assert_eq!(identity, object, "{name}");
        let pdos = pdos(name, &dictionary);
        let count = |is_transmitted| {
            let counted = pdos
                .iter()
                .filter(|pdo| pdo.is_transmitted == is_transmitted);
            i128::try_from(counted.count()).unwrap()
        };
        assert_eq!(number("NrOfTXPDO"), count(true), "{name}");
        assert_eq!(number("NrOfRXPDO"), count(false), "{name}");
        for entry in dictionary.entries() {
            let place = format!("{name} {:#06x}:{:02x}", entry.index, entry.sub_index);
            assert!(!entry.name.is_empty(), "{place}");
            assert_eq!(entry.check(&entry.default), Ok(()), "{place}");
        }
    }
}

#[test]
fn device_types_and_ratings_are_those_of_the_profiles() {
    let drive = node("drive");
    assert_eq!(
        integer(&drive, 0x1000, 0),
        0x0002_0192,
        "CiA 402 servo drive"
    );
    assert_eq!(
        integer(&drive, 0x6502, 0),
        MODES.iter().map(Mode::supported_bit).sum::<u32>().into(),
        "the modes that have a row"
    );
    let rated_milliamperes = integer(&drive, 0x6075, 0);
    let database = Database::shipped();
    for signal in [
        "drive_tpdo1.current_amperes",
        "drive_rpdo1.target_current_amperes",
    ] {
        let factor = database.definition(signal).unwrap().coding.factor;
        assert_eq!(
            factor,
            rated_milliamperes as f64 / 1e6,
            "permille of the rated current"
        );
    }
    let disturbance = node("disturbance");
    assert_eq!(
        integer(&disturbance, 0x1000, 0),
        0x0108_0191,
        "CiA 401 analogue outputs"
    );
    for sub_index in [1, 2] {
        let output = integer(&disturbance, 0x6411, sub_index);
        assert_eq!(integer(&disturbance, 0x6443, sub_index), 1);
        assert_eq!(
            integer(&disturbance, 0x6444, sub_index),
            output,
            "errors restore the default"
        );
    }
}

#[test]
fn names_end_in_their_units() {
    let units = [
        ("_millimetres_per_second", "mm/s"),
        ("_metres_per_second_squared", "m/s^2"),
        ("_amperes_squared", "A^2"),
        ("_millimetres", "mm"),
        ("_amperes", "A"),
        ("_celsius", "degC"),
        ("_grams", "g"),
        ("_seconds", "s"),
    ];
    for message in Database::shipped().messages() {
        for signal in &message.signals {
            let found = units.iter().find(|(word, _)| signal.name.ends_with(word));
            let unit = found.map_or("", |(_, unit)| unit);
            assert_eq!(signal.unit, unit, "{}.{}", message.name, signal.name);
            assert!(
                !signal.comment.is_empty(),
                "{}.{}",
                message.name,
                signal.name
            );
        }
        assert!(!message.comment.is_empty(), "{}", message.name);
    }
}

#[test]
fn statusword_labels_follow_the_state_machine() {
    let database = Database::shipped();
    let state = database.definition("drive_tpdo1.statusword_state").unwrap();
    // CiA 402-2, table 30: mask, bits, state.
    let states = [
        (0x4F, 0x00, "not ready to switch on"),
        (0x4F, 0x40, "switch on disabled"),
        (0x6F, 0x21, "ready to switch on"),
        (0x6F, 0x23, "switched on"),
        (0x6F, 0x27, "operation enabled"),
        (0x6F, 0x07, "quick stop active"),
        (0x4F, 0x0F, "fault reaction active"),
        (0x4F, 0x08, "fault"),
    ];
    for bits in 0..0x80_u8 {
        let expected = states.iter().find(|(mask, value, _)| bits & mask == *value);
        let label = expected.map(|(_, _, label)| *label);
        assert_eq!(state.label(f64::from(bits)), label, "{bits:#04x}");
    }
}
