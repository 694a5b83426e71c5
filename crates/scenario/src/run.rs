//! The facts of a run that belong to no single loop.

use serde::Deserialize;

use schemars::JsonSchema;

use crate::bus::Bus;
use crate::fault::Faults;

/// Facts that all loops of a run share.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// Short name of the scenario.
    pub name: String,
    /// Purpose of the scenario, and source of its limits.
    pub description: Option<String>,
    /// Requirements that the scenario as a whole tests, such as "REQ-12".
    pub requirements: Vec<String>,
    /// Seed of every random number.
    pub seed: u64,
    /// Length of the run from the first SYNC after Operation Enabled.
    pub duration_seconds: f64,
    /// Bit rate and cycle of the bus.
    pub bus: Bus,
    /// Faults of the run, each at its node; the nodes do not know of them.
    pub faults: Faults,
}

/// Keys of a scenario file that are not tables.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Header {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    #[serde(rename = "schema")]
    _schema: u32,
    /// Short name of the scenario.
    #[schemars(length(min = 1, max = 200))]
    name: String,
    /// Purpose of the scenario, and source of its limits.
    #[serde(default)]
    description: Option<String>,
    /// The requirements that the scenario as a whole tests, such as "REQ-12".
    #[serde(default)]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    requirements: Vec<String>,
    /// Seed of every random number in the run.
    #[serde(default)]
    #[schemars(range(min = 0, max = 9_007_199_254_740_991_u64))]
    seed: u64,
    /// Length of the run from the first SYNC after Operation Enabled.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    duration_seconds: f64,
}

impl Header {
    pub(crate) fn run(self, bus: Bus, faults: Faults) -> Run {
        // A length that is not positive is one problem; that events come after the end of the run is not a further one.
        let is_length = self.duration_seconds > 0.0;
        Run {
            name: self.name,
            description: self.description,
            requirements: self.requirements,
            seed: self.seed,
            duration_seconds: if is_length {
                self.duration_seconds
            } else {
                f64::INFINITY
            },
            bus,
            faults,
        }
    }
}
