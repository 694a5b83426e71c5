//! The controller as a node of the bus: NMT manager, SYNC producer, and the law's cycle.
//!
//! A SYNC makes the drive sample; its TPDO1 brings the sample; the law's command leaves in RPDO1 and acts with the next
//! SYNC: one cycle of delay. Scenario time 0 is the first SYNC after Operation enabled was seen.

use std::fmt;
use std::time::Duration;

use canopen::cia402::{Command as DriveCommand, State};
use canopen::emcy::{EmergencyMessage, ErrorCode};
use canopen::services::InvalidPdo;
use canopen::{
    Application, CanFrame, CommunicationLoss, Device, Filter, NmtCommand, NmtState, Node, Progress,
    Services, eds, nmt::NodeId, sync::Sync,
};
use scenario::ControllerView;
use scenario::reference::Trajectory;
use scenario::rig::{Rig, Timeouts};

use crate::catalogue::{self, LawError};
use crate::cause::Cause;
use crate::drive::{Drive, Feedback};
use crate::explanation::{self, ExplanationObjects};
use crate::law::{Law, Measurement};
use crate::limits::LimitWatch;
use crate::manager::{BringUp, Outcome};
use crate::plausibility::Plausibility;

/// Node-ID of the controller.
pub const CONTROLLER: NodeId = NodeId::new(0x01).expect("1 is a node id");
/// Node-ID of the disturbance module.
pub const DISTURBANCE: NodeId = NodeId::new(0x11).expect("17 is a node id");

/// The drive must reach Operation enabled within this time after its start.
pub const ENABLE_TIME: Duration = Duration::from_secs(2);

/// Time between two questions to a drive that has not shown up.
const SEARCH_PERIOD: Duration = Duration::from_millis(100);
/// SYNCs that carry the command 0 to the drive before NMT stop.
const SYNCS_TO_STOP: u8 = 2;

const SYNC_PERIOD_OBJECT: u16 = 0x1006;
const CONSUMER_HEARTBEAT_TIME: u16 = 0x1016;
const ERROR_BEHAVIOUR: u16 = 0x1029;

/// Why a controller cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The scenario selects no law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// An EDS cannot be read.
    #[error("the EDS is wrong: {0}")]
    Eds(#[from] eds::EdsError),
    /// The controller's own PDOs are wrong.
    #[error("the controller's EDS is wrong: {0}")]
    Pdo(#[from] InvalidPdo),
    /// The controller's EDS lacks an object.
    #[error("the controller's EDS has no object 0x{0:04X}")]
    NoObject(u16),
    /// A PDO of the drive is not described.
    #[error("the drive's EDS describes no usable PDO at 0x{0:04X}")]
    DrivePdo(u16),
    /// The drive lacks an object.
    #[error("the drive's EDS has no object 0x{index:04X}:{sub_index:02X}")]
    NoDriveObject {
        /// Its index.
        index: u16,
        /// Its sub-index.
        sub_index: u8,
    },
    /// An object of the drive is of another type.
    #[error("the drive's object 0x{index:04X}:{sub_index:02X} is no integer of 8, 16 or 32 bits")]
    NoInteger {
        /// Its index.
        index: u16,
        /// Its sub-index.
        sub_index: u8,
    },
    /// No object's name.
    #[error("\"{0}\" names no object")]
    Address(String),
    /// No node's number.
    #[error("{0} is no node-ID")]
    NodeId(u8),
    /// More objects than a PDO holds.
    #[error(
        "the objects of the rig file take {bytes} bytes in PDO mapping 0x{mapping:04X} (limit 8)"
    )]
    PdoTooLong {
        /// The mapping's index.
        mapping: u16,
        /// Their bytes.
        bytes: usize,
    },
}

/// What has been counted since the start of the scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// SYNCs sent.
    pub cycles: u64,
    /// Cycles without a position from the drive.
    pub missing_positions: u64,
    /// SYNCs not sent because their time had passed.
    pub sync_overruns: u64,
}

/// One line.
impl fmt::Display for Statistics {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycles,
            missing_positions,
            sync_overruns,
        } = self;
        write!(
            formatter,
            "{cycles} cycles, {missing_positions} without a position, {sync_overruns} SYNCs skipped"
        )
    }
}

/// The controller.
#[derive(Debug)]
pub struct ControllerNode {
    device: Device<Controller>,
}

