//! The `[fault]` table: faults that a run has on purpose.
//!
//! Each kind of fault is a row of [`KINDS`] and an array of tables in a scenario, `[[fault.sensor.stuck]]`. All may be used
//! together. Each draws its random numbers from a separate stream, so one more fault leaves the others as they were.

mod kinds;
mod read;
mod schema;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::node::{NodeIndex, Nodes};

pub use kinds::{Actor, Drawn, Form, Group, KINDS, Key, Kind, Need, Time, Touch};
pub(crate) use read::read;
pub(crate) use schema::{describe, described};

/// Value of a fault's key.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Number(f64),
    Word(String),
}

/// Fault of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Kind of the fault: its row.
    pub kind: &'static Kind,
    /// Index among the faults of its kind in the file.
    pub index: usize,
    /// Node that fails, or of which a part fails; `None` if the bus or a plant fails.
    pub node: Option<NodeIndex>,
    /// Plant that fails, if the file names it in place of a drive.
    pub plant: Option<String>,
    /// Start; `None` if it acts while a node boots, before the start of the scenario.
    pub from_seconds: Option<f64>,
    /// End; the end of the run if absent. A fault that happens at an instant ends at that instant.
    pub until_seconds: Option<f64>,
    values: BTreeMap<&'static str, Value>,
}

impl Fault {
    /// Returns its path in the document, which also names its stream of random numbers.
    pub fn path(&self) -> String {
        format!("{}.{}", self.kind.path(), self.index)
    }

    /// Returns the number at a key.
    ///
    /// # Panics
    /// The kind has no such number, or the number has no default and is not given.
    pub fn number(&self, key: &str) -> f64 {
        let number = self.optional(key);
        number.unwrap_or_else(|| panic!("{} has no number `{key}`", self.kind.heading()))
    }

    /// Returns the number at an optional key.
    pub fn optional(&self, key: &str) -> Option<f64> {
        match self.values.get(key)? {
            Value::Number(number) => Some(*number),
            Value::Word(_) => None,
        }
    }

    /// Returns the whole number at an optional key.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the loader has checked that it is whole and in the range of its kind"
    )]
    pub fn whole(&self, key: &str) -> Option<u32> {
        self.optional(key).map(|number| number as u32)
    }

    /// Checks whether a key has this word.
    pub fn says(&self, key: &str, word: &str) -> bool {
        matches!(self.values.get(key), Some(Value::Word(said)) if said == word)
    }

    /// Checks whether the fault acts at a scenario time.
    pub fn acts_at(&self, time_seconds: f64) -> bool {
        self.from_seconds.is_some_and(|from| time_seconds >= from)
            && self.until_seconds.is_none_or(|end| time_seconds < end)
    }

    /// Checks whether it happens to a node or a part of it.
    pub fn is_at(&self, node: NodeIndex) -> bool {
        self.node == Some(node)
    }

    /// Checks whether it happens to this drive, or to the plant that the drive moves.
    pub fn is_at_drive(&self, drive: NodeIndex, plant: &str) -> bool {
        match self.node {
            Some(node) => node == drive,
            None => self.plant.as_deref().is_some_and(|name| name == plant),
        }
    }

    /// Describes a fault of a run with these nodes; `are_drives_named` adds the name of the drive.
    pub fn text(&self, nodes: &Nodes, are_drives_named: bool) -> String {
        let (group, name) = (self.kind.group, self.kind.name.replace('_', " "));
        let whose = match (self.node, &self.plant) {
            (Some(node), _) => Some(nodes[node].name.as_str()),
            (None, plant) => plant.as_deref(),
        };
        match (group, whose) {
            (Group::Node, Some(whose)) => format!("fault: {whose} {name}"),
            (Group::Sensor | Group::Amplifier | Group::Plant, Some(whose)) if are_drives_named => {
                format!("fault: {whose} {} {name}", group.name())
            }
            _ => format!("fault: {} {name}", group.name()),
        }
    }
}

/// Faults of a run, in the order of [`KINDS`] and of the file. All loops of a run share them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults(Arc<[Fault]>);

impl Faults {
    /// Returns all faults.
    pub fn iter(&self) -> std::slice::Iter<'_, Fault> {
        self.0.iter()
    }

    /// Checks whether there are no faults.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the faults of a kind.
    pub fn of<'a>(&'a self, kind: &'a str) -> impl Iterator<Item = &'a Fault> {
        self.iter().filter(move |fault| fault.kind.name == kind)
    }

    /// Returns the faults of a group.
    pub fn in_group(&self, group: Group) -> impl Iterator<Item = &Fault> {
        self.iter().filter(move |fault| fault.kind.group == group)
    }

    /// Returns the faults of a node.
    pub fn at_node(&self, node: NodeIndex) -> Self {
        self.only(|fault| fault.is_at(node))
    }

    /// Returns those faults that fulfil a condition.
    pub(crate) fn only(&self, is_one: impl Fn(&Fault) -> bool) -> Self {
        Self(self.iter().filter(|fault| is_one(fault)).cloned().collect())
    }

    /// Checks whether a fault of a kind acts at a scenario time.
    pub fn any_acts(&self, kind: &str, time_seconds: f64) -> bool {
        self.of(kind).any(|fault| fault.acts_at(time_seconds))
    }
}
