//! `canrig run`: plays scenarios with controller and plant as processes on a CAN bus.

use std::path::Path;

use clap::{Args, ValueEnum};
use platform::bus::BusAddress;
use platform::claim::Claim;
use scenario::fault::{Faults, Group};

use crate::event::{Listener, RunEvent};
use crate::exit::{Exit, Failure};
use crate::machine::refused_priority;
use crate::observer::observed;
use crate::play::{GuestArgs, PlayArgs, Testbed, in_virtual_time, play_all, prepared};
use crate::scenarios::{is_to_play, scenario_files};
use plan::{ControlLoop, Plan};
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use worlds::bus_connection::BusConnection;
use worlds::preflight::{Preflight, PreflightEvent};
use worlds::{
    BusChoice, End, Played, RunBus, Vigil, WorldError, choose_bus, claim, parse_bus, processes,
    real_time,
};

/// Error of `--dry-run` without an external drive.
const NOTHING_TO_CHECK: &str = "--dry-run checks a drive that canrig does not emulate: name it with --external, or its rig file with --rig";

/// Default of `--tries`.
const TRIES: u32 = 3;
/// Duration up to which a scenario is played again.
const REPEATED_SECONDS_MAX: f64 = 60.0;

/// Arguments of `run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    #[command(flatten)]
    pub play: PlayArgs,
    /// The bus: `auto`, `private` (a vcan that only this run sees), `embedded` (a socket private to you) or a CAN
    /// interface such as `vcan0`
    #[arg(long, value_name = "BUS", default_value = "auto", value_parser = parse_bus)]
    pub bus: BusChoice,
    /// The clock of the processes
    #[arg(long, value_enum, default_value_t = ClockChoice::RealTime)]
    pub clock: ClockChoice,
    #[command(flatten)]
    pub guests: GuestArgs,
    /// Most plays of a scenario of up to 60 s in real time while stalls of this computer spoil it
    /// [default: 3, with --strict 1]
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=10))]
    pub tries: Option<u32>,
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

/// Time by which the processes play.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ClockChoice {
    /// The machine's clock
    RealTime,
    /// Virtual time: the load of the machine cannot change the verdict
    #[value(alias = "lock-step")]
    Lockstep,
}

/// Plays the scenarios, or makes the pre-flight alone; returns the worst exit of all.
pub fn run(args: &RunArgs) -> Result<Exit, Failure> {
    let listener = args.play.listener();
    let mut testbed = RunTestbed::resolve(args, &*listener)?;
    testbed.announce();
    if args.dry_run {
        testbed.dry_run()
    } else {
        play_all(&args.play, &mut testbed, &*listener)
    }
}

/// Testbed of a command.
struct RunTestbed<'a> {
    args: &'a RunArgs,
    bus: RunBus,
    /// Place on the bus, held until the command ends.
    _claim: Option<Claim>,
    /// Vigil between two scenarios.
    vigil: Option<Vigil>,
    preflight: Preflight,
    listener: &'a dyn Listener,
}

impl<'a> RunTestbed<'a> {
    /// Finds the bus.
    fn resolve(args: &'a RunArgs, listener: &'a dyn Listener) -> Result<Self, Failure> {
        let bus = choose_bus(&args.bus, args.require_vcan);
        let placed = bus.and_then(|bus| claim(&bus).map(|claim| (bus, claim)));
        let (bus, claim) = placed.map_err(|error| Exit::BenchFailed.because(error))?;
        Ok(Self {
            args,
            bus,
            _claim: claim,
            vigil: None,
            preflight: Preflight::new(!args.no_heating),
            listener,
        })
    }

    /// Prints the bus and the clock of all runs.
    fn announce(&self) {
        let clock = match self.args.clock {
            ClockChoice::RealTime => "real time",
            ClockChoice::Lockstep => "lock-step",
        };
        self.listener
            .on_note(format!("bus: {} · clock: {clock}", self.bus));
        if self.args.clock == ClockChoice::RealTime
            && let Some(refusal) = refused_priority()
        {
            self.listener.on_note(format!("note: {refusal}"));
        }
    }

    /// Prints the address of an embedded or a private bus. Tools find the only embedded bus by themselves; several ones, and a
    /// private one, need the address.
    fn announce_address(&self, address: &BusAddress) {
        if matches!(address, BusAddress::Embedded(_) | BusAddress::Private(_)) {
            self.listener.on_note(format!("bus address: {address}"));
        }
    }

    /// Opens the bus, makes the pre-flight of an external drive, and plays the scenario.
    fn in_real_time(
        &mut self,
        plan: &Plan,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        self.vigil.take().map_or(Ok(()), Vigil::end)?;
        let mut line = BusConnection::open(&self.bus, plan)?;
        self.announce_address(line.address());
        let preflight = self.run_preflight(plan, folder.path(), &mut line, capture.watch());
        let ended = match preflight {
            Ok(End::Completed) => {
                line.discard();
                real_time::play(plan, folder, capture, &mut line, &mut |_| false)
            }
            Ok(end) => Ok(Played { end, host: None }),
            Err(error) => Err(error),
        };
        let address = line.address().clone();
        line.close(capture, plan)?;
        // If a controller may have been lost, its silence takes the current away.
        let is_orderly =
            matches!(&ended, Ok(played) if played.end == End::Completed) && !plan.has_faults();
        if is_orderly {
            self.keep_place(plan, &address);
        }
        ended
    }

