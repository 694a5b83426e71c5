//! What each command does.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use dbc::Database;
use platform::bus::BusAddress;
use platform::{private_bus, process, scheduling};
use scenario::Scenario;
use scenario::rig::Rig;

use crate::FILE_BYTES_MAX;
use crate::capture::{Capture, Watch};
use crate::cli::{
    BusChoice, CheckArgs, Cli, ClockChoice, Command, DoctorArgs, MonitorArgs, PlayArgs, RunArgs,
    SdoAction,
};
use crate::console::{Progress, complain, say};
use crate::doctor;
use crate::exit::Exit;
use crate::external::{External, ExternalNode};
use crate::identify;
use crate::manual;
use crate::new;
use crate::nodes;
use crate::preflight::Preflight;
use crate::recordings;
use crate::report::terminal;
use crate::reproduce;
use crate::rig::{LoadedRig, RIG_FILE, RigError};
use crate::run::{self, Judged, Source, World};
use crate::run_folder::RunFolder;
use crate::sweep;
use crate::tap::WhenFull;
use crate::tools::{self, ToolError};
use crate::torture;
use crate::verdict::{Outcome, Verdict};
use crate::viewer::Viewers;
use crate::world::{self, End, RunBus, WorldError};

/// Levels of folders that are searched for scenarios.
const FOLDER_DEPTH_MAX: u32 = 8;

/// Does what the command line says.
#[must_use]
pub fn execute(cli: Cli) -> Exit {
    match cli.command {
        Command::Run(args) => run(&args),
        Command::Simulate(args) => simulate(&args.play),
        Command::Report(args) => recordings::report::report(&args),
        Command::Replay(args) => recordings::replay::replay(&args),
        Command::Compare(args) => recordings::compare::compare(&args),
        Command::Coverage(args) => recordings::coverage::coverage(&args),
        Command::Export(args) => recordings::export::export(&args),
        Command::Identify(args) => identify::command::identify(&args),
        Command::Reproduce(args) => reproduce::command::reproduce(&args),
        Command::Torture(args) => torture::torture(&args),
        Command::Sweep(args) => sweep::command::sweep(&args),
        Command::Merge(args) => sweep::merge::merge(&args),
        Command::Check(args) => check(&args),
        Command::Schema { rig } => {
            say(&match rig {
                true => scenario::schema::rig_json_schema(),
                false => scenario::schema::json_schema(),
            });
            Exit::Pass
        }
        Command::New(args) => new::new(&args),
        Command::Doctor(args) => doctor(&args),
        Command::Nodes(args) => {
            let listen = Duration::from_secs_f64(args.listen);
            told(tools::nodes::nodes(&args.bus.bus, &args.eds, listen))
        }
        Command::Sdo(args) => told(sdo(&args.action)),
        Command::Monitor(args) => monitor(args),
        Command::Completions { shell } => manual::completions(shell),
        Command::Man { folder } => manual::pages(&folder),
        Command::Node(args) => nodes::host(&args),
        Command::PrivateBus { channel } => {
            let served = process::inherited_channel(channel).and_then(private_bus::serve);
            served.map_or(Exit::BenchFailed, |()| Exit::Pass)
        }
    }
}

fn doctor(args: &DoctorArgs) -> Exit {
    let findings = doctor::examine();
    say(&doctor::table(&findings));
    if args.strict && findings.iter().any(|finding| finding.mend.is_some()) {
        Exit::BenchFailed
    } else {
        Exit::Pass
    }
}

/// Prints what a tool found out, or why it did not.
fn told(outcome: Result<String, ToolError>) -> Exit {
    match outcome {
        Ok(text) => {
            say(&text);
            Exit::Pass
        }
        Err(error) => {
            complain(&format!("canrig: {error}"));
            error.exit()
        }
    }
}

fn sdo(action: &SdoAction) -> Result<String, ToolError> {
    let (object, value) = match action {
        SdoAction::Read(object) => (object, None),
        SdoAction::Write { object, value } => (object, Some(value.as_str())),
    };
    let target = tools::sdo::Target {
        node: &object.node,
        object: &object.object,
        eds: object.eds.as_deref(),
    };
    tools::sdo::sdo(&object.bus.bus, target, value)
}

