//! Plants and control laws from outside: their tables lie beside the shipped ones, under other names.
//!
//! They are registered once, before anything is read; from then on schema and loader know them as they know the shipped ones.

use std::any::Any;
use std::sync::OnceLock;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

use crate::null::TakeNullAway;

/// Parameters of a plant or a law, into which a scenario's table is read and by which it is described. The schema gives types and
/// ranges, `serde(default)` the defaults; `serde(deny_unknown_fields)` refuses other keys.
pub trait Parameters: DeserializeOwned + JsonSchema + 'static {}

impl<T: DeserializeOwned + JsonSchema + 'static> Parameters for T {}

/// Returns the parameters of an empty table.
///
/// # Errors
/// One of them has no default.
pub fn defaults<P: Parameters>() -> Result<P, toml::de::Error> {
    toml::Table::new().try_into()
}

/// Applies a function to parameters: those of the table of their type among the format's, else of the table from outside, else
/// the defaults. A law or a plant has at most one of them.
///
/// # Errors
/// The table from outside has other parameters, or one of them has no default.
pub(crate) fn with_parameters<'a, P: Parameters, T>(
    tables: impl IntoIterator<Item = Option<&'a dyn Any>>,
    custom: Option<&Custom>,
    make: impl FnOnce(&P) -> T,
) -> Result<T, toml::de::Error> {
    let mut given = tables.into_iter().flatten();
    match given.find_map(|table| table.downcast_ref()) {
        Some(parameters) => Ok(make(parameters)),
        None => {
            let parameters = custom.map_or_else(defaults, Custom::parameters)?;
            Ok(make(&parameters))
        }
    }
}

/// Returns a table as one of any type.
pub(crate) fn any<T: Any>(table: &Option<T>) -> Option<&dyn Any> {
    table.as_ref().map(|table| table as &dyn Any)
}

/// Section of a file with tables from outside.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Section {
    /// Models of plants: `[plant.NAME.MODEL]` of a rig file.
    Plant,
    /// Laws: `[controller.LAW]` of a scenario.
    Controller,
}

impl Section {
    pub(crate) const ALL: [Self; 2] = [Self::Plant, Self::Controller];

    /// Checks whether the tables of the section are in the table of this name: the models of a plant in `[plant.NAME]`, the laws
    /// in `[controller]`.
    pub(crate) fn is_place(self, place: &str) -> bool {
        match self {
            Self::Plant => {
                let name = place.strip_prefix("[plant.");
                name.is_some_and(|name| !name.contains('.'))
            }
            Self::Controller => place == "[controller]",
        }
    }

    /// Returns the kind of its tables, for messages.
    pub(crate) const fn kind(self) -> &'static str {
        match self {
            Self::Plant => "plant model",
            Self::Controller => "control law",
        }
    }

    /// Returns its key in a scenario.
    pub(crate) const fn key(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }

    /// Returns the tables from outside, which are set once and for all.
    pub(crate) fn tables(self) -> &'static OnceLock<Vec<CustomTable>> {
        static PLANTS: OnceLock<Vec<CustomTable>> = OnceLock::new();
        static LAWS: OnceLock<Vec<CustomTable>> = OnceLock::new();
        match self {
            Self::Plant => &PLANTS,
            Self::Controller => &LAWS,
        }
    }
}

/// Table of a plant or a law from outside.
#[derive(Debug)]
pub struct CustomTable {
    pub(crate) name: &'static str,
    /// Faults of `[[fault.plant.…]]` that have a meaning for the plant.
    pub(crate) faults: &'static [&'static str],
    /// Number of drives of its loop that a law leads; `None` for a law that leads all loops.
    drives: Option<usize>,
    pub(crate) schema: Value,
    /// Checks a table by the type of the parameters.
    pub(crate) check: fn(Spanned<DeValue<'_>>) -> Result<(), toml::de::Error>,
}

impl CustomTable {
    /// Makes the table `name`, which holds these parameters.
    pub fn new<P: Parameters>(name: &'static str) -> Self {
        Self {
            name,
            faults: &[],
            drives: Some(1),
            schema: schema::<P>(),
            check: |value| P::deserialize(ValueDeserializer::from(value)).map(drop),
        }
    }

    /// Sets the faults that have a meaning for the plant.
    #[must_use]
    pub fn with_faults(self, faults: &'static [&'static str]) -> Self {
        Self { faults, ..self }
    }

    /// Sets the number of drives of its loop that a law leads; `None` for a law that leads all loops.
    #[must_use]
    pub fn leading(self, drives: Option<usize>) -> Self {
        Self { drives, ..self }
    }
}

/// Returns the JSON Schema of parameters. It has no definitions, since their names might be taken.
pub fn schema<P: Parameters>() -> Value {
    let mut settings = SchemaSettings::draft07().with_transform(TakeNullAway);
    settings.inline_subschemas = true;
    let mut schema: Value = settings.into_generator().into_root_schema_for::<P>().into();
    if let Some(schema) = schema.as_object_mut() {
        schema.remove("$schema");
    }
    schema
}