impl ControllerNode {
    /// A controller for what it may know of a scenario.
    ///
    /// # Errors
    /// The scenario selects no law, or an EDS does not fit.
    pub fn new(view: &ControllerView) -> Result<Self, ControllerError> {
        let drive = Drive::from_eds(dbc::DRIVE_EDS)?;
        Self::leading(view, dbc::CONTROLLER_EDS, drive, &Timeouts::default(), None)
    }

    /// As [`ControllerNode::new`], for the drive of a rig file, whose limits it obeys.
    ///
    /// # Errors
    /// As [`ControllerNode::new`].
    pub fn on_rig(
        view: &ControllerView,
        rig: &Rig,
        drive_eds: &str,
    ) -> Result<Self, ControllerError> {
        let view = ControllerView {
            bus: rig.bus.of_scenario(),
            ..view.clone()
        };
        let drive = Drive::new(drive_eds, &rig.drive, rig.limits.current_amperes)?;
        let limits = LimitWatch::new(&rig.limits, view.bus.sync_period());
        Self::leading(
            &view,
            dbc::CONTROLLER_EDS,
            drive,
            &rig.timeouts,
            Some(limits),
        )
    }

    fn leading(
        view: &ControllerView,
        controller_eds: &str,
        drive: Drive,
        timeouts: &Timeouts,
        limits: Option<LimitWatch>,
    ) -> Result<Self, ControllerError> {
        let law = catalogue::law(&view.controller)?;
        let mut dictionary = eds::parse(controller_eds, CONTROLLER.get())?.dictionary;
        explanation::declare(&mut dictionary, &law.terms());
        // Checked here, since it is written only when the drive is configured.
        let watch = dictionary.unsigned(CONSUMER_HEARTBEAT_TIME, 1);
        watch.ok_or(ControllerError::NoObject(CONSUMER_HEARTBEAT_TIME))?;
        let watch =
            u32::from(drive.node_id.get()) << 16 | u32::from(timeouts.drive_lost_milliseconds);
        let sync_period = view.bus.sync_period();
        let controller = Controller {
            trajectory: view.reference.trajectory(),
            explanation: ExplanationObjects::find(&dictionary, &law)?,
            law,
            bring_up: BringUp::new(&drive, sync_period, timeouts),
            drive,
            sync_period,
            timeouts: *timeouts,
            watch,
            phase: Phase::Off,
            controlword: 0,
            last_heard: Duration::ZERO,
            last_statusword: None,
            last_emergency: None,
            plausibility: Plausibility::default(),
            implausible: None,
            limits,
            current_amperes: 0.0,
            failure: None,
            statistics: Statistics::default(),
        };
        let device = Device::new(CONTROLLER, dictionary, controller)?;
        Ok(Self { device })
    }

    /// What has been counted since the start of the scenario.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.device.application().statistics
    }
}

impl Node for ControllerNode {
    /// NMT, SYNC and EMCY, the drive's TPDO1, SDO, and heartbeats. The emulator's truth (TPDO2) is not among them.
    fn filters(&self) -> Vec<Filter> {
        let function = |id| Filter {
            mask: Filter::exact(0).mask & !0x7F,
            ..Filter::exact(id)
        };
        let feedback = self.device.application().drive.feedback_id();
        vec![
            Filter::exact(0x000),
            function(0x080),
            Filter::exact(feedback),
            function(0x580),
            function(0x600),
            function(0x700),
            Filter::ERRORS,
        ]
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.device.on_frame(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        self.device.on_tick(now);
    }

    fn on_stop(&mut self, now: Duration) {
        self.device.on_stop(now);
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.device.next_frame()
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.device.next_deadline()
    }

    fn progress(&self) -> Progress {
        self.device.progress()
    }
}

/// What the controller is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Not booted.
    Off,
    /// Looks for the drive.
    Searching {
        until: Duration,
        next_question: Duration,
    },
    /// The drive was up already and has been told to reset its communication; its boot-up is awaited.
    Resetting { until: Duration },
    /// Configures the drive by SDO.
    Configuring { until: Duration },
    /// Leads the drive to Operation enabled.
    Enabling { until: Duration },
    /// Operation enabled was seen; the next SYNC is scenario time 0.
    Ready,
    /// Runs the law.
    Running(Cycle),
    /// Sends the command 0 and quick stop until the drive has surely taken it.
    Stopping { until: Duration, syncs_left: u8 },
    /// The drive is stopped; nothing more to say.
    Ended,
}

/// The present cycle of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cycle {
    /// Periods since scenario time 0.
    number: u64,
    /// The drive's position has come.
    has_position: bool,
    /// Cycles without a position in a row.
    missing: u64,
    /// SYNC overruns up to here.
    overruns: u64,
}

