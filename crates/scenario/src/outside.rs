//! Tables of plants and laws from outside that a scenario may have.

use std::borrow::Cow;

use serde_json::{Value, json};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::custom::{self, Section, is_name};
use crate::plant::MODELS;
use crate::schema;

/// Tables from outside that a reader of a scenario admits.
pub(crate) enum Outside {
    /// Tables of the plants and laws that are registered here.
    Registered,
    /// Tables of a recorded scenario. Their plants and laws need not be known here: the recording holds their effects, so the
    /// content of these tables is not read.
    Recorded(Vec<(Section, String)>),
}

impl Outside {
    /// Collects the tables of a recorded scenario: every law that the format itself does not know.
    pub(crate) fn from_recording(root: &DeTable<'_>) -> Self {
        let laws = root.get(Section::Controller.key());
        let laws = laws.and_then(|laws| laws.get_ref().as_table());
        let known = &schema::SHIPPED["definitions"]["Controller"]["properties"];
        let tables = laws
            .into_iter()
            .flat_map(DeTable::iter)
            .filter(|(_, value)| value.get_ref().is_table());
        let names = tables.map(|(key, _)| key.get_ref().as_ref());
        let unknown = names.filter(|name| is_name(name) && known.get(name).is_none());
        Self::Recorded(
            unknown
                .map(|name| (Section::Controller, name.to_owned()))
                .collect(),
        )
    }

    /// Collects the tables of the rig of a recording: every model of a plant that the format itself does not know.
    pub(crate) fn from_recorded_rig(root: &DeTable<'_>) -> Self {
        let plants = root.get(Section::Plant.key());
        let plants = plants.and_then(|plants| plants.get_ref().as_table());
        let models = plants.into_iter().flat_map(|plants| plants.values());
        let models = models.filter_map(|models| models.get_ref().as_table());
        let names = models
            .flat_map(|models| models.keys())
            .map(|name| name.get_ref().to_string());
        let unknown = names.filter(|name| is_name(name) && !MODELS.contains(&name.as_str()));
        Self::Recorded(unknown.map(|name| (Section::Plant, name)).collect())
    }

    /// Returns the schema for a rig file with these models.
    pub(crate) fn rig_schema(&self) -> Cow<'static, Value> {
        match self {
            Self::Registered => Cow::Borrowed(&schema::RIG),
            Self::Recorded(models) => {
                let mut schema = schema::RIG.clone();
                for (_, name) in models {
                    schema["definitions"]["PlantModel"]["properties"][name] = json!({});
                }
                Cow::Owned(schema)
            }
        }
    }

    /// Returns the names of a section's tables.
    pub(crate) fn names(&self, section: Section) -> Vec<&str> {
        match self {
            Self::Registered => custom::tables(section)
                .iter()
                .map(|custom| custom.name())
                .collect(),
            Self::Recorded(tables) => {
                let in_section = tables.iter().filter(|(place, _)| *place == section);
                in_section.map(|(_, name)| name.as_str()).collect()
            }
        }
    }

    /// Returns the schema for scenarios with these tables.
    pub(crate) fn schema(&self) -> Cow<'static, Value> {
        match self {
            Self::Registered => Cow::Borrowed(&schema::SECTIONS),
            Self::Recorded(tables) if tables.is_empty() => Cow::Borrowed(&schema::SHIPPED),
            Self::Recorded(tables) => {
                let mut schema = schema::SHIPPED.clone();
                for (_, name) in tables {
                    // A schema without keywords admits everything.
                    schema["definitions"]["Controller"]["properties"][name] = json!({});
                }
                Cow::Owned(schema)
            }
        }
    }

    /// Checks a table of a section.
    pub(crate) fn check(
        &self,
        section: Section,
        name: &str,
        table: Spanned<DeValue<'_>>,
    ) -> Result<(), toml::de::Error> {
        match self {
            Self::Registered => {
                let mut registered = custom::tables(section).iter();
                let found = registered.find(|custom| custom.name() == name);
                found.map_or(Ok(()), |custom| custom.check(table))
            }
            Self::Recorded(_) => Ok(()),
        }
    }

    /// Removes the tables from a document, since no type of the format has a field for them: the laws of a scenario, and the
    /// models of a rig file's plants.
    pub(crate) fn remove_from(&self, root: &mut DeTable<'_>) {
        if let Some(laws) = root.get_mut(Section::Controller.key()) {
            self.remove_names(Section::Controller, laws);
        }
        let plants = root.get_mut(Section::Plant.key()).map(Spanned::get_mut);
        if let Some(DeValue::Table(plants)) = plants {
            for (_, models) in plants.iter_mut() {
                self.remove_names(Section::Plant, models);
            }
        }
    }

    fn remove_names(&self, section: Section, tables: &mut Spanned<DeValue<'_>>) {
        if let DeValue::Table(tables) = tables.get_mut() {
            for name in self.names(section) {
                tables.remove(name);
            }
        }
    }
}
