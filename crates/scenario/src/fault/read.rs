//! Reads the faults of a scenario, each with the node to which it happens.

use std::collections::BTreeMap;

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::schema::definition;
use super::{Fault, Faults, Form, Group, KINDS, Key, Kind, Need, Time, Value};
use crate::check::outside;
use crate::document::Document;
use crate::error::Problem;
use crate::load::{Naming, in_unit, without_problems};
use crate::nearest::meant_or_known;
use crate::node::{Node, Part};
use crate::rig::nodes::{NodeKind, Rig};
use crate::schema;
use crate::structure::{self, check_table, number};

const FAULT: &str = "fault";
const PLANT: &str = "plant";
const BENCH: &str = "bench";
/// Returns the node of a rig to which a fault may happen.
fn node_of(rig: &Rig, name: &str) -> Option<Node> {
    if name == BENCH {
        return Some(Node::new(name, 0, Part::Bench));
    }
    let found = rig.node.get(name)?;
    let part = match found.kind {
        NodeKind::Controller => Part::Controller,
        NodeKind::Drive => Part::Drive,
        NodeKind::Io => return None,
    };
    Some(Node::new(name, found.node_id, part))
}

fn only_drive(rig: &Rig) -> Option<Node> {
    let is_drive = |name: &&String| rig.node[*name].kind == NodeKind::Drive;
    let mut drives = rig.node.keys().filter(is_drive);
    let only = drives.next().filter(|_| drives.next().is_none())?;
    node_of(rig, only)
}

/// Reads the faults of a document, and the problems among them. A fault of another form than the schema's is left out: the check
/// against the schema has reported it.
pub(crate) fn read(document: &Document<'_>, rig: &Rig) -> (Faults, Vec<Problem>) {
    let reader = Reader { document, rig };
    let mut problems = reader.shape();
    let mut faults = Vec::new();
    for kind in KINDS {
        let path = format!("{FAULT}.{}.{}", kind.group.name(), kind.name);
        let entries = document
            .spanned(&path)
            .map(Spanned::get_ref)
            .and_then(DeValue::as_array);
        for (index, entry) in entries.into_iter().flatten().enumerate() {
            match reader.fault(kind, index, entry) {
                Ok(fault) => faults.extend(fault),
                Err(found) => problems.extend(found),
            }
        }
    }
    (Faults(faults.into()), problems)
}

struct Reader<'a, 'text> {
    document: &'a Document<'text>,
    rig: &'a Rig,
}

