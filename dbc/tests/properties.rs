//! Properties of every signal, every payload and every text.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;

use can::CanFrame;
use dbc::messages::{Heading, Pdo, compose};
use dbc::node_objects::{self, PLANT_OBJECTS, PlantSignals};
use dbc::{Coding, Database, Kind, Message, Range, SMA_ACTUATOR, Signal, carried_terms};
use proptest::prelude::*;
use proptest::sample::select;

/// Returns all signals of the rig, and of a file with big-endian, extended and 64-bit messages.
fn signals() -> Vec<Signal> {
    let orders = Database::parse(include_str!("data/byte_orders.dbc")).unwrap();
    let databases = [Database::shipped(), &orders];
    let messages = databases.into_iter().flat_map(Database::messages);
    messages
        .flat_map(|message| message.signals.clone())
        .collect()
}

/// Returns a float that is as often huge, tiny or not a number as it is ordinary.
fn any_value() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -1e3..1e3_f64,
        any::<u64>().prop_map(f64::from_bits)
    ]
}

/// Returns a unit or a comment.
fn any_text() -> impl Strategy<Value = String> {
    prop_oneof!["[ -~\n]{0,40}", "\\PC{0,20}", any::<String>()]
}

/// Returns different names of the form that scenarios use.
fn names() -> impl Strategy<Value = BTreeSet<String>> {
    prop::collection::btree_set("[a-z][a-z0-9_]{0,63}", 0..=6)
}

fn plant_signals() -> impl Strategy<Value = Vec<Signal>> {
    let resolution = any::<f64>()
        .prop_map(f64::abs)
        .prop_filter("a step", |step| *step > 0.0 && step.is_finite());
    let range = (-1e9..1e9_f64, 1e-9..1e9_f64).prop_map(|(minimum, width)| Range {
        minimum,
        maximum: minimum + width,
    });
    let parts = prop::collection::vec((any_text(), any_text(), resolution, range), 6);
    (names(), parts).prop_map(|(names, parts)| {
        let signals =
            names
                .into_iter()
                .zip(parts)
                .map(|(name, (unit, comment, resolution, range))| {
                    let kind = if range.minimum < 0.0 {
                        Kind::Signed
                    } else {
                        Kind::Unsigned
                    };
                    let coding = Coding::little_endian(0, 16, kind, resolution, Some(range));
                    Signal::new(name, &unit, &comment, coding)
                });
        signals.collect()
    })
}

fn law_terms() -> impl Strategy<Value = Vec<Signal>> {
    let parts = prop::collection::vec((any_text(), any_text()), 6);
    (names(), parts).prop_map(|(names, parts)| {
        let terms = names.into_iter().zip(parts).map(|(name, (unit, comment))| {
            let range = Some(Range {
                minimum: -1e9,
                maximum: 1e9,
            });
            let coding = Coding::little_endian(0, 32, Kind::Float32, 1.0, range);
            Signal::new(name, &unit, &comment, coding)
        });
        terms.collect()
    })
}

/// Returns the coding of an integer of a drive, in the bits from `start_bit` on.
fn any_coding(start_bit: u8, bits_max: u8) -> impl Strategy<Value = Coding> {
    let kind = select(vec![Kind::Unsigned, Kind::Signed]);
    let units = prop_oneof![-1e9..-1e-6_f64, 1e-6..1e9_f64];
    let parts = (1..=bits_max, kind, units, -3e9..5e9_f64);
    parts.prop_map(move |(length_bits, kind, units, raw_offset)| {
        Coding::integer(start_bit, length_bits, kind, units, raw_offset)
    })
}

/// Returns a rig with one drive, emulated or with another layout.
fn rig(
    plant: Option<&[Signal]>,
    terms: &[Signal],
    identifiers: [u16; 2],
    (position, current, target): (Coding, Option<Coding>, Coding),
) -> Database {
    let coding = |signal: &Signal| match signal.name.as_str() {
        "position_millimetres" => Some(position),
        "current_amperes" => current,
        "target_current_amperes" => Some(target),
        _ => Some(signal.coding),
    };
    let shipped = Database::shipped().messages().iter();
    let is_replaced = |message: &&Message| {
        let mut replaced = ["controller_tpdo", "drive_tpdo2"].into_iter();
        replaced.any(|start| message.name.starts_with(start))
    };
    let mut messages = Vec::from_iter(shipped.filter(|one| !is_replaced(one)).cloned());
    for message in messages.iter_mut().filter(|_| plant.is_none()) {
        let (identifier, length_bytes) = match &*message.name {
            "drive_tpdo1" => (identifiers[0], 8),
            "drive_rpdo1" => (identifiers[1], 6),
            "drive_heartbeat" => {
                message.cycle_time_milliseconds = identifiers[0].into();
                continue;
            }
            _ => continue,
        };
        (message.raw_id, message.length_bytes) = (identifier.into(), length_bytes);
        message.signals.retain_mut(|signal| {
            let coding = coding(signal);
            signal.coding = coding.unwrap_or(signal.coding);
            coding.is_some()
        });
    }
    if let Some(published) = plant {
        let position = Signal::new("true_x".to_owned(), "", "", position.starting_at(0));
        let truth = PlantSignals {
            published: published.iter().collect(),
            position: &position,
        };
        let objects = node_objects::drive(0x20, Some(truth), []);
        let numbered = PLANT_OBJECTS.into_iter().zip(published);
        let carried = numbered.map(|(index, signal)| ((index, 0), vec![signal.clone()]));
        let of_plant = compose(&objects, &carried.collect(), 1, |pdo| match pdo {
            Pdo::Transmit(number @ 2..) => Some(heading("drive", number)),
            _ => None,
        });
        messages.extend(of_plant);
    }
    let loops = [(terms.to_vec(), [0x181, 0x281, 0x381, 0x481])];
    let objects = node_objects::controller(1, &loops, &[0x20], &[]);
    let of_law = compose(&objects, &carried_terms(terms, 0), 1, |pdo| match pdo {
        Pdo::Transmit(number) => Some(heading("controller", number)),
        Pdo::Receive(_) => None,
    });
    messages.extend(of_law);
    Database::from_messages(messages)
}

