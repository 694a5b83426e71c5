//! Processes that load the FMUs of plants: `canrig fmu-worker`, one for each FMU of a run, at a port seat. A crash, a hang or an
//! exit of an FMU ends its worker, and costs only that run.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use fmu::{Configuration, Fault, FmuError, Instance, Unpacked};
use platform::port_seat::{NoAnswer, PortSeat};
use platform::program::{Order, START_PATIENCE, Seat};
use platform::seat::{Header, Kind, MESSAGE_BYTES_MAX, numbers};

use crate::law_worker::{Loaded, command, told};

/// Hidden subcommand of a worker.
pub const SUBCOMMAND: &str = "fmu-worker";
/// Time for a step: less than the time that other nodes wait for the plant in lock-step.
const STEP_PATIENCE: Duration = Duration::from_secs(5);
/// Time for an FMU to terminate.
const TERMINATE_PATIENCE: Duration = Duration::from_secs(2);
/// Time for a worker that closed its channel to end.
const CLOSED_PATIENCE: Duration = Duration::from_secs(1);
/// Actions of the worker, for messages.
const LOADED: &str = "loaded it";
const STEPPED: &str = "stepped";

/// FMU that plays in a worker.
#[derive(Debug)]
pub struct RemoteFmu {
    file: PathBuf,
    seat: PortSeat,
}

impl RemoteFmu {
    /// Starts a worker, which loads the FMU and brings it to time 0; `outputs` then has its values.
    ///
    /// # Errors
    /// If the FMU cannot be loaded, does not accept the configuration, or ended its worker.
    pub fn load(
        unpacked: &Unpacked,
        configuration: &Configuration,
        outputs: &mut [f64],
    ) -> Result<Self, FmuError> {
        let file = unpacked.file.clone();
        let command = command(SUBCOMMAND, &[unpacked.folder()]);
        let started = command.map_err(io::Error::other).and_then(|command| {
            let order = Order {
                command: &command,
                folder: Path::new("."),
                log: None,
                part: None,
                environment: &[],
            };
            // Where a kill leaves the seat, it goes with the unpacked files.
            PortSeat::start(&order, Some(unpacked.folder()))
        });
        let seat = started.map_err(|source| FmuError {
            file: file.clone(),
            fault: Fault::File {
                place: "no process to load it can be started".to_owned(),
                source,
            },
        })?;
        let mut remote = Self { file, seat };
        let inputs = vec![0.0; configuration.inputs.len()];
        let loaded = remote
            .meet(configuration)
            .and_then(|()| remote.step(LOADED, 0.0, &inputs, outputs));
        loaded.map_err(|fault| remote.failed(fault))?;
        Ok(remote)
    }

    /// Advances the time under constant inputs; `outputs` then has the values.
    ///
    /// # Errors
    /// If the FMU failed, or ended its worker.
    pub fn advance(
        &mut self,
        to_seconds: f64,
        inputs: &[f64],
        outputs: &mut [f64],
    ) -> Result<(), FmuError> {
        let stepped = self.step(STEPPED, to_seconds, inputs, outputs);
        stepped.map_err(|fault| self.failed(fault))
    }

    fn meet(&mut self, configuration: &Configuration) -> Result<(), Fault> {
        let part = postcard::to_allocvec(configuration)
            .map_err(|error| Fault::Invalid(error.to_string()))?;
        let values = configuration.inputs.len().max(configuration.outputs.len());
        // Beside the start values or the values of a step there are a header and a few numbers.
        let bytes = part.len().max(8 * values) + 64;
        if bytes >= MESSAGE_BYTES_MAX {
            return Err(Fault::Invalid(format!(
                "its start values and ports have {bytes} bytes (limit {MESSAGE_BYTES_MAX})"
            )));
        }
        let met = self.seat.meet(0, &part, CLOSED_PATIENCE);
        met.map_err(|why| unanswered(LOADED, START_PATIENCE, why))
    }

    /// Lets the worker step, and takes the outputs.
    fn step(
        &mut self,
        doing: &str,
        to_seconds: f64,
        inputs: &[f64],
        outputs: &mut [f64],
    ) -> Result<(), Fault> {
        let seat = &mut self.seat;
        let sent = seat.step(Header::of(Kind::Step), to_seconds, inputs);
        let patience = if sent.is_ok() {
            STEP_PATIENCE
        } else {
            Duration::ZERO
        };
        let answered = match (seat.values(patience, CLOSED_PATIENCE, outputs.len()), sent) {
            (Err(NoAnswer::Late), Err(error)) => {
                Err(NoAnswer::Wrong(format!("cannot be reached: {error}")))
            }
            // Of a worker that is gone, its end says more.
            (answered, _) => answered,
        };
        let values = answered.map_err(|why| unanswered(doing, STEP_PATIENCE, why))?;
        // Each step is waited for, so none is answered late.
        let values = outputs.iter_mut().zip(numbers(values.unwrap_or_default()));
        values.for_each(|(output, value)| *output = value);
        Ok(())
    }

    /// Ends the worker of an FMU that failed.
    fn failed(&mut self, fault: Fault) -> FmuError {
        self.seat.program.kill();
        let file = self.file.clone();
        FmuError { file, fault }
    }
}

impl Drop for RemoteFmu {
    /// Terminates the FMU as FMI demands, since some FMUs write their files then. An error comes too late to report.
    fn drop(&mut self) {
        if !self.seat.has_stopped(TERMINATE_PATIENCE) {
            self.seat.program.kill();
        }
    }
}

/// Returns the fault of an FMU for the reason why its worker gave no answer.
fn unanswered(doing: &str, patience: Duration, why: NoAnswer) -> Fault {
    let text = match why {
        NoAnswer::Ended((how, log)) => {
            let said = fmu::said(&log);
            format!(
                "the process that had it loaded {how} while it {doing}; only this run is lost{said}"
            )
        }
        NoAnswer::Late => {
            format!("it did not return within {patience:?} while it {doing}; its process was ended")
        }
        NoAnswer::GaveUp(text) => text,
        NoAnswer::Wrong(what) if doing == STEPPED => {
            format!("the process that has it loaded {what}")
        }
        NoAnswer::Wrong(what) => format!("the process that is to load it {what}"),
    };
    if doing == STEPPED {
        Fault::InRun(text)
    } else {
        Fault::Invalid(text)
    }
}

/// Runs the hidden subcommand: takes the seat that the environment names, loads an FMU whose files are in a folder, and steps it.
/// Call it only in a process of its own: it runs foreign code.
///
/// # Errors
/// If there is no seat, or its other end speaks another protocol.
pub fn serve(folder: &Path) -> io::Result<()> {
    let mut seat = Seat::join(SUBCOMMAND)?;
    let (configuration, _) = seat.welcome()?;
    let configuration: Configuration =
        postcard::from_bytes(configuration).map_err(io::Error::other)?;
    let loaded = load(folder, &configuration).map_err(told);
    let (inputs, outputs) = (configuration.inputs.len(), configuration.outputs.len());
    seat.play(loaded, inputs, outputs)
}

/// Loads an FMU. It is told the time to reach in place of a period; at time 0 it only has its outputs read.
fn load(folder: &Path, configuration: &Configuration) -> Result<Loaded, Fault> {
    let mut instance = Instance::new(folder, configuration)?;
    Ok(Box::new(move |_, to_seconds, inputs, outputs| {
        if to_seconds > 0.0 {
            instance.advance(to_seconds, inputs).map_err(told)?;
        }
        instance.read(outputs).map_err(told)
    }))
}
