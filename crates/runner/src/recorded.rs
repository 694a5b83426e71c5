//! Reads a recording back from the disk.

use dbc::SignalMissing;
use std::fmt::Display;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::console::print_problem;
use crate::exit::{Exit, Failure};
use crate::play_record::PlayRecord;
use judge::verdict::{Outcome, Verdict};
use judge::{Circumstances, judge_timing};
use plan::Plan;
use plan::catalogue::Catalogue;
use recording::ending::EndedBy;
use recording::foreign::Foreign;
use recording::frames::Log;
use recording::hits::Hits;
use recording::latency::Host;
use recording::reasons::Reasons;
use recording::run_folder::{file, file_in, log_in};
use recording::session::read_plan;
use recording::sources::Sent;
use recording::stalls::read_stalls;
use recording::timeline::{self, Timeline};
use recording::unrecorded::Unrecorded;

/// Largest `verdict.json` that is read: a scenario of 1 MiB may name its requirements in four rows for each time that it names
/// them.
const VERDICT_BYTES_MAX: u64 = 16 << 20;

/// Recording: a run folder, or a log of `candump -L` and the scenario that was played.
pub struct Recorded {
    /// Path that the user named.
    pub path: PathBuf,
    /// Plan that was played.
    pub plan: Plan,
    /// Frames of the recording.
    pub log: Log,
    /// Verdict of the run; `None` for a log that canrig has not written.
    pub stored: Option<Verdict>,
    /// Stalls of the nodes, and the frames that canrig's nodes sent; only the folder of a run in real time has them.
    pub host: Host,
    /// Hits of the scenario's faults; `None` if the recording does not say it.
    hits: Option<Hits>,
    /// Frames that no node of the run sent; `None` if the senders are not known.
    foreign: Option<Foreign>,
    /// Reasons of canrig's nodes that may not have reached the bus.
    reasons: Reasons,
    /// Whether the recording is a run folder.
    pub is_folder: bool,
    /// Whether the recording is the folder of a long run, whose log and signals are compressed.
    pub is_long: bool,
}

/// Recording that was decoded and judged.
pub(crate) struct JudgedRecording {
    pub(crate) recorded: Recorded,
    pub(crate) timelines: Vec<Timeline>,
    pub(crate) verdict: Verdict,
    /// Record of the play; `None` if it is missing or damaged, which only `coverage` refuses.
    pub(crate) record: Option<PlayRecord>,
}

impl Recorded {
    /// Reads a run folder, or a log with the scenario `played` or the `scenario.toml` in its folder. The catalogue is used only
    /// for facts that the folder lacks.
    ///
    /// # Errors
    /// A file is missing or not valid. A log that breaks off is no error, nor is the missing log of a run that broke off.
    pub fn load(
        path: &Path,
        played: Option<&Path>,
        catalogue: &Catalogue,
    ) -> Result<Self, Failure> {
        let is_folder = is_folder(path)?;
        let (folder, log_path) = if is_folder {
            require_run(path)?;
            (path, require_inside(path, log_in(path))?)
        } else {
            let folder = path.parent().unwrap_or(Path::new("."));
            (folder, path.to_owned())
        };
        if played.is_none() && !is_folder && !folder.join(file::SCENARIO).exists() {
            let reason = format!(
                "`{}`: a log does not name the scenario that was played; name it with --scenario FILE",
                path.display()
            );
            return Err(Exit::CannotStart.because(reason));
        }
        let (plan, stored) = match played {
            Some(played) => (Plan::load(played, catalogue)?, None),
            None => read_played(folder, catalogue)?,
        };
        let log = read_log(&log_path, stored.as_ref())?;
        if log.frames.is_empty() && !is_folder {
            let path = log_path.display();
            let broken = log.unread.broken.map(|broken| format!(" ({broken})"));
            let reason = format!("`{path}` holds no frame{}", broken.unwrap_or_default());
            return Err(Exit::CannotStart.because(reason));
        }
        let mut host = Host::default();
        let (mut hits, mut foreign) = (None, None);
        let mut reasons = Reasons::default();
        if is_folder {
            hits = Hits::read(folder).map_err(unreadable(folder.join(file::HITS)))?;
            reasons = Reasons::read(folder).map_err(unreadable(folder.join(file::REASONS)))?;
            foreign = Foreign::read(folder).map_err(unreadable(folder.join(file::FOREIGN)))?;
            host.stalls = read_stalls(folder).map_err(unreadable(folder.join(file::STALLS)))?;
            host.sent = Sent::read(folder).map_err(unreadable(folder.join(file::SENT)))?;
        }
        Ok(Self {
            path: path.to_owned(),
            plan,
            log,
            stored,
            host,
            hits,
            foreign,
            reasons,
            is_folder,
            is_long: log_path.ends_with(file::LONG_BUS_LOG),
        })
    }

