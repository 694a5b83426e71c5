//! The controller as a node of the bus: NMT manager, SYNC producer, and the law's cycle.
//!
//! A SYNC makes the drive sample; its TPDO1 brings the sample; the law's command leaves in RPDO1 and acts with the next
//! SYNC: one cycle of delay. Scenario time 0 is the first SYNC after Operation enabled was seen.
//!
//! [`sequence`] leads from the search for the drive to its stop, [`cycle`] runs the law in between, [`application`] is
//! what calls both.

mod application;
mod cycle;
mod phase;
mod sequence;
mod statistics;
#[cfg(test)]
mod tests;

use std::time::Duration;

use canopen::{CanFrame, Device, Filter, Node, Progress, nmt::NodeId};
use scenario::ControllerView;
use scenario::plant::SMA_ACTUATOR;
use scenario::rig::drive::DriveLayout;
use scenario::rig::limits::LimitWatch;
use scenario::rig::{RigDrive, RigFile, Timeouts};

use crate::catalogue;
use crate::error::ControllerError;
use crate::explanation::{self, ExplanationObjects};
use crate::manager::BringUp;
use crate::node_ids::{CONTROLLER, DISTURBANCE};
use crate::plausibility::Plausibility;
use phase::Phase;
pub use sequence::ENABLE_TIME;
use sequence::{CONSUMER_HEARTBEAT_TIME, Controller};
pub use statistics::Statistics;

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
        let dictionary = dbc::dictionary(dbc::DRIVE_EDS, RigDrive::default().node_id)?;
        let drive = DriveLayout::emulated(dictionary)?;
        let timeouts = Timeouts::default();
        Self::leading(
            view,
            dbc::CONTROLLER_EDS,
            drive,
            DISTURBANCE,
            &timeouts,
            None,
        )
    }

    /// As [`ControllerNode::new`], for the drive of a rig file, whose limits it obeys.
    ///
    /// # Errors
    /// As [`ControllerNode::new`].
    pub fn on_rig(
        view: &ControllerView,
        rig: &RigFile,
        drive_eds: &str,
    ) -> Result<Self, ControllerError> {
        let view = ControllerView {
            bus: rig.bus.of_scenario(),
            ..view.clone()
        };
        let dictionary = dbc::dictionary(drive_eds, rig.drive.node_id)?;
        let drive = DriveLayout::new(dictionary, &rig.drive, rig.limits.current_amperes)?;
        let fan = rig.fan.node_id;
        let fan = NodeId::new(fan).ok_or(ControllerError::NodeId(fan))?;
        let limits = LimitWatch::new(&rig.limits, view.bus.sync_period());
        Self::leading(
            &view,
            dbc::CONTROLLER_EDS,
            drive,
            fan,
            &rig.timeouts,
            Some(limits),
        )
    }

    fn leading(
        view: &ControllerView,
        controller_eds: &str,
        drive: DriveLayout,
        fan: NodeId,
        timeouts: &Timeouts,
        limits: Option<LimitWatch>,
    ) -> Result<Self, ControllerError> {
        let law = catalogue::law(&view.controller)?;
        let mut dictionary = dbc::dictionary(controller_eds, CONTROLLER.get())?;
        explanation::declare(&mut dictionary, &law.terms());
        // Checked here, since it is written only when the drive is configured.
        let watch = dictionary.unsigned(CONSUMER_HEARTBEAT_TIME, 1);
        watch.ok_or(ControllerError::NoObject(CONSUMER_HEARTBEAT_TIME))?;
        let watch =
            u32::from(drive.node_id().get()) << 16 | u32::from(timeouts.drive_lost_milliseconds);
        let sync_period = view.bus.sync_period();
        let controller = Controller {
            trajectory: view.reference.trajectory(),
            has_set_point: !view.reference.is_empty(),
            explanation: ExplanationObjects::find(&dictionary, &law)?,
            law,
            bring_up: BringUp::new(&drive, sync_period, timeouts),
            drive,
            fan,
            sync_period,
            timeouts: *timeouts,
            watch,
            phase: Phase::Off,
            controlword: 0,
            last_heard: Duration::ZERO,
            last_statusword: None,
            last_emergency: None,
            plausibility: Plausibility::new(view.plant == SMA_ACTUATOR),
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
