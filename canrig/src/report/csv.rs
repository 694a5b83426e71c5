//! `signals.csv`: one row a cycle.

use std::io::{self, Write};

use crate::digits;
use crate::timeline::Timeline;

/// Decimals of a number: one more than the finest signal has.
const DECIMALS: usize = 7;
/// Ten to the power of the decimals.
const SCALE: u32 = 10_000_000;
/// Longest text of a cell with decimals: what stands before the point, the point, an even number of decimals.
const CELL: usize = POINT + 1 + DECIMALS + 1;
/// Where the point stands in it: behind the comma, a sign and nine digits.
const POINT: usize = 11;
/// Numbers from here on have no decimal that is known: that many decimals of them are no whole numbers below 2^53.
const LARGE: f64 = (9_007_199_254_740_992.0 - 0.5) / SCALE as f64;
/// The table goes on to the output in pieces of this size: they stay in the processor's cache, and are large enough for the
/// system to take them page after page at once.
const PIECE: usize = 256 * 1024;
/// Cells that are kept, a power of two: most measured values come again soon.
const KEPT: usize = 2048;
/// Rows in which changes are looked for together.
const ROWS: usize = 128;

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
    columns: &'a [&'a [f64]],
    cells: Cells,
    /// Of each 64 columns, a bit for each that changes, in each of some rows.
    changed: Vec<[u64; ROWS]>,
    /// Where the cells of the last row begin.
    last: usize,
    /// Where each of them ends, counted from there.
    ends: Vec<usize>,
}

impl<'a> Rows<'a> {
    fn of(columns: &'a [&'a [f64]]) -> Self {
        Self {
            columns,
            cells: Cells::new(),
            changed: vec![[0; ROWS]; columns.len().div_ceil(64)],
            last: 0,
            ends: vec![0; columns.len()],
        }
    }

    /// Appends the cells of a row. Most values are those of the row before: stretches of such are copied as text.
    fn push(&mut self, table: &mut Vec<u8>, row: usize) {
        if row.is_multiple_of(ROWS) {
            self.find_changes(row);
        }
        let last = std::mem::replace(&mut self.last, table.len());
        // By how much the cells so far are longer than those of the last row, and what of that is still to be copied.
        let mut longer = 0_usize;
        let mut held = last;
        for (words, first) in self.changed.iter().zip((0..).step_by(64)) {
            let mut bits = words[row % ROWS];
            while bits != 0 {
                let column = first + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let begin = if column == 0 {
                    0
                } else {
                    self.ends[column - 1]
                };
                let held_end = last + begin.wrapping_sub(longer);
                if held < held_end {
                    table.extend_from_within(held..held_end);
                }
                held = last + self.ends[column].wrapping_sub(longer);
                self.cells.push(table, self.columns[column][row]);
                let more = (table.len() - self.last).wrapping_sub(self.ends[column]);
                if more != 0 {
                    let ends = self.ends[column..].iter_mut();
                    ends.for_each(|end| *end = end.wrapping_add(more));
                    longer = longer.wrapping_add(more);
                }
            }
        }
        let end = self.ends.last().map_or(0, |end| end.wrapping_sub(longer));
        table.extend_from_within(held..last + end);
    }

    /// Compares the values from this row on with those before them, column after column.
    fn find_changes(&mut self, row: usize) {
        for (columns, words) in self.columns.chunks(64).zip(&mut self.changed) {
            words.fill(0);
            let words = if row == 0 {
                words[0] = u64::MAX >> (64 - columns.len());
                &mut words[1..]
            } else {
                &mut words[..]
            };
            for (values, place) in columns.iter().zip(0..) {
                let before = &values[row.saturating_sub(1)..];
                let bit = 1 << place;
                for ((word, before), value) in words.iter_mut().zip(before).zip(&before[1..]) {
                    let is_same = before.to_bits() == value.to_bits();
                    *word |= if is_same { 0 } else { bit };
                }
            }
        }
    }
}

/// The texts of numbers, with a comma before each.
struct Cells(Vec<Cell>);

impl Cells {
    fn new() -> Self {
        Self(vec![Cell::of(0.0); KEPT])
    }

    /// Appends a comma and a fixed number of decimals without trailing zeros; the comma alone where there is no value.
    fn push(&mut self, table: &mut Vec<u8>, value: f64) {
        if value.abs() < LARGE {
            let cell = self.find(value);
            // As many bytes as a cell may have are sooner copied than just those of this one.
            let end = table.len() + cell.length;
            table.extend_from_slice(&cell.text);
            table.truncate(end);
            return;
        }
        table.push(b',');
        if !value.is_nan() {
            // So large that no decimal is known.
            table.extend_from_slice(value.to_string().as_bytes());
        }
    }

    /// The cell of a number that is not large. Each has one place, where the latest of several stays.
    fn find(&mut self, value: f64) -> &Cell {
        /// Spreads neighbouring numbers over the places.
        const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "as many bits as there are places"
        )]
        let place = (value.to_bits().wrapping_mul(SPREAD) >> (64 - KEPT.ilog2())) as usize;
        let cell = &mut self.0[place % KEPT];
        if cell.bits != value.to_bits() {
            *cell = Cell::of(value);
        }
        cell
    }
}

/// The text of one number.
#[derive(Clone, Copy)]
struct Cell {
    /// The number.
    bits: u64,
    text: [u8; CELL],
    /// The bytes of it that count.
    length: usize,
}

impl Cell {
    /// Of a number that is not large.
    fn of(value: f64) -> Self {
        let scaled = value.abs() * f64::from(SCALE) + 0.5;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "below 2^53, and rounded down on purpose"
        )]
        let (whole, decimals) = {
            // By way of a signed number, which the processor has an instruction for.
            let scaled = scaled as i64 as u64;
            (
                scaled / u64::from(SCALE),
                (scaled % u64::from(SCALE)) as u32,
            )
        };
        let mut text = [b'.'; POINT + CELL];
        // One digit more than there are, since an even number of them is written.
        let digits = digits::eight(10 * decimals);
        text[POINT + 1..CELL].copy_from_slice(&digits);
        let mut first = digits::put(&mut text[..POINT], whole);
        if value.is_sign_negative() && (whole, decimals) != (0, 0) {
            first -= 1;
            text[first] = b'-';
        }
        first -= 1;
        text[first] = b',';
        let end = if decimals > 0 {
            CELL - zeros_behind(digits)
        } else {
            POINT
        };
        let mut cell = Self {
            bits: value.to_bits(),
            text: [0; CELL],
            length: end - first,
        };
        cell.text.copy_from_slice(&text[first..first + CELL]);
        cell
    }
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
        Cells::new().push(&mut text, value);
        let text = String::from_utf8(text).unwrap();
        text.strip_prefix(',').unwrap().to_owned()
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
