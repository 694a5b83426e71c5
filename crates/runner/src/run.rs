//! Plays one scenario, from its setup to its verdict.

use std::io;
use std::path::{Path, PathBuf};

use scenario::Override;

use crate::exit::Exit;
use crate::identity::identity;
use crate::play_record::PlayRecord;
use exports::parquet;
use judge::Circumstances;
use judge::timing::Timing;
use judge::verdict::{Identity, Outcome, Tries, Verdict};
use plan::{Plan, Shared};
use recording::capture::{Capture, Watch};
use recording::ending::{EarlyEnd, EndedBy};
use recording::frame_queue::FrameQueue;
use recording::frames::Frames;
use recording::progress::ProgressReader;
use recording::run_folder::{RunFolder, WriteError, file};
use recording::session::{write_plan, write_sheets};
use recording::stalls;
use recording::timeline::{self, Timeline};
use recording::unrecorded::Unrecorded;
use report::{ReportError, Run};
use worlds::{End, Played, WorldError};

/// Default of `--output`: the folder for run folders.
pub const RUNS: &str = "runs";

/// Default of `--compress-above`: the duration from which on runs leave compressed files.
pub const COMPRESS_ABOVE_SECONDS: f64 = 600.0;

/// Place and form of a run's files.
#[derive(Clone, Copy, Debug)]
pub struct RunPlace<'a> {
    /// Folder in which the run's folder is made.
    pub parent: &'a Path,
    /// Whether log and signals are compressed, and the recording for the viewer is thinned.
    pub is_long: bool,
    /// Values of the command line, which the scenario already has.
    pub overrides: &'a [Override],
    /// Whether a run fails if it passes although nothing was limited.
    pub is_strict: bool,
    /// Plays before this one, which stalls spoiled.
    pub tries: Option<&'a Tries>,
}

/// Result of a run.
pub struct Judged {
    /// Verdict of the run.
    pub verdict: Verdict,
    /// Frames of the run.
    pub frames: Frames,
    /// Folder of the run.
    pub folder: PathBuf,
    /// Exit of the program.
    pub exit: Exit,
}

