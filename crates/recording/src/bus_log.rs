//! Log of a run in progress.

use std::fs::{File, Metadata};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use zstd::bulk::Compressor;
use zstd::zstd_safe::CParameter;

use crate::log::{OpenLog, Stamped, is_compressed};
use crate::write_error::WriteError;

/// Length of the pieces in which a run is compressed. A kill loses no more than one.
const PIECE: Duration = Duration::from_secs(1);
/// Number of flushes without a frame after which the open piece is compressed: a second of a silent bus.
const IDLE_FLUSHES_MAX: u32 = 50;
/// Compression level; a higher one takes longer and saves little.
const LEVEL: i32 = 3;

/// `bus.log`, or the compressed log of a long run: there each second is a piece that can be read without the others.
pub struct BusLog {
    /// Path of the log; `None` for a file without a name.
    path: Option<PathBuf>,
    file: File,
    compressor: Option<Compressor<'static>>,
    /// Lines that are not in the file yet: since the latest flush, or of the latest piece.
    text: String,
    /// Time of the first frame among them.
    since: Duration,
    /// Number of flushes since the latest frame.
    flushes: u32,
}

impl BusLog {
    /// Makes an empty log; its name decides whether it is compressed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create(path: PathBuf) -> Result<Self, WriteError> {
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(true);
        let file = options.open(&path);
        let log = file.and_then(|file| Self::new(file, is_compressed(&path)));
        Ok(Self {
            path: Some(path.clone()),
            ..log.map_err(WriteError::at(&path))?
        })
    }

    /// Makes an empty compressed log in a file without a name, which ends with the process.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn without_name() -> Result<Self, WriteError> {
        let log = tempfile::tempfile().and_then(|file| Self::new(file, true));
        log.map_err(WriteError::at(&std::env::temp_dir()))
    }

    fn new(file: File, is_compressed: bool) -> io::Result<Self> {
        let mut compressor = is_compressed.then(|| Compressor::new(LEVEL)).transpose()?;
        if let Some(compressor) = &mut compressor {
            compressor.set_parameter(CParameter::ChecksumFlag(true))?;
        }
        Ok(Self {
            path: None,
            file,
            compressor,
            text: String::new(),
            since: Duration::ZERO,
            flushes: 0,
        })
    }

    /// # Errors
    /// If the disk does not take them.
    pub fn append(&mut self, frames: &[Stamped]) -> Result<(), WriteError> {
        for stamped in frames {
            if self.compressor.is_some() && stamped.time.abs_diff(self.since) >= PIECE {
                self.write()?;
            }
            if self.text.is_empty() {
                self.since = stamped.time;
            }
            stamped.push_to(&mut self.text);
            self.flushes = 0;
        }
        Ok(())
    }

    /// Hands all frames to the operating system, so that a kill loses no older ones; for a compressed log, all but the latest
    /// second.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        if self.compressor.is_none() || self.flushes == IDLE_FLUSHES_MAX {
            self.write()?;
        }
        self.flushes = self.flushes.saturating_add(1);
        Ok(())
    }

    /// Writes the lines that are not in the file yet.
    fn write(&mut self) -> Result<(), WriteError> {
        let text = self.text.as_bytes();
        let written = match &mut self.compressor {
            _ if text.is_empty() => Ok(()),
            None => self.file.write_all(text),
            Some(compressor) => compressor
                .compress(text)
                .and_then(|piece| self.file.write_all(&piece)),
        };
        self.text.clear();
        written.map_err(|error| self.error(error))
    }

    fn error(&self, error: io::Error) -> WriteError {
        let path = self.path.clone().unwrap_or_else(std::env::temp_dir);
        WriteError::at(&path)(error)
    }

    /// Ends the log and returns it for reading.
    ///
    /// # Errors
    /// If the disk does not take it, or the log is not at its path any more: a folder without its log is no recording.
    pub(crate) fn finish(mut self) -> Result<OpenLog, WriteError> {
        self.write()?;
        if self
            .path
            .as_ref()
            .is_some_and(|path| !has_name(&self.file, path))
        {
            let gone = io::Error::other("somebody removed or replaced it during the run");
            return Err(self.error(gone));
        }
        Ok(OpenLog::new(self.file, self.compressor.is_some()))
    }
}

/// Returns whether an open file is the one at this path.
pub(crate) fn has_name(file: &File, path: &Path) -> bool {
    let number = |found: Metadata| (found.dev(), found.ino());
    let opened = file.metadata().map(number);
    let found = path.metadata().map(number);
    opened.is_ok_and(|opened| found.is_ok_and(|found| opened == found))
}

#[cfg(test)]
mod tests {
    use can::CanFrame;
    use std::fs;

    use super::*;
    use crate::frames::Log;

    fn frame(millis: u64) -> Stamped {
        Stamped::new(
            Duration::from_millis(millis),
            CanFrame::new(0x190, &millis.to_le_bytes()),
        )
    }

    /// A log of three seconds, cut at each byte: the whole seconds before the cut are read.
    #[test]
    fn a_compressed_log_cut_at_any_byte_reads_to_the_last_second() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bus.log.zst");
        let frames: Vec<Stamped> = (0..3500).map(frame).collect();
        let mut log = BusLog::create(path.clone()).unwrap();
        let mut ends = vec![0];
        for part in frames.chunks(100) {
            log.append(part).unwrap();
            log.flush().unwrap();
            ends.push(fs::metadata(&path).unwrap().len());
        }
        // The log was not ended, as after a kill.
        let killed = Log::read(&path).unwrap();
        assert_eq!((killed.frames.len(), killed.unread.broken), (3000, None));
        log.finish().unwrap();
        let whole = Log::read(&path).unwrap();
        assert!(whole.frames.iter().eq(frames.iter().copied()));
        assert_eq!(whole.unread.broken, None);
        ends.dedup();
        assert_eq!(ends.len(), 4);
        let bytes = fs::read(&path).unwrap();
        for length in 1..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            let cut = Log::read(&path).unwrap();
            let length = u64::try_from(length).unwrap();
            let pieces = ends[1..].iter().filter(|end| **end <= length).count();
            let read = cut.frames.len();
            assert!(read >= 1000 * pieces, "{length}: {read}");
            assert!(cut.frames.iter().eq(frames[..read].iter().copied()));
            assert_eq!(
                cut.unread.broken.is_some(),
                !ends.contains(&length),
                "{length}"
            );
        }
    }

    #[test]
    fn a_bus_that_falls_silent_is_compressed_before_its_second_is_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bus.log.zst");
        let mut log = BusLog::create(path.clone()).unwrap();
        log.append(&[frame(1), frame(2)]).unwrap();
        for _ in 0..IDLE_FLUSHES_MAX {
            log.flush().unwrap();
            assert_eq!(fs::metadata(&path).unwrap().len(), 0);
        }
        assert!(Log::read(&path).unwrap().frames.is_empty());
        log.flush().unwrap();
        let frames = Log::read(&path).unwrap().frames;
        assert_eq!((frames.len(), frames.is_empty()), (2, false));
    }
}
