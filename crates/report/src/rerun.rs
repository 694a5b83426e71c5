//! Recording of a run for the Rerun viewer: `run.rrd`, and the same in pieces while a run is played, with its layout.
//!
//! A signal has a row in every cycle; a signal that seldom changes, or is not drawn, has rows only where its value changes. The
//! file contains no times of this machine's clock, so two equal runs are equal files once decoded (only the SDK's random numbers
//! of rows differ).

mod blueprint;
mod bus;
mod contour;
mod drawing;
mod file;
mod groups;
mod hysteresis;
mod output;
mod run_log;
#[cfg(test)]
mod tests;
mod times;
mod trail;

use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;

use re_sdk::{EntityPath, RecordingInfo, StoreId, StoreKind};
use re_sdk_types::blueprint::components::PlayState;

use super::{ReportError, Run};
use crate::run::RunLoop;

use plan::Plan;
use platform::series::Series;
use recording::run_folder::replace;

use blueprint::Page;
use file::RecordingFile;
use output::{Output, send_static};
pub(crate) use run_log::{Known, Recording, log_verdict};

/// Least number of rows of a long run that are logged at once, and largest number of times. The table of contents, which is in
/// memory to the end, has a row for each entity each time.
const PIECE_ROWS_MIN: usize = 1 << 16;
const PIECES_MAX: usize = 50;

/// Largest number of points in a path; every second point of a longer path is left out.
const POINTS_MAX: usize = 20_000;

/// Name of the application, for which the viewer keeps one layout.
pub(crate) const APPLICATION: &str = "canrig";

/// Writes the recording as a whole: a reader sees no file or a complete one. With several loops each has a folder.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, run: &Run<'_>) -> Result<(), ReportError> {
    replace(path, |file| write_to(file, run))
}

fn write_to(file: File, run: &Run<'_>) -> Result<(), ReportError> {
    let id = recording_id(run);
    let store = StoreId::new(StoreKind::Recording, APPLICATION, id);
    let mut file = RecordingFile::begin(file, store)?;
    let properties = RecordingInfo::new()
        .with_name(run.plan.shared.run.name.as_str())
        .with_start_time(0_i64);
    send_static(&mut file, EntityPath::properties(), &properties)?;
    let mut pages = Vec::new();
    let mut end_seconds = 0.0_f64;
    for one in run.loops() {
        let (page, end) = log_loop(&mut file, run, &one)?;
        pages.push(page);
        end_seconds = end_seconds.max(end);
    }
    log_verdict(&mut file, run.plan, run.verdict, end_seconds)?;
    let planes = contour::log(&mut file, run)?;
    blueprint::send(&mut file, &pages, &planes, PlayState::Paused)?;
    file.finish()
}

/// Sends the layout of a run that has just begun, with all groups that may follow.
pub(crate) fn expect_all(output: &mut dyn Output, plan: &Plan) -> Result<(), ReportError> {
    let pages = plan.loops.iter().map(|control_loop| Page {
        plan,
        control_loop,
        groups: groups::expected(plan, control_loop),
    });
    blueprint::send(output, &Vec::from_iter(pages), &[], PlayState::Following)
}

/// Logs a loop; returns its page of the layout, and the time of its end.
fn log_loop<'a>(
    output: &mut dyn Output,
    run: &Run<'_>,
    one: &RunLoop<'a>,
) -> Result<(Page<'a>, f64), ReportError> {
    let (control_loop, timeline) = (one.control_loop, one.timeline);
    let rows = timeline.cycle.len();
    let (known, piece_rows) = if run.is_long {
        let piece_rows = rows.div_ceil(PIECES_MAX).max(PIECE_ROWS_MIN);
        (Known::Thinned, piece_rows)
    } else {
        (Known::Whole, rows.max(1))
    };
    let mut recording = Recording::begin(output, (one.plan, control_loop), known)?;
    let mut frames = run.frames.iter();
    for begin in (0..rows.max(1)).step_by(piece_rows) {
        let end = rows.min(begin + piece_rows);
        let piece = timeline.piece(begin..end);
        let end_seconds = if end == rows {
            f64::INFINITY
        } else {
            piece.end_seconds()
        };
        // The frames go up to the first one of a later cycle.
        frames.find(|stamped| recording.observe(stamped) >= end_seconds);
        recording.log(&piece)?;
    }
    recording.end()
}

/// Leaves out every second point of a path that has become too long.
fn thin<T>(points: &mut Vec<T>) {
    if points.len() > POINTS_MAX {
        let mut is_kept = true;
        points.retain(|_| {
            is_kept = !is_kept;
            is_kept
        });
    }
}

/// Returns an id of the recording, since an open viewer would mix two recordings with the same id. Runs that differ in anything
/// differ in the verdict, the events, the position or the current. An id of 64 bits makes equal ones unlikely enough.
fn recording_id(run: &Run<'_>) -> String {
    let mut hasher = DefaultHasher::new();
    run.verdict.to_json().hash(&mut hasher);
    for timeline in run.timelines {
        for event in timeline.events.iter() {
            event.text.hash(&mut hasher);
        }
        let times = timeline.events.iter().map(|event| event.time_seconds);
        let current = timeline.current().into_iter().flat_map(Series::iter);
        for value in times.chain(timeline.position().iter()).chain(current) {
            hasher.write_u64(value.to_bits());
        }
    }
    format!("{:016x}", hasher.finish())
}
