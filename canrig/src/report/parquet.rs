//! The signals as Apache Parquet, for data frames (pandas, Polars, DuckDB): one row a cycle, the columns of `signals.csv`.

use std::sync::Arc;

use parquet::basic::{Repetition, Type as Physical};
use parquet::data_type::{DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use crate::timeline::Timeline;

/// The file as bytes: `cycle` as a whole number, everything else as double, null where there is no value.
///
/// # Errors
/// The library refuses.
pub fn to_parquet(timeline: &Timeline) -> Result<Vec<u8>, ParquetError> {
    let own = [
        ("time_seconds", &timeline.time_seconds),
        ("set_point_millimetres", &timeline.set_point_millimetres),
    ];
    let signals = timeline
        .columns
        .iter()
        .map(|column| (column.name.as_str(), &column.values));
    let columns: Vec<(&str, &Vec<f64>)> = own.into_iter().chain(signals).collect();
    let properties = WriterProperties::builder()
        .set_created_by(concat!("canrig ", env!("CARGO_PKG_VERSION")).to_owned())
        .build();
    let schema = schema(columns.iter().map(|(name, _)| *name))?;
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut rows = writer.next_row_group()?;
    write_cycles(&mut rows, &timeline.cycle)?;
    for (_, values) in columns {
        write_values(&mut rows, values)?;
    }
    rows.close()?;
    writer.into_inner()
}

fn schema<'a>(names: impl Iterator<Item = &'a str>) -> Result<TypePtr, ParquetError> {
    let cycle = Type::primitive_type_builder("cycle", Physical::INT64)
        .with_repetition(Repetition::REQUIRED)
        .build()
        .map(Arc::new);
    let values = names.map(|name| {
        Type::primitive_type_builder(name, Physical::DOUBLE)
            .with_repetition(Repetition::OPTIONAL)
            .build()
            .map(Arc::new)
    });
    let fields = std::iter::once(cycle).chain(values);
    Type::group_type_builder("signals")
        .with_fields(fields.collect::<Result<_, _>>()?)
        .build()
        .map(Arc::new)
}

type Rows<'a> = SerializedRowGroupWriter<'a, Vec<u8>>;

fn write_cycles(rows: &mut Rows<'_>, cycles: &[u64]) -> Result<(), ParquetError> {
    let cycles: Vec<i64> = cycles
        .iter()
        .map(|cycle| i64::try_from(*cycle).unwrap_or(i64::MAX))
        .collect();
    if let Some(mut column) = rows.next_column()? {
        column
            .typed::<Int64Type>()
            .write_batch(&cycles, None, None)?;
        column.close()?;
    }
    Ok(())
}

/// A value that is there has the level 1, one that is not 0.
fn write_values(rows: &mut Rows<'_>, values: &[f64]) -> Result<(), ParquetError> {
    let levels: Vec<i16> = values
        .iter()
        .map(|value| i16::from(!value.is_nan()))
        .collect();
    let there: Vec<f64> = values
        .iter()
        .copied()
        .filter(|value| !value.is_nan())
        .collect();
    if let Some(mut column) = rows.next_column()? {
        column
            .typed::<DoubleType>()
            .write_batch(&there, Some(&levels), None)?;
        column.close()?;
    }
    Ok(())
}
