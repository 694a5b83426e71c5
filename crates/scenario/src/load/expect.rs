//! Divides the expectations among the loops, and the bus that they share.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::nodes::fill;
use super::sections::{ALL, CONTOUR, EXPECT, Selector};
use crate::error::Problem;
use crate::metrics::{Metric, is_bus_metric};

const TIMING: &str = "timing";
const REQUIREMENTS: &str = "requirements";

/// Checks whether a key of `[expect]` belongs to all loops together.
pub(super) fn is_shared(key: &str) -> bool {
    key == CONTOUR || key == REQUIREMENTS || is_bus_key(key)
}

/// Checks whether a key of `[expect]` is about the bus and the computer.
fn is_bus_key(key: &str) -> bool {
    key == TIMING || is_bus_metric(key)
}

impl<'text> Selector<'_, 'text> {
    /// Returns `[expect.LOOP]`, completed from `[expect.all]`. The first loop also gets the expectations of the bus from
    /// `[expect]`. If there is one loop, its table may be `[expect]` itself.
    pub(super) fn expect(&self, name: &str) -> Option<Spanned<DeValue<'text>>> {
        let expect = self.scenario.root().get(EXPECT)?;
        let whole = match expect.get_ref().as_table() {
            Some(whole) if self.is_by_loop(EXPECT) => whole,
            // Expectations of the only loop do not hold for a further drive that its law leads.
            _ if self.is_led(name) => return None,
            _ => {
                let mut kept = expect.clone();
                if let DeValue::Table(table) = kept.get_mut() {
                    table.remove(CONTOUR);
                }
                return Some(kept);
            }
        };
        let for_all = whole.get(ALL).filter(|_| !self.is_led(name));
        let mut kept = match whole.get(name).or(for_all) {
            Some(kept) => kept.clone(),
            None => Spanned::new(expect.span(), DeValue::Table(DeTable::new())),
        };
        // A value that is no table is refused later.
        if let DeValue::Table(table) = kept.get_mut() {
            if let Some(all) = for_all.and_then(|all| all.get_ref().as_table()) {
                add(table, all);
            }
            let first = self.rig.loops.keys().next();
            if first.is_some_and(|first| first == name) {
                let is_for_bus = |key: &str| is_bus_key(key) || key == REQUIREMENTS;
                let for_bus = whole
                    .iter()
                    .filter(|(key, _)| is_for_bus(key.get_ref()))
                    .map(|(key, value)| (key.clone(), value.clone()));
                add(table, &for_bus.collect());
            }
        }
        Some(kept)
    }

    /// Finds expectations of all loops in the table of one loop, and the other way round.
    pub(super) fn misplaced(&self, loops: &[&str]) -> Vec<Problem> {
        if !self.is_by_loop(EXPECT) {
            return Vec::new();
        }
        let misplaced = loops.iter().chain([&ALL]).flat_map(|name| {
            let path = format!("{EXPECT}.{name}");
            let keys = self.scenario.keys(&path).into_iter();
            let shared = keys.filter(|key| is_bus_key(key) || *key == CONTOUR);
            let problems = shared.map(|key| {
                let message = format!("`{key}` is of the whole bus, not of one loop");
                let path = format!("{path}.{key}");
                let problem = self
                    .scenario
                    .key_problem(&path, message, "all loops share it");
                problem.with_help(format!("move it to [{EXPECT}]"))
            });
            Vec::from_iter(problems)
        });
        let path = format!("{EXPECT}.{REQUIREMENTS}");
        let keys = self.scenario.keys(&path).into_iter();
        let is_loop_key = |key: &&str| !is_bus_key(key) && Metric::named(key).is_some();
        let without_loop = keys.filter(is_loop_key).map(|key| {
            let message = format!("`{key}` of which loop?");
            let label = format!("write [{EXPECT}.LOOP.{REQUIREMENTS}]");
            self.scenario
                .key_problem(&format!("{path}.{key}"), message, label)
        });
        misplaced.chain(without_loop).collect()
    }
}

/// Adds the limits that are missing, each as a whole, and the requirements of those that are there.
fn add<'text>(limits: &mut DeTable<'text>, others: &DeTable<'text>) {
    for (key, other) in others {
        let name: &str = key.get_ref();
        match (limits.get_mut(name).map(Spanned::get_mut), other.get_ref()) {
            (None, _) => drop(limits.insert(key.clone(), other.clone())),
            (Some(DeValue::Table(known)), DeValue::Table(other)) if name == REQUIREMENTS => {
                fill(known, other);
            }
            (Some(_), _) => {}
        }
    }
}
