//! Faults of the current amplifier.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lasting::faults;

faults! {
    /// Faults of the current amplifier. Where several act at a time, the dead one wins, then the one stuck on.
    AmplifierFaults {
        /// The amplifier gives less than its largest current.
        saturated: Saturated {
            /// Largest current that it gives.
            #[schemars(range(min = 0.0, max = 1.0))]
            current_amperes_max: f64,
        }
        /// A current flows whatever is commanded.
        stuck_on: StuckOn {
            /// Current that flows.
            #[schemars(range(min = 0.0, max = 1.0))]
            current_amperes: f64,
        }
        /// No current flows whatever is commanded.
        dead: Dead {}
    }
}
