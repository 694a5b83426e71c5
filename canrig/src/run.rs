//! One scenario from file to verdict.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;

use dbc::{Database, SignalMissing};
use plant_emulator::{InvalidEmulator, catalogue};
use scenario::{Objection, Scenario, ScenarioError};

use crate::capture::{Capture, Watch};
use crate::console::complain;
use crate::exit::Exit;
use crate::external::External;
use crate::frames::Frames;
use crate::gauge::Gauge;
use crate::judge::{self, judge, judge_broken};
use crate::report;
use crate::rig::LoadedRig;
use crate::run_folder::{RunFolder, WriteError, file};
use crate::signal_names::SignalNames;
use crate::tap::Tap;
use crate::timeline::{self, Timeline};
use crate::timing::{Host, Timing};
use crate::verdict::Verdict;
use crate::world::{End, WorldError};
use dbc::scenario_clock::ScenarioClock;

/// A scenario as it lies on the disk.
pub struct Source {
    /// Its file.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    /// Its meaning.
    pub scenario: Scenario,
    /// Which nodes are not canrig's when it is played.
    pub external: External,
    /// The rig that it is played on; none for the emulated one.
    pub rig: Option<Arc<LoadedRig>>,
}

impl Source {
    /// Reads and checks a scenario file.
    ///
    /// # Errors
    /// The file cannot be read or is no valid scenario.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let (scenario, text) = Scenario::load_with_text(path, objections)?;
        Ok(Self {
            path: path.to_owned(),
            text,
            scenario,
            external: External::default(),
            rig: None,
        })
    }

    /// As [`Source::load`]; what is wrong with the file is told.
    ///
    /// # Errors
    /// The exit code for it.
    pub fn load_or_complain(path: &Path) -> Result<Self, Exit> {
        Self::load(path).map_err(|error| {
            complain(&format!("{:?}", miette::Report::new(error)));
            Exit::ScenarioInvalid
        })
    }

    /// The same on a rig, whose bus takes the place of the scenario's.
    #[must_use]
    pub fn on(mut self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        if let Some(loaded) = &rig {
            self.scenario.bus = loaded.rig.bus.of_scenario();
        }
        let terms = Frames::of(&self.scenario).law_terms();
        let rig = rig.map(|loaded| LoadedRig::led_by(loaded, terms));
        Self {
            external,
            rig,
            ..self
        }
    }

    /// What the frames of the bus mean.
    #[must_use]
    pub fn database(&self) -> &Database {
        match &self.rig {
            Some(rig) => &rig.database,
            None => self.external.database(&self.scenario),
        }
    }
}

/// What only the bench knows to be wrong in a scenario: names of signals, and a plant that makes no physical sense.
fn objections(scenario: &Scenario) -> Vec<Objection> {
    let mut objections = SignalNames::objections(scenario);
    if let Err(InvalidEmulator::Plant(invalid)) = catalogue::check(scenario) {
        let plant = scenario.plant.name();
        let path = match invalid.parameter() {
            Some(parameter) => format!("plant.{plant}.{parameter}"),
            None => format!("plant.{plant}"),
        };
        objections.push(Objection {
            path,
            message: format!("the plant `{plant}` makes no physical sense"),
            label: invalid.to_string(),
            help: None,
        });
    }
    objections
}

/// What a run left.
pub struct Judged {
    /// The verdict.
    pub verdict: Verdict,
    /// Its folder.
    pub folder: PathBuf,
    /// How the program ends.
    pub exit: Exit,
}

/// Why the files of a run are not complete.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The DBC lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// A report cannot be made.
    #[error("{name} cannot be made: {reason}")]
    Report {
        /// Which one.
        name: &'static str,
        /// Why.
        reason: String,
    },
}

impl RunError {
    fn report(name: &'static str, error: &dyn std::error::Error) -> Self {
        Self::Report {
            name,
            reason: error.to_string(),
        }
    }
}

