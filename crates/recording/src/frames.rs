//! Frames of a recording, for repeated reading: few are kept in memory, many are read from their log each time.

use std::fmt::Display;
use std::io;
use std::iter;
use std::path::Path;
use std::time::Duration;

use crate::log::{LogReader, OpenLog, Stamped, Unread};

/// Largest number of frames in memory: half a minute of a bus with four frames in a cycle of 1 ms, in 5 MB.
pub(crate) const KEPT_MAX: usize = 1 << 17;

/// Least time of the wall clock, in 2001. No run in virtual time, which begins at 0, lasts that long.
const WALL_CLOCK_FROM: Duration = Duration::from_secs(1_000_000_000);

/// Clock that gave a recording its times.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Clock {
    /// Virtual time.
    Virtual,
    /// The wall clock, in real time.
    Wall,
}

/// All frames of a recording.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    kept: Vec<Stamped>,
    /// Log with the frames, and their number, if not all are kept.
    log: Option<(OpenLog, usize)>,
}

impl Frames {
    /// Returns the first `count` frames of a log that was read to its end before.
    pub(crate) fn in_log(log: OpenLog, count: usize) -> Self {
        Self {
            kept: Vec::new(),
            log: Some((log, count)),
        }
    }

    pub fn len(&self) -> usize {
        self.log
            .as_ref()
            .map_or(self.kept.len(), |(_, count)| *count)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the time of the first frame; `None` without frames.
    pub fn start(&self) -> Option<Duration> {
        self.iter().next().map(|first| first.time)
    }

    /// Returns the clock of the frames' times; `None` without frames.
    pub fn clock(&self) -> Option<Clock> {
        self.start().map(|start| match start {
            start if start < WALL_CLOCK_FROM => Clock::Virtual,
            _ => Clock::Wall,
        })
    }

    /// Iterates from the first to the last.
    ///
    /// # Panics
    /// With [`LogChanged`], if the log was changed since it was read before.
    pub fn iter(&self) -> impl Iterator<Item = Stamped> {
        let reader = |log: &OpenLog| log.frames().unwrap_or_else(|error| changed(&error));
        let mut log = self.log.as_ref().map(|(log, _)| reader(log));
        let read = move || {
            let next = log.as_mut().map_or(Ok(None), LogReader::next_frame);
            let next = next.unwrap_or_else(|error| changed(&error));
            next.unwrap_or_else(|| changed(&"it has fewer frames than before"))
        };
        // A log that has grown since it was read before has more frames.
        let in_log = self.log.as_ref().map_or(0, |(_, count)| *count);
        let kept = self.kept.iter().copied();
        kept.chain(iter::repeat_with(read).take(in_log))
    }
}

impl From<Vec<Stamped>> for Frames {
    fn from(frames: Vec<Stamped>) -> Self {
        Self {
            kept: frames,
            log: None,
        }
    }
}

/// Content of a log, as far as it can be read.
#[derive(Clone, Debug, Default)]
pub struct Log {
    pub frames: Frames,
    pub unread: Unread,
}

impl Log {
    /// Reads a log file up to its end, or to the point where it breaks off. The frames of a long one are read again when needed.
    ///
    /// # Errors
    /// If the file cannot be read, or is no log.
    pub fn read(path: &Path) -> io::Result<Self> {
        let open = OpenLog::open(path)?;
        let mut log = open.frames()?;
        let mut kept = Vec::new();
        let mut count = 0;
        while let Some(stamped) = log.next_frame()? {
            count += 1;
            if count <= KEPT_MAX {
                kept.push(stamped);
            }
        }
        let unread = log.finish();
        let frames = if count <= KEPT_MAX {
            kept.into()
        } else {
            Frames::in_log(open, count)
        };
        Ok(Self { frames, unread })
    }
}

/// Error: the frames of a recording cannot be read again, since its log was changed meanwhile.
#[derive(Debug, thiserror::Error)]
#[error("the log was changed while it was read ({0}): give the same command again")]
pub struct LogChanged(String);

/// Panics. A reader has frames in memory or from a log that was read to its end before, so a change is like a failure of memory.
fn changed(reason: &dyn Display) -> ! {
    std::panic::panic_any(LogChanged(reason.to_string()))
}