    /// Returns the recording, decoded for each loop.
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub fn timelines(&self) -> Result<Vec<Timeline>, SignalMissing> {
        timeline::decode(&self.log.frames, &self.plan)
    }

    /// Decodes the recording, and takes its verdict by [`Recorded::judge`] or [`Recorded::verdict`].
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub(crate) fn judged(
        self,
        verdict: fn(&Self, &[Timeline]) -> Result<Verdict, SignalMissing>,
    ) -> Result<JudgedRecording, SignalMissing> {
        let timelines = self.timelines()?;
        Ok(JudgedRecording {
            verdict: verdict(&self, &timelines)?,
            record: PlayRecord::read(&self.path).ok().flatten(),
            recorded: self,
            timelines,
        })
    }

    /// Judges the recording as if the run had just ended. A run that broke off stays incomplete, with its own reason.
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub fn judge(&self, timelines: &[Timeline]) -> Result<Verdict, SignalMissing> {
        let stored = self.stored.as_ref();
        let ended_early = stored.and_then(|stored| stored.ended_early.clone());
        let timing = stored.and_then(|stored| stored.timing.clone());
        let timed = timing.clone().unwrap_or_default();
        let circumstances = Circumstances {
            unrecorded: self.unrecorded(timelines),
            ended_early: ended_early.clone().filter(|end| end.by != EndedBy::User),
            host: Host {
                controller: timed.controller,
                plant_emulator: timed.plant_emulator,
                on_this_machine: timed.on_this_machine,
                ..self.host.clone()
            },
        };
        let mut verdict = Verdict {
            identity: stored.and_then(|stored| stored.identity.clone()),
            tries: stored.and_then(|stored| stored.tries.clone()),
            ..judge::judge(&self.plan, timelines, &circumstances)
        };
        let is_incomplete = |stored: &&Verdict| stored.outcome == Outcome::Incomplete;
        // A drive that is still on fails even a run that the bench ended.
        let is_on = verdict.ended_early.is_some() && verdict.outcome == Outcome::Fail;
        if let Some(stored) = stored.filter(is_incomplete).filter(|_| !is_on) {
            verdict.outcome = Outcome::Incomplete;
            verdict.reason.clone_from(&stored.reason);
            verdict.ended_early = ended_early;
        }
        if self.is_folder && stored.is_none() {
            let reason = format!("the run broke off before there was a {}", file::VERDICT);
            verdict.outcome = Outcome::Incomplete;
            verdict.reason = Some(reason);
        }
        if let Some(timing) = timing {
            let again = timing.again(&self.log.frames, &self.plan)?;
            let expect = &self.plan.shared.run.expect;
            judge_timing(&mut verdict, again, expect, &self.host.stalls);
        }
        Ok(verdict)
    }

    /// Returns the number of further passes over the frames in [`Recorded::judge`]: for the times of each loop, if the run has
    /// any.
    pub fn passes_for_timing(&self) -> u64 {
        let stored = self.stored.as_ref();
        if stored.is_some_and(|stored| stored.timing.is_some()) {
            self.plan.loops.len() as u64
        } else {
            0
        }
    }

    /// Returns the traffic that is not among the frames: the losses that the run noted, and the lines of its log that cannot be
    /// read.
    fn unrecorded(&self, timelines: &[Timeline]) -> Unrecorded {
        let duration_seconds = self.plan.shared.run.duration_seconds;
        let zero = timelines.first().and_then(|timeline| timeline.zero_seconds);
        let end = zero.and_then(|zero| Duration::try_from_secs_f64(zero + duration_seconds).ok());
        let stored = |count: fn(&Verdict) -> u64| self.stored.as_ref().map_or(0, count);
        let unread = &self.log.unread;
        Unrecorded {
            frames_lost: stored(|stored| stored.frames_lost),
            fd_frames: stored(|stored| stored.fd_frames) + unread.fd_frames,
            hits: self.hits.clone(),
            foreign: self.foreign.clone(),
            reasons: self.reasons.clone(),
            unreadable_lines: unread.unreadable_until(end.unwrap_or(Duration::MAX)),
        }
    }

    /// Returns the verdict of the run itself, or the one it would have had.
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub fn verdict(&self, timelines: &[Timeline]) -> Result<Verdict, SignalMissing> {
        match &self.stored {
            Some(stored) => Ok(stored.clone()),
            None => self.judge(timelines),
        }
    }
}

