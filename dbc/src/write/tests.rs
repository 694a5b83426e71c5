use can::frame::EXTENDED_FLAG;
use proptest::prelude::*;
use proptest::sample::Index;

use super::*;
use crate::coding::{Range, Scale};

/// Returns any text; often a name, often one of characters that have a meaning in a DBC.
fn text() -> impl Strategy<Value = String> {
    prop_oneof![
        "[a-z][a-z0-9_]{0,63}",
        "[\"\\\\x5C;\n\r\t @|:/]{0,8}",
        "\\PC{0,20}",
        any::<String>(),
    ]
}

fn finite() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -1e3..1e3_f64,
        any::<i32>().prop_map(f64::from),
        any::<u64>().prop_map(f64::from_bits),
    ]
    .prop_filter("a number", |value| value.is_finite())
}

fn range() -> impl Strategy<Value = Option<Range>> {
    let ordered = (finite(), finite()).prop_map(|(one, other)| Range {
        minimum: one.min(other),
        maximum: one.max(other),
    });
    let is_one = |range: &Range| range.minimum != 0.0 || range.maximum != 0.0;
    prop::option::of(ordered.prop_filter("[0|0] is none", is_one))
}

fn coding() -> impl Strategy<Value = Coding> {
    let kind = prop_oneof![
        Just((Kind::Float32, 32)),
        Just((Kind::Float64, 64)),
        (1..=64_u8).prop_map(|length| (Kind::Signed, length)),
        (1..=64_u8).prop_map(|length| (Kind::Unsigned, length)),
    ];
    let byte_order = prop_oneof![Just(ByteOrder::LittleEndian), Just(ByteOrder::BigEndian)];
    let factor = finite().prop_filter("a factor", |factor| *factor != 0.0);
    let parts = (any::<u8>(), kind, byte_order, factor, finite(), range());
    parts.prop_map(
        |(start_bit, (kind, length_bits), byte_order, factor, offset, range)| Coding {
            start_bit,
            length_bits,
            byte_order,
            kind,
            factor,
            offset,
            range,
            scale: Scale::new(factor),
        },
    )
}

fn signal() -> impl Strategy<Value = Signal> {
    let name = text().prop_filter("a name", |name| !name.is_empty());
    let labels = prop::collection::vec((any::<i64>(), text()), 0..3);
    let receivers = prop::collection::vec("[a-z]{1,8}", 0..3);
    let parts = (
        name,
        text(),
        coding(),
        labels,
        receivers,
        text(),
        text(),
        0..128_u8,
    );
    parts.prop_map(
        |(name, unit, coding, labels, receivers, object, comment, start_bit)| Signal {
            name,
            unit,
            // Inside the payload more often than by chance.
            coding: coding.starting_at(coding.start_bit.min(start_bit)),
            labels,
            receivers,
            object,
            comment,
        },
    )
}

fn message() -> impl Strategy<Value = Message> {
    let raw_id = prop_oneof![
        0..=0x7FF_u32,
        (0..=0x1FFF_FFFF_u32).prop_map(|id| id | EXTENDED_FLAG),
        (0x1FFF_FFF0..=0x1FFF_FFFF_u32).prop_map(|id| id | EXTENDED_FLAG),
    ];
    let signals = prop::collection::vec(signal(), 0..6);
    let sender = prop::option::of("[a-z]{1,8}");
    let parts = (
        "[a-z_][a-z0-9_]{0,20}",
        raw_id,
        0..=8_u8,
        sender,
        any::<u64>(),
        text(),
        signals,
    );
    parts.prop_map(
        |(name, raw_id, length_bytes, sender, milliseconds, comment, mut signals)| {
            let (mut names, mut taken_bits) = (BTreeSet::new(), 0);
            signals.retain(|signal| {
                let coding = &signal.coding;
                let is_inside = coding.check(length_bytes.into()).is_ok();
                let fits = is_inside && coding.occupied_bits() & taken_bits == 0;
                let is_kept = fits && names.insert(signal.name.clone());
                taken_bits |= if is_kept { coding.occupied_bits() } else { 0 };
                is_kept
            });
            Message {
                name,
                raw_id,
                length_bytes,
                sender,
                cycle_time_milliseconds: milliseconds,
                comment,
                signals,
            }
        },
    )
}

