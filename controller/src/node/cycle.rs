//! The cycle of the law: from SYNC and sample to the command.

use std::time::Duration;

use canopen::Services;
use canopen::cia402::{Command as DriveCommand, State};
use scenario::reference::SetPoint;
use scenario::rig::drive::Feedback;

use super::phase::{Cycle, Phase};
use super::sequence::{Controller, state_words};
use crate::cause::Cause;
use crate::law::Measurement;

impl Controller {
    /// Ends the previous cycle and begins the next, at its SYNC.
    pub(super) fn begin_cycle(&mut self, services: &mut Services, mut cycle: Cycle) {
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
            let reference = self.reference(&cycle);
            self.step(services, reference, f64::NAN);
        }
        // The law lives through skipped cycles too, so that its model keeps pace with the plant.
        let missing_max = u64::from(self.timeouts.missing_positions_cycles);
        for _ in 0..skipped.min(missing_max) {
            cycle.number += 1;
            let reference = self.reference(&cycle);
            self.step(services, reference, f64::NAN);
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
                self.drive.node_id(),
                self.drive.feedback_id(),
                cycle.missing
            );
            self.fail(services, cause, text);
        }
    }

    /// Scenario time of a cycle, and its set-point.
    fn reference(&self, cycle: &Cycle) -> (f64, SetPoint) {
        let period_nanoseconds = u64::try_from(self.sync_period.as_nanos()).unwrap_or(u64::MAX);
        let time = Duration::from_nanos(period_nanoseconds.saturating_mul(cycle.number));
        let time_seconds = time.as_secs_f64();
        (time_seconds, self.trajectory.at(time_seconds))
    }

    /// One step of the law; the command in amperes.
    pub(super) fn step(
        &mut self,
        services: &mut Services,
        (scenario_time_seconds, set_point): (f64, SetPoint),
        position_metres: f64,
    ) -> f64 {
        let measurement = Measurement {
            scenario_time_seconds,
            position_metres,
        };
        let period_seconds = self.sync_period.as_secs_f64();
        let command = self.law.step(&measurement, &set_point, period_seconds);
        self.explanation
            .store(services.dictionary_mut(), &command.explanation, &self.law);
        command.current_amperes
    }

    /// The drive's sample of this cycle: the law's turn. A second one in a cycle is late or forged and passed over.
    pub(super) fn on_sample(
        &mut self,
        services: &mut Services,
        mut cycle: Cycle,
        feedback: &Feedback,
    ) {
        let state = State::from_statusword(feedback.statusword);
        if state != Some(State::OperationEnabled) {
            let state = state_words(feedback.statusword);
            let text = format!(
                "the drive (node {}) left Operation enabled: statusword {state}",
                self.drive.node_id()
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
        let position_metres = feedback.position_metres;
        let reference = self.reference(&cycle);
        let set_point_metres = match self.has_set_point {
            true => reference.1.position_metres,
            false => f64::NAN,
        };
        match self.plausibility.check(position_metres, set_point_metres) {
            Ok(()) => self.implausible = None,
            Err(cause @ Cause::PositionFrozen) => {
                let text = self.plausibility.frozen_words(position_metres);
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
        let current_amperes = self.step(services, reference, position_metres);
        self.command(
            services,
            DriveCommand::EnableOperation.controlword(),
            current_amperes,
        );
    }
}
