//! Reader of DBC files.

use can_dbc::{
    AttributeValue, Dbc, MessageId, MultiplexIndicator, NumericValue, SignalExtendedValueType,
};

use crate::coding::{ByteOrder, Coding, Kind, Range, Scale};
use crate::database::{Database, Message, Signal};
use crate::error::DbcError;
use crate::notation::{CYCLE_TIME, LONG_NAME, OBJECT, unescaped};

/// Pseudo-message in which Vector's tools keep signals that belong to no message.
const UNUSED_SIGNALS: &str = "VECTOR__INDEPENDENT_SIG_MSG";
/// Largest number of characters of a line that an error quotes.
const QUOTED_CHARACTERS_MAX: usize = 200;

impl Database {
    /// Longest text that is parsed.
    pub const TEXT_BYTES_MAX: usize = 1 << 20;

    /// Reads a DBC file. Overlapping signals, multiplexed signals, and payloads beyond 8 bytes are refused. The attributes and
    /// escapes of [`Database::to_dbc`] are understood.
    ///
    /// # Errors
    /// [`DbcError`] names the message and signal.
    pub fn parse(text: &str) -> Result<Self, DbcError> {
        let (bytes, limit) = (text.len(), Self::TEXT_BYTES_MAX);
        if bytes > limit {
            let what = format!("DBC text has {bytes} bytes (limit {limit})");
            return Err(DbcError(what));
        }
        let dbc = Dbc::try_from(text).map_err(|error| {
            let error = with_short_lines(&error.to_string());
            DbcError(format!("DBC syntax: {error}"))
        })?;
        let is_used = |message: &&can_dbc::Message| message.name != UNUSED_SIGNALS;
        let used = dbc.messages.iter().filter(is_used);
        let messages = used.map(|message| read_message(&dbc, message));
        let database = Self::from_messages(messages.collect::<Result<_, _>>()?);
        database.refuse_duplicates()?;
        Ok(database)
    }
}

