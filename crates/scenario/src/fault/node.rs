//! Faults of nodes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lasting::faults;

/// A node that can fail.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Node {
    /// The controller, node 0x01.
    Controller,
    /// The drive, node 0x10; the actuator that it is wired to lives on.
    Drive,
}

impl Node {
    /// Its name in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Drive => "drive",
        }
    }

    /// Its number on the bus.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Controller => 0x01,
            Self::Drive => 0x10,
        }
    }
}

/// What flows through the wire while the drive is dead.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// The current stays: the amplifier keeps its last command.
    Hold,
    /// No current: the amplifier is switched off with its drive.
    #[default]
    Zero,
}

faults! {
    /// Faults of the drive's node or of the controller: how the node itself behaves, so `bus.log` shows what it still
    /// sends. Where a crash or hang of the controller meets a run in real time, it is a SIGKILL or SIGSTOP of its
    /// process; the other kinds are the same in all worlds.
    NodeFaults {
        /// The node is dead, as without power; where the fault ends it boots anew, without memory.
        crash: Crash {
            /// The node that fails.
            node: Node,
            /// What the drive's amplifier does meanwhile.
            #[serde(default)]
            output: Output,
        }
        /// The node does nothing; then it goes on as if no time had passed, with the first 32 of the frames that came
        /// meanwhile. The drive's amplifier keeps its current.
        hang: Hang {
            /// The node that fails.
            node: Node,
        }
        /// The node is slow: its frames leave it later.
        slow_cycle: SlowCycle {
            /// The node that fails.
            node: Node,
            /// How much later.
            #[schemars(range(min = 0.0, max = 1_000.0))]
            delay_milliseconds: f64,
        }
        /// The node's clock is fast (or slow, if negative).
        clock_drift: ClockDrift {
            /// The node that fails.
            node: Node,
            /// Drift of the clock.
            #[schemars(range(min = -500_000.0, max = 500_000.0))]
            parts_per_million: f64,
        }
        /// The node's heartbeats do not leave it.
        lost_heartbeat: LostHeartbeat {
            /// The node that fails.
            node: Node,
        }
    }
    plus {
        /// The node starts anew at once, without memory, as after a watchdog reset. The drive's current is 0 from then on.
        restart: Restart,
        /// Somebody on the bus orders the node to stop; `bus.log` shows the order.
        nmt_stop: NmtStop,
        /// The node boots late.
        late_boot: LateBoot,
        /// The drive is not the one of the controller's data sheet; the controller must refuse it.
        wrong_identity: WrongIdentity,
        /// The drive has another node-ID than the controller expects.
        wrong_node_id: WrongNodeId,
    }
}

/// The node starts anew at once, without memory, as after a watchdog reset.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Restart {
    /// When the node starts anew.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// The node that fails.
    pub node: Node,
}

/// Somebody on the bus orders the node to stop.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct NmtStop {
    /// When the order is sent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// The node that fails.
    pub node: Node,
}

/// The node boots late.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LateBoot {
    /// The node that fails.
    pub node: Node,
    /// How much later than the others it boots.
    #[schemars(range(min = 0.0, max = 60.0))]
    pub delay_seconds: f64,
}

/// The drive is not the one of the controller's data sheet.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct WrongIdentity {
    /// Its product code (0x1018:02).
    pub product_code: u32,
}

/// The drive has another node-ID than the controller expects.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct WrongNodeId {
    /// Its node-ID.
    #[schemars(range(min = 2, max = 127))]
    pub node_id: u8,
}
