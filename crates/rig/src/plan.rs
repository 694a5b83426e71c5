//! The plan of a run: its loops, and all that they share.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use dbc::Database;
use dbc::loops::LoopPlace;
use scenario::Bus;
use scenario::fault::{Fault, Faults};
use scenario::loops::Contour;
use scenario::sweep::Sweep;
use scenario::wiring::IoOutput;
use scenario::{Scenario, Texts};

use crate::catalogue::{Catalogue, Frames};
use crate::external::{External, ExternalNode};
use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;

mod load;

pub use load::{check_rig, may_name_rig};

/// Names of the nodes where no rig gives others.
const CONTROLLER: &str = "controller";
const DRIVE: &str = "drive";
const DISTURBANCE: &str = "disturbance";

/// A run: the loops of a scenario and all that they share. A single loop is a list of one.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The facts of the whole run.
    pub shared: Shared,
    /// The loops in the order of their names; at least one.
    pub loops: Vec<ControlLoop>,
}

/// The facts of a run that belong to no single loop.
#[derive(Clone, Debug)]
pub struct Shared {
    /// The scenario's file; empty where it lies nowhere.
    pub path: PathBuf,
    /// The file's text.
    pub text: String,
    /// The texts of the tables that the scenario names, by these names.
    pub tables: BTreeMap<String, String>,
    /// The scenario's name.
    pub name: String,
    /// The scenario's description.
    pub description: Option<String>,
    /// The requirements that the scenario as a whole tests.
    pub requirements: Vec<String>,
    /// Seed of every random number.
    pub seed: u64,
    /// Length of the run.
    pub duration_seconds: f64,
    /// Bit rate and cycle of the bus.
    pub bus: Bus,
    /// The faults of the run, each at its node.
    pub faults: Faults,
    /// The values that a sweep varies, where there is one.
    pub sweep: Option<Sweep>,
    /// Expectations of several loops together.
    pub contours: Vec<Contour>,
    /// The nodes of each loop by the loop's name; empty where there is only one.
    pub nodes_of_loops: BTreeMap<String, NodeNames>,
}

/// The name of one of several loops.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct LoopName {
    /// Its name.
    pub name: String,
    /// The plant that it moves.
    pub plant: String,
}

/// The names that a rig gives to the nodes of a loop.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeNames {
    /// The controller, which leads all loops.
    pub controller: String,
    /// Its drive.
    pub drive: String,
    /// The module that acts on its plant, where there is one.
    pub disturbance: Option<String>,
}

/// One of the two nodes that close a loop.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum LoopNode {
    /// The controller.
    Controller,
    /// The drive.
    Drive,
}

/// One loop of a plan. Loops of one plant, law and rig share the meaning of their frames.
#[derive(Clone, Debug)]
pub struct ControlLoop {
    /// The scenario as this loop sees it.
    pub scenario: Scenario,
    /// Its name among several; none for the only one.
    pub loop_name: Option<LoopName>,
    /// The rig's names of its nodes; none in a scenario of schema 1.
    pub nodes: Option<NodeNames>,
    /// The place of its nodes on the bus.
    pub place: LoopPlace,
    /// Its nodes that canrig does not play.
    pub external: External,
    /// The rig that it is played on; none for the emulated one.
    pub rig: Option<Arc<LoadedRig>>,
    /// The meaning of all frames on the bus.
    pub database: Arc<Database>,
    frames: Arc<Frames>,
}

impl Plan {
    /// The plan of a scenario of one loop that lies in no file.
    #[must_use]
    pub fn new(scenario: Scenario, catalogue: &Catalogue) -> Self {
        let frames = catalogue.frames(&scenario);
        Self::of_one(ControlLoop::with_frames(scenario, frames))
    }

    /// The plan of one loop.
    fn of_one(only: ControlLoop) -> Self {
        Self::of_loops(vec![only], Vec::new(), BTreeMap::new())
    }

