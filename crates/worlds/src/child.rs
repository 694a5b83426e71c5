//! Node in a process of its own: its start, the request to stop, and the report on its end.

use std::fs::{self, File};
use std::io;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use platform::bus::BusAddress;
use platform::clock::Clock;
use platform::process;
use tokio::io::AsyncReadExt;
use tokio::process::{Child, ChildStdin, Command};
use tokio::time::{sleep, timeout};

use crate::error::{Doing, WorldError};
use crate::law_process::{indented, more_patience, scenario_folder};
use crate::names::PLANT_EMULATOR;
use crate::programs::{ProgramOrder, StartedProgram};
use plan::Plan;
use recording::run_folder::RunFolder;

/// Number of lines of a log in a message.
const LOG_TAIL_LINES: usize = 12;
/// Number of bytes at the end of a log that are searched for these lines.
const LOG_TAIL_BYTES: usize = 4096;
/// Period at which a program is checked.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wall time for the orderly end of a process.
const END_PATIENCE: Duration = Duration::from_secs(3);
/// Exit codes of a node's process that attribute its end; any other attributes it to the node.
const NOT_SET_UP: i32 = 3;
const BUS_FAILED: i32 = 4;
const INTERNAL: i32 = 70;

/// Process of a node: canrig's own, or a program.
pub(super) enum NodeProcess {
    Own(OwnProcess),
    Program(ProgramProcess),
}

impl NodeProcess {
    /// Starts this program again as the node `name`; `side_channel` is passed on.
    pub(super) fn spawn(
        name: &str,
        plan: &Plan,
        folder: &RunFolder,
        bus: Option<&BusAddress>,
        side_channel: Option<OwnedFd>,
    ) -> Result<Self, WorldError> {
        OwnProcess::spawn(name, plan, folder, bus, side_channel).map(Self::Own)
    }

    /// Starts the program of a node on a bus, in real time.
    pub(super) fn start(order: ProgramOrder, bus: &BusAddress) -> Result<Self, WorldError> {
        ProgramProcess::start(order, bus).map(Self::Program)
    }

    /// Starts another process in place of one that a fault has killed.
    pub(super) fn again(
        &self,
        plan: &Plan,
        folder: &RunFolder,
        bus: &BusAddress,
    ) -> Result<Self, WorldError> {
        match self {
            Self::Own(node) => Self::spawn(&node.name, plan, folder, Some(bus), None),
            Self::Program(program) => Self::start(program.order.clone(), bus),
        }
    }

    /// Returns the name of its node.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Own(node) => &node.name,
            Self::Program(program) => program.order.name(),
        }
    }

    /// Returns the process number, unless the process has ended or is a program.
    pub(super) fn number(&self) -> Option<u32> {
        match self {
            Self::Own(node) => node.child.id(),
            Self::Program(_) => None,
        }
    }

    /// Kills the process as a fault of the scenario.
    pub(super) async fn kill_by_fault(&mut self) -> Result<(), WorldError> {
        match self {
            Self::Own(node) => node.kill_by_fault().await,
            Self::Program(program) => {
                program.is_killed_by_fault = true;
                program.started.program.kill();
                Ok(())
            }
        }
    }

    /// Suspends the process as a fault of the scenario, or resumes it.
    pub(super) fn suspend(&self, is_suspended: bool) -> Result<(), WorldError> {
        match self {
            Self::Own(node) => node.suspend(is_suspended),
            Self::Program(program) => {
                program.started.program.suspend(is_suspended);
                Ok(())
            }
        }
    }

    /// Waits for the process to end before the request to stop; returns the error for it. A process that a fault killed has not
    /// ended early.
    pub(super) async fn early_end(&mut self) -> WorldError {
        match self {
            Self::Own(node) => node.early_end().await,
            Self::Program(program) => program.early_end().await,
        }
    }

    /// Asks the node for its safe state and waits for its end; returns the report of a node of canrig, also after a bad end.
    pub(super) async fn stop(&mut self) -> (Option<String>, Result<(), WorldError>) {
        match self {
            Self::Own(node) => {
                let (report, ended) = node.stop().await;
                (Some(report), ended)
            }
            Self::Program(program) => (None, program.stop().await),
        }
    }
}

