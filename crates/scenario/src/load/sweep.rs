//! Reads the sweep of a scenario.

use crate::check;
use crate::document::Document;
use crate::error::Problem;
use crate::load::{build, without_problems};
use crate::rig::nodes::Rig;
use crate::schema;
use crate::sweep::{Sweep, Swept};

const SWEEP: &str = "sweep";

/// Reads the `[sweep]` of a scenario on a rig, and checks its keys against those of the scenario.
pub(super) fn read_sweep(
    scenario: &Document<'_>,
    rig: &Rig,
) -> Result<Option<Sweep>, Vec<Problem>> {
    let Some(entry) = scenario.root().get_key_value(SWEEP) else {
        return Ok(None);
    };
    let tree = [(entry.0.clone(), entry.1.clone())];
    let document = scenario.with_root(tree.into_iter().collect());
    let place = "the scenario";
    let (Swept { mut sweep }, mut problems) = build::<Swept>(&document, place, &schema::SWEPT)?;
    problems.extend(check::sweep(scenario, rig, sweep.as_mut()));
    without_problems(problems, sweep)
}
