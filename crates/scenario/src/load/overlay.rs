//! Values of a scenario that replace those of its rig, by the rig's own paths: `[bus]`, `[plant.NAME]` without the model's name,
//! and the parts of a node, as in `[node.NAME.sensor]`. A scenario adds, removes and rewires nothing.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::fmus;
use super::nodes::fill;
use crate::document::Document;
use crate::error::Problem;
use crate::load::Reading;
use crate::nearest::{meant_or_known, nearest};
use crate::plant::FMU;
use crate::rig::nodes::Rig;
use crate::schema;

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
    let mut rig_tables = placed_table(rig_tree, &scenario.span("rig"));
    rig_tables.remove("defaults");
    fmus::name_start_values(&mut rig_tables);
    let overlay = Overlay {
        scenario,
        tree: &rig_tables,
    };
    let mut problems = Vec::new();
    let mut tree = overlay.values(&mut problems);
    fmus::name_start_values(&mut tree);
    fill(&mut tree, &rig_tables);
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

type Key<'text> = Spanned<DeString<'text>>;
type Value<'text> = Spanned<DeValue<'text>>;

struct Overlay<'a, 'text> {
    scenario: &'a Document<'text>,
    /// Tree of the rig as written.
    tree: &'a DeTable<'text>,
}

impl<'text> Overlay<'_, 'text> {
    /// Returns the scenario's values in the form of a rig file, without wrong ones.
    fn values(&self, problems: &mut Vec<Problem>) -> DeTable<'text> {
        let mut values = DeTable::new();
        let sections = SECTIONS
            .iter()
            .filter_map(|name| self.scenario.root().get_key_value(*name));
        for (section, value) in sections {
            // The check of the whole refuses all that is no table.
            let DeValue::Table(entries) = value.get_ref() else {
                values.insert(section.clone(), value.clone());
                continue;
            };
            let mut kept = DeTable::new();
            for (name, entry) in entries {
                let kept_entry = match section.get_ref().as_ref() {
                    PLANT => self.plant(name, entry),
                    NODE => self.node(name, entry),
                    _ => Ok(entry.clone()),
                };
                match kept_entry {
                    Ok(entry) => drop(kept.insert(name.clone(), entry)),
                    Err(problem) => problems.push(problem),
                }
            }
            values.insert(section.clone(), table_at(&value.span(), kept));
        }
        values
    }

    /// Returns the values of a plant below the name of its model.
    fn plant(&self, name: &Key<'text>, values: &Value<'text>) -> Result<Value<'text>, Problem> {
        let models = self.entry(PLANT, name)?;
        let model = models.keys().next().map_or("", |key| key.get_ref());
        let wiring = if model == FMU {
            &WIRING_OF_FMU[..]
        } else {
            &[]
        };
        let refused = values.get_ref().as_table().and_then(|table| {
            let refused = self.wiring(table, wiring);
            refused.or_else(|| self.with_model(name, model, table))
        });
        if let Some(problem) = refused {
            return Err(problem);
        }
        let model = Spanned::new(name.span(), DeString::from(model.to_owned()));
        let parameters = values.clone();
        let models = [(model, parameters)].into_iter().collect();
        Ok(table_at(&values.span(), models))
    }

    /// Returns the values of a node.
    fn node(&self, name: &Key<'text>, parts: &Value<'text>) -> Result<Value<'text>, Problem> {
        let node = self.entry(NODE, name)?;
        let refused = parts.get_ref().as_table().and_then(|table| {
            let of_part = || table.keys().find_map(|part| self.part(name, part, node));
            self.wiring(table, &WIRING).or_else(of_part)
        });
        match refused {
            Some(problem) => Err(problem),
            None => Ok(parts.clone()),
        }
    }

    /// Returns the plants or the nodes of the rig file by name.
    fn entries(&self, section: &str) -> impl Iterator<Item = (&str, &DeTable<'text>)> {
        let found = self.tree.get(section).map(Spanned::get_ref);
        let entries = found.and_then(DeValue::as_table).into_iter().flatten();
        entries.filter_map(|(name, value)| Some((&**name.get_ref(), value.get_ref().as_table()?)))
    }

    /// Returns the plant or the node of the rig file with this name.
    fn entry(&self, section: &str, name: &Key<'text>) -> Result<&DeTable<'text>, Problem> {
        let mut entries = self.entries(section);
        if let Some((_, entry)) = entries.find(|(known, _)| known == name.get_ref()) {
            return Ok(entry);
        }
        let known = Vec::from_iter(self.entries(section).map(|(known, _)| known));
        let message = format!("the rig has no {section} `{}`", name.get_ref());
        let label = match known.as_slice() {
            [] => format!("it has no {section}s"),
            known => meant_or_known(name.get_ref(), known),
        };
        let help = "this table gives other values to the scenario's rig: play it on a rig that has this, or leave it out";
        Err(self.problem(name.span(), message, label).with_help(help))
    }

    /// Refuses the name of a plant's model, which only a rig file has.
    fn with_model(
        &self,
        plant: &Key<'text>,
        model: &str,
        values: &DeTable<'text>,
    ) -> Option<Problem> {
        let models = &schema::RIG["definitions"]["PlantModel"]["properties"];
        let is_model = |(key, value): &(&Key<'_>, &Value<'_>)| {
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
    fn part(&self, name: &Key<'text>, part: &Key<'text>, node: &DeTable<'text>) -> Option<Problem> {
        let (name, key): (&str, &str) = (name.get_ref(), part.get_ref());
        if !VALUES.contains(&key) && !node.contains_key(key) {
            let parts = node
                .iter()
                .filter(|(_, value)| value.get_ref().is_table())
                .map(|(part, _)| part.get_ref().as_ref());
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

    /// Refuses a key that is for the rig file alone.
    fn wiring(&self, table: &DeTable<'text>, wiring: &[&str]) -> Option<Problem> {
        let key = first_key(table, wiring)?;
        let message = format!("a scenario cannot give its rig another `{}`", key.get_ref());
        let problem = self.problem(key.span(), message, "only the rig file says this");
        let help = "a scenario changes the values of its rig, not its wiring; `--rig FILE` plays it on another rig";
        Some(problem.with_help(help))
    }

    fn problem(&self, span: Range<usize>, message: String, label: impl Into<String>) -> Problem {
        self.scenario.source.problem(span, message, label)
    }

    /// Gives problems the paths of the scenario, which are without the names of models.
    fn without_models(&self, problems: Vec<Problem>) -> impl Iterator<Item = Problem> {
        let paths = self.entries(PLANT).filter_map(|(plant, models)| {
            let short = format!("{PLANT}.{plant}");
            Some((
                format!("{short}.{}", models.keys().next()?.get_ref()),
                short,
            ))
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
fn first_key<'a, 'text>(table: &'a DeTable<'text>, keys: &[&str]) -> Option<&'a Key<'text>> {
    table.iter().find_map(|(key, value)| match value.get_ref() {
        _ if keys.contains(&key.get_ref().as_ref()) => Some(key),
        DeValue::Table(below) if key.get_ref() != "start" => first_key(below, keys),
        _ => None,
    })
}

fn table_at<'text>(at: &Range<usize>, table: DeTable<'text>) -> Value<'text> {
    Spanned::new(at.clone(), DeValue::Table(table))
}

/// Copies a table of another file; every value gets one place of this file.
fn placed_table<'text>(table: &DeTable<'text>, at: &Range<usize>) -> DeTable<'text> {
    let entries = table.iter().map(|(key, value)| {
        let key = Spanned::new(at.clone(), key.get_ref().clone());
        (key, placed(value, at))
    });
    entries.collect()
}

fn placed<'text>(value: &Value<'text>, at: &Range<usize>) -> Value<'text> {
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
