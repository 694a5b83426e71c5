//! Registers plants and laws from outside, once and before anything is read.

use crate::controller;
use crate::custom::{CustomTable, Section};
use crate::fault::{Group, Kind};
use crate::plant;
use dbc::names::is_name;

/// Reason why a plant or a law cannot be registered.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidRegistration(pub String);

impl InvalidRegistration {
    /// Makes the error of a second registration, or of one after a scenario was read.
    pub fn again() -> Self {
        Self("the plants and laws of a bench are registered once".to_owned())
    }

    fn taken(section: Section, name: &str) -> Self {
        let section = section.key();
        Self(format!(
            "[{section}.{name}] is a table already: choose another name"
        ))
    }
}

/// Registers all tables of a section, once and before anything is read.
///
/// # Errors
/// One of them cannot be a table of the section.
pub fn register(section: Section, tables: Vec<CustomTable>) -> Result<(), InvalidRegistration> {
    for (place, table) in tables.iter().enumerate() {
        let name = table.name;
        is_free(section, name)?;
        if tables[..place].iter().any(|other| other.name == name) {
            return Err(InvalidRegistration::taken(section, name));
        }
        if table.schema["type"] != "object" {
            return Err(InvalidRegistration(format!(
                "the parameters of `{name}` are no struct with named fields"
            )));
        }
        let is_plants = |kind: &Kind| kind.group == Group::Plant;
        let unknown = |fault: &&&str| !Kind::named(fault).is_some_and(is_plants);
        if let Some(fault) = table.faults.iter().find(unknown) {
            return Err(InvalidRegistration(format!(
                "`{name}` names a fault `{fault}`, and there is no [[fault.plant.{fault}]]"
            )));
        }
    }
    section
        .tables()
        .set(tables)
        .map_err(|_| InvalidRegistration::again())
}

/// Refuses a name that a plant or a law cannot have.
///
/// # Errors
/// The name cannot be that of a table, or is that of another one.
pub fn is_free(section: Section, name: &str) -> Result<(), InvalidRegistration> {
    if !is_name(name) {
        return Err(InvalidRegistration(format!(
            "`{name}` cannot be the name of a table: a name has at most 64 small letters, digits and underscores, and begins with a letter"
        )));
    }
    let is_taken = match section {
        Section::Plant => plant::is_built_in(name) || PLANT_PARTS.contains(&name),
        Section::Controller => controller::is_built_in(name),
    };
    if RESERVED.contains(&name) || is_taken {
        return Err(InvalidRegistration::taken(section, name));
    }
    Ok(())
}

/// Tables of the plants that ship and of their drives: `[plant.wire.heat]` of a scenario names no model.
const PLANT_PARTS: [&str; 5] = ["amplifier", "heat", "mechanics", "phase", "sensor"];

/// Names that mean something else without being keys.
const RESERVED: [&str; 3] = ["sma_actuator", "sma", "none"];
