//! The `[fault]` table as a whole.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::amplifier::AmplifierFaults;
use super::bus::BusFaults;
use super::node::NodeFaults;
use super::plant::PlantFaults;
use super::sensor::SensorFaults;

/// Injected faults, by where they act. Each kind says where it acts and whether `bus.log` shows it.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Faults of the bus; in virtual time on the modelled bus only.
    #[serde(skip_serializing_if = "BusFaults::is_empty")]
    pub bus: BusFaults,
    /// Faults of the drive's node or of the controller.
    #[serde(skip_serializing_if = "NodeFaults::is_empty")]
    pub node: NodeFaults,
    /// Faults of the position sensor: before the drive, so `bus.log` shows the wrong position as the drive sends it.
    #[serde(skip_serializing_if = "SensorFaults::is_empty")]
    pub sensor: SensorFaults,
    /// Faults of the current amplifier: behind the drive; `bus.log` shows the current that really flows.
    #[serde(skip_serializing_if = "AmplifierFaults::is_empty")]
    pub amplifier: AmplifierFaults,
    /// Faults of wire and mechanics; `bus.log` shows their consequences only.
    #[serde(skip_serializing_if = "PlantFaults::is_empty")]
    pub plant: PlantFaults,
}
