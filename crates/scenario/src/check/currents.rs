//! Currents that the amplifier of a drive cannot be commanded.

use crate::controller::OpenLoop;
use crate::document::Document;
use crate::error::Problem;
use crate::trial::Trial;

/// The currents of the law of a loop.
pub(super) fn of_law(document: &Document<'_>, trial: &Trial) -> Vec<Problem> {
    let range = trial.wiring.current();
    let mut problems = Vec::new();
    if let Some(OpenLoop { step, ramp, .. }) = &trial.controller.open_loop {
        let path = |piece: &str, index: usize| {
            format!("controller.open_loop.{piece}.{index}.current_amperes")
        };
        let steps = step.iter().enumerate();
        let steps = steps.map(|(index, step)| (path("step", index), step.current_amperes));
        let ramps = ramp.iter().enumerate();
        let ramps = ramps.map(|(index, ramp)| (path("ramp", index), ramp.current_amperes));
        let within = [range.min, range.max];
        problems.extend(
            steps
                .chain(ramps)
                .filter_map(|(path, current)| outside(document, &path, current, within)),
        );
    }
    if let Some(pair) = &trial.controller.pid_pair {
        let path = "controller.pid_pair.co_contraction_amperes";
        let both = pair.co_contraction_amperes;
        problems.extend(outside(document, path, both, [0.0, range.max]));
    }
    problems
}

/// A current at a path that is not within these.
pub(crate) fn outside(
    document: &Document<'_>,
    path: &str,
    current_amperes: f64,
    [min, max]: [f64; 2],
) -> Option<Problem> {
    (!(min..=max).contains(&current_amperes)).then(|| {
        let keys = path
            .split('.')
            .filter(|key| !key.starts_with(|c: char| c.is_ascii_digit()));
        let key = Vec::from_iter(keys).join(".");
        let message = format!("`{key}` = {current_amperes} is out of range");
        document.problem(path, message, format!("must be from {min} to {max}"))
    })
}
