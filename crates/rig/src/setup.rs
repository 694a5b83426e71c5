//! What is played, and what then is known of the bus: the scenario with its file, the rig, and what the frames mean.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::Database;
use scenario::{Scenario, ScenarioError};

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
        let (scenario, text) = Scenario::load_with_text(path, objections)?;
        Ok(Self::of(scenario, catalogue).from_file(path, text))
    }

    /// A scenario that lies in no file.
    #[must_use]
    pub fn of(scenario: Scenario, catalogue: &Catalogue) -> Self {
        let frames = catalogue.frames(&scenario);
        Self {
            path: PathBuf::new(),
            text: String::new(),
            scenario,
            external: External::default(),
            rig: None,
            database: Arc::clone(&frames.database),
            frames: Arc::clone(frames),
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

    /// The same with frames that mean something else.
    #[must_use]
    pub fn with_database(self, database: Arc<Database>) -> Self {
        Self { database, ..self }
    }

    /// The same with somebody else's nodes, on a rig, whose bus takes the place of the scenario's.
    #[must_use]
    pub fn on(mut self, rig: Option<Arc<LoadedRig>>, external: External) -> Self {
        let rig = rig.map(|rig| LoadedRig::led_by(rig, &self.frames.law_terms));
        if let Some(rig) = &rig {
            self.scenario.bus = rig.file.bus.of_scenario();
        }
        let database = match &rig {
            Some(rig) => Arc::clone(&rig.database),
            None => self.frames.database_with(&external),
        };
        Self {
            external,
            rig,
            database,
            ..self
        }
    }

    /// All names of all signals.
    #[must_use]
    pub fn names(&self) -> &SignalNames {
        self.frames.names()
    }
}
