//! Facts of the bus that are not among the frames of its recording.

use crate::foreign::Foreign;
use crate::hits::Hits;
use crate::reasons::Reasons;

/// Facts of the bus that the frames of a recording do not show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unrecorded {
    /// Number of frames that the recorder lost.
    pub frames_lost: u64,
    /// Number of CAN FD frames, which are only counted.
    pub fd_frames: u64,
    /// Lines of the log that are no frames, for the user; `None` if everything that is judged could be read.
    pub unreadable_lines: Option<String>,
    /// Hits of the scenario's faults; `None` if that is not known.
    pub hits: Option<Hits>,
    /// Reasons of canrig's nodes that faults of the bus may have kept from it.
    pub reasons: Reasons,
    /// Frames that no node of the run sent; `None` if the senders are not known.
    pub foreign: Option<Foreign>,
}
