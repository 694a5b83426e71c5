//! The interface of control laws: constants, a state, ports, and a pure step.

use std::fmt;
use std::time::Duration;

pub use dbc::CommandRange;
pub use dbc::{Port, Ports, Width};
use dbc::{Quantities, Signal};
use scenario::custom::Parameters;
use scenario::law_ports::{LOOP_INPUTS, LawWires, WrongPort, loop_output};
use scenario::process_law::ProcessLaw;
use scenario::reference::SetPoint;
use scenario::wiring::{Measured, Wiring};

use crate::process_law::{Player, StartPlayer, Window, placed};
use crate::terms::described;

/// Time of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cycle {
    /// Time since the start of the scenario.
    pub scenario_time_seconds: f64,
    /// Time since the previous cycle.
    pub period_seconds: f64,
}

/// A control law. It is made from a table of the scenario; its constants are in `self`, its memory in `State`. A step
/// maps input values to output values.
///
/// A law of one loop has the ports of [`one_loop`]. A law of all loops of a rig names its inputs and outputs. An input
/// is `LOOP.position_UNIT`, which is NaN in a cycle without a position; `LOOP.set_point_UNIT`, or with the suffix
/// `_per_second` or `_per_second_squared` a derivative of the set-point; or `DRIVE.position_UNIT` of a further drive.
/// An output is `DRIVE.command`, in the unit of the drive's target, one for each drive, or a term of the law,
/// `LOOP.NAME`, which is recorded among the signals of that loop. A command may instead have the name of the target with
/// a unit, as `DRIVE.current_amperes`. The law states the unit in the name; the controller converts.
///
/// The controller node does everything else: the drives, SYNC, set-points, missing and implausible positions, and the
/// objects in which the terms are published. An observer belongs to the law: its state is a part of `State`.
pub trait Law: fmt::Debug + Send + 'static {
    /// Name of the law and of its table in a scenario.
    const NAME: &'static str;
    /// Number of drives of its loop that it leads; `None` for a law of all loops of a rig.
    const DRIVES: Option<usize> = Some(1);
    /// Parameters of the law, read from the scenario's table.
    type Config: Parameters;
    /// Memory from cycle to cycle. `Copy` excludes memory on the heap.
    type State: Copy + fmt::Debug + Send;

    /// Computes the constants. `commands` are the ranges of the commands to the drives that it leads, in their order.
    /// For a law of all loops they are those of the first drive of each loop, in the order of the loops' names.
    fn new(config: &Self::Config, commands: &[CommandRange]) -> Self;

    /// Returns the inputs and outputs. A command is limited to the range of its port and to that of the drive. The
    /// terms are sent every 10th cycle, in at most four frames.
    fn ports(&self) -> Ports;

    /// Returns the parameter that makes no physical sense, if there is one, and the reason.
    fn objection(&self) -> Option<(&'static str, String)> {
        None
    }

    /// Returns the memory before the first cycle.
    fn start(&self) -> Self::State;

    /// Computes the outputs that act from the next cycle on from the inputs; both are in the order of the ports. It is
    /// called once per cycle: when the last position that it reads has come, or at the end of a cycle that lacked one.
    /// It does not allocate, and its outputs are finite for any inputs.
    fn step(&self, state: &mut Self::State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]);
}

/// Returns the ports of a law of one loop: the inputs are [`LoopReads`]; the outputs are a command for each drive that
/// it leads, in the unit of the drive's target, and its terms.
pub fn one_loop<L: Law>(terms: impl IntoIterator<Item = Port>) -> Ports {
    // The drive limits the command.
    let any = [f64::NEG_INFINITY, f64::INFINITY];
    let drives = 0..L::DRIVES.unwrap_or_default();
    let commands = drives.map(|place| Port::output(&loop_output(place), any));
    let inputs = LOOP_INPUTS.map(|(name, _)| Port::input(name, any));
    Ports {
        inputs: inputs.into(),
        outputs: commands.chain(terms).collect(),
    }
}

