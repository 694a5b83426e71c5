//! Node in a process of its own: its start, the request to stop, and the report on its end.

use std::fs::{self, File};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ExitStatus, Stdio};
use std::time::Duration;

use platform::bus::BusAddress;
use platform::clock::{Clock, sleep};
use platform::keeper::last_lines;
use platform::{process, program};

use crate::error::{Doing, WorldError};
use crate::law_process::{end_of, has_process_law, scenario_folder};
use crate::names::PLANT_EMULATOR;
use crate::process_faults::ProcessAction;
use crate::programs::{ProgramOrder, StartedProgram};
use plan::Plan;
use recording::run_folder::RunFolder;

/// Number of bytes at the end of a log that are searched for its last lines.
const LOG_TAIL_BYTES: usize = 4096;
/// Period of the check whether a process has ended.
const LOOK: Duration = Duration::from_millis(2);
/// Longest wall time for the orderly end of a process.
pub(super) const END_PATIENCE: Duration = Duration::from_secs(3);
/// Exit codes of a node's process that attribute its end; any other attributes it to the node.
const NOT_SET_UP: i32 = 3;
const BUS_FAILED: i32 = 4;
const INTERNAL: i32 = 70;
/// Time of an end before the request to stop.
const EARLY: &str = " in the middle of the run";

/// Process that was stopped.
pub(super) struct Stopped {
    /// Name of its node.
    pub(super) name: String,
    /// Report of a node of canrig's on itself.
    pub(super) report: Option<String>,
    /// Error if it ended badly.
    pub(super) ended: Result<(), WorldError>,
}

/// Process of a node.
pub(super) struct NodeProcess {
    process: Process,
    /// Whether a fault of the scenario has killed it.
    is_killed_by_fault: bool,
}

enum Process {
    /// Process of canrig's own.
    Own(OwnProcess),
    /// Program, in real time.
    Program(Box<ProgramOrder>, StartedProgram),
}

impl NodeProcess {
    fn new(process: Process) -> Self {
        Self {
            process,
            is_killed_by_fault: false,
        }
    }

    /// Starts this program again as the node `name`. Its standard error goes to a log in the run's folder; its standard output is
    /// its report; a `side_channel` takes the place of the lifeline.
    pub(super) fn spawn(
        name: &str,
        plan: &Plan,
        folder: &RunFolder,
        bus: Option<&BusAddress>,
        side_channel: Option<OwnedFd>,
    ) -> io::Result<Self> {
        let log = folder.path().join(format!("{name}.log"));
        let output = File::create(&log)?;
        let mut command = process::myself()?;
        let is_controller = name == plan.controller().name;
        let role = match name {
            _ if is_controller => &["controller"][..],
            PLANT_EMULATOR => &[PLANT_EMULATOR],
            plant => &[PLANT_EMULATOR, "--plant", plant],
        };
        command.arg("node").args(role);
        command.arg("--scenario").arg(folder.scenario());
        let mut end_patience = END_PATIENCE;
        if is_controller {
            command.arg("--laws-in").arg(scenario_folder(plan));
            if has_process_law(plan) {
                end_patience += program::END_PATIENCE;
            }
        }
        if let Some(bus) = bus {
            command.arg("--bus").arg(bus.to_string());
        }
        if let Some(side_channel) = side_channel {
            command.arg("--lockstep").stdin(side_channel);
        }
        command.stdout(Stdio::piped()).stderr(output);
        let mut child = command.spawn()?;
        Ok(Self::new(Process::Own(OwnProcess {
            name: name.to_owned(),
            lifeline: child.stdin.take(),
            child,
            log,
            end_patience,
        })))
    }

    /// Starts the program of a node on a bus, in real time.
    pub(super) fn start(order: ProgramOrder, bus: &BusAddress) -> io::Result<Self> {
        let started = match bus {
            BusAddress::Private(_) => Err(io::Error::other(
                "a program cannot join a private bus: play with --bus embedded, or on a CAN interface",
            )),
            bus => order.start(bus.to_string(), "real", None),
        };
        Ok(Self::new(Process::Program(Box::new(order), started?)))
    }

