//! `signals.csv`: one row a cycle.

use std::io::{self, Write};

use crate::digits;
use crate::timeline::Timeline;

/// Decimals of a number: one more than the finest signal has.
const DECIMALS: usize = 7;
/// Ten to the power of the decimals.
const SCALE: u32 = 10_000_000;
/// Longest text of a number with decimals: ten places, the point, an even number of decimals.
const CELL: usize = POINT + 1 + DECIMALS + 1;
/// Where the point stands in it.
const POINT: usize = 10;
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
    let mut rows = Rows::of(&columns);
    for (row, cycle) in timeline.cycle.iter().enumerate() {
        if text.len() >= PIECE {
            // The last row stays, since the next one is made of it.
            output.write_all(&text[..rows.last])?;
            text.drain(..std::mem::take(&mut rows.last));
        }
        digits::push(&mut text, *cycle);
        rows.push(&mut text, row);
        text.push(b'\n');
    }
    output.write_all(&text)
}

/// Makes one row of another.
struct Rows<'a> {
    /// The values of each column, and how long the text of the last one is.
    columns: Vec<(&'a [f64], usize)>,
    /// Where the cells of the last row begin.
    last: usize,
}

impl<'a> Rows<'a> {
    fn of(columns: &[&'a [f64]]) -> Self {
        Self {
            columns: columns.iter().map(|values| (*values, 0)).collect(),
            last: 0,
        }
    }

    /// Appends the cells of a row. Most values are those of the row before: stretches of such are copied as text.
    fn push(&mut self, table: &mut Vec<u8>, row: usize) {
        let mut held = self.last..self.last;
        self.last = table.len();
        for (values, length) in &mut self.columns {
            if row > 0 && values[row].to_bits() == values[row - 1].to_bits() {
                held.end += *length;
                continue;
            }
            if !held.is_empty() {
                table.extend_from_within(held.clone());
            }
            held.start = held.end + *length;
            held.end = held.start;
            let begin = table.len();
            table.push(b',');
            push_number(table, values[row]);
            *length = table.len() - begin;
        }
        table.extend_from_within(held);
    }
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
    let whole = scaled / u64::from(SCALE);
    #[expect(clippy::cast_possible_truncation, reason = "less than the scale")]
    let decimals = (scaled % u64::from(SCALE)) as u32;
    let mut text = [b'.'; POINT + CELL];
    // One digit more than there are, since an even number of them is written.
    let digits = digits::eight(10 * decimals);
    text[POINT + 1..CELL].copy_from_slice(&digits);
    let mut first = digits::put(&mut text[..POINT], whole);
    if value.is_sign_negative() && scaled > 0 {
        first -= 1;
        text[first] = b'-';
    }
    let end = if decimals > 0 {
        CELL - zeros_behind(digits)
    } else {
        POINT
    };
    // As many bytes as a number may have are sooner copied than just those of this one.
    let length = table.len() + end - first;
    table.extend_from_slice(&text[first..][..CELL]);
    table.truncate(length);
}

/// How many zeros stand at the end: read as one number, they are its highest bytes.
fn zeros_behind(digits: [u8; DECIMALS + 1]) -> usize {
    const ZEROS: u64 = u64::from_le_bytes([b'0'; DECIMALS + 1]);
    (u64::from_le_bytes(digits) ^ ZEROS).leading_zeros() as usize / 8
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
            -900_719_925.25,
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
            "-900719925.25",
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
            let (mut text, mut rows) = (b"head".to_vec(), Rows::of(&columns));
            let mut expected = "head".to_owned();
            for (index, row) in table.iter().enumerate() {
                rows.push(&mut text, index);
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
