//! Experiment on the ripple of the current while the load is held.

use scenario::expect::Expect;

use super::bases;
use super::experiment::{ComparedLaw, Evaluation, Experiment, Keep, Kept, PlannedRun};
use super::quantity::{Quantity, at_most};

/// Heights at which the ripple is measured, and its target.
const HEIGHTS_MILLIMETRES: [f64; 4] = [5.0, 20.1, 35.0, 45.0];
const RIPPLE_AMPERES: f64 = 0.02;

/// Returns the experiment of this file.
pub(super) fn experiment() -> Experiment {
    let runs = HEIGHTS_MILLIMETRES.into_iter().flat_map(|height| {
        let mut scenario = bases::step();
        scenario.reference.hold[0].position = height;
        scenario.reference.step.clear();
        scenario.expect =
            Expect::default().with_max("{command}_ripple_{command_unit}_rms", RIPPLE_AMPERES);
        let expect = scenario.expect.clone();
        PlannedRun::with_twin(&scenario, Keep::Verdict)
            .into_iter()
            .map(move |mut run| {
                run.scenario.expect = expect.clone();
                run.label = format!("{}, {height} mm", run.label);
                run
            })
    });
    Experiment {
        id: "ripple",
        title: "Ripple of the current in a hold",
        text: "Positions are held for 12 s. The steps of the converter shake a law that trusts them: ripple is the standard deviation of the \
               commanded current from 1 s after the position has come to stay. The paper shows it in its figures and gives no number.",
        runs: runs.collect(),
        evaluate: |runs| Evaluation {
            numbers: runs.iter().map(ripple).collect(),
            ..Evaluation::default()
        },
    }
}

/// Returns the ripple: with a target for `sliding_mode`, without one for the other laws.
fn ripple(run: &Kept) -> Quantity {
    let name = "current_ripple_amperes_rms";
    let value = match run.row(name) {
        None => Err("not measured".to_owned()),
        Some(row) => row
            .value
            .ok_or_else(|| row.remark.clone().unwrap_or_default()),
    };
    let is_ours = run.scenario.controller.law_name() == ComparedLaw::SlidingMode.name();
    let target = at_most(RIPPLE_AMPERES).filter(|_| is_ours);
    Quantity::derived(name, run.label.as_str(), value, target).with_model(run.model())
}
