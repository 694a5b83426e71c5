//! Checks that the schema cannot express: values that must fit each other.

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

use std::collections::BTreeMap;

use crate::controller::drives_led_by;
use crate::disturbance::{Change, Disturbance};
use crate::document::Document;
use crate::error::Problem;
use crate::expect::Expect;
use crate::nearest::meant_or_known;
use crate::node::Nodes;
use crate::reference::Reference;
use crate::rig::nodes::{LOAD_OUTPUT, Outputs, Rig, kind_of_output};
use crate::run::Run;
use crate::structure::out_of_range;
use crate::trial::Trial;
use crate::wiring::Wiring;
use dbc::{Quantities, Quantity, UNIT, conversion, plant_of_port};

pub(crate) use files::NamedFiles;
pub(crate) use sweep::check as sweep;
pub(crate) use tables::read_tables;

use fault::faults;
pub(crate) use fault::faults_of_loops;
pub(crate) use limits::{limits, reactions};
use pieces::{entries, order, pieces};
pub(crate) use plant::{cooling, temperatures};

/// A document, the rig of the run, and the problems that are found so far.
pub(crate) struct Check<'a> {
    pub(crate) document: &'a Document<'a>,
    pub(crate) rig: &'a Rig,
    pub(crate) problems: Vec<Problem>,
}

impl<'a> Check<'a> {
    /// Makes a check that has found these problems.
    pub(crate) fn new(document: &'a Document<'a>, rig: &'a Rig, problems: Vec<Problem>) -> Self {
        Self {
            document,
            rig,
            problems,
        }
    }

    /// Reports problems.
    pub(crate) fn add(&mut self, problems: impl IntoIterator<Item = Problem>) {
        self.problems.extend(problems);
    }

    /// Reports a problem at the value at a path.
    pub(crate) fn at(&mut self, path: &str, message: impl Into<String>, label: impl Into<String>) {
        self.add([self.document.problem(path, message, label)]);
    }

    /// Reports a problem at the key at a path.
    pub(crate) fn at_key(
        &mut self,
        path: &str,
        message: impl Into<String>,
        label: impl Into<String>,
    ) {
        self.add([self.document.key_problem(path, message, label)]);
    }
}

/// Gains to start from: the quotient of the sensor's range by the error that commands the largest current, and the integral and
/// derivative gains by the proportional one. So they are those of `scenarios/motor_step.toml`, nearly.
const FULL_COMMANDS_IN_RANGE: f64 = 4.0;
const START_INTEGRAL_PER_SECOND: f64 = 7.5;
const START_DERIVATIVE_SECONDS: f64 = 0.06;

/// Checks the trial of a loop.
pub(crate) fn trial(check: &mut Check<'_>, trial: &Trial) {
    let document = check.document;
    check.add(laws(document, trial));
    check.add(led_drives(document, &trial.wiring));
    check.add(law_of_a_wire(document, trial));
    check.add(pair_of_one_quantity(document, trial));
    check.add(missing_gain(document, trial));
    check.add(co_contraction(document, trial));
    for table in ["reference", "controller.open_loop"] {
        pieces(check, table, trial.run.duration_seconds);
    }
    travel(check, trial);
    chirps(check, &trial.reference);
    signals::check(check, &trial.expect, trial.run.duration_seconds);
    let expects = [&trial.expect, &trial.run.expect];
    requirements::check(check, expects, &trial.wiring.quantities);
}

/// Checks the facts that all loops share.
pub(crate) fn run(check: &mut Check<'_>, run: &Run, nodes: &Nodes) {
    name(check, "name", &run.name);
    requirements::names(check, "requirements", &run.requirements);
    limits::of_bus(check, &run.expect);
    let expects = [&run.expect, &Expect::default()];
    requirements::check(check, expects, &Quantities::default());
    signals::check(check, &run.expect, run.duration_seconds);
    disturbances(check, run);
    faults(check, &run.faults, nodes, run.duration_seconds);
}

/// Refuses control characters: the name goes into terminals, XML and file names.
pub(crate) fn name(check: &mut Check<'_>, path: &str, name: &str) {
    if name.contains(char::is_control) {
        let message = "`name` has a control character in it";
        check.at(path, message, "one line of plain text");
    }
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
    let count = wiring.drives_commanded();
    (led != count).then(|| {
        let message = format!("the law `{law}` leads {}", drives(led));
        let label = format!("the loop has {}", drives(count));
        document.key_problem(&format!("controller.{law}"), message, label)
    })
}