fn monitor(args: MonitorArgs) -> Exit {
    let options = tools::monitor::Options {
        only: args.only,
        except: args.except,
        changes: args.changes,
        raw: args.raw,
        count: args.count,
        duration: args.duration.map(Duration::from_secs_f64),
        dbc: args.dbc,
    };
    match tools::monitor::monitor(&args.bus.bus, options) {
        Ok(()) => Exit::Pass,
        Err(error) => told(Err(error)),
    }
}

fn check(args: &CheckArgs) -> Exit {
    let paths = match scenario_files(&args.scenarios, |_| true) {
        Ok(paths) => paths,
        Err(error) => return usage(&error),
    };
    let mut worst = Exit::Pass;
    for path in paths {
        match checked(&path) {
            Ok(name) => say(&format!("{}: valid ({name})", path.display())),
            Err(error) => {
                complain(&format!("{error:?}"));
                worst = worst.max(Exit::ScenarioInvalid);
            }
        }
    }
    worst
}

/// The name of a valid scenario or rig file.
fn checked(path: &Path) -> miette::Result<String> {
    let text = scenario::read_text(path, FILE_BYTES_MAX).unwrap_or_default();
    if Rig::is_meant(&text) {
        let loaded = LoadedRig::load(path)?;
        return Ok(format!("rig: {}", loaded.rig.name));
    }
    let scenario = Source::load(path)?.scenario;
    Ok(match &scenario.sweep {
        Some(sweep) => format!("{}, {} runs in a sweep", scenario.name, sweep.runs()),
        None => scenario.name,
    })
}

/// The rig that the arguments name, or the one beside the first scenario if the drive is a real one.
fn rig_of(args: &RunArgs, external: &External) -> Result<Option<LoadedRig>, RigError> {
    if let Some(path) = &args.rig {
        return LoadedRig::load(path).map(Some);
    }
    let first = args.play.scenarios.first();
    match first.filter(|_| external.has(ExternalNode::Drive)) {
        Some(folder) if folder.is_dir() => LoadedRig::in_folder(folder),
        Some(file) => LoadedRig::in_folder(file.parent().unwrap_or(Path::new(""))),
        None => Ok(None),
    }
}

fn run(args: &RunArgs) -> Exit {
    let external = match External::new(&args.external) {
        Ok(external) => external,
        Err(reason) => return usage(reason),
    };
    let rig = match rig_of(args, &external) {
        Ok(rig) => rig.map(Arc::new),
        Err(error) => {
            complain(&format!("{:?}", miette::Report::new(error)));
            return Exit::ScenarioInvalid;
        }
    };
    let external = match rig {
        Some(_) => external.with_drive(),
        None => external,
    };
    if args.clock == ClockChoice::Lockstep && !external.is_empty() {
        return usage(
            "--external needs --clock real-time: a node of somebody else's keeps its own time",
        );
    }
    let bus = match (&args.bus, rig.as_ref()) {
        (BusChoice::Auto, Some(rig)) => rig.rig.bus.interface.clone().map(BusChoice::Interface),
        _ => None,
    };
    let bus = match world::choose_bus(bus.as_ref().unwrap_or(&args.bus), args.require_vcan) {
        Ok(bus) => bus,
        Err(error) => {
            complain(&format!("canrig: {error}"));
            return Exit::BenchFailed;
        }
    };
    if args.dry_run && !external.has(ExternalNode::Drive) {
        return usage(
            "--dry-run needs --external drive or --rig: it checks a drive that canrig does not emulate",
        );
    }
    let (clock, lockstep) = match args.clock {
        ClockChoice::RealTime => ("real time", false),
        ClockChoice::Lockstep => ("lock-step", true),
    };
    announce(&args.play, &format!("bus: {bus} · clock: {clock}"));
    if !external.is_empty() {
        announce(
            &args.play,
            &format!("external: {external} (expected on the bus)"),
        );
    }
    if args.clock == ClockChoice::RealTime
        && let Some(refusal) = refused_priority()
    {
        announce(&args.play, &format!("note: {refusal}"));
    }
    if let Some(rig) = &rig {
        let (name, path) = (&rig.rig.name, rig.path.display());
        announce(&args.play, &format!("rig: {name} ({path})"));
    }
    let when_full = if lockstep {
        WhenFull::Wait
    } else {
        WhenFull::Drop
    };
    let admits = |source: &Source| {
        let scenario = &source.scenario;
        admits(scenario, &bus, lockstep)?;
        external.admits(scenario)?;
        rig.as_ref().map_or(Ok(()), |rig| rig.admits(scenario))
    };
    let on = |source: Source| source.on(rig.clone(), external.clone());
    let tell_address = |address: &BusAddress| tell_address(&args.play, address);
    let tell_check = |line: &str| announce(&args.play, line);
    let preflight = Preflight::new(!args.no_heating, &tell_check);
    if args.dry_run {
        return dry_run(args, on, admits, |source, watch| {
            let parent = &args.play.output;
            world::real_time::dry_run(source, parent, &bus, watch, &tell_address, &preflight)
        });
    }
    play(
        &args.play,
        on,
        when_full,
        admits,
        |source, folder, capture| {
            if lockstep {
                world::processes::in_lockstep(&source.scenario, folder, capture, &bus)
            } else {
                let tell = &tell_address;
                world::real_time::run(source, folder, capture, &bus, tell, &preflight)
            }
        },
    )
}

