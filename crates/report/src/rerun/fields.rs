//! Chunks as rows of Arrow.

use std::sync::Arc;

use re_sorbet::{
    BatchType, ColumnDescriptor, ComponentColumnDescriptor, IndexColumnDescriptor,
    RowIdColumnDescriptor, SorbetColumnDescriptors, SorbetSchema,
};
use rerun::external::arrow::array::{Array, ArrayRef, RecordBatch};
use rerun::external::arrow::datatypes::{FieldRef, Schema};
use rerun::external::arrow::error::ArrowError;
use rerun::log::Chunk;
use rerun::{EntityPath, SerializedComponentColumn};

#[expect(
    clippy::disallowed_types,
    reason = "only looked up; what orders columns does not see whether they are sorted"
)]
type Known = std::collections::HashMap<ColumnDescriptor, FieldRef>;

/// The fields of all columns so far. The SDK makes them anew for each chunk, although those of one signal are those of
/// the next.
#[derive(Default)]
pub(super) struct Fields(Known);

impl Fields {
    /// The rows of a chunk, with what the SDK says of them.
    pub(super) fn batch(&mut self, chunk: &Chunk) -> Result<RecordBatch, ArrowError> {
        let mut columns = columns(chunk);
        columns.sort_by(|(one, _), (other, _)| one.cmp(other));
        let columns = columns.into_iter();
        let (fields, arrays): (Vec<_>, Vec<_>) = columns
            .map(|(column, array)| (self.field(column), array))
            .unzip();
        let schema = Schema::new_with_metadata(fields, about(chunk).arrow_batch_metadata());
        RecordBatch::try_new(Arc::new(schema), arrays)
    }

    fn field(&mut self, column: ColumnDescriptor) -> FieldRef {
        let field = self.0.entry(column);
        let field =
            field.or_insert_with_key(|column| column.to_arrow_field(BatchType::Chunk).into());
        Arc::clone(field)
    }
}

/// What is said of a chunk as a whole.
fn about(chunk: &Chunk) -> SorbetSchema {
    SorbetSchema {
        columns: SorbetColumnDescriptors {
            columns: Vec::new(),
        },
        chunk_id: Some(chunk.id()),
        entity_path: Some(chunk.entity_path().clone()),
        segment_id: None,
        timestamps: Default::default(),
    }
}

fn columns(chunk: &Chunk) -> Vec<(ColumnDescriptor, ArrayRef)> {
    let row_id = RowIdColumnDescriptor::from_sorted(chunk.is_row_ids_sorted());
    let row_ids: ArrayRef = Arc::new(chunk.row_ids_array().clone());
    let times = chunk.timelines().values().map(|times| {
        let column = IndexColumnDescriptor::from_timeline(*times.timeline(), times.is_sorted());
        (ColumnDescriptor::Time(column), times.times_array())
    });
    // The field of a chunk's column does not say whose it is.
    let nobody = EntityPath::root();
    let components = chunk.components().values().map(|column| {
        let array: ArrayRef = Arc::new(column.list_array.clone());
        let column = component_column(nobody.clone(), column);
        (ColumnDescriptor::Component(column), array)
    });
    let row_ids = (ColumnDescriptor::RowId(row_id), row_ids);
    [row_ids]
        .into_iter()
        .chain(times)
        .chain(components)
        .collect()
}

/// Describes a column of an entity.
pub(super) fn component_column(
    entity_path: EntityPath,
    column: &SerializedComponentColumn,
) -> ComponentColumnDescriptor {
    let descriptor = &column.descriptor;
    ComponentColumnDescriptor {
        store_datatype: column.list_array.data_type().clone(),
        entity_path,
        archetype: descriptor.archetype,
        component: descriptor.component,
        component_type: descriptor.component_type,
        is_static: false,
        is_tombstone: false,
        is_semantically_empty: false,
    }
}