/// Refuses a law of a wire in a loop that commands no current or measures no length: these laws know how a current heats the wire,
/// and how long it then is.
fn law_of_a_wire(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    let is_of_wire = |law: &&str| ["sliding_mode", "sliding_mode_paper"].contains(law);
    let law = trial.controller.law_names().find(is_of_wire)?;
    let Quantities { feedback, output } = &trial.wiring.quantities;
    let (message, label) = if *output != Quantity::current() {
        let label = format!("the loop's command is `{}`", output.words());
        (format!("`{law}` commands a current"), label)
    } else {
        let is_length = conversion(feedback.unit.word(), "metres").is_some();
        let label = (!is_length).then(|| format!("the loop is in {}", feedback.unit))?;
        (format!("`{law}` leads a length"), label)
    };
    Some(document.key_problem(&format!("controller.{law}"), message, label))
}

/// Refuses a pair of drives whose commands are in two units: the output of the law is added to one and taken from the other.
fn pair_of_one_quantity(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    let wiring = &trial.wiring;
    trial.controller.pid_pair.as_ref()?;
    let first = &wiring.quantities.output.unit;
    let loops = wiring.shared.loops.iter();
    let other = loops
        .filter(|one| one.is_led_by(&wiring.loop_name))
        .map(|one| &one.quantities.output.unit)
        .find(|unit| *unit != first)?;
    let label = format!("the drives' commands are in {first} and in {other}");
    Some(document.key_problem(
        "controller.pid_pair",
        "`pid_pair` commands one quantity",
        label,
    ))
}

/// Demands the gains of `pid` in a loop that is not that of a wire's position: the default gains are that one's, by the metre.
fn missing_gain(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    const GAINS: [&str; 3] = [
        "proportional_{gain}",
        "integral_{gain}_second",
        "derivative_{gain_seconds}",
    ];
    let feedback = &trial.wiring.feedback;
    let unit = &feedback.quantity.unit;
    let metres = conversion(unit.word(), "metres");
    let is_of_wire = metres.is_some() && trial.plant().actuator().is_some();
    trial.controller.pid.as_ref().filter(|_| !is_of_wire)?;
    let path = "controller.pid";
    let is_missing = |gain: &&&str| !document.has(&format!("{path}.{gain}"));
    let gain = GAINS.iter().find(is_missing)?;
    let message = format!("`pid` lacks `{gain}`");
    let label = "without it, it is that of a wire in metres";
    let [lowest, highest] = feedback.range();
    let range = (highest - lowest) * metres.unwrap_or(1.0);
    let proportional = FULL_COMMANDS_IN_RANGE * trial.wiring.amplifier.range().max / range;
    let integral = proportional * START_INTEGRAL_PER_SECOND;
    let derivative = proportional * START_DERIVATIVE_SECONDS;
    let gains = GAINS.iter().zip([proportional, integral, derivative]);
    let named = gains.map(|(gain, value)| {
        let gain = trial.wiring.quantities.name(gain);
        format!("{gain} = {}", with_three_digits(value))
    });
    let help = format!("to start from: {}", Vec::from_iter(named).join(", "));
    Some(document.key_problem(path, message, label).with_help(help))
}

/// Writes a positive number with three digits that count.
fn with_three_digits(value: f64) -> String {
    let digits = 2.0 - libm::floor(libm::log10(value));
    let scale = libm::pow(10.0, digits);
    format!("{}", libm::round(value * scale) / scale)
}

/// Checks the current of a pair at rest, given or by default, against the amplifier.
fn co_contraction(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    let current = trial.controller.pid_pair.as_ref()?.co_contraction;
    let max = trial.wiring.amplifier.range().max;
    let path = "controller.pid_pair.co_contraction_{command_unit}";
    let label = format!("must be from 0 to {max}");
    (current > max).then(|| document.problem(path, out_of_range(path, current), label))
}

