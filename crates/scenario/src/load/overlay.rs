//! Values of a scenario that replace those of its rig, by the rig's own paths: `[bus]`, `[plant.NAME]` without the model's name,
//! and the parts of a node, as in `[node.NAME.sensor]`. A scenario adds, removes and rewires nothing.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::fmus;
use crate::document::Document;
use crate::error::Problem;
use crate::load::Reading;
use crate::nearest::{meant_or_known, nearest};
use crate::plant::FMU;
use crate::rig::nodes::Rig;
use crate::schema;
use crate::structure::found_kind;

/// Tables of a rig file that a scenario may have, too.
const SECTIONS: [&str; 3] = ["bus", "plant", "node"];
const PLANT: &str = "plant";
const NODE: &str = "node";
/// Key of the hard limits of a real drive.
const LIMITS: &str = "limits";
/// Keys of a node that are values, not tables.
const VALUES: [&str; 2] = ["truth_every_cycles", "program"];
/// Keys of a node that define the parts of the rig and their wiring; only the rig file has them.
const WIRING: [&str; 12] = [
    "kind",
    "node_id",
    "external",
    "eds",
    "mode_of_operation",
    "command",
    "position",
    "current",
    "port",
    "unit",
    "outputs",
    "record",
];
/// Keys of an FMU for the rig file only.
const WIRING_OF_FMU: [&str; 3] = ["file", "ports", "record"];

/// Returns the rig with the values of a scenario in it, and the problems of these values. `as_written` is the rig without these
/// values, if it was checked so; it allows further checks of a scenario whose values are wrong.
///
/// # Errors
/// The problems of the values, if they prevent further checks.
pub(super) fn overlaid<'text>(
    scenario: &Document<'text>,
    as_written: Option<Rig>,
    rig_tree: &DeTable<'text>,
    reading: Reading,
) -> Result<(Rig, Vec<Problem>), Vec<Problem>> {
    let is_overlaid = SECTIONS.iter().any(|section| scenario.has(section));
    let as_written = match as_written {
        Some(rig) if !is_overlaid => return Ok((rig, Vec::new())),
        as_written => as_written,
    };
    // A problem in the rig file is shown at the scenario's key `rig`.
    let at = scenario.span("rig");
    let mut rig_tables = placed_table(rig_tree, &at);
    rig_tables.remove("defaults");
    let overlay = Overlay {
        scenario,
        tree: &rig_tables,
    };
    let mut tree = rig_tables.clone();
    let mut problems = overlay.put_into(&mut tree, &at);
    match Rig::from_tree(&scenario.with_root(tree), reading) {
        Ok(rig) => Ok((rig, problems)),
        Err(found) => {
            problems.extend(overlay.without_models(found));
            match as_written {
                Some(rig) => Ok((rig, problems)),
                None => Err(problems),
            }
        }
    }
}

struct Overlay<'a, 'text> {
    scenario: &'a Document<'text>,
    /// Tree of the rig as written.
    tree: &'a DeTable<'text>,
}

