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
use crate::scenarios::{Use, is_to_play, load_for, playable, scenario_files};
use crate::terminal::Terminal;
use judge::verdict::{SpoiledPlay, Tries};
use plan::Plan;
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use report::ReportError;
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

    /// Returns how often a plan is played at most while stalls of the computer spoil each play.
    fn tries(&self, _plan: &Plan) -> u32 {
        1
    }

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
    let plan = load_for(path, values, &wanted).and_then(playable);
    let plan = plan.map_err(failed)?;
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
    let max = testbed.tries(plan);
    let mut earlier = Vec::new();
    let mut number = 1;
    loop {
        let tries = (number > 1).then(|| Tries {
            number,
            max,
            earlier: earlier.clone(),
        });
        let played = play_once(
            args,
            plan,
            tries.as_ref(),
            testbed,
            listener,
            watch,
            viewers,
        );
        let judged = match played {
            Ok(judged) => judged,
            Err(error) => {
                listener.on_event(&RunEvent::Failed(format!("`{}`: {error}", path.display())));
                return (Exit::BenchFailed, None);
            }
        };
        let is_last = number == max || watch.is_interrupted();
        if is_last || !judged.verdict.is_spoiled_by_stalls() {
            testbed.check(plan, &judged, watch);
            listener.on_event(&RunEvent::Judged {
                path,
                judged: &judged,
            });
            return (judged.exit, Some(judged));
        }
        let (folder, reason) = (judged.folder.display(), judged.verdict.reason.as_deref());
        listener.on_event(&RunEvent::Spoiled(format!(
            "{}: inconclusive (try {number} of {max}): {}; run folder {folder}; playing again",
            shared.run.name,
            reason.unwrap_or_default(),
        )));
        earlier.push(SpoiledPlay::new(&judged.verdict, &judged.folder));
        number += 1;
    }
}

/// Plays a plan once, records and judges it.
fn play_once(
    args: &PlayArgs,
    plan: &Plan,
    tries: Option<&Tries>,
    testbed: &mut dyn Testbed,
    listener: &dyn Listener,
    watch: &Watch,
    viewers: &mut Viewers,
) -> Result<Judged, ReportError> {
    let duration_seconds = plan.shared.run.duration_seconds;
    listener.on_event(&RunEvent::Began { duration_seconds });
    let (queues, shows) = viewers.show(plan, testbed.when_full());
    let place = RunPlace {
        parent: &args.output,
        is_long: duration_seconds > args.compress_above,
        overrides: &args.values.all(),
        is_strict: args.strict,
        tries,
    };
    let judged = run(plan, place, watch, queues, |folder, capture| {
        let played = testbed.play(plan, folder, capture);
        played.inspect(|played| {
            let passes = passes_to_files(played, plan.loops.len());
            listener.on_event(&RunEvent::Played { passes });
        })
    });
    let judged = judged?;
    report_all(listener, shows.end(&judged.verdict, viewers));
    Ok(judged)
}

