//! Events on the bus, and the parts of the controller that handle them.

use std::time::Duration;

use can::{CanFrame, Filter, Progress};
use canopen::emcy::{self, EmergencyMessage, ErrorCode};
use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID, NmtCommand, NmtState, NodeId};
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID};
use canopen::sync::Sync;
use canopen::{Application, CommunicationLoss, Services};

use super::drive::LedDrive;
use super::phase::{Cycle, DrivePhase, Phase};
use super::sequence::Leader;
use crate::cause::Cause;

impl Application for Leader {
    /// Returns the filters for NMT, SYNC and EMCY, the TPDO1 of each drive, SDO, and heartbeats. They exclude the
    /// emulator's truth (TPDO2).
    fn filters(&self) -> Vec<Filter> {
        let function = |id| Filter {
            mask: Filter::exact(0).mask & !0x7F,
            ..Filter::exact(id)
        };
        let feedback = self.drives().map(|drive| drive.layout.feedback.id());
        let others = [
            Filter::exact(COMMAND_ID),
            function(emcy::DEFAULT_ID),
            function(DEFAULT_RESPONSE_ID),
            function(DEFAULT_REQUEST_ID),
            function(ERROR_CONTROL_ID),
            Filter::ERRORS,
        ];
        feedback.map(Filter::exact).chain(others).collect()
    }

    fn on_reset(&mut self, services: &mut Services, _: NmtCommand) {
        if self.phase == Phase::Off {
            self.search(services);
            self.check_laws(services);
        } else {
            let text = "the controller was reset over the bus".to_owned();
            self.fail(services, None, (Cause::OrderedAbout, text));
        }
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if self.leads() && state != NmtState::Operational {
            let text = format!("the controller was ordered to NMT state {state:?} over the bus");
            self.fail(services, None, (Cause::OrderedAbout, text));
        }
    }

    fn on_sync(&mut self, services: &mut Services, _: &Sync) {
        match self.phase {
            Phase::BringUp if self.is_ready() => {
                self.phase = Phase::Running(Cycle {
                    number: 0,
                    overruns: services.sync_overruns(),
                });
            }
            Phase::Running(cycle) => self.begin_cycle(services, cycle),
            Phase::Stopping { syncs_left: 0, .. } => self.end(services),
            Phase::Stopping { until, syncs_left } => {
                self.phase = Phase::Stopping {
                    until,
                    syncs_left: syncs_left - 1,
                };
                self.quick_stop(services);
            }
            _ => {}
        }
    }

    fn on_sampling(&mut self, services: &mut Services) {
        for law in &mut self.laws {
            law.store_terms(services.dictionary_mut());
        }
    }

    fn on_read(&mut self, services: &mut Services, _: u16, _: u8) {
        self.on_sampling(services);
    }

    fn on_frame(&mut self, services: &mut Services, frame: &CanFrame) {
        let mut loops = self.loops.iter().enumerate();
        let sample = loops.find_map(|(place, one)| Some((one.drive.layout.decode(frame)?, place)));
        let Some((feedback, place)) = sample else {
            for place in 0..self.loops.len() {
                self.on_answer(services, place, frame);
            }
            return;
        };
        let one = &mut self.loops[place];
        match self.phase {
            Phase::BringUp => one.drive.enable(services, &feedback),
            Phase::Running(Cycle { number, .. }) => {
                let node_id = one.drive.node_id();
                match one.on_sample(services, (place, number), &feedback) {
                    Ok(true) => self.on_position(services, place, number, feedback.position),
                    Ok(false) => {}
                    Err(failure) => self.fail(services, Some(node_id), failure),
                }
            }
            _ => {}
        }
    }

    fn on_heartbeat(&mut self, services: &mut Services, node_id: NodeId, state: NmtState) {
        let is_ending = matches!(self.phase, Phase::Stopping { .. } | Phase::Ended);
        let waits = matches!(state, NmtState::Initialising | NmtState::PreOperational);
        if self.io_nodes.contains(&node_id) && waits && !is_ending {
            services.send_nmt(NmtCommand::Start, Some(node_id));
        }
        let Some(place) = self.drives().position(|drive| drive.node_id() == node_id) else {
            return;
        };
        let must_be_operational = self.is_ready() || matches!(self.phase, Phase::Running(_));
        let has_booted = self.phase == Phase::BringUp && state == NmtState::Initialising;
        let drive = &mut self.loops[place].drive;
        drive.last_heard = services.now();
        if has_booted && drive.may_restart() {
            self.on_sign_of_life(services, place, true);
        } else if must_be_operational && state != NmtState::Operational {
            let text =
                format!("the drive (node {node_id}) left NMT state Operational: it is {state:?}");
            self.fail(services, Some(node_id), (Cause::DriveNotOperational, text));
        } else if self.phase == Phase::BringUp {
            self.on_sign_of_life(services, place, state == NmtState::Initialising);
        }
    }

    fn on_emergency(
        &mut self,
        services: &mut Services,
        node_id: NodeId,
        message: &EmergencyMessage,
    ) {
        let drive = self.drives_mut().find(|drive| drive.node_id() == node_id);
        let Some(drive) = drive.filter(|_| message.code != ErrorCode::NO_ERROR) else {
            return;
        };
        drive.last_emergency = Some(*message);
        if self.is_ready() || matches!(self.phase, Phase::Running(_)) {
            let EmergencyMessage { code, register, .. } = message;
            let text = format!(
                "the drive (node {node_id}) reports emergency 0x{:04X}, error register 0x{register:02X}",
                code.0
            );
            self.fail(services, Some(node_id), (Cause::DriveEmergency, text));
        }
    }

