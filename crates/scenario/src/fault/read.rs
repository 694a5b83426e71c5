//! Reads the faults of a scenario, each with the node to which it happens.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::schema::definition;
use super::{Fault, Faults, Group, KINDS, Key, Kind, Need, Time, Value};
use crate::document::{Document, KeyContext};
use crate::error::Problem;
use crate::load::{Naming, in_unit, only_one, without_problems};
use crate::nearest::meant_or_known;
use crate::node::{NodeIndex, Nodes, Profile};
use crate::rig::nodes::{Rig, RigNode};
use crate::schema;
use crate::structure::{self, check_table, number};

const PLANT: &str = "plant";
const NODE: &str = "node";

/// Reads the faults of a document, and the problems among them. An entry that is no table is left out: the check against the
/// schema has reported it.
pub(crate) fn read(document: &Document<'_>, rig: &Rig, nodes: &Nodes) -> (Faults, Vec<Problem>) {
    let reader = Reader {
        document,
        rig,
        nodes,
    };
    let mut problems = reader.shape();
    let mut faults = Vec::new();
    for kind in KINDS {
        for (index, entry) in document.entries(&kind.path()).iter().enumerate() {
            let DeValue::Table(table) = entry.get_ref() else {
                continue;
            };
            match reader.fault(kind, index, (entry.span(), table)) {
                Ok(fault) => faults.push(fault),
                Err(found) => problems.extend(found),
            }
        }
    }
    (Faults(faults.into()), problems)
}

struct Reader<'a, 'text> {
    document: &'a Document<'text>,
    rig: &'a Rig,
    nodes: &'a Nodes,
}

