//! What is played, and what then is known of the bus: the scenario with its file, the rig, and what the frames mean.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::Database;
use scenario::{Scenario, ScenarioError, Texts};

use crate::catalogue::{Catalogue, Frames};
use crate::external::External;
use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;

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
        let frames = Arc::clone(catalogue.frames(&scenario));
        Self::with_frames(scenario, frames)
    }

    fn with_frames(scenario: Scenario, frames: Arc<Frames>) -> Self {
        Self {
            path: PathBuf::new(),
            text: String::new(),
            tables: BTreeMap::new(),
            scenario,
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

    fn with_texts(self, path: &Path, texts: Texts) -> Self {
        Self {
            tables: texts.tables,
            ..self.from_file(path, texts.scenario)
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

    /// All names of all signals.
    #[must_use]
    pub fn names(&self) -> &SignalNames {
        self.frames.names()
    }
}
