//! The sequence of the controller: it finds, configures and enables its drives, and finally stops them.

use std::time::Duration;

use canopen::Services;
use canopen::cia402::Command as DriveCommand;
use canopen::nmt::{NmtCommand, NodeId};
use dbc::node_objects::{CONSUMER_HEARTBEAT_TIME, watch_entry};

use super::control_loop::{ControlLoop, Failure};
use super::drive::LedDrive;
use super::leading_law::LeadingLaw;
use super::phase::{DrivePhase, Phase};
use crate::cause::Cause;

/// Number of SYNCs that carry the command 0 to the drives before NMT stop.
const SYNCS_TO_STOP: u8 = 2;
/// Time between two requests to a drive that has not answered.
const SEARCH_PERIOD: Duration = Duration::from_millis(100);

const SYNC_PERIOD_OBJECT: u16 = 0x1006;
/// Mask of the milliseconds in an entry of 0x1016; without them its node is not watched.
const WATCH_TIME: u32 = 0xFFFF;

/// The application of the controller's device: it leads the drives by laws.
#[derive(Debug)]
pub struct Leader {
    pub(super) loops: Vec<ControlLoop>,
    /// The law of each loop, or one that leads all loops.
    pub(super) laws: Vec<LeadingLaw>,
    /// The fan and load modules.
    pub(super) io_nodes: Vec<NodeId>,
    pub(super) sync_period: Duration,
    /// Time in which the drives must be found and configured.
    pub(super) bring_up: Duration,
    pub(super) phase: Phase,
    pub(super) failure: Option<String>,
}

impl Leader {
    pub(super) fn drives(&self) -> impl Iterator<Item = &LedDrive> {
        self.loops.iter().map(|one| &one.drive)
    }

    pub(super) fn drives_mut(&mut self) -> impl Iterator<Item = &mut LedDrive> {
        self.loops.iter_mut().map(|one| &mut one.drive)
    }

    /// Returns whether this controller leads the drives.
    pub(super) fn leads(&self) -> bool {
        match self.phase {
            Phase::BringUp => self.drives().all(LedDrive::is_enabling),
            Phase::Running(_) => true,
            _ => false,
        }
    }

    /// Returns whether every drive is enabled. The next SYNC is then scenario time 0.
    pub(super) fn is_ready(&self) -> bool {
        self.phase == Phase::BringUp && self.drives().all(LedDrive::is_enabled)
    }

    /// Searches for all drives.
    pub(super) fn search(&mut self, services: &mut Services) {
        let now = services.now();
        let until = now + self.bring_up;
        self.phase = Phase::BringUp;
        for drive in self.drives_mut() {
            drive.phase = DrivePhase::Searching { next_question: now };
            drive.until = until;
        }
    }

    /// Executes the due actions in the bring-up of a drive.
    pub(super) fn bring_up(&mut self, services: &mut Services, place: usize) {
        let now = services.now();
        let drive = &mut self.loops[place].drive;
        match drive.phase {
            _ if drive.is_awaited() && now >= drive.until => {
                let (node_id, text) = (drive.node_id(), drive.overdue(self.bring_up));
                self.fail(services, Some(node_id), (Cause::NoBringUp, text));
            }
            DrivePhase::Searching { next_question } if now >= next_question => {
                drive.phase = DrivePhase::Searching {
                    next_question: now + SEARCH_PERIOD,
                };
                drive.bring_up.ask(services);
            }
            DrivePhase::Configuring => {
                drive.bring_up.on_tick(services);
                self.advance(services, place);
            }
            _ => {}
        }
    }

    pub(super) fn configure(&mut self, services: &mut Services, place: usize) {
        let drive = &mut self.loops[place].drive;
        drive.phase = DrivePhase::Configuring;
        drive.bring_up.rewind();
        self.advance(services, place);
    }