    /// Starts another process in place of one that a fault has killed.
    pub(super) fn again(
        &self,
        plan: &Plan,
        folder: &RunFolder,
        bus: &BusAddress,
    ) -> Result<Self, WorldError> {
        let started = match &self.process {
            Process::Own(node) => Self::spawn(&node.name, plan, folder, Some(bus), None),
            Process::Program(order, _) => Self::start(ProgramOrder::clone(order), bus),
        };
        started.map_err(WorldError::control(self.name(), "started again"))
    }

    /// Returns the name of its node.
    pub(super) fn name(&self) -> &str {
        match &self.process {
            Process::Own(node) => &node.name,
            Process::Program(order, _) => order.name(),
        }
    }

    /// Returns the process number; of a program that of its keeper.
    pub(super) fn number(&self) -> u32 {
        match &self.process {
            Process::Own(node) => node.child.id(),
            Process::Program(_, started) => started.program.number(),
        }
    }

    /// Kills, suspends or resumes the process as a fault of the scenario, unless one has killed it.
    pub(super) fn play_fault(&mut self, action: ProcessAction) -> Result<(), WorldError> {
        if self.is_killed_by_fault {
            return Ok(());
        }
        let is_suspended = action == ProcessAction::Suspend;
        let signalled = match (&mut self.process, action) {
            // A start makes another process: see `again`.
            (_, ProcessAction::Start) => Ok(()),
            (Process::Own(node), ProcessAction::Kill) => node.kill(),
            (Process::Own(node), ProcessAction::Suspend | ProcessAction::Resume) => {
                process::suspend(node.child.id(), is_suspended)
            }
            (Process::Program(_, started), ProcessAction::Kill) => {
                started.program.kill();
                Ok(())
            }
            (Process::Program(_, started), ProcessAction::Suspend | ProcessAction::Resume) => {
                started.program.suspend(is_suspended);
                Ok(())
            }
        };
        signalled.map_err(WorldError::control(self.name(), "signalled"))?;
        self.is_killed_by_fault = action == ProcessAction::Kill;
        Ok(())
    }

    /// Sends SIGTERM to a process of canrig, so that it does not wait for the process of a law.
    pub(super) fn terminate(&self) {
        if let Process::Own(node) = &self.process {
            // An ended process is reported when it is stopped.
            let _ = process::terminate(node.child.id());
        }
    }

    /// Returns the error for a process that ends within a patience, before the request to stop. A process that a fault killed has
    /// not ended early.
    pub(super) fn early_end(&mut self, patience: Duration) -> Option<WorldError> {
        match &mut self.process {
            _ if self.is_killed_by_fault => None,
            Process::Own(node) => match node.wait(patience) {
                Ok(status) => Some(node.failure(status?, EARLY)),
                Err(error) => Some(error),
            },
            Process::Program(order, started) => {
                started.end_by_itself(order.name(), patience, EARLY)
            }
        }
    }

    /// Asks the node for its safe state and waits for its end; with the report of a node of canrig, also after a bad end.
    pub(super) fn stop(&mut self) -> Stopped {
        let (report, ended) = match &mut self.process {
            Process::Own(_) if self.is_killed_by_fault => (Some(String::new()), Ok(())),
            Process::Own(node) => node.stop(),
            Process::Program(..) if self.is_killed_by_fault => (None, Ok(())),
            Process::Program(order, started) => {
                // It may still be suspended.
                started.program.suspend(false);
                let early = started.end_by_itself(order.name(), Duration::ZERO, EARLY);
                (None, early.map_or_else(|| started.end(order.name()), Err))
            }
        };
        let name = self.name().to_owned();
        Stopped {
            name,
            report,
            ended,
        }
    }
}

