//! Names of the participants of a run, in messages and on the command line of their processes.

use plan::{ControlLoop, Plan, each_once};
use scenario::node::Part;

pub(crate) use dbc::names::BENCH;
pub(crate) const PLANT_EMULATOR: &str = "plant-emulator";

/// Returns the names of the participants that emulate the plants whose drives are canrig's.
pub(crate) fn played_emulators(plan: &Plan) -> Vec<&str> {
    let loops = plan.loops.iter();
    emulator_names(loops.filter(|one| one.is_ours(Part::Drive)))
}

/// Returns the names of the participants that emulate the plants of these loops, each once.
pub fn emulator_names<'a>(loops: impl IntoIterator<Item = &'a ControlLoop>) -> Vec<&'a str> {
    each_once(loops.into_iter().map(emulator_name))
}

/// Returns the name of the participant that emulates a loop's plant. With several loops it is the name of the first plant that
/// the participant emulates.
pub fn emulator_name(one: &ControlLoop) -> &str {
    match one.loop_name() {
        Some(_) => &one.trial.wiring.emulated_with,
        None => PLANT_EMULATOR,
    }
}
