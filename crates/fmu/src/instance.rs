//! An FMU that plays: from its start values through its initialization, step by step to its end.

use std::ffi::CString;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::archive::description_in;
use crate::description::{Causality, CoSimulation, Description, Kind, Variability, Variable};
use crate::error::{Fault, FmuError};
use crate::library::{self, Slave, Status};

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
    pub inputs: Vec<String>,
    /// Variables that are read after each step, in this order.
    pub outputs: Vec<String>,
    /// The only length of a step; `None` for steps of any length.
    pub step_seconds: Option<f64>,
}

/// A start value.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub enum StartValue {
    /// A number.
    Number(f64),
    /// A boolean.
    Truth(bool),
    /// A text.
    Text(String),
}

/// Properties of a variable for calls to the library.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Access {
    name: String,
    kind: Kind,
    reference: u32,
    /// Whether it is set in event mode only.
    is_discrete: bool,
}

impl Access {
    fn of(variable: &Variable) -> Self {
        Self {
            name: variable.name.clone(),
            kind: variable.kind,
            reference: variable.reference,
            is_discrete: variable.causality == Causality::Input
                && variable.variability == Variability::Discrete,
        }
    }
}

/// A start value, ready for calls to the library.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Start {
    Number(Access, f64),
    Text(Access, CString),
}

/// A configuration that fits a description.
#[derive(Clone, Debug, PartialEq)]
struct Plan {
    start: Vec<Start>,
    inputs: Vec<Access>,
    outputs: Vec<Access>,
    step_seconds: Option<f64>,
}

impl Configuration {
    /// Fits the configuration to a description.
    fn plan(&self, description: &Description) -> Result<Plan, Fault> {
        let co_simulation = description.served()?;
        let access = |name: &String, is_input: bool| {
            let variable = description.variable(name)?;
            check_port(variable, is_input)?;
            Ok(Access::of(variable))
        };
        let all = |names: &[String], is_input| {
            let accesses = names.iter().map(|name| access(name, is_input));
            accesses.collect::<Result<Vec<_>, Fault>>()
        };
        let start = self
            .start
            .iter()
            .map(|(name, value)| checked_start(description.variable(name)?, value));
        Ok(Plan {
            start: start.collect::<Result<_, Fault>>()?,
            inputs: all(&self.inputs, true)?,
            outputs: all(&self.outputs, false)?,
            step_seconds: fixed_step(self.step_seconds, co_simulation, description)?,
        })
    }
}

/// Checks whether a port can carry a variable.
pub(crate) fn check_port(variable: &Variable, is_input: bool) -> Result<(), Fault> {
    let fault = |reason: &str| Err(Fault::variable(&variable.name, reason));
    if variable.is_array {
        return fault("is an array, which cannot be a port");
    }
    if !variable.kind.is_number() {
        return fault("is not a number, so it cannot be a port");
    }
    if is_input && !variable.is_input() {
        let is = variable.causality.name();
        return fault(&format!("is {is}, so nothing can be wired to set it"));
    }
    Ok(())
}

/// Returns a start value for calls to the library, if the variable accepts it.
pub(crate) fn checked_start(variable: &Variable, value: &StartValue) -> Result<Start, Fault> {
    let fault = |reason: String| Err(Fault::variable(&variable.name, reason));
    if !variable.takes_start() {
        let is = variable.causality.name();
        return fault(format!("is {is}, which takes no start value"));
    }
    let access = Access::of(variable);
    let number = match (value, variable.kind) {
        (StartValue::Text(text), Kind::String) => {
            return match CString::new(text.as_str()) {
                Ok(text) => Ok(Start::Text(access, text)),
                Err(_) => fault("cannot be a text with a NUL in it".to_owned()),
            };
        }
        (StartValue::Truth(truth), Kind::Boolean) => f64::from(u8::from(*truth)),
        (StartValue::Number(number), kind) if kind.is_number() && kind != Kind::Boolean => *number,
        (_, Kind::String) => return fault("takes a text as its start value".to_owned()),
        (_, Kind::Boolean) => return fault("takes true or false as its start value".to_owned()),
        _ => return fault("takes a number as its start value".to_owned()),
    };
    let lowest = variable.min.unwrap_or(f64::NEG_INFINITY);
    let highest = variable.max.unwrap_or(f64::INFINITY);
    if !number.is_finite() || number < lowest || number > highest {
        return fault(format!(
            "cannot start with {number}, it must be from {lowest} to {highest}"
        ));
    }
    if let Some([lowest, highest]) = variable.kind.whole_range()
        && (number.fract() != 0.0 || number < lowest || number > highest)
    {
        return fault(format!(
            "cannot start with {number}, it must be a whole number from {lowest} to {highest}"
        ));
    }
    Ok(Start::Number(access, number))
}