/// The application of the controller's device.
#[derive(Debug)]
struct Controller {
    law: Law,
    trajectory: Trajectory,
    explanation: ExplanationObjects,
    bring_up: BringUp,
    drive: Drive,
    sync_period: Duration,
    timeouts: Timeouts,
    /// How the drive's heartbeat is watched: 0x1016:01 once the drive is configured.
    watch: u32,
    phase: Phase,
    /// The last controlword sent.
    controlword: u16,
    /// When the drive's last heartbeat came.
    last_heard: Duration,
    last_statusword: Option<u16>,
    last_emergency: Option<EmergencyMessage>,
    plausibility: Plausibility,
    /// Why the latest sample was no position.
    implausible: Option<Cause>,
    /// The rig's limits.
    limits: Option<LimitWatch>,
    /// The last command.
    current_amperes: f64,
    failure: Option<String>,
    statistics: Statistics,
}

impl Controller {
    /// Sends RPDO1.
    fn command(&mut self, services: &mut Services, controlword: u16, current_amperes: f64) {
        self.controlword = controlword;
        self.current_amperes = current_amperes;
        services.send(self.drive.encode(controlword, current_amperes));
    }

    /// The drive is there, but who knows in which state: it begins anew.
    fn reset_drive(&mut self, services: &mut Services, until: Duration) {
        services.send_nmt(NmtCommand::ResetCommunication, Some(self.drive.node_id));
        self.phase = Phase::Resetting { until };
    }

    fn configure(&mut self, services: &mut Services, until: Duration) {
        self.phase = Phase::Configuring { until };
        let outcome = self.bring_up.begin(services);
        self.on_outcome(services, outcome);
    }

    fn on_outcome(&mut self, services: &mut Services, outcome: Outcome) {
        match outcome {
            Outcome::Busy => {}
            Outcome::Done => self.start(services),
            Outcome::Failed(text) => self.fail(services, Cause::NoBringUp, text),
        }
    }

    /// Starts drive, itself and SYNC, and watches the drive from now on.
    fn start(&mut self, services: &mut Services) {
        let now = services.now();
        self.phase = Phase::Enabling {
            until: now + ENABLE_TIME,
        };
        self.last_heard = now;
        services.send_nmt(NmtCommand::Start, Some(self.drive.node_id));
        services.request_nmt(NmtCommand::Start);
        self.configure_self(services, self.watch, self.sync_period);
    }

    /// Writes the own objects that change with the phase.
    fn configure_self(&mut self, services: &mut Services, watch: u32, sync_period: Duration) {
        let microseconds = u32::try_from(sync_period.as_micros()).unwrap_or(u32::MAX);
        let writes = [
            (CONSUMER_HEARTBEAT_TIME, 1, watch),
            (SYNC_PERIOD_OBJECT, 0, microseconds),
        ];
        for (index, sub_index, value) in writes {
            if let Err(code) = services.write(index, sub_index, &value.to_le_bytes()) {
                let text = format!(
                    "the controller's own object 0x{index:04X}:{sub_index:02X} refuses {value}: {code}"
                );
                self.failure.get_or_insert(text);
                self.phase = Phase::Ended;
            }
        }
    }

    /// Takes the energy away, says why on the bus and remembers it.
    fn fail(&mut self, services: &mut Services, cause: Cause, text: String) {
        if matches!(self.phase, Phase::Stopping { .. } | Phase::Ended) {
            return;
        }
        self.failure = Some(text);
        services.raise_error(cause.code(), cause.manufacturer());
        self.stop(services);
    }

    /// Command 0 and quick stop first; NMT stop when a SYNC or two have made it valid.
    fn stop(&mut self, services: &mut Services) {
        match self.phase {
            Phase::Stopping { .. } | Phase::Ended => {}
            Phase::Enabling { .. } | Phase::Ready | Phase::Running(_) => {
                let patience = u32::from(SYNCS_TO_STOP) + 2;
                let until = services.now() + patience * self.sync_period;
                let syncs_left = SYNCS_TO_STOP;
                self.phase = Phase::Stopping { until, syncs_left };
                self.command(services, DriveCommand::QuickStop.controlword(), 0.0);
            }
            _ => self.end(services),
        }
    }

    /// NMT stop; the last thing that the controller does.
    fn end(&mut self, services: &mut Services) {
        self.phase = Phase::Ended;
        for node in [self.drive.node_id, DISTURBANCE] {
            services.send_nmt(NmtCommand::Stop, Some(node));
        }
        self.configure_self(services, 0, Duration::ZERO);
    }

