//! Divides the tables of a scenario among the loops: by the loop's name, by that of its drive, or to the only loop.
//!
//! The division works on the tree of the file, before any type is made of it, so that every value keeps its place.

use std::mem;
use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::expect;
use super::{Factors, Naming};
use crate::custom::leads_all;
use crate::document::Document;
use crate::error::Problem;
use crate::fault::Faults;
use crate::nearest::meant_or_known;
use crate::rig::nodes::{Rig, output_of_kind};
use crate::schema;
use crate::wiring::{LoopFacts, SharedWiring, Wiring};

/// Key of the law of all loops.
pub(crate) const ALL: &str = "all";
/// Key of the limits of several loops together.
pub(super) const CONTOUR: &str = "contour";
/// Keys of a scenario that hold for all loops.
pub(super) const SHARED: [&str; 6] = [
    "schema",
    "name",
    "description",
    "requirements",
    "seed",
    "duration_seconds",
];
/// Tables that belong to one loop or one node, and the rig with its values.
const TABLES: [&str; 9] = [
    "rig",
    "bus",
    "plant",
    "node",
    "controller",
    "reference",
    DISTURBANCE,
    "fault",
    "sweep",
];
/// Keys of a rig file that a scenario cannot change.
const RIG_KEYS: [&str; 2] = ["defaults", "loop"];
pub(super) const EXPECT: &str = "expect";
pub(crate) const CONTROLLER: &str = "controller";
const REFERENCE: &str = "reference";
pub(super) const DISTURBANCE: &str = "disturbance";
/// Table of a drive that a program or the law of another drive leads.
const NO_LAW: &str = "{ open_loop = {} }";
/// Key that names a node.
const NODE: &str = "node";

/// Selects the tables of the rig's loops from a scenario.
pub(super) struct Selector<'a, 'text> {
    pub(super) scenario: &'a Document<'text>,
    pub(super) rig: &'a Rig,
    pub(super) shared: Arc<SharedWiring>,
}

/// The part of a scenario for one loop.
pub(super) struct LoopTables<'text> {
    /// Wiring of the loop's drive.
    pub(super) wiring: Wiring,
    /// Tables of the loop.
    pub(super) tree: DeTable<'text>,
    /// Factors for parameters of its law.
    pub(super) factors: Factors,
}