impl<'text> Overlay<'_, 'text> {
    /// Puts the scenario's values in place of the rig's.
    fn put_into(&self, tree: &mut DeTable<'text>, at: &Range<usize>) -> Vec<Problem> {
        let mut problems = Vec::new();
        for section in SECTIONS {
            let Some(values) = self.scenario.spanned(section) else {
                continue;
            };
            let DeValue::Table(values) = values.get_ref() else {
                problems.push(self.no_table(section, values));
                continue;
            };
            let target = below(tree, section, at);
            match section {
                PLANT => self.plants(target, values, &mut problems),
                NODE => self.nodes(target, values, &mut problems),
                _ => put(target, values),
            }
        }
        problems
    }

    fn plants(
        &self,
        tree: &mut DeTable<'text>,
        plants: &DeTable<'text>,
        problems: &mut Vec<Problem>,
    ) {
        let models = Vec::from_iter(self.models());
        let known = Vec::from_iter(models.iter().map(|(plant, _)| *plant));
        for (name, values) in plants {
            let plant = models.iter().find(|(plant, _)| *plant == name.get_ref());
            let Some((_, model)) = plant.copied() else {
                problems.push(self.unknown(name, PLANT, &known));
                continue;
            };
            let wiring = if model == FMU {
                &WIRING_OF_FMU[..]
            } else {
                &[]
            };
            let Some(values) = self.values(PLANT, name, values, wiring, problems) else {
                continue;
            };
            if let Some(problem) = self.with_model(name, model, values.1) {
                problems.push(problem);
                continue;
            }
            let models = below(tree, name.get_ref(), &values.0);
            let mut values = values.1.clone();
            if model == FMU {
                fmus::name_start_values(&mut values);
                fmus::name_start_values(below(models, model, &name.span()));
            }
            put(below(models, model, &name.span()), &values);
        }
    }

    fn nodes(
        &self,
        tree: &mut DeTable<'text>,
        nodes: &DeTable<'text>,
        problems: &mut Vec<Problem>,
    ) {
        let known = Vec::from_iter(self.entries(NODE).map(|(node, _)| node));
        'nodes: for (name, parts) in nodes {
            if !known.contains(&name.get_ref().as_ref()) {
                problems.push(self.unknown(name, NODE, &known));
                continue;
            }
            let Some((at, parts)) = self.values(NODE, name, parts, &WIRING, problems) else {
                continue;
            };
            let node = below(tree, name.get_ref(), &at);
            for part in parts.keys() {
                if let Some(problem) = self.part(name, part, node) {
                    problems.push(problem);
                    continue 'nodes;
                }
            }
            put(node, parts);
        }
    }

    /// Returns the entries of a table of the rig file.
    fn entries(&self, section: &str) -> impl Iterator<Item = (&str, &DeValue<'text>)> {
        let table = self.tree.get(section);
        let table = table.and_then(|table| table.get_ref().as_table());
        let entries = table.into_iter().flat_map(DeTable::iter);
        entries.map(|(name, value)| (name.get_ref().as_ref(), value.get_ref()))
    }

    /// Returns the plants of the rig, each with the name of its model.
    fn models(&self) -> impl Iterator<Item = (&str, &str)> {
        self.entries(PLANT).filter_map(|(plant, models)| {
            let model = models.as_table()?.keys().next()?;
            Some((plant, model.get_ref().as_ref()))
        })
    }

    /// Refuses the name of a plant's model, which only a rig file has.
    fn with_model(
        &self,
        plant: &Spanned<DeString<'text>>,
        model: &str,
        values: &DeTable<'text>,
    ) -> Option<Problem> {
        let models = &schema::RIG["definitions"]["PlantModel"]["properties"];
        let is_model = |(key, value): &(&Spanned<DeString<'_>>, &Spanned<DeValue<'_>>)| {
            models.get(key.get_ref().as_ref()).is_some() && value.get_ref().is_table()
        };
        let (key, _) = values.iter().find(is_model)?;
        let (name, plant) = (key.get_ref(), plant.get_ref());
        let (message, label) = if name == model {
            (
                format!("unknown key `{name}` in [{PLANT}.{plant}]"),
                format!("write [{PLANT}.{plant}], without the name of the model"),
            )
        } else {
            (
                format!("the model of `{plant}` is `{model}`, not `{name}`"),
                "a scenario gives other values and no other model".to_owned(),
            )
        };
        Some(self.problem(key.span(), message, label))
    }

    /// Refuses values for a part of a node that a scenario cannot change.
    fn part(
        &self,
        name: &Spanned<DeString<'text>>,
        part: &Spanned<DeString<'text>>,
        node: &DeTable<'text>,
    ) -> Option<Problem> {
        let (name, key): (&str, &str) = (name.get_ref(), part.get_ref());
        if !VALUES.contains(&key) && !node.contains_key(key) {
            let parts = node.iter().filter(|(_, value)| value.get_ref().is_table());
            let parts = parts.map(|(part, _)| part.get_ref().as_ref());
            let label = match nearest(key, parts.chain(VALUES)) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => "a scenario gives other values and adds nothing".to_owned(),
            };
            let message = format!("`{name}` of the rig has no {key}");
            return Some(self.problem(part.span(), message, label));
        }
        (key == LIMITS).then(|| {
            let message = format!("a scenario cannot change the limits of `{name}`");
            let label = "they stand in the rig file and hold whatever a scenario says";
            self.problem(part.span(), message, label)
        })
    }

    /// Returns the table below a name, if it has no key that is for the rig file alone.
    fn values<'b>(
        &self,
        section: &str,
        name: &Spanned<DeString<'text>>,
        values: &'b Spanned<DeValue<'text>>,
        wiring: &[&str],
        problems: &mut Vec<Problem>,
    ) -> Option<(Range<usize>, &'b DeTable<'text>)> {
        let DeValue::Table(table) = values.get_ref() else {
            let path = format!("{section}.{}", name.get_ref());
            problems.push(self.no_table(&path, values));
            return None;
        };
        if let Some(key) = first_key(table, wiring) {
            let message = format!("a scenario cannot give its rig another `{}`", key.get_ref());
            let problem = self.problem(key.span(), message, "only the rig file says this");
            let help = "a scenario changes the values of its rig, not its wiring; `--rig FILE` plays it on another rig";
            problems.push(problem.with_help(help));
            return None;
        }
        Some((values.span(), table))
    }

    fn no_table(&self, path: &str, value: &Spanned<DeValue<'text>>) -> Problem {
        let message = format!("`{path}` must be a table");
        let label = format!("this is {}", found_kind(value.get_ref()));
        self.problem(value.span(), message, label)
    }

    fn unknown(&self, name: &Spanned<DeString<'text>>, kind: &str, known: &[&str]) -> Problem {
        let message = format!("the rig has no {kind} `{}`", name.get_ref());
        let label = match known {
            [] => format!("it has no {kind}s"),
            known => meant_or_known(name.get_ref(), known),
        };
        let problem = self.problem(name.span(), message, label);
        problem.with_help("this table gives other values to the scenario's rig: play it on a rig that has this, or leave it out")
    }

    fn problem(&self, span: Range<usize>, message: String, label: impl Into<String>) -> Problem {
        self.scenario.source.problem(span, message, label)
    }

    /// Gives problems the paths of the scenario, which are without the names of models.
    fn without_models(&self, problems: Vec<Problem>) -> impl Iterator<Item = Problem> {
        let paths = self.models().map(|(plant, model)| {
            let short = format!("{PLANT}.{plant}");
            (format!("{short}.{model}"), short)
        });
        let paths = Vec::from_iter(paths);
        problems.into_iter().map(move |problem| {
            problem.renamed(|text| {
                let named = paths.iter().fold(text.to_owned(), |text, (long, short)| {
                    text.replace(long, short)
                });
                named.replace("the rig file", "the scenario")
            })
        })
    }
}

