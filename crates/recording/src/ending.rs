//! Who ended a run before its scenario's end, and why.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Who ended it.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndedBy {
    /// A node under test: it was silent, gave up, crashed or violated a limit of the rig.
    Node,
    /// A part of canrig, or the bus.
    Bench,
    /// Ctrl-C.
    User,
}

/// The end of a run that did not come to its scenario's end, as `verdict.json` holds it.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct EarlyEnd {
    pub by: EndedBy,
    /// Which node; none where the bench or the user ended it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// Since when something was amiss, in scenario time; where the scenario never began, in that of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_seconds: Option<f64>,
    /// When the run ended for it, in the same time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_seconds: Option<f64>,
    /// What happened.
    pub what: String,
}

impl EarlyEnd {
    /// The bench's or the user's end.
    #[must_use]
    pub fn without_node(by: EndedBy, what: impl Into<String>) -> Self {
        Self {
            by,
            node: None,
            since_seconds: None,
            at_seconds: None,
            what: what.into(),
        }
    }
}

/// `controller: silent since 3.012 s`
impl fmt::Display for EarlyEnd {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.node {
            Some(node) => write!(formatter, "{node}: {}", self.what),
            None => formatter.write_str(&self.what),
        }
    }
}