impl<'text> Reader<'_, 'text> {
    /// Checks groups and kinds against the schema, which leaves the entries of their arrays to [`Reader::fault`].
    fn shape(&self) -> Vec<Problem> {
        let document = self.document.only(&["fault"]);
        structure::check(&document, "the scenario", &schema::FAULTS)
    }

    fn fault(
        &self,
        kind: &'static Kind,
        index: usize,
        (span, table): (Range<usize>, &DeTable<'text>),
    ) -> Result<Fault, Vec<Problem>> {
        let path = format!("{}.{index}", kind.path());
        let plant = self.plant(kind, &path, table).map_err(one)?;
        let node = match plant {
            Some(_) => None,
            None => self.node(kind, &path, table).map_err(one)?,
        };
        let named = node.map(|node| self.nodes[node].name.as_str());
        let table = self.in_loop_unit(kind, (span, table.clone()), named.unwrap_or_default())?;
        let keys = kind.keys.iter().filter(|key| !key.names_node());
        // An entry that lacks a key was refused above.
        let values = keys.filter_map(|key| Some((key.name, value(key, &table)?)));
        let seconds = |key: &str| table.get(key).and_then(|value| number(value.get_ref()));
        let (from_seconds, until_seconds) = match kind.time {
            Time::Lasts | Time::Ends => (seconds("from_seconds"), seconds("until_seconds")),
            Time::Instant => (seconds("at_seconds"), seconds("at_seconds")),
            Time::Boot => (None, None),
        };
        Ok(Fault {
            kind,
            index,
            node,
            plant,
            from_seconds,
            until_seconds,
            values: values.collect(),
        })
    }

    /// Returns the plant that a fault names in place of a drive.
    fn plant(
        &self,
        kind: &Kind,
        path: &str,
        table: &DeTable<'_>,
    ) -> Result<Option<String>, Problem> {
        let Some(named) = table.get(PLANT).filter(|_| kind.group == Group::Plant) else {
            return Ok(None);
        };
        let name = named.get_ref().as_str().unwrap_or_default();
        match self.rig.plant.get_key_value(name) {
            Some((name, _)) => Ok(Some(name.clone())),
            None => Err(self.unknown(path, [PLANT, name], self.rig.plant.keys())),
        }
    }

    /// Returns the node to which a fault happens; `None` if it happens to the bus, or if the schema does not admit the name.
    fn node(
        &self,
        kind: &Kind,
        path: &str,
        table: &DeTable<'_>,
    ) -> Result<Option<NodeIndex>, Problem> {
        let is_drive_fault = kind.is_drive_fault();
        let key = match kind.node_key() {
            Some(key) => key.name,
            None if is_drive_fault => NODE,
            None => return Ok(None),
        };
        let Some(named) = table.get(key) else {
            let only = only_one(self.rig.of_kind(Profile::Drive)).filter(|_| is_drive_fault);
            if only.is_some() || !is_drive_fault {
                return Ok(only.and_then(|(name, _)| self.nodes.find(name)));
            }
            let drives = self.rig.of_kind(Profile::Drive).map(|(name, _)| name);
            let known = Vec::from_iter(drives).join(", ");
            let label = format!("`{NODE}` is missing; known are: {known}");
            return Err(self.document.problem(path, "for which node?", label));
        };
        let name = named.get_ref().as_str().unwrap_or_default();
        let found = self.nodes.find(name);
        let profile = found.and_then(|index| self.nodes[index].profile());
        let label = match profile {
            // canrig's own node is in no rig file: it has only what happens to its frames.
            None if found.is_some() && kind.group == Group::Bus => return Ok(found),
            None => return Err(self.unknown(path, [key, name], self.rig.node.keys())),
            Some(Profile::Io) if kind.group == Group::Bus => {
                "an io node; faults of the bus happen to drives, the controller and the bench"
            }
            Some(Profile::Io | Profile::Manager) if is_drive_fault => "no drive",
            Some(_) => return Ok(found),
        };
        let message = format!("{} cannot happen to `{name}`", kind.heading());
        Err(self
            .document
            .problem(&format!("{path}.{key}"), message, label))
    }

    /// Refuses a name at a key that the rig does not have.
    fn unknown<'a>(
        &self,
        path: &str,
        [key, name]: [&str; 2],
        known: impl Iterator<Item = &'a String>,
    ) -> Problem {
        let message = format!("the rig has no {key} `{name}`");
        let label = meant_or_known(name, known);
        self.document
            .problem(&format!("{path}.{key}"), message, label)
    }

    /// Returns an entry with the patterns of its keys, after a check of their names.
    fn in_loop_unit(
        &self,
        kind: &Kind,
        (span, mut table): (Range<usize>, DeTable<'text>),
        drive: &str,
    ) -> Result<DeTable<'text>, Vec<Problem>> {
        let part = &schema::FAULTS["definitions"][definition(kind)];
        let quantities = self.rig.quantities_of(drive);
        let (loop_name, _) = self.rig.loop_of(drive).unzip();
        let naming = Naming {
            source: &self.document.source,
            quantities: &quantities,
            loop_name: loop_name.map_or("", String::as_str),
            schema: &schema::FAULTS,
        };
        naming.apply(&mut table, part).map_err(one)?;
        let measured = self.rig.node.get(drive).map(RigNode::measured);
        let key_context = KeyContext {
            measured: measured.unwrap_or_default(),
            commands: self.rig.parts_of(drive).1.range(),
            quantities,
        };
        let document = self.document.with_loop(DeTable::new(), key_context);
        let at = (span, &table);
        let problems = check_table(&document, &kind.heading(), at, &schema::FAULTS, part);
        without_problems(in_unit(problems, &document.key_context), table)
    }
}

fn one(problem: Problem) -> Vec<Problem> {
    vec![problem]
}

/// Returns the value of a key, or its default.
fn value(key: &Key, table: &DeTable<'_>) -> Option<Value> {
    match (table.get(key.name).map(Spanned::get_ref), key.need) {
        (Some(DeValue::String(word)), _) => Some(Value::Word(word.to_string())),
        (Some(value), _) => number(value).map(Value::Number),
        (None, Need::Default(number)) => Some(Value::Number(number)),
        (None, Need::DefaultWord(word)) => Some(Value::Word(word.to_owned())),
        (None, Need::Required | Need::Optional) => None,
    }
}
