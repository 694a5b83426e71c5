//! The start values of an FMU, whose names may have dots in them.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Names the start values of the FMUs in the tables of a rig by the whole names of their variables.
pub(super) fn name_start_values(rig: &mut DeTable<'_>) {
    let plants = rig.get_mut("plant").map(Spanned::get_mut);
    let Some(DeValue::Table(plants)) = plants else {
        return;
    };
    for (_, plant) in plants.iter_mut() {
        if let DeValue::Table(models) = plant.get_mut()
            && let Some(DeValue::Table(fmu)) = models.get_mut("fmu").map(Spanned::get_mut)
            && let Some(DeValue::Table(start)) = fmu.get_mut("start").map(Spanned::get_mut)
        {
            let mut whole = DeTable::new();
            flatten(start, "", &mut whole);
            *start = whole;
        }
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