/// Returns the only length of a step, if the FMU or the configuration has one.
pub(crate) fn fixed_step(
    wanted: Option<f64>,
    co_simulation: &CoSimulation,
    description: &Description,
) -> Result<Option<f64>, Fault> {
    if let Some(step) = wanted {
        return if step > 0.0 && step.is_finite() {
            Ok(wanted)
        } else {
            Err(Fault::Invalid(format!(
                "its step is {step} s, it must be above 0"
            )))
        };
    }
    if co_simulation.takes_any_step {
        return Ok(None);
    }
    let recommended = co_simulation
        .fixed_step_seconds
        .or(description.step_seconds);
    match recommended {
        Some(step) => Ok(Some(step)),
        None => Err(Fault::Invalid(
            "it takes steps of one length only and does not say which; write step_milliseconds"
                .to_owned(),
        )),
    }
}

/// One instance of an FMU at its time. An advance neither allocates nor looks anything up.
pub struct Instance {
    file: PathBuf,
    slave: Box<dyn Slave>,
    inputs: Vec<Access>,
    outputs: Vec<Access>,
    /// Last values of the inputs; NaN before the first.
    last_inputs: Vec<f64>,
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

/// Terminates the instance as FMI requires: some FMUs write their files then. An error comes too late to report.
impl Drop for Instance {
    fn drop(&mut self) {
        if self.is_initialized {
            self.slave.terminate();
        }
    }
}

impl Instance {
    /// Loads an unpacked FMU from a folder, and brings it to time 0. It runs foreign code, so only a worker process may
    /// call it.
    ///
    /// # Errors
    /// The FMU cannot be loaded, or does not accept the configuration; `file` is its name in the error.
    pub fn new(
        folder: &Path,
        file: &Path,
        configuration: &Configuration,
    ) -> Result<Self, FmuError> {
        Self::loaded(folder, file, configuration).map_err(|fault| fault.of(file))
    }

    fn loaded(folder: &Path, file: &Path, configuration: &Configuration) -> Result<Self, Fault> {
        let description = description_in(folder)?;
        let plan = configuration.plan(&description)?;
        let co_simulation = description.served()?;
        let name = CString::new(configuration.name.as_str())
            .map_err(|_| Fault::Invalid("its name has a NUL in it".to_owned()))?;
        let slave = library::instantiate(folder, &description, &name)?;
        let mut instance = Self {
            file: file.to_owned(),
            slave,
            last_inputs: vec![f64::NAN; plan.inputs.len()],
            inputs: plan.inputs,
            outputs: plan.outputs,
            step_seconds: plan.step_seconds,
            steps: 0.0,
            may_shorten: co_simulation.takes_any_step,
            has_events: co_simulation.has_event_mode,
            next_event_seconds: f64::INFINITY,
            time_seconds: 0.0,
            is_initialized: false,
        };
        instance.initialize(&plan.start, description.tolerance)?;
        Ok(instance)
    }

