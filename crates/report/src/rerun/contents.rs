//! The table of contents of `run.rrd`: where each chunk lies, and what is in it.
//!
//! The SDK makes the same table of chunks that were already taken apart: it puts each together again, and encodes what
//! all columns are called twice, the first time to hash it.

use std::collections::BTreeMap;
use std::sync::Arc;

use re_protos::common::v1alpha1::{Compression, DataframePart, EncoderVersion, Schema};
use re_protos::log_msg::v1alpha1::RrdManifest;
use re_sorbet::{
    BatchType, ComponentColumnDescriptor, IndexColumnDescriptor, RowIdColumnDescriptor,
};
use re_span::Span;
use rerun::external::arrow::array::{
    Array, ArrayRef, BooleanArray, FixedSizeBinaryArray, RecordBatch, StringArray, UInt64Array,
};
use rerun::external::arrow::buffer::Buffer;
use rerun::external::arrow::datatypes::{self as arrow, Field};
use rerun::external::arrow::error::ArrowError;
use rerun::external::arrow::ipc::writer::StreamWriter;
use rerun::external::re_log_encoding::RawRrdManifest;
use rerun::external::re_log_types::{AbsoluteTimeRange, EntityPathHash, StoreId, TimeInt};
use rerun::log::{Chunk, ChunkId};
use rerun::time::Timeline;
use rerun::{ComponentDescriptor, ComponentIdentifier, EntityPath, TimelineName};
use sha2::{Digest, Sha256};

use super::fields::component_column;

/// A column of the table.
type Column = (Field, ArrayRef);

/// What lies where, of a recording or of its layout.
#[derive(Default)]
pub(super) struct Contents {
    chunks: Vec<Entry>,
    /// All columns of all entities.
    columns: BTreeMap<(EntityPathHash, ComponentIdentifier), ComponentColumnDescriptor>,
    /// The static chunks of each component, by their numbers.
    statics: BTreeMap<ComponentDescriptor, Vec<usize>>,
    timelines: BTreeMap<TimelineName, Ranges>,
    components: BTreeMap<(TimelineName, ComponentDescriptor), Ranges>,
}

/// A chunk.
struct Entry {
    id: ChunkId,
    path: EntityPath,
    is_static: bool,
    rows: usize,
    place: Span<u64>,
    payload_bytes: u64,
}

/// What of a timeline is in which chunk.
struct Ranges {
    timeline: Timeline,
    ranges: Vec<Range>,
}

struct Range {
    /// Its number.
    chunk: usize,
    times: AbsoluteTimeRange,
    rows: usize,
}

impl Contents {
    /// Takes the next chunk.
    pub(super) fn append(&mut self, chunk: &Chunk, place: Span<u64>, payload_bytes: u64) {
        self.append_columns(chunk);
        if chunk.is_static() {
            for component in chunk.component_descriptors() {
                let chunks = self.statics.entry(component.clone()).or_default();
                chunks.push(self.chunks.len());
            }
        } else {
            self.append_ranges(chunk);
        }
        self.chunks.push(Entry {
            id: chunk.id(),
            path: chunk.entity_path().clone(),
            is_static: chunk.is_static(),
            rows: chunk.num_rows(),
            place,
            payload_bytes,
        });
    }

    /// A column is static when it is so anywhere, and empty when it is so everywhere. None is ever cleared.
    fn append_columns(&mut self, chunk: &Chunk) {
        for (component, column) in chunk.components().iter() {
            let is_empty = column.list_array.values().is_empty();
            let path = chunk.entity_path();
            let known = self.columns.entry((path.hash(), *component));
            let known = known.or_insert_with(|| ComponentColumnDescriptor {
                is_semantically_empty: true,
                ..component_column(path.clone(), column)
            });
            known.is_static |= chunk.is_static();
            known.is_semantically_empty &= is_empty;
        }
    }

    fn append_ranges(&mut self, chunk: &Chunk) {
        for (name, column) in chunk.timelines() {
            let none = || Ranges {
                timeline: *column.timeline(),
                ranges: Vec::new(),
            };
            let range = |times, rows| Range {
                chunk: self.chunks.len(),
                times,
                rows,
            };
            let timeline = self.timelines.entry(*name).or_insert_with(none);
            timeline.ranges.push(range(column.time_range(), 0));
            let times = column.time_range_per_component(chunk.components());
            for (component, column) in chunk.components().iter() {
                let Some(times) = times.get(component) else {
                    continue;
                };
                let component = &column.descriptor;
                // It has a column for what is static of it all the same.
                self.statics.entry(component.clone()).or_default();
                let key = (*name, component.clone());
                let rows = column.list_array.len() - column.list_array.null_count();
                let ranges = self.components.entry(key).or_insert_with(none);
                ranges.ranges.push(range(*times, rows));
            }
        }
    }

    /// The table as it is written.
    pub(super) fn manifest(self, store: StoreId) -> Result<RrdManifest, ArrowError> {
        let (schema, hash) = self.schema()?;
        let data = DataframePart {
            encoder_version: EncoderVersion::V0.into(),
            payload: Some(self.encoded()?.into()),
            compression: Compression::None.into(),
            ..DataframePart::default()
        };
        Ok(RrdManifest {
            store_id: Some(store.into()),
            sorbet_schema: Some(schema),
            sorbet_schema_sha256: Some(hash.into()),
            data: Some(data),
        })
    }