    /// The plan of these loops, of which there is at least one.
    fn of_loops(
        loops: Vec<ControlLoop>,
        contours: Vec<Contour>,
        nodes_of_loops: BTreeMap<String, NodeNames>,
    ) -> Self {
        let scenario = &loops[0].scenario;
        let shared = Shared {
            path: PathBuf::new(),
            text: String::new(),
            tables: BTreeMap::new(),
            name: scenario.name.clone(),
            description: scenario.description.clone(),
            requirements: scenario.requirements.clone(),
            seed: scenario.seed,
            duration_seconds: scenario.duration_seconds,
            bus: scenario.bus.clone(),
            faults: scenario.faults.clone(),
            sweep: scenario.sweep.clone(),
            contours,
            nodes_of_loops,
        };
        Self { shared, loops }
    }

    /// The same, read from a file with this text.
    #[must_use]
    pub fn from_file(mut self, path: impl Into<PathBuf>, text: String) -> Self {
        self.shared.path = path.into();
        self.shared.text = text;
        self
    }

    fn with_texts(mut self, path: impl Into<PathBuf>, texts: Texts) -> Self {
        self.shared.tables = texts.tables;
        self.from_file(path, texts.scenario)
    }

    /// The same with each loop changed.
    fn map(mut self, change: impl FnMut(ControlLoop) -> ControlLoop) -> Self {
        self.loops = self.loops.into_iter().map(change).collect();
        self
    }

    /// The same with frames of another meaning.
    #[must_use]
    pub fn with_database(self, database: &Arc<Database>) -> Self {
        self.map(|one| one.with_database(Arc::clone(database)))
    }

    /// The same with nodes that are somebody else's, on a rig, whose bus takes the place of the scenario's.
    #[must_use]
    pub fn on(self, rig: Option<&Arc<LoadedRig>>, external: &External) -> Self {
        self.on_bus_of(rig)
            .map(|one| one.on(rig.cloned(), external.clone()))
    }

    /// As [`Plan::on`], for a recording that says by itself what its frames mean.
    #[must_use]
    pub fn recorded_on(self, rig: Option<&Arc<LoadedRig>>, external: &External) -> Self {
        self.on_bus_of(rig)
            .map(|one| one.recorded_on(rig.cloned(), external.clone()))
    }

    fn on_bus_of(mut self, rig: Option<&Arc<LoadedRig>>) -> Self {
        if let Some(rig) = rig {
            self.shared.bus = rig.file.bus.of_scenario();
        }
        self
    }

    /// The same with the limits of another plan; none where that has other loops.
    #[must_use]
    pub fn with_limits_of(mut self, other: &Self) -> Option<Self> {
        if !self
            .loops
            .iter()
            .map(ControlLoop::name)
            .eq(other.loops.iter().map(ControlLoop::name))
        {
            return None;
        }
        for (own, other) in self.loops.iter_mut().zip(&other.loops) {
            own.scenario.expect = other.scenario.expect.clone();
        }
        self.shared.contours.clone_from(&other.shared.contours);
        Some(self)
    }

    /// The names of the nodes that are somebody else's, each once.
    #[must_use]
    pub fn external_names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for name in self.loops.iter().flat_map(ControlLoop::external_names) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// The meaning of all frames on the bus, as a run folder stores it.
    #[must_use]
    pub fn database(&self) -> &Arc<Database> {
        &self.loops[0].database
    }

    /// The name of the controller, which leads all loops.
    #[must_use]
    pub fn controller_name(&self) -> &str {
        self.loops[0].node_names().0
    }

    /// The loop whose controller and law stand for all: those of the only loop, or of the first of several.
    #[must_use]
    pub fn leading(&self) -> &ControlLoop {
        &self.loops[0]
    }

    /// Length of the run.
    #[must_use]
    pub fn duration(&self) -> Duration {
        Duration::from_secs_f64(self.shared.duration_seconds)
    }

    /// Time between two SYNCs.
    #[must_use]
    pub fn sync_period(&self) -> Duration {
        self.shared.bus.sync_period()
    }

    /// Whether the scenario names its rig.
    #[must_use]
    pub fn names_rig(&self) -> bool {
        self.loops.iter().any(|one| one.nodes.is_some())
    }

