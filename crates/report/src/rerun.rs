//! What the Rerun viewer shows of a run: `run.rrd`, and the same in pieces while a run goes on, with a layout of its own.
//!
//! A signal has a row in every cycle; one that seldom changes, or that is not drawn, only where its value changes.
//! Nothing in the file comes from this machine's clock, so two equal runs are equal files once decoded (only the SDK's
//! random numbers of rows differ).

mod blueprint;
mod bus;
mod drawing;
mod file;
mod groups;
mod hysteresis;
mod output;
mod run_log;
#[cfg(test)]
mod tests;
mod times;

use dbc::SignalMissing;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::Path;

use re_sdk::external::re_log_encoding::EncodeError;
use re_sdk::log::ChunkError;
use re_sdk::{EntityPath, RecordingInfo, SerializationError, StoreId, StoreKind};

use super::Run;
use judge::verdict::Verdict;
use recording::timeline::Timeline;

pub(crate) use bus::BusReader;
use file::RecordingFile;
use output::send_static;
pub(crate) use run_log::{Known, Recording};

/// Rows of a long run that are logged at once.
const PIECE_ROWS: usize = 1 << 16;

/// The viewer keeps one layout per application.
pub(crate) const APPLICATION: &str = "canrig";

/// Why the recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RerunError {
    /// Rows and their times do not fit each other.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// The SDK cannot put values into a column.
    #[error(transparent)]
    Serialization(#[from] SerializationError),
    /// The disk does not take the file.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The DBC lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// The recording cannot be put into the file.
    #[error(transparent)]
    Encoding(#[from] EncodeError),
}

/// Writes the recording as a whole: a reader sees none or a complete one.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, run: &Run<'_>) -> Result<(), RerunError> {
    let Run {
        setup,
        timeline,
        verdict,
        ..
    } = *run;
    let mut bus = BusReader::new(setup, run.is_long)?;
    let partial = path.with_added_extension("partial");
    let id = recording_id(timeline, verdict);
    let store = StoreId::new(StoreKind::Recording, APPLICATION, id);
    let mut file = RecordingFile::create(&partial, store)?;
    let properties = RecordingInfo::new()
        .with_name(setup.scenario.name.as_str())
        .with_start_time(0_i64);
    send_static(&mut file, EntityPath::properties(), &properties)?;
    let known = match run.is_long {
        false => Known::Whole,
        true => Known::Thinned,
    };
    let mut recording = Recording::begin(&mut file, setup, known)?;
    let mut frames = run.frames.iter();
    if run.is_long {
        let rows = timeline.cycle.len();
        for begin in (0..rows.max(1)).step_by(PIECE_ROWS) {
            let end = rows.min(begin + PIECE_ROWS);
            let piece = timeline.piece(begin..end);
            let end_seconds = match end == rows {
                true => f64::INFINITY,
                false => piece.end_seconds(),
            };
            // Up to the first frame of a cycle beyond.
            frames.find(|stamped| bus.observe(stamped) >= end_seconds);
            recording.log(&piece, &mut bus)?;
        }
    } else {
        frames.for_each(|stamped| {
            bus.observe(&stamped);
        });
        recording.log(timeline, &mut bus)?;
    }
    recording.log_verdict(verdict)?;
    recording.finish()?;
    file.finish()?;
    Ok(fs::rename(partial, path)?)
}

/// Names what was recorded: two recordings of one id would be mixed by a viewer that is open. Runs that differ in
/// anything differ in the verdict, the events, the position or the current. Against chance 64 bits are enough.
fn recording_id(timeline: &Timeline, verdict: &Verdict) -> String {
    let mut hasher = DefaultHasher::new();
    verdict.to_json().hash(&mut hasher);
    for event in &timeline.events {
        event.text.hash(&mut hasher);
    }
    let times = timeline.events.iter().map(|event| &event.time_seconds);
    let values = timeline.position().iter().chain(timeline.current());
    for value in times.chain(values) {
        hasher.write_u64(value.to_bits());
    }
    format!("{:016x}", hasher.finish())
}
