//! `signals.csv`: one row a cycle.

use std::io::{self, Write};

use crate::digits;
use crate::timeline::Timeline;

/// Decimals of a number: one more than the finest signal has.
const DECIMALS: usize = 7;
/// Ten to the power of the decimals.
const SCALE: u32 = 10_000_000;
/// Whole numbers below this are exact.
const EXACT_MAX: f64 = 9_007_199_254_740_992.0;
/// The table goes on to the output in pieces of this size: they stay in the processor's cache, and are large enough for the
/// system to take them page after page at once.
const PIECE: usize = 256 * 1024;

/// Writes the table. Names and numbers hold neither comma nor quote, so nothing needs quoting.
///
/// # Errors
/// The output does not take it.
pub fn write(mut output: impl Write, timeline: &Timeline) -> io::Result<()> {
    let mut text = Vec::with_capacity(2 * PIECE);
    text.extend_from_slice(b"cycle,time_seconds,set_point_millimetres");
    for column in &timeline.columns {
        text.push(b',');
        text.extend_from_slice(column.name.as_bytes());
    }
    text.push(b'\n');
    let own = [&timeline.time_seconds, &timeline.set_point_millimetres];
    let columns = timeline.columns.iter().map(|column| &column.values);
    let columns: Vec<&[f64]> = own
        .into_iter()
        .chain(columns)
        .map(|values| &values[..])
        .collect();
    let mut before = vec![0; columns.len() + 1];
    for (row, cycle) in timeline.cycle.iter().enumerate() {
        if text.len() >= PIECE {
            // The last row stays, since the next one is made of it.
            let done = before[0];
            output.write_all(&text[..done])?;
            text.drain(..done);
            before.iter_mut().for_each(|place| *place -= done);
        }
        digits::push(&mut text, *cycle, 1);
        push_row(&mut text, &columns, row, &mut before);
        text.push(b'\n');
    }
    output.write_all(&text)
}

/// Appends the cells of a row. Most values are those of the row `before`, which tells where each of its cells begins and
/// where the last one ends: stretches of such values are copied as text.
fn push_row(table: &mut Vec<u8>, columns: &[&[f64]], row: usize, before: &mut [usize]) {
    // The text of the values that are to be copied.
    let mut held = 0..0;
    for (place, values) in columns.iter().enumerate() {
        let old = before[place]..before[place + 1];
        if row > 0 && values[row].to_bits() == values[row - 1].to_bits() {
            before[place] = table.len() + held.len();
            if held.is_empty() {
                held = old;
            } else {
                held.end = old.end;
            }
            continue;
        }
        table.extend_from_within(std::mem::take(&mut held));
        before[place] = table.len();
        table.push(b',');
        push_number(table, values[row]);
    }
    table.extend_from_within(held);
    before[columns.len()] = table.len();
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
    digits::push(table, scaled / scale, 1);
    let decimals = scaled % scale;
    if decimals > 0 {
        // One digit more than there are, since an even number of them is written.
        let digits = digits::fixed::<{ DECIMALS + 1 }>(10 * decimals);
        let last = digits.iter().rposition(|digit| *digit != b'0');
        table.push(b'.');
        table.extend_from_slice(&digits[..=last.unwrap_or(0)]);
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
        fn rows_that_hold_values_read_as_others(table in prop::collection::vec(prop::array::uniform4(0..3u8), 0..20)) {
            // Few values, so that neighbours are often equal; one of them is none.
            let value = |number: u8| [f64::NAN, -1.5, 1000.0][usize::from(number)];
            let columns: Vec<Vec<f64>> = (0..4).map(|place| table.iter().map(|row| value(row[place])).collect()).collect();
            let columns: Vec<&[f64]> = columns.iter().map(|values| &values[..]).collect();
            let (mut text, mut before) = (b"head".to_vec(), [0; 5]);
            let mut expected = "head".to_owned();
            for (index, row) in table.iter().enumerate() {
                push_row(&mut text, &columns, index, &mut before);
                text.push(b'\n');
                let cells = row.map(|place| format!(",{}", number(value(place))));
                expected += &(cells.concat() + "\n");
            }
            prop_assert_eq!(String::from_utf8(text).unwrap(), expected);
        }

        #[test]
        fn a_number_reads_back_to_half_of_the_last_decimal(value in -1e6..1e6_f64) {
            let read: f64 = number(value).parse().unwrap();
            prop_assert!((read - value).abs() <= 0.51e-7, "{value} {read}");
        }
    }
}
