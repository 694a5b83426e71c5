//! Log of a run in progress.

use std::fs::{File, Metadata};
use std::io::{self, BufWriter, IntoInnerError, Write};
use std::mem;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use zstd::bulk::Compressor;
use zstd::zstd_safe::CParameter;

use crate::log::{self, OpenLog, Stamped, is_compressed};
use crate::write_error::WriteError;

/// Length of the pieces in which a run is compressed. A kill loses no more than one.
const PIECE: Duration = Duration::from_secs(1);
/// Number of flushes without a frame after which the open piece is compressed: a second of a silent bus.
const IDLE_FLUSHES_MAX: u32 = 50;
/// Compression level; a higher one takes longer and saves little.
const LEVEL: i32 = 3;

/// `bus.log`, or the compressed log of a long run.
#[derive(Debug)]
pub struct BusLog {
    /// Path of the log; `None` for a file without a name.
    path: Option<PathBuf>,
    output: Output,
}

#[derive(Debug)]
enum Output {
    Plain(BufWriter<File>),
    Compressed(Pieces),
}

impl BusLog {
    /// Makes an empty log; its name decides whether it is compressed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create(path: PathBuf) -> Result<Self, WriteError> {
        let file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path);
        let output = file.and_then(|file| Output::new(file, is_compressed(&path)));
        Ok(Self {
            output: output.map_err(WriteError::at(&path))?,
            path: Some(path),
        })
    }

    /// Makes an empty compressed log in a file without a name, which ends with the process.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn without_name() -> Result<Self, WriteError> {
        let output = tempfile::tempfile().and_then(|file| Output::new(file, true));
        Ok(Self {
            output: output.map_err(WriteError::at(&std::env::temp_dir()))?,
            path: None,
        })
    }

    /// Returns the path for an error message.
    fn place(&self) -> PathBuf {
        self.path.clone().unwrap_or_else(std::env::temp_dir)
    }

    /// # Errors
    /// If the disk does not take them.
    pub fn append(&mut self, frames: &[Stamped]) -> Result<(), WriteError> {
        let written = match &mut self.output {
            Output::Plain(output) => log::write_log(output, frames),
            Output::Compressed(pieces) => pieces.append(frames),
        };
        written.map_err(|error| WriteError::at(&self.place())(error))
    }

    /// Hands all frames to the operating system, so that a kill loses no older ones; for a compressed log, all but the latest
    /// second.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        let written = match &mut self.output {
            Output::Plain(output) => output.flush(),
            Output::Compressed(pieces) => pieces.flush(),
        };
        written.map_err(|error| WriteError::at(&self.place())(error))
    }

    /// Ends the log and returns it for reading.
    ///
    /// # Errors
    /// If the disk does not take it, or the log is not at its path any more.
    pub(crate) fn finish(mut self) -> Result<OpenLog, WriteError> {
        self.flush()?;
        let place = self.place();
        let is_compressed = matches!(self.output, Output::Compressed(_));
        let log = match self.output {
            Output::Plain(output) => output.into_inner().map_err(IntoInnerError::into_error),
            Output::Compressed(mut pieces) => pieces.write().map(|()| pieces.file),
        };
        let log = match &self.path {
            Some(path) => log.and_then(|file| require_at(path, file)),
            None => log,
        };
        let log = log.map_err(WriteError::at(&place))?;
        Ok(OpenLog::new(log, is_compressed))
    }
}

/// Returns whether an open file is the one at this path.
pub(crate) fn has_name(file: &File, path: &Path) -> bool {
    let number = |found: Metadata| (found.dev(), found.ino());
    let opened = file.metadata().map(number);
    let found = path.metadata().map(number);
    opened.is_ok_and(|opened| found.is_ok_and(|found| opened == found))
}

/// Refuses a file that has lost its name: a folder without its log is no recording.
fn require_at(path: &Path, file: File) -> io::Result<File> {
    if has_name(&file, path) {
        Ok(file)
    } else {
        Err(io::Error::other(
            "somebody removed or replaced it during the run",
        ))
    }
}

impl Output {
    fn new(file: File, is_compressed: bool) -> io::Result<Self> {
        if !is_compressed {
            return Ok(Self::Plain(BufWriter::new(file)));
        }
        let mut compressor = Compressor::new(LEVEL)?;
        compressor.set_parameter(CParameter::ChecksumFlag(true))?;
        Ok(Self::Compressed(Pieces {
            file,
            compressor,
            text: String::new(),
            since: Duration::ZERO,
            has_new: false,
            idle_flushes: 0,
        }))
    }
}

/// Compressed log: each second is a piece that can be read without the others.
struct Pieces {
    file: File,
    compressor: Compressor<'static>,
    /// Lines of the latest piece, which is still open.
    text: String,
    /// Time of its first frame.
    since: Duration,
    /// Whether frames came since the latest flush.
    has_new: bool,
    idle_flushes: u32,
}

impl std::fmt::Debug for Pieces {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Pieces")
            .field("file", &self.file)
            .finish_non_exhaustive()
    }
}

impl Pieces {
    fn append(&mut self, frames: &[Stamped]) -> io::Result<()> {
        for stamped in frames {
            if stamped.time.abs_diff(self.since) >= PIECE {
                self.write()?;
            }
            if self.text.is_empty() {
                self.since = stamped.time;
            }
            stamped.push_to(&mut self.text);
            self.has_new = true;
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.idle_flushes = if mem::take(&mut self.has_new) {
            0
        } else {
            self.idle_flushes.saturating_add(1)
        };
        match self.idle_flushes {
            IDLE_FLUSHES_MAX => self.write(),
            _ => Ok(()),
        }
    }

    /// Writes the open piece, and begins another.
    fn write(&mut self) -> io::Result<()> {
        if self.text.is_empty() {
            return Ok(());
        }
        let piece = self.compressor.compress(self.text.as_bytes())?;
        self.text.clear();
        self.file.write_all(&piece)
    }
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
        log.flush().unwrap();
        assert_eq!(Log::read(&path).unwrap().frames.len(), 2);
    }
}
