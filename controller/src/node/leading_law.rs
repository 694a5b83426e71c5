//! A law that leads one loop or all: its wires to them, the time of its step, and the objects of its terms.

use canopen::cia402::Command as DriveCommand;
use canopen::{ObjectDictionary, Services};
use scenario::law_ports::{LOOP_INPUTS, LoopValue, Reading};
use scenario::wiring::Wiring;

use super::control_loop::ControlLoop;
use crate::error::ControllerError;
use crate::law::{AnyLaw, CommandRange, Cycle};
use crate::process_law::Window;
use crate::terms::TermObjects;

/// Divisor of a period: a law must answer this part of a period before the next SYNC, which it never delays.
const ANSWER_SHARE: u32 = 10;

/// Values of a loop in a cycle that a law may read, in the order of the [`LoopValue`]s.
pub(super) type Seen = [f64; LOOP_INPUTS.len()];

/// Connection of a command.
#[derive(Clone, Copy, Debug)]
struct CommandWire {
    /// Index of the loop of the drive.
    place: usize,
    /// Index of the output; `None` for a drive beyond those that the law leads, which gets no command.
    output: Option<usize>,
    range: [f64; 2],
    /// Command in the unit of the drive's target for an output of one.
    factor: f64,
    /// Range of the drive's commands.
    drive: CommandRange,
}

impl CommandWire {
    /// Returns the command for these outputs of the law. NaN becomes 0.
    fn command(&self, writes: &[f64]) -> f64 {
        let value = self.output.map_or(0.0, |output| writes[output]);
        let [min, max] = self.range;
        let command = if value.is_nan() {
            0.0
        } else {
            value.max(min).min(max) * self.factor
        };
        self.drive.limited(command)
    }
}

/// A law that is wired to the loops that it reads or leads.
#[derive(Debug)]
pub(super) struct LeadingLaw {
    law: AnyLaw,
    /// Indices of these loops.
    places: Vec<usize>,
    /// Indices of the loops whose positions it waits for.
    waits_for: Vec<usize>,
    readings: Vec<Reading>,
    commands: Vec<CommandWire>,
    terms: Vec<TermObjects>,
    reads: Vec<f64>,
    writes: Vec<f64>,
    /// Whether it has stepped in the present cycle.
    has_stepped: bool,
    /// Whether the terms of the latest step are not in the dictionary yet.
    has_new_terms: bool,
}

impl LeadingLaw {
    /// Wires a law to the loops with these indices; `wiring` is that of the first one. The dictionary must contain its
    /// terms.
    pub(super) fn new(
        law: AnyLaw,
        places: Vec<usize>,
        wiring: &Wiring,
        dictionary: &ObjectDictionary,
    ) -> Result<Self, ControllerError> {
        let ports = law.ports();
        let wires = law.wires()?;
        let readings = wires.inputs.iter().map(|reading| Reading {
            index: places[reading.index],
            ..*reading
        });
        let readings = Vec::from_iter(readings);
        let drives = wiring.command_ranges(law.drives());
        let commands = places.iter().enumerate().map(|(drive, place)| {
            let mut outputs = wires.outputs.iter();
            let output = outputs.position(|one| one.is_command && one.index == drive);
            CommandWire {
                place: *place,
                output,
                range: output.map_or([0.0; 2], |output| ports.outputs[output].range),
                factor: output.map_or(1.0, |output| wires.outputs[output].factor),
                drive: drives.get(drive).copied().unwrap_or_default(),
            }
        });
        let terms = places.iter().enumerate().map(|(place, of_loop)| {
            TermObjects::find(dictionary, *of_loop, wires.terms(place, &ports.outputs))
        });
        Ok(Self {
            commands: commands.collect(),
            terms: terms.collect::<Result<_, _>>()?,
            reads: vec![0.0; ports.inputs.len()],
            writes: vec![0.0; ports.outputs.len()],
            waits_for: waits_for(&readings, &places),
            readings,
            places,
            has_stepped: false,
            has_new_terms: false,
            law,
        })
    }

    /// Returns the reason why the law cannot continue, if there is one.
    pub(super) fn failure(&self) -> Option<&str> {
        self.law.failure()
    }

    /// Stores the terms of the latest step in the dictionary. Does not allocate.
    pub(super) fn store_terms(&mut self, dictionary: &mut ObjectDictionary) {
        if std::mem::take(&mut self.has_new_terms) {
            for terms in &self.terms {
                terms.store(dictionary, &self.writes);
            }
        }
    }

    /// Steps and commands the drives that it leads, if the last position of the cycle has come and it has not stepped
    /// yet.
    pub(super) fn lead(&mut self, services: &mut Services, loops: &mut [ControlLoop], number: u64) {
        let mut waits_for = self.waits_for.iter();
        let is_due = !self.has_stepped && waits_for.all(|place| loops[*place].has_position);
        if !is_due || !self.step(services, loops, number, true) {
            return;
        }
        let controlword = DriveCommand::EnableOperation.controlword();
        for wire in &self.commands {
            let command = wire.command(&self.writes);
            let drive = &mut loops[wire.place].drive;
            drive.command(services, controlword, command);
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

    /// Steps the law on the values of the loops. Returns false if it does not answer in time. Does not allocate.
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
        for (value, reading) in self.reads.iter_mut().zip(&self.readings) {
            let seen = &loops[reading.index].seen;
            *value = seen[reading.value as usize] * reading.factor;
        }
        self.has_new_terms = true;
        self.law
            .step(&cycle, &window, &self.reads, &mut self.writes)
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
        let waits_for = self.waits_for.iter();
        let missing = waits_for.map(|place| loops[*place].missing_max);
        let missing_max = missing.max().unwrap_or_default();
        for passed in 1..=skipped.min(missing_max) {
            for place in &self.places {
                loops[*place].look(number + passed, f64::NAN);
            }
            self.step_on_seen(services, loops, false);
        }
        self.has_stepped = false;
    }
}

/// Returns the indices of the loops whose positions a law reads; if it reads none, of all its loops.
fn waits_for(readings: &[Reading], places: &[usize]) -> Vec<usize> {
    let positions = readings
        .iter()
        .filter(|reading| reading.value == LoopValue::Position);
    let mut waits_for = Vec::from_iter(positions.map(|reading| reading.index));
    if waits_for.is_empty() {
        waits_for = places.to_vec();
    }
    waits_for.sort_unstable();
    waits_for.dedup();
    waits_for
}
