//! The worlds that a scenario runs in. The nodes are the same in each; only what moves frames and time differs.

mod bus_model;
pub mod catalogue;
mod child;
mod choice;
mod coordinator;
pub mod disturbance_node;
pub mod line;
pub mod lockstep;
pub mod nodes;
pub mod preflight;
pub mod processes;
pub mod real_time;
mod strikes;
mod supervisor;

pub use choice::{BusChoice, RunBus, choose_bus};

use std::io;
use std::time::Duration;

use dbc::SignalMissing;

use crate::coordinator::CoordinatorError;
use recording::latency::Host;
use recording::run_folder::WriteError;

/// Names of the nodes, for messages and for the command line of their processes.
const CONTROLLER: &str = "controller";
const PLANT_EMULATOR: &str = "plant-emulator";
const BENCH: &str = "bench";

/// How long the nodes may take until the scenario begins, on the run's clock.
const START_PATIENCE: Duration = Duration::from_secs(15);
/// How long a node may take to its safe state, on the run's clock.
const STOP_PATIENCE: Duration = Duration::from_millis(500);

/// How a run ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The scenario was played to its end.
    Completed,
    /// The user stopped it.
    Interrupted,
}

/// What a world came to that did not fail.
pub struct Played {
    /// Whether it came to the scenario's end.
    pub end: End,
    /// What the host knows of the timing; none in virtual time.
    pub host: Option<Host>,
}

impl Played {
    /// In virtual time there is no timing.
    #[must_use]
    pub fn in_virtual_time(end: End) -> Self {
        Self { end, host: None }
    }
}

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
