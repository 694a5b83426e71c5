//! Why a run failed.

use std::io;
use std::time::Duration;

use dbc::SignalMissing;
use recording::run_folder::WriteError;

use crate::coordinator::CoordinatorError;

/// How long the nodes may take until the scenario begins, on the run's clock.
pub(crate) const START_PATIENCE: Duration = Duration::from_secs(15);
/// How long a node may take to its safe state, on the run's clock.
pub(crate) const STOP_PATIENCE: Duration = Duration::from_millis(500);

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Virtual time cannot go on.
    #[error(transparent)]
    Coordinator(#[from] CoordinatorError),
    /// The scenario did not begin.
    #[error("the scenario did not begin within {} s: the drive never reported Operation Enabled", patience.as_secs())]
    NoStart {
        /// How long was waited.
        patience: Duration,
    },
    /// A node has no safe state in time.
    #[error("{name} did not reach its safe state within {} ms", STOP_PATIENCE.as_millis())]
    NoStop {
        /// Which node.
        name: &'static str,
    },
    /// A node cannot be built from the scenario.
    #[error("the {name} cannot be set up: {reason}")]
    Node {
        /// Which node.
        name: &'static str,
        /// Why.
        reason: String,
    },
    /// A process ended before its time.
    #[error("the {name} {how} in the middle of the run{log}")]
    Process {
        /// Which process.
        name: &'static str,
        /// How it ended.
        how: String,
        /// The end of its log, ready to print.
        log: String,
    },
    /// A process could not be started.
    #[error("the {name} cannot be started: {source}")]
    Spawn {
        /// Which process.
        name: &'static str,
        /// Why.
        source: io::Error,
    },
    /// The bus cannot be used.
    #[error(transparent)]
    Bus(#[from] platform::bus::BusError),
    /// No kernel CAN where it is demanded.
    #[error("--require-vcan: {0}")]
    NoKernelCan(String),
    /// No frame for some time in the middle of a run.
    #[error("the bus has been silent for {} s in the middle of the run: the controller sends no SYNC", silence.as_secs())]
    Silent {
        /// For how long.
        silence: Duration,
    },
    /// The private bus cannot be made.
    #[error("no private bus: {0}")]
    Private(#[from] platform::private_bus::PrivateBusError),
    /// The embedded bus cannot be made.
    #[error(transparent)]
    Hub(#[from] platform::hub::HubError),
    /// The bench's own node failed.
    #[error("the bench's own node failed: {0}")]
    Bench(platform::real_time::RunError),
    /// A limit of the rig was violated.
    #[error("canrig stopped the drive: {0}")]
    Violation(String),
    /// Somebody else leads on this bus.
    #[error("a second master: {0}")]
    SecondMaster(String),
    /// The bench cannot have the interface for itself.
    #[error(transparent)]
    Claim(platform::claim::ClaimError),
    /// A check before current may flow.
    #[error("the pre-flight fails: {name}: {found}")]
    Preflight {
        /// Which check.
        name: &'static str,
        /// What was found.
        found: String,
    },
    /// The DBC lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// The recording cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
