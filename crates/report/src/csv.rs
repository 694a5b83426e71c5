//! `signals.csv`: one row for each cycle.

use std::io::{self, Write};

use recording::cell::heading;
use recording::timeline::{self, Timeline};
use recording::work::Pass;

/// Ten to the power of the decimals of a number: one more than the finest signal has.
const SCALE: f64 = 1e7;
/// Bound below which whole numbers are exact.
const EXACT_MAX: f64 = 9_007_199_254_740_992.0;

/// Writes the table of loops that were played at once to an output that has a buffer.
///
/// # Errors
/// The output fails.
pub fn write(mut output: impl Write, timelines: &[Timeline]) -> io::Result<()> {
    let Some(first) = timelines.first() else {
        return Ok(());
    };
    let signals = timeline::signals(timelines);
    let names = signals.iter().map(|signal| signal.name.as_str());
    writeln!(output, "{}", heading(["cycle"].into_iter().chain(names)))?;
    let columns = signals.iter().map(|signal| (signal.values.iter(), None));
    let mut columns = Vec::from_iter(columns);
    let mut cells = vec![String::new(); columns.len()];
    let mut row = String::new();
    let mut pass = Pass::new(first.cycle.len() as u64);
    for cycle in &first.cycle {
        pass.advance(1);
        row.clear();
        for (text, (values, before)) in cells.iter_mut().zip(&mut columns) {
            let value = values.next().expect("a value for each cycle");
            // Most values hold for many rows.
            if before.replace(value.to_bits()) != Some(value.to_bits()) {
                *text = cell(value);
            }
            row.push(',');
            row.push_str(text);
        }
        writeln!(output, "{cycle}{row}")?;
    }
    Ok(())
}

/// Writes a number with seven decimals, without trailing zeros; empty without a value.
fn cell(value: f64) -> String {
    if value.is_nan() {
        return String::new();
    }
    let scaled = (value * SCALE).round();
    // A larger number has no known decimals.
    let is_exact = scaled.abs() < EXACT_MAX;
    let shown = if is_exact { scaled / SCALE } else { value };
    // Adding 0 makes -0 a 0.
    (shown + 0.0).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn number(value: f64) -> String {
        cell(value)
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
        fn a_number_reads_back_to_half_of_the_last_decimal(value in -1e6..1e6_f64) {
            let read: f64 = number(value).parse().unwrap();
            prop_assert!((read - value).abs() <= 0.51e-7, "{value} {read}");
        }
    }
}
