//! `canrig run`: scenarios with controller and plant as processes on a CAN bus.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use platform::bus::BusAddress;
use platform::scheduling;
use scenario::loops::Loops;
use scenario::{Scenario, read_text};

use crate::console::{print_diagnostic, print_error, usage_error};
use crate::event::{Listener, RunEvent};
use crate::exit::Exit;
use crate::observer::observed;
use crate::play::{PlayArgs, Testbed, external_names, play_all, prepared, refuse_external};
use crate::scenarios::{is_scenario, read_rig, scenario_files};
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use rig::FILE_BYTES_MAX;
use rig::external::{External, ExternalNode};
use rig::rig_file::{LoadedRig, RigError};
use rig::setup::Setup;
use worlds::bus_connection::BusConnection;
use worlds::preflight::{Preflight, PreflightEvent};
use worlds::{
    BusChoice, BusPlace, End, Played, RunBus, Vigil, WorldError, choose_bus, processes, real_time,
};

/// What `--dry-run` is for.
const NOTHING_TO_CHECK: &str =
    "--dry-run needs --external drive or --rig: it checks a drive that canrig does not emulate";

/// Arguments of `run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    #[command(flatten)]
    pub play: PlayArgs,
    /// The bus: `auto`, `private` (a vcan that only this run sees), `embedded` (a socket private to you) or a CAN
    /// interface such as `vcan0`
    #[arg(long, value_name = "BUS", default_value = "auto")]
    pub bus: BusChoice,
    /// The clock of the processes
    #[arg(long, value_enum, default_value_t = ClockChoice::RealTime)]
    pub clock: ClockChoice,
    /// Nodes that canrig does not start but expects on the bus, such as a real drive; several with commas: `drive`,
    /// `controller`, `fan`, or the names of a scenario's rig. A fan needs its drive too, since a real fan cannot cool an emulated
    /// wire. A limit on a value that no node then sends is not judged; a run that fails no other limit ends with exit code 5
    #[arg(long, value_name = "NODE", value_delimiter = ',')]
    pub external: Vec<String>,
    /// The rig file of a real drive, or the name of one that ships: its bus, objects, scaling, time-outs and hard limits. It makes the drive external.
    /// Without it, --external drive reads `rig.toml` beside the first scenario, where there is one
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// End after the pre-flight of an external drive: interface, nodes, objects, direction under a slow heating ramp, stop
    #[arg(long)]
    pub dry_run: bool,
    /// Leave the heating ramp out of the pre-flight, so that the load does not move
    #[arg(long)]
    pub no_heating: bool,
    /// Fail unless the kernel provides the bus, so that a CI job cannot fall back to the embedded bus unnoticed
    #[arg(long)]
    pub require_vcan: bool,
}

/// Which time the processes live in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ClockChoice {
    /// The machine's clock
    RealTime,
    /// Virtual time: the load of the machine cannot change the verdict
    Lockstep,
}

/// Plays the scenarios, or makes the pre-flight alone; the worst exit of all.
#[must_use]
pub fn run(args: &RunArgs) -> Exit {
    let listener = args.play.listener();
    let plan = match RunPlan::resolve(args, &*listener) {
        Ok(plan) => plan,
        Err(exit) => return exit,
    };
    plan.announce();
    if args.dry_run {
        return plan.dry_run(args);
    }
    play_all(&args.play, &plan, &*listener)
}

/// What the arguments come to: on which bus, by which clock, with whose nodes.
struct RunPlan<'a> {
    bus: RunBus,
    /// Held until the command ends.
    _place: BusPlace,
    /// Between two scenarios.
    vigil: Cell<Option<Vigil>>,
    clock: ClockChoice,
    /// As the user names them.
    names: Vec<String>,
    /// The same on a bench with one drive.
    external: External,
    rig: Option<Arc<LoadedRig>>,
    preflight: Preflight,
    listener: &'a dyn Listener,
}

impl<'a> RunPlan<'a> {
    /// Finds rig and bus, and refuses what does not go together.
    fn resolve(args: &RunArgs, listener: &'a dyn Listener) -> Result<Self, Exit> {
        let external = External::of_names(&args.external);
        let external = match names_rigs(args) {
            true => external.unwrap_or_default(),
            false => external.map_err(|reason| usage_error(&reason))?,
        };
        let rig = rig_of(args, &external).map_err(|error| {
            print_diagnostic(error);
            Exit::CannotStart
        })?;
        let external = match rig {
            Some(_) => external.with_drive(),
            None => external,
        };
        refuse(args, &external).map_err(usage_error)?;
        let interface = match (&args.bus, &rig) {
            (BusChoice::Auto, Some(rig)) => rig.file.bus.interface.clone(),
            _ => None,
        };
        let choice = interface.map_or_else(|| args.bus.clone(), BusChoice::Interface);
        let bus = choose_bus(&choice, args.require_vcan);
        let placed = bus.and_then(|bus| BusPlace::take(&bus).map(|place| (bus, place)));
        let (bus, place) = placed.map_err(|error| {
            print_error(&format!("canrig: {error}"));
            Exit::BenchFailed
        })?;
        Ok(Self {
            bus,
            _place: place,
            vigil: Cell::new(None),
            clock: args.clock,
            names: args.external.clone(),
            external,
            rig: rig.map(Arc::new),
            preflight: Preflight::new(!args.no_heating),
            listener,
        })
    }

