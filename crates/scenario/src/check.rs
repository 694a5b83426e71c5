//! Checks that the schema cannot express: values that must fit each other.

mod currents;
mod fault;
mod files;
mod limits;
mod pieces;
mod plant;
mod requirements;
mod signals;
mod sweep;
mod tables;
#[cfg(test)]
mod tests;

use crate::controller::drives_led_by;
use crate::disturbance::{Change, Disturbance};
use crate::document::Document;
use crate::error::Problem;
use crate::nearest::meant_or_known;
use crate::port::{Command, UNIT, conversion};
use crate::reference::Reference;
use crate::rig::nodes::{Outputs, Rig, kind_of_output};
use crate::run::Run;
use crate::trial::Trial;
use crate::wiring::Wiring;

pub(crate) use files::NamedFiles;
pub(crate) use sweep::check as sweep;
pub(crate) use tables::read_tables;

pub(crate) use currents::outside;
use fault::faults;
pub(crate) use fault::faults_of_plants;
use limits::limits;
pub(crate) use limits::reactions;
use pieces::{entries, order, pieces};
pub(crate) use plant::{cooling, temperatures};

/// Checks the trial of a loop.
pub(crate) fn trial(document: &Document<'_>, trial: &Trial, rig: &Rig) -> Vec<Problem> {
    let duration_seconds = trial.run.duration_seconds;
    let mut problems = Vec::from_iter(laws(document, trial));
    problems.extend(led_drives(document, &trial.wiring));
    problems.extend(law_without_current(document, trial));
    problems.extend(gains_in_other_unit(document, trial));
    for table in ["reference", "controller.open_loop"] {
        problems.extend(pieces(document, table, duration_seconds));
    }
    problems.extend(travel(document, trial));
    problems.extend(chirps(document, &trial.reference));
    problems.extend(currents::problems(document, trial));
    problems.extend(disturbances(document, trial, rig));
    problems.extend(limits(document, trial));
    problems.extend(signals::check(document, trial, rig));
    problems.extend(requirements::problems(document, trial));
    problems
}

/// Checks the facts that all loops share.
pub(crate) fn run(document: &Document<'_>, run: &Run, rig: &Rig) -> Vec<Problem> {
    let mut problems = Vec::from_iter(name(document, &run.name));
    problems.extend(requirements::names(
        document,
        "requirements",
        &run.requirements,
    ));
    problems.extend(faults(document, &run.faults, rig, run.duration_seconds));
    problems
}

/// Refuses control characters: the name goes into terminals, XML and file names.
pub(crate) fn name(document: &Document<'_>, name: &str) -> Option<Problem> {
    name.contains(char::is_control).then(|| {
        let message = "`name` has a control character in it";
        document.problem("name", message, "one line of plain text")
    })
}

/// Checks that there is exactly one law, and a set-point for a closed loop.
fn laws(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    const HELP: &str = "exactly one table such as [controller.sliding_mode] chooses the law";
    match document.keys("controller").as_slice() {
        [] => {
            let span = document.key_span("controller");
            // The table may be that of a loop or of all loops.
            let label = match document.source.text(&span) {
                "controller" => {
                    "name the law: [controller.sliding_mode], [controller.pid]".to_owned()
                }
                table => format!("name the law: [controller.{table}.pid]"),
            };
            Some(document.key_problem("controller", "no control law", label))
        }
        ["open_loop"] => None,
        [law] if trial.reference.is_empty() => {
            let message = format!("the closed loop `{law}` has no set-point");
            let path = format!("controller.{law}");
            let problem = document.key_problem(&path, message, "needs one to follow");
            Some(problem.with_help("add [[reference.hold]], step, ramp, sine, chirp or table"))
        }
        [_] => None,
        [first, second, ..] => {
            let message = "more than one control law";
            let path = |law: &str| format!("controller.{law}");
            let problem = document.key_problem(&path(second), message, "the second law");
            let first = document.key_span(&path(first));
            Some(problem.with_place(first, "the first law").with_help(HELP))
        }
    }
}

/// Checks that the law leads as many drives as its loop has.
fn led_drives(document: &Document<'_>, wiring: &Wiring) -> Option<Problem> {
    let keys = document.keys("controller");
    let [law] = keys.as_slice() else { return None };
    // A profile belongs to the first drive; the others have no current.
    if *law == "open_loop" {
        return None;
    }
    let led = drives_led_by(law)?;
    let drives = |count: usize| match count {
        1 => "one drive".to_owned(),
        count => format!("{count} drives"),
    };
    let count = 1 + wiring.also_leads;
    (led != count).then(|| {
        let message = format!("the law `{law}` leads {}", drives(led));
        let label = format!("the loop has {}", drives(count));
        document.key_problem(&format!("controller.{law}"), message, label)
    })
}

/// Refuses a law of a wire in a loop that commands no current: these laws know how a current heats the wire.
fn law_without_current(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    let command = trial.wiring.feedback.measurand.command;
    if command == Command::Current {
        return None;
    }
    let is_of_wire = |law: &&str| ["sliding_mode", "sliding_mode_paper"].contains(law);
    let law = trial.controller.law_names().find(is_of_wire)?;
    let message = format!("`{law}` commands a current");
    let label = format!("the loop commands a {}", command.signal());
    Some(document.key_problem(&format!("controller.{law}"), message, label))
}

