//! What was on the bus: the frames of a run, and what they say.
//!
//! Comes in: the frames of a world, each with its time, or a `bus.log`; the [`Plan`](plan::Plan), whose database
//! says what frames mean. Goes out: `bus.log` while a run goes on ([`capture`]), the same frames to observers
//! ([`frame_queue`]), the run's progress ([`progress`]), and the decoded recording: a [`Timeline`](timeline::Timeline) with
//! a row for each cycle, its events and losses, the samples of the signals that checks name; the latencies of
//! real time, and where the machine was late ([`stalls`]).
//! A [`RunFolder`](run_folder::RunFolder) holds the files of one run, each written as a whole.
//!
//! It does not know: limits and verdicts, reports, which world made the frames, how plants and laws behave.

pub mod bus_log;
pub mod capture;
pub mod cell;
pub mod drive_reports;
pub mod ending;
pub mod events;
mod fan;
pub mod frame_queue;
pub mod frames;
mod identifiers;
pub mod latency;
pub mod log;
pub mod losses;
mod node_words;
pub mod occurrences;
mod pieces;
pub mod progress;
pub mod run_folder;
pub mod session;
pub mod sources;
pub mod stalls;
pub mod timeline;
pub mod traces;
pub mod truth;
pub mod unrecorded;
pub mod work;
mod write_error;