    fn initialize(&mut self, start: &[Start], tolerance: Option<f64>) -> Result<(), Fault> {
        for start in start {
            let slave = &mut self.slave;
            let (access, status) = match start {
                Start::Number(of, number) => (of, slave.set_number(of.kind, of.reference, *number)),
                Start::Text(of, text) => (of, slave.set_text(of.reference, text)),
            };
            if !status.is_good() {
                let (outcome, log) = (status.outcome(), self.slave.log());
                return Err(Fault::variable(
                    &access.name,
                    format!("could not be set to its start value: {outcome} {log}"),
                ));
            }
        }
        let status = self.slave.enter_initialization(0.0, tolerance);
        self.good("EnterInitializationMode", status, None)?;
        let status = self.slave.exit_initialization();
        self.good("ExitInitializationMode", status, None)?;
        if self.has_events {
            self.update_and_go_on(None)?;
        }
        self.is_initialized = true;
        Ok(())
    }

    /// Returns the time in the FMU.
    pub fn time_seconds(&self) -> f64 {
        self.time_seconds
    }

    /// Advances the time under constant inputs. An FMU with a fixed step advances by whole steps; its outputs are then
    /// constant until the next one.
    ///
    /// # Errors
    /// An input is no number, or the FMU failed.
    ///
    /// # Panics
    /// The number of inputs differs from the configuration.
    pub fn advance(&mut self, to_seconds: f64, inputs: &[f64]) -> Result<(), FmuError> {
        let advanced = self.set(inputs).and_then(|()| match self.step_seconds {
            None => self.reach(to_seconds),
            Some(step_seconds) => self.count_to(to_seconds, step_seconds),
        });
        advanced.map_err(|fault| fault.of(&self.file))
    }

    /// Reads the outputs.
    ///
    /// # Errors
    /// An output is no finite number, or the FMU failed.
    ///
    /// # Panics
    /// The number of outputs differs from the configuration.
    pub fn read(&mut self, outputs: &mut [f64]) -> Result<(), FmuError> {
        assert_eq!(
            outputs.len(),
            self.outputs.len(),
            "outputs of the configuration"
        );
        for (access, value) in self.outputs.iter().zip(outputs) {
            let status = self.slave.number(access.kind, access.reference, value);
            if !status.is_good() {
                let log = self.slave.log();
                let reason = format!("could not be read: {} {log}", status.outcome());
                return Err(Fault::variable(&access.name, reason).of(&self.file));
            }
            if !value.is_finite() {
                return Err(Fault::NotFinite {
                    variable: access.name.clone(),
                    value: *value,
                    time_seconds: self.time_seconds,
                    whose: "the FMU computed it",
                }
                .of(&self.file));
            }
        }
        Ok(())
    }

    fn set(&mut self, inputs: &[f64]) -> Result<(), Fault> {
        assert_eq!(
            inputs.len(),
            self.inputs.len(),
            "inputs of the configuration"
        );
        for (access, value) in self.inputs.iter().zip(inputs) {
            if !value.is_finite() {
                return Err(Fault::NotFinite {
                    variable: access.name.clone(),
                    value: *value,
                    time_seconds: self.time_seconds,
                    whose: "what is wired to it put it out",
                });
            }
        }
        // Discrete inputs are set in event mode, if the FMU has one.
        self.set_those(inputs, false)?;
        let is_changed = |((access, value), last): ((&Access, &f64), &f64)| {
            access.is_discrete && value.to_bits() != last.to_bits()
        };
        let mut pairs = self.inputs.iter().zip(inputs).zip(&self.last_inputs);
        if self.has_events && pairs.any(is_changed) {
            let status = self.slave.enter_events();
            self.good("EnterEventMode", status, Some(self.time_seconds))?;
            self.set_those(inputs, true)?;
            self.update_and_go_on(Some(self.time_seconds))?;
        } else if !self.has_events {
            self.set_those(inputs, true)?;
        }
        Ok(())
    }