/// Plays the scenario in a world, records and judges it, and hands the frames on to the taps meanwhile. What was
/// recorded before a failure of the world is kept, with a verdict that says "incomplete" and why.
///
/// # Errors
/// The files of the run cannot be written.
pub fn run(
    source: &Source,
    parent: &Path,
    watch: &Watch,
    taps: Vec<Tap>,
    world: impl FnOnce(&RunFolder, &mut Capture<'_>) -> Result<World, WorldError>,
) -> Result<Judged, RunError> {
    let scenario = &source.scenario;
    let database = source.database();
    let folder = RunFolder::create(parent, source)?;
    let gauge = Gauge::new(scenario, database)?;
    let clock = ScenarioClock::new(database)?;
    let mut capture = Capture::new(folder.bus_log()?, gauge, clock, watch, taps);
    let ended = world(&folder, &mut capture);
    let (frames, frames_lost) = capture.finish()?;
    let timeline = timeline::decode(&frames, scenario, database)?;
    let mut verdict = verdict(&ended, &timeline, scenario, frames_lost);
    verdict.external = source.external.clone();
    if let Ok(World {
        host: Some(host), ..
    }) = &ended
    {
        let timing = Timing::of(&frames, scenario, database, host.clone())?;
        judge::judge_timing(&mut verdict, timing, &scenario.expect);
    }
    let run = report::html::Run {
        text: &source.text,
        scenario,
        frames: &frames,
        timeline: &timeline,
        verdict: &verdict,
    };
    write_reports(&folder, &run, database)?;
    let exit = match ended {
        Ok(World {
            end: End::Interrupted,
            ..
        }) => Exit::Interrupted,
        _ => verdict.outcome.exit(),
    };
    Ok(Judged {
        verdict,
        folder: folder.path().to_owned(),
        exit,
    })
}

/// What a run came to, however its world ended.
#[must_use]
pub fn verdict(
    ended: &Result<World, WorldError>,
    timeline: &Timeline,
    scenario: &Scenario,
    frames_lost: u64,
) -> Verdict {
    match ended {
        Err(error) => {
            let error = with_cause(error, timeline, frames_lost);
            judge_broken(timeline, scenario, &error)
        }
        Ok(World {
            end: End::Interrupted,
            ..
        }) => Verdict::incomplete_of(scenario, "interrupted by the user"),
        Ok(_) => judge(timeline, scenario, frames_lost),
    }
}

/// A busy machine looks like a broken node; where it was busy, that is said too.
fn with_cause(error: &WorldError, timeline: &Timeline, frames_lost: u64) -> String {
    let busy = judge::too_many_missed(timeline);
    let lost = (frames_lost > 0).then(|| judge::lost_frames(frames_lost));
    let causes = busy.into_iter().chain(lost);
    causes.fold(error.to_string(), |text, cause| format!("{text}\n{cause}"))
}

/// How a world ended.
pub struct World {
    /// Whether it came to the scenario's end.
    pub end: End,
    /// What the host knows of the timing; none in virtual time.
    pub host: Option<Host>,
}

impl World {
    /// A world without a clock, which loses nothing.
    #[must_use]
    pub fn in_virtual_time(end: End) -> Self {
        Self { end, host: None }
    }
}

/// Makes the files of a judged run. The recording takes as long as all others, so they are made beside it. The verdict comes
/// last, since it says that the folder is complete.
fn write_reports(
    folder: &RunFolder,
    run: &report::html::Run<'_>,
    database: &Database,
) -> Result<(), RunError> {
    thread::scope(|scope| {
        let beside = scope.spawn(|| write_tables_and_page(folder, run, database));
        let recorded = write_recording(folder, run, database);
        beside
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        recorded
    })?;
    Ok(folder.write_verdict(run.verdict)?)
}

fn write_tables_and_page(
    folder: &RunFolder,
    run: &report::html::Run<'_>,
    database: &Database,
) -> Result<(), RunError> {
    folder.write_with(file::SIGNALS, |output| {
        report::csv::write(output, run.timeline)
    })?;
    let junit = report::junit::to_xml(std::slice::from_ref(run.verdict));
    let junit = junit.map_err(|error| RunError::report(file::JUNIT, &error))?;
    folder.write(file::JUNIT, junit.as_bytes())?;
    let page = report::html::to_html(run, database)?;
    Ok(folder.write(file::REPORT, page.as_bytes())?)
}

#[cfg(feature = "rerun")]
fn write_recording(
    folder: &RunFolder,
    run: &report::html::Run<'_>,
    database: &Database,
) -> Result<(), RunError> {
    let path = folder.path().join(file::RERUN);
    let (frames, timeline, verdict) = (run.frames, run.timeline, run.verdict);
    report::rerun::write(&path, frames, timeline, verdict, run.scenario, database)
        .map_err(|error| RunError::report(file::RERUN, &error))
}

#[cfg(not(feature = "rerun"))]
fn write_recording(
    _folder: &RunFolder,
    _run: &report::html::Run<'_>,
    _database: &Database,
) -> Result<(), RunError> {
    Ok(())
}