/// Returns the plan that was played, and the verdict of the run if there is one.
///
/// # Errors
/// A file cannot be read or is not valid.
pub fn read_played(
    folder: &Path,
    catalogue: &Catalogue,
) -> Result<(Plan, Option<Verdict>), Failure> {
    let verdict = read_verdict(&require_inside(folder, file::VERDICT)?)?;
    let external = verdict.as_ref().map(|verdict| verdict.external.as_slice());
    let plan = read_plan(folder, external, catalogue)?;
    Ok((plan, verdict))
}

/// Returns the path of a file in a folder that may come from elsewhere.
///
/// # Errors
/// A link leads out of the folder.
pub fn require_inside(folder: &Path, name: &str) -> Result<PathBuf, Failure> {
    file_in(folder, name).map_err(unreadable(folder.join(name)))
}

/// Returns the conversion of an error of the system on reading a file.
pub fn unreadable(path: impl AsRef<Path>) -> impl FnOnce(io::Error) -> Failure {
    move |error| {
        let path = path.as_ref().display();
        Exit::CannotStart.because(format!("`{path}` cannot be read: {error}"))
    }
}

/// Returns whether a path that exists is a folder.
fn is_folder(path: &Path) -> Result<bool, Failure> {
    let metadata = path.metadata().map_err(unreadable(path))?;
    Ok(metadata.is_dir())
}

/// Refuses a path that is not a run folder.
///
/// # Errors
/// The folder has many runs or none, or cannot be read.
pub fn require_run(path: &Path) -> Result<(), Failure> {
    if !is_folder(path)? || !path.join(file::SCENARIO).exists() {
        let (path, scenario) = (path.display(), file::SCENARIO);
        let reason = format!("`{path}` is not a run folder (no {scenario} in it)");
        Err(Exit::CannotStart.because(reason))
    } else if holds_many_runs(path) {
        Err(many_runs(path))
    } else {
        Ok(())
    }
}

fn many_runs(path: &Path) -> Failure {
    let path = path.display();
    Exit::CannotStart.because(format!(
        "`{path}` is the folder of a sweep or of torture, not of a run"
    ))
}

/// Returns whether a folder is that of a campaign, or of a part of one.
pub fn holds_many_runs(folder: &Path) -> bool {
    let mut names = [file::ROWS, file::ENGINE].iter();
    names.any(|name| folder.join(name).exists())
}

/// Returns the folders of runs and campaigns: a folder that is none, but contains some, is replaced by these.
pub fn opened(folders: &[PathBuf]) -> Vec<PathBuf> {
    let is_one = |path: &Path| path.join(file::SCENARIO).exists() || holds_many_runs(path);
    let opened = folders.iter().flat_map(|folder| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let mut found = Vec::from_iter(
            entries
                .map(|entry| entry.path())
                .filter(|path| is_one(path)),
        );
        found.sort();
        if is_one(folder) || found.is_empty() {
            vec![folder.clone()]
        } else {
            found
        }
    });
    opened.collect()
}

/// Returns the folders that are runs. Folders of sweeps, which are among them in `runs/*`, are reported and left out. If there
/// are no others, they are returned, so that they are refused with a reason.
pub(crate) fn runs_among(folders: &[PathBuf]) -> Vec<&Path> {
    let folders = folders.iter().map(PathBuf::as_path);
    let (others, runs): (Vec<_>, Vec<_>) = folders.partition(|folder| holds_many_runs(folder));
    if runs.is_empty() {
        return others;
    }
    for path in others {
        print_problem(format!("{}; it is left out", many_runs(path)));
    }
    runs
}

fn read_log(path: &Path, stored: Option<&Verdict>) -> Result<Log, Failure> {
    let is_incomplete = stored.is_some_and(|stored| stored.outcome == Outcome::Incomplete);
    match Log::read(path) {
        // The run was killed before there was a log.
        Err(error) if error.kind() == io::ErrorKind::NotFound && is_incomplete => {
            let mut log = Log::default();
            log.unread.broken = Some("there is none".to_owned());
            Ok(log)
        }
        read => read.map_err(unreadable(path)),
    }
}

/// Reads the verdict of a run; `None` if there is no file. The file is written as a whole, so one that cannot be read back was
/// damaged.
fn read_verdict(path: &Path) -> Result<Option<Verdict>, Failure> {
    let damaged = |reason: &dyn Display| {
        let path = path.display();
        Exit::CannotStart.because(format!(
            "`{path}` is damaged: {reason}. Without this file, the frames are judged as those of a run that broke off: move it away for that"
        ))
    };
    match scenario::read_text(path, VERDICT_BYTES_MAX) {
        Ok(text) => Verdict::from_json(&text)
            .map(Some)
            .map_err(|error| damaged(&error)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) if error.kind() == io::ErrorKind::InvalidData => Err(damaged(&error)),
        Err(error) => Err(unreadable(path)(error)),
    }
}