/// Process of a program, in real time.
pub(super) struct ProgramProcess {
    order: ProgramOrder,
    started: StartedProgram,
    is_killed_by_fault: bool,
}

impl ProgramProcess {
    fn start(order: ProgramOrder, bus: &BusAddress) -> Result<Self, WorldError> {
        let started = match bus {
            BusAddress::Private(_) => Err(io::Error::other(
                "a program cannot join a private bus: play with --bus embedded, or on a CAN interface",
            )),
            bus => order.start(bus.to_string(), "real", None),
        };
        let started = started.map_err(|source| WorldError::Spawn {
            name: order.name().to_owned(),
            source,
        })?;
        Ok(Self {
            order,
            started,
            is_killed_by_fault: false,
        })
    }

    async fn early_end(&mut self) -> WorldError {
        loop {
            if !self.is_killed_by_fault
                && let Some(end) = self.started.early_end(self.order.name())
            {
                return end;
            }
            sleep(LOOK).await;
        }
    }

    async fn stop(&mut self) -> Result<(), WorldError> {
        if self.is_killed_by_fault {
            return Ok(());
        }
        // It may still be suspended.
        self.started.program.suspend(false);
        if let Some(end) = self.started.early_end(self.order.name()) {
            return Err(end);
        }
        self.started.program.dismiss();
        let clock = Clock::start();
        while !self.started.has_ended() && clock.now() < platform::program::END_PATIENCE {
            sleep(LOOK).await;
        }
        self.started.ended_well(self.order.name())
    }
}

/// Process of canrig's own.
pub(super) struct OwnProcess {
    name: String,
    child: Child,
    /// Pipe whose end stops the node, so that the node stops too when this process is killed.
    lifeline: Option<ChildStdin>,
    log: PathBuf,
    /// Longest wall time for its orderly end.
    end_patience: Duration,
    /// Whether a fault of the scenario has killed it.
    is_killed_by_fault: bool,
}

impl OwnProcess {
    /// Starts this program again as the node `name`. Its standard error goes to a log in the run's folder; its standard output is
    /// its report; `side_channel` is passed on.
    fn spawn(
        name: &str,
        plan: &Plan,
        folder: &RunFolder,
        bus: Option<&BusAddress>,
        side_channel: Option<OwnedFd>,
    ) -> Result<Self, WorldError> {
        let fault = |source| WorldError::Spawn {
            name: name.to_owned(),
            source,
        };
        let log = folder.path().join(format!("{name}.log"));
        let output = File::create(&log).map_err(fault)?;
        let mut command = process::myself().map_err(fault)?;
        let is_controller = name == plan.controller().name;
        let role = match name {
            _ if is_controller => &["controller"][..],
            PLANT_EMULATOR => &[PLANT_EMULATOR],
            plant => &[PLANT_EMULATOR, "--plant", plant],
        };
        command
            .arg("node")
            .args(role)
            .arg("--scenario")
            .arg(folder.scenario());
        let mut end_patience = END_PATIENCE;
        if is_controller {
            command.arg("--laws-in").arg(scenario_folder(plan));
            end_patience += more_patience(plan)[1];
        }
        if let Some(bus) = bus {
            command.arg("--bus").arg(bus.to_string());
        }
        if let Some(side_channel) = side_channel {
            let number = process::inherit(&mut command, side_channel);
            command.arg("--lockstep").arg(number.to_string());
        }
        command.stdout(Stdio::piped()).stderr(output);
        let mut child = Command::from(command)
            .kill_on_drop(true)
            .spawn()
            .map_err(fault)?;
        let lifeline = child.stdin.take();
        Ok(Self {
            name: name.to_owned(),
            child,
            lifeline,
            log,
            end_patience,
            is_killed_by_fault: false,
        })
    }

    /// Kills the process as a fault of the scenario.
    async fn kill_by_fault(&mut self) -> Result<(), WorldError> {
        self.is_killed_by_fault = true;
        let killed = self.child.kill().await;
        killed.map_err(|source| WorldError::Spawn {
            name: self.name.clone(),
            source,
        })
    }

    /// Suspends the process as a fault of the scenario, or resumes it.
    fn suspend(&self, is_suspended: bool) -> Result<(), WorldError> {
        if self.is_killed_by_fault {
            return Ok(());
        }
        let number = self.child.id().unwrap_or_default();
        process::suspend(number, is_suspended).map_err(|source| WorldError::Spawn {
            name: self.name.clone(),
            source,
        })
    }

