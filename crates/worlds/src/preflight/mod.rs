//! Before the first scenario runs on a drive that is not the emulator: a checklist.
//!
//! First what can be asked without any current: the interface (`interface`), then the nodes and their objects (`interview`).
//! Then our controller leads the drive as it will later, under the same limits and the same supervisor, but with a slow
//! heating ramp, and what the bus shows is judged (`heating`). The first check that fails ends it.

mod checklist;
mod heating;
mod interface;
mod interview;
mod phase;

use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use canopen::eds;
use canopen::nmt::NodeId;
use platform::clock;
use scenario::Scenario;
use scenario::node::Part;

pub use checklist::{Check, CheckOutcome};

use crate::bus_choice::RunBus;
use crate::bus_connection::BusConnection;
use crate::bus_place::Vigil;
use crate::catalogue::catalogue;
use crate::error::WorldError;
use crate::names::drive_name;
use crate::played::End;
use crate::real_time;
use heating::Heating;
use interview::Interview;
use recording::capture::{Capture, Watch};
use recording::progress::ProgressReader;
use recording::run_folder::RunFolder;
use recording::session::write_plan;
use rig::plan::{ControlLoop, FAN, Plan, Shared};
use rig::rig_file::LoadedRig;

/// Name of the session under which the drive is heated, and of its folder.
const NAME: &str = "pre-flight";
/// An emulated drive's sensor is taken to resolve its travel by 10 bits, as that of the shipped rig does.
const STEPS_OF_TRAVEL: f64 = 1024.0;
/// Nothing takes less than this through its travel, where its node does not say how fast it is. Assumed: the paper's wire needs 0.2 s.
const TRAVEL_SECONDS: f64 = 0.12;
/// How often is looked whether the user stops the pre-flight.
const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Heartbeats of a drive that was stopped are awaited for so long beyond their time-out.
const HEARTBEAT_PATIENCE: Duration = Duration::from_millis(50);

/// What happens during a pre-flight.
pub enum PreflightEvent {
    /// It begins.
    Begun,
    /// The checks of one of several drives begin.
    Drive(String),
    /// Something was checked.
    Checked(Check),
    /// The wire cools before the scenario.
    Cooling(Duration),
}

/// The pre-flight of one command: made once for each drive, before its first scenario.
pub struct Preflight {
    may_heat: bool,
    /// Which drives passed it.
    passed: RefCell<BTreeSet<String>>,
    has_failed: Cell<bool>,
}

impl Preflight {
    /// A pre-flight that may heat the wire, or may not.
    #[must_use]
    pub fn new(may_heat: bool) -> Self {
        Self {
            may_heat,
            passed: RefCell::default(),
            has_failed: Cell::default(),
        }
    }

    /// Whether a check failed, or could not be made: then nothing more may be played.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.has_failed.get()
    }

    /// Makes the checks of each drive that is not the emulator, unless it has passed them; a folder in `parent` keeps what was
    /// on the bus while a drive was led.
    ///
    /// # Errors
    /// The check that failed, or why it could not be made.
    pub fn make(
        &self,
        plan: &Plan,
        parent: &Path,
        bus: &RunBus,
        connection: &mut BusConnection,
        watch: &Watch,
        report: &dyn Fn(&PreflightEvent),
    ) -> Result<End, WorldError> {
        let session = Session {
            parent,
            connection,
            watch,
        };
        let made = self.check_drives(plan, bus, session, report);
        self.has_failed.set(made.is_err());
        made
    }

    fn check_drives(
        &self,
        plan: &Plan,
        bus: &RunBus,
        session: Session<'_>,
        report: &dyn Fn(&PreflightEvent),
    ) -> Result<End, WorldError> {
        let is_external = |one: &&ControlLoop| one.is_external(Part::Drive);
        let has_passed = |one: &&ControlLoop| self.passed.borrow().contains(&who(one));
        let unchecked = plan.loops.iter().filter(is_external);
        let unchecked = Vec::from_iter(unchecked.filter(|one| !has_passed(one)));
        if unchecked.is_empty() {
            return Ok(End::Completed);
        }
        report(&PreflightEvent::Begun);
        let bit_rate = plan.shared.bus.bitrate_kilobits_per_second;
        pass(interface::checks(bus, bit_rate), report)?;
        let is_led_elsewhere = |one: &&ControlLoop| one.is_external(Part::Controller);
        if unchecked.iter().any(is_led_elsewhere) {
            let text = "left to the external controller, which leads it";
            pass(vec![Check::open("drive", text)], report)?;
            return Ok(End::Completed);
        }
        let Session {
            parent,
            connection,
            watch,
        } = session;
        for one in unchecked {
            let session = Session {
                parent,
                connection: &mut *connection,
                watch,
            };
            match self.check_drive(one, session, report)? {
                End::Completed => self.passed.borrow_mut().insert(who(one)),
                end => return Ok(end),
            };
        }
        Ok(End::Completed)
    }

    /// The checks of one drive.
    fn check_drive(
        &self,
        one: &ControlLoop,
        session: Session<'_>,
        report: &dyn Fn(&PreflightEvent),
    ) -> Result<End, WorldError> {
        if one.loop_name.is_some() {
            report(&PreflightEvent::Drive(drive_name(one).to_owned()));
        }
        let rig = self.rig(one)?;
        let mut interview = interview(&rig, one.is_external(Part::Io))?;
        let Session {
            parent,
            connection,
            watch,
        } = session;
        connection.run_node(&mut interview, watch)?;
        if watch.is_interrupted() {
            return Ok(End::Interrupted);
        }
        let passed = pass(interview.checks(), report);
        if let Some(manager) = interview.manager() {
            let found = format!(
                "the pre-flight hears {manager}: end the other controller, or name it with --external controller"
            );
            return Err(WorldError::SecondMaster(found));
        }
        passed?;
        let session = Session {
            parent,
            connection: &mut *connection,
            watch,
        };
        let end = heat(&rig, one, session, report)?;
        if end == End::Interrupted || !rig.file.preflight.heating {
            return Ok(end);
        }
        let cooling = Duration::from_secs_f64(rig.file.preflight.cooling_seconds);
        report(&PreflightEvent::Cooling(cooling));
        cool(cooling, connection, watch)
    }

    /// The rig, or that of the emulated drive where there is no rig file, with the user's wish.
    fn rig(&self, one: &ControlLoop) -> Result<Arc<LoadedRig>, WorldError> {
        let mut rig = match &one.rig {
            Some(rig) => LoadedRig::clone(rig),
            None => emulated(one)?,
        };
        rig.file.preflight.heating &= self.may_heat;
        Ok(Arc::new(rig))
    }
}