/// Shortens the lines of an error that quotes the text, in which a line may be long.
fn with_short_lines(error: &str) -> String {
    let lines = error.lines().map(|line| {
        let cut = line.char_indices().nth(QUOTED_CHARACTERS_MAX);
        cut.map_or(line, |(end, _)| &line[..end])
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Reads a message with its signals.
fn read_message(dbc: &Dbc, message: &can_dbc::Message) -> Result<Message, DbcError> {
    let (name, bytes) = (&message.name, message.size);
    if let MessageId::Standard(id @ 0x800..) = message.id {
        let what = format!("message {name}: identifier {id:#x} exceeds 11 bits");
        return Err(DbcError(what));
    }
    let length_bytes = u8::try_from(bytes).ok().filter(|bytes| *bytes <= 8);
    let length_bytes = length_bytes.ok_or_else(|| {
        DbcError(format!(
            "message {name} has {bytes} bytes (classical CAN carries 8)"
        ))
    })?;
    let signals = message
        .signals
        .iter()
        .map(|signal| read_signal(dbc, message, signal))
        .collect::<Result<Vec<_>, _>>()?;
    refuse_overlap(name, &signals)?;
    let cycle_time = dbc.resolved_message_attribute(message.id, CYCLE_TIME);
    Ok(Message {
        name: name.clone(),
        raw_id: message.id.raw(),
        length_bytes,
        sender: message.transmitter.clone(),
        cycle_time_milliseconds: match cycle_time {
            Some(AttributeValue::Uint(milliseconds)) => *milliseconds,
            _ => 0,
        },
        comment: unescaped(dbc.message_comment(message.id).unwrap_or_default()),
        signals,
    })
}

/// Refuses two signals of one name or with common bits.
fn refuse_overlap(message: &str, signals: &[Signal]) -> Result<(), DbcError> {
    for (place, second) in signals.iter().enumerate() {
        let bits = second.coding.occupied_bits();
        for first in &signals[..place] {
            let [one, other] = [&first.name, &second.name];
            if one == other {
                let what = format!("message {message} has two signals {one}");
                return Err(DbcError(what));
            }
            if first.coding.occupied_bits() & bits != 0 {
                let what = format!("message {message}: signals {one} and {other} overlap");
                return Err(DbcError(what));
            }
        }
    }
    Ok(())
}

/// Reads a signal with its labels and attributes.
fn read_signal(
    dbc: &Dbc,
    message: &can_dbc::Message,
    signal: &can_dbc::Signal,
) -> Result<Signal, DbcError> {
    let refuse =
        |reason: &str| DbcError(format!("signal {}.{}: {reason}", message.name, signal.name));
    if signal.multiplexer_indicator != MultiplexIndicator::Plain {
        return Err(refuse("multiplexed signals are not supported"));
    }
    let extended_type = dbc.extended_value_type_for_signal(message.id, &signal.name);
    let coding = read_coding(signal, extended_type).map_err(refuse)?;
    coding
        .check(usize::try_from(message.size).unwrap_or(0))
        .map_err(refuse)?;
    let attribute = |name| match dbc.signal_attribute(message.id, &signal.name, name) {
        Some(AttributeValue::String(text)) => unescaped(text),
        _ => String::new(),
    };
    let long_name = attribute(LONG_NAME);
    let labels = dbc.value_descriptions_for_signal(message.id, &signal.name);
    let comment = dbc.signal_comment(message.id, &signal.name);
    Ok(Signal {
        name: if long_name.is_empty() {
            signal.name.clone()
        } else {
            long_name
        },
        unit: unescaped(&signal.unit),
        coding,
        labels: labels
            .unwrap_or_default()
            .iter()
            .map(|label| (label.id, unescaped(&label.description)))
            .collect(),
        receivers: signal.receivers.clone(),
        object: attribute(OBJECT),
        comment: unescaped(comment.unwrap_or_default()),
    })
}

/// Reads bits and scaling of a signal, without checks.
fn read_coding(
    signal: &can_dbc::Signal,
    extended_type: Option<&SignalExtendedValueType>,
) -> Result<Coding, &'static str> {
    let small = |number: u64| u8::try_from(number).map_err(|_| "reaches beyond the payload");
    let range = Range {
        minimum: number(signal.min),
        maximum: number(signal.max),
    };
    let has_range = range.minimum != 0.0 || range.maximum != 0.0;
    Ok(Coding {
        start_bit: small(signal.start_bit)?,
        length_bits: small(signal.size)?,
        byte_order: match signal.byte_order {
            can_dbc::ByteOrder::LittleEndian => ByteOrder::LittleEndian,
            can_dbc::ByteOrder::BigEndian => ByteOrder::BigEndian,
        },
        kind: match (extended_type, signal.value_type) {
            (Some(SignalExtendedValueType::IEEEfloat32Bit), _) => Kind::Float32,
            (Some(SignalExtendedValueType::IEEEdouble64bit), _) => Kind::Float64,
            (_, can_dbc::ValueType::Signed) => Kind::Signed,
            (_, can_dbc::ValueType::Unsigned) => Kind::Unsigned,
        },
        factor: signal.factor,
        offset: signal.offset,
        scale: Scale::new(signal.factor),
        range: has_range.then_some(range),
    })
}

/// Returns a limit as a float.
fn number(value: NumericValue) -> f64 {
    match value {
        NumericValue::Uint(value) => value as f64,
        NumericValue::Int(value) => value as f64,
        NumericValue::Double(value) => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parses a file with these messages and, after them, these lines.
    fn parse(messages: &str) -> Result<Database, DbcError> {
        Database::parse(&format!("VERSION \"\"\n\nBS_:\n\nBU_: a b\n\n{messages}\n"))
    }

    #[test]
    fn vectors_pseudo_message_is_passed_over() {
        let text = "BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" a\n";
        assert!(parse(text).unwrap().messages().is_empty());
    }

    #[test]
    fn what_cannot_be_coded_is_refused_with_its_name() {
        let cases = [
            (
                "BO_ 1 m: 8 a\n SG_ s M : 0|8@1+ (1,0) [0|0] \"\" b",
                "signal m.s: multiplexed",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|0@1+ (1,0) [0|0] \"\" b",
                "length is not 1 to 64 bits",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 1|64@1+ (1,0) [0|0] \"\" b",
                "reaches beyond the payload",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 300|1@1+ (1,0) [0|0] \"\" b",
                "reaches beyond the payload",
            ),
            (
                "BO_ 1 m: 2 a\n SG_ s : 8|9@0+ (1,0) [0|0] \"\" b",
                "reaches beyond the payload",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|8@1+ (0,0) [0|0] \"\" b",
                "factor is 0",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|8@1+ (1e999,0) [0|0] \"\" b",
                "not finite",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|8@1+ (1,0) [2|1] \"\" b",
                "range is empty",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|16@1- (1,0) [0|0] \"\" b\n\nSIG_VALTYPE_ 1 s : 1;",
                "needs 32 bits",
            ),
            ("BO_ 1 m: 9 a\n", "message m has 9 bytes"),
            ("BO_ 2048 m: 8 a\n", "0x800 exceeds 11 bits"),
            (
                "BO_ 1 m: 8 a\n\nBO_ 1 n: 8 a\n",
                "messages m and n have the same",
            ),
            (
                "BO_ 1 m: 8 a\n\nBO_ 2 m: 8 a\n",
                "messages m and m have the same",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" b\n SG_ t : 0|1@0+ (1,0) [0|0] \"\" b",
                "message m: signals s and t overlap",
            ),
            (
                "BO_ 1 m: 8 a\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" b\n SG_ s : 8|8@1+ (1,0) [0|0] \"\" b",
                "message m has two signals s",
            ),
            ("nonsense", "DBC syntax"),
        ];
        for (text, expected) in cases {
            let error = parse(text).expect_err(text).to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
        let long = " ".repeat(Database::TEXT_BYTES_MAX + 1);
        let error = Database::parse(&long).unwrap_err().to_string();
        assert_eq!(error, "DBC text has 1048577 bytes (limit 1048576)");
    }
}
