//! End of a run before its scenario's end, with its cause.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Cause of the end.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndedBy {
    /// A node under test: it was silent, gave up, crashed or violated a limit of the rig.
    Node,
    /// A part of canrig, or the bus.
    Bench,
    /// The user, by Ctrl-C.
    User,
}

/// End of a run before its scenario's end, as `verdict.json` holds it.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct EarlyEnd {
    pub by: EndedBy,
    /// Node that caused the end; `None` if the bench or the user ended it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// Time of the first sign of the cause, in scenario time, or in recording time if the scenario never began.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_seconds: Option<f64>,
    /// Time at which the run ended because of it, on the same clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_seconds: Option<f64>,
    /// Description of the cause.
    pub what: String,
    /// Whether a drive violated a limit of its rig.
    #[serde(default, skip_serializing_if = "is_false")]
    pub is_rig_limit: bool,
}

fn is_false(value: &bool) -> bool {
    !value
}

impl EarlyEnd {
    /// Makes an end by the bench or the user.
    pub fn without_node(by: EndedBy, what: impl Into<String>) -> Self {
        Self {
            by,
            node: None,
            since_seconds: None,
            at_seconds: None,
            what: what.into(),
            is_rig_limit: false,
        }
    }
}

/// Writes a text such as `controller: silent since 3.012 s`.
impl fmt::Display for EarlyEnd {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.node {
            Some(node) => write!(formatter, "{node}: {}", self.what),
            None => formatter.write_str(&self.what),
        }
    }
}
