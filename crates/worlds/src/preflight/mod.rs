//! Pre-flight: a checklist before the first scenario on a drive that is not the emulator.
//!
//! The first checks need no current: the interface (`interface`), then the nodes and their objects (`interview`). Then our
//! controller leads the drive as it will later, under the same limits and the same supervisor, but with a slow heating ramp, and
//! the frames on the bus are judged (`heating`). The first check that fails ends it.

mod checklist;
mod heating;
mod interface;
mod interview;
mod observed;

use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;
use std::iter;
use std::path::Path;
use std::time::Duration;

use can::Filter;
use canopen::nmt::NodeId;
use platform::clock;
use scenario::Beside;
use scenario::node::{Node, Player};
use scenario::rig::RealDrive;

use crate::bus_choice::RunBus;
use crate::bus_connection::BusConnection;
use crate::bus_place::Vigil;
use crate::catalogue::catalogue;
use crate::error::WorldError;
use crate::guest::{Guest, GuestError};
use crate::played::End;
use crate::real_time;
use checklist::{Check, Found};
use heating::Heating;
use interview::{BrokenOff, Interview, OTHER_MANAGER};
use plan::loaded_drive::LoadedDrive;
use plan::{ControlLoop, Plan, Shared};
use recording::capture::{Capture, Watch};
use recording::progress::ProgressReader;
use recording::run_folder::RunFolder;
use recording::session::write_plan;

/// Name of the session in which the drive is heated, and of its folder.
const NAME: &str = "pre-flight";
/// File of its rig.
const RIG: &str = "rig.toml";
/// Period of the check whether the user stops the pre-flight.
const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Time beyond the time-out for which a stopped drive's heartbeats are awaited.
const HEARTBEAT_PATIENCE: Duration = Duration::from_millis(50);

/// Event during a pre-flight.
pub enum PreflightEvent {
    /// The pre-flight begins.
    Begun,
    /// The checks of one of several drives begin.
    Drive(String),
    /// A check was made, or the plant cools before the scenario.
    Step(String),
}

/// Pre-flight of one command, made once for each drive, before its first scenario.
pub struct Preflight {
    may_heat: bool,
    /// Drives that have passed it.
    passed: RefCell<BTreeSet<String>>,
    has_failed: Cell<bool>,
}

impl Preflight {
    /// Makes a pre-flight that may or may not heat the wire.
    pub fn new(may_heat: bool) -> Self {
        Self {
            may_heat,
            passed: RefCell::default(),
            has_failed: Cell::default(),
        }
    }

    /// Returns whether a check failed, or could not be made; then no further scenario may be played.
    pub fn has_failed(&self) -> bool {
        self.has_failed.get()
    }

    /// Makes the checks of each drive that is not the emulator, unless it has passed them. A folder in `parent` keeps the frames
    /// while a drive was led.
    ///
    /// # Errors
    /// With the failed check, or the reason why it could not be made.
    pub fn make(
        &self,
        plan: &Plan,
        parent: &Path,
        bus: &RunBus,
        connection: &mut BusConnection,
        watch: &Watch,
        report: &dyn Fn(&PreflightEvent),
    ) -> Result<End, WorldError> {
        let mut session = Session {
            plan,
            parent,
            connection,
            watch,
            report,
        };
        let made = self.check_drives(bus, &mut session);
        self.has_failed.set(made.is_err());
        made
    }

    fn check_drives(&self, bus: &RunBus, session: &mut Session<'_>) -> Result<End, WorldError> {
        let plan = session.plan;
        // A program is not there before its run, and no current flows in it.
        let is_external = |one: &&ControlLoop| one.drive().player == Player::Expected;
        let has_passed = |one: &&ControlLoop| self.passed.borrow().contains(&who(one));
        let unchecked = plan.loops.iter().filter(is_external);
        let unchecked = Vec::from_iter(unchecked.filter(|one| !has_passed(one)));
        if unchecked.is_empty() {
            return Ok(End::Completed);
        }
        (session.report)(&PreflightEvent::Begun);
        let bit_rate = plan.shared.run.bus.bitrate_kilobits_per_second;
        session.pass(interface::checks(bus, bit_rate))?;
        if plan.controller().is_external() {
            let text = "left to the external controller, which leads it".to_owned();
            session.pass(vec![Check("drive", Found::Open(text))])?;
            return Ok(End::Completed);
        }
        for one in unchecked {
            match self.check_drive(one, session)? {
                End::Completed => self.passed.borrow_mut().insert(who(one)),
                end => return Ok(end),
            };
        }
        Ok(End::Completed)
    }

