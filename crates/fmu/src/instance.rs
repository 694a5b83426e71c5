//! An FMU that plays: from its start values through its initialization, step by step to its end.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::archive::description_in;
use crate::description::Variable;
use crate::error::{Fault, said};
use crate::library::{self, Slave, Status, text};
use crate::unit::Conversion;

/// Largest number of halvings of a step that the FMU refuses.
const HALVINGS_MAX: i32 = 20;
/// Largest number of updates of the discrete states in one event.
const UPDATES_MAX: u32 = 100;
/// Largest number of calls to `DoStep` in one advance.
const STEPS_MAX: u32 = 1_000_000;
/// Largest part of a step by which time may miss the end: rounding of the sums of many steps.
const ROUNDING: f64 = 1e-6;

/// Configuration of an FMU's instance for a run.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Configuration {
    /// Name of the instance, which some FMUs write into their messages.
    pub name: String,
    /// Start values, by the names of variables.
    pub start: Vec<(String, StartValue)>,
    /// Variables that are set before each step, in this order.
    pub inputs: Vec<PortVariable>,
    /// Variables that are read after each step, in this order.
    pub outputs: Vec<PortVariable>,
    /// The only length of a step; `None` for steps of any length.
    pub step_seconds: Option<f64>,
}

/// Variable behind a port of a plant or a law.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct PortVariable {
    /// The variable.
    pub variable: Variable,
    /// Conversion from the variable to the port.
    pub conversion: Conversion,
}

/// A start value.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub enum StartValue {
    /// A number; 0 or 1 for a boolean.
    Number(f64),
    /// A text.
    Text(String),
}

/// One instance of an FMU at its time. An advance neither allocates nor looks anything up.
pub struct Instance {
    slave: Box<dyn Slave>,
    inputs: Vec<Input>,
    outputs: Vec<PortVariable>,
    /// The only length of a step.
    step_seconds: Option<f64>,
    /// Number of steps of that length since the start.
    steps: f64,
    may_shorten: bool,
    has_events: bool,
    next_event_seconds: f64,
    time_seconds: f64,
    /// Whether the FMU is to be terminated: after its start, and until a fatal error.
    is_initialized: bool,
}

/// Input with its value in this step.
struct Input {
    behind: PortVariable,
    /// Value in the FMU's unit; NaN before the first.
    value: f64,
    is_changed: bool,
}

/// Terminates the instance as FMI requires: some FMUs write their files then. An error comes too late to report.
impl Drop for Instance {
    fn drop(&mut self) {
        if self.is_initialized {
            self.slave.call(library::TERMINATE);
        }
    }
}

impl Instance {
    /// Loads an unpacked FMU from a folder, and brings it to time 0. It runs foreign code, so only a worker process may
    /// call it.
    ///
    /// # Errors
    /// The FMU cannot be loaded, or does not accept the configuration.
    pub fn new(folder: &Path, configuration: &Configuration) -> Result<Self, Fault> {
        let description = description_in(folder)?;
        let co_simulation = description.served()?;
        let start = configuration.start.iter();
        let start = start.map(|(name, value)| Ok((description.variable(name)?, value)));
        let start = start.collect::<Result<Vec<_>, Fault>>()?;
        let inputs = configuration.inputs.iter().cloned().map(|behind| Input {
            behind,
            value: f64::NAN,
            is_changed: false,
        });
        let slave = library::instantiate(folder, &description, &text(&configuration.name)?)?;
        let mut instance = Self {
            slave,
            inputs: inputs.collect(),
            outputs: configuration.outputs.clone(),
            step_seconds: configuration.step_seconds,
            steps: 0.0,
            may_shorten: co_simulation.takes_any_step,
            has_events: co_simulation.has_event_mode,
            next_event_seconds: f64::INFINITY,
            time_seconds: 0.0,
            is_initialized: false,
        };
        instance.initialize(&start, description.tolerance)?;
        Ok(instance)
    }

    fn initialize(
        &mut self,
        start: &[(&Variable, &StartValue)],
        tolerance: Option<f64>,
    ) -> Result<(), Fault> {
        for (variable, value) in start {
            let (kind, reference) = (variable.kind, variable.reference);
            let status = match value {
                StartValue::Number(number) => self.slave.set_number(kind, reference, *number),
                StartValue::Text(value) => self.slave.set_text(reference, &text(value)?),
            };
            if !status.is_good() {
                let action = "set to its start value";
                return Err(refused(&mut *self.slave, variable, action, status));
            }
        }
        let status = self.slave.enter_initialization(0.0, tolerance);
        self.good("EnterInitializationMode", status)?;
        self.call(library::EXIT_INITIALIZATION)?;
        if self.has_events {
            self.update_and_go_on()?;
        }
        self.is_initialized = true;
        Ok(())
    }

