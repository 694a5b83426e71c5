//! A loop: the set-point, and the drive that follows it, led by a law.

use std::time::Duration;

use canopen::Services;
use canopen::cia402::State;
use scenario::cycle_start_seconds;
use scenario::reference::{SetPoint, Trajectory};
use scenario::rig::drive::Feedback;

use super::drive::{LedDrive, state_text};
use super::leading_law::Seen;
use crate::cause::Cause;
use crate::law::LoopReads;

/// One of the loops that the controller closes.
#[derive(Debug)]
pub(super) struct ControlLoop {
    pub(super) drive: LedDrive,
    pub(super) trajectory: Trajectory,
    /// False in open loop, where the trajectory is 0 throughout.
    pub(super) has_set_point: bool,
    pub(super) sync_period: Duration,
    /// Index of the loop whose drive measures the position that this one follows; usually its own.
    pub(super) follows: usize,
    /// Whether the position that it follows has come in the present cycle.
    pub(super) has_position: bool,
    /// Whether the sample of its own drive has come in the present cycle.
    pub(super) has_sample: bool,
    /// Inputs of a law from the latest look, and its scenario time.
    pub(super) seen: Seen,
    pub(super) scenario_time_seconds: f64,
    /// Number of consecutive cycles without a position of its drive.
    pub(super) missing: u64,
    /// Largest tolerated number of them.
    pub(super) missing_max: u64,
}

/// Reason why a loop cannot continue.
pub(super) type Failure = (Cause, String);

impl ControlLoop {
    /// Ends a cycle, and the skipped ones as well, so the state of the drive stays in step with time.
    pub(super) fn end_cycle(&mut self, skipped: u64) {
        let cycles = f64::from(u32::try_from(skipped).unwrap_or(u32::MAX)) + 1.0;
        let elapsed_seconds = cycles * self.sync_period.as_secs_f64();
        let drive = &mut self.drive;
        drive.plausibility.advance(elapsed_seconds, drive.commanded);
        self.missing += u64::from(!self.has_sample);
        self.has_position = false;
        self.has_sample = false;
    }

    /// Fails after too many consecutive cycles without a position.
    pub(super) fn check_missing(&self) -> Result<(), Failure> {
        if self.missing <= self.missing_max {
            return Ok(());
        }
        let implausible = self.drive.implausible;
        let signal = self.drive.plausibility.signal();
        let what = match implausible {
            Some(_) => format!("no plausible {signal}"),
            None => format!("no {signal}"),
        };
        let text = format!(
            "{what} from the drive (node {}, frame 0x{:03X}) in {} cycles (limit {})",
            self.drive.node_id(),
            self.drive.layout.feedback.id(),
            self.missing,
            self.missing_max
        );
        Err((implausible.unwrap_or(Cause::NoPosition), text))
    }

    /// Handles the sample of the drive of the loop with this index, in a cycle. A second sample in a cycle is late or
    /// forged, and ignored. Returns whether it carried the position.
    pub(super) fn on_sample(
        &mut self,
        services: &Services,
        (place, number): (usize, u64),
        feedback: &Feedback,
    ) -> Result<bool, Failure> {
        let state = State::from_statusword(feedback.statusword);
        if state != Some(State::OperationEnabled) {
            let state = state_text(feedback.statusword);
            let node = self.drive.node_id();
            let text =
                format!("the drive (node {node}) left Operation enabled: statusword {state}");
            return Err((Cause::DriveNotEnabled, text));
        }
        if self.has_sample {
            return Ok(false);
        }
        let limits = self.drive.limits.as_mut();
        if let Some(violation) = limits.and_then(|limits| limits.check(services.now(), feedback)) {
            return Err((Cause::RigLimit, violation));
        }
        // A drive whose loop follows another one has no target.
        let set_point = (self.follows == place).then(|| self.look(number, feedback.position));
        let wanted = set_point
            .filter(|_| self.has_set_point)
            .map_or(f64::NAN, |set_point| set_point.position);
        self.has_sample = self.is_plausible(feedback.position, wanted)?;
        if self.has_sample {
            self.missing = 0;
        }
        Ok(self.has_sample)
    }

    fn is_plausible(&mut self, position: f64, wanted: f64) -> Result<bool, Failure> {
        let drive = &mut self.drive;
        match drive.plausibility.check(position, wanted) {
            Ok(()) => {
                drive.implausible = None;
                Ok(true)
            }
            Err(cause @ Cause::PositionFrozen) => {
                Err((cause, drive.plausibility.frozen_message(position)))
            }
            Err(cause) => {
                drive.implausible = Some(cause);
                Ok(false)
            }
        }
    }

    /// Updates the inputs of a law for a cycle with this position, and returns the set-point.
    pub(super) fn look(&mut self, number: u64, position: f64) -> SetPoint {
        self.scenario_time_seconds = cycle_start_seconds(number, self.sync_period);
        let set_point = self.trajectory.at(self.scenario_time_seconds);
        let reads = LoopReads {
            position,
            set_point,
        };
        self.seen = reads.values();
        set_point
    }
}