    /// Makes the checks of one drive.
    fn check_drive(&self, one: &ControlLoop, session: &mut Session<'_>) -> Result<End, WorldError> {
        if one.loop_name().is_some() {
            (session.report)(&PreflightEvent::Drive(one.drive().name.clone()));
        }
        let drive = self.drive(one)?;
        match session.interview(&drive, one)? {
            Ok(checks) => session.pass(checks)?,
            Err(BrokenOff::Guest(GuestError::Interrupted)) => return Ok(End::Interrupted),
            Err(BrokenOff::Guest(GuestError::Bus(error))) => return Err(error.into()),
            Err(BrokenOff::Manager(manager)) => {
                let remedy = "end the other controller, or name it with --external controller";
                let found = Found::Failed(format!("{manager} is heard: {remedy}"));
                let check = Check(OTHER_MANAGER, found);
                (session.report)(&PreflightEvent::Step(check.to_string()));
                let found = format!("the pre-flight hears {manager}: {remedy}");
                return Err(WorldError::SecondMaster(found));
            }
        }
        let preflight = drive.real.preflight;
        let end = session.heat(&drive, one)?;
        if end == End::Interrupted || !preflight.heating {
            return Ok(end);
        }
        let cooling = Duration::from_secs_f64(preflight.cooling_seconds);
        let text = format!("the plant cools for {} s", cooling.as_secs_f64());
        (session.report)(&PreflightEvent::Step(text));
        session.cool(cooling, one.controller().id())
    }

    /// Returns the drive, or one like the emulated drive if the rig does not describe it, with the user's choice on heating.
    fn drive(&self, one: &ControlLoop) -> Result<LoadedDrive, WorldError> {
        let mut drive = match &one.real_drive {
            Some(drive) => LoadedDrive::clone(drive),
            None => {
                let drive = LoadedDrive::new(RealDrive::emulated(&one.trial.wiring), None);
                drive.map_err(|error| cannot_be_made(&error))?
            }
        };
        drive.real.preflight.heating &= self.may_heat;
        Ok(drive)
    }
}

/// Identifies a drive: scenarios of one command may name several rigs.
fn who(one: &ControlLoop) -> String {
    let real = one.real_drive.as_deref().map(|drive| &drive.real);
    format!("{} {real:?}", one.drive().id())
}

/// Plan whose drives are checked, and the place; the folder of the recording is in `parent`.
struct Session<'a> {
    plan: &'a Plan,
    parent: &'a Path,
    connection: &'a mut BusConnection,
    watch: &'a Watch,
    report: &'a dyn Fn(&PreflightEvent),
}

