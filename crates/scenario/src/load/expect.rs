//! Divides the expectations among the loops, and the bus that they share.

use std::collections::BTreeSet;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::nodes::fill;
use super::sections::{ALL, CONTOUR, EXPECT, Selector};
use crate::document::Document;
use crate::error::Problem;
use crate::fault::{Fault, Faults};
use crate::metrics::{Form, METRICS, Metric, Needs, Subject, is_bus_metric};
use crate::nearest::nearest;
use crate::schema;
use crate::wiring::Wiring;

const TIMING: &str = "timing";
const JUDGED_UNTIL: &str = "judged_until_seconds";
/// Expectations of signals, of a loop or of the bus.
const OF_SIGNALS: [&str; 2] = ["signal", "sequence"];
const REQUIREMENTS: &str = "requirements";

/// Checks whether a key of `[expect]` belongs to all loops together.
pub(super) fn is_shared(key: &str) -> bool {
    key == CONTOUR || key == REQUIREMENTS || is_bus_key(key)
}

/// Checks whether a key of `[expect]` is about the bus and the computer.
fn is_bus_key(key: &str) -> bool {
    key == TIMING || is_bus_metric(key)
}

/// Checks whether a key of `[expect.requirements]` is, too: the name of a limit on timing begins with its key.
fn is_bus_requirement(key: &str) -> bool {
    let timing = &schema::RUN["definitions"]["TimingLimits"]["properties"];
    let mut timing = timing.as_object().into_iter().flatten();
    is_bus_metric(key) || timing.any(|(limit, _)| key.starts_with(limit))
}

/// Finds expectations of a loop in the scenario of a rig without one: there, signals and sequences are of the bus.
pub(super) fn of_no_loop(scenario: &Document<'_>) -> Vec<Problem> {
    let is_of_bus = |key: &&str| is_shared(key) || OF_SIGNALS.contains(key);
    let of_loops = scenario
        .keys(EXPECT)
        .into_iter()
        .filter(|key| !is_of_bus(key));
    let problems = of_loops.map(|key| {
        let path = format!("{EXPECT}.{key}");
        let message = format!("`{key}` of which loop?");
        scenario.key_problem(&path, message, "the rig has no loop")
    });
    problems.collect()
}

/// Leaves those limits in `[expect]` that are on the bus, or those on the only loop, with their requirements.
pub(super) fn keep_part(expect: &mut DeValue<'_>, is_of_bus: bool) {
    if let DeValue::Table(whole) = expect {
        let is_limit = |key: &str| key != CONTOUR && is_bus_key(key) == is_of_bus;
        *whole = part_of(whole, is_limit, |key| is_bus_requirement(key) == is_of_bus);
    }
}