    /// Waits for the process to end before the request to stop; returns the error for it. A process that a fault killed has not
    /// ended early.
    async fn early_end(&mut self) -> WorldError {
        if self.is_killed_by_fault {
            return std::future::pending().await;
        }
        match self.child.wait().await {
            Ok(status) => self.failure(status, " in the middle of the run"),
            Err(source) => WorldError::Spawn {
                name: self.name.clone(),
                source,
            },
        }
    }

    /// Asks the node for its safe state and waits for its end; returns the node's report, also after a bad end.
    async fn stop(&mut self) -> (String, Result<(), WorldError>) {
        if self.is_killed_by_fault {
            self.lifeline = None;
            return (String::new(), Ok(()));
        }
        let when = match self.child.try_wait() {
            Ok(Some(_)) => " in the middle of the run",
            _ => " when it was to stop",
        };
        self.lifeline = None;
        let ended = self.end(when).await;
        let report = match &ended {
            Err(WorldError::NoStop { .. }) => String::new(),
            _ => self.report().await,
        };
        (report, ended)
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// If it does not end in time, or ends badly.
    async fn end(&mut self, when: &str) -> Result<(), WorldError> {
        // It may still be suspended; an ended process is reported below.
        let _ = self.suspend(false);
        match timeout(self.end_patience, self.child.wait()).await {
            Ok(Ok(status)) if status.success() => {
                self.remove_empty_log();
                Ok(())
            }
            Ok(Ok(status)) => Err(self.failure(status, when)),
            Ok(Err(source)) => Err(WorldError::Spawn {
                name: self.name.clone(),
                source,
            }),
            Err(_) => {
                // Already late, so a failed kill does not matter any more.
                let _ = self.child.kill().await;
                Err(WorldError::NoStop {
                    name: self.name.clone(),
                    patience: self.end_patience,
                })
            }
        }
    }

    /// Returns the report. It is one line, so that it fits the pipe and the node never waits for its reader.
    async fn report(&mut self) -> String {
        let mut text = String::new();
        if let Some(mut output) = self.child.stdout.take() {
            // Without a report the timing is not trusted; it has no other effect.
            let _ = output.read_to_string(&mut text).await;
        }
        text
    }

    fn failure(&self, status: ExitStatus, when: &str) -> WorldError {
        let log = self
            .log_tail()
            .map(|tail| format!("; the end of its log:\n{tail}"));
        let doing = doing(status);
        let how = match doing {
            Doing::NotSetUp => "cannot be set up".to_owned(),
            _ => how(status) + when,
        };
        WorldError::Process {
            name: self.name.clone(),
            how,
            log: log.unwrap_or_default(),
            doing,
        }
    }

    fn log_tail(&self) -> Option<String> {
        let bytes = fs::read(&self.log).ok()?;
        let text = String::from_utf8_lossy(&bytes[bytes.len().saturating_sub(LOG_TAIL_BYTES)..])
            .into_owned();
        let lines: Vec<&str> = text.lines().collect();
        let tail = &lines[lines.len().saturating_sub(LOG_TAIL_LINES)..];
        (!tail.is_empty()).then(|| indented(&tail.join("\n")))
    }

    /// Removes the log of a node if it is empty.
    fn remove_empty_log(&self) {
        let is_empty = fs::metadata(&self.log).is_ok_and(|metadata| metadata.len() == 0);
        let removed = if is_empty {
            fs::remove_file(&self.log)
        } else {
            Ok(())
        };
        // A remaining empty file does no harm.
        let _: io::Result<()> = removed;
    }
}

/// Attributes an end by the exit codes of `canrig node`.
fn doing(status: ExitStatus) -> Doing {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(NOT_SET_UP), _) => Doing::NotSetUp,
        (Some(BUS_FAILED), _) => Doing::FromOutside,
        (Some(INTERNAL), _) => Doing::Crashed,
        (None, Some(signal)) if process::is_crash(signal) => Doing::Crashed,
        (None, _) => Doing::FromOutside,
        (Some(_), _) => Doing::GaveUp,
    }
}

fn how(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(signal)) => format!("was killed by signal {signal}"),
        (None, None) => "ended".to_owned(),
    }
}
