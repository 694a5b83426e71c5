//! Plants and control laws from outside: their tables stand beside the shipped ones, each under its own name.
//!
//! They are registered once, before anything is read; from then on schema and loader know them as they know the shipped ones.

use std::sync::OnceLock;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

use crate::null::TakeNullAway;

/// Longest name.
const NAME_CHARACTERS_MAX: usize = 64;

/// What a plant's or a law's parameters must be: what a scenario's table is read into, and described by. The schema gives
/// types and ranges, `serde(default)` the defaults, `serde(deny_unknown_fields)` what does not belong there.
pub trait Parameters: DeserializeOwned + JsonSchema + 'static {}

impl<T: DeserializeOwned + JsonSchema + 'static> Parameters for T {}

/// The parameters that an empty table stands for.
///
/// # Errors
/// One of them has no default.
pub fn defaults<P: Parameters>() -> Result<P, toml::de::Error> {
    toml::Table::new().try_into()
}

/// The tables of which a plant's or a law's own is one.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Section {
    /// Models of plants: `[plant.NAME.MODEL]` of a rig file.
    Plant,
    /// Laws: `[controller.LAW]` of a scenario.
    Controller,
}

impl Section {
    pub(crate) const ALL: [Self; 2] = [Self::Plant, Self::Controller];

    /// Whether its tables stand in the table at a place: the models of a plant in `[plant.NAME]`, the laws in `[controller]`.
    pub(crate) fn is_place(self, place: &str) -> bool {
        match self {
            Self::Plant => {
                let name = place.strip_prefix("[plant.");
                name.is_some_and(|name| !name.contains('.'))
            }
            Self::Controller => place == "[controller]",
        }
    }

    /// What the section chooses.
    pub(crate) const fn kind(self) -> &'static str {
        match self {
            Self::Plant => "plant model",
            Self::Controller => "control law",
        }
    }

    /// Its key in a scenario.
    pub(crate) const fn key(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }

    /// Sets the tables from outside for good; gives them back where that was done before.
    pub(crate) fn set_tables(self, tables: Vec<OwnTable>) -> Result<(), Vec<OwnTable>> {
        self.tables().set(tables)
    }

    fn tables(self) -> &'static OnceLock<Vec<OwnTable>> {
        static PLANTS: OnceLock<Vec<OwnTable>> = OnceLock::new();
        static LAWS: OnceLock<Vec<OwnTable>> = OnceLock::new();
        match self {
            Self::Plant => &PLANTS,
            Self::Controller => &LAWS,
        }
    }
}

/// The table of a plant or a law from outside.
#[derive(Debug)]
pub struct OwnTable {
    name: &'static str,
    /// Faults of `[[fault.plant.…]]` that mean something to the plant.
    faults: &'static [&'static str],
    /// Of a law: how many drives of its loop it leads; none for a law that leads all loops.
    drives: Option<usize>,
    schema: Value,
    check: fn(Spanned<DeValue<'_>>) -> Result<(), toml::de::Error>,
}

impl OwnTable {
    /// The table `name`, which holds these parameters.
    #[must_use]
    pub fn new<P: Parameters>(name: &'static str) -> Self {
        Self {
            name,
            faults: &[],
            drives: Some(1),
            schema: schema::<P>(),
            check: |value| P::deserialize(ValueDeserializer::from(value)).map(drop),
        }
    }

    /// The same for a plant to which these faults mean something.
    #[must_use]
    pub fn with_faults(self, faults: &'static [&'static str]) -> Self {
        Self { faults, ..self }
    }

    /// The same for a law that leads so many drives of its loop; `None` for one that leads all loops.
    #[must_use]
    pub fn leading(self, drives: Option<usize>) -> Self {
        Self { drives, ..self }
    }

    pub(crate) fn name(&self) -> &'static str {
        self.name
    }

    pub(crate) fn faults(&self) -> &'static [&'static str] {
        self.faults
    }

    pub(crate) fn schema(&self) -> &Value {
        &self.schema
    }

    /// What the parameters' own type finds wrong with a table.
    pub(crate) fn check(&self, table: Spanned<DeValue<'_>>) -> Result<(), toml::de::Error> {
        (self.check)(table)
    }
}

