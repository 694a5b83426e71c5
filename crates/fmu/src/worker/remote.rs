//! The plant's side.

use std::fmt;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use super::Channel;
use super::protocol::{
    ADVANCE, CANNOT, DONE, END, FAILED, LOAD, MESSAGE_BYTES_MAX, Order, numbers, write,
};
use crate::archive::Unpacked;
use crate::error::{Fault, FmuError};
use crate::instance::Configuration;

/// Time for an FMU to load and to find its start; some FMUs start an interpreter.
pub const LOAD_PATIENCE: Duration = Duration::from_secs(60);
/// Time for a step: less than the time that other nodes wait for the plant in lock-step.
pub const STEP_PATIENCE: Duration = Duration::from_secs(5);
/// Time for an FMU to end.
const END_PATIENCE: Duration = Duration::from_secs(2);

/// An FMU that plays in a worker. The worker ends when this is dropped.
pub struct Remote {
    file: PathBuf,
    channel: Box<dyn Channel>,
    inputs: usize,
    outputs: usize,
    message: Vec<u8>,
    answer: Vec<u8>,
}

impl fmt::Debug for Remote {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = formatter.debug_struct("Remote");
        shown.field("file", &self.file).finish_non_exhaustive()
    }
}

impl Remote {
    /// Lets the worker at the other end load an FMU and bring it to time 0; `outputs` then has its values.
    ///
    /// # Errors
    /// The FMU cannot be loaded, does not accept the configuration, or ended its worker.
    ///
    /// # Panics
    /// The number of outputs differs from the configuration.
    pub fn load(
        channel: Box<dyn Channel>,
        unpacked: &Unpacked,
        configuration: &Configuration,
        outputs: &mut [f64],
    ) -> Result<Self, FmuError> {
        let mut remote = Self {
            file: unpacked.file.clone(),
            channel,
            inputs: configuration.inputs.len(),
            outputs: configuration.outputs.len(),
            message: Vec::with_capacity(MESSAGE_BYTES_MAX),
            answer: vec![0; MESSAGE_BYTES_MAX],
        };
        let order = Order {
            folder: unpacked.folder().to_string_lossy().into_owned(),
            file: remote.file.to_string_lossy().into_owned(),
            configuration: configuration.clone(),
        };
        remote
            .order(&order)
            .and_then(|()| remote.ask("loaded it", LOAD_PATIENCE))
            .and_then(|length| remote.take(length, outputs))
            .map_err(|fault| fault.of(&remote.file))?;
        Ok(remote)
    }

    fn order(&mut self, order: &Order) -> Result<(), Fault> {
        // Each value of the configuration is sent or returned in one message.
        let values = 8 * (self.inputs.max(self.outputs) + 2);
        let order =
            postcard::to_allocvec(order).map_err(|error| Fault::Table(error.to_string()))?;
        if order.len().max(values) >= MESSAGE_BYTES_MAX {
            return Err(Fault::Table(format!(
                "its start values and ports have {} bytes (limit {MESSAGE_BYTES_MAX})",
                order.len().max(values)
            )));
        }
        self.message.clear();
        self.message.push(LOAD);
        self.message.extend_from_slice(&order);
        Ok(())
    }

    /// Advances the time under constant inputs; `outputs` then has the values.
    ///
    /// # Errors
    /// The FMU failed, or ended its worker.
    ///
    /// # Panics
    /// The number of inputs or outputs differs from the configuration.
    pub fn advance(
        &mut self,
        to_seconds: f64,
        inputs: &[f64],
        outputs: &mut [f64],
    ) -> Result<(), FmuError> {
        assert_eq!(inputs.len(), self.inputs, "inputs of the configuration");
        let numbers = std::iter::once(to_seconds).chain(inputs.iter().copied());
        write(&mut self.message, ADVANCE, numbers);
        self.ask("stepped", STEP_PATIENCE)
            .and_then(|length| self.take(length, outputs))
            .map_err(|fault| fault.of(&self.file))
    }

    /// Terminates the FMU as FMI requires.
    ///
    /// # Errors
    /// The FMU failed in this, or ended its worker.
    pub fn end(mut self) -> Result<(), FmuError> {
        write(&mut self.message, END, std::iter::empty());
        self.ask("ended", END_PATIENCE)
            .and_then(|length| self.refused(length))
            .map_err(|fault| fault.of(&self.file))
    }

    /// Sends the message and waits for the answer; returns its length.
    fn ask(&mut self, doing: &'static str, patience: Duration) -> Result<usize, Fault> {
        let answered = match self.channel.send(&self.message) {
            Ok(()) => self.channel.receive(&mut self.answer, Some(patience)),
            // The cause of the worker's end is asked for below.
            Err(_) => Ok(0),
        };
        match answered {
            Ok(0) => {
                let (how, log) = self.channel.ended();
                let doing = doing.to_owned();
                Err(Fault::Died { how, doing, log })
            }
            Ok(length) => Ok(length),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                self.channel.ended();
                let doing = doing.to_owned();
                Err(Fault::Hangs { doing, patience })
            }
            Err(error) => Err(Fault::Worker(format!("cannot be reached: {error}"))),
        }
    }

    /// Returns the error that the worker sent in place of an answer.
    fn refused(&self, length: usize) -> Result<(), Fault> {
        let answer = &self.answer[..length];
        let told = |in_run| {
            let text = String::from_utf8_lossy(&answer[1..]).into_owned();
            Err(Fault::Told { text, in_run })
        };
        match answer.first() {
            Some(&DONE) => Ok(()),
            Some(&CANNOT) => told(false),
            Some(&FAILED) => told(true),
            _ => Err(unexpected_answer()),
        }
    }

    fn take(&self, length: usize, outputs: &mut [f64]) -> Result<(), Fault> {
        assert_eq!(outputs.len(), self.outputs, "outputs of the configuration");
        self.refused(length)?;
        let numbers = numbers(&self.answer[..length]);
        if numbers.len() != outputs.len() {
            return Err(unexpected_answer());
        }
        for (output, number) in outputs.iter_mut().zip(numbers) {
            *output = number;
        }
        Ok(())
    }
}

fn unexpected_answer() -> Fault {
    Fault::Worker("answered what is no answer".to_owned())
}
