//! Reads the sweep of a scenario.

use crate::check::{self, Check};
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
    let (Swept { mut sweep }, problems) =
        build::<Swept>(&document, "the scenario", &schema::SWEPT)?;
    let mut check = Check::new(scenario, rig, problems);
    if let Some(sweep) = &mut sweep {
        check::sweep(&mut check, sweep);
    }
    without_problems(check.problems, sweep)
}
