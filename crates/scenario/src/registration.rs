//! Registers plants and laws from outside, once and before anything is read.

use crate::controller::Controller;
use crate::custom::{CustomTable, Section, is_name};
use crate::fault::{Group, Kind};
use crate::plant::is_built_in;
use crate::schema::schema_of;

/// Reason why a plant or a law cannot be registered.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
pub enum InvalidRegistration {
    /// The name cannot be that of a table.
    #[error(
        "`{0}` cannot be the name of a table: a name has at most 64 small letters, digits and underscores, and begins with a letter"
    )]
    Name(String),
    /// The name is taken.
    #[error("[{}.{name}] is a table already: choose another name", section.key())]
    Taken {
        /// Section with the name.
        section: Section,
        /// Name that is taken.
        name: String,
    },
    /// The parameters are not a table.
    #[error("the parameters of `{0}` are no struct with named fields")]
    NoTable(&'static str),
    /// The fault does not exist.
    #[error("`{name}` names a fault `{fault}`, and there is no [[fault.plant.{fault}]]")]
    Fault {
        /// Name of the plant.
        name: &'static str,
        /// Name of the fault.
        fault: &'static str,
    },
    /// Tables are registered twice, or after a scenario was read.
    #[error("the plants and laws of a bench are registered once")]
    RegisteredAlready,
}

/// Registers all tables of a section, once and before anything is read.
///
/// # Errors
/// One of them cannot be a table of the section.
pub fn register(section: Section, tables: Vec<CustomTable>) -> Result<(), InvalidRegistration> {
    for (place, table) in tables.iter().enumerate() {
        let name = table.name();
        is_free(section, name)?;
        if tables[..place].iter().any(|other| other.name() == name) {
            let name = name.to_owned();
            return Err(InvalidRegistration::Taken { section, name });
        }
        if table.schema()["type"] != "object" {
            return Err(InvalidRegistration::NoTable(name));
        }
        let is_plants = |kind: &Kind| kind.group == Group::Plant;
        let unknown = |fault: &&&str| !Kind::named(fault).is_some_and(is_plants);
        if let Some(fault) = table.faults().iter().find(unknown) {
            return Err(InvalidRegistration::Fault { name, fault });
        }
    }
    section
        .set_tables(tables)
        .map_err(|_| InvalidRegistration::RegisteredAlready)
}

/// Refuses a name that a plant or a law cannot have.
///
/// # Errors
/// The name cannot be that of a table, or is that of another one.
pub fn is_free(section: Section, name: &str) -> Result<(), InvalidRegistration> {
    if !is_name(name) {
        return Err(InvalidRegistration::Name(name.to_owned()));
    }
    let is_taken = match section {
        Section::Plant => is_built_in(name) || PLANT_PARTS.contains(&name),
        Section::Controller => schema_of::<Controller>()["properties"].get(name).is_some(),
    };
    if RESERVED.contains(&name) || is_taken {
        let name = name.to_owned();
        return Err(InvalidRegistration::Taken { section, name });
    }
    Ok(())
}

/// Tables of the plants that ship and of their drives: `[plant.wire.heat]` of a scenario names no model.
const PLANT_PARTS: [&str; 5] = ["amplifier", "heat", "mechanics", "phase", "sensor"];

/// Names that mean something else without being keys.
const RESERVED: [&str; 3] = ["sma_actuator", "sma", "none"];
