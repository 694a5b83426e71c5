//! From a timeline to a verdict, by the recording alone.
//!
//! The input is a decoded recording ([`Timeline`](recording::timeline::Timeline)), the [`Plan`](plan::Plan) with the scenario's
//! `[expect]`, and the [`Circumstances`]: frames that the recorder lost, the end of the run, the stalls of the machine, and for a
//! run in real time the counts of its host. The output is a [`Verdict`](verdict::Verdict): each metric with its limit
//! ([`metrics`]), the checks of signals and sequences, the losses, the [`Timing`](timing::Timing), and one
//! [`Outcome`](verdict::Outcome). `verdict.json` holds it.
//!
//! [`comparison`] compares two recordings with their verdicts, and reports the differences beyond a tolerance.
//!
//! This crate does not know which world made the recording, where it is stored, or how a verdict is shown. Names, units and
//! limits of the metrics are in [`scenario::metrics`].

mod attribution;
mod chirp;
mod circumstances;
pub mod comparison;
mod contour;
mod decision;
mod disturbances;
mod duties;
mod evidence;
mod harmonic;
mod holds;
mod loops;
mod metric;
mod metrics;
mod off;
mod quality;
mod reactions;
mod sequences;
mod signals;
mod sine;
mod steps;
#[cfg(test)]
mod tests;
pub mod timing;
mod timing_decision;
pub mod verdict;

pub use chirp::{CUT_OFF_GAIN, FrequencyPoint, FrequencyResponse, frequency_responses};
pub use circumstances::Circumstances;
pub use contour::contour_errors;
pub use decision::judge;
pub use holds::swing;
pub use loops::{expected_rows, limits};
pub use quality::lost_frames;
pub use steps::SETTLING_BAND;
pub use timing_decision::judge_timing;
