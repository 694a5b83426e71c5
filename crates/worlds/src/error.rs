//! Errors of a run.

use std::fmt;
use std::io;
use std::time::Duration;

use dbc::SignalMissing;
use platform::lockstep::Failure;
use recording::run_folder::WriteError;

/// Longest time for the nodes until the scenario begins, on the run's clock.
pub(crate) const START_PATIENCE: Duration = Duration::from_secs(15);
/// Longest time for a node to reach its safe state, on the run's clock.
pub(crate) const STOP_PATIENCE: Duration = Duration::from_millis(500);

/// Attribution of the end of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// The node could not be set up, so the run did not begin.
    NotSetUp,
    /// The node ended itself, with its reason.
    GaveUp,
    /// The node's code crashed: a panic, a violation of memory.
    Crashed,
    /// Another process killed it, or the bus failed under it.
    FromOutside,
}

/// Reason why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Virtual time cannot continue without a participant.
    #[error("{name} {failure}")]
    Participant {
        /// Name of the participant.
        name: String,
        /// Reason.
        failure: Failure,
    },
    /// The scenario did not begin.
    #[error("the scenario did not begin within {} s: the drive never reported Operation Enabled", patience.as_secs())]
    NoStart {
        /// Time that was waited.
        patience: Duration,
    },
    /// A node did not reach a safe state in time.
    #[error("the {name} did not reach its safe state within {} ms", patience.as_millis())]
    NoStop {
        /// Name of the node.
        name: String,
        /// Time that was waited.
        patience: Duration,
    },
    /// The run cannot begin: a node cannot be set up, a process cannot be started, or a check before current may flow failed.
    #[error("{what}")]
    CannotBegin {
        /// Description.
        what: String,
        /// Error of the system, if that refused something.
        source: Option<io::Error>,
    },
    /// The system refuses an action on a process in the middle of a run, or at its end.
    #[error("the {name} cannot be {action}: {source}")]
    Control {
        /// Name of the process.
        name: String,
        /// Action, such as "awaited".
        action: &'static str,
        /// Error of the system.
        source: io::Error,
    },
    /// A process ended before its time, or badly.
    #[error("the {name} {how}{log}")]
    Process {
        /// Name of the process.
        name: String,
        /// Description of its end.
        how: String,
        /// End of its log, ready to print.
        log: String,
        /// Attribution of its end.
        doing: Doing,
    },
    /// The bus cannot be made or used.
    #[error(transparent)]
    Bus(#[from] platform::bus::BusError),
    /// Kernel CAN was required and is missing.
    #[error("--require-vcan: {0}")]
    NoKernelCan(String),
    /// A node was not heard for some time in the middle of a run.
    #[error("the {node} has been silent for {} s in the middle of the run", silence.as_secs_f64())]
    Silent {
        /// Name of the node.
        node: String,
        /// Length of the silence.
        silence: Duration,
    },
    /// The private bus cannot be made.
    #[error("no private bus: {0}")]
    Private(io::Error),
    /// The bench's own node failed.
    #[error("the bench's own node failed: {0}")]
    Bench(platform::real_time::RunError),
    /// A limit of the rig was violated.
    #[error("canrig stopped the {drive}: {violation}")]
    Violation {
        /// Name of the drive.
        drive: String,
        /// The limit, and the value that violated it.
        violation: String,
    },
    /// Another controller leads on this bus.
    #[error("a second master: {0}")]
    SecondMaster(String),
    /// The bench cannot claim the interface.
    #[error(transparent)]
    Claim(platform::claim::ClaimError),
    /// The DBC lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// The recording cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl WorldError {
    /// Returns a function for `map_err` that makes the error of a process or a thread that cannot be started before the run.
    pub(crate) fn spawn(name: &str) -> impl FnOnce(io::Error) -> Self + use<> {
        let name = name.to_owned();
        move |source| Self::CannotBegin {
            what: format!("the {name} cannot be started: {source}"),
            source: Some(source),
        }
    }

    /// Returns a function for `map_err` that makes the error of an action on a process after the run has begun.
    pub(crate) fn control(name: &str, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let name = name.to_owned();
        move |source| Self::Control {
            name,
            action,
            source,
        }
    }

    /// Makes the error of a node that cannot be set up.
    pub(crate) fn set_up(name: &str, reason: &dyn fmt::Display) -> Self {
        let what = format!("the {name} cannot be set up: {reason}");
        Self::CannotBegin { what, source: None }
    }

    /// Makes the error of a check of the pre-flight, with its finding.
    pub(crate) fn preflight(name: &str, found: &dyn fmt::Display) -> Self {
        let what = format!("the pre-flight fails: {name}: {found}");
        Self::CannotBegin { what, source: None }
    }

    /// Returns whether a process was killed, or the bus failed under it.
    pub(crate) fn is_from_outside(&self) -> bool {
        matches!(self, Self::Process { doing, .. } if *doing == Doing::FromOutside)
    }

    /// Returns whether the recording cannot be written.
    pub(crate) fn is_of_recording(&self) -> bool {
        matches!(self, Self::Write(_))
    }

    /// Returns whether the run never began: a program or a plant cannot be started, or a check before the run failed.
    pub fn is_before_start(&self) -> bool {
        match self {
            Self::CannotBegin { .. } => true,
            Self::Process { doing, .. } => *doing == Doing::NotSetUp,
            _ => false,
        }
    }
}