    fn note(&self, text: String) {
        self.listener.on_event(&RunEvent::Note(text));
    }

    /// What a reader of the output must know of all runs.
    fn announce(&self) {
        let clock = match self.clock {
            ClockChoice::RealTime => "real time",
            ClockChoice::Lockstep => "lock-step",
        };
        self.note(format!("bus: {} · clock: {clock}", self.bus));
        if !self.external.is_empty() {
            self.announce_external(&self.external.to_string());
        }
        if self.clock == ClockChoice::RealTime
            && let Some(refusal) = refused_priority()
        {
            self.note(format!("note: {refusal}"));
        }
        if let Some(rig) = &self.rig {
            let (name, path) = (&rig.file.name, rig.path.display());
            self.note(format!("rig: {name} ({path})"));
        }
    }

    fn announce_external(&self, names: &str) {
        self.note(format!("external: {names} (expected on the bus)"));
    }

    /// Tools find the only embedded bus by themselves; of several, and of a private one, each has its address.
    fn announce_address(&self, address: &BusAddress) {
        if matches!(address, BusAddress::Embedded(_) | BusAddress::Private(_)) {
            self.note(format!("bus address: {address}"));
        }
    }

    fn on_step(&self, step: &PreflightEvent) {
        self.listener.on_event(&RunEvent::Preflight(step));
    }

    /// Opens the bus, makes the pre-flight of a drive that is external, and plays the scenario.
    fn in_real_time(
        &self,
        setups: &[Setup],
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        self.vigil.take().map_or(Ok(()), Vigil::end)?;
        let mut line = BusConnection::open(&self.bus)?;
        self.announce_address(line.address());
        let preflight = self.run_preflight(setups, folder.path(), &mut line, capture.watch());
        let ended = match preflight {
            Ok(End::Completed) => {
                line.discard();
                real_time::play(setups, folder, capture, &mut line, &mut |_| false)
            }
            Ok(end) => Ok(Played { end, host: None }),
            Err(error) => Err(error),
        };
        let address = line.address().clone();
        line.close(capture)?;
        // Where a controller may have been lost, its silence is what takes the current away.
        let is_orderly = matches!(&ended, Ok(played) if played.end == End::Completed)
            && (setups.iter()).all(|setup| setup.scenario.fault.is_empty());
        if is_orderly {
            self.keep_place(&setups[0], &address);
        }
        ended
    }

    /// Until the next scenario, on a bus that outlives this one. What is wrong with that bus is for the next scenario to say.
    fn keep_place(&self, setup: &Setup, address: &BusAddress) {
        let is_manager = !setup.external.has(ExternalNode::Controller);
        let is_lasting = matches!(self.bus, RunBus::Interface(_));
        if is_manager && is_lasting {
            self.vigil.set(Vigil::begin(address).ok());
        }
    }

    fn run_preflight(
        &self,
        setups: &[Setup],
        parent: &Path,
        line: &mut BusConnection,
        watch: &Watch,
    ) -> Result<End, WorldError> {
        let report = |step: &PreflightEvent| self.on_step(step);
        (self.preflight).make(setups, parent, &self.bus, line, watch, &report)
    }

    /// The pre-flight of the first scenario, which stands for all: they share rig and bus.
    fn dry_run(&self, args: &RunArgs) -> Exit {
        let paths = match scenario_files(&args.play.scenarios, is_scenario) {
            Ok(paths) => paths,
            Err(error) => return usage_error(&error),
        };
        let Some(path) = paths.first() else {
            return usage_error("no scenario is named");
        };
        let setups = match prepared(path, &args.play.values, self, self.listener) {
            Ok(setups) => setups,
            Err(exit) => return exit,
        };
        let has_drive = |setup: &Setup| setup.external.has(ExternalNode::Drive);
        if !setups.iter().any(has_drive) {
            return usage_error(NOTHING_TO_CHECK);
        }
        let watch = Watch::default();
        let made = || {
            let mut line = BusConnection::open(&self.bus)?;
            self.announce_address(line.address());
            self.run_preflight(&setups, &args.play.output, &mut line, &watch)
        };
        match observed(|| watch.interrupt(), || (), made) {
            Ok(End::Completed) => Exit::Pass,
            Ok(End::Interrupted) => Exit::Interrupted,
            Ok(End::ByNode(end)) => {
                print_error(&format!("canrig: {end}"));
                Exit::VerdictFailed
            }
            Err(error) => {
                print_error(&format!("canrig: {error}"));
                match error.is_before_start() {
                    true => Exit::CannotStart,
                    false => Exit::BenchFailed,
                }
            }
        }
    }
}

