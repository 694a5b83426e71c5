//! A drive that the controller leads: its bring-up, and its latest state.

use std::time::Duration;

use can::earlier;
use canopen::Services;
use canopen::cia402::{Command as DriveCommand, State};
use canopen::emcy::EmergencyMessage;
use canopen::nmt::{NmtCommand, NodeId};
use scenario::rig::drive::{DriveLayout, Feedback};
use scenario::rig::limits::LimitWatch;

use super::LoopPlan;
use super::phase::DrivePhase;
use crate::cause::Cause;
use crate::manager::BringUp;
use crate::plausibility::Plausibility;

/// Time in which the drive must reach Operation enabled after its start.
pub const ENABLE_TIME: Duration = Duration::from_secs(2);

/// Most boots of a drive after its start, before scenario time 0.
const RESTARTS_MAX: u8 = 3;

/// A drive of the controller.
#[derive(Debug)]
pub(super) struct LedDrive {
    pub(super) layout: DriveLayout,
    pub(super) bring_up: BringUp,
    pub(super) phase: DrivePhase,
    /// Time by which it must be configured; from its start on, by which it must be enabled.
    pub(super) until: Duration,
    /// Number of times that it booted after its start, before scenario time 0.
    restarts: u8,
    /// Entry of 0x1016 that watches its heartbeat, written after its configuration.
    pub(super) watch: u32,
    /// The last controlword sent.
    controlword: u16,
    /// The last command.
    pub(super) commanded: f64,
    /// Time of the last heartbeat.
    pub(super) last_heard: Duration,
    last_statusword: Option<u16>,
    pub(super) last_emergency: Option<EmergencyMessage>,
    pub(super) plausibility: Plausibility,
    /// Reason why the latest sample was no position.
    pub(super) implausible: Option<Cause>,
    /// Limits of the rig.
    pub(super) limits: Option<LimitWatch>,
}

impl LedDrive {
    pub(super) fn new(plan: LoopPlan<'_>, manager: NodeId, sync_period: Duration) -> Self {
        let (wiring, timeouts) = (&plan.view.wiring, &plan.timeouts);
        let unit = &wiring.sensor.quantity.unit;
        let watch = |limits| LimitWatch::new(limits, sync_period, unit);
        let node_id = u32::from(plan.drive.node_id.get());
        Self {
            bring_up: BringUp::new(&plan.drive, manager, sync_period, timeouts),
            phase: DrivePhase::Searching {
                next_question: Duration::ZERO,
            },
            until: Duration::ZERO,
            restarts: 0,
            watch: node_id << 16 | u32::from(timeouts.drive_lost_milliseconds),
            controlword: 0,
            commanded: 0.0,
            last_heard: Duration::ZERO,
            last_statusword: None,
            last_emergency: None,
            plausibility: Plausibility::new(wiring),
            implausible: None,
            limits: plan.limits.map(watch),
            layout: plan.drive,
        }
    }

    pub(super) fn node_id(&self) -> NodeId {
        self.layout.node_id
    }

    pub(super) fn is_configured(&self) -> bool {
        self.phase == DrivePhase::Configured
    }

    pub(super) fn is_enabling(&self) -> bool {
        matches!(self.phase, DrivePhase::Enabling { .. })
    }

    pub(super) fn is_enabled(&self) -> bool {
        self.phase == DrivePhase::Enabling { is_enabled: true }
    }

    /// Returns whether the phase must end by its time.
    pub(super) fn is_awaited(&self) -> bool {
        !self.is_configured() && !self.is_enabled()
    }

    /// Returns whether the drive, which was started, may boot again before scenario time 0. Some drives boot twice.
    pub(super) fn may_restart(&self) -> bool {
        self.is_enabling() && self.restarts < RESTARTS_MAX
    }

    /// Takes a boot of a drive that was started: it must be configured once more.
    pub(super) fn restart(&mut self) {
        self.restarts += 1;
        self.controlword = 0;
    }

    /// Sends RPDO1.
    pub(super) fn command(&mut self, services: &mut Services, controlword: u16, command: f64) {
        self.controlword = controlword;
        self.commanded = command;
        services.send(self.layout.encode(controlword, command));
    }

    /// Resets the communication of a drive that is present in an unknown state.
    pub(super) fn reset(&mut self, services: &mut Services) {
        services.send_nmt(NmtCommand::ResetCommunication, Some(self.node_id()));
        self.phase = DrivePhase::Resetting;
    }

    /// Starts the drive. From now on it is watched.
    pub(super) fn start(&mut self, services: &mut Services) {
        let now = services.now();
        self.phase = DrivePhase::Enabling { is_enabled: false };
        self.until = now + ENABLE_TIME;
        self.last_heard = now;
        services.send_nmt(NmtCommand::Start, Some(self.node_id()));
    }

    /// Leads the drive one step towards Operation enabled.
    pub(super) fn enable(&mut self, services: &mut Services, feedback: &Feedback) {
        if !self.is_enabling() {
            return;
        }
        let state = State::from_statusword(feedback.statusword);
        self.last_statusword = Some(feedback.statusword);
        self.phase = DrivePhase::Enabling {
            is_enabled: state == Some(State::OperationEnabled),
        };
        let wanted = state.map_or(0, State::controlword_towards_operation);
        // An edge resets a fault, so the bit must fall before it can rise again.
        let reset = DriveCommand::FaultReset.controlword();
        let controlword = if wanted == reset && self.controlword == reset {
            0
        } else {
            wanted
        };
        self.command(services, controlword, 0.0);
    }

    /// Returns the time of the next action in the bring-up.
    pub(super) fn next_deadline(&self) -> Option<Duration> {
        let action = match self.phase {
            DrivePhase::Searching { next_question } => Some(next_question),
            DrivePhase::Configuring => self.bring_up.next_deadline(),
            _ => None,
        };
        earlier(action, self.is_awaited().then_some(self.until))
    }

    /// Returns the error text for a phase that has lasted too long.
    pub(super) fn overdue(&self, bring_up: Duration) -> String {
        let seconds = bring_up.as_secs_f64();
        let drive = self.node_id();
        match self.phase {
            DrivePhase::Resetting => {
                format!(
                    "the drive (node {drive}) did not boot within {seconds} s after NMT reset communication"
                )
            }
            DrivePhase::Configuring => {
                format!("the drive (node {drive}) was not configured within {seconds} s")
            }
            DrivePhase::Enabling { .. } => {
                let seconds = ENABLE_TIME.as_secs();
                let last = self.last_statusword.map_or_else(
                    || format!("it sent no TPDO1 (0x{:03X})", self.layout.feedback.id()),
                    |statusword| format!("its last statusword was {}", state_text(statusword)),
                );
                let emergency = self.last_emergency.map_or_else(String::new, |message| {
                    format!(", its last emergency 0x{:04X}", message.code.0)
                });
                format!(
                    "the drive (node {drive}) did not reach Operation enabled within {seconds} s; {last}{emergency}"
                )
            }
            DrivePhase::Searching { .. } | DrivePhase::Configured => format!(
                "no drive: node {drive} sent no boot-up message or heartbeat and answered no SDO for {seconds} s"
            ),
        }
    }
}

/// Returns the text for a statusword with its state.
pub(super) fn state_text(statusword: u16) -> String {
    match State::from_statusword(statusword) {
        Some(state) => format!("0x{statusword:04X} ({state:?})"),
        None => format!("0x{statusword:04X} (no state of CiA 402)"),
    }
}