fn heading(node: &str, number: u16) -> Heading {
    Heading::new(format!("{node}_tpdo{number}"), node, ["bench"])
}

proptest! {
    #[test]
    fn every_database_that_can_be_made_is_read_back_as_it_was_written(
        plant in prop::option::of(plant_signals()),
        terms in law_terms(),
        identifiers in [0..=0x7FF_u16, 0..=0x7FF_u16],
        codings in (any_coding(16, 32), prop::option::of(any_coding(48, 16)), any_coding(16, 32)),
    ) {
        let database = rig(plant.as_deref(), &terms, identifiers, codings);
        // Two messages with the same identifier are refused before they are written.
        prop_assume!(database.refuse_duplicates().is_ok());
        let text = database.to_dbc();
        prop_assert_eq!(Database::parse(&text), Ok(database), "{}", text);
    }

    #[test]
    fn a_decoded_value_encodes_to_the_same_value_and_touches_no_other_bit(
        payload: [u8; 8], background: [u8; 8],
    ) {
        for signal in signals() {
            let coding = signal.coding;
            let value = coding.decode(&payload);
            let is_inside = coding.range.is_none_or(|range| (range.minimum..=range.maximum).contains(&value));
            if !is_inside || value.is_nan() {
                continue;
            }
            let mut encoded = background;
            coding.encode(value, &mut encoded);
            prop_assert_eq!(coding.decode(&encoded), value, "{}", signal.name);
            let others = !coding.occupied_bits();
            let (before, after) = (u64::from_le_bytes(background), u64::from_le_bytes(encoded));
            prop_assert_eq!(before & others, after & others, "{}", signal.name);
        }
    }

    #[test]
    fn encoding_saturates_at_the_range_and_rounds_to_the_nearest_step(value in any_value()) {
        for signal in signals() {
            let coding = signal.coding;
            let Some(range) = coding.range else { continue };
            let mut payload = [0; 8];
            coding.encode(value, &mut payload);
            let decoded = coding.decode(&payload);
            if value.is_nan() {
                continue;
            }
            let wanted = value.clamp(range.minimum, range.maximum);
            let slack = match coding.kind {
                dbc::Kind::Float32 => wanted.abs() * f64::from(f32::EPSILON) + 1e-45,
                _ => coding.factor.abs() * 0.500_001 + wanted.abs() * 1e-15,
            };
            prop_assert!((decoded - wanted).abs() <= slack, "{}: {} became {}", signal.name, value, decoded);
        }
    }

    #[test]
    fn any_frame_is_decoded_or_passed_over(id: u32, length in 0_u8..=8, payload: [u8; 8], is_known: bool) {
        let database = Database::shipped();
        let messages = database.messages();
        let id = if is_known { messages[id as usize % messages.len()].raw_id } else { id };
        let frame = CanFrame::from_raw(id, length, payload).unwrap();
        match database.message_of(&frame) {
            Some(message) => for (signal, decoded) in message.decode(&frame) {
                prop_assert!(signal.coding.payload_bytes() <= usize::from(length));
                let path = format!("{}.{}", message.name, signal.name);
                let value = database.signal(&path).unwrap().decode(&frame).unwrap();
                prop_assert!(value == decoded || value.is_nan());
            },
            None => prop_assert!(messages.iter().all(|message| message.raw_id != id)),
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in "(BO_|SG_|VAL_|CM_|BA_|SIG_VALTYPE_|[0-9@|:+\" ;\n-]){0,60}") {
        let _ = Database::parse(&text);
    }

    #[test]
    fn no_damage_to_the_file_makes_the_parser_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), "[ -~\n]{0,4}"), 1..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut text = SMA_ACTUATOR[..=cut.index(SMA_ACTUATOR.len())].to_owned();
        for (place, replacement) in places {
            let start = place.index(text.len());
            let end = (start + replacement.len()).min(text.len());
            text.replace_range(start..end, &replacement);
        }
        if let Ok(database) = Database::parse(&text) {
            for message in database.messages() {
                for signal in &message.signals {
                    let mut payload = [0xA5; 8];
                    signal.coding.encode(signal.coding.decode(&payload), &mut payload);
                }
            }
        }
    }
}