    /// Whether anything goes wrong on purpose.
    #[must_use]
    pub fn has_faults(&self) -> bool {
        !self.shared.faults.is_empty()
    }
}

/// The beginning of the names of a loop's signals and metrics, by the loop's name.
#[must_use]
pub fn prefix_of(loop_name: &str) -> String {
    match loop_name {
        "" => String::new(),
        name => format!("{name}."),
    }
}

impl ControlLoop {
    fn with_frames(scenario: Scenario, frames: Arc<Frames>) -> Self {
        Self {
            scenario,
            loop_name: None,
            nodes: None,
            place: LoopPlace::SHIPPED,
            external: External::default(),
            rig: None,
            database: Arc::clone(&frames.database),
            frames,
        }
    }

    /// A loop of a recording, whose frames mean what the database says.
    fn of_recording(scenario: Scenario, database: Database) -> Self {
        let frames = Frames::from_database(Arc::new(database));
        Self::with_frames(scenario, Arc::new(frames))
    }

    /// The same with another scenario of the same plant and law.
    fn varied(&self, scenario: Scenario) -> Self {
        Self {
            scenario,
            ..self.clone()
        }
    }

    fn with_database(self, database: Arc<Database>) -> Self {
        Self { database, ..self }
    }

    fn on(self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        // Its nodes may be elsewhere on the bus than those of the shipped rig.
        if rig.is_none() && external.is_empty() {
            return self.recorded_on(rig, external);
        }
        let database = self.frames.database_with(rig.as_deref(), &external);
        self.recorded_on(rig, external).with_database(database)
    }

    fn recorded_on(mut self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        if let Some(rig) = &rig {
            self.scenario.bus = rig.file.bus.of_scenario();
        }
        Self {
            external,
            rig,
            ..self
        }
    }

    /// The faults of the whole run: those of other loops may take the current from this one too.
    pub fn faults(&self) -> impl Iterator<Item = &Fault> {
        self.scenario.faults.iter()
    }

    /// The name of one of several loops; empty for the only one.
    #[must_use]
    pub fn name(&self) -> &str {
        self.loop_name.as_ref().map_or("", |names| &names.name)
    }

    /// The beginning of the names of its signals and metrics: empty where it is the only loop.
    #[must_use]
    pub fn prefix(&self) -> String {
        prefix_of(self.name())
    }

    /// The names of its controller, its drive and, where there is one, the module that acts on its plant.
    #[must_use]
    pub fn node_names(&self) -> (&str, &str, Option<&str>) {
        match &self.nodes {
            Some(names) => (
                &names.controller,
                &names.drive,
                names.disturbance.as_deref(),
            ),
            None => (CONTROLLER, DRIVE, Some(DISTURBANCE)),
        }
    }

    /// The node-IDs of its drive and of the module that acts on its plant, where there is one.
    #[must_use]
    pub fn node_ids(&self) -> (u8, Option<u8>) {
        let (_, _, disturbance) = self.node_names();
        let (drive, module) = match &self.rig {
            Some(rig) => (rig.drive.node_id().get(), Some(rig.file.fan.node_id)),
            None => (self.place.drive_node_id, self.place.disturbance_node_id),
        };
        (drive, disturbance.and(module))
    }

    /// The names of its nodes that are somebody else's.
    #[must_use]
    pub fn external_names(&self) -> Vec<String> {
        let (controller, drive, disturbance) = self.node_names();
        let name = |node: ExternalNode| match (node, &self.nodes) {
            (_, None) => node.name(),
            (ExternalNode::Controller, _) => controller,
            (ExternalNode::Drive, _) => drive,
            (ExternalNode::Fan, _) => disturbance.unwrap_or_default(),
        };
        self.external
            .nodes()
            .map(|node| name(node).to_owned())
            .collect()
    }

    /// The outputs of the io node of its plant besides fan and load; none of a recording.
    #[must_use]
    pub fn io_outputs(&self) -> &[IoOutput] {
        &self.frames.outputs
    }

    /// All names of all signals.
    #[must_use]
    pub fn names(&self) -> &SignalNames {
        self.frames.names()
    }
}