    /// Returns the time in the FMU.
    pub fn time_seconds(&self) -> f64 {
        self.time_seconds
    }

    /// Advances the time under constant inputs, in the units of their ports. An FMU with a fixed step advances by whole
    /// steps; its outputs are then constant until the next one.
    ///
    /// # Errors
    /// An input is no number, or the FMU failed.
    ///
    /// # Panics
    /// The number of inputs differs from the configuration.
    pub fn advance(&mut self, to_seconds: f64, inputs: &[f64]) -> Result<(), Fault> {
        self.set(inputs)?;
        match self.step_seconds {
            None => self.reach(to_seconds),
            Some(step_seconds) => self.count_to(to_seconds, step_seconds),
        }
    }

    /// Reads the outputs, in the units of their ports.
    ///
    /// # Errors
    /// An output is no finite number, or the FMU failed.
    ///
    /// # Panics
    /// The number of outputs differs from the configuration.
    pub fn read(&mut self, outputs: &mut [f64]) -> Result<(), Fault> {
        assert_eq!(
            outputs.len(),
            self.outputs.len(),
            "outputs of the configuration"
        );
        for (behind, output) in self.outputs.iter().zip(outputs) {
            let variable = &behind.variable;
            let (status, value) = self.slave.number(variable.kind, variable.reference);
            if !status.is_good() {
                return Err(refused(&mut *self.slave, variable, "read", status));
            }
            if !value.is_finite() {
                return Err(self.not_finite(variable, value, "the FMU computed it"));
            }
            *output = behind.conversion.of(value);
        }
        Ok(())
    }

    fn set(&mut self, inputs: &[f64]) -> Result<(), Fault> {
        assert_eq!(
            inputs.len(),
            self.inputs.len(),
            "inputs of the configuration"
        );
        for (input, value) in self.inputs.iter_mut().zip(inputs) {
            let value = input.behind.conversion.back(*value);
            input.is_changed = value.to_bits() != input.value.to_bits();
            input.value = value;
        }
        let mut inputs = self.inputs.iter();
        if let Some(input) = inputs.find(|input| !input.value.is_finite()) {
            let whose = "what is wired to it put it out";
            return Err(self.not_finite(&input.behind.variable, input.value, whose));
        }
        // Discrete inputs are set in event mode, if the FMU has one.
        self.set_those(false)?;
        let is_event =
            |input: &Input| input.is_changed && input.behind.variable.is_discrete_input();
        if self.has_events && self.inputs.iter().any(is_event) {
            self.call(library::ENTER_EVENT_MODE)?;
            self.set_those(true)?;
            self.update_and_go_on()?;
        } else if !self.has_events {
            self.set_those(true)?;
        }
        Ok(())
    }

    /// Sets the inputs that have changed: the discrete ones, or the others.
    fn set_those(&mut self, is_discrete: bool) -> Result<(), Fault> {
        for input in &self.inputs {
            let (variable, value) = (&input.behind.variable, input.value);
            if !input.is_changed || variable.is_discrete_input() != is_discrete {
                continue;
            }
            let kind = variable.kind;
            let taken = match kind.whole_range() {
                Some([lowest, highest]) => value.round().clamp(lowest, highest),
                None => value,
            };
            let status = self.slave.set_number(kind, variable.reference, taken);
            if !status.is_good() {
                let action = format!("set to {value} at {} s", self.time_seconds);
                return Err(refused(&mut *self.slave, variable, &action, status));
            }
        }
        Ok(())
    }

    /// Takes as many whole steps as fit. Their ends are multiples, not sums, so they do not drift.
    fn count_to(&mut self, to_seconds: f64, step_seconds: f64) -> Result<(), Fault> {
        let mut left = STEPS_MAX;
        loop {
            let end = (self.steps + 1.0) * step_seconds;
            if end > to_seconds + ROUNDING * step_seconds {
                return Ok(());
            }
            left = left.checked_sub(1).ok_or_else(|| self.too_many())?;
            self.reach(end)?;
            self.steps += 1.0;
        }
    }

    fn too_many(&self) -> Fault {
        let outcome = format!("was called {STEPS_MAX} times without reaching the next SYNC");
        Fault::call("DoStep", &outcome, Some(self.time_seconds), "")
    }