    /// Leads the drive one step nearer to Operation enabled.
    fn enable(&mut self, services: &mut Services, feedback: &Feedback) {
        let state = State::from_statusword(feedback.statusword);
        self.last_statusword = Some(feedback.statusword);
        if state == Some(State::OperationEnabled) {
            self.phase = Phase::Ready;
        }
        let wanted = state.map_or(0, State::controlword_towards_operation);
        // A fault is reset by an edge, so the bit must fall before it can rise again.
        let reset = DriveCommand::FaultReset.controlword();
        let controlword = if wanted == reset && self.controlword == reset {
            0
        } else {
            wanted
        };
        self.command(services, controlword, 0.0);
    }

    /// Ends the previous cycle and begins the next, at its SYNC.
    fn begin_cycle(&mut self, services: &mut Services, mut cycle: Cycle) {
        let overruns = services.sync_overruns();
        let skipped = overruns - cycle.overruns;
        cycle.overruns = overruns;
        self.statistics.sync_overruns += skipped;
        self.statistics.cycles += 1;
        let cycles = f64::from(u32::try_from(skipped).unwrap_or(u32::MAX)) + 1.0;
        let elapsed_seconds = cycles * self.sync_period.as_secs_f64();
        self.plausibility
            .advance(elapsed_seconds, self.current_amperes);
        if !cycle.has_position {
            cycle.missing += 1;
            self.statistics.missing_positions += 1;
            self.step(services, &cycle, f64::NAN);
        }
        // The law lives through skipped cycles too, so that its model keeps pace with the plant.
        let missing_max = u64::from(self.timeouts.missing_positions_cycles);
        for _ in 0..skipped.min(missing_max) {
            cycle.number += 1;
            self.step(services, &cycle, f64::NAN);
        }
        cycle.number += 1 + skipped.saturating_sub(missing_max);
        cycle.has_position = false;
        self.phase = Phase::Running(cycle);
        if cycle.missing > missing_max {
            let cause = self.implausible.unwrap_or(Cause::NoPosition);
            let what = if self.implausible.is_some() {
                "no plausible position"
            } else {
                "no position"
            };
            let text = format!(
                "{what} from the drive (node {}, frame 0x{:03X}) in {} cycles (limit {missing_max})",
                self.drive.node_id,
                self.drive.feedback_id(),
                cycle.missing
            );
            self.fail(services, cause, text);
        }
    }

    /// One step of the law; the command in amperes.
    fn step(&mut self, services: &mut Services, cycle: &Cycle, position_metres: f64) -> f64 {
        let period_nanoseconds = u64::try_from(self.sync_period.as_nanos()).unwrap_or(u64::MAX);
        let time = Duration::from_nanos(period_nanoseconds.saturating_mul(cycle.number));
        let measurement = Measurement {
            scenario_time_seconds: time.as_secs_f64(),
            position_metres,
        };
        let set_point = self.trajectory.at(measurement.scenario_time_seconds);
        let period_seconds = self.sync_period.as_secs_f64();
        let command = self.law.step(&measurement, &set_point, period_seconds);
        self.explanation
            .store(services.dictionary_mut(), &command.explanation, &self.law);
        command.current_amperes
    }

    /// The drive's sample of this cycle: the law's turn. A second one in a cycle is late or forged and passed over.
    fn on_sample(&mut self, services: &mut Services, mut cycle: Cycle, feedback: &Feedback) {
        let state = State::from_statusword(feedback.statusword);
        if state != Some(State::OperationEnabled) {
            let state = state_words(feedback.statusword);
            let text = format!(
                "the drive (node {}) left Operation enabled: statusword {state}",
                self.drive.node_id
            );
            self.fail(services, Cause::DriveNotEnabled, text);
            return;
        }
        if cycle.has_position {
            return;
        }
        let now = services.now();
        let limits = self.limits.as_mut();
        if let Some(violation) = limits.and_then(|limits| limits.check(now, feedback)) {
            self.fail(services, Cause::RigLimit, violation.to_string());
            return;
        }
        match self.plausibility.check(feedback.position_metres) {
            Ok(()) => self.implausible = None,
            Err(cause @ Cause::PositionFrozen) => {
                let millimetres = feedback.position_metres * 1e3;
                let text = format!(
                    "the position stands still at {millimetres:.1} mm although the wire is heated"
                );
                self.fail(services, cause, text);
                return;
            }
            Err(cause) => {
                self.implausible = Some(cause);
                return;
            }
        }
        (cycle.has_position, cycle.missing) = (true, 0);
        self.phase = Phase::Running(cycle);
        let current_amperes = self.step(services, &cycle, feedback.position_metres);
        self.command(
            services,
            DriveCommand::EnableOperation.controlword(),
            current_amperes,
        );
    }

