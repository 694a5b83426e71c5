//! Tables of plants and laws from outside that a scenario may have.

use std::borrow::Cow;

use serde_json::{Value, json};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::controller;
use crate::custom::{self, Section, is_name};
use crate::document::Document;
use crate::load::Reading;
use crate::plant::MODELS;

/// Tables from outside that a reader of a scenario admits.
pub(crate) enum Outside {
    /// Tables of the plants and laws that are registered here.
    Registered,
    /// Tables of a recording. Their plants and laws need not be known here: the recording holds their effects, so the content of
    /// these tables is not read.
    Recorded(Vec<(Section, String)>),
}

impl Outside {
    /// Returns the tables that a document may have when it is read for a purpose.
    pub(crate) fn of(reading: Reading, document: &Document<'_>) -> Self {
        match reading {
            Reading::Recorded => Self::recorded(document.root()),
            Reading::ToPlay | Reading::Case | Reading::View => Self::Registered,
        }
    }

    /// Collects the tables of a recorded scenario or its rig: every law and every model of a plant that the format itself does not
    /// know.
    fn recorded(root: &DeTable<'_>) -> Self {
        let section = |section: Section| root.get(section.key()).into_iter().flat_map(tables);
        let laws = section(Section::Controller).map(|(law, _)| (Section::Controller, law));
        let models = section(Section::Plant).flat_map(|(_, plant)| tables(plant));
        let models = models.map(|(model, _)| (Section::Plant, model));
        let is_unknown = |(section, name): &(Section, &str)| {
            let is_known = match section {
                Section::Plant => MODELS.contains(name),
                Section::Controller => controller::is_built_in(name),
            };
            is_name(name) && !is_known
        };
        let unknown = laws.chain(models).filter(is_unknown);
        Self::Recorded(
            unknown
                .map(|(section, name)| (section, name.to_owned()))
                .collect(),
        )
    }

    /// Returns a schema with these tables.
    pub(crate) fn schema(&self, schema: &'static Value) -> Cow<'static, Value> {
        match self {
            Self::Recorded(tables) if !tables.is_empty() => {
                let mut schema = schema.clone();
                for (section, name) in tables {
                    let definition = match section {
                        Section::Plant => "PlantModel",
                        Section::Controller => "Controller",
                    };
                    // A schema without keywords admits everything.
                    schema["definitions"][definition]["properties"][name] = json!({});
                }
                Cow::Owned(schema)
            }
            Self::Registered | Self::Recorded(_) => Cow::Borrowed(schema),
        }
    }

    /// Returns the names of a section's tables.
    pub(crate) fn names(&self, section: Section) -> Vec<&str> {
        match self {
            Self::Registered => custom::tables(section)
                .iter()
                .map(|custom| custom.name)
                .collect(),
            Self::Recorded(tables) => {
                let in_section = tables.iter().filter(|(place, _)| *place == section);
                in_section.map(|(_, name)| name.as_str()).collect()
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
                let found = registered.find(|custom| custom.name == name);
                found.map_or(Ok(()), |custom| (custom.check)(table))
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

/// Returns the tables in a table.
fn tables<'a, 'text>(
    value: &'a Spanned<DeValue<'text>>,
) -> impl Iterator<Item = (&'a str, &'a Spanned<DeValue<'text>>)> {
    let entries = value.get_ref().as_table().into_iter().flatten();
    let tables = entries.filter(|(_, below)| below.get_ref().is_table());
    tables.map(|(name, below)| (name.get_ref().as_ref(), below))
}
