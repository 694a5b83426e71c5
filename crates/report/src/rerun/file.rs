//! `run.rrd` as an output of a recording.

use std::fs::File;
use std::io::BufWriter;

use re_sdk::StoreId;
use re_sdk::external::re_log_encoding::{Encoder, EncodingOptions};
use re_sdk::log::{Chunk, LogMsg};

use super::ReportError;
use super::output::{Output, begin};

/// Writer of a recording to the disk. It does not compress: compression would halve the file, and would cost more than all other
/// parts of it. It does not use a stream of the SDK, whose threads and queues serve callers that may not wait.
pub(super) struct RecordingFile {
    store: StoreId,
    encoder: Encoder<BufWriter<File>>,
}

impl RecordingFile {
    /// Begins a file with the id of its recording only.
    pub(super) fn begin(file: File, store: StoreId) -> Result<Self, ReportError> {
        let file = BufWriter::new(file);
        let version = re_sdk::build_info().version;
        let options = EncodingOptions::PROTOBUF_UNCOMPRESSED;
        let mut encoder = Encoder::new_eager(version, options, file)?;
        encoder.append(&begin(store.clone()))?;
        Ok(Self { store, encoder })
    }

    /// Writes the table of contents, which is the end of the file.
    pub(super) fn finish(mut self) -> Result<(), ReportError> {
        self.encoder.finish()?;
        Ok(self.encoder.flush_blocking()?)
    }
}

impl Output for RecordingFile {
    fn send(&mut self, chunk: Chunk) -> Result<(), ReportError> {
        let rows = chunk.to_arrow_msg()?;
        self.send_message(LogMsg::ArrowMsg(self.store.clone(), rows))
    }

    fn send_message(&mut self, message: LogMsg) -> Result<(), ReportError> {
        self.encoder.append(&message)?;
        Ok(())
    }
}
