//! The FMU of a plant, as a rig file and a scenario have it, before both are put together.

use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::plant::FMU;

/// Names an FMU among the models of a plant by its path, and its start values by the whole names of their
/// variables. FMUs lie beside the rig file.
pub(super) fn place<'text>(models: &mut DeTable<'text>, rig: &Path) {
    let fmu = models.get_mut(FMU).map(Spanned::get_mut);
    let Some(DeValue::Table(fmu)) = fmu else {
        return;
    };
    if let Some(DeValue::String(file)) = fmu.get_mut("file").map(Spanned::get_mut) {
        let path = rig.with_file_name(&**file);
        *file = path.to_string_lossy().into_owned().into();
    }
    if let Some(DeValue::Table(start)) = fmu.get_mut("start").map(Spanned::get_mut) {
        let mut whole = DeTable::new();
        flatten(start, "", &mut whole);
        *start = whole;
    }
}

fn flatten<'text>(table: &DeTable<'text>, above: &str, into: &mut DeTable<'text>) {
    for (key, value) in table {
        let name = match above {
            "" => key.get_ref().to_string(),
            above => format!("{above}.{}", key.get_ref()),
        };
        match value.get_ref() {
            DeValue::Table(below) => flatten(below, &name, into),
            _ => drop(into.insert(Spanned::new(key.span(), name.into()), value.clone())),
        }
    }
}
