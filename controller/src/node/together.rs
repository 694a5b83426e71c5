//! A law that leads all loops: when it steps, and on what.

use canopen::Services;

use super::control_loop::ControlLoop;
use crate::law::Explanation;
use crate::law_with_ports::{Cycle, Seen, WiredLaw};

/// The law of all loops.
#[derive(Debug)]
pub(super) struct Together {
    law: WiredLaw,
    /// It has stepped in the present cycle.
    has_stepped: bool,
}

impl Together {
    pub(super) fn new(law: WiredLaw) -> Self {
        Self {
            law,
            has_stepped: false,
        }
    }

    /// Whether the last position of the cycle has come, and the law has not stepped on it yet.
    pub(super) fn is_due(&self, loops: &[ControlLoop]) -> bool {
        !self.has_stepped && loops.iter().all(|one| one.has_position)
    }

    /// One step of the law, on the positions of the cycle that have come.
    pub(super) fn step(&mut self, services: &mut Services, loops: &[ControlLoop], number: u64) {
        self.has_stepped = true;
        self.step_on(services, loops, number, |one| match one.has_position {
            true => one.position_metres,
            false => f64::NAN,
        });
    }

    fn step_on(
        &mut self,
        services: &mut Services,
        loops: &[ControlLoop],
        number: u64,
        position_metres: impl Fn(&ControlLoop) -> f64,
    ) {
        let Some(first) = loops.first() else { return };
        let cycle = Cycle {
            scenario_time_seconds: first.reference(number).0,
            period_seconds: first.sync_period.as_secs_f64(),
        };
        self.law.step(&cycle, |place| {
            let one = &loops[place];
            Seen {
                position_metres: position_metres(one),
                set_point: one.reference(number).1,
            }
        });
        for (place, one) in loops.iter().enumerate() {
            let set_point = one.reference(number).1;
            let reference = Explanation {
                reference_position_metres: set_point.position_metres,
                reference_velocity_metres_per_second: set_point.velocity_metres_per_second,
                ..Explanation::default()
            };
            let own = self.law.terms(place);
            one.explanation
                .store(services.dictionary_mut(), &reference, own);
        }
    }

    /// The command to the drive of a loop after the latest step.
    pub(super) fn current_amperes(&self, place: usize) -> f64 {
        self.law.current_amperes(place)
    }

    /// Ends a cycle, before the loops do, and lives through so many that were skipped. A cycle that lacked a position is a step too,
    /// but commands nothing.
    pub(super) fn end_cycle(
        &mut self,
        services: &mut Services,
        loops: &[ControlLoop],
        number: u64,
        skipped: u64,
    ) {
        if !self.has_stepped {
            self.step(services, loops, number);
        }
        let missing_max = loops.iter().map(|one| one.missing_max).max();
        for passed in 1..=skipped.min(missing_max.unwrap_or_default()) {
            self.step_on(services, loops, number + passed, |_| f64::NAN);
        }
        self.has_stepped = false;
    }
}