/// Inputs of a law of one loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopReads {
    /// Position as sampled by the drive, in metres or the loop's own unit; not finite in a cycle without one.
    pub position: f64,
    /// Set-point, in the same unit.
    pub set_point: SetPoint,
}

impl LoopReads {
    /// Makes the inputs from values in the order of [`one_loop`].
    #[inline]
    pub fn of(reads: &[f64]) -> Self {
        let [position, wanted, velocity, acceleration, jerk, exact] =
            reads.try_into().unwrap_or_default();
        Self {
            position,
            set_point: SetPoint {
                position: wanted,
                velocity,
                acceleration,
                jerk,
                has_exact_derivatives: exact > 0.0,
            },
        }
    }

    /// Returns the values in the order of [`one_loop`].
    #[inline]
    pub fn values(&self) -> [f64; LOOP_INPUTS.len()] {
        let set_point = &self.set_point;
        [
            self.position,
            set_point.position,
            set_point.velocity,
            set_point.acceleration,
            set_point.jerk,
            flag(set_point.has_exact_derivatives),
        ]
    }
}

/// A law with its memory.
#[derive(Debug)]
struct Running<L: Law> {
    law: L,
    state: L::State,
}

impl<L: Law> Player for Running<L> {
    fn objection(&self) -> Option<(&'static str, String)> {
        self.law.objection()
    }

    fn step(&mut self, cycle: &Cycle, _: &Window, reads: &[f64], writes: &mut [f64]) -> bool {
        self.law.step(&mut self.state, cycle, reads, writes);
        true
    }
}

/// A law in the controller node.
#[derive(Debug)]
pub struct AnyLaw {
    ports: Ports,
    drives: Option<usize>,
    /// Connections of its ports, or the port without one.
    wires: Result<LawWires, WrongPort>,
    /// `None` for a process that is not started yet.
    player: Option<Box<dyn Player>>,
    /// Law of a process that is not started yet.
    process: Option<ProcessLaw>,
}

impl AnyLaw {
    /// Makes a law with these parameters, before its first cycle, for the drive with this wiring.
    pub fn of<L: Law>(config: &L::Config, wiring: &Wiring) -> Self {
        let law = L::new(config, &wiring.command_ranges(L::DRIVES));
        let ports = law.ports();
        let unit = &wiring.feedback.quantity.unit;
        Self {
            wires: match L::DRIVES {
                None => LawWires::for_all_loops(&ports, &wiring.shared.loops),
                Some(drives) => LawWires::for_one_loop(&ports, unit, &wiring.targets(drives)),
            },
            ports,
            drives: L::DRIVES,
            player: Some(Box::new(Running {
                state: law.start(),
                law,
            })),
            process: None,
        }
    }

    /// Makes a law that a process plays, for the drive with this wiring.
    pub(crate) fn of_process(law: ProcessLaw, wiring: &Wiring) -> Self {
        let (law, ports) = placed(law, wiring);
        Self {
            wires: LawWires::for_all_loops(&ports, &wiring.led_loops()),
            ports,
            drives: Some(wiring.drives_commanded()),
            player: None,
            process: Some(law),
        }
    }

    /// Starts the process of a law that a process plays.
    ///
    /// # Errors
    /// The process cannot be started.
    pub(crate) fn start(&mut self, period: Duration, start: StartPlayer<'_>) -> Result<(), String> {
        if let Some(mut law) = self.process.take() {
            law.setup.period_seconds = period.as_secs_f64();
            self.player = Some(start(&law)?);
        }
        Ok(())
    }

    /// Returns the inputs and outputs.
    pub fn ports(&self) -> &Ports {
        &self.ports
    }

    /// Returns the number of drives of its loop that it leads; `None` for a law of all loops.
    pub fn drives(&self) -> Option<usize> {
        self.drives
    }