    /// Keeps the place of the manager until the next scenario, on a bus that outlives this one. The next scenario reports errors
    /// of that bus.
    fn keep_place(&mut self, plan: &Plan, address: &BusAddress) {
        let controller = plan.controller();
        let is_lasting = matches!(self.bus, RunBus::Interface(_));
        if controller.is_ours() && is_lasting {
            self.vigil = Vigil::begin(address, controller.id()).ok();
        }
    }

    fn run_preflight(
        &self,
        plan: &Plan,
        parent: &Path,
        line: &mut BusConnection,
        watch: &Watch,
    ) -> Result<End, WorldError> {
        let report = |step: &PreflightEvent| self.listener.on_event(&RunEvent::Preflight(step));
        self.preflight
            .make(plan, parent, &self.bus, line, watch, &report)
    }

    /// Makes the pre-flight of the first scenario, which counts for all: they share rig and bus.
    fn dry_run(&self) -> Result<Exit, Failure> {
        let args = &self.args.play;
        let paths = scenario_files(&args.scenarios, is_to_play)?;
        let path = paths
            .first()
            .ok_or_else(|| Exit::Usage.because("no scenario is named"))?;
        let plan = match prepared(path, &args.values, self, self.listener) {
            Ok(plan) => plan,
            Err(exit) => return Ok(exit),
        };
        let has_drive = |one: &ControlLoop| one.drive().is_external();
        if !plan.loops.iter().any(has_drive) {
            return Err(Exit::Usage.because(NOTHING_TO_CHECK));
        }
        let watch = Watch::default();
        let made = || {
            let mut line = BusConnection::open(&self.bus, &plan)?;
            self.announce_address(line.address());
            self.run_preflight(&plan, &args.output, &mut line, &watch)
        };
        match observed(|| watch.interrupt(), || (), made) {
            Ok(End::Completed) => Ok(Exit::Pass),
            Ok(End::Interrupted) => Ok(Exit::Interrupted),
            Ok(End::ByNode(end)) => Err(Exit::VerdictFailed.because(end)),
            Err(error) if error.is_before_start() => Err(Exit::CannotStart.because(error)),
            Err(error) => Err(Exit::BenchFailed.because(error)),
        }
    }
}

impl Testbed for RunTestbed<'_> {
    fn external(&self) -> &[String] {
        &self.args.guests.external
    }

    /// Returns whether the drive failed its pre-flight, so that no scenario may lead it.
    fn is_over(&self) -> bool {
        self.preflight.has_failed()
    }

    fn prepare(&self, plan: Plan) -> Result<Plan, String> {
        let plan = match self.args.clock {
            ClockChoice::RealTime => plan.with_external(&self.args.guests.external)?,
            ClockChoice::Lockstep => in_virtual_time(plan, &self.args.guests.external)?,
        };
        let external = plan.expected_names();
        if !external.is_empty() && self.args.clock == ClockChoice::RealTime {
            let names = external.join(", ");
            self.listener
                .on_note(format!("external: {names} (expected on the bus)"));
        }
        admits(&plan.shared.run.faults, &self.bus, self.args.clock)?;
        plan.admits_faults()?;
        for one in &plan.loops {
            let scenario = &one.trial;
            if let Some(drive) = &one.real_drive {
                drive.admits(scenario)?;
            }
        }
        Ok(plan)
    }

    /// Returns the number of `--tries` for a run in real time that is not long. A node that is not
    /// canrig's is not led again without its user, and virtual time knows no stalls.
    fn tries(&self, plan: &Plan) -> u32 {
        let default = if self.args.play.strict { 1 } else { TRIES };
        let is_repeated = self.args.clock == ClockChoice::RealTime
            && plan.expected_names().is_empty()
            && plan.shared.run.duration_seconds <= REPEATED_SECONDS_MAX;
        if is_repeated {
            self.args.tries.unwrap_or(default)
        } else {
            1
        }
    }

    fn when_full(&self) -> WhenFull {
        match self.args.clock {
            ClockChoice::RealTime => WhenFull::Drop,
            ClockChoice::Lockstep => WhenFull::Wait,
        }
    }

    fn play(
        &mut self,
        plan: &Plan,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        match self.args.clock {
            ClockChoice::RealTime => self.in_real_time(plan, folder, capture),
            ClockChoice::Lockstep => {
                let announce = |text: &str| self.listener.on_note(text.to_owned());
                let hosting = self.args.guests.hosting(Some(folder.path()), &announce);
                processes::in_lockstep(plan, folder, &hosting, capture, &self.bus)
            }
        }
    }
}

/// Refuses faults of the bus on a real one, which cannot delay or lose frames on demand.
fn admits(faults: &Faults, bus: &RunBus, clock: ClockChoice) -> Result<(), String> {
    let is_modelled = clock == ClockChoice::Lockstep && matches!(bus, RunBus::Embedded { .. });
    let first = faults.in_group(Group::Bus).next().filter(|_| !is_modelled);
    let Some(first) = first else {
        return Ok(());
    };
    let heading = first.kind.heading();
    Err(format!(
        "{heading} is possible on the modelled bus only: use `canrig simulate`, or `canrig run --clock lockstep --bus embedded`"
    ))
}
