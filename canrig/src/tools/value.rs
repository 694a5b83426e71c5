//! Values of objects, as text.

use std::collections::BTreeSet;

use canopen::eds::octets;
use canopen::object_dictionary::{DataType, Entry};
use dbc::{Database, Signal};

/// Largest number of bytes that are shown in hexadecimal digits.
const SHOWN_BYTES_MAX: usize = 64;

/// Returns the name of a type in the standard, such as `VISIBLE_STRING`: that in the code, in capitals.
pub(crate) fn type_name(data_type: DataType) -> String {
    let mut name = String::new();
    for letter in format!("{data_type:?}").chars() {
        if letter.is_ascii_uppercase() && !name.is_empty() {
            name.push('_');
        }
        name.push(letter.to_ascii_uppercase());
    }
    name
}

/// Returns bytes as a value of the object's type; for unknown objects as bytes.
pub(crate) fn show(entry: Option<&Entry>, bytes: &[u8]) -> String {
    let Some(entry) = entry else {
        return show_bytes(bytes);
    };
    let data_type = entry.data_type;
    let size = data_type.size_bytes();
    if let Some(size) = size.filter(|size| *size != bytes.len()) {
        let (shown, name, has) = (show_bytes(bytes), type_name(data_type), bytes.len());
        return if has < size {
            format!("{shown} (a short answer: {has} bytes, {name} has {size})")
        } else {
            format!("{shown} (not of type {name})")
        };
    }
    match data_type {
        DataType::Boolean => (bytes != [0]).to_string(),
        DataType::Real32 => show_real(bytes, f32::from_le_bytes),
        DataType::Real64 => show_real(bytes, f64::from_le_bytes),
        DataType::VisibleString => format!("{:?}", String::from_utf8_lossy(bytes)),
        DataType::UnicodeString => {
            let units: Vec<u16> = bytes
                .chunks_exact(2)
                .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
                .collect();
            format!("{:?}", String::from_utf16_lossy(&units))
        }
        DataType::OctetString
        | DataType::Domain
        | DataType::TimeOfDay
        | DataType::TimeDifference => show_bytes(bytes),
        _ => show_integer(entry, bytes),
    }
}

fn show_real<const N: usize, T: ToString>(bytes: &[u8], real: fn([u8; N]) -> T) -> String {
    bytes
        .try_into()
        .map_or_else(|_| show_bytes(bytes), |bytes| real(bytes).to_string())
}

fn show_integer(entry: &Entry, bytes: &[u8]) -> String {
    let value = entry.decode_integer(bytes);
    if entry.data_type.is_signed() {
        return value.to_string();
    }
    let digits = 2 * bytes.len();
    format!("{value} (0x{value:0digits$X})")
}

fn show_bytes(bytes: &[u8]) -> String {
    let shown = bytes.iter().take(SHOWN_BYTES_MAX);
    let pairs = Vec::from_iter(shown.map(|byte| format!("{byte:02X}")));
    let rest = if bytes.len() > SHOWN_BYTES_MAX {
        " ..."
    } else {
        ""
    };
    format!("{}{rest} ({} bytes)", pairs.join(" "), bytes.len())
}

/// Returns the meaning of a value by the DBC: number with unit and label of each signal that is made from the object.
pub(crate) fn meaning(database: &Database, entry: &Entry, bytes: &[u8]) -> Vec<String> {
    let object = format!("0x{:04X}:{:02X}", entry.index, entry.sub_index);
    let signals = database.messages().iter().flat_map(|message| {
        let signals = message.signals.iter();
        // Signals lie in the message where the object lies; the first of them shows its place.
        let first = message
            .signals
            .iter()
            .find(|signal| signal.object == object);
        let start = first.map_or(0, |signal| signal.coding.start_bit);
        signals
            .filter(|signal| signal.object == object)
            .map(move |signal| (signal, start))
    });
    let mut seen = BTreeSet::new();
    signals
        .filter(|(signal, _)| seen.insert(&signal.name))
        .filter_map(|(signal, start)| signal_meaning(signal, start, bytes))
        .collect()
}

fn signal_meaning(signal: &Signal, start: u8, bytes: &[u8]) -> Option<String> {
    let mut payload = [0; 8];
    payload.get_mut(..bytes.len())?.copy_from_slice(bytes);
    let mut coding = signal.coding;
    coding.start_bit = coding.start_bit.checked_sub(start)?;
    coding.check(bytes.len()).ok()?;
    let value = coding.decode(&payload);
    let says_more =
        !signal.unit.is_empty() || signal.label(value).is_some() || coding.factor != 1.0;
    says_more.then(|| show_signal(signal, value))
}