impl<'text> Reader<'_, 'text> {
    /// Checks groups and kinds against the schema, without the entries of their arrays.
    fn shape(&self) -> Vec<Problem> {
        let section = self
            .document
            .root()
            .get_key_value(FAULT)
            .map(|(key, value)| (key.clone(), value.clone()));
        let mut tree: DeTable<'text> = section.into_iter().collect();
        for kinds in tree.iter_mut().flat_map(|(_, groups)| tables(groups)) {
            for (_, entries) in tables(kinds.1) {
                if let DeValue::Array(entries) = entries.get_mut() {
                    *entries = DeArray::new();
                }
            }
        }
        self.check(tree)
    }

    fn check(&self, tree: DeTable<'text>) -> Vec<Problem> {
        let document = self.document.with_root(tree);
        structure::check(&document, "the scenario", &schema::FAULTS)
    }

    fn fault(
        &self,
        kind: &'static Kind,
        index: usize,
        entry: &Spanned<DeValue<'text>>,
    ) -> Result<Option<Fault>, Vec<Problem>> {
        let path = format!("{FAULT}.{}.{}.{index}", kind.group.name(), kind.name);
        let DeValue::Table(table) = entry.get_ref() else {
            return Ok(None);
        };
        let plant = self.plant(kind, &path, table).map_err(one)?;
        let node = match plant {
            Some(_) => None,
            None => self.node(kind, &path, table).map_err(one)?,
        };
        let table = self.in_loop_unit(kind, entry, node.as_ref())?;
        let values = kind.keys.iter().filter(|key| !names_node(key));
        let mut read = BTreeMap::new();
        for key in values {
            match (value(key, &table), key.need) {
                (Some(value), _) => drop(read.insert(key.name, value)),
                (None, Need::Required) => return Ok(None),
                (None, _) => {}
            }
        }
        let seconds = |key: &str| table.get(key).and_then(|value| number(value.get_ref()));
        let (from_seconds, until_seconds) = match kind.time {
            Time::Lasts | Time::Ends => (seconds("from_seconds"), seconds("until_seconds")),
            Time::Instant => (seconds("at_seconds"), seconds("at_seconds")),
            Time::Boot => (None, None),
        };
        if kind.time != Time::Boot && from_seconds.is_none() {
            return Ok(None);
        }
        if let Some(problem) = self.outside_amplifier(kind, &path, node.as_ref(), &table) {
            return Err(vec![problem]);
        }
        Ok(Some(Fault {
            kind,
            index,
            node,
            plant,
            from_seconds,
            until_seconds,
            values: read,
        }))
    }

    /// Returns the plant that a fault names in place of a drive.
    fn plant(
        &self,
        kind: &Kind,
        path: &str,
        table: &DeTable<'_>,
    ) -> Result<Option<String>, Problem> {
        let named = table.get(PLANT).filter(|_| kind.group == Group::Plant);
        let (rig, Some(named)) = (self.rig, named) else {
            return Ok(None);
        };
        let name = named.get_ref().as_str().unwrap_or_default();
        if rig.plant.contains_key(name) {
            return Ok(Some(name.to_owned()));
        }
        let known = Vec::from_iter(rig.plant.keys().map(String::as_str));
        let (message, label) = (
            format!("the rig has no plant `{name}`"),
            meant_or_known(name, &known),
        );
        Err(self
            .document
            .problem(&format!("{path}.{PLANT}"), message, label))
    }

    /// Returns the node to which a fault happens; `None` if it happens to the bus, or if the schema does not admit the name.
    fn node(&self, kind: &Kind, path: &str, table: &DeTable<'_>) -> Result<Option<Node>, Problem> {
        let key = match kind.node_key() {
            Some(key) => key.name,
            None if kind.is_drive_fault() => "node",
            None => return Ok(None),
        };
        let Some(named) = table.get(key) else {
            if !kind.is_drive_fault() {
                return Ok(None);
            }
            let only = only_drive(self.rig);
            let known = Vec::from_iter(self.rig.node.keys().map(String::as_str));
            let message = "for which node?";
            let label = format!("`node` is missing; known are: {}", known.join(", "));
            return match only {
                Some(only) => Ok(Some(only)),
                None => Err(self.document.problem(path, message, label)),
            };
        };
        let name = named.get_ref().as_str().unwrap_or_default();
        let is_possible = |node: &Node| match node.part {
            Part::Bench => kind.group == Group::Bus,
            Part::Controller => !kind.is_drive_fault(),
            Part::Drive => true,
            Part::Io => false,
        };
        let rig = self.rig;
        if let Some(node) = node_of(rig, name).filter(is_possible) {
            return Ok(Some(node));
        }
        let path = format!("{path}.{key}");
        let heading = kind.heading();
        let (message, label) = match rig.node.get(name).map(|node| node.kind) {
            Some(kind) => {
                let label = match kind {
                    NodeKind::Io => "an io node; faults happen to drives and the controller",
                    _ => "no drive",
                };
                let message = format!("{heading} cannot happen to `{name}`");
                (message, label.to_owned())
            }
            None => {
                let known = Vec::from_iter(rig.node.keys().map(String::as_str));
                (
                    format!("the rig has no {key} `{name}`"),
                    meant_or_known(name, &known),
                )
            }
        };
        Err(self.document.problem(&path, message, label))
    }

    /// Refuses a current that the amplifier of the drive never gives.
    fn outside_amplifier(
        &self,
        kind: &Kind,
        path: &str,
        node: Option<&Node>,
        table: &DeTable<'_>,
    ) -> Option<Problem> {
        let drive = node.filter(|node| node.part == Part::Drive)?;
        let key = kind.keys.iter().find(|key| key.name.starts_with(CURRENT))?;
        let current = number(table.get(key.name)?.get_ref())?;
        let range = self.rig.wiring_of(&drive.name).current();
        let within = match key.name {
            CURRENT => [range.min, range.max],
            _ => [0.0, range.max],
        };
        outside(
            self.document,
            &format!("{path}.{}", key.name),
            current,
            within,
        )
    }

    /// Returns an entry with the patterns of its keys, after a check of their names.
    fn in_loop_unit(
        &self,
        kind: &Kind,
        entry: &Spanned<DeValue<'text>>,
        node: Option<&Node>,
    ) -> Result<DeTable<'text>, Vec<Problem>> {
        let drive = node.filter(|node| node.part == Part::Drive);
        let wiring = drive.map(|node| self.rig.wiring_of(&node.name));
        let wiring = wiring.unwrap_or_default();
        let measurand = wiring.sensor.measurand;
        let part = &schema::FAULTS["definitions"][definition(kind)];
        let mut table = entry.get_ref().as_table().cloned().unwrap_or_default();
        if drive.is_some() {
            let naming = Naming {
                source: &self.document.source,
                measurand: &measurand,
                loop_name: &wiring.loop_name,
                schema: &schema::FAULTS,
            };
            naming.apply(&mut table, part).map_err(one)?;
        }
        let document = self.document.with_loop(DeTable::new(), measurand.clone());
        let at = (entry.span(), &table);
        let problems = check_table(&document, &kind.heading(), at, &schema::FAULTS, part);
        without_problems(in_unit(problems, &measurand), table)
    }
}

/// Name of a current of the amplifier, and beginning of the name of its limit.
const CURRENT: &str = "{command}_{command_unit}";

fn one(problem: Problem) -> Vec<Problem> {
    vec![problem]
}

fn names_node(key: &Key) -> bool {
    matches!(key.form, Form::Node | Form::Station)
}

/// Returns the entries of a table.
fn tables<'a, 'text>(
    value: &'a mut Spanned<DeValue<'text>>,
) -> impl Iterator<
    Item = (
        &'a Spanned<toml::de::DeString<'text>>,
        &'a mut Spanned<DeValue<'text>>,
    ),
> {
    let table = match value.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    };
    table.into_iter().flat_map(DeTable::iter_mut)
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
