//! Tables as Apache Parquet, for data frames (pandas, Polars, DuckDB).

use std::borrow::Cow;
use std::io::Write;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use recording::timeline::{self, Timeline, blocks};
use recording::work::Way;

pub use parquet::errors::ParquetError;

/// Cells of a column.
pub enum Cells<'a> {
    /// Whole numbers, none of them absent.
    Count(Vec<i64>),
    /// Whole numbers; `None` becomes null.
    Whole(Vec<Option<i64>>),
    /// Numbers; NaN becomes null.
    Number(Cow<'a, [f64]>),
    /// Texts; `None` becomes null.
    Text(Vec<Option<String>>),
}

/// Type of a column.
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

/// Table that is written row group by row group.
pub struct ParquetTable<W: Write + Send>(SerializedFileWriter<W>);

impl<W: Write + Send> ParquetTable<W> {
    /// Makes a table with columns and no rows.
    pub fn new(
        output: W,
        name: &str,
        columns: &[(&str, ColumnKind)],
    ) -> Result<Self, ParquetError> {
        let properties = WriterProperties::builder()
            .set_created_by(concat!("canrig ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .set_offset_index_disabled(true)
            .build();
        let schema = schema(name, columns)?;
        let writer = SerializedFileWriter::new(output, schema, Arc::new(properties))?;
        Ok(Self(writer))
    }

    /// Appends rows, given by their columns in the table's order; each column is requested after the one before is written.
    pub fn write<'a>(
        &mut self,
        columns: impl IntoIterator<Item = Cells<'a>>,
    ) -> Result<(), ParquetError> {
        let mut rows = self.0.next_row_group()?;
        for cells in columns {
            match cells {
                Cells::Count(cells) => {
                    write_column::<Int64Type, W, _>(&mut rows, &cells, |cell| Some(*cell))?
                }
                Cells::Whole(cells) => {
                    write_column::<Int64Type, W, _>(&mut rows, &cells, |cell| *cell)?
                }
                Cells::Number(cells) => {
                    write_column::<DoubleType, W, _>(&mut rows, &cells, |value| {
                        (!value.is_nan()).then_some(*value)
                    })?
                }
                Cells::Text(cells) => {
                    write_column::<ByteArrayType, W, _>(&mut rows, &cells, |text| {
                        text.as_ref()
                            .map(|text| ByteArray::from(text.as_bytes().to_vec()))
                    })?
                }
            }
        }
        rows.close().map(|_| ())
    }

    /// Writes the end of the file.
    pub fn finish(self) -> Result<W, ParquetError> {
        self.0.into_inner()
    }
}

/// Rows of a run between two places at which a reader can begin. The writer holds the metadata of each group to the end of the
/// file, so ten hours have few groups.
const GROUP_ROWS: usize = 1 << 20;

/// Writes the signals: one row a cycle, the columns of `signals.csv`.
///
/// # Errors
/// If the library or the output refuses.
pub fn write_signals(
    output: impl Write + Send,
    timelines: &[Timeline],
) -> Result<(), ParquetError> {
    let Some(timeline) = timelines.first() else {
        return Ok(());
    };
    let signals = timeline::signals(timelines);
    let time = ("time_seconds", &*timeline.time_seconds);
    let signals = signals
        .iter()
        .map(|signal| (signal.name.as_str(), &**signal.values));
    let numbers: Vec<(&str, &[f64])> = [time].into_iter().chain(signals).collect();
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
        let cycles = timeline.cycle.range(group.clone());
        let cycles = cycles.map(|cycle| i64::try_from(*cycle).unwrap_or(i64::MAX));
        let cycles = Cells::Count(cycles.collect());
        let numbers = numbers.iter();
        let numbers = numbers.map(|(_, values)| Cells::Number(values[group.clone()].into()));
        table.write([cycles].into_iter().chain(numbers))?;
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

/// Writes a column. A present value has the level 1, a missing one 0; a column without missing values has no levels.
fn write_column<T: DataType, W: Write + Send, C>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    cells: &[C],
    value: impl Fn(&C) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let Some(mut column) = rows.next_column()? else {
        return Ok(());
    };
    let mut levels = Vec::new();
    let mut there = Vec::new();
    for piece in blocks(cells) {
        levels.clear();
        there.clear();
        for cell in piece.iter().map(&value) {
            levels.push(i16::from(cell.is_some()));
            there.extend(cell);
        }
        column
            .typed::<T>()
            .write_batch(&there, Some(&levels), None)?;
    }
    column.close()
}