/// Returns a signal with its value, unit and label.
pub(crate) fn show_signal(signal: &Signal, value: f64) -> String {
    let number = match signal.label(value) {
        Some(label) => format!("\"{label}\""),
        None => show_number(signal.coding.factor, value),
    };
    let unit = &signal.unit;
    let blank = if unit.is_empty() { "" } else { " " };
    format!("{}={number}{blank}{unit}", signal.name)
}

/// Returns whether a value carries no information: a flag that is not set, or an unnamed value of a few bits that is 0.
pub(crate) fn is_idle(signal: &Signal, value: f64) -> bool {
    let is_nameless = signal.unit.is_empty() && signal.coding.length_bits < 8;
    value == 0.0
        && signal
            .label(value)
            .map_or(is_nameless, |label| label == "no")
}

/// Returns a number with the decimals that its steps need.
fn show_number(factor: f64, value: f64) -> String {
    let is_whole = factor.fract() == 0.0;
    if is_whole && value.fract() != 0.0 {
        // A floating-point signal.
        return format!("{value:.6}");
    }
    let mut decimals = 0;
    let mut step = factor.abs();
    while decimals < 9 && (step - step.round()).abs() > 1e-6 * step {
        step *= 10.0;
        decimals += 1;
    }
    format!("{value:.decimals$}")
}

/// Parses a text as a value of the object's type, little-endian.
///
/// # Errors
/// The text is no value of the type; the error has the expected form.
pub(crate) fn parse(entry: &Entry, text: &str) -> Result<Vec<u8>, String> {
    let data_type = entry.data_type;
    let wrong = |expected: &str| {
        let (index, sub_index) = (entry.index, entry.sub_index);
        format!(
            "\"{text}\" is not a value for 0x{index:04X}:{sub_index:02X} {}: {expected}",
            entry.name
        )
    };
    match data_type {
        DataType::Boolean => match text {
            "true" | "1" => Ok(vec![1]),
            "false" | "0" => Ok(vec![0]),
            _ => Err(wrong("true or false is expected")),
        },
        DataType::Real32 => text
            .parse::<f32>()
            .map(|value| value.to_le_bytes().to_vec())
            .map_err(|_| wrong("a number is expected")),
        DataType::Real64 => text
            .parse::<f64>()
            .map(|value| value.to_le_bytes().to_vec())
            .map_err(|_| wrong("a number is expected")),
        DataType::VisibleString => Ok(text.as_bytes().to_vec()),
        DataType::UnicodeString => Ok(text.encode_utf16().flat_map(u16::to_le_bytes).collect()),
        DataType::OctetString
        | DataType::Domain
        | DataType::TimeOfDay
        | DataType::TimeDifference => {
            parse_bytes(text).ok_or_else(|| wrong("pairs of hexadecimal digits are expected"))
        }
        _ => {
            let size = data_type.size_bytes().unwrap_or(8);
            let value = parse_integer(text).ok_or_else(|| wrong("a whole number is expected"))?;
            let bytes = value.to_le_bytes()[..size].to_vec();
            if entry.decode_integer(&bytes) != value {
                return Err(wrong(&format!("it does not fit {}", type_name(data_type))));
            }
            Ok(bytes)
        }
    }
}

/// Parses the value of an object of unknown type. Two forms are accepted: `0x` with two digits for each byte, and at
/// least two bytes separated by blanks. Other texts are ambiguous in size or base.
pub(crate) fn parse_untyped(text: &str) -> Option<Vec<u8>> {
    match text.strip_prefix("0x") {
        Some(digits) if digits.contains(char::is_whitespace) => None,
        Some(digits) => {
            let mut bytes = parse_bytes(digits)?;
            bytes.reverse();
            Some(bytes)
        }
        None => {
            let pairs: Vec<&str> = text.split_whitespace().collect();
            let is_bytes = pairs.len() > 1 && pairs.iter().all(|pair| pair.len() == 2);
            is_bytes.then(|| parse_bytes(text))?
        }
    }
}

/// Parses bytes, each as two hexadecimal digits.
pub(crate) fn parse_bytes(text: &str) -> Option<Vec<u8>> {
    octets(text).ok().filter(|bytes| !bytes.is_empty())
}