/// Lowest values of parameters, by their schema.
pub struct Minima(Value);

/// Parameter that makes no physical sense.
#[derive(Debug, thiserror::Error)]
#[error("{name} is {what}")]
pub struct WrongParameter {
    /// Key of the parameter.
    pub name: String,
    /// Value of the parameter, and requirement on it.
    pub what: String,
}

impl Minima {
    /// Returns the lowest values of parameters of this type.
    pub fn of<P: Parameters>() -> Self {
        Self(schema::<P>())
    }

    /// Checks the numbers of a table and of the tables in it.
    ///
    /// # Errors
    /// The first number that is too low.
    pub fn check(&self, parameters: &impl Serialize) -> Result<(), WrongParameter> {
        let table = toml::Table::try_from(parameters).expect("parameters come from a table");
        check_minima(&table, &self.0)
    }
}

fn check_minima(table: &toml::Table, schema: &Value) -> Result<(), WrongParameter> {
    table.iter().try_for_each(|(name, value)| {
        let property = &schema["properties"][name];
        let value = match value {
            toml::Value::Table(below) => return check_minima(below, property),
            toml::Value::Float(value) => *value,
            _ => return Ok(()),
        };
        let above = property["exclusiveMinimum"].as_f64();
        let lowest = above
            .or(property["minimum"].as_f64())
            .unwrap_or(f64::NEG_INFINITY);
        if value.is_finite() && value >= lowest && above != Some(value) {
            return Ok(());
        }
        let what = match above {
            Some(above) => format!("{value}, it must be above {above}"),
            None if lowest.is_finite() => format!("{value}, it must be {lowest} or above"),
            None => format!("{value}, it must be a finite number"),
        };
        let name = name.clone();
        Err(WrongParameter { name, what })
    })
}

/// Returns the tables of a section that come from outside.
fn tables(section: Section) -> &'static [CustomTable] {
    section.tables().get().map_or(&[], Vec::as_slice)
}

/// Returns the names of the tables of a section that come from outside.
pub(crate) fn names(section: Section) -> impl Iterator<Item = &'static str> {
    tables(section).iter().map(|table| table.name)
}

/// Returns a table from outside.
pub(crate) fn find(section: Section, name: &str) -> Option<&'static CustomTable> {
    tables(section).iter().find(|table| table.name == name)
}

/// Returns the faults of `[[fault.plant.…]]` that have a meaning for a plant from outside.
pub(crate) fn plant_faults(plant: &str) -> &'static [&'static str] {
    find(Section::Plant, plant).map_or(&[], |table| table.faults)
}

/// Returns the number of drives that a law from outside leads; `None` if it is not known, or if the law leads all loops.
pub(crate) fn drives_led_by(law: &str) -> Option<usize> {
    find(Section::Controller, law)?.drives
}

/// Checks whether a law from outside leads all loops.
pub(crate) fn leads_all(law: &str) -> bool {
    find(Section::Controller, law).is_some_and(|table| table.drives.is_none())
}

/// Lists the plants or laws among the keys of a section.
pub(crate) fn known<'a>(section: Section, keys: impl Iterator<Item = &'a str>) -> String {
    let names = Vec::from_iter(keys).join(", ");
    let page = match section {
        Section::Plant => "docs/your-plant.md",
        Section::Controller => "docs/your-law.md",
    };
    let kind = section.kind();
    format!(
        "known here: {names}; a {kind} of your own is known to the program of its crate only ({page})"
    )
}

/// Definitions of the schema that have the tables of a section.
pub(crate) const DEFINITIONS: [(Section, &str); 2] = [
    (Section::Plant, "PlantModel"),
    (Section::Controller, "Controller"),
];

/// Adds the tables from outside to a schema.
pub(crate) fn describe(schema: &mut Value) {
    for (section, definition) in DEFINITIONS {
        let properties = schema.pointer_mut(&format!("/definitions/{definition}/properties"));
        if let Some(properties) = properties.and_then(Value::as_object_mut) {
            let tables = tables(section).iter();
            properties.extend(tables.map(|table| (table.name.to_owned(), table.schema.clone())));
        }
    }
}

/// Reads a table under a name that the format does not have.
pub(crate) fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Custom>, D::Error> {
    let tables = toml::Table::deserialize(deserializer)?;
    Ok((!tables.is_empty()).then_some(Custom(tables)))
}

/// Table of a plant or a law from outside, as a scenario has it. Its parameters are checked, except in a recorded scenario.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Custom(toml::Table);

impl Custom {
    /// Returns the name of the plant or the law.
    pub fn name(&self) -> &str {
        self.0.keys().next().map_or("", String::as_str)
    }

    /// Returns the parameters.
    ///
    /// # Errors
    /// They belong to another plant or law.
    pub fn parameters<P: Parameters>(&self) -> Result<P, toml::de::Error> {
        let table = self.0.values().next().cloned();
        table
            .unwrap_or_else(|| toml::Table::new().into())
            .try_into()
    }
}
