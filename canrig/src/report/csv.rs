//! `signals.csv`: one row a cycle.

use crate::recording::push_decimal;
use crate::timeline::Timeline;

/// Decimals of a number: one more than the finest signal has.
const DECIMALS: usize = 7;
/// Ten to the power of the decimals.
const SCALE: u32 = 10_000_000;
/// Whole numbers below this are exact.
const EXACT_MAX: f64 = 9_007_199_254_740_992.0;

/// The table as bytes. Names and numbers hold neither comma nor quote, so nothing needs quoting.
#[must_use]
pub fn to_csv(timeline: &Timeline) -> Vec<u8> {
    let mut table = b"cycle,time_seconds,set_point_millimetres".to_vec();
    for column in &timeline.columns {
        table.push(b',');
        table.extend_from_slice(column.name.as_bytes());
    }
    table.push(b'\n');
    for (row, cycle) in timeline.cycle.iter().enumerate() {
        push_decimal(&mut table, *cycle, 1);
        for values in [&timeline.time_seconds, &timeline.set_point_millimetres] {
            push_cell(&mut table, values[row]);
        }
        for column in &timeline.columns {
            push_cell(&mut table, column.values[row]);
        }
        table.push(b'\n');
    }
    table
}

fn push_cell(table: &mut Vec<u8>, value: f64) {
    table.push(b',');
    push_number(table, value);
}

/// A fixed number of decimals without trailing zeros; nothing where there is no value.
fn push_number(table: &mut Vec<u8>, value: f64) {
    if value.is_nan() {
        return;
    }
    let scaled = value.abs() * f64::from(SCALE) + 0.5;
    if scaled >= EXACT_MAX {
        // So large that no decimal is known.
        table.extend_from_slice(value.to_string().as_bytes());
        return;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "below 2^53, and rounded down on purpose"
    )]
    let scaled = scaled as u64;
    if value.is_sign_negative() && scaled > 0 {
        table.push(b'-');
    }
    let scale = u64::from(SCALE);
    push_decimal(table, scaled / scale, 1);
    if !scaled.is_multiple_of(scale) {
        table.push(b'.');
        push_decimal(table, scaled % scale, DECIMALS);
        while table.last() == Some(&b'0') {
            table.pop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn number(value: f64) -> String {
        let mut text = Vec::new();
        push_number(&mut text, value);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn numbers_are_short_and_exact() {
        let texts = [
            0.0,
            -0.0,
            1.0,
            0.1 + 0.2,
            12.345_678_9,
            -1e-9,
            -0.5,
            f64::NAN,
            100.0,
            1e12,
        ]
        .map(number);
        let expected = [
            "0",
            "0",
            "1",
            "0.3",
            "12.3456789",
            "0",
            "-0.5",
            "",
            "100",
            "1000000000000",
        ];
        assert_eq!(texts, expected);
    }

    proptest! {
        #[test]
        fn a_number_reads_back_to_half_of_the_last_decimal(value in -1e6..1e6_f64) {
            let read: f64 = number(value).parse().unwrap();
            prop_assert!((read - value).abs() <= 0.51e-7, "{value} {read}");
        }
    }
}
