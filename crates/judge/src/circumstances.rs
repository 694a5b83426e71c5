//! What is known of a run besides its frames.

use recording::ending::EarlyEnd;
use recording::stalls::Stall;
use recording::unrecorded::Unrecorded;

/// What is known of a run besides its frames; the default is that of virtual time, and of somebody else's recording.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// What was on the bus and is not among the frames.
    pub unrecorded: Unrecorded,
    /// Who ended the run before its scenario's end; none if it was played to its end.
    pub ended_early: Option<EarlyEnd>,
    /// Where the machine held up what canrig started; nothing in virtual time.
    pub stalls: Vec<Stall>,
}