/// Which drive it is: scenarios of one command may name several rigs.
fn who(one: &ControlLoop) -> String {
    let rig = one.rig.as_deref().map_or("", |rig| rig.text.as_str());
    format!("{} {rig}", one.place.drive_node_id)
}

/// Reports the checks, up to the first that failed.
fn pass(checks: Vec<Check>, report: &dyn Fn(&PreflightEvent)) -> Result<(), WorldError> {
    for check in checks {
        let failed = (check.outcome == CheckOutcome::Failed).then(|| WorldError::Preflight {
            name: check.name,
            found: check.found.clone(),
        });
        report(&PreflightEvent::Checked(check));
        if let Some(failed) = failed {
            return Err(failed);
        }
    }
    Ok(())
}

/// Where the drive is led: with the folder of the recording in `parent`.
struct Session<'a> {
    parent: &'a Path,
    connection: &'a mut BusConnection,
    watch: &'a Watch,
}

/// Leads the drive through the ramp and judges what was on the bus.
fn heat(
    rig: &Arc<LoadedRig>,
    one: &ControlLoop,
    session: Session<'_>,
    report: &dyn Fn(&PreflightEvent),
) -> Result<End, WorldError> {
    let Session {
        parent,
        connection,
        watch,
    } = session;
    let ramp = ramp(rig, one)?;
    let Shared {
        name, seed, text, ..
    } = &ramp.shared;
    let folder = RunFolder::create(parent, name, *seed, text)?;
    write_plan(&folder, &ramp)?;
    let progress = ProgressReader::new(ramp.leading())?;
    let clock = ramp.scenario_clock()?;
    let mut capture = Capture::new(folder.bus_log(false)?, progress, clock, watch, Vec::new());
    let mut heating = Heating::new(rig, &one.scenario.wiring.unit)?;
    let mut is_enough = |capture: &Capture<'_>| {
        heating.follow(capture);
        heating.is_over()
    };
    let ended = real_time::play(&ramp, &folder, &mut capture, connection, &mut is_enough);
    await_stopped(connection, &mut capture, &mut heating)?;
    capture.finish()?;
    let ended = match ended.map(|played| played.end) {
        Err(second_master @ WorldError::SecondMaster(_)) => return Err(second_master),
        Ok(End::Interrupted) => return Ok(End::Interrupted),
        Ok(End::ByNode(end)) => Err(WorldError::ByNode(end)),
        Ok(End::Completed) => Ok(()),
        Err(error) => Err(error),
    };
    pass(heating.checks(ended.as_ref().copied()), report)?;
    Ok(End::Completed)
}

