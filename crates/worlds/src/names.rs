//! Names of the participants of a run, in messages and on the command line of their processes.

use plan::{ControlLoop, Plan, each_once};

pub(crate) use dbc::names::BENCH;
pub(crate) const PLANT_EMULATOR: &str = "plant-emulator";

/// Returns the names of the participants that canrig plays: the emulators of the plants whose drives are its own, then the
/// controller.
pub(crate) fn played(plan: &Plan) -> Vec<&str> {
    let loops = plan.loops.iter();
    let mut names = emulator_names(loops.filter(|one| one.drive().is_ours()));
    let controller = plan.controller();
    names.extend(controller.is_ours().then_some(controller.name.as_str()));
    names
}

/// Returns the names of the participants that emulate the plants of these loops, each once.
pub fn emulator_names<'a>(loops: impl IntoIterator<Item = &'a ControlLoop>) -> Vec<&'a str> {
    each_once(loops.into_iter().map(emulator_name))
}

/// Returns the name of the participant that emulates a loop's plant. With several loops it is the name of the first plant that
/// the participant emulates.
pub fn emulator_name(one: &ControlLoop) -> &str {
    match one.loop_name() {
        Some(_) => one.trial.plants.keys().next().map_or("", String::as_str),
        None => PLANT_EMULATOR,
    }
}