/// Process of canrig's own. It does not outlive this value.
struct OwnProcess {
    name: String,
    child: Child,
    /// Pipe whose end stops the node, so that the node stops too when this process is killed.
    lifeline: Option<ChildStdin>,
    log: PathBuf,
    /// Longest wall time for its orderly end.
    end_patience: Duration,
}

impl OwnProcess {
    fn kill(&mut self) -> io::Result<()> {
        self.child.kill()?;
        self.child.wait().map(drop)
    }

    /// Asks the node for its safe state and waits for its end; returns the node's report, also after a bad end.
    fn stop(&mut self) -> (Option<String>, Result<(), WorldError>) {
        let when = if let Ok(Some(_)) = self.child.try_wait() {
            EARLY
        } else {
            // It may still be suspended; an ended process is reported below.
            let _ = process::suspend(self.child.id(), false);
            " when it was to stop"
        };
        self.lifeline = None;
        let ended = self.end(when);
        let mut report = String::new();
        let is_there = !matches!(ended, Err(WorldError::NoStop { .. }));
        // The report is one line, so that it fits the pipe and the node never waits for its reader.
        if let Some(mut output) = self.child.stdout.take().filter(|_| is_there) {
            // Without a report the timing is not trusted; it has no other effect.
            let _ = output.read_to_string(&mut report);
        }
        (Some(report), ended)
    }

    /// Waits for its end, no longer than `patience`.
    fn wait(&mut self, patience: Duration) -> Result<Option<ExitStatus>, WorldError> {
        let clock = Clock::start();
        loop {
            match self.child.try_wait() {
                Ok(None) if clock.now() < patience => sleep(LOOK),
                ended => return ended.map_err(WorldError::control(&self.name, "awaited")),
            }
        }
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// If it does not end in time, or ends badly.
    fn end(&mut self, when: &str) -> Result<(), WorldError> {
        match self.wait(self.end_patience)? {
            Some(status) if status.success() => {
                if fs::metadata(&self.log).is_ok_and(|metadata| metadata.len() == 0) {
                    // A remaining empty file does no harm.
                    let _ = fs::remove_file(&self.log);
                }
                Ok(())
            }
            Some(status) => Err(self.failure(status, when)),
            None => {
                // Already late, so a failed kill does not matter any more.
                let _ = self.kill();
                Err(WorldError::NoStop {
                    name: self.name.clone(),
                    patience: self.end_patience,
                })
            }
        }
    }

    fn failure(&self, status: ExitStatus, when: &str) -> WorldError {
        let log = fs::read(&self.log).unwrap_or_default();
        let tail = last_lines(&log[log.len().saturating_sub(LOG_TAIL_BYTES)..]);
        let (doing, how) = match ended_by(status) {
            (Doing::NotSetUp, _) => (Doing::NotSetUp, "cannot be set up".to_owned()),
            (doing, how) => (doing, how + when),
        };
        WorldError::Process {
            name: self.name.clone(),
            how,
            log: end_of("log", &tail),
            doing,
        }
    }
}

impl Drop for OwnProcess {
    fn drop(&mut self) {
        // A process that has ended needs no kill.
        let _ = self.kill();
    }
}

/// Attributes an end by the exit codes of `canrig node`, and describes it.
fn ended_by(status: ExitStatus) -> (Doing, String) {
    use std::os::unix::process::ExitStatusExt;
    let Some(code) = status.code() else {
        let signal = status.signal().unwrap_or_default();
        let doing = if process::is_crash(signal) {
            Doing::Crashed
        } else {
            Doing::FromOutside
        };
        return (doing, format!("was killed by signal {signal}"));
    };
    let doing = match code {
        NOT_SET_UP => Doing::NotSetUp,
        BUS_FAILED => Doing::FromOutside,
        INTERNAL => Doing::Crashed,
        _ => Doing::GaveUp,
    };
    (doing, format!("ended with exit code {code}"))
}
