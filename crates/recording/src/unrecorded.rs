//! Traffic of the bus that is not among the frames of its recording.

/// Traffic of the bus that the frames of a recording do not show.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unrecorded {
    /// Number of frames that the recorder lost.
    pub frames_lost: u64,
    /// Number of CAN FD frames, which are only counted.
    pub fd_frames: u64,
    /// Lines of the log that are no frames, for the user; `None` if everything that is judged could be read.
    pub unreadable_lines: Option<String>,
}