fn parse_integer(text: &str) -> Option<i128> {
    let (is_negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text),
    };
    if digits.starts_with(['+', '-']) {
        return None;
    }
    let value = match digits.get(..2) {
        Some("0x" | "0X") => i128::from_str_radix(&digits[2..], 16),
        Some("0b" | "0B") => i128::from_str_radix(&digits[2..], 2),
        _ => digits.parse(),
    };
    value
        .ok()
        .map(|value| if is_negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use plan::data_sheet::rig_data_sheets;
    use proptest::prelude::*;

    fn entry(index: u16, sub_index: u8) -> Entry {
        rig_data_sheets()[1]
            .dictionary
            .get(index, sub_index)
            .unwrap()
            .clone()
    }

    #[test]
    fn numbers_are_read_in_the_objects_type() {
        for (index, text, bytes) in [
            (0x6071, "-2", vec![0xFE, 0xFF]),
            (0x6071, "0x10", vec![0x10, 0]),
            (0x1017, "0b101", vec![5, 0]),
            (0x60A8, "4294967295", vec![0xFF; 4]),
        ] {
            assert_eq!(parse(&entry(index, 0), text).unwrap(), bytes, "{text}");
        }
    }

    #[test]
    fn a_value_without_type_must_show_its_size() {
        for (text, bytes) in [
            ("0x32", vec![0x32]),
            ("0x0032", vec![0x32, 0]),
            ("32 00", vec![0x32, 0]),
            ("0x000003e8", vec![0xE8, 3, 0, 0]),
        ] {
            assert_eq!(parse_untyped(text), Some(bytes), "{text}");
        }
        // The base and the size are ambiguous.
        for text in ["50", "3200", "0x321", "0x", "1 2", "32 0", "", "fast"] {
            assert_eq!(parse_untyped(text), None, "{text}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let error = parse(&entry(0x1017, 0), "70000").unwrap_err();
        assert_eq!(
            error,
            "\"70000\" is not a value for 0x1017:00 Producer heartbeat time: it does not fit UNSIGNED16"
        );
        for text in ["", "-1", "ten", "0x", "1.5", "--1", "+-1"] {
            assert!(parse(&entry(0x1017, 0), text).is_err(), "{text}");
        }
    }

    #[test]
    fn values_are_shown_by_type_with_unit_and_label() {
        let database = Database::shipped();
        let shown = |index, bytes: &[u8]| {
            let entry = entry(index, 0);
            (show(Some(&entry), bytes), meaning(database, &entry, bytes))
        };
        let (value, meaning) = shown(0x6064, &10_000_i32.to_le_bytes());
        assert_eq!(
            (value.as_str(), meaning),
            ("10000", vec!["position_millimetres=10.000 mm".to_owned()])
        );
        let (value, meaning) = shown(0x6041, &[0x37, 0x12]);
        assert_eq!(value, "4663 (0x1237)");
        assert!(meaning[0].contains("operation enabled"), "{meaning:?}");
        assert!(
            meaning.contains(&"statusword_follows_command=\"yes\"".to_owned()),
            "{meaning:?}"
        );
        assert_eq!(shown(0x1008, b"SMA").0, "\"SMA\"");
        assert_eq!(
            shown(0x1000, b"SMA").0,
            "53 4D 41 (3 bytes) (a short answer: 3 bytes, UNSIGNED32 has 4)"
        );
    }

    #[test]
    fn numbers_have_the_decimals_of_their_steps() {
        for (factor, value, text) in [
            (1.0, 3.0, "3"),
            (0.001, 10.0, "10.000"),
            (0.000_001, 9.987_654, "9.987654"),
            (0.000_02, 0.951_16, "0.95116"),
            (0.5, 1.5, "1.5"),
            (1.0, 0.25, "0.250000"),
        ] {
            assert_eq!(show_number(factor, value), text);
        }
    }

    proptest! {
        #[test]
        fn every_integer_comes_back(value: i16) {
            let entry = entry(0x6071, 0);
            let bytes = parse(&entry, &value.to_string()).unwrap();
            prop_assert_eq!(show(Some(&entry), &bytes), value.to_string());
        }

        #[test]
        fn arbitrary_text_and_bytes_never_panic(text in ".{0,20}", bytes: Vec<u8>, place in 0usize..112) {
            let drive = rig_data_sheets().remove(1);
            let entry = &drive.dictionary.entries()[place];
            let _ = parse(entry, &text);
            let _ = parse_bytes(&text);
            let _ = parse_untyped(&text);
            let _ = show(Some(entry), &bytes);
            let _ = meaning(Database::shipped(), entry, &bytes);
        }
    }
}