    /// All columns of all entities, and the hash of them in order.
    fn schema(&self) -> Result<(Schema, Vec<u8>), ArrowError> {
        let row_id = RowIdColumnDescriptor::from_sorted(false).to_arrow_field();
        let timelines = self.timelines.values();
        let times = timelines.map(|it| IndexColumnDescriptor::from(it.timeline).to_arrow_field());
        let components = self.columns.values();
        let components = components.map(|column| column.to_arrow_field(BatchType::Dataframe));
        let mut fields: Vec<Field> = [row_id]
            .into_iter()
            .chain(times)
            .chain(components)
            .collect();
        fields.sort();
        let stream = StreamWriter::try_new(Vec::new(), &arrow::Schema::new(fields))?;
        // The end of the stream is not hashed.
        let hash = Sha256::digest(stream.get_ref()).to_vec();
        let schema = Schema {
            arrow_schema: Some(stream.into_inner()?.into()),
        };
        Ok((schema, hash))
    }

    fn encoded(&self) -> Result<Vec<u8>, ArrowError> {
        let columns = self.chunk_columns().into_iter();
        let columns = columns
            .chain(self.static_columns())
            .chain(self.range_columns());
        let (fields, arrays): (Vec<_>, Vec<_>) = columns.unzip();
        let schema = Arc::new(arrow::Schema::new(fields));
        let table = RecordBatch::try_new(Arc::clone(&schema), arrays)?;
        let mut stream = StreamWriter::try_new(Vec::new(), &schema)?;
        stream.write(&table)?;
        stream.into_inner()
    }

    fn chunk_columns(&self) -> [Column; 7] {
        let chunks = || self.chunks.iter();
        let numbers = |number: fn(&Entry) -> u64| -> ArrayRef {
            Arc::new(UInt64Array::from_iter_values(chunks().map(number)))
        };
        let paths = StringArray::from_iter_values(chunks().map(|chunk| chunk.path.to_string()));
        let ids: Vec<[u8; 16]> = chunks()
            .map(|chunk| chunk.id.as_u128().to_be_bytes())
            .collect();
        let ids = FixedSizeBinaryArray::new(16, Buffer::from_vec(ids.into_flattened()), None);
        let statics: Vec<bool> = chunks().map(|chunk| chunk.is_static).collect();
        [
            (RawRrdManifest::field_chunk_entity_path(), Arc::new(paths)),
            (RawRrdManifest::field_chunk_id(), Arc::new(ids)),
            (
                RawRrdManifest::field_chunk_is_static(),
                Arc::new(BooleanArray::from(statics)),
            ),
            (
                RawRrdManifest::field_chunk_num_rows(),
                numbers(|chunk| chunk.rows as u64),
            ),
            (
                RawRrdManifest::field_chunk_byte_offset(),
                numbers(|chunk| chunk.place.start),
            ),
            (
                RawRrdManifest::field_chunk_byte_size(),
                numbers(|chunk| chunk.place.len),
            ),
            (
                RawRrdManifest::field_chunk_byte_size_uncompressed(),
                numbers(|chunk| chunk.payload_bytes),
            ),
        ]
    }

    /// Of each component, in which chunks it is static.
    fn static_columns(&self) -> impl Iterator<Item = Column> {
        self.statics.iter().map(|(component, chunks)| {
            let mut is_there = vec![false; self.chunks.len()];
            chunks.iter().for_each(|&chunk| is_there[chunk] = true);
            let field = RawRrdManifest::field_has_static_data(component);
            let column: ArrayRef = Arc::new(BooleanArray::from(is_there));
            (field, column)
        })
    }

    /// Of each timeline, and of each component on it, from when until when it goes in which chunks.
    fn range_columns(&self) -> impl Iterator<Item = Column> {
        let count = self.chunks.len();
        let timelines = self.timelines.values();
        let timelines = timelines.flat_map(move |ranges| ranges.bounds(None, count));
        let components = self.components.iter();
        let components = components.flat_map(move |((_, component), ranges)| {
            let bounds = ranges.bounds(Some(component), count);
            bounds.into_iter().chain([ranges.rows(component, count)])
        });
        timelines.chain(components)
    }
}

impl Ranges {
    /// The first and the last times, of so many chunks.
    fn bounds(&self, component: Option<&ComponentDescriptor>, count: usize) -> [Column; 2] {
        let bounds = |bound: fn(&AbsoluteTimeRange) -> TimeInt| {
            let mut times = vec![TimeInt::STATIC; count];
            for range in &self.ranges {
                times[range.chunk] = bound(&range.times);
            }
            let times = times.into_iter();
            self.timeline.typ().make_arrow_array_from_time_ints(times)
        };
        let start = RawRrdManifest::field_index_start(&self.timeline, component);
        let end = RawRrdManifest::field_index_end(&self.timeline, component);
        [
            (start, bounds(AbsoluteTimeRange::min)),
            (end, bounds(AbsoluteTimeRange::max)),
        ]
    }

    /// How many rows there are, of so many chunks.
    fn rows(&self, component: &ComponentDescriptor, count: usize) -> Column {
        let mut rows = vec![0; count];
        for range in &self.ranges {
            rows[range.chunk] = range.rows as u64;
        }
        let field = RawRrdManifest::field_index_num_rows(&self.timeline, Some(component));
        (field, Arc::new(UInt64Array::from(rows)))
    }
}
