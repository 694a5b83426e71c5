//! Names of positions: in a file they end in the unit of their loop, in the types in millimetres.

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::controller::is_process_law;
use crate::custom::leads_all;
use crate::error::{Problem, Source};
use crate::metrics::METRICS;
use crate::port::{GAINS, Measurand, Unit, conversion, singular, unit_at_start};

/// Sections in which names end in the unit of a position.
const SECTIONS: [&str; 3] = ["reference", "fault", EXPECT];
const EXPECT: &str = "expect";
/// Section in which names divide by the unit of a position: gains of laws.
const LAW: &str = "controller";
/// Unit of the gains in the types of laws.
const METRE: &str = "metre";
/// Units that a name might have by mistake.
const UNITS: [&str; 3] = ["millimetres", "degrees", "revolutions"];

/// Factors for parameters of a law, with their paths.
pub(crate) type Factors = Vec<(String, f64)>;

/// Renames the keys of one loop.
pub(crate) struct InUnit<'a> {
    pub(crate) source: &'a Source,
    pub(crate) measurand: &'a Measurand,
    pub(crate) of_loop: &'a str,
}

impl InUnit<'_> {
    /// Renames all positions to the unit of the loop's types. Returns the factors for gains by another unit of the same quantity,
    /// with their paths below the section.
    ///
    /// # Errors
    /// The first name that ends in another unit than the loop's.
    pub(crate) fn rename(&self, tree: &mut DeTable<'_>) -> Result<Factors, Problem> {
        let mut factors = Factors::new();
        for (key, value) in tree.iter_mut() {
            let section: &str = key.get_ref();
            if SECTIONS.contains(&section) {
                self.positions(section == EXPECT, value.get_mut())?;
            } else if section == LAW
                && let DeValue::Table(laws) = value.get_mut()
            {
                // A law of all loops, or in a process of its own, states the units in the names of its ports.
                let mut of_loop = laws
                    .iter_mut()
                    .filter(|(law, _)| !leads_all(law.get_ref()) && !is_process_law(law.get_ref()));
                of_loop.try_for_each(|(name, law)| {
                    self.gains(name.get_ref(), law.get_mut(), &mut factors)
                })?;
            }
        }
        Ok(factors)
    }

    /// Renames positions. In `[expect]` the name of another metric stays, as `temperature_celsius` in a loop of a temperature.
    fn positions(&self, is_expect: bool, value: &mut DeValue<'_>) -> Result<(), Problem> {
        match value {
            DeValue::Table(table) => {
                for (mut key, mut below) in std::mem::take(table) {
                    self.check(&key)?;
                    if !(is_expect && METRICS.iter().any(|one| one.name == key.get_ref())) {
                        let name = self.measurand.canonical(key.get_ref());
                        *key.get_mut() = name.into();
                    }
                    self.positions(is_expect, below.get_mut())?;
                    table.insert(key, below);
                }
            }
            DeValue::Array(array) => {
                for below in array.iter_mut() {
                    self.positions(is_expect, below.get_mut())?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Refuses a name whose unit is that of another kind of loop.
    fn check(&self, key: &Spanned<DeString<'_>>) -> Result<(), Problem> {
        let (name, own): (&str, _) = (key.get_ref(), self.measurand);
        if own.position_of(name).is_some() {
            return Ok(());
        }
        if let Some(right) = own.command.corrected(name) {
            return Err(self.wrong_command(key, &right));
        }
        let unit = &own.unit;
        let has_unit = UNITS.iter().any(|unit| name.contains(unit)) || name.contains(unit.word());
        if !has_unit {
            return Ok(());
        }
        let units = UNITS.map(Unit::of_word).into_iter().chain([unit.clone()]);
        let others = units.flat_map(|unit| {
            let position = Measurand::position(unit.clone());
            let signal = own.signal.clone();
            let command = own.command;
            let named = Measurand {
                signal,
                unit,
                command,
            };
            [named, position.commanding(command)]
        });
        let wrong = others.filter(|other| other != own).find_map(|other| {
            let canonical = other.canonical(name);
            (canonical != name || other == Measurand::default())
                .then(|| own.rename(&canonical))
                .filter(|right| right != name)
        });
        let Some(right) = wrong else {
            return Ok(());
        };
        let message = if name.contains(unit.word()) {
            format!("the loop `{}` measures `{}`", self.of_loop, own.signal)
        } else {
            format!("the loop `{}` is in {unit}", self.of_loop)
        };
        let label = format!("write `{right}`");
        Err(self.source.problem(key.span(), message, label))
    }

    fn wrong_command(&self, key: &Spanned<DeString<'_>>, right: &str) -> Problem {
        let command = self.measurand.command.signal();
        let message = format!("the loop `{}` commands a {command}", self.of_loop);
        self.source
            .problem(key.span(), message, format!("write `{right}`"))
    }

    /// Renames the gains by the unit of the loop to gains by the metre, as laws have them: a law sees positions in metres, or in
    /// the loop's unit. A law takes its command for a current.
    fn gains(
        &self,
        path: &str,
        value: &mut DeValue<'_>,
        factors: &mut Factors,
    ) -> Result<(), Problem> {
        let table = match value {
            DeValue::Table(table) => table,
            DeValue::Array(array) => {
                let mut below = array.iter_mut();
                return below.try_for_each(|one| self.gains(path, one.get_mut(), factors));
            }
            _ => return Ok(()),
        };
        let command = self.measurand.command;
        for (mut key, mut below) in std::mem::take(table) {
            let right = command.rename(key.get_ref());
            if right != **key.get_ref() {
                return Err(self.wrong_command(&key, &right));
            }
            *key.get_mut() = command.canonical(key.get_ref()).into();
            let name: &str = key.get_ref();
            let mut path = format!("{path}.{name}");
            if let Some((gain, unit, rest)) = self.gain(name) {
                let factor = conversion(self.measurand.unit.of_laws(), unit);
                let factor = factor.ok_or_else(|| self.wrong_gain(&key))?;
                let canonical = format!("{gain}{METRE}{rest}");
                path.truncate(path.len() - name.len());
                path += &canonical;
                if factor != 1.0 {
                    factors.push((path.clone(), factor));
                }
                let written = key.span();
                *key.get_mut() = canonical.into();
                if let Some((first, _)) = table.get_key_value(&**key.get_ref()) {
                    let message = "one gain by two units";
                    let problem = self.source.problem(written, message, "and this one");
                    return Err(problem.with_place(first.span(), "this one"));
                }
            }
            self.gains(&path, below.get_mut(), factors)?;
            table.insert(key, below);
        }
        Ok(())
    }

    /// Makes the problem of a gain by a unit of another quantity, with the right name.
    fn wrong_gain(&self, key: &Spanned<DeString<'_>>) -> Problem {
        let own = self.measurand.unit.of_laws();
        let (gain, _, rest) = self.gain(key.get_ref()).unwrap_or_default();
        let right = format!("{gain}{}{rest}", singular(own));
        let right = self.measurand.command.rename(&right);
        let message = format!(
            "the gains of the loop `{}` are by the {}",
            self.of_loop,
            singular(own).replace('_', " ")
        );
        let label = format!("write `{right}`");
        self.source.problem(key.span(), message, label)
    }

    /// Returns the parts of a gain's name: before the unit, the unit, and behind it.
    fn gain<'n>(&self, name: &'n str) -> Option<(&'n str, &str, &'n str)> {
        let by = GAINS
            .iter()
            .find_map(|gain| Some(name.find(gain)? + gain.len()));
        let (gain, rest) = name.split_at(by?);
        let own = self.measurand.unit.of_laws();
        let is_own = rest.strip_prefix(&singular(own)).map(|rest| (own, rest));
        let is_end = |rest: &str| rest.is_empty() || rest.starts_with('_');
        let (unit, rest) = is_own
            .filter(|(_, rest)| is_end(rest) && !rest.starts_with("_per_"))
            .or_else(|| unit_at_start(rest))?;
        Some((gain, unit, rest))
    }
}
