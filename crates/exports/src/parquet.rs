//! Tables as Apache Parquet, for data frames (pandas, Polars, DuckDB).

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use recording::timeline::{self, Series, Timeline};
use recording::work::Pass;

pub use parquet::errors::ParquetError;

/// Cells of a column.
pub enum Cells {
    /// Whole numbers, none of them absent.
    Count(Series<u64>),
    /// Whole numbers; `None` becomes null.
    Whole(Vec<Option<i64>>),
    /// Numbers; NaN becomes null.
    Number(Series<f64>),
    /// Texts; `None` becomes null.
    Text(Vec<Option<String>>),
}

/// Table that is written row group by row group.
pub struct ParquetTable<W: Write + Send>(SerializedFileWriter<W>);

impl<W: Write + Send> ParquetTable<W> {
    /// Makes a table with the names and types of these columns, and no rows: the cells themselves are not written.
    pub fn new(output: W, name: &str, columns: &[(&str, Cells)]) -> Result<Self, ParquetError> {
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
    pub fn write(&mut self, columns: impl IntoIterator<Item = Cells>) -> Result<(), ParquetError> {
        let mut rows = self.0.next_row_group()?;
        for cells in columns {
            match cells {
                Cells::Count(cells) => {
                    let whole = |cell| Some(i64::try_from(cell).unwrap_or(i64::MAX));
                    write_column::<Int64Type, W>(&mut rows, cells.iter().map(whole))?
                }
                Cells::Whole(cells) => write_column::<Int64Type, W>(&mut rows, cells.into_iter())?,
                Cells::Number(cells) => {
                    let number = |value: f64| (!value.is_nan()).then_some(value);
                    write_column::<DoubleType, W>(&mut rows, cells.iter().map(number))?
                }
                Cells::Text(cells) => {
                    let bytes = |text: String| ByteArray::from(text.into_bytes());
                    let texts = cells.into_iter().map(|text| text.map(bytes));
                    write_column::<ByteArrayType, W>(&mut rows, texts)?
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
/// Number of cells that are given to the library at once.
const BATCH_ROWS: usize = 1 << 13;

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
    let mut columns = vec![("cycle", Cells::Count(Series::default()))];
    let no_number = || Cells::Number(Series::default());
    columns.extend(signals.iter().map(|one| (one.name.as_str(), no_number())));
    let mut table = ParquetTable::new(output, "signals", &columns)?;
    let rows = timeline.cycle.len();
    let mut pass = Pass::new(rows as u64);
    for begin in (0..rows.max(1)).step_by(GROUP_ROWS) {
        let group = begin..rows.min(begin + GROUP_ROWS);
        pass.advance(group.len());
        let cycles = Cells::Count(timeline.cycle.part(group.clone()));
        let numbers = signals
            .iter()
            .map(|one| Cells::Number(one.values.part(group.clone())));
        table.write([cycles].into_iter().chain(numbers))?;
    }
    table.finish().map(drop)
}

fn schema(name: &str, columns: &[(&str, Cells)]) -> Result<TypePtr, ParquetError> {
    let fields = columns.iter().map(|(name, cells)| {
        let text = Some(LogicalType::String);
        let (physical, logical, repetition) = match cells {
            Cells::Count(_) => (Physical::INT64, None, Repetition::REQUIRED),
            Cells::Whole(_) => (Physical::INT64, None, Repetition::OPTIONAL),
            Cells::Number(_) => (Physical::DOUBLE, None, Repetition::OPTIONAL),
            Cells::Text(_) => (Physical::BYTE_ARRAY, text, Repetition::OPTIONAL),
        };
        Type::primitive_type_builder(name, physical)
            .with_repetition(repetition)
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
fn write_column<T: DataType, W: Write + Send>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    mut cells: impl ExactSizeIterator<Item = Option<T::T>>,
) -> Result<(), ParquetError> {
    let Some(mut column) = rows.next_column()? else {
        return Ok(());
    };
    let mut levels = Vec::new();
    let mut there = Vec::new();
    while cells.len() > 0 {
        levels.clear();
        there.clear();
        for cell in cells.by_ref().take(BATCH_ROWS) {
            levels.push(i16::from(cell.is_some()));
            there.extend(cell);
        }
        column
            .typed::<T>()
            .write_batch(&there, Some(&levels), None)?;
    }
    column.close()
}
