//! Keys whose names follow from the quantities of a loop: a file has the names, the types have their patterns.

use serde_json::Value;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::error::{Problem, Source};
use crate::schema::resolve;
use dbc::{Quantities, Quantity, Unit, conversion, is_gain, is_pattern, known_units, singular};

/// Gains that are by another unit than the loop's.
pub(crate) type Factors = Vec<Factor>;

/// Gain that is by another unit than the loop's.
#[derive(Debug)]
pub(crate) struct Factor {
    /// Path in the tables of the loop, such as `controller.pid.proportional_{gain}`.
    pub(crate) path: String,
    /// Path as the file has it.
    pub(crate) written: String,
    /// Factor to the unit of the loop.
    pub(crate) factor: f64,
}

type Key<'text> = Spanned<DeString<'text>>;

/// Finds the patterns of the keys of one loop.
pub(crate) struct Naming<'a> {
    pub(crate) source: &'a Source,
    pub(crate) quantities: &'a Quantities,
    pub(crate) loop_name: &'a str,
    /// Whole schema whose keys are patterns.
    pub(crate) schema: &'a Value,
}

impl<'a> Naming<'a> {
    /// Replaces the names of a table with a part of the schema by their patterns. Returns the factors for gains by another unit of
    /// the loop's quantity, with their paths in the table.
    ///
    /// # Errors
    /// The first name that another loop would have, with the right name.
    pub(crate) fn apply(
        &self,
        table: &mut DeTable<'_>,
        part: &'a Value,
    ) -> Result<Factors, Problem> {
        let mut factors = Factors::new();
        self.table("", table, part, &mut factors)?;
        Ok(factors)
    }

    fn table(
        &self,
        path: &str,
        table: &mut DeTable<'_>,
        schema: &'a Value,
        factors: &mut Factors,
    ) -> Result<(), Problem> {
        let Some(properties) = resolve(self.schema, schema)["properties"].as_object() else {
            return Ok(());
        };
        let patterns = properties
            .keys()
            .map(String::as_str)
            .filter(|key| is_pattern(key))
            .map(|pattern| (pattern, self.quantities.name(pattern)));
        let patterns = Vec::from_iter(patterns);
        for (mut key, mut value) in std::mem::take(table) {
            let written = key.span();
            if is_pattern(key.get_ref()) {
                let message = format!("unknown key `{}`", key.get_ref());
                let label = "not a key of the format";
                return Err(self.source.problem(written, message, label));
            }
            let pattern = if properties.contains_key(&**key.get_ref()) {
                None
            } else {
                self.pattern(&key, &patterns)?
            };
            if let Some((pattern, factor)) = pattern {
                let name = std::mem::replace(key.get_mut(), pattern.to_owned().into());
                factors.extend((factor != 1.0).then(|| Factor {
                    path: format!("{path}{pattern}"),
                    written: format!("{path}{name}"),
                    factor,
                }));
                if let Some((first, _)) = table.get_key_value(pattern) {
                    let message = "one gain by two units";
                    let problem = self.source.problem(written, message, "and this one");
                    return Err(problem.with_place(first.span(), "this one"));
                }
            }
            let name: &str = key.get_ref();
            if let Some(below) = properties.get(name) {
                self.value(&format!("{path}{name}."), value.get_mut(), below, factors)?;
            }
            table.insert(key, value);
        }
        Ok(())
    }

    fn value(
        &self,
        path: &str,
        value: &mut DeValue<'_>,
        schema: &'a Value,
        factors: &mut Factors,
    ) -> Result<(), Problem> {
        match value {
            DeValue::Table(table) => self.table(path, table, schema, factors),
            DeValue::Array(array) => {
                let items = &resolve(self.schema, schema)["items"];
                let mut below = array.iter_mut();
                below.try_for_each(|one| self.value(path, one.get_mut(), items, factors))
            }
            _ => Ok(()),
        }
    }

    /// Returns the pattern of a key, and the factor from its unit to the loop's; `None` for a key without a pattern, which may be
    /// unknown.
    fn pattern(
        &self,
        key: &Key<'_>,
        patterns: &[(&'a str, String)],
    ) -> Result<Option<(&'a str, f64)>, Problem> {
        let name: &str = key.get_ref();
        if let Some((pattern, _)) = patterns.iter().find(|(_, other)| other == name) {
            return Ok(Some((pattern, 1.0)));
        }
        let mut patterns = patterns.iter().map(|(pattern, _)| *pattern);
        for pattern in patterns.clone().filter(|pattern| is_gain(pattern)) {
            let mut units = known_units();
            if let Some(unit) = units.find(|unit| self.by(unit).name(pattern) == name) {
                let factor = conversion(self.quantities.feedback.unit.law_word(), unit)
                    .ok_or_else(|| self.wrong_gain(key, pattern))?;
                return Ok(Some((pattern, factor)));
            }
        }
        match patterns.find_map(|pattern| self.wrong(key, pattern)) {
            Some(problem) => Err(problem),
            None => Ok(None),
        }
    }

    /// Returns the loop's quantities with another unit of its feedback.
    fn by(&self, unit: &str) -> Quantities {
        let mut quantities = self.quantities.clone();
        quantities.feedback.unit = Unit::Other(unit.to_owned());
        quantities
    }

    /// Refuses a name that a pattern has in a loop of other quantities.
    fn wrong(&self, key: &Key<'_>, pattern: &str) -> Option<Problem> {
        let name: &str = key.get_ref();
        let unit = &self.quantities.feedback.unit;
        let right = self.quantities.name(pattern);
        let has = |other: Quantities| other.name(pattern) == name;
        let commanding = |output: Quantity| Quantities {
            output,
            ..self.quantities.clone()
        };
        let message = if Quantity::known().map(commanding).any(has) {
            let command = self.quantities.output.words();
            format!("the loop `{}` commands a {command}", self.loop_name)
        } else if has(Quantities::of_position(unit.clone())) {
            format!(
                "the loop `{}` measures `{}`",
                self.loop_name, self.quantities.feedback.name
            )
        } else {
            // Units that a name might have by mistake.
            let mut others = known_units().flat_map(|unit| {
                let unit_alone = Unit::Other(unit.to_owned());
                [self.by(unit), Quantities::of_position(unit_alone)]
            });
            others
                .any(has)
                .then(|| format!("the loop `{}` is in {unit}", self.loop_name))?
        };
        let label = format!("write `{right}`");
        Some(self.source.problem(key.span(), message, label))
    }

    /// Makes the problem of a gain by a unit of another quantity, with the right name.
    fn wrong_gain(&self, key: &Key<'_>, pattern: &str) -> Problem {
        let by = singular(self.quantities.feedback.unit.law_word()).replace('_', " ");
        let message = format!("the gains of the loop `{}` are by the {by}", self.loop_name);
        let label = format!("write `{}`", self.quantities.name(pattern));
        self.source.problem(key.span(), message, label)
    }
}
