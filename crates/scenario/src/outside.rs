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

/// Tables from outside that a reader of a scenario admits, each with its section.
pub(crate) struct Outside {
    tables: Vec<(Section, String)>,
    /// Whether they are those of a recording. Their plants and laws need not be known here: the recording holds their effects, so
    /// the content of these tables is not read.
    is_recorded: bool,
}

impl Outside {
    /// Returns the tables that a document may have when it is read for a purpose.
    pub(crate) fn of(reading: Reading, document: &Document<'_>) -> Self {
        match reading {
            Reading::Recorded => Self::recorded(document.root()),
            Reading::ToPlay | Reading::Case => Self::registered(),
        }
    }

    /// Returns the tables of the plants and laws that are registered here.
    pub(crate) fn registered() -> Self {
        let named = |section| {
            custom::tables(section)
                .iter()
                .map(move |one| (section, one.name))
        };
        let tables = Section::ALL.into_iter().flat_map(named);
        Self {
            tables: tables
                .map(|(section, name)| (section, name.to_owned()))
                .collect(),
            is_recorded: false,
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
        Self {
            tables: unknown
                .map(|(section, name)| (section, name.to_owned()))
                .collect(),
            is_recorded: true,
        }
    }

    /// Returns a schema with these tables; it has those that are registered.
    pub(crate) fn schema(&self, schema: &'static Value) -> Cow<'static, Value> {
        let mut schema = Cow::Borrowed(schema);
        for (section, name) in self.tables.iter().filter(|_| self.is_recorded) {
            let definition = match section {
                Section::Plant => "PlantModel",
                Section::Controller => "Controller",
            };
            // A schema without keywords admits everything.
            schema.to_mut()["definitions"][definition]["properties"][name] = json!({});
        }
        schema
    }

    /// Returns the names of a section's tables.
    pub(crate) fn names(&self, section: Section) -> impl Iterator<Item = &str> {
        let tables = self
            .tables
            .iter()
            .filter(move |(place, _)| *place == section);
        tables.map(|(_, name)| name.as_str())
    }

    /// Checks a table of a section.
    pub(crate) fn check(
        &self,
        section: Section,
        name: &str,
        table: Spanned<DeValue<'_>>,
    ) -> Result<(), toml::de::Error> {
        let registered = custom::tables(section).iter();
        let mut known = registered.filter(|custom| custom.name == name && !self.is_recorded);
        known.next().map_or(Ok(()), |custom| (custom.check)(table))
    }

    /// Removes the tables from a document, since no type of the format has a field for them: the laws of a scenario, and the
    /// models of a rig file's plants.
    pub(crate) fn remove_from(&self, root: &mut DeTable<'_>) {
        for (section, name) in &self.tables {
            let Some(DeValue::Table(tables)) = root.get_mut(section.key()).map(Spanned::get_mut)
            else {
                continue;
            };
            if *section == Section::Controller {
                tables.remove(name.as_str());
                continue;
            }
            for (_, models) in tables.iter_mut() {
                if let DeValue::Table(models) = models.get_mut() {
                    models.remove(name.as_str());
                }
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
