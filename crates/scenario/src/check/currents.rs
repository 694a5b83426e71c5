//! Checks of currents against the range of a drive's amplifier.

use serde_json::json;

use super::Check;
use crate::document::Document;
use crate::error::Problem;
use crate::structure::{broken_limit, out_of_range};
use crate::trial::Trial;

/// Checks the currents of a loop's law.
pub(super) fn check(check: &mut Check<'_>, trial: &Trial) {
    let (document, range) = (check.document, trial.wiring.current());
    let at = |kind: &str, index: usize, current: f64| {
        let path = format!("controller.open_loop.{kind}.{index}.{{command}}_{{command_unit}}");
        outside(document, &path, current, [range.min, range.max])
    };
    if let Some(open_loop) = &trial.controller.open_loop {
        let steps = open_loop.step.iter().enumerate();
        check.add(steps.filter_map(|(index, one)| at("step", index, one.current)));
        let ramps = open_loop.ramp.iter().enumerate();
        check.add(ramps.filter_map(|(index, one)| at("ramp", index, one.current)));
    }
    if let Some(pair) = &trial.controller.pid_pair {
        let path = "controller.pid_pair.co_contraction_{command_unit}";
        let both = pair.co_contraction;
        check.add(outside(document, path, both, [0.0, range.max]));
    }
}

/// Refuses a current outside a range; `path` is that of the current in the document.
pub(crate) fn outside(
    document: &Document<'_>,
    path: &str,
    current_amperes: f64,
    [min, max]: [f64; 2],
) -> Option<Problem> {
    let limits = json!({ "minimum": min, "maximum": max });
    broken_limit(current_amperes, &limits).map(|label| {
        let is_index = |key: &&str| key.starts_with(|c: char| c.is_ascii_digit());
        let keys = path.split('.').filter(|key| !is_index(key));
        let message = out_of_range(&Vec::from_iter(keys).join("."), current_amperes);
        document.problem(path, message, label)
    })
}
