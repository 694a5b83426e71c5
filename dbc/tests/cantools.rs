//! The same numbers as cantools, an independent implementation; `data/cantools_vectors.py` wrote the table.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use canopen::CanFrame;
use canopen::frame::EXTENDED_FLAG;
use dbc::Database;

const VECTORS: &str = include_str!("data/cantools_vectors.csv");
const BYTE_ORDERS: &str = include_str!("data/byte_orders.dbc");

/// One frame of the table with the values of its signals.
#[derive(Default)]
struct Vector<'a> {
    file: &'a str,
    message: &'a str,
    is_encoded: bool,
    values: Vec<(&'a str, f64)>,
}

fn vectors() -> BTreeMap<(&'static str, &'static str), Vector<'static>> {
    let mut vectors: BTreeMap<_, Vector<'_>> = BTreeMap::new();
    for line in VECTORS.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let &[file, direction, frame, message, signal, value] = &fields[..] else {
            panic!("{line}");
        };
        let vector = vectors.entry((direction, frame)).or_default();
        (vector.file, vector.message) = (file, message);
        vector.is_encoded = direction == "encode";
        vector.values.push((signal, value.parse().unwrap()));
    }
    vectors
}

/// A frame in candump's notation.
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

fn database(file: &str) -> Database {
    match file {
        "byte_orders.dbc" => Database::parse(BYTE_ORDERS).unwrap(),
        _ => Database::sma_actuator().clone(),
    }
}

/// Equal but for the last places, since cantools multiplies where this crate divides.
fn is_same(ours: f64, theirs: f64) -> bool {
    ours == theirs
        || ours.is_nan() && theirs.is_nan()
        || (ours - theirs).abs() <= 4.0 * f64::EPSILON * theirs.abs()
}

#[test]
fn frames_decode_to_the_values_of_cantools() {
    let (rig, orders) = (database(""), database("byte_orders.dbc"));
    let mut checked = 0;
    for ((_, text), vector) in vectors() {
        let database = if vector.file == "byte_orders.dbc" {
            &orders
        } else {
            &rig
        };
        let frame = frame(text);
        let decoded = database.decode(&frame).unwrap();
        assert_eq!(decoded.message().name, vector.message);
        assert_eq!(decoded.signals().count(), vector.values.len(), "{text}");
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
    let (rig, orders) = (database(""), database("byte_orders.dbc"));
    let mut checked = 0;
    for ((_, text), vector) in vectors()
        .into_iter()
        .filter(|(_, vector)| vector.is_encoded)
    {
        let database = if vector.file == "byte_orders.dbc" {
            &orders
        } else {
            &rig
        };
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