fn interview(rig: &LoadedRig, has_real_io: bool) -> Result<Interview, WorldError> {
    let dictionary = eds::parse(&rig.eds, rig.drive.node_id().get())
        .map_err(|error| cannot_be_made(&error))?
        .dictionary;
    let node_id = NodeId::new(rig.file.fan.node_id).filter(|_| has_real_io);
    let fan = node_id.map(|node_id| (node_id, "fan and load module"));
    Ok(Interview::new(rig, dictionary, fan.as_slice()))
}

/// What is known of the emulated drive, with limits that are what its positions can be. They are in the drive's unit, whatever
/// the keys say.
fn emulated(one: &ControlLoop) -> Result<LoadedRig, WorldError> {
    let Scenario { bus, wiring, .. } = &one.scenario;
    let node_id = one.place.drive_node_id;
    let [lowest, highest] = wiring.range();
    let travel = highest - lowest;
    // A motor's differ in nothing that is asked here.
    let plausible = wiring.plausible_positions(true);
    let text = format!(
        "schema = 1\nname = \"the emulated drive\"\n[drive]\nnode_id = {node_id}\n\
         position = {{ units_per_millimetre = {:?}, resolution_millimetres = {:?} }}\n[bus]\nbitrate_kilobits_per_second = {}\n\
         sync_period_milliseconds = {:?}\n[limits]\ncurrent_amperes = 1.0\n\
         position_millimetres = {{ min = {:?}, max = {:?} }}\nspeed_millimetres_per_second = {:?}\n",
        wiring.unit.counts(),
        travel / STEPS_OF_TRAVEL,
        bus.bitrate_kilobits_per_second,
        bus.sync_period_milliseconds,
        plausible.min.unwrap_or(lowest),
        plausible.max.unwrap_or(highest),
        plausible.rate_max.unwrap_or(travel / TRAVEL_SECONDS)
    );
    LoadedRig::from_text(&text).map_err(|error| cannot_be_made(&error))
}

/// The session in which the drive is led: at rest, then under a ramp from 0 A to the limit of the rig.
fn ramp(rig: &Arc<LoadedRig>, one: &ControlLoop) -> Result<Plan, WorldError> {
    let preflight = &rig.file.preflight;
    let rest = heating::REST.as_secs_f64();
    let limit = rig.file.limits.current_amperes;
    let seconds = match preflight.heating {
        true => preflight.heating_seconds_max,
        false => rest,
    };
    let mut text = format!(
        "schema = 1\nname = \"{NAME}\"\nduration_seconds = {:?}\n",
        rest + seconds
    );
    text += "[controller.open_loop]\n";
    if preflight.heating {
        let until = rest + limit / preflight.ramp_amperes_per_second;
        text += &format!(
            "[[controller.open_loop.ramp]]\nfrom_seconds = {rest:?}\nuntil_seconds = {until:?}\ncurrent_amperes = {limit:?}\n"
        );
    }
    let scenario = Scenario::parse(&text, NAME, |_| Err(std::io::ErrorKind::NotFound.into()))
        .map_err(|error| cannot_be_made(&error))?;
    let ramp = Plan::new(scenario, catalogue()).from_file(NAME, text);
    let mut ramp = ramp.on(rig);
    if one.is_external(Part::Io) {
        ramp = ramp.recorded_external(&[FAN.to_owned()]);
    }
    // Who watches the limits names them in the unit of the drive.
    for ramped in &mut ramp.loops {
        ramped.scenario.wiring.unit = one.scenario.wiring.unit.clone();
    }
    Ok(ramp)
}

fn cannot_be_made(reason: &dyn std::fmt::Display) -> WorldError {
    WorldError::Preflight {
        name: NAME,
        found: format!("it cannot be made: {reason}"),
    }
}

/// Records on until a heartbeat of the drive says that it was stopped.
fn await_stopped(
    connection: &mut BusConnection,
    capture: &mut Capture<'_>,
    heating: &mut Heating<'_>,
) -> Result<(), WorldError> {
    let patience = heating.patience() + HEARTBEAT_PATIENCE;
    let clock = clock::Clock::start();
    loop {
        connection.collect(capture)?;
        heating.follow(capture);
        if heating.is_stopped() || clock.now() > patience {
            return Ok(());
        }
        clock::sleep(POLL_PERIOD);
    }
}

/// Waits, unless the user does not want to, and keeps the bench's place on the bus meanwhile.
fn cool(time: Duration, connection: &BusConnection, watch: &Watch) -> Result<End, WorldError> {
    let vigil = Vigil::begin(connection.address())?;
    let clock = clock::Clock::start();
    while clock.now() < time && !watch.is_interrupted() && !vigil.is_broken() {
        clock::sleep(POLL_PERIOD);
    }
    vigil.end()?;
    Ok(match watch.is_interrupted() {
        true => End::Interrupted,
        false => End::Completed,
    })
}
