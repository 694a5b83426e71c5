//! What happens on the bus, and which part of the controller answers it.

use std::time::Duration;

use canopen::cia402::Command as DriveCommand;
use canopen::emcy::{EmergencyMessage, ErrorCode};
use canopen::nmt::{NmtCommand, NmtState, NodeId};
use canopen::sync::Sync;
use canopen::{Application, CanFrame, CommunicationLoss, Progress, Services};

use super::phase::{Cycle, Phase};
use super::sequence::Controller;
use crate::cause::Cause;

/// Time between two questions to a drive that has not shown up.
const SEARCH_PERIOD: Duration = Duration::from_millis(100);

impl Application for Controller {
    fn on_reset(&mut self, services: &mut Services, _: NmtCommand) {
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
        if node_id == self.fan && waits && !is_ending {
            services.send_nmt(NmtCommand::Start, Some(self.fan));
        }
        if node_id != self.drive.node_id() {
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
        if node_id != self.drive.node_id() || message.code == ErrorCode::NO_ERROR {
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
            CommunicationLoss::Heartbeat(node) if node == self.drive.node_id() && self.leads() => {
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