impl Session<'_> {
    /// Reports the checks, up to the first that failed.
    fn pass(&self, checks: Vec<Check>) -> Result<(), WorldError> {
        for check in checks {
            (self.report)(&PreflightEvent::Step(check.to_string()));
            if let Check(name, Found::Failed(text)) = check {
                return Err(WorldError::preflight(name, &text));
            }
        }
        Ok(())
    }

    /// Asks the drive and the io nodes of its loop.
    fn interview(
        &mut self,
        drive: &LoadedDrive,
        one: &ControlLoop,
    ) -> Result<Result<Vec<Check>, BrokenOff>, WorldError> {
        let nodes = iter::once(one.drive())
            .chain(io_of(self.plan, one))
            .filter_map(|node| Some((NodeId::new(node.id())?, node.name.clone())));
        let watch = self.watch;
        let bus = self.connection.join(&[Filter::ALL])?;
        let guest = Guest::new(bus, || watch.is_interrupted());
        let interview = Interview::new(guest, drive, one.controller().id());
        Ok(interview.checks(&Vec::from_iter(nodes)))
    }

    /// Leads the drive through the ramp and judges the frames on the bus.
    fn heat(&mut self, drive: &LoadedDrive, one: &ControlLoop) -> Result<End, WorldError> {
        let ramp = ramp(drive, self.plan, one)?;
        let Shared { run, text, .. } = &ramp.shared;
        let folder = RunFolder::create(self.parent, &run.name, run.seed, text)?;
        write_plan(&folder, &ramp)?;
        let (log, progress) = (folder.bus_log(false)?, ProgressReader::new(&ramp)?);
        let clock = ramp.scenario_clock()?;
        let unit = &one.trial.wiring.sensor.quantity.unit;
        let mut heating = Heating::new(drive, clock.clone(), unit);
        let mut capture = Capture::new(log, progress, clock, self.watch, Vec::new());
        let mut is_enough = |capture: &Capture<'_>| {
            heating.follow(capture);
            heating.is_over()
        };
        let connection = &mut *self.connection;
        let ended = real_time::play(&ramp, &folder, &mut capture, connection, &mut is_enough);
        self.await_stopped(&mut capture, &mut heating)?;
        capture.finish(&ramp)?;
        match ended.map(|played| played.end) {
            Err(second_master @ WorldError::SecondMaster(_)) => Err(second_master),
            Ok(End::Interrupted) => Ok(End::Interrupted),
            ended => self.pass(heating.checks(&ended)).map(|()| End::Completed),
        }
    }

    /// Continues the recording until a heartbeat of the drive shows that it was stopped.
    fn await_stopped(
        &mut self,
        capture: &mut Capture<'_>,
        heating: &mut Heating<'_>,
    ) -> Result<(), WorldError> {
        let patience = heating.patience() + HEARTBEAT_PATIENCE;
        let clock = clock::Clock::start();
        loop {
            self.connection.collect(capture)?;
            heating.follow(capture);
            if heating.is_stopped() || clock.now() > patience {
                return Ok(());
            }
            clock::sleep(POLL_PERIOD);
        }
    }

    /// Waits, unless the user stops the pre-flight, and keeps the bench's place on the bus meanwhile.
    fn cool(&self, time: Duration, manager: u8) -> Result<End, WorldError> {
        let vigil = Vigil::begin(self.connection.address(), manager)?;
        let clock = clock::Clock::start();
        while clock.now() < time && !self.watch.is_interrupted() && !vigil.is_broken() {
            clock::sleep(POLL_PERIOD);
        }
        vigil.end()?;
        Ok(if self.watch.is_interrupted() {
            End::Interrupted
        } else {
            End::Completed
        })
    }
}

/// Returns the io nodes on the bus with outputs that are signals of a loop.
fn io_of<'a>(plan: &'a Plan, one: &'a ControlLoop) -> impl Iterator<Item = &'a Node> {
    let io = plan.io_on_bus().map(|(io, _)| *io);
    let io = io.filter(|io| one.trial.wiring.io_nodes().any(|own| own == *io));
    io.map(|io| &plan.nodes[io])
}

/// Returns the plan of the session in which the drive is led: at rest, then under a ramp from 0 A to its limit.
fn ramp(drive: &LoadedDrive, plan: &Plan, one: &ControlLoop) -> Result<Plan, WorldError> {
    let preflight = &drive.real.preflight;
    let rest = heating::REST.as_secs_f64();
    let limit = drive.real.limits.current_amperes;
    let seconds = if preflight.heating {
        preflight.heating_seconds_max
    } else {
        rest
    };
    let mut text = format!(
        "schema = 1\nrig = \"{RIG}\"\nname = \"{NAME}\"\nduration_seconds = {:?}\n[controller.open_loop]\n",
        rest + seconds
    );
    if preflight.heating {
        let until = rest + limit / preflight.ramp_amperes_per_second;
        text += &format!(
            "[[controller.open_loop.ramp]]\nfrom_seconds = {rest:?}\nuntil_seconds = {until:?}\ncurrent_amperes = {limit:?}\n"
        );
    }
    let acts = |io: &&Node| plan.shared.rig.acts_on(&io.name, &one.drive().name);
    let io = io_of(plan, one).filter(acts).map(|io| io.name.as_str());
    let rig = plan
        .shared
        .rig
        .with_one_drive(&one.drive().name, &drive.real, io);
    let read = |name: &str| match name {
        RIG => Ok(rig.to_toml()),
        _ => Ok(drive.eds.clone()),
    };
    let ramp = Plan::parse(&Beside::new(Path::new(NAME)), text, read, catalogue());
    ramp.map_err(|error| cannot_be_made(&error))
}

fn cannot_be_made(reason: &dyn std::fmt::Display) -> WorldError {
    WorldError::preflight(NAME, &format!("cannot be made: {reason}"))
}
