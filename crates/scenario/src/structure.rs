//! Checks a document against the schema: keys, types and ranges, all problems at once.

use std::ops::Range;

use serde_json::{Map, Value, json};
use toml::Spanned;
use toml::de::{DeArray, DeString, DeTable, DeValue};

use crate::custom::{self, Section};
use crate::document::{Document, Meaning};
use crate::error::{Problem, Source};
use crate::nearest::{nearest, suggestion};
use crate::schema::{MULTIPLE_OF, resolve};

/// Kind of a value in messages.
const TABLES: &str = "an array of tables";

/// Finds everything in the document that the schema does not admit; `what` names the whole in messages.
pub(crate) fn check(document: &Document<'_>, what: &str, schema: &Value) -> Vec<Problem> {
    check_table(document, what, (0..0, document.root()), schema, schema)
}

/// Checks a table of the document as [`check`], against a part of the schema.
pub(crate) fn check_table(
    document: &Document<'_>,
    what: &str,
    table: (Range<usize>, &DeTable<'_>),
    schema: &Value,
    part: &Value,
) -> Vec<Problem> {
    let mut checker = Checker {
        source: &document.source,
        meaning: &document.meaning,
        schema,
        problems: Vec::new(),
    };
    // A table such as `[[fault.bus.lose]]`, or the whole file.
    let path = what.trim_matches(['[', ']']);
    let path = if path.len() < what.len() { path } else { "" };
    checker.table(what, path, table, part);
    checker.problems
}

struct Checker<'a> {
    source: &'a Source,
    /// Meaning of the schema's keys here, some of which are patterns.
    meaning: &'a Meaning,
    schema: &'a Value,
    problems: Vec<Problem>,
}

impl<'a> Checker<'a> {
    fn report(&mut self, span: Range<usize>, message: String, label: impl Into<String>) {
        self.problems
            .push(self.source.problem(span, message, label));
    }