/// The pre-flight of the first scenario, which stands for all: they share rig and bus.
fn dry_run(
    args: &RunArgs,
    on: impl Fn(Source) -> Source,
    admits: impl Fn(&Source) -> Result<(), String>,
    preflight: impl FnOnce(&Source, &Watch) -> Result<End, WorldError>,
) -> Exit {
    let paths = match scenario_files(&args.play.scenarios, is_scenario) {
        Ok(paths) => paths,
        Err(error) => return usage(&error),
    };
    let Some(path) = paths.first() else {
        return usage("no scenario is named");
    };
    let source = match Source::load_or_complain(path) {
        Ok(source) => on(source),
        Err(exit) => return exit,
    };
    if let Err(reason) = admits(&source) {
        complain(&format!("canrig: {}: {reason}", path.display()));
        return Exit::ScenarioInvalid;
    }
    let watch = Watch::default();
    let ended = world::observed(|| watch.interrupt(), || (), || preflight(&source, &watch));
    match ended {
        Ok(End::Completed) => Exit::Pass,
        Ok(End::Interrupted) => Exit::Interrupted,
        Err(error) => {
            complain(&format!("canrig: {error}"));
            Exit::BenchFailed
        }
    }
}

/// Rig files lie beside scenarios.
fn is_scenario(path: &Path) -> bool {
    !path.ends_with(RIG_FILE)
}

/// Faults of the bus need the modelled one; no real bus delays or loses frames as it is told.
fn admits(scenario: &Scenario, bus: &RunBus, is_lockstep: bool) -> Result<(), String> {
    let is_modelled = is_lockstep && matches!(bus, RunBus::Embedded { .. });
    if is_modelled || scenario.fault.bus.is_empty() {
        return Ok(());
    }
    let windows = scenario.fault.windows();
    let first = windows.iter().find(|fault| fault.place.group == "bus");
    let kind = first.map_or("", |fault| fault.place.kind);
    Err(format!(
        "[[fault.bus.{kind}]] is possible on the modelled bus only: use `canrig simulate`, or `canrig run --clock lockstep --bus embedded`"
    ))
}

/// Tools find the only embedded bus by themselves; of several, and of a private one, each has its address.
fn tell_address(args: &PlayArgs, address: &BusAddress) {
    if matches!(address, BusAddress::Embedded(_) | BusAddress::Private(_)) {
        announce(args, &format!("bus address: {address}"));
    }
}