    /// Returns the parameter that makes no physical sense, if there is one, and the reason.
    pub fn objection(&self) -> Option<(&'static str, String)> {
        self.player.as_ref()?.objection()
    }

    /// Returns the connections of its ports.
    pub(crate) fn wires(&self) -> Result<&LawWires, WrongPort> {
        self.wires.as_ref().map_err(WrongPort::clone)
    }

    /// Returns the terms that it publishes for the loop of the drive with this wiring.
    pub fn terms(&self, wiring: &Wiring) -> Vec<Signal> {
        let index = match self.drives {
            None => wiring.loop_number().into(),
            Some(_) => 0,
        };
        self.loop_terms(index, &wiring.quantities, &wiring.feedback)
    }

    /// Returns the terms that it publishes for the loop with this index among those that it leads; none if one of its ports has no
    /// meaning.
    pub(crate) fn loop_terms(
        &self,
        index: usize,
        quantities: &Quantities,
        feedback: &Measured,
    ) -> Vec<Signal> {
        let wires = self.wires.iter();
        let terms = wires.flat_map(|wires| wires.terms(index, &self.ports.outputs));
        terms
            .map(|(_, port, _)| described(port, quantities, feedback))
            .collect()
    }

    /// Computes the outputs that act from the next cycle on. Returns false if there is no answer in time. Does not
    /// allocate.
    pub fn step(
        &mut self,
        cycle: &Cycle,
        window: &Window,
        reads: &[f64],
        writes: &mut [f64],
    ) -> bool {
        let player = self.player.as_mut();
        player.is_some_and(|player| player.step(cycle, window, reads, writes))
    }

    /// Returns the reason why it cannot continue, if there is one.
    pub fn failure(&self) -> Option<&str> {
        self.player.as_ref()?.failure()
    }
}

/// Returns the value of a flag: 1 for true, 0 for false.
pub fn flag(is_set: bool) -> f64 {
    f64::from(u8::from(is_set))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::law;
    use proptest::prelude::*;
    use scenario::controller::{self, Controller};

    fn all_laws() -> [Controller; 5] {
        let none = Controller::default();
        [
            Controller {
                sliding_mode: Some(controller::SlidingMode::default()),
                ..none.clone()
            },
            Controller {
                sliding_mode_paper: Some(controller::SlidingModePaper::default()),
                ..none.clone()
            },
            Controller {
                pid: Some(controller::Pid::default()),
                ..none.clone()
            },
            Controller {
                pid_pair: Some(controller::PidPair::default()),
                ..none.clone()
            },
            Controller {
                open_loop: Some(controller::OpenLoop::default()),
                ..none
            },
        ]
    }

    fn any_position() -> impl Strategy<Value = f64> {
        prop_oneof![
            8 => 0.0..0.06_f64,
            1 => any::<f64>(),
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
        ]
    }

    proptest! {
        #[test]
        fn what_a_law_writes_is_finite_and_a_current_for_any_measurement(
            positions in prop::collection::vec(any_position(), 1..300),
            target in -0.1..0.1_f64,
        ) {
            for controller in all_laws() {
                let mut law = law(&controller, &Wiring::default()).unwrap();
                let mut writes = vec![0.0; law.ports().outputs.len()];
                let drives = law.drives().unwrap();
                for (cycle, &position) in positions.iter().enumerate() {
                    let set_point = SetPoint { position: target, ..SetPoint::default() };
                    let reads = LoopReads { position, set_point };
                    let cycle = Cycle {
                        scenario_time_seconds: f64::from(u16::try_from(cycle).unwrap()) * 1e-3,
                        period_seconds: 1e-3,
                    };
                    law.step(&cycle, &Window::default(), &reads.values(), &mut writes);
                    prop_assert!(writes.iter().all(|value| value.is_finite()), "{writes:?}");
                    let mut currents = writes[..drives].iter();
                    prop_assert!(currents.all(|it| (0.0..=1.0).contains(it)));
                }
            }
        }
    }
}
