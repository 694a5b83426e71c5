//! Scenarios played one after the other: what `canrig run` and `canrig simulate` share.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::console::{complain_of, usage};
use crate::event::{Listener, RunEvent};
use crate::exit::Exit;
use crate::observer::observed;
use crate::run::{Judged, run};
use crate::terminal::Terminal;
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use report::viewer::{ViewerAddress, Viewers};
use rig::rig_file::RIG_FILE;
use rig::setup::Setup;
use worlds::catalogue::catalogue;
use worlds::{Played, WorldError};

/// Levels of folders that are searched for scenarios.
const FOLDER_DEPTH_MAX: u32 = 8;

/// Scenarios and what to do with their results.
#[derive(Args, Debug)]
pub struct PlayArgs {
    /// Scenario files, or folders of them
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<PathBuf>,
    /// Where run folders are made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Print the verdicts as JSON instead of tables
    #[arg(long)]
    pub json: bool,
    /// Print nothing but failures
    #[arg(long, short, conflicts_with = "json")]
    pub quiet: bool,
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub viewer: ViewerArgs,
}

/// Where to show what happens.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewerArgs {
    /// Open the Rerun viewer and show the run in it while it goes on
    #[arg(long)]
    pub viewer: bool,
    /// Show the run in a viewer that is already open: PORT on this machine, HOST:PORT, or the viewer's own address
    #[arg(long, value_name = "ADDRESS")]
    pub rerun_connect: Option<ViewerAddress>,
}

impl ViewerArgs {
    /// Opens or finds the viewers, and says which cannot be had.
    #[must_use]
    pub fn open(&self) -> (Viewers, Vec<String>) {
        Viewers::open(self.viewer, self.rerun_connect.as_ref())
    }
}

/// Where scenarios are played, and which of them.
pub(crate) trait Stage {
    /// Puts a scenario on the rig of the stage.
    ///
    /// # Errors
    /// Why it cannot be played here.
    fn prepare(&self, setup: Setup) -> Result<Setup, String>;

    /// What becomes of frames that a viewer is too slow for.
    fn when_full(&self) -> WhenFull;

    /// Plays a scenario.
    ///
    /// # Errors
    /// The world failed.
    fn play(
        &self,
        setup: &Setup,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError>;
}

/// Plays each scenario on a stage and reports; the worst exit of all.
pub(crate) fn play_all(args: &PlayArgs, stage: &dyn Stage, terminal: &Terminal) -> Exit {
    let paths = match scenario_files(&args.scenarios, is_scenario) {
        Ok(paths) => paths,
        Err(error) => return usage(&error),
    };
    let (mut viewers, refused) = args.viewer.open();
    fail_all(terminal, refused);
    let mut worst = Exit::Pass;
    let mut verdicts = Vec::new();
    for path in &paths {
        let (exit, judged) = match prepared(path, stage, terminal) {
            Ok(setup) => play_one(args, &setup, stage, terminal, &mut viewers),
            Err(exit) => (exit, None),
        };
        verdicts.extend(judged.map(|judged| judged.verdict));
        worst = worst.max(exit);
        if exit == Exit::Interrupted {
            break;
        }
    }
    terminal.hear(&RunEvent::Ended(&verdicts));
    worst
}

/// A scenario that can be played on the stage.
pub(crate) fn prepared(
    path: &Path,
    stage: &dyn Stage,
    listener: &dyn Listener,
) -> Result<Setup, Exit> {
    let setup = load(path)?;
    stage.prepare(setup).map_err(|reason| {
        listener.hear(&RunEvent::Failed(format!("{}: {reason}", path.display())));
        Exit::ScenarioInvalid
    })
}

/// Reads and checks a scenario file; says what is wrong with it.
///
/// # Errors
/// The exit code for it.
pub fn load(path: &Path) -> Result<Setup, Exit> {
    Setup::load(path, catalogue()).map_err(|error| {
        complain_of(error);
        Exit::ScenarioInvalid
    })
}

fn play_one(
    args: &PlayArgs,
    setup: &Setup,
    stage: &dyn Stage,
    listener: &dyn Listener,
    viewers: &mut Viewers,
) -> (Exit, Option<Judged>) {
    let (scenario, path) = (&setup.scenario, &setup.path);
    if let Some(sweep) = &scenario.sweep {
        let (runs, path) = (sweep.runs(), path.display());
        listener.hear(&RunEvent::Note(format!(
            "note: this is the scenario as it stands; `canrig sweep {path}` plays its {runs} runs"
        )));
    }
    let watch = Watch::default();
    listener.hear(&RunEvent::Began {
        duration_seconds: scenario.duration_seconds,
    });
    let (queues, shows) = viewers.show(setup, stage.when_full());
    let judged = run(setup, &args.output, &watch, queues, |folder, capture| {
        observed(
            || watch.interrupt(),
            || listener.hear(&RunEvent::Reached(watch.progress())),
            || stage.play(setup, folder, capture),
        )
    });
    match judged {
        Ok(judged) => {
            fail_all(listener, shows.end(&judged.verdict, viewers));
            listener.hear(&RunEvent::Judged {
                path,
                judged: &judged,
            });
            (judged.exit, Some(judged))
        }
        Err(error) => {
            listener.hear(&RunEvent::Failed(format!("{}: {error}", path.display())));
            (Exit::BenchFailed, None)
        }
    }
}

fn fail_all(listener: &dyn Listener, reasons: Vec<String>) {
    for reason in reasons {
        listener.hear(&RunEvent::Failed(reason));
    }
}

/// Rig files lie beside scenarios.
pub(crate) fn is_scenario(path: &Path) -> bool {
    !path.ends_with(RIG_FILE)
}

/// The scenario files that the arguments name: files as they are, folders with everything wanted below them in order.
pub(crate) fn scenario_files(
    arguments: &[PathBuf],
    is_wanted: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    for argument in arguments {
        if argument.is_dir() {
            let before = files.len();
            let searched = find_scenarios(argument, FOLDER_DEPTH_MAX, &mut files);
            searched.map_err(|error| format!("{} cannot be read: {error}", argument.display()))?;
            let found = files.split_off(before);
            files.extend(found.into_iter().filter(|path| is_wanted(path)));
            if files.len() == before {
                return Err(format!("{} holds no scenario (*.toml)", argument.display()));
            }
        } else {
            files.push(argument.clone());
        }
    }
    Ok(files)
}

fn find_scenarios(folder: &Path, depth: u32, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() && depth > 0 {
            find_scenarios(&path, depth - 1, files)?;
        } else if path
            .extension()
            .is_some_and(|extension| extension == "toml")
        {
            files.push(path);
        }
    }
    Ok(())
}