    /// Continues the configuration of a drive. When all drives are configured, they start.
    pub(super) fn advance(&mut self, services: &mut Services, place: usize) {
        let drive = &mut self.loops[place].drive;
        match drive.bring_up.advance(services) {
            Ok(()) if drive.bring_up.is_configured() => {
                drive.phase = DrivePhase::Configured;
                let is_ready = |drive: &LedDrive| drive.is_configured() || drive.is_enabling();
                if self.drives().all(is_ready) {
                    self.start(services);
                }
            }
            Err(text) => {
                let node_id = drive.node_id();
                self.fail(services, Some(node_id), (Cause::NoBringUp, text));
            }
            Ok(()) => {}
        }
    }

    /// Starts the drives, this node and SYNC. From now on the drives are watched. A drive that booted again joins the others.
    fn start(&mut self, services: &mut Services) {
        let configured = self.drives_mut().filter(|drive| drive.is_configured());
        configured.for_each(|drive| drive.start(services));
        services.request_nmt(NmtCommand::Start);
        self.configure_self(services, u32::MAX, self.sync_period);
    }

    /// Writes the own objects that change with the phase.
    fn configure_self(&mut self, services: &mut Services, watch_mask: u32, sync_period: Duration) {
        let microseconds = u32::try_from(sync_period.as_micros()).unwrap_or(u32::MAX);
        for place in 0..self.loops.len() {
            let watch = self.loops[place].drive.watch & watch_mask;
            self.write_own(
                services,
                (CONSUMER_HEARTBEAT_TIME, watch_entry(place)),
                watch,
            );
        }
        self.write_own(services, (SYNC_PERIOD_OBJECT, 0), microseconds);
    }

    fn write_own(&mut self, services: &mut Services, (index, sub_index): (u16, u8), value: u32) {
        if let Err(code) = services.write(index, sub_index, &value.to_le_bytes()) {
            let text = format!(
                "the controller's own object 0x{index:04X}:{sub_index:02X} refuses {value}: {code}"
            );
            self.failure.get_or_insert(text);
            self.phase = Phase::Ended;
        }
    }

    /// Switches the current off, reports the cause on the bus, with the faulty drive if there are several, and keeps
    /// it.
    pub(super) fn fail(&mut self, services: &mut Services, node: Option<NodeId>, failure: Failure) {
        if matches!(self.phase, Phase::Stopping { .. } | Phase::Ended) {
            return;
        }
        let (cause, text) = failure;
        self.failure = Some(text);
        let named = node.filter(|_| self.loops.len() > 1);
        services.raise_error(cause.code(), cause.manufacturer(named));
        self.stop(services);
    }

    /// Stops the drives. Command 0 and quick stop come first, NMT stop after the SYNCs that make the command valid.
    pub(super) fn stop(&mut self, services: &mut Services) {
        match self.phase {
            Phase::Stopping { .. } | Phase::Ended => {}
            _ if self.leads() => {
                let patience = u32::from(SYNCS_TO_STOP) + 2;
                let until = services.now() + patience * self.sync_period;
                let syncs_left = SYNCS_TO_STOP;
                self.phase = Phase::Stopping { until, syncs_left };
                self.quick_stop(services);
            }
            _ => self.end(services),
        }
    }

    /// Removes the current from every drive, whatever the cause: the parts that they move may be connected.
    pub(super) fn quick_stop(&mut self, services: &mut Services) {
        let quick_stop = DriveCommand::QuickStop.controlword();
        self.drives_mut()
            .for_each(|drive| drive.command(services, quick_stop, 0.0));
    }

    /// Sends NMT stop, the last action of the controller.
    pub(super) fn end(&mut self, services: &mut Services) {
        self.phase = Phase::Ended;
        let drives = self.drives().map(LedDrive::node_id);
        for node in drives.chain(self.io_nodes.iter().copied()) {
            services.send_nmt(NmtCommand::Stop, Some(node));
        }
        self.configure_self(services, !WATCH_TIME, Duration::ZERO);
    }
}