/// Plays a plan in a world, records and judges it, and passes the frames on to the queues meanwhile. A node that ended the run
/// has failed. The recording before a failure of the bench is kept, with a verdict "incomplete" and its reason.
///
/// # Errors
/// A file or report of the run cannot be written, the database lacks a signal, or the program that plays is unknown.
pub fn run(
    plan: &Plan,
    place: RunPlace<'_>,
    watch: &Watch,
    queues: Vec<FrameQueue>,
    world: impl FnOnce(&RunFolder, &mut Capture<'_>) -> Result<Played, WorldError>,
) -> Result<Judged, ReportError> {
    let identity = identity(plan)?;
    let is_long = place.is_long;
    let record = PlayRecord::now(place.overrides);
    let folder = create_folder(place, plan, &identity, &record)?;
    write_sheets(&folder, plan)?;
    let progress = ProgressReader::new(plan)?;
    let clock = plan.scenario_clock()?;
    let mut capture = Capture::new(folder.bus_log(is_long)?, progress, clock, watch, queues);
    let ended = world(&folder, &mut capture);
    let (frames, unrecorded) = capture.finish(plan)?;
    let timelines = timeline::decode(&frames, plan)?;
    let mut verdict = Verdict {
        identity: Some(identity),
        tries: place.tries.cloned(),
        ..verdict(&ended, &timelines, plan, &unrecorded)
    };
    if let Some(hits) = unrecorded.hits.as_ref().filter(|_| plan.has_faults()) {
        folder.write(file::HITS, hits.to_csv().as_bytes())?;
    }
    if !unrecorded.reasons.is_empty() {
        folder.write(file::REASONS, unrecorded.reasons.to_csv().as_bytes())?;
    }
    if let Some(foreign) = &unrecorded.foreign {
        folder.write(file::FOREIGN, foreign.to_csv().as_bytes())?;
    }
    if let Ok(Played {
        host: Some(host), ..
    }) = &ended
    {
        folder.write(file::STALLS, stalls::to_csv(&host.stalls).as_bytes())?;
        folder.write(file::SENT, host.sent.to_csv().as_bytes())?;
        let timing = Timing::new(&frames, plan, host.clone())?;
        let expect = &plan.shared.run.expect;
        judge::judge_timing(&mut verdict, timing, expect, &host.stalls);
    }
    if is_long {
        folder.write_with(file::LONG_SIGNALS, |output| {
            parquet::write_signals(output, &timelines).map_err(io::Error::other)
        })?;
    }
    let played = record.place();
    let run = Run {
        plan,
        frames: &frames,
        timelines: &timelines,
        verdict: &verdict,
        set: &record.set,
        played: Some(&played),
        is_long,
    };
    report::write_all(&run, &folder)?;
    let exit = match &ended {
        // The interruption may have come during the judging.
        _ if watch.is_interrupted() => Exit::Interrupted,
        Err(error) if error.is_before_start() => Exit::CannotStart,
        // Also where a drive that is on fails the run.
        Err(_) if verdict.outcome == Outcome::Fail => Exit::BenchFailed,
        _ if place.is_strict && verdict.judged_nothing() => Exit::VerdictFailed,
        _ => verdict.outcome.into(),
    };
    Ok(Judged {
        verdict,
        frames,
        folder: folder.path().to_owned(),
        exit,
    })
}

/// Returns the number of passes over the frames and cycles of a long run after its play: for the timelines, the verdict, the
/// signals, and the page; for each loop, for the viewer, and for its times in real time.
pub(crate) fn passes_to_files(played: &Played, loops: usize) -> u64 {
    let passes_of_loop = if played.host.is_some() { 2 } else { 1 };
    4 + passes_of_loop * loops as u64
}

/// Makes the folder of a run with its input and a verdict "incomplete", which a reader finds if the run breaks off.
fn create_folder(
    place: RunPlace<'_>,
    plan: &Plan,
    identity: &Identity,
    record: &PlayRecord,
) -> Result<RunFolder, WriteError> {
    let Shared { run, text, .. } = &plan.shared;
    let folder = RunFolder::create(place.parent, &run.name, run.seed, text)?;
    let unfinished = "the run has not ended; if no process works on it any more, it broke off";
    let verdict = Verdict {
        identity: Some(identity.clone()),
        ..Verdict::incomplete_run(plan, unfinished)
    };
    folder.write(file::VERDICT, verdict.to_json().as_bytes())?;
    record.write(&folder)?;
    write_plan(&folder, plan)?;
    Ok(folder)
}

/// Returns the verdict of a run, however its world ended.
pub fn verdict(
    ended: &Result<Played, WorldError>,
    timelines: &[Timeline],
    plan: &Plan,
    unrecorded: &Unrecorded,
) -> Verdict {
    let ended_early = match ended {
        Err(error) => Some(EarlyEnd::without_node(
            EndedBy::Bench,
            with_losses(error, unrecorded.frames_lost),
        )),
        Ok(played) => match &played.end {
            End::Completed => None,
            End::Interrupted => return interrupted(plan),
            End::ByNode(end) => Some(end.clone()),
        },
    };
    let host = ended.as_ref().ok().and_then(|played| played.host.clone());
    let circumstances = Circumstances {
        unrecorded: unrecorded.clone(),
        ended_early,
        host: host.unwrap_or_default(),
    };
    judge::judge(plan, timelines, &circumstances)
}

fn interrupted(plan: &Plan) -> Verdict {
    let reason = "interrupted by the user";
    Verdict {
        ended_early: Some(EarlyEnd::without_node(EndedBy::User, reason)),
        ..Verdict::incomplete_run(plan, reason)
    }
}

fn with_losses(error: &WorldError, frames_lost: u64) -> String {
    match frames_lost {
        0 => error.to_string(),
        lost => format!("{error}\n{}", judge::lost_frames(lost)),
    }
}
