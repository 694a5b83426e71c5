//! Faults of wire and mechanics.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lasting::{faults, one};

faults! {
    /// Faults of wire and mechanics.
    PlantFaults {
        /// The wire ages: its parameters move evenly from 1 to their factors while the fault lasts, and stay.
        ageing: Ageing {
            /// Factor on the electrical resistance.
            #[serde(default = "one")]
            #[schemars(range(min = 0.1, max = 10.0))]
            resistance_factor: f64,
            /// Factor on the recoverable strain.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            recoverable_strain_factor: f64,
        }
        /// The wire is broken: it carries neither load nor current.
        broken_wire: BrokenWire {}
        /// The pulley does not move.
        jammed_pulley: JammedPulley {}
        /// The load has come off; disturbances that add one do nothing.
        dropped_load: DroppedLoad {}
    }
}
