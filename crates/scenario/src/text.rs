//! Plants and nominal models as TOML text.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::controller::NominalModel;
use crate::document::Document;
use crate::error::{Problem, Source};
use crate::load::{build, without_problems};
use crate::plant::Sma;
use crate::schema::schema_of;

static NOMINAL_MODEL_FILE: LazyLock<Value> = LazyLock::new(schema_of::<NominalModelFile>);

/// File with other values for the plant of a rig, as in a scenario. Its other tables are ignored.
#[derive(Deserialize, Serialize)]
struct PlantFile {
    #[serde(default)]
    plant: BTreeMap<String, Sma>,
}

/// File with the model of a law.
#[derive(Deserialize, JsonSchema, Serialize)]
#[serde(deny_unknown_fields)]
struct NominalModelFile {
    nominal_model: NominalModel,
}

impl NominalModel {
    /// Reads the model from the text of a file; `name` names it in problems.
    ///
    /// # Errors
    /// All problems of the text.
    pub(crate) fn from_file_text(name: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let document = Document::parse(Source::new(name, text), text)?;
        let (file, problems) =
            build::<NominalModelFile>(&document, "the file", &NOMINAL_MODEL_FILE)?;
        without_problems(problems, file.nominal_model)
    }

    /// Returns the text of a file with this model.
    ///
    /// # Errors
    /// A value has no form in TOML.
    pub fn to_file_text(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(&NominalModelFile {
            nominal_model: self.clone(),
        })
    }
}

impl Sma {
    /// Reads the actuator from the text of a file, if there is one, with the name of its plant.
    ///
    /// # Errors
    /// The text is not TOML, or the table describes no actuator.
    pub fn from_file_text(text: &str) -> Result<Option<(String, Self)>, toml::de::Error> {
        toml::from_str(text).map(|file: PlantFile| file.plant.into_iter().next())
    }

    /// Returns the text of a file with these values for a plant, as in a scenario.
    ///
    /// # Errors
    /// A value has no form in TOML.
    pub fn to_file_text(&self, plant: &str) -> Result<String, toml::ser::Error> {
        let plant = BTreeMap::from([(plant.to_owned(), self.clone())]);
        toml::to_string(&PlantFile { plant })
    }
}
