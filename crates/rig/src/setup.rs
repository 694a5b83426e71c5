//! What is played, and what then is known of the bus: the scenario with its file, the rig, and what the frames mean.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::Database;
use dbc::loops::LoopPlace;
use scenario::fault::FaultWindow;
use scenario::loops::Contour;
use scenario::wiring::IoOutput;
use scenario::{Scenario, ScenarioError, Texts};

use crate::catalogue::{Catalogue, Frames};
use crate::external::{External, ExternalNode};
use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;

/// Names of the nodes where no rig gives others.
const CONTROLLER: &str = "controller";
const DRIVE: &str = "drive";
const DISTURBANCE: &str = "disturbance";

/// One of several loops.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct LoopName {
    /// Its name.
    pub name: String,
    /// The plant that it moves.
    pub plant: String,
}

/// What a rig calls the nodes of a loop.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeNames {
    /// The controller, which leads all loops.
    pub controller: String,
    /// Its drive.
    pub drive: String,
    /// The module that acts on its plant, where there is one.
    pub disturbance: Option<String>,
}

/// A scenario and what is known before it is played. Those of one plant, law and rig share what the frames mean.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The scenario's file; empty where it lies nowhere.
    pub path: PathBuf,
    /// The file's text.
    pub text: String,
    /// The texts of the tables that it names, by these names.
    pub tables: BTreeMap<String, String>,
    /// Its meaning.
    pub scenario: Scenario,
    /// Which of several loops it is; none for the only one.
    pub loop_name: Option<LoopName>,
    /// What the rig calls its nodes; none in a scenario of schema 1.
    pub nodes: Option<NodeNames>,
    /// What the rig calls the nodes of each loop on the bus, by the loop's name; nothing where it is the only one.
    pub nodes_of_loops: Arc<BTreeMap<String, NodeNames>>,
    /// What is expected of it together with other loops.
    pub contours: Arc<Vec<Contour>>,
    /// Where its nodes are on the bus.
    pub place: LoopPlace,
    /// What goes wrong on purpose in the other loops, which may take the current from this one too.
    pub faults_elsewhere: Vec<FaultWindow>,
    /// Which nodes are not canrig's when it is played.
    pub external: External,
    /// The rig that it is played on; none for the emulated one.
    pub rig: Option<Arc<LoadedRig>>,
    /// What the frames of the bus mean.
    pub database: Arc<Database>,
    frames: Arc<Frames>,
}

impl Setup {
    /// Reads and checks a scenario file.
    ///
    /// # Errors
    /// The file cannot be read or is no valid scenario.
    pub fn load(path: &Path, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        let objections = |scenario: &Scenario| catalogue.objections(scenario);
        let (scenario, texts) = Scenario::load_with_text(path, objections)?;
        Ok(Self::new(scenario, catalogue).with_texts(path, texts))
    }

    /// Checks the text of a scenario; the tables that it names lie beside `path`.
    ///
    /// # Errors
    /// It is no valid scenario.
    pub fn parse(path: &Path, text: String, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        let objections = |scenario: &Scenario| catalogue.objections(scenario);
        let (scenario, texts) = Scenario::parse_beside(path, text, objections)?;
        Ok(Self::new(scenario, catalogue).with_texts(path, texts))
    }

    /// Reads the scenario of a recording whose frames mean what the database says. Plant and law need not be known here.
    ///
    /// # Errors
    /// The file cannot be read or is no valid scenario.
    pub fn load_recorded(path: &Path, database: Arc<Database>) -> Result<Self, ScenarioError> {
        let frames = Arc::new(Frames::from_database(database));
        let objections = |scenario: &Scenario| SignalNames::objections(scenario, || frames.names());
        let (scenario, texts) = Scenario::load_recorded(path, objections)?;
        Ok(Self::with_frames(scenario, frames).with_texts(path, texts))
    }

    /// A scenario that lies in no file.
    #[must_use]
    pub fn new(scenario: Scenario, catalogue: &Catalogue) -> Self {
        let frames = catalogue.frames(&scenario);
        Self::with_frames(scenario, frames)
    }

    /// A rig with a drive of its own, on which nothing is tried.
    #[must_use]
    pub fn of_rig(rig: LoadedRig) -> Self {
        let text = "schema = 1\nname = \"a rig\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let no_table = |_: &str| Err(io::ErrorKind::NotFound.into());
        let scenario = Scenario::parse(text, "a rig", no_table);
        let scenario = scenario.expect("this scenario is valid");
        let frames = Arc::new(Frames::from_database(Arc::clone(&rig.database)));
        let external = External::default().with_drive();
        Self::with_frames(scenario, frames).recorded_on(Some(Arc::new(rig)), external)
    }

