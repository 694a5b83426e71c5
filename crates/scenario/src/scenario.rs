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

/// What a scenario and the rig that it names say, resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// The facts of the whole run.
    pub run: Arc<Run>,
    /// The rig, with the scenario's values in it.
    pub rig: Rig,
    /// The loops, in the order of their names.
    pub loops: Vec<Trial>,
    /// What is expected of several loops together.
    pub contours: Vec<Contour>,
    /// What `canrig sweep` varies, to make many scenarios of this one; all other commands ignore it.
    pub sweep: Option<Sweep>,
    /// The EDS of each drive that is somebody else's, by the drive's name.
    pub sheets: BTreeMap<String, String>,
    /// The programs that play nodes, by the names of these.
    pub programs: BTreeMap<String, NodeProgram>,
    /// Whether the scenario has laws that are left out, since a program leads.
    pub has_unused_law: bool,
    /// The copy of a rig that ships in a run folder: its name and its text.
    pub(crate) shipped_rig: Option<(String, String)>,
}

/// A program that plays a node.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeProgram {
    /// The program and its arguments.
    pub command: Vec<String>,
    /// The file that names it, by its name beside the scenario; empty for the scenario itself.
    pub named_in: String,
}

impl Scenario {
    /// Whether a text may be meant as a scenario: it has a key that no rig file has, or is not even TOML.
    #[must_use]
    pub fn may_be(text: &str) -> bool {
        match Document::parse(Source::new("", text), text) {
            Ok(document) => is_scenario(&document),
            Err(_) => true,
        }
    }
}
