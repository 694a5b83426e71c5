//! The values of an EDS (CiA 306-1, clause 4.4): numbers, `$NODEID` formulas, reals, strings, bytes.

use super::ini::split;
use crate::object_dictionary::DataType;

/// Reads an integer: decimal, hexadecimal (`0x`), octal (leading 0), or a sum of these and `$NODEID`.
pub(super) fn integer(text: &str, node_id: u8) -> Result<i128, String> {
    // A number holds no semicolon, so here a comment needs no blank before it.
    let text = split(text, b';').next().unwrap_or_default();
    split(text, b'+').try_fold(0_i128, |sum, term| {
        let term = term.trim();
        let value = if term.eq_ignore_ascii_case("$NODEID") {
            i128::from(node_id)
        } else {
            literal(term)?
        };
        sum.checked_add(value)
            .ok_or_else(|| "the number is too large".to_owned())
    })
}

/// Reads one number.
fn literal(text: &str) -> Result<i128, String> {
    let (is_negative, magnitude) = match text.strip_prefix('-') {
        Some(rest) => (true, rest.trim_start()),
        None => (false, text),
    };
    let (digits, radix, kind) = if is_hexadecimal(magnitude) {
        (&magnitude[2..], 16, "a hexadecimal number")
    } else if magnitude.len() > 1 && magnitude.starts_with('0') {
        (&magnitude[1..], 8, "an octal number (leading 0)")
    } else {
        (magnitude, 10, "a decimal number")
    };
    if digits.is_empty() || !digits.chars().all(|digit| digit.is_digit(radix)) {
        return Err(format!("\"{text}\" is not {kind}"));
    }
    let value = i128::from_str_radix(digits, radix)
        .map_err(|_| format!("the number \"{text}\" is too large"))?;
    Ok(if is_negative { -value } else { value })
}

/// Checks whether a number is written as `0x…`.
fn is_hexadecimal(text: &str) -> bool {
    text.starts_with("0x") || text.starts_with("0X")
}

/// Reads a value of a type into its little-endian bytes.
pub(super) fn encode(data_type: DataType, text: &str, node_id: u8) -> Result<Vec<u8>, String> {
    match data_type {
        DataType::VisibleString => Ok(text.as_bytes().to_vec()),
        DataType::UnicodeString => Ok(text.encode_utf16().flat_map(u16::to_le_bytes).collect()),
        DataType::OctetString | DataType::Domain => octets(text),
        DataType::Real32 | DataType::Real64 if !is_hexadecimal(text) => real(data_type, text),
        _ => integer(text, node_id).and_then(|value| number(data_type, text, value)),
    }
}

/// Returns the bytes of an integer, or of a real given by its bits.
fn number(data_type: DataType, text: &str, value: i128) -> Result<Vec<u8>, String> {
    let size = data_type.size_bytes().unwrap_or(16);
    let bits = if data_type == DataType::Boolean {
        1
    } else {
        8 * size
    };
    let modulus = 1_i128 << bits.min(126);
    let (low, high) = if data_type.is_signed() {
        (-modulus / 2, modulus / 2)
    } else {
        (0, modulus)
    };
    // Signed values are also written as the hexadecimal digits of their two's complement.
    let is_complement = text.contains(['x', 'X']) && (0..modulus).contains(&value);
    if !(low..high).contains(&value) && !is_complement {
        return Err(format!("{value} does not fit the type {data_type:?}"));
    }
    Ok(value.to_le_bytes()[..size].to_vec())
}

/// Returns the bytes of a decimal real.
fn real(data_type: DataType, text: &str) -> Result<Vec<u8>, String> {
    let text = text.split(';').next().unwrap_or_default().trim();
    let refused = || format!("\"{text}\" is not a finite {data_type:?}");
    if data_type == DataType::Real32 {
        let value = text.parse::<f32>().ok().filter(|value| value.is_finite());
        Ok(value.ok_or_else(refused)?.to_le_bytes().to_vec())
    } else {
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        Ok(value.ok_or_else(refused)?.to_le_bytes().to_vec())
    }
}

/// Returns the bytes of hexadecimal digits; blanks between bytes are allowed.
///
/// # Errors
/// With the expected form.
pub fn octets(text: &str) -> Result<Vec<u8>, String> {
    let digits = String::from_iter(text.split_whitespace());
    if digits.len() % 2 != 0 || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return Err("expected pairs of hexadecimal digits".to_owned());
    }
    let byte = |place| u8::from_str_radix(&digits[place..place + 2], 16).ok();
    Ok((0..digits.len()).step_by(2).filter_map(byte).collect())
}