/// Why the nodes will run without real-time priority; found out on a thread that ends at once.
fn refused_priority() -> Option<String> {
    let asked = std::thread::spawn(|| scheduling::request_fifo(scheduling::NODE_PRIORITY)).join();
    asked
        .ok()
        .and_then(Result::err)
        .map(|refused| refused.to_string())
}

fn simulate(args: &PlayArgs) -> Exit {
    announce(args, "bus: modelled · clock: lock-step, in one process");
    play(
        args,
        |source| source,
        WhenFull::Wait,
        |_| Ok(()),
        |source, _, capture| {
            let scenario = &source.scenario;
            let end = world::lockstep::simulate(scenario, Database::shipped(), capture)?;
            Ok(World::in_virtual_time(end))
        },
    )
}

fn announce(args: &PlayArgs, text: &str) {
    if !args.json && !args.quiet {
        say(text);
    }
}

/// Plays each scenario, on the rig that `on` says, in a world and reports; the worst exit of all.
fn play(
    args: &PlayArgs,
    on: impl Fn(Source) -> Source,
    when_full: WhenFull,
    admits: impl Fn(&Source) -> Result<(), String>,
    world: impl Fn(&Source, &RunFolder, &mut Capture<'_>) -> Result<World, WorldError>,
) -> Exit {
    let paths = match scenario_files(&args.scenarios, is_scenario) {
        Ok(paths) => paths,
        Err(error) => return usage(&error),
    };
    let mut viewers = Viewers::open(&args.viewer);
    let mut worst = Exit::Pass;
    let mut verdicts = Vec::new();
    for path in &paths {
        let source = match Source::load_or_complain(path) {
            Ok(source) => on(source),
            Err(exit) => {
                worst = worst.max(exit);
                continue;
            }
        };
        if let Err(reason) = admits(&source) {
            complain(&format!("canrig: {}: {reason}", path.display()));
            worst = worst.max(Exit::ScenarioInvalid);
            continue;
        }
        if let Some(sweep) = &source.scenario.sweep {
            let (runs, path) = (sweep.runs(), path.display());
            announce(
                args,
                &format!(
                    "note: this is the scenario as it stands; `canrig sweep {path}` plays its {runs} runs"
                ),
            );
        }
        let watch = Watch::default();
        let progress = Progress::new(source.scenario.duration_seconds, !args.json && !args.quiet);
        let (taps, shows) = viewers.show(&source, when_full);
        let judged = run::run(&source, &args.output, &watch, taps, |folder, capture| {
            world::observed(
                || watch.interrupt(),
                || progress.show(&watch.reading()),
                || world(&source, folder, capture),
            )
        });
        drop(progress);
        let exit = match judged {
            Ok(judged) => {
                shows.end(&judged.verdict, &mut viewers);
                report(args, path, &judged);
                verdicts.push(judged.verdict);
                judged.exit
            }
            Err(error) => {
                complain(&format!("canrig: {}: {error}", path.display()));
                Exit::BenchFailed
            }
        };
        worst = worst.max(exit);
        if exit == Exit::Interrupted {
            break;
        }
    }
    summarise(args, &verdicts);
    worst
}

fn report(args: &PlayArgs, path: &Path, judged: &Judged) {
    if judged.verdict.outcome == Outcome::Incomplete {
        let reason = judged.verdict.reason.as_deref().unwrap_or_default();
        complain(&format!("canrig: {}: {reason}", path.display()));
    }
    if !args.json && (!args.quiet || judged.exit != Exit::Pass) {
        say(&terminal::run(judged));
    }
}

fn summarise(args: &PlayArgs, verdicts: &[Verdict]) {
    if args.json {
        say(&serde_json::to_string_pretty(verdicts).expect("plain data"));
    } else if !args.quiet && verdicts.len() > 1 {
        say(&terminal::summary(verdicts));
    }
}

fn usage(message: &str) -> Exit {
    complain(&format!("canrig: {message}"));
    Exit::Usage
}

/// The scenario files that the arguments name: files as they are, folders with everything wanted below them in order.
fn scenario_files(
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
