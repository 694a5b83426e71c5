//! A law that leads all loops of a rig: it says by ports what it reads of them and what it writes.

use std::fmt;

use scenario::law_ports::{LawWires, Quantity, Reading, Writing, WrongPort};
use scenario::own::Parameters;
pub use scenario::port::{Port, Ports};
use scenario::reference::SetPoint;
use scenario::wiring::LoopOfRig;

use crate::law::sound_current;

/// When a law steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cycle {
    /// Time since the start of the scenario.
    pub scenario_time_seconds: f64,
    /// Time since the cycle before.
    pub period_seconds: f64,
}

/// A law that leads all loops of a rig, with the ports that it has when made of its parameters.
///
/// An input is a signal of the rig: `LOOP.position_UNIT`, which is not a number in a cycle that brought no position;
/// `LOOP.set_point_UNIT`, and with `_per_second` and `_per_second_squared` behind it the set-point's derivatives;
/// `DRIVE.position_UNIT` of a further drive. An output is `DRIVE.current_amperes`, one for each drive, or a term of the law's own,
/// `LOOP.NAME`, which is recorded among the signals of that loop. The law states the unit in the name; the controller converts.
///
/// The controller node owns the rest, as with [`ControlLaw`](crate::law::ControlLaw).
pub trait LawWithPorts: fmt::Debug + Send + 'static {
    /// Its name, and that of its table in a scenario.
    const NAME: &'static str;
    /// Its parameters: what a scenario's table is read into.
    type Config: Parameters;
    /// What it remembers from cycle to cycle. `Copy` owns nothing on the heap.
    type State: Copy + fmt::Debug + Send;

    /// Works out the constants.
    fn new(config: &Self::Config) -> Self;

    /// What it reads. The list never changes.
    fn inputs(&self) -> &[Port];

    /// What it writes. The list never changes. The range of a current is its limit; a term has 32 bits.
    fn outputs(&self) -> &[Port];

    /// The memory before the first cycle.
    fn start(&self) -> Self::State;

    /// Writes what acts from the next cycle on, in the order of the outputs, from values in the order of the inputs. Is called once
    /// per cycle, when the last of the positions has come, or at the end of a cycle that lacked one. Allocates nothing.
    fn step(&self, state: &mut Self::State, cycle: &Cycle, inputs: &[f64], outputs: &mut [f64]);
}

/// A law with ports and its memory, whichever it is.
trait Step: fmt::Debug + Send {
    fn step(&mut self, cycle: &Cycle, inputs: &[f64], outputs: &mut [f64]);
}

#[derive(Debug)]
struct Running<L: LawWithPorts> {
    law: L,
    state: L::State,
}

impl<L: LawWithPorts> Step for Running<L> {
    fn step(&mut self, cycle: &Cycle, inputs: &[f64], outputs: &mut [f64]) {
        self.law.step(&mut self.state, cycle, inputs, outputs);
    }
}

/// What the controller node runs for all loops together.
#[derive(Debug)]
pub struct JointLaw {
    ports: Ports,
    step: Box<dyn Step>,
}

impl JointLaw {
    /// A law with these constants, before its first cycle.
    #[must_use]
    pub fn of<L: LawWithPorts>(config: &L::Config) -> Self {
        let law = L::new(config);
        Self {
            ports: Ports {
                inputs: law.inputs().to_vec(),
                outputs: law.outputs().to_vec(),
            },
            step: Box::new(Running {
                state: law.start(),
                law,
            }),
        }
    }

    /// What it reads and writes.
    #[must_use]
    pub fn ports(&self) -> &Ports {
        &self.ports
    }
}

/// What a loop brings to a cycle of the law: the position that its drive measured, not a number where there is none, and its
/// set-point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) position_metres: f64,
    pub(crate) set_point: SetPoint,
}

/// A law with ports that is wired to the loops of a rig.
#[derive(Debug)]
pub(crate) struct WiredLaw {
    law: JointLaw,
    wires: LawWires,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
}

impl WiredLaw {
    pub(crate) fn new(law: JointLaw, loops: &[LoopOfRig]) -> Result<Self, WrongPort> {
        let wires = LawWires::new(law.ports(), loops, dbc::LAW_TERMS_MAX)?;
        Ok(Self {
            inputs: vec![0.0; wires.inputs.len()],
            outputs: vec![0.0; wires.outputs.len()],
            law,
            wires,
        })
    }

    pub(crate) fn ports(&self) -> &Ports {
        self.law.ports()
    }

