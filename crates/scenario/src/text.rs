//! Plants and nominal models as TOML text.

use std::sync::LazyLock;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::controller::NominalModel;
use crate::document::Document;
use crate::error::{Problem, Source};
use crate::load::{build, none_of};
use crate::outside::Outside;
use crate::plant::Plant;
use crate::schema::schema_of;

static NOMINAL_MODEL_FILE: LazyLock<Value> = LazyLock::new(schema_of::<NominalModelFile>);

/// A file that has a `[plant]` table: a scenario, or a file that identification wrote. Its other tables are ignored.
#[derive(Deserialize, Serialize)]
struct PlantFile {
    plant: Option<Plant>,
}

/// A file with the model of a law.
#[derive(Deserialize, JsonSchema, Serialize)]
#[serde(deny_unknown_fields)]
struct NominalModelFile {
    nominal_model: NominalModel,
}

impl NominalModel {
    /// The model of a file's text; `name` names it in problems.
    ///
    /// # Errors
    /// Everything that is wrong in the text.
    pub(crate) fn from_file_text(name: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let document = Document::parse(Source::new(name, text), text)?;
        let (file, problems) = build::<NominalModelFile>(
            &document,
            &Outside::Registered,
            "the file",
            &NOMINAL_MODEL_FILE,
        )?;
        none_of(problems, file.nominal_model)
    }

    /// The text of a file with this model.
    ///
    /// # Errors
    /// A value has no form in TOML.
    pub fn to_file_text(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(&NominalModelFile {
            nominal_model: self.clone(),
        })
    }
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
