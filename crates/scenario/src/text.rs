//! Scenarios and plants as TOML text.

use serde::{Deserialize, Serialize};

use crate::plant::Plant;
use crate::scenario::Scenario;

/// A file that has a `[plant]` table: a scenario, or a file that identification wrote. Its other tables are ignored.
#[derive(Deserialize, Serialize)]
struct PlantFile {
    plant: Option<Plant>,
}

impl Plant {
    /// The `[plant]` table of a file's text, if there is one.
    ///
    /// # Errors
    /// The text is no TOML, or the table describes no plant.
    pub fn from_file_text(text: &str) -> Result<Option<Self>, toml::de::Error> {
        toml::from_str(text).map(|file: PlantFile| file.plant)
    }

    /// The text of a file with this plant only.
    ///
    /// # Errors
    /// A value has no form in TOML.
    pub fn to_file_text(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(&PlantFile {
            plant: Some(self.clone()),
        })
    }
}

impl Scenario {
    /// The text of a scenario file with these values.
    ///
    /// # Errors
    /// A value has no form in TOML.
    pub fn to_text(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}
