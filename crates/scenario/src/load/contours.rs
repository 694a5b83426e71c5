//! Reads the expectations of several loops together.

use std::collections::BTreeSet;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::patterns::Naming;
use super::sections::{CONTOUR, EXPECT};
use crate::contour::{Contour, Contours, LIMITS};
use crate::document::Document;
use crate::error::Problem;
use crate::load::{build, without_problems};
use crate::nearest::meant_or_known;
use crate::rig::nodes::{Rig, RigLoop};
use crate::schema;
use crate::trial::Trial;
use dbc::{Quantities, Unit};

/// Reads `[[expect.contour]]`.
pub(super) fn read_contours(
    scenario: &Document<'_>,
    rig: &Rig,
    loops: &[Trial],
) -> Result<Vec<Contour>, Vec<Problem>> {
    let expect = scenario.spanned(EXPECT).map(Spanned::get_ref);
    let entries = expect.and_then(DeValue::as_table).into_iter().flatten();
    let contours = entries.filter(|(key, _)| key.get_ref() == CONTOUR);
    let mut tree = DeTable::from_iter(contours.map(|(key, value)| (key.clone(), value.clone())));
    if let Some(DeValue::Array(entries)) = tree.get_mut(CONTOUR).map(Spanned::get_mut) {
        for entry in entries.iter_mut() {
            to_patterns(scenario, entry.get_mut(), rig).map_err(|problem| vec![problem])?;
        }
    }
    let document = scenario.with_root(tree);
    let (Contours { mut contour }, mut problems) =
        build::<Contours>(&document, "[expect]", &schema::CONTOURS)?;
    let mut names = BTreeSet::from_iter(rig.loops.keys().cloned());
    for (number, one) in contour.iter_mut().enumerate() {
        let first = one.loops.first().map_or("", String::as_str);
        one.unit = unit_of(first, rig);
        let path = format!("{CONTOUR}.{number}");
        problems.extend(wrong_contour(&document, &path, one, (rig, loops)));
        let name = one.loops.join("_");
        if !names.insert(name.clone()) {
            let message = format!("`{name}` is the name of two things");
            problems.push(document.problem(&path, message, "its loops give it this name"));
        }
    }
    without_problems(problems, contour)
}

/// Returns the unit of a loop.
fn unit_of(name: &str, rig: &Rig) -> Unit {
    let followed = rig.loops.get(name).map(RigLoop::followed);
    rig.quantities_of(followed.unwrap_or_default())
        .feedback
        .unit
}

/// Replaces the names of a contour's limits by their patterns. All loops of a contour have one unit.
fn to_patterns(scenario: &Document<'_>, entry: &mut DeValue<'_>, rig: &Rig) -> Result<(), Problem> {
    let DeValue::Table(entry) = entry else {
        return Ok(());
    };
    let loops = entry
        .get("loops")
        .and_then(|loops| loops.get_ref().as_array());
    let loops = Vec::from_iter(loops.into_iter().flatten().filter_map(|one| {
        let name = one.get_ref().as_str()?;
        let is_known = rig.loops.contains_key(name);
        is_known.then(|| (name.to_owned(), one.span(), unit_of(name, rig)))
    }));
    let Some((first, _, unit)) = loops.first() else {
        return Ok(());
    };
    if let Some((name, span, other)) = loops.iter().find(|(_, _, other)| other != unit) {
        let message = format!(
            "`{first}` is in {unit} and `{name}` in {other}: there is no distance between them"
        );
        let label = format!("a contour is of loops of one unit, here {unit}");
        return Err(scenario.source.problem(span.clone(), message, label));
    }
    let naming = Naming {
        source: &scenario.source,
        quantities: &Quantities::of_position(unit.clone()),
        loop_name: first,
        schema: &schema::CONTOURS,
    };
    let contour = &schema::CONTOURS["properties"][CONTOUR]["items"];
    naming.apply(entry, contour).map(drop)
}

fn wrong_contour(
    document: &Document<'_>,
    path: &str,
    contour: &Contour,
    (rig, loops): (&Rig, &[Trial]),
) -> Option<Problem> {
    for (place, name) in contour.loops.iter().enumerate() {
        let path = format!("{path}.loops.{place}");
        if !rig.loops.contains_key(name) {
            let message = format!("the rig has no loop `{name}`");
            return Some(document.problem(&path, message, meant_or_known(name, rig.loops.keys())));
        }
        if contour.loops[..place].contains(name) {
            let message = format!("the loop `{name}` is an axis of this contour twice");
            return Some(document.problem(&path, message, "each loop is one axis"));
        }
        let is_idle = |one: &Trial| one.wiring.loop_name == *name && one.reference.is_empty();
        if loops.iter().any(is_idle) {
            let message = format!("the loop `{name}` has no set-point");
            return Some(document.problem(&path, message, "a contour is a path of set-points"));
        }
    }
    let limits = [contour.error_max, contour.error_rms];
    if limits.iter().all(Option::is_none) {
        let label = format!(
            "{} = {{ max = … }} is missing",
            Quantities::of_position(contour.unit.clone()).name(LIMITS[0])
        );
        return Some(document.problem(path, "nothing is expected of this contour", label));
    }
    let is_empty = contour
        .until_seconds
        .is_some_and(|until| until <= contour.from_seconds);
    is_empty.then(|| {
        let path = format!("{path}.until_seconds");
        document.problem(&path, "the window is empty", "must be behind from_seconds")
    })
}
