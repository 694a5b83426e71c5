//! Processes that load FMUs: `canrig fmu-worker`, one for each FMU of a run.

use std::io;
use std::os::fd::RawFd;
use std::time::Duration;

use fmu::worker::Channel;
use platform::worker::{self, Worker};

/// Hidden subcommand of a worker.
pub const SUBCOMMAND: &str = "fmu-worker";

/// Plant's end of the channel to a worker.
struct ToWorker(Worker);

/// Worker's end of the channel.
struct ToPlant(worker::Channel);

/// Starts a worker.
///
/// # Errors
/// If the system refuses.
pub fn start() -> io::Result<Box<dyn Channel>> {
    let worker = Worker::start(&[SUBCOMMAND])?;
    Ok(Box::new(ToWorker(worker)))
}

/// Runs the hidden subcommand: loads one FMU and steps it as the parent process asks.
///
/// # Errors
/// If there is no channel of this number, or it failed.
pub fn serve(number: RawFd) -> io::Result<()> {
    fmu::worker::serve(&mut ToPlant(worker::Channel::inherited(number)?))
}

impl Channel for ToWorker {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.0.channel.send(message)
    }

    fn receive(&mut self, message: &mut [u8], patience: Option<Duration>) -> io::Result<usize> {
        self.0.channel.receive(message, patience)
    }

    fn ended(&mut self) -> (String, String) {
        self.0.ended()
    }
}

impl Channel for ToPlant {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.0.send(message)
    }

    fn receive(&mut self, message: &mut [u8], patience: Option<Duration>) -> io::Result<usize> {
        self.0.receive(message, patience)
    }

    fn ended(&mut self) -> (String, String) {
        ("ended".to_owned(), String::new())
    }
}
