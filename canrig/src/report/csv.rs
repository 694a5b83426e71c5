//! `signals.csv`: one row a cycle.

use crate::timeline::Timeline;

/// Decimals of a number: one more than the finest signal has.
const DECIMALS: usize = 7;

/// The table as bytes.
///
/// # Errors
/// A row cannot be written; into memory that does not happen.
pub fn to_csv(timeline: &Timeline) -> csv::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let fixed = ["cycle", "time_seconds", "set_point_millimetres"];
    let names = timeline.columns.iter().map(|column| column.name.as_str());
    writer.write_record(fixed.into_iter().chain(names))?;
    for (row, cycle) in timeline.cycle.iter().enumerate() {
        writer.write_field(cycle.to_string())?;
        writer.write_field(number(timeline.time_seconds[row]))?;
        writer.write_field(number(timeline.set_point_millimetres[row]))?;
        for column in &timeline.columns {
            writer.write_field(number(column.values[row]))?;
        }
        writer.write_record(None::<&[u8]>)?;
    }
    writer
        .into_inner()
        .map_err(|error| error.into_error().into())
}

/// A fixed number of decimals without trailing zeros; empty where there is no value.
fn number(value: f64) -> String {
    if value.is_nan() {
        return String::new();
    }
    let text = format!("{value:.DECIMALS$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_exact() {
        let texts = [
            0.0,
            -0.0,
            1.0,
            0.1 + 0.2,
            12.345_678_9,
            -1e-9,
            f64::NAN,
            100.0,
        ]
        .map(number);
        assert_eq!(texts, ["0", "0", "1", "0.3", "12.3456789", "0", "", "100"]);
    }
}
