//! The facts of a run that belong to no single loop.

use serde::Deserialize;

use schemars::JsonSchema;

use crate::bus::Bus;
use crate::disturbance::Disturbance;
use crate::expect::Expect;
use crate::fault::Faults;
use crate::sweep::Sweep;

/// Facts that all loops of a run share: the keys of a scenario file that are not tables, the sweep, the bus, its limits,
/// the disturbances and the faults.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Version of the format; 1.
    #[schemars(range(min = 1, max = 1))]
    pub schema: u32,
    /// Short name of the scenario.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Purpose of the scenario, and source of its limits.
    #[serde(default)]
    pub description: Option<String>,
    /// The requirements that the scenario as a whole tests, such as "REQ-12".
    #[serde(default)]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Vec<String>,
    /// Seed of every random number in the run.
    #[serde(default)]
    #[schemars(range(min = 0, max = 9_007_199_254_740_991_u64))]
    pub seed: u64,
    /// Length of the run from the first SYNC after Operation Enabled.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub duration_seconds: f64,
    /// Disturbances of the plant.
    #[serde(default)]
    pub disturbance: Disturbance,
    /// Limits on the bus and on the timing of the nodes.
    #[serde(default)]
    pub expect: Expect,
    #[serde(default)]
    pub(crate) sweep: Option<Sweep>,
    /// Bit rate and cycle of the bus, put in by the loader.
    #[serde(skip)]
    pub bus: Bus,
    /// Faults of the run, each at its node, put in by the loader; the nodes do not know of them.
    #[serde(skip)]
    pub faults: Faults,
}
