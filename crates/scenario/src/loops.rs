//! What is tried in each loop of a rig.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::expect::{Limit, Requirements};
use crate::port::Unit;
use crate::rig::nodes::Rig;

/// A scenario on a rig with several loops: for each of them one of one drive, as all that plays and judges a loop knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Loops<T> {
    /// The rig.
    pub rig: Rig,
    /// The loops, in the order of their names.
    pub loops: Vec<OneLoop<T>>,
    /// What is expected of several loops together.
    pub contours: Vec<Contour>,
    /// The EDS of each drive that is somebody else's, by the drive's name.
    pub sheets: BTreeMap<String, String>,
    /// The copy of a rig that ships in a run folder: its name and its text.
    pub(crate) shipped_rig: Option<(String, String)>,
}

/// How near several loops together stay to the path of their set-points.
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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// Longest distance from the path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contour_error_millimetres_max: Option<Limit>,
    /// RMS of the distance from the path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contour_error_millimetres_rms: Option<Limit>,
    /// The unit of its loops, put in by the loader.
    #[serde(skip)]
    pub unit: Unit,
    /// The requirements that these limits test.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Requirements,
}

impl Contour {
    /// Its rows of the verdict, each with its limit: of the longest distance from the path, and of its RMS.
    #[must_use]
    pub fn rows(&self) -> [(String, Option<Limit>); 2] {
        let name = self.loops.join("_");
        let row = |end| {
            let metric = format!("contour_error_millimetres_{end}");
            format!("{name}.{}", self.unit.rename(&metric))
        };
        [
            (row("max"), self.contour_error_millimetres_max),
            (row("rms"), self.contour_error_millimetres_rms),
        ]
    }
}

/// The contours of a scenario.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Contours {
    #[serde(default)]
    #[schemars(length(max = 100))]
    pub(crate) contour: Vec<Contour>,
}

/// One of the loops.
#[derive(Clone, Debug, PartialEq)]
pub struct OneLoop<T> {
    /// Its name.
    pub name: String,
    /// Where its nodes are on the bus.
    pub place: NodesOfLoop,
    /// What is tried: a [`crate::Scenario`], or what the controller may know of it.
    pub scenario: T,
}

/// The node-IDs of a loop.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct NodesOfLoop {
    /// Of its drive.
    pub drive: u8,
    /// Of the io node that acts on the drive's plant, where there is one.
    pub io: Option<u8>,
    /// The drive publishes the truth about its plant in every so many cycles.
    pub truth_every_cycles: u8,
}

impl Rig {
    /// Where the nodes of a loop are on the bus.
    ///
    /// # Panics
    /// The rig has no such loop.
    #[must_use]
    pub fn place(&self, name: &str) -> NodesOfLoop {
        let drive = &self.loops[name].drives[0];
        NodesOfLoop {
            drive: self.node[drive].node_id,
            io: self.io_of(drive).map(|(_, node)| node.node_id),
            truth_every_cycles: self.node[drive].truth_every_cycles.unwrap_or(1),
        }
    }
}