/// Returns the first of some keys in a table, or in one below it.
fn first_key<'a, 'text>(
    table: &'a DeTable<'text>,
    keys: &[&str],
) -> Option<&'a Spanned<DeString<'text>>> {
    table.iter().find_map(|(key, value)| match value.get_ref() {
        _ if keys.contains(&key.get_ref().as_ref()) => Some(key),
        DeValue::Table(below) if key.get_ref() != "start" => first_key(below, keys),
        _ => None,
    })
}

/// Returns the table at a key, and makes it if it is missing.
fn below<'a, 'text>(
    tree: &'a mut DeTable<'text>,
    name: &str,
    at: &Range<usize>,
) -> &'a mut DeTable<'text> {
    let empty = || DeValue::Table(DeTable::new());
    let key = Spanned::new(at.clone(), DeString::from(name.to_owned()));
    let below = tree
        .entry(key)
        .or_insert_with(|| Spanned::new(at.clone(), empty()));
    if !below.get_ref().is_table() {
        *below = Spanned::new(at.clone(), empty());
    }
    match below.get_mut() {
        DeValue::Table(table) => table,
        _ => unreachable!("made just above"),
    }
}

/// Replaces values by others, down to the last table.
fn put<'text>(tree: &mut DeTable<'text>, values: &DeTable<'text>) {
    for (key, value) in values {
        let name: &str = key.get_ref();
        match (tree.get_mut(name).map(Spanned::get_mut), value.get_ref()) {
            (Some(DeValue::Table(below)), DeValue::Table(values)) => put(below, values),
            _ => {
                tree.remove(name);
                tree.insert(key.clone(), value.clone());
            }
        }
    }
}

/// Copies a table of another file; every value gets one place of this file.
fn placed_table<'text>(table: &DeTable<'text>, at: &Range<usize>) -> DeTable<'text> {
    let entries = table.iter().map(|(key, value)| {
        let key = Spanned::new(at.clone(), key.get_ref().clone());
        (key, placed(value, at))
    });
    entries.collect()
}

fn placed<'text>(value: &Spanned<DeValue<'text>>, at: &Range<usize>) -> Spanned<DeValue<'text>> {
    let inner = match value.get_ref() {
        DeValue::Table(table) => DeValue::Table(placed_table(table, at)),
        DeValue::Array(array) => {
            let entries = array.iter().map(|below| placed(below, at));
            DeValue::Array(entries.collect())
        }
        other => other.clone(),
    };
    Spanned::new(at.clone(), inner)
}

#[cfg(test)]
mod tests;
