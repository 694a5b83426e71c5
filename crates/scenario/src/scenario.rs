//! A scenario on its rig.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use crate::beside::Beside;
use crate::contour::Contour;
use crate::document::Document;
use crate::error::Source;
use crate::load::{RigText, is_scenario};
use crate::node::Nodes;
use crate::plant::PlantModel;
use crate::rig::nodes::Rig;
use crate::run::Run;
use crate::sweep::Sweep;
use crate::trial::Trial;
use crate::wiring::SharedWiring;

/// Scenario and the rig that it names, resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Facts that its loops share.
    pub shared: Shared,
    /// Nodes of the run.
    pub nodes: Nodes,
    /// Facts of the rig that its loops share, with its io nodes.
    pub wiring: Arc<SharedWiring>,
    /// Loops, in the order of their names.
    pub loops: Vec<Trial>,
    /// EDS of each external drive, by the drive's name.
    pub sheets: BTreeMap<String, String>,
    /// Place of the rig file.
    pub(crate) rig_path: PathBuf,
    /// Text of the rig file.
    pub(crate) rig_text: RigText,
}

impl Scenario {
    /// Returns the plants by name, their files in the folder of the rig file.
    pub fn plants(&self) -> impl Iterator<Item = (&str, PlantModel)> {
        let plants = self.shared.rig.plant.iter();
        plants.map(|(name, plant)| (name.as_str(), plant.beside(&self.rig_path)))
    }
}

/// Facts of a run that belong to no single loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shared {
    /// Locations of the scenario and of the files that it names; empty for a scenario without a file.
    pub beside: Beside,
    /// Text of the scenario's file, to the byte.
    pub text: String,
    /// Texts of the files that the scenario names, its rig among them, by these names.
    pub tables: BTreeMap<String, String>,
    /// Facts of the whole run.
    pub run: Arc<Run>,
    /// Rig with the scenario's values in it; an empty one if only a trial is known.
    pub rig: Arc<Rig>,
    /// Expectations of several loops together.
    pub contours: Vec<Contour>,
    /// Keys that `canrig sweep` varies to make many scenarios of this one; all other commands ignore them.
    pub sweep: Option<Sweep>,
    /// Whether the scenario has laws that are not used, since a program leads.
    pub has_unused_law: bool,
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
