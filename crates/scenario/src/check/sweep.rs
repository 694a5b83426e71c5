//! Checks of `[sweep]`: keys are numbers of this scenario, and their values are ones that they admit.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::LazyLock;

use serde_json::{Value, json};
use toml::Spanned;
use toml::de::DeValue;

use super::Check;
use crate::document::Document;
use crate::load::only_one;
use crate::nearest::nearest;
use crate::schema::{MULTIPLE_OF, resolve};
use crate::structure::{broken_limit, join, out_of_range};
use crate::sweep::{LogUniform, RUNS_MAX, Spacing, Sweep, Uniform};
use crate::{schema, sweep};

/// Schema of a number under a key that the user chooses.
static NUMBER: LazyLock<Value> = LazyLock::new(|| json!({"type": "number"}));
/// Tables of the format itself, which cannot be swept.
const NOT_SWEPT: [&str; 2] = ["schema", "sweep"];
/// Checks, which cannot be swept either: their names in the verdict contain their windows and limits.
const CHECKS: [&str; 2] = [".signal", ".sequence"];

/// Checks the sweep of a scenario, and notes in it which keys are whole numbers.
pub(crate) fn check(check: &mut Check<'_>, sweep: &mut Sweep) {
    let schema = schema::on_rig(check.rig);
    let mut checker = Checker {
        keys: Keys::new(&schema, check),
        check,
        has_few_runs: sweep.runs() <= RUNS_MAX,
        seen: BTreeSet::new(),
    };
    for (index, list) in sweep.list.iter().enumerate() {
        checker.list(&format!("sweep.list.{index}"), list);
    }
    for (index, range) in sweep.range.iter().enumerate() {
        checker.range(&format!("sweep.range.{index}"), range);
    }
    for (index, Uniform { key, from, to }) in sweep.uniform.iter().enumerate() {
        checker.drawn_between(&format!("sweep.uniform.{index}"), key, *from, *to);
    }
    for (index, LogUniform { key, from, to }) in sweep.log_uniform.iter().enumerate() {
        checker.drawn_between(&format!("sweep.log_uniform.{index}"), key, *from, *to);
    }
    for (index, normal) in sweep.normal.iter().enumerate() {
        let path = format!("sweep.normal.{index}");
        checker.drawn(&path, &normal.key, &[("mean", normal.mean)]);
    }
    checker.whole(sweep);
    let keys = &checker.keys.0;
    let is_whole = |key: &&str| keys.get(*key).is_some_and(|schema| is_integer(schema));
    sweep.whole_numbers = sweep.keys().filter(is_whole).map(str::to_owned).collect();
}

/// Numbers of a scenario by their dotted paths, each with its schema.
struct Keys<'a>(BTreeMap<String, &'a Value>);

impl<'a> Keys<'a> {
    fn new(schema: &'a Value, check: &Check<'_>) -> Self {
        let mut keys = Self(BTreeMap::new());
        keys.collect(schema, schema, check.document, "");
        // Numbers of a loop are below its name.
        if !check.rig.has_only_loop() {
            let is_of_no_loop = |key: &str| {
                key.strip_prefix("expect.")
                    .is_none_or(|key| key.contains('.'))
            };
            keys.0.retain(|key, _| is_of_no_loop(key));
        }
        keys
    }

    /// Collects the numbers below the table at a key.
    fn collect(&mut self, root: &'a Value, table: &'a Value, document: &Document<'_>, key: &str) {
        for (name, property) in table["properties"].as_object().into_iter().flatten() {
            let key = join(key, name);
            let path = path_of(&key);
            let is_check =
                key.starts_with("expect.") && CHECKS.iter().any(|check| key.ends_with(check));
            if is_check || NOT_SWEPT.contains(&key.as_str()) {
                continue;
            }
            let schema = resolve(root, property);
            match schema["type"].as_str() {
                Some("number" | "integer") => {
                    self.0.insert(key, schema);
                }
                // A table without a default is a choice, such as the law, which a number does not make.
                Some("object") if document.has(&path) || property.get("default").is_some() => {
                    self.collect(root, schema, document, &key);
                    if schema["additionalProperties"].is_object() {
                        self.collect_table(document, &key);
                    }
                }
                Some("array") => {
                    let items = resolve(root, &schema["items"]);
                    for place in 0..document.entries(&path).len() {
                        self.collect(root, items, document, &format!("{key}[{place}]"));
                    }
                }
                _ => {}
            }
        }
    }

