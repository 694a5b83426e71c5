//! Outputs of a recording, which take chunks: rows of one entity.

use plan::ControlLoop;
use re_sdk::external::re_log_types::{SetStoreInfo, StoreInfo};
use re_sdk::log::{Chunk, ChunkId, LogMsg, RowId, TimeColumn};
use re_sdk::{
    AsComponents, EntityPath, RecordingStream, SerializedComponentColumn, StoreId, TimePoint,
};
use re_sdk_types::archetypes::{Points2D, Scalars};
use re_sdk_types::components::Radius;

use super::{APPLICATION, ReportError};

/// Output of a recording: a file or a viewer.
pub(crate) trait Output {
    /// Writes rows of one entity of the recording.
    fn send(&mut self, chunk: Chunk) -> Result<(), ReportError>;

    /// Writes a message that does not belong to the recording itself.
    fn send_message(&mut self, message: LogMsg) -> Result<(), ReportError>;
}

impl Output for RecordingStream {
    fn send(&mut self, chunk: Chunk) -> Result<(), ReportError> {
        self.send_chunk(chunk);
        Ok(())
    }

    fn send_message(&mut self, message: LogMsg) -> Result<(), ReportError> {
        self.record_msg(message);
        Ok(())
    }
}

/// Output for a loop, whose entities are in a folder with the loop's name if there are several.
pub(super) struct Folder<'a> {
    output: &'a mut dyn Output,
    folder: EntityPath,
}

impl<'a> Folder<'a> {
    /// Returns the output of a loop.
    pub(super) fn for_loop(output: &'a mut dyn Output, control_loop: &ControlLoop) -> Self {
        let folder = control_loop.name().into();
        Self { output, folder }
    }
}

impl Output for Folder<'_> {
    fn send(&mut self, chunk: Chunk) -> Result<(), ReportError> {
        let path = self.folder.join(chunk.entity_path());
        self.output.send(chunk.clone_with_new_entity_path(path))
    }

    fn send_message(&mut self, message: LogMsg) -> Result<(), ReportError> {
        self.output.send_message(message)
    }
}

/// Returns the first message of a recording or a layout.
pub(super) fn begin(store_id: StoreId) -> LogMsg {
    let info = StoreInfo {
        store_id,
        ..re_sdk::new_store_info(APPLICATION)
    };
    let row_id = *RowId::new();
    SetStoreInfo { row_id, info }.into()
}

/// Sends the constant properties of an entity.
pub(super) fn send_static(
    output: &mut dyn Output,
    path: impl Into<EntityPath>,
    what: &dyn AsComponents,
) -> Result<(), ReportError> {
    let chunk = Chunk::builder(path).with_archetype_auto_row(TimePoint::default(), what);
    output.send(chunk.build()?)
}

/// Sends rows of one number each, if there are any.
pub(super) fn send_scalars(
    output: &mut dyn Output,
    path: impl Into<EntityPath>,
    times: [TimeColumn; 2],
    values: Vec<f64>,
) -> Result<(), ReportError> {
    if values.is_empty() {
        return Ok(());
    }
    let columns = Scalars::new(values).columns_of_unit_batches()?;
    send_rows(output, path, times, columns)
}

/// Sends rows with their times.
pub(super) fn send_rows(
    output: &mut dyn Output,
    path: impl Into<EntityPath>,
    times: [TimeColumn; 2],
    columns: impl IntoIterator<Item = SerializedComponentColumn>,
) -> Result<(), ReportError> {
    let times = times
        .map(|times| (*times.timeline().name(), times))
        .into_iter()
        .collect();
    let columns = columns.into_iter().collect();
    let chunk = Chunk::from_auto_row_ids(ChunkId::new(), path.into(), times, columns)?;
    output.send(chunk)
}

/// Sends the look of a point that moves with time.
pub(super) fn send_look(
    output: &mut dyn Output,
    path: &str,
    colour: [u8; 3],
) -> Result<(), ReportError> {
    let look = Points2D::update_fields()
        .with_colors([colour])
        .with_radii([Radius::new_ui_points(5.0)]);
    send_static(output, path, &look)
}
