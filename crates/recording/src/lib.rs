//! Recordings of a bus: the frames of a run, and their meaning.
//!
//! Input: the frames of a world, each with its time, or a `bus.log`; the [`Plan`](plan::Plan), whose database gives frames their
//! meaning. Output: `bus.log` during a run ([`capture`]), the same frames to observers ([`frame_queue`]), the run's progress
//! ([`progress`]), and the decoded recording: a [`Timeline`](timeline::Timeline) with a row for each cycle, its events and
//! losses, the samples of the signals that checks name; the latencies of real time, and the stalls of the machine ([`stalls`]). A
//! [`RunFolder`](run_folder::RunFolder) holds the files of one run, each written as a whole.
//!
//! It knows no limits and verdicts, no reports, no world that made the frames, no behaviour of plants and laws.

pub mod bus_log;
pub mod capture;
pub mod cell;
pub mod conduct;
pub mod drive_reports;
pub mod ending;
pub mod events;
pub mod foreign;
pub mod frame_queue;
pub mod frames;
pub mod hits;
mod identifiers;
mod io_currents;
mod io_nodes;
pub mod latency;
pub mod log;
pub mod losses;
pub mod occurrences;
mod pieces;
pub mod progress;
pub mod reasons;
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