    /// Collects the numbers of a table whose keys the user chooses.
    fn collect_table(&mut self, document: &Document<'_>, table: &str) {
        let path = path_of(table);
        for name in document.keys(&path) {
            let value = document.spanned(&join(&path, name)).map(Spanned::get_ref);
            if let Some(DeValue::Float(_) | DeValue::Integer(_)) = value {
                self.0.entry(join(table, name)).or_insert(&NUMBER);
            }
        }
    }

    /// Returns the key that was probably meant: one with the same last name, or one that is spelt alike.
    fn meant(&self, key: &str) -> Option<&str> {
        let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
        let namesakes = self.0.keys().filter(|known| last(known) == last(key));
        only_one(namesakes)
            .map(String::as_str)
            .or_else(|| nearest(key, self.0.keys().map(String::as_str)))
    }
}

/// Returns the path in a document of a key of the sweep: `reference.step.0` for `reference.step[0]`.
fn path_of(key: &str) -> String {
    key.replace('[', ".").replace(']', "")
}

fn is_integer(schema: &Value) -> bool {
    schema["type"] == "integer"
}

struct Checker<'a, 'b> {
    check: &'a mut Check<'b>,
    keys: Keys<'a>,
    /// False if the ranges have too many values to check each.
    has_few_runs: bool,
    seen: BTreeSet<String>,
}

