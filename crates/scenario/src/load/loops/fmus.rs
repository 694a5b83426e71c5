//! The FMU of a plant, as a rig file has it.

use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::plant::FMU;

/// Names an FMU among the models of a plant by its path, and its start values by the whole names of their variables. FMUs lie
/// beside the rig file.
pub(super) fn place<'text>(models: &mut DeTable<'text>, rig: &Path) {
    let fmu = models.get_mut(FMU).map(Spanned::get_mut);
    let Some(DeValue::Table(fmu)) = fmu else {
        return;
    };
    if let Some(DeValue::String(file)) = fmu.get_mut("file").map(Spanned::get_mut) {
        let path = rig.with_file_name(&**file);
        *file = path.to_string_lossy().into_owned().into();
    }
    name_start_values(fmu);
}

/// Calls the start values of an FMU by the whole names of their variables.
pub(super) fn name_start_values(fmu: &mut DeTable<'_>) {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The start values of an FMU by their names.
    fn placed(start: &str) -> Vec<String> {
        let text = format!("[fmu]\nfile = \"arm.fmu\"\n[fmu.start]\n{start}\n");
        let mut models = DeTable::parse(&text).unwrap().into_inner();
        place(&mut models, Path::new("rigs/rig.toml"));
        let fmu = models["fmu"].get_ref().as_table().unwrap();
        assert_eq!(fmu["file"].get_ref().as_str(), Some("rigs/arm.fmu"));
        let start = fmu["start"].get_ref().as_table().unwrap();
        start.keys().map(|key| key.get_ref().to_string()).collect()
    }

    #[test]
    fn a_name_with_dots_may_be_quoted_or_not() {
        assert_eq!(placed("\"body.arm.m\" = 2.0"), ["body.arm.m"]);
        assert_eq!(placed("body.arm.m = 2.0"), ["body.arm.m"]);
        let several = "n = 1\nbody.mass = 1.0\nbody.arm = { m = 2.0, on = true }";
        let names = ["body.arm.m", "body.arm.on", "body.mass", "n"];
        assert_eq!(placed(several), names);
    }
}
