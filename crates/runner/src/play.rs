//! Plays scenarios one after the other: the common part of `canrig run` and `canrig simulate`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use scenario::Override;
use scenario::rig::shipped;

use crate::console::failed;
use crate::event::{Listener, RunEvent};
use crate::exit::{Exit, Failure};
use crate::lines::EventLines;
use crate::number;
use crate::observer::observed;
use crate::run::{COMPRESS_ABOVE_SECONDS, Judged, RUNS, RunPlace, passes_to_files, run};
use crate::scenarios::{Use, is_to_play, load_for, scenario_files};
use crate::terminal::Terminal;
use plan::Plan;
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use report::viewer::{ViewerAddress, Viewers};
use worlds::law_process::started_by;
use worlds::programs::Hosting;
use worlds::{Played, WorldError};

/// Scenarios and what to do with their results.
#[derive(Args, Debug)]
pub struct PlayArgs {
    /// Scenario files, or folders of them
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<PathBuf>,
    /// Folder in which the run folders are made
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Print the verdicts as JSON instead of tables
    #[arg(long)]
    pub json: bool,
    /// Print what happens as lines of JSON, for another program
    #[arg(long, conflicts_with = "json")]
    pub events: bool,
    /// Print failures only
    #[arg(long, short, conflicts_with_all = ["json", "events"])]
    pub quiet: bool,
    /// Fail a run that passes although nothing was limited
    #[arg(long)]
    pub strict: bool,
    /// Compress log and signals, and thin the recording for the viewer, of runs longer than this
    #[arg(long, value_name = "SECONDS", default_value_t = COMPRESS_ABOVE_SECONDS)]
    pub compress_above: f64,
    #[command(flatten)]
    pub values: ValueArgs,
    #[command(flatten)]
    pub viewer: ViewerArgs,
}

/// Values that differ from those in the files.
#[derive(Args, Clone, Debug, Default)]
pub struct ValueArgs {
    /// Play with another value, such as reference.step[0].position_millimetres=20
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<Override>,
    /// Play on another rig in place of the scenario's: a rig file, such as that of a real drive, or the name of one that ships
    #[arg(long, value_name = "RIG")]
    pub rig: Option<PathBuf>,
    /// Behind `--`: a program that plays the controller, with its arguments; the scenario's law is left out
    #[arg(last = true, value_name = "PROGRAM")]
    pub program: Vec<String>,
}

/// Nodes that canrig does not play itself.
#[derive(Args, Clone, Debug)]
pub struct GuestArgs {
    /// Nodes of the rig that canrig does not start but expects on the bus for 15 s, such as a real drive; several with
    /// commas
    #[arg(long, value_name = "NODE", value_delimiter = ',')]
    pub external: Vec<String>,
    /// Seconds that the answer of a program may take in virtual time; `none` for a debugger
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = patience)]
    pub patience: Patience,
}

/// Longest time for an answer; unlimited if `None`.
pub type Patience = Option<Duration>;

impl GuestArgs {
    /// Returns how programs are hosted whose output is kept in a folder, if there is one.
    pub(crate) fn hosting<'a>(
        &self,
        logs: Option<&'a Path>,
        announce: &'a dyn Fn(&str),
    ) -> Hosting<'a> {
        Hosting {
            logs,
            patience: self.patience,
            announce,
        }
    }
}

fn patience(text: &str) -> Result<Patience, String> {
    const HELP: &str = "a number of seconds from 0.1 to 86400, or `none`";
    if text == "none" {
        return Ok(None);
    }
    let seconds = number::parse(text, 0.1..=86_400.0, HELP, HELP)?;
    Ok(Some(Duration::from_secs_f64(seconds)))
}

impl ValueArgs {
    /// Returns whether nothing differs from the files.
    pub(crate) fn is_empty(&self) -> bool {
        self.overrides.is_empty() && self.rig.is_none() && self.program.is_empty()
    }

    /// Returns the rig file that replaces the scenario's; `None` for one that ships.
    pub(crate) fn rig_file(&self) -> Option<&Path> {
        let rig = self.rig.as_deref()?;
        let shipped = rig.to_str().and_then(shipped::text);
        shipped.is_none().then_some(rig)
    }

    /// Returns all values, including the rig.
    ///
    /// # Panics
    /// Never: any text can be a value.
    pub fn all(&self) -> Vec<Override> {
        let name = self.rig.as_deref().map(|rig| match self.rig_file() {
            Some(file) => {
                let name = file.file_name().unwrap_or_default();
                shipped::copied_name(&name.to_string_lossy())
            }
            None => rig.to_string_lossy().into_owned(),
        });
        let key = |name| format!("rig={name:?}").parse();
        let rig = name.map(|name: String| key(name).expect("a key and a value"));
        self.overrides.iter().cloned().chain(rig).collect()
    }
}

impl PlayArgs {
    /// Returns the listener that prints events, as far as the user wants them.
    pub(crate) fn listener(&self) -> Box<dyn Listener> {
        if self.events {
            Box::new(EventLines)
        } else {
            Box::new(Terminal::new(self.json, self.quiet))
        }
    }
}

/// Where to show what happens.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewerArgs {
    /// Open the Rerun viewer and show the run in it
    #[arg(long)]
    pub viewer: bool,
    /// Show the run in a viewer that is open already: PORT on this machine, HOST:PORT, or the address that the viewer
    /// prints
    #[arg(long, value_name = "ADDRESS")]
    pub rerun_connect: Option<ViewerAddress>,
}

impl ViewerArgs {
    /// Opens or finds the viewers, and returns the reasons why some are missing.
    pub fn open(&self) -> (Viewers, Vec<String>) {
        Viewers::open(self.viewer, self.rerun_connect.as_ref())
    }
}