    /// True while the drive is led by this controller.
    fn leads(&self) -> bool {
        matches!(
            self.phase,
            Phase::Enabling { .. } | Phase::Ready | Phase::Running(_)
        )
    }

    /// Until when the bring-up must be over, while it goes on.
    fn bring_up_deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::Searching { until, .. }
            | Phase::Resetting { until }
            | Phase::Configuring { until } => Some(until),
            _ => None,
        }
    }

    /// What to say when a phase has lasted too long.
    fn overdue(&self) -> String {
        let seconds = self.timeouts.bring_up_seconds;
        let drive = self.drive.node_id;
        match self.phase {
            Phase::Resetting { .. } => {
                format!(
                    "the drive (node {drive}) did not boot within {seconds} s after NMT reset communication"
                )
            }
            Phase::Configuring { .. } => {
                format!("the drive (node {drive}) was not configured within {seconds} s")
            }
            Phase::Enabling { .. } => {
                let seconds = ENABLE_TIME.as_secs();
                let last = self.last_statusword.map_or_else(
                    || format!("it sent no TPDO1 (0x{:03X})", self.drive.feedback_id()),
                    |statusword| format!("its last statusword was {}", state_words(statusword)),
                );
                let emergency = self.last_emergency.map_or_else(String::new, |message| {
                    format!(", its last emergency 0x{:04X}", message.code.0)
                });
                format!(
                    "the drive (node {drive}) did not reach Operation enabled within {seconds} s; {last}{emergency}"
                )
            }
            _ => format!(
                "no drive: node {drive} sent no boot-up message or heartbeat and answered no SDO for {seconds} s"
            ),
        }
    }
}

/// A statusword with its state, for people.
fn state_words(statusword: u16) -> String {
    match State::from_statusword(statusword) {
        Some(state) => format!("0x{statusword:04X} ({state:?})"),
        None => format!("0x{statusword:04X} (no state of CiA 402)"),
    }
}

impl Application for Controller {
    fn on_reset(&mut self, services: &mut Services, _: NmtCommand) {
        // A lost module or drive is this application's business; the device itself stays Operational.
        services.write(ERROR_BEHAVIOUR, 1, &[1]).ok();
        self.configure_self(services, 0, Duration::ZERO);
        if self.phase == Phase::Off {
            let now = services.now();
            let until = now + self.timeouts.bring_up();
            self.phase = Phase::Searching {
                until,
                next_question: now,
            };
        } else {
            let text = "the controller was reset over the bus".to_owned();
            self.fail(services, Cause::OrderedAbout, text);
        }
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        let may_lead = matches!(state, NmtState::Operational);
        if self.leads() && !may_lead {
            self.fail(
                services,
                Cause::OrderedAbout,
                format!("the controller was ordered to NMT state {state:?} over the bus"),
            );
        }
    }

    fn on_sync(&mut self, services: &mut Services, _: &Sync) {
        match self.phase {
            Phase::Ready => {
                let overruns = services.sync_overruns();
                self.statistics.cycles = 1;
                self.phase = Phase::Running(Cycle {
                    overruns,
                    ..Cycle::default()
                });
            }
            Phase::Running(cycle) => self.begin_cycle(services, cycle),
            Phase::Stopping { syncs_left: 0, .. } => self.end(services),
            Phase::Stopping { until, syncs_left } => {
                self.phase = Phase::Stopping {
                    until,
                    syncs_left: syncs_left - 1,
                };
                self.command(services, DriveCommand::QuickStop.controlword(), 0.0);
            }
            _ => {}
        }
    }

    fn on_frame(&mut self, services: &mut Services, frame: &CanFrame) {
        if let Some(feedback) = self.drive.decode(frame) {
            match self.phase {
                Phase::Enabling { .. } => self.enable(services, &feedback),
                Phase::Running(cycle) => self.on_sample(services, cycle, &feedback),
                _ => {}
            }
            return;
        }
        self.bring_up.on_frame(services, frame);
        match self.phase {
            Phase::Searching { until, .. } if self.bring_up.is_answered() => {
                self.reset_drive(services, until);
            }
            Phase::Configuring { .. } => {
                let outcome = self.bring_up.advance(services);
                self.on_outcome(services, outcome);
            }
            _ => {}
        }
    }

