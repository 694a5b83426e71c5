//! Many rows of one entity at once.

use std::iter;

use rerun::log::{Chunk, ChunkId, RowId};
use rerun::{
    EntityPath, RecordingStream, RecordingStreamError, SerializedComponentColumn, TimeColumn,
};

/// Sends rows with their times. The SDK would sort them first, although nearly all are in the order of time already.
pub(super) fn send(
    stream: &RecordingStream,
    path: impl Into<EntityPath>,
    times: [TimeColumn; 2],
    columns: impl IntoIterator<Item = SerializedComponentColumn>,
) -> Result<(), RecordingStreamError> {
    if !times.iter().all(TimeColumn::is_sorted) {
        return stream.send_columns(path, times, columns);
    }
    let rows = iter::successors(Some(RowId::new()), |row| Some(row.next()));
    let rows: Vec<RowId> = rows.take(times[0].num_rows()).collect();
    let timelines = times.map(|times| (*times.timeline().name(), times));
    let chunk = Chunk::from_native_row_ids(
        ChunkId::new(),
        path.into(),
        Some(true),
        &rows,
        timelines.into_iter().collect(),
        columns.into_iter().collect(),
    )?;
    stream.send_chunk(chunk);
    Ok(())
}
