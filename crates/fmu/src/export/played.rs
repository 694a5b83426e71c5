//! An instance of a model, without C.

use std::ffi::{CStr, CString, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::component::{ERROR, FATAL};
use super::{Exported, Model, Role, Running, by_token};
use crate::instance::StartValue;

/// Value of a variable.
enum Value {
    Number(f64),
    Text(CString),
}

/// A model that was instantiated.
pub(super) struct Played {
    exported: &'static dyn Exported,
    model: Model,
    /// Values, one for each variable.
    values: Vec<Value>,
    running: Option<Box<dyn Running>>,
    time_seconds: f64,
}

impl Played {
    /// Instantiates the model whose description has this token.
    pub(super) fn new(token: &str) -> Result<Self, String> {
        let (exported, model) = by_token(token).ok_or_else(|| {
            format!("the token {token:?} is of no model of this library: description and library do not belong together")
        })?;
        let value = |role: &Role| match role {
            Role::Input(start) | Role::Number { start, .. } => Value::Number(*start),
            Role::Word { start } => Value::Text(CString::new(start.as_str()).unwrap_or_default()),
            Role::Output => Value::Number(0.0),
        };
        let variables = model.variables.iter();
        Ok(Self {
            exported,
            values: variables.map(|variable| value(&variable.role)).collect(),
            running: None,
            time_seconds: 0.0,
            model,
        })
    }

    /// Returns to the state before the start.
    pub(super) fn reset(&mut self) -> Result<(), String> {
        *self = Self::new(&self.model.token())?;
        Ok(())
    }

    pub(super) fn set_time(&mut self, time_seconds: f64) -> Result<(), String> {
        self.time_seconds = time_seconds;
        Ok(())
    }

    fn place(&self, reference: u32) -> Result<usize, String> {
        let place = usize::try_from(reference)
            .ok()
            .and_then(|place| place.checked_sub(1))
            .filter(|place| *place < self.model.variables.len());
        place.ok_or_else(|| format!("there is no variable {reference} to be set"))
    }

    /// Returns name and value of a variable that may be set now.
    fn settable(&mut self, reference: u32) -> Result<(&str, &mut Value), String> {
        let place = self.place(reference)?;
        let variable = &self.model.variables[place];
        let (name, is_input) = (&variable.name, matches!(variable.role, Role::Input(_)));
        if variable.role == Role::Output {
            return Err(format!("{name} is an output"));
        }
        if !is_input && self.running.is_some() {
            return Err(format!("{name} is fixed once the simulation runs"));
        }
        Ok((name, &mut self.values[place]))
    }

    pub(super) fn set_number(&mut self, reference: u32, value: f64) -> Result<(), String> {
        match self.settable(reference)? {
            (name, Value::Text(_)) => Err(format!("{name} is a text")),
            (name, _) if !value.is_finite() => Err(format!("{name} cannot be {value}")),
            (_, number) => {
                *number = Value::Number(value);
                Ok(())
            }
        }
    }

    pub(super) fn set_word(&mut self, reference: u32, word: &CStr) -> Result<(), String> {
        match self.settable(reference)? {
            (name, Value::Number(_)) => Err(format!("{name} is a number")),
            (_, text) => {
                *text = Value::Text(word.to_owned());
                Ok(())
            }
        }
    }

    pub(super) fn number(&mut self, reference: u32) -> Result<f64, String> {
        if reference == 0 {
            return Ok(self.time_seconds);
        }
        let place = self.place(reference)?;
        // Before the start the outputs are those of an instance that would start now.
        if self.model.variables[place].role == Role::Output && self.running.is_none() {
            let running = self.started()?;
            self.take_outputs(&*running);
        }
        match &self.values[place] {
            Value::Number(number) => Ok(*number),
            Value::Text(_) => Err(format!("{} is a text", self.model.variables[place].name)),
        }
    }

    pub(super) fn word(&self, reference: u32) -> Result<&CStr, String> {
        let place = self.place(reference)?;
        match &self.values[place] {
            Value::Text(text) => Ok(text),
            Value::Number(_) => Err(format!("{} is a number", self.model.variables[place].name)),
        }
    }

    fn started(&self) -> Result<Box<dyn Running>, String> {
        let values = self.model.variables.iter().zip(&self.values);
        let parameters = values.filter_map(|(variable, value)| match (&variable.role, value) {
            (Role::Input(_) | Role::Output, _) => None,
            (_, Value::Number(number)) => Some(StartValue::Number(*number)),
            (_, Value::Text(text)) => Some(StartValue::Text(text.to_string_lossy().into_owned())),
        });
        self.exported.start(&Vec::from_iter(parameters))
    }

    /// Starts the model. From here on parameters are fixed.
    pub(super) fn start(&mut self) -> Result<(), String> {
        let running = self.started()?;
        self.take_outputs(&*running);
        self.running = Some(running);
        Ok(())
    }

    pub(super) fn step(&mut self, from_seconds: f64, duration_seconds: f64) -> Result<(), String> {
        if !(duration_seconds >= 0.0 && duration_seconds.is_finite()) {
            return Err(format!("a step cannot take {duration_seconds} s"));
        }
        let mut running = self.running.take().ok_or("it was not initialized")?;
        let values = self.model.variables.iter().zip(&self.values);
        let inputs = values.filter_map(|(variable, value)| match (&variable.role, value) {
            (Role::Input(_), Value::Number(number)) => Some(*number),
            _ => None,
        });
        let inputs = Vec::from_iter(inputs);
        running.step(duration_seconds, &inputs);
        self.take_outputs(&*running);
        self.running = Some(running);
        self.time_seconds = from_seconds + duration_seconds;
        Ok(())
    }

    fn take_outputs(&mut self, running: &dyn Running) {
        let values = self.model.variables.iter().zip(&mut self.values);
        let outputs = values.filter(|(variable, _)| variable.role == Role::Output);
        for ((_, value), output) in outputs.zip(running.outputs()) {
            *value = Value::Number(output);
        }
    }
}

/// Runs code that may panic. A panic must not leave through C. A failure is a status of FMI and its reason.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, (c_int, String)> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(message)) => Err((ERROR, message)),
        Err(_) => Err((FATAL, "the model broke".to_owned())),
    }
}