    /// A step of the law on what is seen of the loops. Allocates nothing.
    pub(crate) fn step(&mut self, cycle: &Cycle, seen: impl Fn(usize) -> Seen) {
        for (value, reading) in self.inputs.iter_mut().zip(&self.wires.inputs) {
            *value = read(reading, &seen(reading.of_loop));
        }
        self.outputs.fill(0.0);
        self.law.step.step(cycle, &self.inputs, &mut self.outputs);
    }

    /// The command to the drive of a loop after the latest step; what is no current at all is none.
    pub(crate) fn current_amperes(&self, of_loop: usize) -> f64 {
        let outputs = self.outputs.iter().zip(&self.law.ports.outputs);
        let mut outputs = outputs.zip(&self.wires.outputs);
        let current = outputs.find_map(|((value, port), writing)| match writing {
            Writing::Current {
                of_loop: place,
                factor,
            } if *place == of_loop => {
                let [min, max] = port.range;
                Some(value.max(min).min(max) * factor).filter(|_| !value.is_nan())
            }
            _ => None,
        });
        sound_current(current.unwrap_or_default())
    }

    /// The terms of a loop after the latest step, in their order.
    pub(crate) fn terms(&self, of_loop: usize) -> impl Iterator<Item = f64> {
        let outputs = self.outputs.iter().zip(&self.wires.outputs);
        let own = outputs.filter(move |(_, writing)| **writing == Writing::Term(of_loop));
        own.map(|(value, _)| *value)
    }
}

fn read(reading: &Reading, seen: &Seen) -> f64 {
    let set_point = &seen.set_point;
    let inside = match reading.quantity {
        Quantity::Position => seen.position_metres,
        Quantity::SetPoint => set_point.position_metres,
        Quantity::SetPointVelocity => set_point.velocity_metres_per_second,
        Quantity::SetPointAcceleration => set_point.acceleration_metres_per_second_squared,
    };
    inside * reading.factor
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::controller::OpenLoop;
    use scenario::port::Unit;

    /// Commands what the other loop is away, and publishes it.
    #[derive(Debug)]
    struct Crossed {
        inputs: [Port; 3],
        outputs: [Port; 3],
    }

    impl LawWithPorts for Crossed {
        const NAME: &'static str = "crossed";
        type Config = OpenLoop;
        type State = u32;

        fn new(_: &OpenLoop) -> Self {
            Self {
                inputs: [
                    "x.position_millimetres",
                    "y.position_metres",
                    "y.set_point_metres",
                ]
                .map(|name| Port::input(name, [-1e3, 1e3])),
                outputs: [
                    "y.current_amperes",
                    "x.current_milliamperes",
                    "y.away_metres",
                ]
                .map(|name| Port::output(name, [-500.0, 0.5])),
            }
        }

        fn inputs(&self) -> &[Port] {
            &self.inputs
        }

        fn outputs(&self) -> &[Port] {
            &self.outputs
        }

        fn start(&self) -> u32 {
            0
        }

        fn step(&self, state: &mut u32, _: &Cycle, inputs: &[f64], outputs: &mut [f64]) {
            *state += 1;
            outputs.copy_from_slice(&[inputs[0], -1e3 * inputs[1], inputs[2] - inputs[1]]);
        }
    }

    fn stepped(x: f64, y: f64) -> WiredLaw {
        let loops = ["x", "y"].map(|name| LoopOfRig {
            name: name.to_owned(),
            drive: name.to_owned(),
            unit: Unit::Millimetres,
            is_led: false,
        });
        let law = JointLaw::of::<Crossed>(&OpenLoop::default());
        let mut wired = WiredLaw::new(law, &loops).unwrap();
        wired.step(&Cycle::default(), |place| Seen {
            position_metres: [x, y][place],
            set_point: SetPoint {
                position_metres: 3.0,
                ..SetPoint::default()
            },
        });
        wired
    }

    #[test]
    fn each_output_goes_where_its_name_says_within_its_range() {
        let wired = stepped(0.000_25, 0.25);
        assert_eq!(
            [0, 1].map(|place| wired.current_amperes(place)),
            [-0.25, 0.25]
        );
        assert_eq!(Vec::from_iter(wired.terms(1)), [2.75]);
        assert_eq!(wired.terms(0).count(), 0);
        // -500 mA and 0.5 A are the ends of the ranges.
        let wired = stepped(7.0, 7.0);
        assert_eq!(
            [0, 1].map(|place| wired.current_amperes(place)),
            [-0.5, 0.5]
        );
    }

    #[test]
    fn what_is_no_current_is_none() {
        let wired = stepped(f64::NAN, f64::INFINITY);
        assert_eq!(
            [0, 1].map(|place| wired.current_amperes(place)),
            [-0.5, 0.0]
        );
    }
}
