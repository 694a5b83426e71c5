//! The way of the controller: it looks for the drive, configures and enables it, and takes it to its stop.

use std::time::Duration;

use canopen::Services;
use canopen::cia402::{Command as DriveCommand, State};
use canopen::emcy::EmergencyMessage;
use canopen::nmt::{NmtCommand, NodeId};
use scenario::reference::Trajectory;
use scenario::rig::Timeouts;
use scenario::rig::drive::{DriveLayout, Feedback};
use scenario::rig::limits::LimitWatch;

use super::phase::Phase;
use super::statistics::Statistics;
use crate::cause::Cause;
use crate::explanation::ExplanationObjects;
use crate::law::Law;
use crate::manager::{BringUp, Outcome};
use crate::plausibility::Plausibility;

/// The drive must reach Operation enabled within this time after its start.
pub const ENABLE_TIME: Duration = Duration::from_secs(2);

/// SYNCs that carry the command 0 to the drive before NMT stop.
const SYNCS_TO_STOP: u8 = 2;

const SYNC_PERIOD_OBJECT: u16 = 0x1006;
pub(super) const CONSUMER_HEARTBEAT_TIME: u16 = 0x1016;
/// The milliseconds in an entry of it; without them its node is not watched.
const WATCH_TIME: u32 = 0xFFFF;

/// The application of the controller's device.
#[derive(Debug)]
pub(super) struct Controller {
    pub(super) law: Law,
    pub(super) trajectory: Trajectory,
    /// False in open loop, where the trajectory is 0 throughout.
    pub(super) has_set_point: bool,
    pub(super) explanation: ExplanationObjects,
    pub(super) bring_up: BringUp,
    pub(super) drive: DriveLayout,
    /// The fan and load module.
    pub(super) fan: NodeId,
    pub(super) sync_period: Duration,
    pub(super) timeouts: Timeouts,
    /// How the drive's heartbeat is watched: 0x1016:01 once the drive is configured.
    pub(super) watch: u32,
    pub(super) phase: Phase,
    /// The last controlword sent.
    pub(super) controlword: u16,
    /// When the drive's last heartbeat came.
    pub(super) last_heard: Duration,
    pub(super) last_statusword: Option<u16>,
    pub(super) last_emergency: Option<EmergencyMessage>,
    pub(super) plausibility: Plausibility,
    /// Why the latest sample was no position.
    pub(super) implausible: Option<Cause>,
    /// The rig's limits.
    pub(super) limits: Option<LimitWatch>,
    /// The last command.
    pub(super) current_amperes: f64,
    pub(super) failure: Option<String>,
    pub(super) statistics: Statistics,
}

impl Controller {
    /// Sends RPDO1.
    pub(super) fn command(
        &mut self,
        services: &mut Services,
        controlword: u16,
        current_amperes: f64,
    ) {
        self.controlword = controlword;
        self.current_amperes = current_amperes;
        services.send(self.drive.encode(controlword, current_amperes));
    }

    /// The drive is there, but who knows in which state: it begins anew.
    pub(super) fn reset_drive(&mut self, services: &mut Services, until: Duration) {
        services.send_nmt(NmtCommand::ResetCommunication, Some(self.drive.node_id()));
        self.phase = Phase::Resetting { until };
    }

    pub(super) fn configure(&mut self, services: &mut Services, until: Duration) {
        self.phase = Phase::Configuring { until };
        let outcome = self.bring_up.begin(services);
        self.on_outcome(services, outcome);
    }

    pub(super) fn on_outcome(&mut self, services: &mut Services, outcome: Outcome) {
        match outcome {
            Outcome::Busy => {}
            Outcome::Done => self.start(services),
            Outcome::Failed(text) => self.fail(services, Cause::NoBringUp, text),
        }
    }

    /// Starts drive, itself and SYNC, and watches the drive from now on.
    pub(super) fn start(&mut self, services: &mut Services) {
        let now = services.now();
        self.phase = Phase::Enabling {
            until: now + ENABLE_TIME,
        };
        self.last_heard = now;
        services.send_nmt(NmtCommand::Start, Some(self.drive.node_id()));
        services.request_nmt(NmtCommand::Start);
        self.configure_self(services, self.watch, self.sync_period);
    }

    /// Writes the own objects that change with the phase.
    pub(super) fn configure_self(
        &mut self,
        services: &mut Services,
        watch: u32,
        sync_period: Duration,
    ) {
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

    /// Switches the current off, reports the cause on the bus and keeps it.
    pub(super) fn fail(&mut self, services: &mut Services, cause: Cause, text: String) {
        if matches!(self.phase, Phase::Stopping { .. } | Phase::Ended) {
            return;
        }
        self.failure = Some(text);
        services.raise_error(cause.code(), cause.manufacturer());
        self.stop(services);
    }

    /// Command 0 and quick stop first; NMT stop when a SYNC or two have made it valid.
    pub(super) fn stop(&mut self, services: &mut Services) {
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
    pub(super) fn end(&mut self, services: &mut Services) {
        self.phase = Phase::Ended;
        for node in [self.drive.node_id(), self.fan] {
            services.send_nmt(NmtCommand::Stop, Some(node));
        }
        self.configure_self(services, self.watch & !WATCH_TIME, Duration::ZERO);
    }

    /// Leads the drive one step nearer to Operation enabled.
    pub(super) fn enable(&mut self, services: &mut Services, feedback: &Feedback) {
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

    /// True while the drive is led by this controller.
    pub(super) fn leads(&self) -> bool {
        matches!(
            self.phase,
            Phase::Enabling { .. } | Phase::Ready | Phase::Running(_)
        )
    }

    /// Until when the bring-up must be over, while it goes on.
    pub(super) fn bring_up_deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::Searching { until, .. }
            | Phase::Resetting { until }
            | Phase::Configuring { until } => Some(until),
            _ => None,
        }
    }

    /// What to say when a phase has lasted too long.
    pub(super) fn overdue(&self) -> String {
        let seconds = self.timeouts.bring_up_seconds;
        let drive = self.drive.node_id();
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
pub(super) fn state_words(statusword: u16) -> String {
    match State::from_statusword(statusword) {
        Some(state) => format!("0x{statusword:04X} ({state:?})"),
        None => format!("0x{statusword:04X} (no state of CiA 402)"),
    }
}