    /// Sets the inputs that have changed: the discrete ones, or the others.
    fn set_those(&mut self, inputs: &[f64], is_discrete: bool) -> Result<(), Fault> {
        for ((access, value), last) in self.inputs.iter().zip(inputs).zip(&mut self.last_inputs) {
            if access.is_discrete != is_discrete || value.to_bits() == last.to_bits() {
                continue;
            }
            let taken = match access.kind.whole_range() {
                Some([lowest, highest]) => value.round().clamp(lowest, highest),
                None => *value,
            };
            let status = self.slave.set_number(access.kind, access.reference, taken);
            if !status.is_good() {
                let (outcome, log) = (status.outcome(), self.slave.log());
                let time = self.time_seconds;
                let reason = format!("could not be set to {value} at {time} s: {outcome} {log}");
                return Err(Fault::variable(&access.name, reason));
            }
            *last = *value;
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
        Fault::Call {
            function: "DoStep",
            outcome: format!("was called {STEPS_MAX} times without reaching the next SYNC"),
            time_seconds: Some(self.time_seconds),
            log: String::new(),
        }
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
                return Err(Fault::Terminated {
                    time_seconds: if reached.is_finite() { reached } else { from },
                    log: self.slave.log(),
                });
            }
            let is_discarded = stepped.status == Status::Discard;
            if !is_discarded {
                self.good("DoStep", stepped.status, Some(from))?;
            }
            let advanced = reached - from;
            let is_sane = (0.0..=duration * (1.0 + ROUNDING)).contains(&advanced);
            if !is_sane {
                let end = from + duration;
                let outcome =
                    format!("says that it reached {reached} s, in a step that ends at {end} s");
                return Err(self.failed("DoStep", outcome, Some(from)));
            }
            if advanced > 0.0 {
                self.time_seconds = reached;
            }
            let is_event =
                self.has_events && self.time_seconds >= self.next_event_seconds - shortest;
            if self.has_events && (stepped.needs_events || is_event) {
                let status = self.slave.enter_events();
                self.good("EnterEventMode", status, Some(self.time_seconds))?;
                self.update_and_go_on(Some(self.time_seconds))?;
            }
            if is_discarded && advanced <= 0.0 {
                if !self.may_shorten || duration / 2.0 < shortest {
                    return Err(self.discarded(duration));
                }
                longest = duration / 2.0;
            }
        }
        Err(self.too_many())
    }

    fn discarded(&mut self, duration: f64) -> Fault {
        let shorter = if self.may_shorten {
            "and every shorter one"
        } else {
            "and it takes no shorter one"
        };
        let outcome = format!("refused (discard) a step of {duration} s, {shorter}");
        self.failed("DoStep", outcome, Some(self.time_seconds))
    }

    /// Returns from event mode to step mode: updates the discrete states until they are stable.
    fn update_and_go_on(&mut self, time_seconds: Option<f64>) -> Result<(), Fault> {
        let mut count = 0;
        loop {
            let (status, updated) = self.slave.update_discrete();
            self.good("UpdateDiscreteStates", status, time_seconds)?;
            if updated.is_terminated {
                return Err(Fault::Terminated {
                    time_seconds: self.time_seconds,
                    log: self.slave.log(),
                });
            }
            self.next_event_seconds = updated.next_event_seconds.unwrap_or(f64::INFINITY);
            count += 1;
            if !updated.again {
                break;
            }
            if count == UPDATES_MAX {
                let outcome = format!("wanted to be called more than {UPDATES_MAX} times");
                return Err(self.failed("UpdateDiscreteStates", outcome, time_seconds));
            }
        }
        let status = self.slave.enter_steps();
        self.good("EnterStepMode", status, time_seconds)
    }

    fn good(
        &mut self,
        function: &'static str,
        status: Status,
        time_seconds: Option<f64>,
    ) -> Result<(), Fault> {
        if status.is_good() {
            return Ok(());
        }
        let fault = self.failed(function, status.outcome(), time_seconds);
        if status == Status::Fatal {
            self.is_initialized = false;
            self.slave.forsake();
        }
        Err(fault)
    }

    fn failed(
        &mut self,
        function: &'static str,
        outcome: String,
        time_seconds: Option<f64>,
    ) -> Fault {
        Fault::Call {
            function,
            outcome,
            time_seconds,
            log: self.slave.log(),
        }
    }
}

#[cfg(test)]
mod tests;