impl<'text> Selector<'_, 'text> {
    /// Returns the parts of all loops in a run with these faults, and the problems of how the scenario names them.
    pub(super) fn select(&self, faults: &Faults) -> (Vec<LoopTables<'text>>, Vec<Problem>) {
        let loops = Vec::from_iter(self.rig.loops.keys().map(String::as_str));
        let leading = Vec::from_iter(loops.iter().copied().filter(|name| !self.is_led(name)));
        // A law of no loop is not a problem of each loop that lacks a law, too; a law that is left out is no law at all.
        let mut problems = if self.rig.is_led_by_program() {
            Vec::new()
        } else {
            self.unknown_tables(CONTROLLER, &leading)
        };
        let is_law_said = !problems.is_empty();
        let unknown = self.unknown_names(&loops, &leading);
        // The loop that such an entry means lacks it.
        if !unknown.is_empty() {
            problems.extend(unknown);
            return (Vec::new(), problems);
        }
        let mut tables = Vec::new();
        for name in self.rig.loops.keys() {
            if is_law_said && self.law(name).is_err() {
                continue;
            }
            match self.loop_tables(name, faults) {
                Ok(loop_tables) => tables.push(loop_tables),
                Err(problem) => problems.push(problem),
            }
        }
        (tables, problems)
    }

    /// Checks whether a loop represents a drive that the law of another loop leads.
    pub(super) fn is_led(&self, name: &str) -> bool {
        let one = self.rig.loops.get(name);
        one.is_some_and(|one| one.led_by.is_some())
    }

    fn loop_tables(&self, name: &str, faults: &Faults) -> Result<LoopTables<'text>, Problem> {
        let mut tables = DeTable::new();
        let key = |name: &'static str| Spanned::new(self.scenario.key_span(name), name.into());
        let (place, law) = self.law(name)?;
        tables.insert(Spanned::new(place, CONTROLLER.into()), law);
        let reference = self.scenario.root().get(REFERENCE);
        if let Some(value) = reference.filter(|_| !self.is_led(name)) {
            let mut kept = value.clone();
            self.keep(kept.get_mut(), name);
            tables.insert(key(REFERENCE), kept);
        }
        let wiring = (self.rig).wiring_in(&self.shared, self.rig.drive_of_loop(name));
        if let Some(expect) = self.expect(name, &wiring, faults) {
            tables.insert(key(EXPECT), expect);
        }
        let naming = Naming {
            source: &self.scenario.source,
            quantities: &wiring.quantities,
            loop_name: name,
            schema: &schema::TRIAL,
        };
        let factors = naming.apply(&mut tables, naming.schema);
        let factors = factors.map_err(|problem| self.with_loop_s_own(problem, name))?;
        Ok(LoopTables {
            wiring,
            tree: tables,
            factors,
        })
    }

    /// Says where a key belongs that is in a table for all loops and is not that of this loop, whose quantity is another one.
    fn with_loop_s_own(&self, problem: Problem, name: &str) -> Problem {
        let mut loops = self.shared.loops.iter();
        let own = loops.clone().find(|one| one.name == name);
        let is_own = |one: &LoopFacts| own.is_some_and(|own| own.quantities == one.quantities);
        let is_like_all = loops.all(is_own);
        let place = problem.place_and_label().0.filter(|_| !is_like_all);
        let section = [CONTROLLER, EXPECT].into_iter().find(|section| {
            let for_all = self.scenario.spanned(&format!("{section}.{ALL}"));
            let has = |place| for_all.is_some_and(|table| has_key_at(table.get_ref(), place));
            place.is_some_and(has)
        });
        let Some(section) = section else {
            return problem;
        };
        problem.with_help(format!(
            "the loops differ in their quantities: what is of `{name}` belongs in [{section}.{name}]"
        ))
    }

    /// Returns `[controller.LOOP.LAW]`, else `[controller.all.LAW]`, and for an only loop also `[controller.LAW]`, with the place
    /// of its key.
    fn law(&self, name: &str) -> Result<(Range<usize>, Spanned<DeValue<'text>>), Problem> {
        if self.is_led(name) || self.rig.is_led_by_program() {
            let law = DeValue::parse(NO_LAW).expect("it is TOML");
            return Ok((self.scenario.key_span(CONTROLLER), law));
        }
        if let Some(problem) = self.law_for_all(name) {
            return Err(problem);
        }
        let only = (!self.is_by_loop(CONTROLLER)).then(|| CONTROLLER.to_owned());
        let by_loop = [name, ALL].map(|table| format!("{CONTROLLER}.{table}"));
        let law = by_loop.into_iter().chain(only).find_map(|path| {
            let law = self.scenario.spanned(&path)?.clone();
            Some((self.scenario.key_span(&path), law))
        });
        law.ok_or_else(|| {
            let message = format!("no law closes the loop `{name}`");
            let label =
                format!("[controller.{name}.LAW] is missing, and so is [controller.{ALL}.LAW]");
            self.scenario.problem(CONTROLLER, message, label)
        })
    }

    /// Refuses a law of all loops together with another law, or as the law of one of several loops.
    fn law_for_all(&self, name: &str) -> Option<Problem> {
        let with_ports = |key: &str| {
            let laws = self.scenario.keys(&format!("{CONTROLLER}.{key}"));
            laws.into_iter().find(|law| leads_all(law))
        };
        let path = format!("{CONTROLLER}.{name}");
        let (message, label) =
            if let Some(law) = with_ports(name).filter(|_| !self.rig.has_only_loop()) {
                let message = format!("the law `{law}` leads all loops, not `{name}` alone");
                (message, format!("write [{CONTROLLER}.{ALL}.{law}]"))
            } else {
                let law = with_ports(ALL).filter(|_| self.scenario.has(&path))?;
                let message = format!("two laws lead the loop `{name}`");
                (message, format!("`{law}` leads all loops already"))
            };
        Some(self.scenario.key_problem(&path, message, label))
    }

    /// Checks whether the tables of a section have the names of loops; those of an only loop need not.
    pub(super) fn is_by_loop(&self, section: &str) -> bool {
        // Without loops, what is expected is expected of the bus.
        if section == EXPECT && self.rig.loops.is_empty() {
            return false;
        }
        let keys = self.scenario.keys(section);
        let is_name = |key: &&str| *key == ALL || self.rig.loops.contains_key(*key);
        !self.rig.has_only_loop() || keys.iter().any(is_name)
    }

    /// Keeps the entries of the arrays, such as `reference.step`, that are for this loop.
    fn keep(&self, value: &mut DeValue<'text>, name: &str) {
        let DeValue::Table(kinds) = value else {
            return;
        };
        for (_, entries) in kinds.iter_mut() {
            if let DeValue::Array(entries) = entries.get_mut() {
                let all = mem::replace(entries, DeArray::new()).into_iter();
                *entries = all.filter_map(|entry| self.kept(entry, name)).collect();
            }
        }
    }

    /// Returns an entry without the name of its loop, if it is for this loop.
    fn kept(
        &self,
        mut entry: Spanned<DeValue<'text>>,
        name: &str,
    ) -> Option<Spanned<DeValue<'text>>> {
        let DeValue::Table(table) = entry.get_mut() else {
            return Some(entry);
        };
        match table.remove("loop") {
            Some(wanted) => (wanted.get_ref().as_str() == Some(name)).then_some(entry),
            None => self.rig.has_only_loop().then_some(entry),
        }
    }

    /// Finds loops and nodes that the scenario names and the rig does not have; only loops with a law have a set-point.
    fn unknown_names(&self, loops: &[&str], leading: &[&str]) -> Vec<Problem> {
        let mut problems = Vec::new();
        let nodes = Vec::from_iter(self.rig.node.keys().map(String::as_str));
        for (section, by, known) in [(REFERENCE, "loop", leading), (DISTURBANCE, NODE, &nodes)] {
            // The structure refuses other keys.
            let kinds = self.scenario.keys(section).into_iter();
            for kind in kinds.filter(|kind| schema::is_key(section, kind)) {
                let path = format!("{section}.{kind}");
                for (place, entry) in self.scenario.entries(&path).iter().enumerate() {
                    let path = format!("{path}.{place}");
                    let unknown_name = |table| self.unknown_name(table, [kind, &path], by, known);
                    problems.extend(entry.get_ref().as_table().and_then(unknown_name));
                }
            }
        }
        problems.extend(self.unknown_tables(EXPECT, loops));
        problems.extend(self.misplaced(loops));
        problems
    }

    /// Finds keys that no scenario has.
    pub(super) fn unknown_keys(&self) -> Vec<Problem> {
        let known = Vec::from_iter(SHARED.into_iter().chain(TABLES).chain([EXPECT]));
        let keys = self.scenario.root().keys();
        let unknown = keys.filter(|key| !known.contains(&key.get_ref().as_ref()));
        let problems = unknown.map(|key| {
            let name: &str = key.get_ref();
            let message = format!("unknown key `{name}` in the scenario");
            let label = if RIG_KEYS.contains(&name) {
                "a table of rig files".to_owned()
            } else {
                meant_or_known(name, &known)
            };
            self.scenario.source.problem(key.span(), message, label)
        });
        problems.collect()
    }

    /// Finds `[controller.NAME]` and `[expect.NAME]` of an unknown loop.
    fn unknown_tables(&self, section: &str, loops: &[&str]) -> Vec<Problem> {
        if !self.is_by_loop(section) {
            return Vec::new();
        }
        let is_known = |key: &&str| {
            loops.contains(key) || *key == ALL || section == EXPECT && expect::is_shared(key)
        };
        let keys = self.scenario.keys(section).into_iter();
        let unknown = keys.filter(|key| !is_known(key));
        let problems = unknown.map(|key| {
            let is_limit = section == EXPECT && self.rig.has_limit(key);
            let (message, label) = if is_limit || schema::is_key(section, key) {
                let label = match loops.first() {
                    Some(first) => {
                        format!("write [{section}.{first}], or [{section}.{ALL}] for all loops")
                    }
                    None => "the rig has no loop".to_owned(),
                };
                (format!("`{key}` of which loop?"), label)
            } else {
                let message = format!("the rig has no loop `{key}`");
                (message, meant_or_known(key, loops))
            };
            self.scenario
                .key_problem(&format!("{section}.{key}"), message, label)
        });
        problems.collect()
    }

    fn unknown_name(
        &self,
        table: &DeTable<'text>,
        [kind, path]: [&str; 2],
        by: &str,
        known: &[&str],
    ) -> Option<Problem> {
        let Some(named) = table.get(by) else {
            let output = output_name(kind, table);
            let with = Vec::from_iter(self.rig.io_with(output).filter(|_| by == NODE));
            let (is_clear, known) = match with.len() {
                // An output that no node has is refused as that.
                0 => (self.rig.has_only_loop() || by == NODE, known),
                count => (count == 1, &*with),
            };
            let message = format!("for which {by}?");
            let label = format!("`{by}` is missing; known are: {}", known.join(", "));
            return (!is_clear).then(|| self.scenario.problem(path, message, label));
        };
        let name = named.get_ref().as_str().unwrap_or_default();
        (!known.contains(&name)).then(|| {
            let message = format!("the rig has no {by} `{name}`");
            let label = meant_or_known(name, known);
            self.scenario
                .problem(&format!("{path}.{by}"), message, label)
        })
    }
}

/// Checks whether a key of a table, or of one below it, begins at this place of the text.
fn has_key_at(value: &DeValue<'_>, place: usize) -> bool {
    let mut keys = value.as_table().into_iter().flatten();
    keys.any(|(key, below)| key.span().start == place || has_key_at(below.get_ref(), place))
}

/// Returns the output of an io node that an entry of a disturbance sets.
fn output_name<'a>(kind: &str, entry: &'a DeTable<'_>) -> &'a str {
    let name = entry.get("name").and_then(|name| name.get_ref().as_str());
    output_of_kind(kind).or(name).unwrap_or_default()
}