/// The JSON Schema of parameters, without definitions of its own, which may be called like one of ours.
#[must_use]
pub fn schema<P: Parameters>() -> Value {
    let mut settings = SchemaSettings::draft07().with_transform(TakeNullAway);
    settings.inline_subschemas = true;
    let mut schema: Value = settings.into_generator().into_root_schema_for::<P>().into();
    if let Some(schema) = schema.as_object_mut() {
        schema.remove("$schema");
    }
    schema
}

/// Whether a text can be the name of a table: small letters, digits and underscores, a letter first.
#[must_use]
pub fn is_name(text: &str) -> bool {
    let is_part = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
    text.len() <= NAME_CHARACTERS_MAX
        && text.starts_with(|first: char| first.is_ascii_lowercase())
        && text.bytes().all(is_part)
}

/// The tables of a section that come from outside.
pub(crate) fn tables(section: Section) -> &'static [OwnTable] {
    section.tables().get().map_or(&[], Vec::as_slice)
}

fn find(section: Section, name: &str) -> Option<&'static OwnTable> {
    tables(section).iter().find(|table| table.name == name)
}

/// The faults of `[[fault.plant.…]]` that mean something to a plant from outside.
pub(crate) fn faults_of(plant: &str) -> &'static [&'static str] {
    find(Section::Plant, plant).map_or(&[], |table| table.faults)
}

/// How many drives a law from outside leads; none where that is not known, or it leads all loops.
pub(crate) fn drives_led_by(law: &str) -> Option<usize> {
    find(Section::Controller, law)?.drives
}

/// Whether a law from outside leads all loops.
pub(crate) fn leads_all(law: &str) -> bool {
    find(Section::Controller, law).is_some_and(|table| table.drives.is_none())
}

/// Which plants or laws there are among the keys of a section, for people.
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

/// The schema of the table of a plant from outside.
pub(crate) fn schema_of_plant(name: &str) -> Value {
    find(Section::Plant, name).map_or_else(Value::default, |table| table.schema.clone())
}

/// Puts the tables of plants from outside among the properties of a schema.
pub(crate) fn describe_plants(properties: &mut Value) {
    let Some(properties) = properties.as_object_mut() else {
        return;
    };
    for table in tables(Section::Plant) {
        properties.insert(table.name.to_owned(), table.schema.clone());
    }
}

/// Puts the tables from outside into a schema.
pub(crate) fn describe(schema: &mut Value) {
    if let Some(models) = schema.pointer_mut("/definitions/PlantModel/properties") {
        describe_plants(models);
    }
    let laws = schema.pointer_mut("/definitions/Controller/properties");
    if let Some(laws) = laws.and_then(Value::as_object_mut) {
        for table in tables(Section::Controller) {
            laws.insert(table.name.to_owned(), table.schema.clone());
        }
    }
}

/// The table of a plant or a law from outside, as a scenario has it. Its parameters are checked, but for those of a recorded
/// scenario.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Own(toml::Table);

impl Own {
    /// What a scenario says of a plant or a law of this name.
    pub(crate) fn new(name: &str, parameters: toml::Table) -> Self {
        Self(toml::Table::from_iter([(
            name.to_owned(),
            parameters.into(),
        )]))
    }

    /// The name of the plant or the law.
    #[must_use]
    pub fn name(&self) -> &str {
        self.0.keys().next().map_or("", String::as_str)
    }

    /// The table, by its name.
    pub(crate) fn tables_mut(&mut self) -> &mut toml::Table {
        &mut self.0
    }

    /// The parameters.
    ///
    /// # Errors
    /// They are those of another plant or law.
    pub fn parameters<P: Parameters>(&self) -> Result<P, toml::de::Error> {
        let table = self.0.values().next().cloned();
        table
            .unwrap_or_else(|| toml::Table::new().into())
            .try_into()
    }
}
