//! `run.rrd` as a place where a recording goes.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use rerun::external::re_log_encoding::{EncodeError, Encoder, EncodingOptions};
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg, SetStoreInfo, StoreInfo};
use rerun::log::{Chunk, RowId};

use super::output::Output;

/// Most of the messages are far shorter, and are handed on together.
const BUFFER_BYTES: usize = 64 * 1024;

/// A recording on its way to the disk. It is not compressed: that would halve it, and was the dearest single part of a
/// whole simulation. Nor does a stream of the SDK lie between, whose threads and queues serve those who may not wait.
pub(super) struct RecordingFile {
    info: StoreInfo,
    encoder: Encoder<BufWriter<File>>,
    /// What went wrong first; nothing is written after it.
    outcome: Result<(), EncodeError>,
}

impl RecordingFile {
    pub(super) fn create(path: &Path, info: StoreInfo) -> Result<Self, EncodeError> {
        let version = rerun::build_info().version;
        let options = EncodingOptions::PROTOBUF_UNCOMPRESSED;
        let file = BufWriter::with_capacity(BUFFER_BYTES, File::create(path)?);
        let mut file = Self {
            info: info.clone(),
            encoder: Encoder::new_eager(version, options, file)?,
            outcome: Ok(()),
        };
        let row_id = *RowId::new();
        file.write(&SetStoreInfo { row_id, info }.into());
        Ok(file)
    }

    /// Writes the table of contents.
    pub(super) fn finish(mut self) -> Result<(), EncodeError> {
        self.outcome?;
        self.encoder.finish()?;
        self.encoder.flush_blocking()
    }

    fn write(&mut self, message: &LogMsg) {
        if self.outcome.is_ok() {
            self.outcome = self.encoder.append(message).map(|_| ());
        }
    }
}

impl Output for RecordingFile {
    fn info(&self) -> Option<StoreInfo> {
        Some(self.info.clone())
    }

    fn send(&mut self, chunk: Chunk) {
        match chunk.to_arrow_msg() {
            Ok(message) => self.write(&LogMsg::ArrowMsg(self.info.store_id.clone(), message)),
            Err(error) if self.outcome.is_ok() => self.outcome = Err(error.into()),
            Err(_) => {}
        }
    }

    fn send_layout(&mut self, layout: Vec<LogMsg>, show: BlueprintActivationCommand) {
        layout.iter().for_each(|message| self.write(message));
        self.write(&show.into());
    }
}
