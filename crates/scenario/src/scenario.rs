//! A scenario on its rig.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::contour::Contour;
use crate::document::Document;
use crate::error::Source;
use crate::load::is_scenario;
use crate::rig::nodes::Rig;
use crate::run::Run;
use crate::sweep::Sweep;
use crate::trial::Trial;

/// Scenario and the rig that it names, resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Facts of the whole run.
    pub run: Arc<Run>,
    /// Rig with the scenario's values in it.
    pub rig: Rig,
    /// Loops, in the order of their names.
    pub loops: Vec<Trial>,
    /// Expectations of several loops together.
    pub contours: Vec<Contour>,
    /// Keys that `canrig sweep` varies to make many scenarios of this one; all other commands ignore them.
    pub sweep: Option<Sweep>,
    /// EDS of each external drive, by the drive's name.
    pub sheets: BTreeMap<String, String>,
    /// Programs that play nodes, by the names of the nodes.
    pub programs: BTreeMap<String, NodeProgram>,
    /// Whether the scenario has laws that are not used, since a program leads.
    pub has_unused_law: bool,
}

/// Program that plays a node.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeProgram {
    /// Program and its arguments.
    pub command: Vec<String>,
    /// Name of the file that names the program, relative to the scenario; empty for the scenario itself.
    pub named_in: String,
}

impl Scenario {
    /// Checks whether a text may be meant as a scenario: it has a key that no rig file has, or is not even TOML.
    pub fn may_be(text: &str) -> bool {
        match Document::parse(Source::new("", text), text) {
            Ok(document) => is_scenario(&document),
            Err(_) => true,
        }
    }
}