impl<'a> Checker<'a, '_> {
    fn list(&mut self, path: &str, list: &sweep::List) {
        let Some(schema) = self.key(path, &list.key) else {
            return;
        };
        let mut seen = BTreeSet::new();
        for (place, value) in list.values.iter().enumerate() {
            let place = format!("{path}.values.{place}");
            if self.value(&place, &list.key, *value, schema) && !seen.insert(value.to_bits()) {
                let message = format!("{value} is listed twice");
                self.check.at(&place, message, "each value once");
            }
        }
    }

    fn range(&mut self, path: &str, range: &sweep::Range) {
        let Some(schema) = self.key(path, &range.key) else {
            return;
        };
        let is_logarithmic = range.spacing == Spacing::Logarithmic;
        let is_ordered = self.ordered(path, range.from, range.to);
        if range.count.is_some() == range.step.is_some() {
            let often = range.count.map_or("nowhere", |_| "twice");
            let message = format!("the number of values of `{}` is given {often}", range.key);
            self.check
                .at(path, message, "give either `count` or `step`");
        } else if is_logarithmic && range.count.is_none() {
            let message = "a logarithmic range has no step";
            self.check
                .at(&format!("{path}.step"), message, "give `count` instead");
        } else if is_logarithmic && range.from <= 0.0 {
            let message = "a logarithmic range begins above 0";
            self.check
                .at(&format!("{path}.from"), message, "must be above 0");
        } else if is_ordered {
            for (name, value) in [("from", range.from), ("to", range.to)] {
                if !self.value(&format!("{path}.{name}"), &range.key, value, schema) {
                    return;
                }
            }
            let values = Some(range)
                .filter(|_| self.has_few_runs)
                .map(sweep::Range::values);
            let is_wrong = |value: &f64| wrong(*value, schema).is_some();
            if let Some(value) = values.into_iter().flatten().find(is_wrong) {
                self.value(path, &range.key, value, schema);
            }
        }
    }

    fn drawn_between(&mut self, path: &str, key: &str, from: f64, to: f64) {
        if self.ordered(path, from, to) {
            self.drawn(path, key, &[("from", from), ("to", to)]);
        } else {
            self.key(path, key);
        }
    }

    /// Checks a key that is drawn, and the numbers of its distribution that the key itself must admit.
    fn drawn(&mut self, path: &str, key: &str, numbers: &[(&str, f64)]) {
        let Some(schema) = self.key(path, key) else {
            return;
        };
        if schema["enum"].is_array() || schema[MULTIPLE_OF].is_number() {
            let message = format!("`{key}` admits some values only, so it cannot be drawn");
            self.check
                .at(&format!("{path}.key"), message, "use [[sweep.list]]");
            return;
        }
        for (name, value) in numbers {
            // Draws of whole numbers are rounded, so the mean need not be whole.
            if let Some(limits) = broken_limit(*value, schema) {
                let place = format!("{path}.{name}");
                self.check.at(&place, out_of_range(key, *value), limits);
            }
        }
    }

    fn ordered(&mut self, path: &str, from: f64, to: f64) -> bool {
        let is_ordered = from < to;
        if !is_ordered {
            let message = format!("`to` = {to} is not above `from` = {from}");
            let label = format!("must be above {from}");
            self.check.at(&format!("{path}.to"), message, label);
        }
        is_ordered
    }

    /// Returns the schema of a key, or reports that there is none, or that another entry varies it already.
    fn key(&mut self, path: &str, key: &str) -> Option<&'a Value> {
        let Some(schema) = self.keys.0.get(key).copied() else {
            let label = match self.keys.meant(key) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => "no number of this scenario".to_owned(),
            };
            let span = self.within(&format!("{path}.key"), key);
            let message = format!("`{key}` is no number of this scenario");
            let problem = self.check.document.source.problem(span, message, label);
            let mut keys = self.keys.0.keys();
            let plant_key = keys.find(|key| key.starts_with("plant."));
            let example = plant_key.map_or("seed", String::as_str);
            let help = format!(
                "a key is the dotted path of a number, such as {example} or reference.step[0].position_millimetres; \
                 the entry of a list, and the table of the law or plant, must be in the file"
            );
            self.check.add([problem.with_help(help)]);
            return None;
        };
        if !self.seen.insert(key.to_owned()) {
            let message = format!("`{key}` is varied twice");
            self.check
                .at(&format!("{path}.key"), message, "once is enough");
        }
        Some(schema)
    }

    /// Returns the place of a key from the first part on that leads nowhere.
    fn within(&self, path: &str, key: &str) -> Range<usize> {
        let span = self.check.document.span(path);
        let is_known = |end: &usize| {
            let known = &key[..*end];
            let leads_on = |other: &String| {
                let rest = other.strip_prefix(known);
                rest.is_some_and(|rest| rest.starts_with(['.', '[']))
            };
            self.keys.0.keys().any(leads_on)
        };
        let ends = key.match_indices(['.', '[']).map(|(end, _)| end);
        let from = ends.filter(is_known).max().map_or(0, |end| end + 1);
        // Escapes in the text would shift the place; then the whole key is underlined.
        if span.len() == key.len() + 2 {
            span.start + 1 + from..span.end - 1
        } else {
            span
        }
    }

    /// Reports a value that its key does not admit.
    fn value(&mut self, path: &str, key: &str, value: f64, schema: &Value) -> bool {
        let limits = wrong(value, schema);
        let is_right = limits.is_none();
        if let Some(limits) = limits {
            self.check.at(path, out_of_range(key, value), limits);
        }
        is_right
    }

    /// Checks the sweep as a whole.
    fn whole(&mut self, sweep: &Sweep) {
        let is_drawn = sweep.distributions().next().is_some();
        let runs = format!("[sweep] has {} runs", sweep.runs());
        let (message, label) = if sweep.keys().next().is_none() {
            let label = "add [[sweep.list]], range, uniform, log_uniform or normal";
            ("[sweep] varies nothing", label)
        } else if sweep.draws.is_none() && is_drawn {
            let label = "it says how many sets of values are drawn";
            ("[sweep] lacks the key `draws`", label)
        } else if sweep.draws.is_some() && !is_drawn {
            ("nothing is drawn", "leave `draws` out")
        } else if !self.has_few_runs {
            (runs.as_str(), "at most 1000000 are admitted")
        } else {
            return;
        };
        self.check.at_key("sweep", message, label);
    }
}

/// Returns the demand of a key that a value does not meet.
fn wrong(value: f64, schema: &Value) -> Option<String> {
    if is_integer(schema) && value != libm::trunc(value) {
        return Some("must be an integer".to_owned());
    }
    broken_limit(value, schema)
}
