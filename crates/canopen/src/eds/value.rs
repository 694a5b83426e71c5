//! The values of an EDS (CiA 306-1, clause 4.4): numbers, `$NODEID` formulas, reals, strings, bytes.
//!
//! What is not written as the standard has it, but can mean one value only, is read too, with what is wrong about it.

use super::ini::split;
use super::notes::quoted;
use crate::object_dictionary::DataType;

/// Value of a text.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Reading<T> {
    pub(super) value: T,
    /// Deviation of the text from CiA 306-1.
    pub(super) slip: Option<String>,
}

impl<T> Reading<T> {
    fn plain(value: T) -> Self {
        Self { value, slip: None }
    }

    fn with_slip(value: T, slip: impl Into<String>) -> Self {
        let slip = Some(slip.into());
        Self { value, slip }
    }
}

/// Reason why a text is no value of a type.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Unreadable {
    pub(super) reason: String,
    /// Whether it is a number, but one that the type cannot have.
    pub(super) is_number: bool,
}

impl Unreadable {
    fn text(reason: impl Into<String>) -> Self {
        Self {
            reason: reason.into(),
            is_number: false,
        }
    }

    fn number(reason: impl Into<String>) -> Self {
        Self {
            reason: reason.into(),
            is_number: true,
        }
    }
}

type Read<T> = Result<Reading<T>, Unreadable>;

/// Reads an integer: decimal, hexadecimal (`0x`), octal (leading 0), or a sum of these and `$NODEID`. Quotes, units and comments
/// behind it, words of a truth value and other ways to write a number are slips.
pub(super) fn integer(text: &str, node_id: u8) -> Read<i128> {
    let strict = match sum(text, node_id) {
        Ok(value) => return Ok(Reading::plain(value)),
        Err(error) if error.is_number => return Err(error),
        Err(error) => error,
    };
    let bare = unquoted(text);
    if bare != text
        && let Ok(value) = sum(bare, node_id)
    {
        return Ok(Reading::with_slip(value, "a number has no quotes"));
    }
    if let Some(value) = truth_value(bare) {
        let slip = format!("expected a number: it counts as {value}");
        return Ok(Reading::with_slip(value, slip));
    }
    match loose_sum(bare, node_id)? {
        Some((value, "")) => Ok(Reading::with_slip(value, format!("it is read as {value}"))),
        Some((value, rest)) => {
            let slip = format!("it is read as {value}, without \"{}\"", quoted(rest));
            Ok(Reading::with_slip(value, slip))
        }
        None => Err(strict),
    }
}

/// Reads a sum as the standard has it.
fn sum(text: &str, node_id: u8) -> Result<i128, Unreadable> {
    // A number holds no semicolon, so here a comment needs no blank before it.
    let text = split(text, b';').next().unwrap_or_default();
    split(text, b'+').try_fold(0_i128, |sum, term| {
        let term = term.trim();
        let value = if term.eq_ignore_ascii_case("$NODEID") {
            i128::from(node_id)
        } else {
            literal(term)?
        };
        sum.checked_add(value).ok_or_else(too_large)
    })
}

/// Reads one number as the standard has it.
fn literal(text: &str) -> Result<i128, Unreadable> {
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
        let text = quoted(text);
        return Err(Unreadable::text(format!("\"{text}\" is not {kind}")));
    }
    let value = i128::from_str_radix(digits, radix).map_err(|_| too_large())?;
    Ok(if is_negative { -value } else { value })
}

fn too_large() -> Unreadable {
    Unreadable::number("the number is too large")
}

/// Checks whether a number is written as `0x…`.
fn is_hexadecimal(text: &str) -> bool {
    text.starts_with("0x") || text.starts_with("0X")
}

/// Returns a text without the quotes around it.
pub(super) fn unquoted(text: &str) -> &str {
    for quote in ['"', '\''] {
        let inside = text.strip_prefix(quote);
        if let Some(inside) = inside.and_then(|inside| inside.strip_suffix(quote)) {
            return inside.trim();
        }
    }
    text
}

/// Returns the number that a word for a truth value stands for.
fn truth_value(text: &str) -> Option<i128> {
    let is_one_of = |words: [&str; 3]| words.iter().any(|word| text.eq_ignore_ascii_case(word));
    if is_one_of(["true", "yes", "on"]) {
        Some(1)
    } else if is_one_of(["false", "no", "off"]) {
        Some(0)
    } else {
        None
    }
}

/// Reads a sum at the beginning of a text, and returns the text behind it; `None` if there is none.
fn loose_sum(text: &str, node_id: u8) -> Result<Option<(i128, &str)>, Unreadable> {
    let (mut sum, mut rest, mut has_terms) = (0_i128, text, false);
    loop {
        let signs_end = rest.find(|letter| !matches!(letter, '+' | '-' | ' ' | '\t'));
        let (signs, behind) = rest.split_at(signs_end.unwrap_or(rest.len()));
        if has_terms && !signs.contains(['+', '-']) {
            break;
        }
        let is_in_term = |letter: char| {
            letter.is_ascii_alphanumeric() || matches!(letter, '$' | '_' | '.' | ',')
        };
        let end = behind.find(|letter| !is_in_term(letter));
        let (term, behind) = behind.split_at(end.unwrap_or(behind.len()));
        let Some(value) = loose_term(term, node_id)? else {
            break;
        };
        let is_negative = signs.matches('-').count() % 2 == 1;
        let value = if is_negative { -value } else { value };
        sum = sum.checked_add(value).ok_or_else(too_large)?;
        (rest, has_terms) = (behind, true);
    }
    Ok(has_terms.then(|| (sum, rest.trim())))
}