    fn resolve(&self, schema: &'a Value) -> &'a Value {
        resolve(self.schema, schema)
    }

    /// Checks a value; `path` names it in messages: `reference.step`.
    fn value(&mut self, path: &str, value: &Spanned<DeValue<'_>>, schema: &'a Value) {
        let (span, schema) = (value.span(), self.resolve(schema));
        match (schema["type"].as_str(), value.get_ref()) {
            (Some("object"), DeValue::Table(table)) => {
                let place = format!("[{path}]");
                self.table(&place, path, (span, table), schema);
            }
            (Some("array"), DeValue::Array(array)) => self.array(path, span, array, schema),
            (Some("number"), number @ (DeValue::Integer(_) | DeValue::Float(_)))
            | (Some("integer"), number @ DeValue::Integer(_)) => {
                self.number(path, span, number, schema);
            }
            (Some("string"), DeValue::String(text)) => self.string(path, span, text, schema),
            (Some("boolean"), DeValue::Boolean(_)) => {}
            // The schema leaves the value to the reader of its type.
            (None, _) if schema.get("oneOf").is_none() => {}
            (None, DeValue::String(text)) => self.choice(path, span, text, schema),
            (expected, found) => {
                let expected = match schema["items"]["type"].as_str() {
                    Some("string") => "an array of strings",
                    Some("number") => "an array of numbers",
                    _ => expected_kind(expected),
                };
                let message = format!("`{path}` must be {expected}");
                self.report(span, message, format!("this is {}", found_kind(found)));
                if expected == TABLES && found.is_table() {
                    self.help(format!("write it with double brackets: [[{path}]]"));
                }
                if let Some(help) = limit_help(path, schema, found) {
                    self.help(help);
                }
            }
        }
    }

    fn help(&mut self, help: String) {
        if let Some(problem) = self.problems.pop() {
            self.problems.push(problem.with_help(help));
        }
    }

    /// Checks a table; `place` names it in messages, `[controller.pid]`, `[[reference.step]]`, and `path` its values:
    /// `reference.step[1]`.
    fn table(
        &mut self,
        place: &str,
        path: &str,
        (span, table): (Range<usize>, &DeTable<'_>),
        schema: &'a Value,
    ) {
        // The table is one of several; another check decides which.
        if schema["anyOf"].is_array() {
            return;
        }
        let no_properties = Map::new();
        let properties = schema["properties"].as_object();
        let mut meant = Vec::new();
        for (key, value) in table {
            let name = key.get_ref().as_ref();
            match properties.and_then(|properties| properties.get(name)) {
                Some(property) => self.value(&join(path, name), value, property),
                // A table whose keys the user chooses.
                None if schema["additionalProperties"].is_object() => {
                    let property = &schema["additionalProperties"];
                    self.value(&join(path, name), value, property);
                }
                None => {
                    let known = properties.unwrap_or(&no_properties);
                    meant.extend(self.unknown_key(place, key, value.get_ref(), known));
                }
            }
        }
        let required = schema["required"].as_array().into_iter().flatten();
        for name in required.filter_map(Value::as_str) {
            // A misspelt key is one problem, not two.
            let is_meant = || meant.contains(&self.meaning.name(name));
            if !table.contains_key(name) && !is_meant() {
                let message = format!("{place} lacks the key `{name}`");
                self.report(span.clone(), message, format!("`{name}` is missing"));
                if let Some(text) = schema["properties"][name]["description"].as_str() {
                    self.help(format!("`{name}`: {text}"));
                }
            }
        }
    }

    /// Reports an unknown key, and returns the known one that was probably meant.
    fn unknown_key(
        &mut self,
        place: &str,
        key: &Spanned<DeString<'_>>,
        value: &DeValue<'_>,
        known: &Map<String, Value>,
    ) -> Option<String> {
        let name = key.get_ref().as_ref();
        let mut named = Vec::from_iter(known.keys().map(|key| self.meaning.name(key)));
        named.sort_unstable();
        let meant = nearest(name, named.iter().map(String::as_str));
        let section = Section::ALL
            .into_iter()
            .find(|section| section.is_place(place));
        if let Some(section) = section.filter(|_| meant.is_none() && value.is_table()) {
            let kind = section.kind();
            let label = format!("this bench has no such {kind}");
            self.report(key.span(), format!("unknown {kind} `{name}`"), label);
            self.help(custom::known(section, named.iter().map(String::as_str)));
            return None;
        }
        let label = match meant {
            Some(meant) => suggestion(name, meant),
            None => "not a key of the format".to_owned(),
        };
        let message = format!("unknown key `{name}` in {place}");
        self.report(key.span(), message, label);
        self.help(format!("known here: {}", named.join(", ")));
        meant.map(str::to_owned)
    }

    fn array(&mut self, path: &str, span: Range<usize>, array: &DeArray<'_>, schema: &'a Value) {
        let fewest = schema["minItems"].as_u64().unwrap_or(0);
        let most = schema["maxItems"].as_u64().unwrap_or(u64::MAX);
        let count = array.len() as u64;
        if !(fewest..=most).contains(&count) {
            let message = match count {
                1 => format!("`{path}` has 1 entry"),
                _ => format!("`{path}` has {count} entries"),
            };
            let label = match fewest {
                1 if count < fewest => "at least 1 is needed".to_owned(),
                _ if count < fewest => format!("at least {fewest} are needed"),
                _ => format!("at most {most} are admitted"),
            };
            self.report(span, message, label);
            return;
        }
        for (place, element) in array.iter().enumerate() {
            // A tuple has a schema for each index.
            let items = schema["items"].get(place).unwrap_or(&schema["items"]);
            let items = self.resolve(items);
            let numbered = match count {
                1 => path.to_owned(),
                _ => format!("{path}[{place}]"),
            };
            match element.get_ref() {
                DeValue::Table(table) => {
                    let header = format!("[[{path}]]");
                    self.table(&header, &numbered, (element.span(), table), items);
                }
                _ => self.value(&numbered, element, items),
            }
        }
    }

    fn string(&mut self, path: &str, span: Range<usize>, text: &str, schema: &Value) {
        let length = text.chars().count() as u64;
        let shortest = schema["minLength"].as_u64().unwrap_or(0);
        let longest = schema["maxLength"].as_u64().unwrap_or(u64::MAX);
        if !(shortest..=longest).contains(&length) {
            let message = format!("`{path}` has {length} characters");
            self.report(span, message, format!("must have {shortest} to {longest}"));
        }
    }

    /// Checks a word of a list that describes each of its words.
    fn choice(&mut self, path: &str, span: Range<usize>, text: &str, schema: &Value) {
        let alternatives = schema["oneOf"].as_array().into_iter().flatten();
        let words: Vec<&str> = alternatives
            .filter_map(|one| one["const"].as_str())
            .collect();
        if !words.contains(&text) {
            let label = format!("must be one of: {}", words.join(", "));
            self.report(span, format!("`{path}` cannot be \"{text}\""), label);
        }
    }

    fn number(&mut self, path: &str, span: Range<usize>, value: &DeValue<'_>, schema: &Value) {
        let Some(number) = number(value) else {
            self.report(
                span,
                format!("`{path}` is too large"),
                "does not fit a number",
            );
            return;
        };
        if !number.is_finite() {
            self.report(
                span,
                format!("`{path}` must be finite"),
                "not a finite number",
            );
            return;
        }
        let key = path.rsplit('.').next().unwrap_or_default();
        let range = self.meaning.range_of(key);
        let of_loop = range.map(|[min, max]| json!({ "minimum": min, "maximum": max }));
        let limits = broken_limit(number, schema).or_else(|| broken_limit(number, &of_loop?));
        if let Some(limits) = limits {
            self.report(span, out_of_range(path, number), limits);
        }
    }
}

/// Returns advice on how to write a limit, if there is another value in its place.
fn limit_help(path: &str, schema: &Value, found: &DeValue<'_>) -> Option<String> {
    let number = match found {
        DeValue::Integer(integer) => integer.as_str(),
        DeValue::Float(float) => float.as_str(),
        _ => "1.0",
    };
    let has = |key: &str| schema["properties"].get(key).is_some();
    if path == "expect" {
        return Some(format!(
            "[expect] has a limit for each metric, as in `overshoot_percent = {{ max = {number} }}`"
        ));
    }
    let below = path.strip_prefix("expect.")?;
    let key = below.rsplit('.').next().unwrap_or(below);
    if has("p99") {
        Some(format!(
            "write the limit of a quantile, `{key} = {{ p99 = {{ max = {number} }} }}`; known are median, p99, p99_9 and max"
        ))
    } else if has("min") && has("max") {
        Some(format!(
            "write the limit as a table: `{key} = {{ max = {number} }}` for at most, `{{ min = {number} }}` for at least, \
             or both sides, `{{ min = …, max = … }}`"
        ))
    } else if schema["type"] == "number" && found.is_table() {
        Some(format!("write the number alone, `{key} = {number}`"))
    } else {
        None
    }
}

/// Returns the number that a TOML integer or float represents.
pub(crate) fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(integer) => {
            let integer = i64::from_str_radix(integer.as_str(), integer.radix()).ok()?;
            // Ranges end far below 2^53, where this is exact.
            Some(integer as f64)
        }
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

/// Returns the message for a number outside its range.
pub(crate) fn out_of_range(path: &str, number: f64) -> String {
    format!("`{path}` = {number} is out of range")
}

/// Returns the range as a text if the number is outside.
pub(crate) fn broken_limit(number: f64, schema: &Value) -> Option<String> {
    if let Some(values) = schema["enum"].as_array() {
        let listed: Vec<String> = values.iter().map(Value::to_string).collect();
        let is_listed = values.iter().any(|value| value.as_f64() == Some(number));
        return (!is_listed).then(|| format!("must be one of: {}", listed.join(", ")));
    }
    let (minimum, maximum) = (schema["minimum"].as_f64(), schema["maximum"].as_f64());
    let above = schema["exclusiveMinimum"].as_f64();
    let is_inside = minimum.is_none_or(|limit| number >= limit)
        && maximum.is_none_or(|limit| number <= limit)
        && above.is_none_or(|limit| number > limit);
    if !is_inside {
        return Some(match (minimum, above, maximum) {
            (Some(least), _, Some(most)) if least == most => format!("must be {least}"),
            (Some(least), _, Some(most)) => format!("must be from {least} to {most}"),
            (_, Some(above), Some(most)) => format!("must be above {above}, at most {most}"),
            (Some(least), _, None) => format!("must be at least {least}"),
            (_, Some(above), None) => format!("must be above {above}"),
            (None, None, most) => format!("must be at most {}", most.unwrap_or(f64::MAX)),
        });
    }
    let unit = schema[MULTIPLE_OF].as_f64()?;
    let ratio = number / unit;
    let is_multiple = (ratio - libm::round(ratio)).abs() < 1e-9;
    (!is_multiple).then(|| format!("must be a multiple of {unit}"))
}

/// Joins `reference` and `step` to `reference.step`.
pub(crate) fn join(path: &str, name: &str) -> String {
    match path {
        "" => name.to_owned(),
        _ => format!("{path}.{name}"),
    }
}

fn expected_kind(schema_type: Option<&str>) -> &'static str {
    match schema_type {
        Some("object") => "a table",
        Some("array") => TABLES,
        Some("boolean") => "true or false",
        Some("number") => "a number",
        Some("integer") => "an integer",
        _ => "a string",
    }
}

/// Describes the type of a value.
fn found_kind(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) => "an integer",
        DeValue::Float(_) => "a number with a fraction",
        DeValue::Boolean(_) => "a boolean",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "an array",
        DeValue::Table(_) => "a table",
    }
}
