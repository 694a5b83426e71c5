//! Expectations of several loops together.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::expect::{ExpectedRow, Limit, Requirements};
use dbc::{Quantities, Unit};

/// Keys of a contour's limits.
pub(crate) const LIMITS: [&str; 2] = ["contour_error_{unit}_max", "contour_error_{unit}_rms"];

/// Limits on the distance of several loops together from the path of their set-points.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Contour {
    /// The loops, each an axis.
    #[schemars(length(min = 2, max = 8))]
    pub loops: Vec<String>,
    /// Start of the window.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// End of the window; the end of the scenario if absent.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// Longest distance from the path.
    #[serde(rename = "contour_error_{unit}_max")]
    pub error_max: Option<Limit>,
    /// RMS of the distance from the path.
    #[serde(rename = "contour_error_{unit}_rms")]
    pub error_rms: Option<Limit>,
    /// Unit of the loops, put in by the loader.
    #[serde(skip)]
    pub unit: Unit,
    /// Requirements that these limits test.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Requirements,
}

impl Contour {
    /// Returns the rows of the verdict: the longest distance from the path, and its RMS.
    pub fn rows(&self) -> [ExpectedRow; 2] {
        let name = self.loops.join("_");
        let quantities = Quantities::of_position(self.unit.clone());
        let row = |(key, limit)| ExpectedRow {
            name: format!("{name}.{}", quantities.name(key)),
            limit,
            requirements: self.requirements.clone(),
        };
        let [max, rms] = LIMITS;
        [(max, self.error_max), (rms, self.error_rms)].map(row)
    }
}

/// Contours of a scenario.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Contours {
    #[serde(default)]
    #[schemars(length(max = 100))]
    pub(crate) contour: Vec<Contour>,
}