    /// Steps until a time. Events and refusals determine the number of steps.
    fn reach(&mut self, to_seconds: f64) -> Result<(), Fault> {
        let whole = to_seconds - self.time_seconds;
        if !whole.is_finite() || whole <= 0.0 {
            return Ok(());
        }
        let shortest = whole * 2_f64.powi(-HALVINGS_MAX);
        let mut longest = whole;
        for _ in 0..STEPS_MAX {
            let from = self.time_seconds;
            let left = to_seconds - from;
            if left <= ROUNDING * whole {
                self.time_seconds = to_seconds;
                return Ok(());
            }
            let mut duration = left.min(longest);
            let to_event = self.next_event_seconds - from;
            if self.may_shorten && to_event > shortest && to_event < duration {
                duration = to_event;
            }
            let stepped = self.slave.step(from, duration);
            let reached = stepped.reached_seconds;
            if stepped.is_terminated {
                let time_seconds = if reached.is_finite() { reached } else { from };
                return Err(self.terminated(time_seconds));
            }
            let is_discarded = stepped.status == Status::DISCARD;
            if !is_discarded {
                self.good("DoStep", stepped.status)?;
            }
            let advanced = reached - from;
            let is_sane = (0.0..=duration * (1.0 + ROUNDING)).contains(&advanced);
            if !is_sane {
                let end = from + duration;
                let outcome =
                    format!("says that it reached {reached} s, in a step that ends at {end} s");
                return Err(self.failed("DoStep", &outcome));
            }
            if advanced > 0.0 {
                self.time_seconds = reached;
            }
            let is_event =
                self.has_events && self.time_seconds >= self.next_event_seconds - shortest;
            if self.has_events && (stepped.needs_events || is_event) {
                self.call(library::ENTER_EVENT_MODE)?;
                self.update_and_go_on()?;
            }
            if is_discarded && advanced <= 0.0 {
                longest = duration / 2.0;
                if self.may_shorten && longest >= shortest {
                    continue;
                }
                let others = if self.may_shorten {
                    "and every shorter one"
                } else {
                    "and it takes no shorter one"
                };
                let outcome = format!("refused (discard) a step of {duration} s, {others}");
                return Err(self.failed("DoStep", &outcome));
            }
        }
        Err(self.too_many())
    }

    /// Returns from event mode to step mode: updates the discrete states until they are stable.
    fn update_and_go_on(&mut self) -> Result<(), Fault> {
        let mut count = 0;
        loop {
            let (status, updated) = self.slave.update_discrete();
            self.good("UpdateDiscreteStates", status)?;
            if updated.is_terminated {
                return Err(self.terminated(self.time_seconds));
            }
            self.next_event_seconds = updated.next_event_seconds.unwrap_or(f64::INFINITY);
            count += 1;
            if !updated.again {
                break;
            }
            if count == UPDATES_MAX {
                let outcome = format!("wanted to be called more than {UPDATES_MAX} times");
                return Err(self.failed("UpdateDiscreteStates", &outcome));
            }
        }
        self.call(library::ENTER_STEP_MODE)
    }

    /// Calls a function that takes no values.
    fn call(&mut self, function: &'static str) -> Result<(), Fault> {
        let status = self.slave.call(function);
        self.good(function, status)
    }

    fn good(&mut self, function: &str, status: Status) -> Result<(), Fault> {
        if status.is_good() {
            return Ok(());
        }
        let fault = self.failed(function, &status.outcome());
        if status == Status::FATAL {
            self.is_initialized = false;
            self.slave.forsake();
        }
        Err(fault)
    }

    fn failed(&mut self, function: &str, outcome: &str) -> Fault {
        let time_seconds = self.is_initialized.then_some(self.time_seconds);
        Fault::call(function, outcome, time_seconds, &self.slave.log())
    }

    fn terminated(&mut self, time_seconds: f64) -> Fault {
        let said = said(&self.slave.log());
        Fault::InRun(format!(
            "the FMU ended the simulation by itself at {time_seconds} s{said}"
        ))
    }

    fn not_finite(&self, variable: &Variable, value: f64, whose: &str) -> Fault {
        let (name, time) = (&variable.name, self.time_seconds);
        Fault::InRun(format!("variable `{name}` is {value} at {time} s: {whose}"))
    }
}

/// Returns the error of a variable that could not be set or read.
fn refused(slave: &mut dyn Slave, variable: &Variable, action: &str, status: Status) -> Fault {
    let (outcome, log) = (status.outcome(), slave.log());
    let reason = format!("could not be {action}: {outcome} {log}");
    Fault::variable(&variable.name, reason)
}

#[cfg(test)]
mod tests;
