//! A loop: the set-point, the law that follows it, and the drive that the law moves.

use std::time::Duration;

use canopen::Services;
use canopen::cia402::{Command as DriveCommand, State};
use scenario::reference::{SetPoint, Trajectory};
use scenario::rig::drive::Feedback;

use super::drive::{LedDrive, state_words};
use crate::cause::Cause;
use crate::explanation::ExplanationObjects;
use crate::law::{Law, Measurement};

/// One of the loops that the controller closes.
#[derive(Debug)]
pub(super) struct ControlLoop {
    pub(super) drive: LedDrive,
    pub(super) law: Law,
    pub(super) trajectory: Trajectory,
    /// False in open loop, where the trajectory is 0 throughout.
    pub(super) has_set_point: bool,
    pub(super) explanation: ExplanationObjects,
    pub(super) sync_period: Duration,
    /// A law sees metres or, in a loop of another unit, that unit; inside the bench positions are in thousands of it.
    pub(super) law_units_per_metre: f64,
    /// The places of the loops that stand for the further drives which its law leads, in their order.
    pub(super) further: Vec<usize>,
    /// Whether the law of another loop, or of all loops, leads its drive.
    pub(super) is_led: bool,
    /// The drive's position of the present cycle has come.
    pub(super) has_position: bool,
    /// That position, or the one before it.
    pub(super) position_metres: f64,
    /// Cycles without a position in a row.
    pub(super) missing: u64,
    /// The most of them.
    pub(super) missing_max: u64,
}

/// Why a loop cannot go on.
pub(super) type Failure = (Cause, String);

impl ControlLoop {
    /// Ends a cycle, and lives through so many that were skipped, so that the law's model keeps pace with the plant. True if
    /// there was a position.
    pub(super) fn end_cycle(&mut self, services: &mut Services, number: u64, skipped: u64) -> bool {
        let cycles = f64::from(u32::try_from(skipped).unwrap_or(u32::MAX)) + 1.0;
        let elapsed_seconds = cycles * self.sync_period.as_secs_f64();
        let drive = &mut self.drive;
        drive
            .plausibility
            .advance(elapsed_seconds, drive.current_amperes);
        let had_position = self.has_position;
        self.missing += u64::from(!had_position);
        if !self.is_led {
            if !had_position {
                self.step(services, self.reference(number), f64::NAN);
            }
            for passed in 1..=skipped.min(self.missing_max) {
                self.step(services, self.reference(number + passed), f64::NAN);
            }
        }
        self.has_position = false;
        had_position
    }

    /// Too many cycles without a position in a row.
    pub(super) fn check_missing(&self) -> Result<(), Failure> {
        if self.missing <= self.missing_max {
            return Ok(());
        }
        let implausible = self.drive.implausible;
        let what = match implausible {
            Some(_) => "no plausible position",
            None => "no position",
        };
        let text = format!(
            "{what} from the drive (node {}, frame 0x{:03X}) in {} cycles (limit {})",
            self.drive.node_id(),
            self.drive.layout.feedback_id(),
            self.missing,
            self.missing_max
        );
        Err((implausible.unwrap_or(Cause::NoPosition), text))
    }

    /// The drive's sample of a cycle: the law's turn. A second one in a cycle is late or forged and passed over. True if the law has
    /// commanded.
    pub(super) fn on_sample(
        &mut self,
        services: &mut Services,
        number: u64,
        feedback: &Feedback,
    ) -> Result<bool, Failure> {
        let state = State::from_statusword(feedback.statusword);
        if state != Some(State::OperationEnabled) {
            let state = state_words(feedback.statusword);
            let node = self.drive.node_id();
            let text =
                format!("the drive (node {node}) left Operation enabled: statusword {state}");
            return Err((Cause::DriveNotEnabled, text));
        }
        if self.has_position {
            return Ok(false);
        }
        let limits = self.drive.limits.as_mut();
        if let Some(violation) = limits.and_then(|limits| limits.check(services.now(), feedback)) {
            return Err((Cause::RigLimit, violation.to_string()));
        }
        let reference = self.reference(number);
        if !self.is_plausible(feedback.position_metres, &reference.1)? {
            return Ok(false);
        }
        (self.has_position, self.missing) = (true, 0);
        if self.is_led {
            self.position_metres = feedback.position_metres;
            return Ok(false);
        }
        let current_amperes = self.step(services, reference, feedback.position_metres);
        let controlword = DriveCommand::EnableOperation.controlword();
        self.drive.command(services, controlword, current_amperes);
        Ok(true)
    }

    fn is_plausible(
        &mut self,
        position_metres: f64,
        set_point: &SetPoint,
    ) -> Result<bool, Failure> {
        let set_point_metres = match self.has_set_point {
            true => set_point.position_metres,
            false => f64::NAN,
        };
        let drive = &mut self.drive;
        match drive.plausibility.check(position_metres, set_point_metres) {
            Ok(()) => {
                drive.implausible = None;
                Ok(true)
            }
            Err(cause @ Cause::PositionFrozen) => {
                Err((cause, drive.plausibility.frozen_words(position_metres)))
            }
            Err(cause) => {
                drive.implausible = Some(cause);
                Ok(false)
            }
        }
    }

    /// Scenario time of a cycle, and its set-point.
    pub(super) fn reference(&self, number: u64) -> (f64, SetPoint) {
        let period_nanoseconds = u64::try_from(self.sync_period.as_nanos()).unwrap_or(u64::MAX);
        let time = Duration::from_nanos(period_nanoseconds.saturating_mul(number));
        let time_seconds = time.as_secs_f64();
        (time_seconds, self.trajectory.at(time_seconds))
    }

    /// One step of the law; the command in amperes.
    fn step(
        &mut self,
        services: &mut Services,
        (scenario_time_seconds, set_point): (f64, SetPoint),
        position_metres: f64,
    ) -> f64 {
        let factor = self.law_units_per_metre;
        let measurement = Measurement {
            scenario_time_seconds,
            position_metres: position_metres * factor,
        };
        let set_point = set_point.times(factor);
        let period_seconds = self.sync_period.as_secs_f64();
        let command = self.law.step(&measurement, &set_point, period_seconds);
        let terms = command.explanation.times(1.0 / factor);
        let own = self.law.term_values();
        self.explanation
            .store(services.dictionary_mut(), &terms, own);
        command.current_amperes
    }
}
