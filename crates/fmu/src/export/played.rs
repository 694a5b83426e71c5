//! An instance of a model, without C.

use std::ffi::{CStr, CString, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::component::{ERROR, FATAL};
use super::{Exported, Model, Role, Running, by_token};
use crate::instance::StartValue;

/// A model that was instantiated.
pub(super) struct Played {
    exported: &'static dyn Exported,
    model: Model,
    /// Numbers, one for each variable; 0 for those that are texts.
    numbers: Vec<f64>,
    /// Texts, one for each variable; those of numbers stay empty.
    texts: Vec<CString>,
    running: Option<Box<dyn Running>>,
    time_seconds: f64,
}

impl Played {
    /// Instantiates the model whose description has this token.
    pub(super) fn new(token: &str) -> Result<Self, String> {
        let (exported, model) = by_token(token).ok_or_else(|| {
            format!("the token {token:?} is of no model of this library: description and library do not belong together")
        })?;
        let number = |role: &Role| match role {
            Role::Input(start) | Role::Number { start, .. } => *start,
            Role::Word { .. } | Role::Output => 0.0,
        };
        let word = |role: &Role| match role {
            Role::Word { start } => CString::new(start.as_str()).unwrap_or_default(),
            _ => CString::default(),
        };
        let roles = || model.variables.iter().map(|variable| &variable.role);
        Ok(Self {
            exported,
            numbers: roles().map(number).collect(),
            texts: roles().map(word).collect(),
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

    /// Checks whether a variable may be set now.
    fn settable(&self, place: usize) -> Result<(), String> {
        let variable = &self.model.variables[place];
        match variable.role {
            Role::Input(_) => Ok(()),
            Role::Output => Err(format!("{} is an output", variable.name)),
            _ if self.running.is_some() => Err(format!(
                "{} is fixed once the simulation runs",
                variable.name
            )),
            _ => Ok(()),
        }
    }

    pub(super) fn set_number(&mut self, reference: u32, value: f64) -> Result<(), String> {
        let place = self.place(reference)?;
        self.settable(place)?;
        let variable = &self.model.variables[place];
        if matches!(variable.role, Role::Word { .. }) {
            return Err(format!("{} is a text", variable.name));
        }
        if !value.is_finite() {
            return Err(format!("{} cannot be {value}", variable.name));
        }
        self.numbers[place] = value;
        Ok(())
    }

    pub(super) fn set_word(&mut self, reference: u32, word: &CStr) -> Result<(), String> {
        let place = self.place(reference)?;
        self.settable(place)?;
        let variable = &self.model.variables[place];
        if !matches!(variable.role, Role::Word { .. }) {
            return Err(format!("{} is a number", variable.name));
        }
        self.texts[place] = word.to_owned();
        Ok(())
    }

    pub(super) fn number(&mut self, reference: u32) -> Result<f64, String> {
        if reference == 0 {
            return Ok(self.time_seconds);
        }
        let place = self.place(reference)?;
        let variable = &self.model.variables[place];
        match variable.role {
            Role::Word { .. } => Err(format!("{} is a text", variable.name)),
            // Before the start the outputs are those of an instance that would start now.
            Role::Output if self.running.is_none() => {
                let running = self.started()?;
                self.take_outputs(&*running);
                Ok(self.numbers[place])
            }
            _ => Ok(self.numbers[place]),
        }
    }

    pub(super) fn word(&self, reference: u32) -> Result<&CStr, String> {
        let place = self.place(reference)?;
        match self.model.variables[place].role {
            Role::Word { .. } => Ok(&self.texts[place]),
            _ => Err(format!("{} is a number", self.model.variables[place].name)),
        }
    }

    fn started(&self) -> Result<Box<dyn Running>, String> {
        let variables = self.model.variables.iter();
        let values = variables.zip(&self.numbers).zip(&self.texts);
        let parameters = values.filter_map(|((variable, number), word)| match variable.role {
            Role::Number { .. } => Some(StartValue::Number(*number)),
            Role::Word { .. } => Some(StartValue::Text(word.to_string_lossy().into_owned())),
            _ => None,
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
        let values = self.model.variables.iter().zip(&self.numbers);
        let inputs = values.filter(|(variable, _)| matches!(variable.role, Role::Input(_)));
        let inputs = Vec::from_iter(inputs.map(|(_, value)| *value));
        running.step(duration_seconds, &inputs);
        self.take_outputs(&*running);
        self.running = Some(running);
        self.time_seconds = from_seconds + duration_seconds;
        Ok(())
    }

    fn take_outputs(&mut self, running: &dyn Running) {
        let values = self.model.variables.iter().zip(&mut self.numbers);
        let outputs = values.filter(|(variable, _)| variable.role == Role::Output);
        for ((_, number), output) in outputs.zip(running.outputs()) {
            *number = output;
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