fn report_all(listener: &dyn Listener, reasons: Vec<String>) {
    for reason in reasons {
        listener.on_event(&RunEvent::Failed(reason));
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::sync::Mutex;

    use judge::verdict::{Outcome, Verdict};
    use recording::latency::Host;
    use recording::stalls::{Stall, What, Who};
    use worlds::catalogue::catalogue;
    use worlds::lockstep;

    use super::*;

    const HANG: &str =
        "[[fault.node.hang]]\nfrom_seconds = 0.2\nuntil_seconds = 0.212\nnode = \"drive\"\n";

    /// Testbed whose first plays have a stall of the machine: the drive hangs meanwhile.
    struct Stalling {
        tries: u32,
        stalls: u32,
        plays: u32,
    }

    impl Testbed for Stalling {
        fn external(&self) -> &[String] {
            &[]
        }

        fn prepare(&self, plan: Plan) -> Result<Plan, String> {
            Ok(plan)
        }

        fn when_full(&self) -> WhenFull {
            WhenFull::Wait
        }

        fn tries(&self, _plan: &Plan) -> u32 {
            self.tries
        }

        fn play(
            &mut self,
            plan: &Plan,
            _folder: &RunFolder,
            capture: &mut Capture<'_>,
        ) -> Result<Played, WorldError> {
            self.plays += 1;
            if self.plays > self.stalls {
                let end = lockstep::simulate(plan, &Hosting::default(), capture)?;
                return Ok(Played::in_virtual_time(end));
            }
            let path = plan.shared.beside.scenario().with_extension("hang");
            fs::write(&path, format!("{}{HANG}", plan.shared.text)).unwrap();
            let hanging = Plan::load(&path, catalogue()).unwrap();
            let end = lockstep::simulate(&hanging, &Hosting::default(), capture)?;
            let zero = capture.zero().unwrap();
            let [from, until] = [199, 213].map(|at| zero + Duration::from_millis(at));
            let host = Host {
                stalls: vec![Stall::new(from, until, Who::Machine, What::StoodStill)],
                ..Host::default()
            };
            let host = Some(host);
            Ok(Played { end, host })
        }
    }

    #[derive(Default)]
    struct Heard {
        spoiled: Mutex<Vec<String>>,
        judged: Mutex<Vec<Verdict>>,
    }

    impl Listener for Heard {
        fn on_event(&self, event: &RunEvent<'_>) {
            match event {
                RunEvent::Spoiled(text) => self.spoiled.lock().unwrap().push(text.clone()),
                RunEvent::Judged { judged, .. } => {
                    self.judged.lock().unwrap().push(judged.verdict.clone());
                }
                RunEvent::Failed(reason) => panic!("{reason}"),
                _ => {}
            }
        }
    }

    /// Plays a warm hold with a limit. Returns the verdict that counts, the notes on spoiled plays,
    /// and the number of plays.
    fn played(folder: &Path, limit: &str, tries: u32, stalls: u32) -> (Verdict, Vec<String>, u32) {
        let path = folder.join("hold.toml");
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"hold\"\nduration_seconds = 0.5\n[expect]\n{limit}\n\
             [controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n"
        );
        fs::write(&path, text).unwrap();
        let args = PlayArgs {
            scenarios: vec![path],
            output: folder.join("runs"),
            json: false,
            events: false,
            quiet: true,
            strict: false,
            compress_above: 600.0,
            values: ValueArgs::default(),
            viewer: ViewerArgs::default(),
        };
        let mut testbed = Stalling {
            tries,
            stalls,
            plays: 0,
        };
        let heard = Heard::default();
        let _ = play_all(&args, &mut testbed, &heard).unwrap();
        let verdict = heard.judged.into_inner().unwrap().remove(0);
        (verdict, heard.spoiled.into_inner().unwrap(), testbed.plays)
    }

    const LIMIT: &str = "missed_cycles_percent = { max = 1.0 }";

    #[test]
    fn a_play_that_stalls_spoiled_is_repeated_and_told() {
        let folder = tempfile::tempdir().unwrap();
        let (verdict, spoiled, plays) = played(folder.path(), LIMIT, 3, 1);
        assert_eq!((verdict.outcome, plays), (Outcome::Pass, 2));
        assert!(spoiled[0].contains("(try 1 of 3)"), "{spoiled:?}");
        assert_eq!(spoiled.len(), 1);
        let line = report::terminal::line(&verdict);
        assert!(
            line.starts_with("hold: pass (try 2 of 3; try 1: stalls; missed_cycles_percent "),
            "{line}"
        );
        assert!(line.ends_with(", limit ≤ 1)"), "{line}");
        let tries = verdict.tries.unwrap();
        let [earlier] = &tries.earlier[..] else {
            panic!("{tries:?}");
        };
        assert!(earlier.reason.contains("stood still"), "{earlier:?}");
        let runs = folder.path().join("runs");
        assert!(runs.join(&earlier.folder).join("verdict.json").exists());
        // The play that counts is the second one, in the folder with a number.
        let last = runs.join(format!("{}-2", earlier.folder));
        let read = |name: &str| fs::read_to_string(last.join(name)).unwrap();
        let stored = Verdict::from_json(&read("verdict.json")).unwrap();
        assert_eq!(stored.tries, Some(tries));
        let junit = read("junit.xml");
        let property = r#"<property name="try 1" value="inconclusive: "#;
        assert!(junit.contains(property), "{junit}");
        assert!(
            junit.contains(r#"name="try 1: missed_cycles_percent""#),
            "{junit}"
        );
        assert!(read("report.html").contains("Try 2 of 3; try 1: stalls"));
    }

    #[test]
    fn a_play_is_repeated_only_so_often_and_never_if_it_failed() {
        let folder = tempfile::tempdir().unwrap();
        let repeated = |limit, tries, stalls| {
            let (verdict, spoiled, plays) = played(folder.path(), limit, tries, stalls);
            assert_eq!(u32::try_from(spoiled.len()).unwrap(), plays - 1);
            (verdict.outcome, plays)
        };
        assert_eq!(repeated(LIMIT, 3, 9), (Outcome::Inconclusive, 3));
        assert_eq!(repeated(LIMIT, 1, 9), (Outcome::Inconclusive, 1));
        assert_eq!(repeated(LIMIT, 3, 0), (Outcome::Pass, 1));
        let missed = format!("{LIMIT}\ncurrent_amperes_rms = {{ max = 0.0 }}");
        assert_eq!(repeated(&missed, 3, 0), (Outcome::Fail, 1));
    }
}