impl RunPlan<'_> {
    /// The loops of a scenario that names its rig itself.
    fn prepare_loops(&self, setups: Vec<Setup>) -> Result<Vec<Setup>, String> {
        if self.rig.is_some() {
            return Err("the scenario names its rig: leave --rig out".to_owned());
        }
        let setups = rig::loops::with_external(setups, &self.names)?;
        if self.clock == ClockChoice::Lockstep {
            refuse_external(&setups)?;
        }
        let external = external_names(&setups);
        if !external.is_empty() {
            self.announce_external(&external.join(", "));
        }
        Ok(setups)
    }
}

impl Testbed for RunPlan<'_> {
    /// A drive that failed its pre-flight is led by nobody.
    fn is_over(&self) -> bool {
        self.preflight.has_failed()
    }

    fn prepare(&self, setups: Vec<Setup>) -> Result<Vec<Setup>, String> {
        let has_rig = setups.iter().any(|setup| setup.nodes.is_some());
        let setups = match has_rig {
            true => self.prepare_loops(setups)?,
            false => {
                let on = |setup: Setup| setup.on(self.rig.clone(), self.external.clone());
                setups.into_iter().map(on).collect()
            }
        };
        for setup in &setups {
            let scenario = &setup.scenario;
            admits(scenario, &self.bus, self.clock)?;
            setup.external.admits(scenario)?;
            if let Some(rig) = &setup.rig {
                rig.admits(scenario)?;
            }
        }
        Ok(setups)
    }

    fn when_full(&self) -> WhenFull {
        match self.clock {
            ClockChoice::RealTime => WhenFull::Drop,
            ClockChoice::Lockstep => WhenFull::Wait,
        }
    }

    fn play(
        &self,
        setups: &[Setup],
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        match self.clock {
            ClockChoice::RealTime => self.in_real_time(setups, folder, capture),
            ClockChoice::Lockstep => processes::in_lockstep(setups, folder, capture, &self.bus),
        }
    }
}

/// The rig that the arguments name, or the one beside the first scenario if the drive is a real one.
fn rig_of(args: &RunArgs, external: &External) -> Result<Option<LoadedRig>, RigError> {
    if let Some(path) = &args.rig {
        return read_rig(path).map(Some);
    }
    let first = args.play.scenarios.first();
    let first = first.filter(|_| external.has(ExternalNode::Drive) && !names_rigs(args));
    match first {
        Some(folder) if folder.is_dir() => LoadedRig::in_folder(folder),
        Some(file) => LoadedRig::in_folder(file.parent().unwrap_or(Path::new(""))),
        None => Ok(None),
    }
}

/// Whether a scenario that the arguments name names its rig by itself.
fn names_rigs(args: &RunArgs) -> bool {
    let paths = scenario_files(&args.play.scenarios, is_scenario).unwrap_or_default();
    let mut texts = paths.iter().map(|path| read_text(path, FILE_BYTES_MAX));
    texts.any(|text| text.is_ok_and(|text| Loops::is_meant(&text)))
}

/// Refuses arguments that do not go together.
fn refuse(args: &RunArgs, external: &External) -> Result<(), &'static str> {
    let has_external = !external.is_empty() || !args.external.is_empty();
    if args.clock == ClockChoice::Lockstep && has_external {
        return Err("--external needs --clock real-time: an external node keeps its own time");
    }
    if args.dry_run && !external.has(ExternalNode::Drive) && !names_rigs(args) {
        return Err(NOTHING_TO_CHECK);
    }
    Ok(())
}

/// Faults of the bus need the modelled one; no real bus delays or loses frames on demand.
fn admits(scenario: &Scenario, bus: &RunBus, clock: ClockChoice) -> Result<(), String> {
    let is_modelled = clock == ClockChoice::Lockstep && matches!(bus, RunBus::Embedded { .. });
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

/// Why the nodes will run without real-time priority; found out on a thread that ends at once.
fn refused_priority() -> Option<String> {
    let asked = std::thread::spawn(|| scheduling::request_fifo(scheduling::NODE_PRIORITY)).join();
    asked
        .ok()
        .and_then(Result::err)
        .map(|refused| refused.to_string())
}