/// Checks that sines and chirps stay within the travel. The schema limits single positions.
fn travel(check: &mut Check<'_>, trial: &Trial) {
    let feedback = &trial.wiring.feedback;
    let ([min, max], symbol) = (feedback.range(), feedback.quantity.unit.symbol());
    let Reference { sine, chirp, .. } = &trial.reference;
    let sines = sine.iter().map(|one| (one.centre, one.amplitude));
    let chirps = chirp.iter().map(|one| (one.centre, one.amplitude));
    let named_sines = sines.enumerate().map(|one| ("sine", one));
    let pieces = named_sines.chain(chirps.enumerate().map(|one| ("chirp", one)));
    for (kind, (index, (centre, amplitude))) in pieces {
        let (lowest, highest) = (centre - amplitude, centre + amplitude);
        if lowest < min || highest > max {
            let path = format!("reference.{kind}.{index}.amplitude_{UNIT}");
            let message = format!("the {kind} leaves the travel of {min} to {max} {symbol}");
            let label = format!("goes from {lowest} to {highest} {symbol}");
            check.at(&path, message, label);
        }
    }
}

/// Checks that the frequency of each chirp moves.
fn chirps(check: &mut Check<'_>, reference: &Reference) {
    let chirps = reference.chirp.iter().enumerate();
    for (index, _) in chirps.filter(|(_, chirp)| chirp.from_hertz == chirp.until_hertz) {
        let path = format!("reference.chirp.{index}.until_hertz");
        let message = "the frequency of the chirp does not move";
        let label = "the same as from_hertz; [[reference.sine]] has one frequency";
        check.at(&path, message, label);
    }
}

/// Finds disturbances for which no io node has an output.
fn unused_outputs(check: &mut Check<'_>, disturbance: &Disturbance) {
    let rig = check.rig;
    let has = |change: &Change| {
        let mut nodes = rig.io_with(&change.output);
        // An unknown node is another problem.
        let is_known = change.node.is_empty() || rig.node.contains_key(&change.node);
        !is_known || nodes.any(|name| change.node.is_empty() || name == change.node)
    };
    let outputs = rig.node.values().flat_map(|node| &node.outputs);
    let others = outputs.flat_map(Outputs::others);
    let known = Vec::from_iter(others.map(|(name, _)| name.as_str()));
    let changes = disturbance.changes().into_iter();
    for Change { path, output, .. } in changes.filter(|change| !has(change)) {
        if let Some(kind) = kind_of_output(&output) {
            let message = format!("no io node has a {kind} at this plant");
            check.at(&path, message, format!("its outputs have no `{output}`"));
            continue;
        }
        let message = format!("no io node has an output `{output}` at this plant");
        let label = if known.is_empty() {
            "a rig file names outputs: outputs = { NAME = \"PLANT.PORT\" }".to_owned()
        } else {
            meant_or_known(&output, &known)
        };
        check.at(&format!("{path}.name"), message, label);
    }
}

fn disturbances(check: &mut Check<'_>, run: &Run) {
    let table = "disturbance";
    let (mut pieces, changes) = (entries(check.document, table), run.disturbance.changes());
    let named = changes.iter().map(|change| (&*change.path, &*change.node));
    let nodes = BTreeMap::from_iter(named);
    // An entry of no node is a problem already.
    pieces.retain_mut(|piece| {
        let node = nodes.get(&*piece.path).copied().or(piece.target[0]);
        piece.target[0] = node;
        node.is_some_and(|node| check.rig.node.contains_key(node))
    });
    order(check, table, &pieces, run.duration_seconds);
    let mut latest = BTreeMap::new();
    for (index, fan) in run.disturbance.fan.iter().enumerate() {
        if let Some(first) = latest.insert(&fan.node, fan)
            && check.rig.node.contains_key(&fan.node)
            && first.from_seconds < fan.from_seconds
            && fan.from_seconds < first.until_seconds
        {
            let path = format!("disturbance.fan.{index}.from_seconds");
            let label = format!("the one before blows until {} s", first.until_seconds);
            check.at(&path, "two fans blow at a time", label);
        }
    }
    unused_outputs(check, &run.disturbance);
    let load_grams = |io: &str| {
        let outputs = check.rig.node.get(io)?.outputs.as_ref()?;
        let plant = check
            .rig
            .plant
            .get(plant_of_port(outputs.port(LOAD_OUTPUT)?)?)?;
        Some(1e3 * plant.load_kilograms()?)
    };
    for (index, load) in run.disturbance.load.iter().enumerate() {
        let hanging = load_grams(&load.node).filter(|grams| grams + load.added_grams <= 0.0);
        if let Some(load_grams) = hanging {
            let path = format!("disturbance.load.{index}.added_grams");
            let label = format!("must leave something of {load_grams} g");
            check.at(&path, "nothing is left of the load", label);
        }
    }
}
