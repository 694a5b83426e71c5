//! What is expected of several loops together.

use toml::Spanned;
use toml::de::DeValue;

use super::{CONTOUR, EXPECT};
use crate::document::Document;
use crate::error::Problem;
use crate::load::{build, none_of};
use crate::loops::{Contour, Contours};
use crate::nearest::meant_or_known;
use crate::outside::Outside;
use crate::rig::nodes::Rig;
use crate::schema;

/// `[[expect.contour]]`.
pub(super) fn read_contours(
    scenario: &Document<'_>,
    rig: &Rig,
) -> Result<Vec<Contour>, Vec<Problem>> {
    let expect = scenario.root().get(EXPECT).map(Spanned::get_ref);
    let expect = expect.and_then(DeValue::as_table);
    let entry = expect.and_then(|table| table.get_key_value(CONTOUR));
    let tree = entry.map(|(key, value)| (key.clone(), value.clone()));
    let document = scenario.with_root(tree.into_iter().collect());
    let place = "[expect]";
    let (Contours { contour }, mut problems) =
        build::<Contours>(&document, &Outside::Registered, place, &schema::CONTOURS)?;
    for (number, one) in contour.iter().enumerate() {
        let path = format!("{CONTOUR}.{number}");
        problems.extend(wrong_contour(&document, &path, one, rig));
    }
    none_of(problems, contour)
}

fn wrong_contour(
    document: &Document<'_>,
    path: &str,
    contour: &Contour,
    rig: &Rig,
) -> Option<Problem> {
    let known = Vec::from_iter(rig.loops.keys().map(String::as_str));
    let is_stranger = |(_, name): &(usize, &String)| !rig.loops.contains_key(*name);
    if let Some((place, name)) = contour.loops.iter().enumerate().find(is_stranger) {
        let message = format!("the rig has no loop `{name}`");
        let label = meant_or_known(name, &known);
        return Some(document.problem(&format!("{path}.loops.{place}"), message, label));
    }
    let is_repeated = |(place, name): &(usize, &String)| contour.loops[..*place].contains(name);
    if let Some((place, name)) = contour.loops.iter().enumerate().find(is_repeated) {
        let message = format!("the loop `{name}` is an axis of this contour twice");
        let path = format!("{path}.loops.{place}");
        return Some(document.problem(&path, message, "each loop is one axis"));
    }
    let limits = [
        contour.contour_error_millimetres_max,
        contour.contour_error_millimetres_rms,
    ];
    if limits.iter().all(Option::is_none) {
        let label = "contour_error_millimetres_max = { max = … } is missing";
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
