//! Numbers in the arguments of a command line.

use std::ops::RangeBounds;

/// Parses a number of a range. `expected` and `limits` say what is wrong with a text that is no number, and with another number.
///
/// # Errors
/// One of these texts.
pub fn parse(
    text: &str,
    range: impl RangeBounds<f64>,
    expected: &str,
    limits: impl ToString,
) -> Result<f64, String> {
    let number = text.parse().map_err(|_| expected)?;
    if range.contains(&number) {
        Ok(number)
    } else {
        Err(limits.to_string())
    }
}