/// Returns messages whose names and identifiers differ.
fn database() -> impl Strategy<Value = Database> {
    prop::collection::vec(message(), 0..8).prop_map(|mut messages| {
        let (mut names, mut identifiers) = (BTreeSet::new(), BTreeSet::new());
        messages.retain(|message| {
            identifiers.insert(message.raw_id) && names.insert(message.name.clone())
        });
        Database::from_messages(messages)
    })
}

fn check(database: &Database) {
    let text = database.to_dbc();
    let read = Database::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert_eq!(&read, database, "{text}");
    // To the last bit: equality does not know the sign of 0.
    assert_eq!(format!("{read:?}"), format!("{database:?}"), "{text}");
}

proptest! {
    #[test]
    fn any_database_is_read_back_as_it_was_written(database in database()) {
        check(&database);
    }

    #[test]
    fn numbers_are_read_back_to_the_last_bit(value in finite()) {
        let text = number(value);
        let read: f64 = text.parse().unwrap();
        prop_assert_eq!(read.to_bits(), value.to_bits(), "{}", text);
    }

    #[test]
    fn short_names_are_admissible_and_differ(
        names in prop::collection::btree_set("[ab]{30,34}|[a_ ]{1,3}|[0-9µ]{1,2}", 1..20), place: Index,
    ) {
        let mut signals = shipped("drive_tpdo1").signals.clone();
        signals.resize(names.len(), signals[0].clone());
        for (signal, name) in signals.iter_mut().zip(names) {
            signal.name = name;
        }
        let count = signals.len();
        signals.rotate_left(place.index(count));
        let short = short_names(&signals);
        prop_assert!(short.iter().all(|name| is_dbc_name(name)), "{:?}", short);
        prop_assert_eq!(short.into_iter().collect::<BTreeSet<_>>().len(), count);
    }
}

fn shipped(name: &str) -> &'static Message {
    Database::shipped().message(name).unwrap()
}

#[test]
fn the_shipped_database_is_read_back() {
    check(Database::shipped());
}

#[test]
fn a_message_is_written_as_people_write_it() {
    let message = Message {
        signals: shipped("drive_tpdo1").signals[7..].to_vec(),
        ..shipped("drive_tpdo1").clone()
    };
    let text = Database::from_messages(vec![message]).to_dbc();
    let written = "BU_: drive controller bench\n\n\
        BO_ 400 drive_tpdo1: 8 drive\n \
        SG_ statusword_bits_13_to_15 : 13|3@1+ (1,0) [0|7] \"\" controller,bench\n \
        SG_ position_millimetres : 16|32@1- (0.001,0) [-2147483.648|2147483.647] \"mm\" controller,bench\n \
        SG_ current_amperes : 48|16@1- (0.001,0) [-32.768|32.767] \"A\" controller,bench\n\n";
    assert!(text.contains(written), "{text}");
}

#[test]
fn what_a_dbc_cannot_say_is_refused_when_read() {
    let refused = |change: fn(&mut Message)| {
        let mut message = shipped("drive_tpdo2").clone();
        change(&mut message);
        let text = Database::from_messages(vec![message]).to_dbc();
        Database::parse(&text).unwrap_err().to_string()
    };
    let double = refused(|message| message.signals[1].name = message.signals[0].name.clone());
    assert!(
        double.contains("two signals wire_temperature_celsius"),
        "{double}"
    );
    let infinite = refused(|message| message.signals[0].coding.factor = f64::INFINITY);
    assert!(infinite.contains("DBC syntax"), "{infinite}");
    let zero = refused(|message| message.signals[0].coding.factor = 0.0);
    assert!(zero.contains("factor is 0"), "{zero}");
    let nameless = refused(|message| message.signals[0].name.clear());
    assert!(nameless.contains("DBC syntax"), "{nameless}");
    let long = refused(|message| message.length_bytes = 9);
    assert!(long.contains("has 9 bytes"), "{long}");
}