/// Reads one number in a way that no standard has; `None` if it can mean none.
fn loose_term(term: &str, node_id: u8) -> Result<Option<i128>, Unreadable> {
    let term = term.replace('_', "");
    if term.trim_start_matches('$').eq_ignore_ascii_case("NODEID") {
        return Ok(Some(node_id.into()));
    }
    let read = |digits: &str, radix| {
        let value = i128::from_str_radix(digits, radix);
        value.map(Some).map_err(|_| too_large())
    };
    let are_digits = |text: &str, radix| {
        !text.is_empty() && text.chars().all(|digit| char::is_digit(digit, radix))
    };
    // The suffixes of C, and the full stop of a sentence.
    let bare = term.trim_end_matches(['u', 'U', 'l', 'L', '.', ',']);
    if is_hexadecimal(bare) {
        let digits = &bare[2..];
        return if are_digits(digits, 16) {
            read(digits, 16)
        } else {
            Ok(None)
        };
    }
    if let Some(digits) = bare.strip_suffix(['h', 'H'])
        && are_digits(digits, 16)
    {
        return read(digits, 16);
    }
    match literal(bare) {
        Ok(value) => return Ok(Some(value)),
        Err(error) if error.is_number => return Err(error),
        // A leading 0 before 8 or 9 begins a decimal number.
        Err(_) if are_digits(bare, 10) => return read(bare, 10),
        Err(_) if are_digits(bare, 16) && !bare.bytes().all(|one| one.is_ascii_lowercase()) => {
            return read(bare, 16);
        }
        Err(_) => {}
    }
    let decimal = bare.replace(',', ".");
    if let Some((whole, fraction)) = decimal.split_once('.') {
        let is_whole = are_digits(whole, 10) && fraction.bytes().all(|digit| digit == b'0');
        return if is_whole { read(whole, 10) } else { Ok(None) };
    }
    // A unit without a blank before it, as in "100ms".
    let end = bare.find(|letter: char| !letter.is_ascii_digit());
    match end.map(|end| bare.split_at(end)) {
        Some((digits, unit))
            if !digits.is_empty() && unit.bytes().all(|one| one.is_ascii_alphabetic()) =>
        {
            read(digits, 10)
        }
        _ => Ok(None),
    }
}

/// Reads a value of a type into its little-endian bytes.
pub(super) fn encode(data_type: DataType, text: &str, node_id: u8) -> Read<Vec<u8>> {
    match data_type {
        DataType::VisibleString => Ok(Reading::plain(text.as_bytes().to_vec())),
        DataType::UnicodeString => {
            let bytes = text.encode_utf16().flat_map(u16::to_le_bytes);
            Ok(Reading::plain(bytes.collect()))
        }
        DataType::OctetString | DataType::Domain => {
            octets(text).map(Reading::plain).map_err(Unreadable::text)
        }
        DataType::Real32 | DataType::Real64 if !is_hexadecimal(unquoted(text)) => {
            real(data_type, text)
        }
        _ => {
            let integer = integer(text, node_id)?;
            let number = number(data_type, text, integer.value)?;
            let slip = integer.slip.or(number.slip);
            Ok(Reading { slip, ..number })
        }
    }
}

/// Returns the bytes of an integer, or of a real given by its bits.
fn number(data_type: DataType, text: &str, value: i128) -> Read<Vec<u8>> {
    let size = data_type.size_bytes().unwrap_or(16);
    let bytes = |value: i128| value.to_le_bytes()[..size].to_vec();
    if data_type == DataType::Boolean {
        let truth = i128::from(value != 0);
        let slip = (value != truth).then(|| "a BOOLEAN is 0 or 1: it counts as 1".to_owned());
        return Ok(Reading {
            value: bytes(truth),
            slip,
        });
    }
    let modulus = 1_i128 << (8 * size).min(126);
    let half = modulus / 2;
    let range = if data_type.is_signed() {
        -half..half
    } else {
        0..modulus
    };
    // Signed values are also written as the hexadecimal digits of their two's complement.
    let is_of_width = (0..modulus).contains(&value);
    if range.contains(&value) || (is_of_width && text.contains(['x', 'X'])) {
        return Ok(Reading::plain(bytes(value)));
    }
    // The digits of a negative number in a wider type, as 0xFFFFFF80 for -128.
    let mut widths = [16, 32, 64].into_iter().map(|bits| 1_i128 << bits);
    let is_extended = data_type.is_signed()
        && widths.any(|wider| wider > modulus && (wider - half..wider).contains(&value));
    if is_of_width || (-half..0).contains(&value) || is_extended {
        let slip = format!(
            "{value} does not fit the type {data_type:?}: it is read as its two's complement"
        );
        return Ok(Reading::with_slip(bytes(value), slip));
    }
    let reason = format!("{value} does not fit the type {data_type:?}");
    Err(Unreadable::number(reason))
}