    fn on_communication_loss(&mut self, services: &mut Services, loss: CommunicationLoss) {
        match loss {
            CommunicationLoss::Heartbeat(node) if self.leads() => {
                let drive = self.drives().find(|drive| drive.node_id() == node);
                let now = services.now();
                let is_before = self.phase == Phase::BringUp;
                let may_boot = |drive: &LedDrive| drive.may_restart() && has_restarted(drive, now);
                if is_before && drive.is_some_and(may_boot) {
                    // Its boot-up message follows.
                    return;
                }
                let text = drive.map(|drive| loss_message(drive, services.now()));
                if let Some(text) = text {
                    self.fail(services, Some(node), (Cause::DriveNotOperational, text));
                }
            }
            CommunicationLoss::BusOff => {
                let text = "the CAN controller went bus-off".to_owned();
                self.fail(services, None, (Cause::DriveNotOperational, text));
            }
            _ => {}
        }
    }

    fn on_tick(&mut self, services: &mut Services) {
        for place in 0..self.loops.len() {
            if self.phase == Phase::BringUp {
                self.bring_up(services, place);
            }
        }
        match self.phase {
            Phase::Stopping { until, .. } if services.now() >= until => self.end(services),
            _ => {}
        }
    }

    fn next_deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::BringUp => self.drives().filter_map(LedDrive::next_deadline).min(),
            Phase::Stopping { until, .. } => Some(until),
            Phase::Off | Phase::Running(_) | Phase::Ended => None,
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

impl Leader {
    /// Handles the position of a drive. It lets a law step if the position is the last one of the cycle for it.
    fn on_position(&mut self, services: &mut Services, place: usize, number: u64, position: f64) {
        let loops = self.loops.iter_mut().enumerate();
        for (own, one) in loops.filter(|(_, one)| one.follows == place) {
            if own != place {
                one.look(number, position);
            }
            one.has_position = true;
        }
        for law in &mut self.laws {
            law.lead(services, &mut self.loops, number);
        }
        self.check_laws(services);
    }

    /// Fails if a law cannot continue.
    fn check_laws(&mut self, services: &mut Services) {
        let mut laws = self.laws.iter();
        let failure = laws.find_map(|law| law.failure().map(str::to_owned));
        if let Some(text) = failure {
            self.fail(services, None, (Cause::LawFailed, text));
        }
    }

    /// Ends the previous cycle of all loops and begins the next one, at its SYNC.
    fn begin_cycle(&mut self, services: &mut Services, cycle: Cycle) {
        let overruns = services.sync_overruns();
        let skipped = overruns - cycle.overruns;
        for law in &mut self.laws {
            law.end_cycle(services, &mut self.loops, cycle.number, skipped);
        }
        for one in &mut self.loops {
            one.end_cycle(skipped);
        }
        self.phase = Phase::Running(Cycle {
            number: cycle.number + 1 + skipped,
            overruns,
        });
        let failure = self.loops.iter().find_map(|one| {
            let failure = one.check_missing().err()?;
            Some((one.drive.node_id(), failure))
        });
        if let Some((node_id, failure)) = failure {
            self.fail(services, Some(node_id), failure);
        }
        self.check_laws(services);
    }

    /// Handles a possible answer of a drive to its bring-up.
    fn on_answer(&mut self, services: &mut Services, place: usize, frame: &CanFrame) {
        let drive = &mut self.loops[place].drive;
        drive.bring_up.on_frame(services, frame);
        if self.phase != Phase::BringUp {
            return;
        }
        match drive.phase {
            DrivePhase::Searching { .. } if drive.bring_up.is_answered() => drive.reset(services),
            DrivePhase::Configuring => self.advance(services, place),
            _ => {}
        }
    }

    /// Handles a heartbeat of a drive in the bring-up.
    fn on_sign_of_life(&mut self, services: &mut Services, place: usize, has_booted: bool) {
        let drive = &mut self.loops[place].drive;
        match drive.phase {
            DrivePhase::Enabling { .. } if !(has_booted && drive.may_restart()) => {}
            DrivePhase::Enabling { .. } => {
                drive.restart();
                self.configure(services, place);
            }
            _ if has_booted => self.configure(services, place),
            DrivePhase::Searching { .. } => drive.reset(services),
            _ => {}
        }
    }
}

/// Returns the time for which a drive has been silent, and its limit, in milliseconds.
fn silence(drive: &LedDrive, now: Duration) -> [u128; 2] {
    let silent = now.saturating_sub(drive.last_heard).as_millis();
    [silent, u128::from(drive.watch & 0xFFFF)]
}

/// Returns whether a drive whose heartbeat is lost has booted, since it was not silent for long.
fn has_restarted(drive: &LedDrive, now: Duration) -> bool {
    let [silent, limit] = silence(drive, now);
    silent < limit
}

/// Returns the error text for a missing heartbeat of a drive.
fn loss_message(drive: &LedDrive, now: Duration) -> String {
    let node = drive.node_id();
    let [silent, limit] = silence(drive, now);
    if silent < limit {
        format!("the drive (node {node}) restarted while it was led")
    } else {
        format!("heartbeat from the drive (node {node}) missing for {silent} ms (limit {limit} ms)")
    }
}
