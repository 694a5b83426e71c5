//! What holds for every signal, every payload and every text.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use canopen::CanFrame;
use dbc::{Database, SMA_ACTUATOR, Signal};
use proptest::prelude::*;

/// All signals of the rig and of a file with big-endian, extended and 64-bit messages.
fn signals() -> Vec<Signal> {
    let orders = Database::parse(include_str!("data/byte_orders.dbc")).unwrap();
    let databases = [Database::sma_actuator(), &orders];
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

proptest! {
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
        let database = Database::sma_actuator();
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