/// Returns the bytes of a decimal real. A comma, quotes and a unit behind it are slips.
fn real(data_type: DataType, text: &str) -> Read<Vec<u8>> {
    let bare = text.split(';').next().unwrap_or_default().trim();
    if let Some(bytes) = real_bytes(data_type, bare) {
        return Ok(Reading::plain(bytes));
    }
    let loose = unquoted(bare).replace(',', ".");
    let is_of_number = |letter: char| letter.is_ascii_digit() || "+-.eE".contains(letter);
    let end = loose.find(|letter| !is_of_number(letter));
    // An "e" behind the digits may begin a word.
    let digits = loose[..end.unwrap_or(loose.len())].trim_end_matches(['e', 'E', '+', '-']);
    match real_bytes(data_type, digits) {
        Some(bytes) => {
            let slip = format!("it is read as {digits}");
            Ok(Reading::with_slip(bytes, slip))
        }
        None => {
            let reason = format!("\"{}\" is not a finite {data_type:?}", quoted(bare));
            Err(Unreadable::text(reason))
        }
    }
}

/// Returns the bytes of a number that Rust reads, if it is finite in the type.
fn real_bytes(data_type: DataType, text: &str) -> Option<Vec<u8>> {
    if data_type == DataType::Real32 {
        let value = text.parse::<f32>().ok().filter(|value| value.is_finite());
        value.map(|value| value.to_le_bytes().to_vec())
    } else {
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.map(|value| value.to_le_bytes().to_vec())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_can_mean_one_value_only_are_read_with_a_slip() {
        for (text, expected) in [
            ("\"0x10\"", 16),
            ("'7'", 7),
            ("TRUE", 1),
            ("no", 0),
            ("08", 8),
            ("0019", 19),
            ("180h", 0x180),
            ("FF", 0xFF),
            ("000A", 10),
            ("0x8000_0000", 0x8000_0000),
            ("0x10UL", 16),
            ("100 ms", 100),
            ("100ms", 100),
            ("5 // default", 5),
            ("5 # default", 5),
            ("5 (default)", 5),
            ("5%", 5),
            ("1.0", 1),
            ("3,00", 3),
            ("+5", 5),
            ("$NODEID+0x180 (TPDO1)", 0x190),
            ("NODEID + 0x180", 0x190),
            ("0x200-$NODEID", 0x1F0),
            ("- -4", 4),
        ] {
            let read = integer(text, 0x10).unwrap();
            assert_eq!(read.value, expected, "{text}");
            assert!(read.slip.is_some(), "{text}");
        }
        for text in [
            "",
            "-",
            "n/a",
            "see manual",
            "0xZZ",
            "0x",
            "1.5",
            "1,5",
            "?",
            "$",
            "ms5",
        ] {
            let error = integer(text, 0x10).unwrap_err();
            assert!(!error.is_number, "{text}: {error:?}");
        }
        let large = "9".repeat(50);
        for text in [&large, &format!("{large} ms"), &format!("0x{large}")] {
            assert!(integer(text, 1).unwrap_err().is_number, "{text}");
        }
    }

    #[test]
    fn a_number_that_its_type_has_not_is_a_two_s_complement_or_none() {
        for (data_type, text, expected) in [
            (DataType::Unsigned32, "-1", &[0xFF; 4][..]),
            (DataType::Unsigned8, "-128", &[0x80]),
            (DataType::Integer16, "65535", &[0xFF, 0xFF]),
            (DataType::Integer8, "0xFFFFFF80", &[0x80]),
            (DataType::Integer8, "0xFF", &[0xFF]),
            (DataType::Integer32, "0x80000000", &[0, 0, 0, 0x80]),
            (DataType::Integer32, "+0x80000000", &[0, 0, 0, 0x80]),
            (
                DataType::Integer64,
                "0x8000000000000000",
                &[0, 0, 0, 0, 0, 0, 0, 0x80],
            ),
            (DataType::Boolean, "255", &[1]),
            (DataType::Boolean, "true", &[1]),
            (DataType::Real32, "1,5", &[0, 0, 0xC0, 0x3F]),
            (DataType::Real32, "1.5 V", &[0, 0, 0xC0, 0x3F]),
            (DataType::Real32, "\"1.5f\"", &[0, 0, 0xC0, 0x3F]),
        ] {
            let read = encode(data_type, text, 1).unwrap();
            assert_eq!(read.value, expected, "{data_type:?} {text}");
        }
        for (data_type, text) in [
            (DataType::Unsigned8, "256"),
            (DataType::Unsigned8, "-129"),
            (DataType::Integer8, "0x1FF"),
            (DataType::Integer16, "0x12345"),
            (DataType::Unsigned32, "0xFFFFFFFFFFFFFFFFFF"),
        ] {
            let error = encode(data_type, text, 1).unwrap_err();
            assert!(error.is_number, "{data_type:?} {text}");
        }
    }
}
