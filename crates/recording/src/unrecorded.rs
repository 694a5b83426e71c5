//! What was on the bus and is not among the frames of its recording.

/// What the frames of a recording do not show of the bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unrecorded {
    /// Frames that the recorder lost.
    pub frames_lost: u64,
    /// CAN FD frames, which are counted only.
    pub fd_frames: u64,
    /// Lines of the log that are no frames, for people; none where all that is judged could be read.
    pub strange_lines: Option<String>,
}