/// Place where scenarios are played, which decides which of them can be.
pub(crate) trait Testbed {
    /// Returns the names of the nodes that the command line makes external.
    fn external(&self) -> &[String];

    /// Puts a plan on the rig of the testbed.
    ///
    /// # Errors
    /// The reason why the plan cannot be played here.
    fn prepare(&self, plan: Plan) -> Result<Plan, String>;

    /// Returns whether no further scenario may be played on the testbed.
    fn is_over(&self) -> bool {
        false
    }

    /// Returns the treatment of frames for which a viewer is too slow.
    fn when_full(&self) -> WhenFull;

    /// Plays a plan.
    ///
    /// # Errors
    /// The world failed.
    fn play(
        &mut self,
        plan: &Plan,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError>;

    /// Looks at a run that was judged.
    fn check(&mut self, _plan: &Plan, _judged: &Judged, _watch: &Watch) {}
}

/// Plays each scenario on a testbed and reports events; returns the worst exit of all.
pub(crate) fn play_all(
    args: &PlayArgs,
    testbed: &mut dyn Testbed,
    listener: &dyn Listener,
) -> Result<Exit, Failure> {
    let paths = scenario_files(&args.scenarios, is_to_play)?;
    let (mut viewers, refused) = args.viewer.open();
    report_all(listener, refused);
    let watch = Watch::default();
    let mut worst = Exit::Pass;
    let mut verdicts = Vec::new();
    // Signals are observed from the first scenario to the last, also while a run is judged. A signal there would be lost
    // otherwise, and the next scenario be played.
    observed(
        || watch.interrupt(),
        || {
            if let Some(progress) = watch.progress() {
                listener.on_event(&RunEvent::Reached(progress));
            }
        },
        || {
            for path in &paths {
                let (exit, judged) = match prepared(path, &args.values, testbed, listener) {
                    Ok(plan) => play_one(args, &plan, testbed, listener, &watch, &mut viewers),
                    Err(exit) => (exit, None),
                };
                verdicts.extend(judged.map(|judged| judged.verdict));
                worst = worst.max(exit);
                if watch.is_interrupted() || testbed.is_over() {
                    break;
                }
            }
        },
    );
    if watch.is_interrupted() {
        worst = worst.max(Exit::Interrupted);
    }
    listener.on_event(&RunEvent::Ended(&verdicts));
    Ok(worst)
}

/// Returns the plan of a scenario that can be played on the testbed.
pub(crate) fn prepared(
    path: &Path,
    values: &ValueArgs,
    testbed: &dyn Testbed,
    listener: &dyn Listener,
) -> Result<Plan, Exit> {
    let wanted = Use {
        external: testbed.external(),
        ..Use::default()
    };
    let plan = load_for(path, values, &wanted).map_err(failed)?;
    testbed.prepare(plan).map_err(|reason| {
        listener.on_event(&RunEvent::Failed(format!("`{}`: {reason}", path.display())));
        Exit::CannotStart
    })
}

/// Returns the same plan in virtual time, in which nodes of the command line come to their seats. A node that is external by its
/// rig file has a time of its own.
///
/// # Errors
/// The nodes that are external by their rig file.
pub(crate) fn in_virtual_time(plan: Plan, external: &[String]) -> Result<Plan, String> {
    let names = plan.expected_names();
    if !names.is_empty() {
        return Err(format!(
            "external: {}: an external node keeps its own time; play on its bus, as in `canrig run SCENARIO --bus can0`, or in virtual time on a rig without a real drive",
            names.join(", ")
        ));
    }
    let plan = plan.with_external(external)?;
    plan.admits_faults()?;
    Ok(plan)
}

fn play_one(
    args: &PlayArgs,
    plan: &Plan,
    testbed: &mut dyn Testbed,
    listener: &dyn Listener,
    watch: &Watch,
    viewers: &mut Viewers,
) -> (Exit, Option<Judged>) {
    let (shared, path) = (&plan.shared, plan.shared.beside.scenario());
    if let Some(sweep) = &shared.sweep {
        let (runs, path) = (sweep.runs(), path.display());
        listener.on_note(format!(
            "note: this is the scenario as it stands; `canrig sweep {path}` plays its {runs} runs"
        ));
    }
    for started in started_by(plan) {
        listener.on_note(started);
    }
    listener.on_event(&RunEvent::Began {
        duration_seconds: shared.run.duration_seconds,
    });
    let (queues, shows) = viewers.show(plan, testbed.when_full());
    let place = RunPlace {
        parent: &args.output,
        is_long: shared.run.duration_seconds > args.compress_above,
        overrides: &args.values.all(),
        is_strict: args.strict,
    };
    let judged = run(plan, place, watch, queues, |folder, capture| {
        let played = testbed.play(plan, folder, capture);
        played.inspect(|played| {
            let passes = passes_to_files(played, plan.loops.len());
            listener.on_event(&RunEvent::Played { passes });
        })
    });
    match judged {
        Ok(judged) => {
            testbed.check(plan, &judged, watch);
            report_all(listener, shows.end(&judged.verdict, viewers));
            listener.on_event(&RunEvent::Judged {
                path,
                judged: &judged,
            });
            (judged.exit, Some(judged))
        }
        Err(error) => {
            listener.on_event(&RunEvent::Failed(format!("`{}`: {error}", path.display())));
            (Exit::BenchFailed, None)
        }
    }
}

fn report_all(listener: &dyn Listener, reasons: Vec<String>) {
    for reason in reasons {
        listener.on_event(&RunEvent::Failed(reason));
    }
}
