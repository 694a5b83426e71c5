//! Virtual time: a coordinator grants time and delivers the frames of the bus; each participant answers with the frames that it
//! queued and with its next deadline.
//!
//! [`Participant`] is the coordinator's view of a node. [`Local`] is a node in this process, [`Remote`] one in another process at
//! a bus seat. A process of canrig runs [`follow`], which steps the node with the same code, so the answers are the same; an
//! external program implements the protocol itself.
//!
//! The rules of a step from the participant's current time to `to`:
//! - a deadline earlier than the next frame ticks first, at the deadline;
//! - at equal times the frames come first, then the tick;
//! - a deadline at `to` itself ticks in this step;
//! - after `to` the node may continue by its own deadlines until a later time, which the coordinator has found safe; it
//!   ends early with the instant in which it queues a frame that another participant may answer;
//! - frames that the node queues carry the time at which it queued them;
//! - the step ends early when the node has stopped or failed.

mod audience;
mod follow;
mod local;
mod participant;
mod protocol;
mod remote;
mod step;
#[cfg(test)]
mod tests;

pub use audience::Audience;
pub use follow::{FollowError, WIRE_PATIENCE, follow};
pub use local::Local;
pub use participant::{Answer, Failure, Participant};
pub use protocol::{FRAMES_MAX, Hello, Setting};
pub use remote::{ANSWER_PATIENCE, Remote, channel};
pub use step::StepError;
pub(crate) use step::TICKS_PER_INSTANT_MAX;
