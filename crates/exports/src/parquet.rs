//! Tables as Apache Parquet, for data frames (pandas, Polars, DuckDB).

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use recording::timeline::Timeline;
use recording::work::Way;

pub use parquet::errors::ParquetError;

/// The cells of a column.
pub enum Cells {
    /// Whole numbers, none of them absent.
    Count(Vec<i64>),
    /// Whole numbers, null where there is none.
    Whole(Vec<Option<i64>>),
    /// Numbers, null where there is none (NaN).
    Number(Vec<f64>),
    /// Text, null where there is none.
    Text(Vec<Option<String>>),
}

/// What a column holds.
#[derive(Clone, Copy)]
pub enum ColumnKind {
    /// Whole numbers, in every row.
    Count,
    /// Whole numbers.
    Whole,
    /// Numbers.
    Number,
    /// Text.
    Text,
}

/// A table that is written group of rows by group of rows.
pub struct ParquetTable<W: Write + Send>(SerializedFileWriter<W>);

impl<W: Write + Send> ParquetTable<W> {
    /// A table with columns and no rows.
    pub fn new(
        output: W,
        name: &str,
        columns: &[(&str, ColumnKind)],
    ) -> Result<Self, ParquetError> {
        let properties = WriterProperties::builder()
            .set_created_by(concat!("canrig ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let schema = schema(name, columns)?;
        let writer = SerializedFileWriter::new(output, schema, Arc::new(properties))?;
        Ok(Self(writer))
    }

    /// Appends rows, given by their columns in the table's order.
    pub fn write(&mut self, columns: &[Cells]) -> Result<(), ParquetError> {
        let mut rows = self.0.next_row_group()?;
        for cells in columns {
            match cells {
                Cells::Count(cells) => write_values::<Int64Type, W>(&mut rows, cells, None)?,
                Cells::Whole(cells) => write_column::<Int64Type, W>(&mut rows, cells)?,
                Cells::Number(cells) => {
                    let cells: Vec<Option<f64>> = cells
                        .iter()
                        .map(|value| (!value.is_nan()).then_some(*value))
                        .collect();
                    write_column::<DoubleType, W>(&mut rows, &cells)?;
                }
                Cells::Text(cells) => {
                    let bytes = |text: &String| ByteArray::from(text.as_bytes().to_vec());
                    let cells: Vec<Option<ByteArray>> =
                        cells.iter().map(|text| text.as_ref().map(bytes)).collect();
                    write_column::<ByteArrayType, W>(&mut rows, &cells)?;
                }
            }
        }
        rows.close().map(|_| ())
    }

    /// Writes what ends the file.
    pub fn finish(self) -> Result<W, ParquetError> {
        self.0.into_inner()
    }
}

/// Rows of a run that are written at once.
const GROUP_ROWS: usize = 1 << 16;

/// Writes the signals: one row a cycle, the columns of `signals.csv`.
///
/// # Errors
/// The library or the output refuses.
pub fn write_signals(output: impl Write + Send, timeline: &Timeline) -> Result<(), ParquetError> {
    let own = [
        ("time_seconds", &*timeline.time_seconds),
        ("set_point_millimetres", &*timeline.set_point_millimetres),
    ];
    let signals = timeline
        .columns
        .iter()
        .map(|column| (column.name.as_str(), &*column.values));
    let numbers: Vec<(&str, &[f64])> = own.into_iter().chain(signals).collect();
    let names = numbers.iter().map(|(name, _)| (*name, ColumnKind::Number));
    let names: Vec<(&str, ColumnKind)> = [("cycle", ColumnKind::Count)]
        .into_iter()
        .chain(names)
        .collect();
    let mut table = ParquetTable::new(output, "signals", &names)?;
    let rows = timeline.cycle.len();
    let mut way = Way::new(rows as u64);
    for begin in (0..rows.max(1)).step_by(GROUP_ROWS) {
        let group = begin..rows.min(begin + GROUP_ROWS);
        way.go(group.len());
        let cycles = timeline.cycle[group.clone()].iter();
        let cycles = cycles.map(|cycle| i64::try_from(*cycle).unwrap_or(i64::MAX));
        let cycles = Cells::Count(cycles.collect());
        let numbers = numbers.iter();
        let numbers = numbers.map(|(_, values)| Cells::Number(values[group.clone()].to_vec()));
        table.write(&[cycles].into_iter().chain(numbers).collect::<Vec<_>>())?;
    }
    table.finish().map(drop)
}

fn schema(name: &str, columns: &[(&str, ColumnKind)]) -> Result<TypePtr, ParquetError> {
    let fields = columns.iter().map(|(name, kind)| {
        let (physical, logical) = match kind {
            ColumnKind::Count | ColumnKind::Whole => (Physical::INT64, None),
            ColumnKind::Number => (Physical::DOUBLE, None),
            ColumnKind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        Type::primitive_type_builder(name, physical)
            .with_repetition(match kind {
                ColumnKind::Count => Repetition::REQUIRED,
                ColumnKind::Whole | ColumnKind::Number | ColumnKind::Text => Repetition::OPTIONAL,
            })
            .with_logical_type(logical)
            .build()
            .map(Arc::new)
    });
    Type::group_type_builder(name)
        .with_fields(fields.collect::<Result<_, _>>()?)
        .build()
        .map(Arc::new)
}

/// A value that is there has the level 1, one that is not 0.
fn write_column<T: DataType, W: Write + Send>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    cells: &[Option<T::T>],
) -> Result<(), ParquetError> {
    let levels: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
    let there: Vec<T::T> = cells.iter().flatten().cloned().collect();
    write_values::<T, W>(rows, &there, Some(&levels))
}

fn write_values<T: DataType, W: Write + Send>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    values: &[T::T],
    levels: Option<&[i16]>,
) -> Result<(), ParquetError> {
    if let Some(mut column) = rows.next_column()? {
        column.typed::<T>().write_batch(values, levels, None)?;
        column.close()?;
    }
    Ok(())
}
