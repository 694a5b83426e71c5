//! The names of a loop's positions end in the loop's own unit, and the types of a loop have them in millimetres.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{Problem, Source};
use crate::port::Unit;

/// Where names have the unit of a position.
const SECTIONS: [&str; 3] = ["reference", "fault", "expect"];
/// Where names have it as the one by which something is divided: gains of laws.
const LAW: &str = "controller";
/// A unit by which something is divided.
const PER_METRE: &str = "per_metre";
/// Units that a name might have by mistake.
const UNITS: [&str; 3] = ["millimetres", "degrees", "revolutions"];

/// The names of one loop.
pub(crate) struct InUnit<'a> {
    pub(crate) source: &'a Source,
    pub(crate) unit: &'a Unit,
    pub(crate) of_loop: &'a str,
}

impl InUnit<'_> {
    /// Gives all names of positions the unit that the types of a loop have.
    ///
    /// # Errors
    /// The first name that ends in another unit than the loop's.
    pub(crate) fn rename(&self, tree: &mut DeTable<'_>) -> Result<(), Problem> {
        for (key, value) in tree.iter_mut() {
            let section: &str = key.get_ref();
            if SECTIONS.contains(&section) {
                self.positions(value.get_mut())?;
            } else if section == LAW && *self.unit != Unit::Millimetres {
                self.gains(value.get_mut());
            }
        }
        Ok(())
    }

    fn positions(&self, value: &mut DeValue<'_>) -> Result<(), Problem> {
        match value {
            DeValue::Table(table) => {
                for (mut key, mut below) in std::mem::take(table) {
                    self.check(&key)?;
                    let name = self.unit.canonical(key.get_ref());
                    *key.get_mut() = name.into();
                    self.positions(below.get_mut())?;
                    table.insert(key, below);
                }
            }
            DeValue::Array(array) => {
                for below in array.iter_mut() {
                    self.positions(below.get_mut())?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// A name whose unit is that of another kind of loop.
    fn check(&self, key: &Spanned<toml::de::DeString<'_>>) -> Result<(), Problem> {
        let (name, unit): (&str, _) = (key.get_ref(), self.unit);
        let others = UNITS.into_iter().filter(|other| *other != unit.word());
        let wrong = others.map(Unit::of_word).find_map(|other| {
            let canonical = other.canonical(name);
            (canonical != name || other == Unit::Millimetres)
                .then(|| unit.rename(&canonical))
                .filter(|right| right != name)
        });
        let Some(right) = wrong else {
            return Ok(());
        };
        let message = format!("the loop `{}` is in {unit}", self.of_loop);
        let label = format!("write `{right}`");
        Err(self.source.problem(key.span(), message, label))
    }

    /// Gains by the unit are to a law gains by the metre: it sees positions in the loop's unit, or in metres.
    fn gains(&self, value: &mut DeValue<'_>) {
        let DeValue::Table(table) = value else {
            return;
        };
        let per_unit = format!("per_{}", self.unit.singular());
        for (mut key, mut below) in std::mem::take(table) {
            let name: &str = key.get_ref();
            if name.contains(&per_unit) {
                let renamed = name.replacen(&per_unit, PER_METRE, 1);
                *key.get_mut() = renamed.into();
            }
            self.gains(below.get_mut());
            table.insert(key, below);
        }
    }
}
