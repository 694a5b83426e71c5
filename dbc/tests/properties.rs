//! What holds for every signal, every payload and every text.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;

use canopen::CanFrame;
use dbc::{Coding, Database, Kind, LawTerm, PlantSignal, Range, SMA_ACTUATOR, Signal};
use proptest::prelude::*;
use proptest::sample::{Index, select};

/// All signals of the rig and of a file with big-endian, extended and 64-bit messages.
fn signals() -> Vec<Signal> {
    let orders = Database::parse(include_str!("data/byte_orders.dbc")).unwrap();
    let databases = [Database::shipped(), &orders];
    let messages = databases.into_iter().flat_map(Database::messages);
    messages
        .flat_map(|message| message.signals.clone())
        .collect()
}

/// A float that is as often huge, tiny or not a number as it is ordinary.
fn any_value() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -1e3..1e3_f64,
        any::<u64>().prop_map(f64::from_bits)
    ]
}

/// A unit or a comment.
fn any_text() -> impl Strategy<Value = String> {
    prop_oneof!["[ -~\n]{0,40}", "\\PC{0,20}", any::<String>()]
}

/// Different names as scenarios have them.
fn names() -> impl Strategy<Value = BTreeSet<String>> {
    prop::collection::btree_set("[a-z][a-z0-9_]{0,63}", 0..=6)
}

fn plant_signals() -> impl Strategy<Value = Vec<PlantSignal>> {
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
                .map(|(name, (unit, comment, resolution, range))| PlantSignal {
                    name,
                    unit,
                    comment,
                    resolution,
                    range,
                });
        signals.collect()
    })
}

fn law_terms() -> impl Strategy<Value = Vec<LawTerm>> {
    let parts = prop::collection::vec((any_text(), any_text()), 6);
    (names(), parts).prop_map(|(names, parts)| {
        let terms = names
            .into_iter()
            .zip(parts)
            .map(|(name, (unit, comment))| LawTerm {
                name,
                unit,
                comment,
                bits: 32,
                kind: Kind::Float32,
                counts_per_unit: 1.0,
                range: Range {
                    minimum: -1e9,
                    maximum: 1e9,
                },
            });
        terms.collect()
    })
}

/// A layout that a drive may have, or none.
fn any_coding() -> impl Strategy<Value = Coding> {
    let kind = select(vec![Kind::Unsigned, Kind::Signed]);
    let units = prop_oneof![-1e9..-1e-6_f64, 1e-6..1e9_f64];
    let parts = (
        any::<u8>(),
        1..=64_u8,
        kind,
        units,
        -3e9..5e9_f64,
        any::<bool>(),
    );
    parts.prop_map(
        |(start_bit, length_bits, kind, units, raw_offset, is_absent)| {
            let coding = Coding::integer(start_bit, length_bits, kind, units, raw_offset);
            if is_absent { coding.absent() } else { coding }
        },
    )
}

/// One change that makes another database of a database.
#[derive(Clone, Debug)]
enum Change {
    Silent(Vec<Index>),
    Identifiers(Vec<(Index, u16)>),
    Layout(Index, Option<u8>, Vec<Coding>),
    Moved(Index, u8),
    CycleTime(Index, u64),
    Law(Vec<LawTerm>),
}

fn change() -> impl Strategy<Value = Change> {
    let codings = prop::collection::vec(any_coding(), 1..12);
    let length = prop::option::of(0..=8_u8);
    let identifiers = prop::collection::vec((any::<Index>(), 0..=0x7FF_u16), 0..6);
    prop_oneof![
        prop::collection::vec(any::<Index>(), 0..6).prop_map(Change::Silent),
        identifiers.prop_map(Change::Identifiers),
        (any::<Index>(), length, codings)
            .prop_map(|(message, length, codings)| Change::Layout(message, length, codings)),
        (any::<Index>(), 0..=64_u8).prop_map(|(message, bits)| Change::Moved(message, bits)),
        (any::<Index>(), any::<u64>()).prop_map(|(message, time)| Change::CycleTime(message, time)),
        law_terms().prop_map(Change::Law),
    ]
}

impl Change {
    fn of(&self, database: &Database) -> Database {
        let messages = database.messages();
        let name = |index: &Index| index.get(messages).name.as_str();
        match self {
            Self::Silent(silent) => {
                let names: Vec<_> = silent.iter().map(name).collect();
                database.with_silent(&names)
            }
            Self::Identifiers(identifiers) => {
                let identifiers = identifiers.iter().map(|(index, id)| (name(index), *id));
                let moved = database.with_identifiers(&identifiers.collect::<Vec<_>>());
                // Two with the same identifier are refused already.
                moved.unwrap_or_else(|_| database.clone())
            }
            Self::Layout(index, length, codings) => {
                let message = index.get(messages);
                database.with_layout(&message.name, *length, |signal| {
                    let place = message.signals.iter().position(|other| other == signal);
                    codings[place.unwrap() % codings.len()]
                })
            }
            Self::Moved(index, bits) => database.with_layout(name(index), None, |signal| {
                let start_bit = signal.coding.start_bit.saturating_add(*bits);
                signal.coding.starting_at(start_bit)
            }),
            Self::CycleTime(index, milliseconds) => {
                database.with_cycle_time(name(index), *milliseconds)
            }
            Self::Law(terms) => database.with_terms(terms),
        }
    }
}

proptest! {
    #[test]
    fn every_database_that_can_be_made_is_read_back_as_it_was_written(
        plant in prop::option::of(plant_signals()), changes in prop::collection::vec(change(), 0..6),
    ) {
        let shipped = Database::shipped().clone();
        let mut database = plant.map_or(shipped, |signals| Database::with_plant(&signals));
        for change in changes {
            database = change.of(&database);
        }
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
        match database.decode(&frame) {
            Some(decoded) => for signal in decoded.signals() {
                prop_assert!(signal.signal.coding.payload_bytes() <= usize::from(length));
                let path = format!("{}.{}", decoded.message().name, signal.signal.name);
                let value = database.signal(&path).unwrap().decode(&frame).unwrap();
                prop_assert!(value == signal.value || value.is_nan());
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
