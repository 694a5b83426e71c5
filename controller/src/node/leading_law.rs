//! A law that leads one loop or all: the time of its step, and its inputs.

use canopen::Services;
use canopen::cia402::Command as DriveCommand;

use super::control_loop::ControlLoop;
use crate::law::{AnyLaw, Cycle};
use crate::process_law::Window;
use crate::wired_law::WiredLaw;

/// Divisor of a period: a law must answer this part of a period before the next SYNC, which it never delays.
const ANSWER_SHARE: u32 = 10;

/// A law with the loops that it leads.
#[derive(Debug)]
pub(super) struct LeadingLaw {
    law: WiredLaw,
    /// Indices of the loops that it reads or leads.
    places: Vec<usize>,
    /// Indices of the loops whose positions it waits for.
    waits_for: Vec<usize>,
    /// Whether it has stepped in the present cycle.
    has_stepped: bool,
}

impl LeadingLaw {
    pub(super) fn new(law: WiredLaw, places: Vec<usize>) -> Self {
        Self {
            waits_for: law.waits_for(),
            law,
            places,
            has_stepped: false,
        }
    }

    pub(super) fn law(&self) -> &AnyLaw {
        self.law.law()
    }

    /// Stores the terms of the latest step in the dictionary.
    pub(super) fn store_terms(&mut self, services: &mut Services) {
        self.law.store_terms(services.dictionary_mut());
    }

    /// Returns whether the last position of the cycle has come and the law has not stepped yet.
    fn is_due(&self, loops: &[ControlLoop]) -> bool {
        let mut waits_for = self.waits_for.iter();
        !self.has_stepped && waits_for.all(|place| loops[*place].has_position)
    }

    /// Steps and commands the drives that it leads, if the last position of the cycle has come.
    pub(super) fn lead(&mut self, services: &mut Services, loops: &mut [ControlLoop], number: u64) {
        if !self.is_due(loops) {
            return;
        }
        if !self.step(services, loops, number, true) {
            return;
        }
        let controlword = DriveCommand::EnableOperation.controlword();
        for (place, current_amperes) in self.law.currents_amperes() {
            let drive = &mut loops[place].drive;
            drive.command(services, controlword, current_amperes);
        }
    }

    /// Steps the law on the positions of the cycle that have come; returns false if it does not answer in time.
    fn step(
        &mut self,
        services: &Services,
        loops: &mut [ControlLoop],
        number: u64,
        is_waited_for: bool,
    ) -> bool {
        self.has_stepped = true;
        for place in &self.places {
            let one = &mut loops[*place];
            if !one.has_position {
                one.look(number, f64::NAN);
            }
        }
        self.step_on_seen(services, loops, is_waited_for)
    }

    fn step_on_seen(
        &mut self,
        services: &Services,
        loops: &[ControlLoop],
        is_waited_for: bool,
    ) -> bool {
        let Some(first) = self.places.first().map(|place| &loops[*place]) else {
            return false;
        };
        let cycle = Cycle {
            scenario_time_seconds: first.scenario_time_seconds,
            period_seconds: first.sync_period.as_secs_f64(),
        };
        let now = services.now();
        let next_sync = services.next_sync().unwrap_or(now + first.sync_period);
        let window = Window {
            now,
            until: if is_waited_for {
                next_sync.saturating_sub(first.sync_period / ANSWER_SHARE)
            } else {
                now
            },
        };
        let seen = |place: usize| &loops[place].seen;
        self.law.step(&cycle, &window, seen)
    }

    /// Ends a cycle before the loops do, and steps through the skipped cycles, so the law's model stays in step with
    /// the plant. A cycle that lacked a position is a step too, but without a command.
    pub(super) fn end_cycle(
        &mut self,
        services: &Services,
        loops: &mut [ControlLoop],
        number: u64,
        skipped: u64,
    ) {
        if !self.has_stepped {
            self.step(services, loops, number, false);
        }
        let missing_max = self
            .waits_for
            .iter()
            .map(|place| loops[*place].missing_max)
            .max()
            .unwrap_or_default();
        for passed in 1..=skipped.min(missing_max) {
            for place in &self.places {
                loops[*place].look(number + passed, f64::NAN);
            }
            self.step_on_seen(services, loops, false);
        }
        self.has_stepped = false;
    }
}
