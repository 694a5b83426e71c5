//! `run.rrd` as a place where the SDK sends a recording.

use std::fs::File;
use std::io::BufWriter;
use std::mem;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rerun::external::re_log_encoding::{EncodeError, Encoder, EncodingOptions};
use rerun::log::LogMsg;
use rerun::sink::{LogSink, SinkFlushError};

/// Most of the messages are far shorter, and are handed on together.
const BUFFER_BYTES: usize = 64 * 1024;

/// A recording on its way to the disk. It is not compressed: that would halve it, and was the dearest single part of a
/// whole simulation.
#[derive(Clone)]
pub(super) struct RecordingFile(Arc<Mutex<Output>>);

struct Output {
    encoder: Encoder<BufWriter<File>>,
    /// What went wrong first; nothing is written after it.
    outcome: Result<(), EncodeError>,
}

impl RecordingFile {
    pub(super) fn create(path: &Path) -> Result<Self, EncodeError> {
        let version = rerun::build_info().version;
        let options = EncodingOptions::PROTOBUF_UNCOMPRESSED;
        let file = BufWriter::with_capacity(BUFFER_BYTES, File::create(path)?);
        let encoder = Encoder::new_eager(version, options, file)?;
        let output = Output {
            encoder,
            outcome: Ok(()),
        };
        Ok(Self(Arc::new(Mutex::new(output))))
    }

    /// Writes the table of contents, once the SDK has sent everything.
    pub(super) fn finish(&self) -> Result<(), EncodeError> {
        let mut output = self.output();
        mem::replace(&mut output.outcome, Ok(()))?;
        output.encoder.finish()?;
        output.encoder.flush_blocking()
    }

    fn output(&self) -> MutexGuard<'_, Output> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LogSink for RecordingFile {
    fn send(&self, message: LogMsg) {
        let mut output = self.output();
        if output.outcome.is_ok() {
            output.outcome = output.encoder.append(&message).map(|_| ());
        }
    }

    fn flush_blocking(&self, _timeout: Duration) -> Result<(), SinkFlushError> {
        Ok(())
    }
}
