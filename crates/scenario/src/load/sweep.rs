//! Reads the sweep of a scenario.

use crate::check;
use crate::document::Document;
use crate::error::Problem;
use crate::load::{build, without_problems};
use crate::rig::nodes::Rig;
use crate::schema;
use crate::sweep::{Sweep, Swept};

/// Reads the `[sweep]` of a scenario on a rig, and checks its keys against those of the scenario.
pub(super) fn read_sweep(
    scenario: &Document<'_>,
    rig: &Rig,
) -> Result<Option<Sweep>, Vec<Problem>> {
    let document = scenario.only(&["sweep"]);
    let (Swept { mut sweep }, mut problems) =
        build::<Swept>(&document, "the scenario", &schema::SWEPT)?;
    problems.extend(check::sweep(scenario, rig, sweep.as_mut()));
    without_problems(problems, sweep)
}