    fn with_frames(scenario: Scenario, frames: Arc<Frames>) -> Self {
        Self {
            path: PathBuf::new(),
            text: String::new(),
            tables: BTreeMap::new(),
            scenario,
            loop_name: None,
            nodes: None,
            nodes_of_loops: Arc::default(),
            contours: Arc::default(),
            place: LoopPlace::SHIPPED,
            faults_elsewhere: Vec::new(),
            external: External::default(),
            rig: None,
            database: Arc::clone(&frames.database),
            frames,
        }
    }

    /// The same as read from a file with this text.
    #[must_use]
    pub fn from_file(self, path: impl Into<PathBuf>, text: String) -> Self {
        Self {
            path: path.into(),
            text,
            ..self
        }
    }

    pub(crate) fn with_texts(self, path: &Path, texts: Texts) -> Self {
        Self {
            tables: texts.tables,
            ..self.from_file(path, texts.scenario)
        }
    }

    /// One of several loops of a recording, whose frames mean what the database says.
    pub(crate) fn of_recording(scenario: Scenario, database: Database) -> Self {
        Self::with_frames(
            scenario,
            Arc::new(Frames::from_database(Arc::new(database))),
        )
    }

    /// The same with another scenario of the same plant and law, which lies in no file.
    pub(crate) fn varied(&self, scenario: Scenario, contours: Arc<Vec<Contour>>) -> Self {
        Self {
            path: PathBuf::new(),
            text: String::new(),
            tables: BTreeMap::new(),
            scenario,
            loop_name: self.loop_name.clone(),
            nodes: self.nodes.clone(),
            nodes_of_loops: Arc::clone(&self.nodes_of_loops),
            contours,
            place: self.place,
            external: self.external.clone(),
            faults_elsewhere: Vec::new(),
            rig: self.rig.clone(),
            database: Arc::clone(&self.database),
            frames: Arc::clone(&self.frames),
        }
    }

    /// The same as a loop of a rig, whose nodes have these names, those of all loops among them; the only one has no name.
    pub(crate) fn of_loop(
        self,
        loop_name: Option<LoopName>,
        (nodes, nodes_of_loops): (NodeNames, Arc<BTreeMap<String, NodeNames>>),
        place: LoopPlace,
        contours: Arc<Vec<Contour>>,
    ) -> Self {
        Self {
            loop_name,
            nodes: Some(nodes),
            nodes_of_loops,
            place,
            contours,
            ..self
        }
    }

    /// The same with frames that mean something else.
    #[must_use]
    pub fn with_database(self, database: Arc<Database>) -> Self {
        Self { database, ..self }
    }

    /// The same with somebody else's nodes, on a rig, whose bus takes the place of the scenario's.
    #[must_use]
    pub fn on(self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        // Its nodes may be elsewhere on the bus than those of the shipped rig.
        if rig.is_none() && external.is_empty() {
            return self.recorded_on(rig, external);
        }
        let database = self.frames.database_with(rig.as_deref(), &external);
        self.recorded_on(rig, external).with_database(database)
    }

    /// As [`Setup::on`], for a recording that says by itself what its frames mean.
    #[must_use]
    pub fn recorded_on(mut self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        if let Some(rig) = &rig {
            self.scenario.bus = rig.file.bus.of_scenario();
        }
        Self {
            external,
            rig,
            ..self
        }
    }

    /// The same among loops in which this goes wrong on purpose.
    pub(crate) fn beside_faults(self, faults_elsewhere: Vec<FaultWindow>) -> Self {
        Self {
            faults_elsewhere,
            ..self
        }
    }

    /// What goes wrong on purpose, in this loop or another one.
    #[must_use]
    pub fn faults(&self) -> Vec<FaultWindow> {
        let own = self.scenario.fault.windows();
        let elsewhere = self.faults_elsewhere.iter().cloned();
        own.into_iter().chain(elsewhere).collect()
    }

    /// What stands before the names of its signals and metrics: nothing where it is the only loop.
    #[must_use]
    pub fn prefix(&self) -> String {
        let names = self.loop_name.as_ref();
        names.map_or_else(String::new, |names| format!("{}.", names.name))
    }

    /// What people call its controller, its drive and, where there is one, the module that acts on its plant.
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
