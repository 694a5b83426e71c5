//! A law that is wired to the loops of a rig: its inputs from them, the destinations of its currents, and the objects
//! of its terms.

use canopen::ObjectDictionary;
use scenario::law_ports::{LOOP_INPUTS, LawWires, Quantity, Reading};
use scenario::port::Port;
use scenario::wiring::Wiring;

use crate::error::ControllerError;
use crate::law::{AnyLaw, CurrentRange, Cycle};
use crate::process_law::Window;
use crate::terms::TermObjects;

/// Values of a loop in a cycle that a law may read, in the order of the [`Quantity`]s.
pub(crate) type Seen = [f64; LOOP_INPUTS.len()];

/// Connection of a current.
#[derive(Clone, Copy, Debug)]
struct CurrentWire {
    /// Index of the loop of the drive.
    place: usize,
    /// Index of the output; `None` for a drive beyond those that the law leads, which has no current.
    output: Option<usize>,
    range: [f64; 2],
    /// Current in amperes for an output of one.
    factor: f64,
    /// Current range of the drive.
    drive: CurrentRange,
}

/// A law that is wired to loops.
#[derive(Debug)]
pub(crate) struct WiredLaw {
    law: AnyLaw,
    readings: Vec<Reading>,
    currents: Vec<CurrentWire>,
    terms: Vec<TermObjects>,
    reads: Vec<f64>,
    writes: Vec<f64>,
    /// Whether the terms of the latest step are not in the dictionary yet.
    has_new_terms: bool,
}

impl WiredLaw {
    /// Makes a law of the drives at these indices of the controller's loops; `wiring` is that of the first one. The
    /// dictionary must contain its terms.
    pub(crate) fn new(
        law: AnyLaw,
        places: &[usize],
        wiring: &Wiring,
        dictionary: &ObjectDictionary,
    ) -> Result<Self, ControllerError> {
        let ports = law.ports();
        let wires = law.wires(wiring)?;
        let readings = wires.inputs.iter().map(|reading| Reading {
            index: places[reading.index],
            ..*reading
        });
        let drives = wiring.currents(law.drives());
        let currents = places.iter().enumerate().map(|(drive, place)| {
            let mut outputs = wires.outputs.iter();
            let output = outputs.position(|one| one.is_command && one.index == drive);
            CurrentWire {
                place: *place,
                output,
                range: output.map_or([0.0; 2], |output| ports.outputs[output].range),
                factor: output.map_or(1.0, |output| wires.outputs[output].factor),
                drive: drives.get(drive).copied().unwrap_or_default(),
            }
        });
        let terms = places.iter().enumerate().map(|(place, of_loop)| {
            TermObjects::find(dictionary, *of_loop, terms(place, &wires, &ports.outputs))
        });
        Ok(Self {
            readings: readings.collect(),
            currents: currents.collect(),
            terms: terms.collect::<Result<_, _>>()?,
            reads: vec![0.0; ports.inputs.len()],
            writes: vec![0.0; ports.outputs.len()],
            has_new_terms: false,
            law,
        })
    }

    /// Returns the indices of the loops whose positions it reads; if it reads none, of the loops that it leads.
    pub(crate) fn waits_for(&self) -> Vec<usize> {
        let positions = self
            .readings
            .iter()
            .filter(|reading| reading.quantity == Quantity::Position);
        let mut places = Vec::from_iter(positions.map(|reading| reading.index));
        if places.is_empty() {
            places = self.currents.iter().map(|wire| wire.place).collect();
        }
        places.sort_unstable();
        places.dedup();
        places
    }

    /// Steps the law on the values of the loops. Returns false if it does not answer in time. Does not allocate.
    pub(crate) fn step<'a>(
        &mut self,
        cycle: &Cycle,
        window: &Window,
        seen: impl Fn(usize) -> &'a Seen,
    ) -> bool {
        for (value, reading) in self.reads.iter_mut().zip(&self.readings) {
            *value = seen(reading.index)[reading.quantity as usize] * reading.factor;
        }
        self.has_new_terms = true;
        self.law.step(cycle, window, &self.reads, &mut self.writes)
    }

    /// Stores the terms of the latest step in the dictionary. Does not allocate.
    pub(crate) fn store_terms(&mut self, dictionary: &mut ObjectDictionary) {
        if std::mem::take(&mut self.has_new_terms) {
            for terms in &self.terms {
                terms.store(dictionary, &self.writes);
            }
        }
    }

    pub(crate) fn law(&self) -> &AnyLaw {
        &self.law
    }

    /// Returns the commands after the latest step, each with the index of its loop. NaN becomes a current of 0.
    pub(crate) fn currents_amperes(&self) -> impl Iterator<Item = (usize, f64)> {
        self.currents.iter().map(|wire| {
            let value = wire.output.map_or(0.0, |output| self.writes[output]);
            let [min, max] = wire.range;
            let current = if value.is_nan() {
                0.0
            } else {
                value.max(min).min(max) * wire.factor
            };
            (wire.place, wire.drive.limited(current))
        })
    }
}

/// Returns the terms of a loop, each with the index of its output, and a factor from that to the unit of the name.
fn terms<'a>(
    place: usize,
    wires: &'a LawWires,
    outputs: &'a [Port],
) -> impl Iterator<Item = (usize, &'a Port, f64)> {
    let wired = wires.outputs.iter().zip(outputs).enumerate();
    let terms = wired.filter(move |(_, (one, _))| !one.is_command && one.index == place);
    terms.map(|(output, (writing, port))| (output, port, writing.factor))
}
