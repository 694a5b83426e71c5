//! Where a recording goes, in chunks: rows of one entity.

use std::sync::Arc;

use rerun::external::arrow::array::{FixedSizeBinaryArray, Float64Array, ListArray};
use rerun::external::arrow::buffer::{Buffer, OffsetBuffer};
use rerun::external::arrow::datatypes::{DataType, Field};
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg, SetStoreInfo, StoreInfo};
use rerun::log::{Chunk, ChunkId, RowId};
use rerun::{
    AsComponents, EntityPath, RecordingStream, RecordingStreamError, Scalars,
    SerializedComponentColumn, TimeColumn, TimePoint,
};

/// A file, or a viewer.
pub(crate) trait Output {
    /// Which recording it is; none when it goes nowhere.
    fn info(&self) -> Option<StoreInfo>;

    /// Takes rows of one entity.
    fn send(&mut self, chunk: Chunk);

    /// Takes a layout, and the command to show it.
    fn send_layout(
        &mut self,
        info: StoreInfo,
        layout: Vec<Chunk>,
        show: BlueprintActivationCommand,
    ) -> Result<(), RecordingStreamError>;
}

impl Output for RecordingStream {
    fn info(&self) -> Option<StoreInfo> {
        self.store_info()
    }

    fn send(&mut self, chunk: Chunk) {
        self.send_chunk(chunk);
    }

    fn send_layout(
        &mut self,
        info: StoreInfo,
        layout: Vec<Chunk>,
        show: BlueprintActivationCommand,
    ) -> Result<(), RecordingStreamError> {
        let store = info.store_id.clone();
        let mut messages = vec![begin(info)];
        for chunk in layout {
            messages.push(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg()?));
        }
        self.send_blueprint(messages, show);
        Ok(())
    }
}

/// The first message of a recording or a layout.
pub(super) fn begin(info: StoreInfo) -> LogMsg {
    let row_id = *RowId::new();
    SetStoreInfo { row_id, info }.into()
}

/// Sends what never changes of an entity.
pub(super) fn send_static(
    output: &mut impl Output,
    path: impl Into<EntityPath>,
    what: &dyn AsComponents,
) -> Result<(), RecordingStreamError> {
    let chunk = Chunk::builder(path).with_archetype_auto_row(TimePoint::default(), what);
    output.send(chunk.build()?);
    Ok(())
}

/// Sends rows of one number each. The SDK takes numbers one by one; here their array is the one that is written.
pub(super) fn send_scalars(
    output: &mut impl Output,
    path: impl Into<EntityPath>,
    times: [TimeColumn; 2],
    values: Vec<f64>,
) -> Result<(), RecordingStreamError> {
    let item = Field::new_list_field(DataType::Float64, true);
    let one_each = OffsetBuffer::from_repeated_length(1, values.len());
    let values = Arc::new(Float64Array::from(values));
    let rows = ListArray::new(Arc::new(item), one_each, values, None);
    let column = SerializedComponentColumn::new(rows, Scalars::descriptor_scalars());
    send_rows(output, path, times, [column])
}

/// Sends rows with their times. The SDK's constructors sort them first, although nearly all are in the order of time
/// already.
pub(super) fn send_rows(
    output: &mut impl Output,
    path: impl Into<EntityPath>,
    times: [TimeColumn; 2],
    columns: impl IntoIterator<Item = SerializedComponentColumn>,
) -> Result<(), RecordingStreamError> {
    let (id, path) = (ChunkId::new(), path.into());
    let is_in_order = times.iter().all(TimeColumn::is_sorted);
    let count = times[0].num_rows();
    let times = times.map(|times| (*times.timeline().name(), times));
    let times = times.into_iter().collect();
    let columns = columns.into_iter().collect();
    let chunk = if is_in_order {
        Chunk::new(id, path, Some(true), row_ids(count), times, columns)
    } else {
        Chunk::from_auto_row_ids(id, path, times, columns)
    };
    output.send(chunk?);
    Ok(())
}

/// Identifiers for so many rows, one after the other.
fn row_ids(count: usize) -> FixedSizeBinaryArray {
    let first = RowId::new().as_u128();
    let ids: Vec<[u8; 16]> = (first..).take(count).map(u128::to_be_bytes).collect();
    FixedSizeBinaryArray::new(16, Buffer::from_vec(ids.into_flattened()), None)
}