impl<'text> Selector<'_, 'text> {
    /// Returns `[expect.LOOP]`, completed from `[expect.all]`. If there is one loop, its table may be `[expect]` itself, without the
    /// limits on the bus. A further drive, which has no set-point, gets what these limit of its amplifier and its plant.
    pub(super) fn expect(
        &self,
        name: &str,
        wiring: &Wiring,
        faults: &Faults,
    ) -> Option<Spanned<DeValue<'text>>> {
        let expect = self.scenario.root().get(EXPECT)?;
        let whole = match expect.get_ref().as_table() {
            Some(whole) if self.is_by_loop(EXPECT) => whole,
            Some(whole) if self.is_led(name) => {
                let kept = DeValue::Table(of_drive(whole, wiring, faults));
                return Some(Spanned::new(expect.span(), kept));
            }
            _ => {
                let mut kept = expect.clone();
                keep_part(kept.get_mut(), false);
                return Some(kept);
            }
        };
        let for_all = whole.get(ALL);
        let mut kept = match whole.get(name).or(for_all.filter(|_| !self.is_led(name))) {
            Some(kept) => kept.clone(),
            None => Spanned::new(expect.span(), DeValue::Table(DeTable::new())),
        };
        // A value that is no table is refused later.
        if let DeValue::Table(table) = kept.get_mut() {
            match for_all.and_then(|all| all.get_ref().as_table()) {
                Some(all) if self.is_led(name) => add(table, &of_drive(all, wiring, faults)),
                Some(all) if whole.contains_key(name) => add(table, all),
                _ => {}
            }
        }
        Some(kept)
    }

    /// Finds expectations of all loops in the table of one loop, and the other way round.
    pub(super) fn misplaced(&self, loops: &[&str]) -> Vec<Problem> {
        if !self.is_by_loop(EXPECT) {
            return Vec::new();
        }
        let tables = loops.iter().chain([&ALL]);
        let tables = tables.flat_map(|name| [("", name), (".requirements", name)]);
        let misplaced = tables.flat_map(|(below, name)| {
            let path = format!("{EXPECT}.{name}{below}");
            let keys = self.scenario.keys(&path).into_iter();
            let is_shared = |key: &&str| *key == CONTOUR || is_bus_key(key);
            let shared = keys.filter(|key| is_shared(key) || is_bus_requirement(key));
            let problems = shared.map(|key| {
                let message = format!("`{key}` is of the whole bus, not of one loop");
                let path = format!("{path}.{key}");
                let problem = self
                    .scenario
                    .key_problem(&path, message, "all loops share it");
                problem.with_help(format!("move it to [{EXPECT}{below}]"))
            });
            Vec::from_iter(problems)
        });
        let path = format!("{EXPECT}.{REQUIREMENTS}");
        let keys = self.scenario.keys(&path).into_iter();
        let of_loops = keys.filter(|key| !is_bus_requirement(key));
        let without_loop = of_loops.map(|key| {
            let message = format!("`{key}` of which loop?");
            let of_bus = METRICS.iter().map(|metric| metric.name);
            let label = match nearest(key, of_bus.filter(|name| is_bus_metric(name))) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => format!("write [{EXPECT}.LOOP.{REQUIREMENTS}]"),
            };
            self.scenario
                .key_problem(&format!("{path}.{key}"), message, label)
        });
        misplaced.chain(without_loop).collect()
    }
}

/// Returns the limits on a drive and its plant, with their requirements, and the end of the judgement; reactions to faults only if it
/// has faults.
fn of_drive<'text>(limits: &DeTable<'text>, wiring: &Wiring, faults: &Faults) -> DeTable<'text> {
    let is_hit = |fault: &Fault| wiring.is_hit_by(fault, wiring.drive, &wiring.plant);
    let has_faults = faults.iter().any(is_hit);
    let is_its = |metric: &&Metric| {
        ![Subject::Cycles, Subject::Bus].contains(&metric.subject)
            && metric.form != Form::List
            && (metric.needs == Needs::Nothing || metric.needs == Needs::Fault && has_faults)
    };
    let patterns = METRICS.iter().filter(is_its).map(|metric| metric.name);
    let names = patterns.map(|name| wiring.quantities.name(name));
    let names = BTreeSet::from_iter(names.chain([JUDGED_UNTIL.to_owned()]));
    part_of(limits, |key| names.contains(key), |key| names.contains(key))
}

/// Returns the limits that are kept, and those requirements whose keys are.
fn part_of<'text>(
    limits: &DeTable<'text>,
    is_limit: impl Fn(&str) -> bool,
    is_required: impl Fn(&str) -> bool,
) -> DeTable<'text> {
    let mut kept = kept_of(limits, |key| key == REQUIREMENTS || is_limit(key));
    if let Some(DeValue::Table(named)) = kept.get_mut(REQUIREMENTS).map(Spanned::get_mut) {
        *named = kept_of(named, is_required);
    }
    kept
}

/// Returns the entries of a table whose keys are kept.
fn kept_of<'text>(table: &DeTable<'text>, is_kept: impl Fn(&str) -> bool) -> DeTable<'text> {
    let kept = table.iter().filter(|(key, _)| is_kept(key.get_ref()));
    kept.map(|(key, value)| (key.clone(), value.clone()))
        .collect()
}

/// Adds the limits that are missing, each as a whole, the entries of lists, and the requirements of those that are there.
fn add<'text>(limits: &mut DeTable<'text>, others: &DeTable<'text>) {
    for (key, other) in others {
        let name: &str = key.get_ref();
        match (limits.get_mut(name).map(Spanned::get_mut), other.get_ref()) {
            (None, _) => drop(limits.insert(key.clone(), other.clone())),
            (Some(DeValue::Table(known)), DeValue::Table(other)) if name == REQUIREMENTS => {
                fill(known, other);
            }
            (Some(DeValue::Array(known)), DeValue::Array(other)) if name != "emcy" => {
                other.iter().for_each(|one| known.push(one.clone()));
            }
            (Some(_), _) => {}
        }
    }
}