    fn on_heartbeat(&mut self, services: &mut Services, node_id: NodeId, state: NmtState) {
        let is_ending = matches!(self.phase, Phase::Stopping { .. } | Phase::Ended);
        let waits = matches!(state, NmtState::Initialising | NmtState::PreOperational);
        if node_id == DISTURBANCE && waits && !is_ending {
            services.send_nmt(NmtCommand::Start, Some(DISTURBANCE));
        }
        if node_id != self.drive.node_id {
            return;
        }
        self.last_heard = services.now();
        let has_booted = state == NmtState::Initialising;
        match (self.phase, self.bring_up_deadline()) {
            (_, Some(until)) if has_booted => self.configure(services, until),
            (Phase::Searching { until, .. }, _) => self.reset_drive(services, until),
            (Phase::Ready | Phase::Running(_), _) if state != NmtState::Operational => {
                self.fail(
                    services,
                    Cause::DriveNotOperational,
                    format!(
                        "the drive (node {node_id}) left NMT state Operational: it is {state:?}"
                    ),
                );
            }
            _ => {}
        }
    }

    fn on_emergency(
        &mut self,
        services: &mut Services,
        node_id: NodeId,
        message: &EmergencyMessage,
    ) {
        if node_id != self.drive.node_id || message.code == ErrorCode::NO_ERROR {
            return;
        }
        self.last_emergency = Some(*message);
        if matches!(self.phase, Phase::Ready | Phase::Running(_)) {
            let EmergencyMessage { code, register, .. } = message;
            let text = format!(
                "the drive (node {node_id}) reports emergency 0x{:04X}, error register 0x{register:02X}",
                code.0
            );
            self.fail(services, Cause::DriveEmergency, text);
        }
    }

    fn on_communication_loss(&mut self, services: &mut Services, loss: CommunicationLoss) {
        match loss {
            CommunicationLoss::Heartbeat(node) if node == self.drive.node_id && self.leads() => {
                let silent = services.now().saturating_sub(self.last_heard).as_millis();
                let limit = u128::from(self.watch & 0xFFFF);
                let text = if silent < limit {
                    format!("the drive (node {node}) restarted while it was led")
                } else {
                    format!(
                        "heartbeat from the drive (node {node}) missing for {silent} ms (limit {limit} ms)"
                    )
                };
                self.fail(services, Cause::DriveNotOperational, text);
            }
            CommunicationLoss::BusOff => {
                let text = "the CAN controller went bus-off".to_owned();
                self.fail(services, Cause::DriveNotOperational, text);
            }
            _ => {}
        }
    }

    fn on_tick(&mut self, services: &mut Services) {
        let now = services.now();
        match self.phase {
            Phase::Searching { until, .. }
            | Phase::Resetting { until }
            | Phase::Configuring { until }
            | Phase::Enabling { until }
                if now >= until =>
            {
                self.fail(services, Cause::NoBringUp, self.overdue());
            }
            Phase::Searching {
                until,
                next_question,
            } if now >= next_question => {
                let next_question = now + SEARCH_PERIOD;
                self.phase = Phase::Searching {
                    until,
                    next_question,
                };
                self.bring_up.ask(services);
            }
            Phase::Configuring { .. } => {
                self.bring_up.on_tick(services);
                let outcome = self.bring_up.advance(services);
                self.on_outcome(services, outcome);
            }
            Phase::Stopping { until, .. } if now >= until => self.end(services),
            _ => {}
        }
    }

    fn next_deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::Searching {
                until,
                next_question,
            } => Some(until.min(next_question)),
            Phase::Configuring { until } => Some(
                self.bring_up
                    .next_deadline()
                    .map_or(until, |answer| answer.min(until)),
            ),
            Phase::Resetting { until }
            | Phase::Enabling { until }
            | Phase::Stopping { until, .. } => Some(until),
            Phase::Off | Phase::Ready | Phase::Running(_) | Phase::Ended => None,
        }
    }

    fn on_stop(&mut self, services: &mut Services) {
        self.stop(services);
    }

    fn progress(&self, _: bool) -> Progress {
        match (&self.phase, &self.failure) {
            (Phase::Ended, Some(text)) => Progress::Failed(text.clone()),
            (Phase::Ended, None) => Progress::Stopped,
            _ => Progress::Running,
        }
    }
}

#[cfg(test)]
mod tests;