/// Demands the gains of `pid` in a loop whose position is no length: the default gains are those of a wire, by the metre.
fn gains_in_other_unit(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    const GAINS: [&str; 3] = [
        "proportional_{gain}",
        "integral_{gain}_second",
        "derivative_{gain_seconds}",
    ];
    let unit = &trial.wiring.feedback.measurand.unit;
    let is_length = conversion(unit.word(), "metres").is_some();
    trial.controller.pid.as_ref().filter(|_| !is_length)?;
    let path = "controller.pid";
    let is_missing = |gain: &&&str| !document.has(&format!("{path}.{gain}"));
    let gain = GAINS.iter().find(is_missing)?;
    let message = format!("`pid` lacks `{gain}`");
    let label = "without it, it is that of a wire in metres";
    Some(document.key_problem(path, message, label))
}

/// Checks that sines and chirps stay within the travel. The schema limits single positions.
fn travel(document: &Document<'_>, trial: &Trial) -> Vec<Problem> {
    let feedback = &trial.wiring.feedback;
    let ([min, max], symbol) = (feedback.range(), feedback.measurand.unit.symbol());
    let Reference { sine, chirp, .. } = &trial.reference;
    let sines = sine.iter().map(|one| (one.centre, one.amplitude));
    let chirps = chirp.iter().map(|one| (one.centre, one.amplitude));
    let sines = sines.enumerate().map(|one| ("sine", one));
    let pieces = sines.chain(chirps.enumerate().map(|one| ("chirp", one)));
    let leaving = pieces.filter_map(|(kind, (index, (centre, amplitude)))| {
        let (lowest, highest) = (centre - amplitude, centre + amplitude);
        (lowest < min || highest > max).then(|| {
            let path = format!("reference.{kind}.{index}.amplitude_{UNIT}");
            let message = format!("the {kind} leaves the travel of {min} to {max} {symbol}");
            let label = format!("goes from {lowest} to {highest} {symbol}");
            document.problem(&path, message, label)
        })
    });
    leaving.collect()
}

/// Checks that the frequency of each chirp moves.
fn chirps(document: &Document<'_>, reference: &Reference) -> Vec<Problem> {
    let chirps = reference.chirp.iter().enumerate();
    let still = chirps.filter(|(_, chirp)| chirp.from_hertz == chirp.until_hertz);
    let problems = still.map(|(index, _)| {
        let path = format!("reference.chirp.{index}.until_hertz");
        let message = "the frequency of the chirp does not move";
        let label = "the same as from_hertz; [[reference.sine]] has one frequency";
        document.problem(&path, message, label)
    });
    problems.collect()
}

/// Finds disturbances for which no io node has an output.
fn unused_outputs(document: &Document<'_>, disturbance: &Disturbance, rig: &Rig) -> Vec<Problem> {
    let has = |change: &Change| {
        let mut nodes = rig.io_with(&change.output);
        nodes.any(|name| change.node.is_empty() || name == change.node)
    };
    let outputs = rig.node.values().flat_map(|node| &node.outputs);
    let others = outputs.flat_map(Outputs::others);
    let known = Vec::from_iter(others.map(|(name, _)| name.as_str()));
    let changes = disturbance.changes().into_iter();
    let problems = changes.filter(|change| !has(change)).map(|change| {
        let Change { path, output, .. } = &change;
        if let Some(kind) = kind_of_output(output) {
            let message = format!("no io node has a {kind} at this plant");
            let label = format!("its outputs have no `{output}`");
            return document.problem(path, message, label);
        }
        let message = format!("no io node has an output `{output}` at this plant");
        let label = if known.is_empty() {
            "a rig file names outputs: outputs = { NAME = \"PLANT.PORT\" }".to_owned()
        } else {
            meant_or_known(output, &known)
        };
        document.problem(&format!("{path}.name"), message, label)
    });
    problems.collect()
}

fn disturbances(document: &Document<'_>, trial: &Trial, rig: &Rig) -> Vec<Problem> {
    let table = "disturbance";
    let pieces = entries(document, table);
    let mut problems = order(document, table, &pieces, trial.run.duration_seconds);
    for (index, pair) in trial.disturbance.fan.windows(2).enumerate() {
        let (first, second) = (&pair[0], &pair[1]);
        let is_same = first.node == second.node;
        if is_same
            && first.from_seconds < second.from_seconds
            && second.from_seconds < first.until_seconds
        {
            let path = format!("disturbance.fan.{}.from_seconds", index + 1);
            let label = format!("the one before blows until {} s", first.until_seconds);
            problems.push(document.problem(&path, "two fans blow at a time", label));
        }
    }
    problems.extend(unused_outputs(document, &trial.disturbance, rig));
    let Some(load_kilograms) = trial.plant.load_kilograms() else {
        return problems;
    };
    let load_grams = load_kilograms * 1e3;
    for (index, load) in trial.disturbance.load.iter().enumerate() {
        if load_grams + load.added_grams <= 0.0 {
            let path = format!("disturbance.load.{index}.added_grams");
            let label = format!("must leave something of {load_grams} g");
            problems.push(document.problem(&path, "nothing is left of the load", label));
        }
    }
    problems
}
