//! Divides the expectations among the loops, and the bus that they share.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::nodes::fill;
use super::sections::{ALL, CONTOUR, EXPECT, Selector};
use crate::error::Problem;
use crate::metrics::{Metric, is_of_bus as is_metric_of_bus};

const TIMING: &str = "timing";
const REQUIREMENTS: &str = "requirements";

/// Checks whether a key of `[expect]` belongs to all loops together.
pub(super) fn is_of_all(key: &str) -> bool {
    key == CONTOUR || key == REQUIREMENTS || is_of_bus(key)
}

/// Checks whether a key of `[expect]` is about the bus and the computer.
fn is_of_bus(key: &str) -> bool {
    key == TIMING || is_metric_of_bus(key)
}

impl<'text> Selector<'_, 'text> {
    /// Returns `[expect.LOOP]`, completed from `[expect.all]`. The first loop also gets the expectations of the bus from
    /// `[expect]`. If there is one loop, its table may be `[expect]` itself.
    pub(super) fn expect(&self, name: &str) -> Option<Spanned<DeValue<'text>>> {
        let expect = self.root().get(EXPECT)?;
        let whole = match self.table(expect) {
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
        let of_all = whole.get(ALL).filter(|_| !self.is_led(name));
        let mut kept = match whole.get(name).or(of_all) {
            Some(kept) => kept.clone(),
            None => Spanned::new(expect.span(), DeValue::Table(DeTable::new())),
        };
        // A value that is no table is refused later.
        if let DeValue::Table(table) = kept.get_mut() {
            if let Some(all) = of_all.and_then(|all| self.table(all)) {
                add(table, all);
            }
            if self
                .rig
                .loops
                .keys()
                .next()
                .is_some_and(|first| first == name)
            {
                let of_bus = whole.iter().filter(|(key, _)| {
                    let key: &str = key.get_ref();
                    is_of_bus(key) || key == REQUIREMENTS
                });
                let of_bus = of_bus.map(|(key, value)| (key.clone(), value.clone()));
                add(table, &of_bus.collect());
            }
        }
        Some(kept)
    }

    /// Finds expectations of all loops in the table of one loop, and the other way round.
    pub(super) fn misplaced(&self, loops: &[&str]) -> Vec<Problem> {
        if !self.is_by_loop(EXPECT) {
            return Vec::new();
        }
        let own = loops.iter().chain([&ALL]).flat_map(|name| {
            let path = format!("{EXPECT}.{name}");
            let keys = self.scenario.keys(&path).into_iter();
            let of_bus = keys.filter(|key| is_of_bus(key) || *key == CONTOUR);
            let problems = of_bus.map(|key| self.of_no_loop(&path, key));
            Vec::from_iter(problems)
        });
        let path = format!("{EXPECT}.{REQUIREMENTS}");
        let keys = self.scenario.keys(&path).into_iter();
        let is_of_loop = |key: &&str| !is_of_bus(key) && Metric::named(key).is_some();
        let of_loops = keys.filter(is_of_loop).map(|key| {
            let span = self.scenario.key_span(&format!("{path}.{key}"));
            let message = format!("`{key}` of which loop?");
            let label = format!("write [{EXPECT}.LOOP.{REQUIREMENTS}]");
            self.scenario.source.problem(span, message, label)
        });
        own.chain(of_loops).collect()
    }

    fn of_no_loop(&self, path: &str, key: &str) -> Problem {
        let span = self.scenario.key_span(&format!("{path}.{key}"));
        let message = format!("`{key}` is of the whole bus, not of one loop");
        let problem = (self.scenario.source).problem(span, message, "all loops share it");
        problem.with_help(format!("move it to [{EXPECT}]"))
    }
}

/// Adds the limits that are missing, each as a whole, and the requirements of those that are there.
fn add<'text>(limits: &mut DeTable<'text>, others: &DeTable<'text>) {
    for (key, other) in others {
        let name: &str = key.get_ref();
        match (limits.get_mut(name).map(Spanned::get_mut), other.get_ref()) {
            (None, _) => drop(limits.insert(key.clone(), other.clone())),
            (Some(DeValue::Table(own)), DeValue::Table(other)) if name == REQUIREMENTS => {
                fill(own, other);
            }
            (Some(_), _) => {}
        }
    }
}
