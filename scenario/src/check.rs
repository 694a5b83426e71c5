//! Checks what the schema cannot say: what only makes sense together.

mod requirements;
mod signals;
mod sweep;
#[cfg(test)]
mod tests;

use std::io;

use crate::Scenario;
use crate::controller::{Controller, OpenLoop};
use crate::document::Document;
use crate::error::Problem;
use crate::expect::{Emergency, Limit};
use crate::fault;
use crate::plant;
use crate::reference::{Reference, Table};
use crate::table;

pub(crate) use signals::read_courses;
pub(crate) use sweep::check as sweep;

/// End of the travel.
const TRAVEL_MILLIMETRES: f64 = 60.0;

/// What scenario and controller view have in common.
pub(crate) struct Control<'a> {
    pub(crate) duration_seconds: f64,
    pub(crate) controller: &'a Controller,
    pub(crate) reference: &'a Reference,
}

/// Checks law, set-point and current profile.
pub(crate) fn control(document: &Document<'_>, control: &Control<'_>) -> Vec<Problem> {
    let mut problems = Vec::from_iter(laws(document, control.reference));
    problems.extend(pieces(
        document,
        "reference",
        &reference_pieces(control.reference),
        control.duration_seconds,
    ));
    problems.extend(travel(document, control.reference));
    if let Some(open_loop) = &control.controller.open_loop {
        let pieces_of_current = current_pieces(open_loop);
        problems.extend(pieces(
            document,
            "controller.open_loop",
            &pieces_of_current,
            control.duration_seconds,
        ));
    }
    problems
}

/// The name goes into terminals, XML and file names.
pub(crate) fn name(document: &Document<'_>, name: &str) -> Option<Problem> {
    name.contains(char::is_control).then(|| {
        let message = "`name` has a control character in it";
        document.problem("name", message, "one line of plain text")
    })
}

/// Checks disturbances, plant and limits.
pub(crate) fn bench(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let mut problems = disturbances(document, scenario);
    problems.extend(fault::check(document, scenario));
    problems.extend(plant::check(document, scenario));
    problems.extend(limits(document, scenario));
    problems.extend(reactions(document, scenario));
    problems.extend(signals::check(document, scenario));
    problems.extend(requirements::check(document, scenario));
    problems
}

/// Exactly one law, and a set-point for a closed loop.
fn laws(document: &Document<'_>, reference: &Reference) -> Option<Problem> {
    const HELP: &str = "exactly one table such as [controller.sliding_mode] chooses the law";
    match document.keys("controller").as_slice() {
        [] => {
            let span = document.key_span("controller");
            let problem = document
                .source
                .problem(span, "no control law", "a law is missing here");
            Some(problem.with_help(HELP))
        }
        ["open_loop"] => None,
        [law] if reference.is_empty() => {
            let span = document.key_span(&format!("controller.{law}"));
            let message = format!("the closed loop `{law}` has no set-point");
            let problem = document
                .source
                .problem(span, message, "needs one to follow");
            Some(problem.with_help("add [[reference.hold]], step, ramp, sine or table"))
        }
        [_] => None,
        [first, second, ..] => {
            let span = document.key_span(&format!("controller.{second}"));
            let label = format!("`{first}` is chosen already");
            Some(
                document
                    .source
                    .problem(span, "more than one control law", label)
                    .with_help(HELP),
            )
        }
    }
}

/// One entry of an array of timed tables.
struct Piece {
    kind: &'static str,
    index: usize,
    start_key: &'static str,
    start_seconds: f64,
    until_seconds: Option<f64>,
}

impl Piece {
    fn at(kind: &'static str, index: usize, start_seconds: f64) -> Self {
        let (start_key, until_seconds) = ("at_seconds", None);
        Self {
            kind,
            index,
            start_key,
            start_seconds,
            until_seconds,
        }
    }

    fn from(
        kind: &'static str,
        index: usize,
        start_seconds: f64,
        until_seconds: Option<f64>,
    ) -> Self {
        let start_key = "from_seconds";
        Self {
            kind,
            index,
            start_key,
            start_seconds,
            until_seconds,
        }
    }

    fn path(&self, table: &str, key: &str) -> String {
        format!("{table}.{}.{}.{key}", self.kind, self.index)
    }
}

fn reference_pieces(reference: &Reference) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let holds = reference.hold.iter().enumerate();
    pieces.extend(holds.map(|(index, hold)| Piece::at("hold", index, hold.at_seconds)));
    let steps = reference.step.iter().enumerate();
    pieces.extend(steps.map(|(index, step)| Piece::at("step", index, step.at_seconds)));
    let ramps = reference.ramp.iter().enumerate();
    pieces.extend(ramps.map(|(index, ramp)| {
        Piece::from("ramp", index, ramp.from_seconds, Some(ramp.until_seconds))
    }));
    let sines = reference.sine.iter().enumerate();
    pieces.extend(sines.map(|(index, sine)| Piece::from("sine", index, sine.from_seconds, None)));
    let tables = reference.table.iter().enumerate();
    pieces
        .extend(tables.map(|(index, table)| Piece::from("table", index, table.from_seconds, None)));
    pieces
}

fn current_pieces(open_loop: &OpenLoop) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let steps = open_loop.step.iter().enumerate();
    pieces.extend(steps.map(|(index, step)| Piece::at("step", index, step.at_seconds)));
    let ramps = open_loop.ramp.iter().enumerate();
    pieces.extend(ramps.map(|(index, ramp)| {
        Piece::from("ramp", index, ramp.from_seconds, Some(ramp.until_seconds))
    }));
    pieces
}

fn disturbance_pieces(scenario: &Scenario) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let fans = scenario.disturbance.fan.iter().enumerate();
    pieces.extend(
        fans.map(|(index, fan)| {
            Piece::from("fan", index, fan.from_seconds, Some(fan.until_seconds))
        }),
    );
    let loads = scenario.disturbance.load.iter().enumerate();
    pieces.extend(loads.map(|(index, load)| Piece::at("load", index, load.at_seconds)));
    pieces
}

/// Times in order, windows that end after they begin, one piece at a time, nothing after the end.
fn pieces(
    document: &Document<'_>,
    table: &str,
    pieces: &[Piece],
    duration_seconds: f64,
) -> Vec<Problem> {
    let mut problems = order(document, table, pieces, duration_seconds);
    let mut by_start: Vec<&Piece> = pieces.iter().collect();
    by_start.sort_by(|left, right| left.start_seconds.total_cmp(&right.start_seconds));
    let is_double = |pair: &&[&Piece]| {
        let [first, second] = pair else { return false };
        first.start_seconds == second.start_seconds && first.kind != second.kind
    };
    for pair in by_start.windows(2).filter(is_double) {
        let (first, second) = (pair[0], pair[1]);
        let time = second.start_seconds;
        let message = format!("two pieces of [{table}] start at {time} s");
        let label = format!("a {} starts at the same time", first.kind);
        problems.push(document.problem(&second.path(table, second.start_key), message, label));
    }
    problems
}

/// Times in order within each kind, windows that end after they begin, nothing after the end.
fn order(
    document: &Document<'_>,
    table: &str,
    pieces: &[Piece],
    duration_seconds: f64,
) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (place, piece) in pieces.iter().enumerate() {
        let Piece {
            kind,
            start_seconds,
            ..
        } = *piece;
        let start_path = piece.path(table, piece.start_key);
        let before = place.checked_sub(1).map(|place| &pieces[place]);
        if let Some(before) = before.filter(|before| before.kind == kind)
            && start_seconds <= before.start_seconds
        {
            let message = format!("times of [[{table}.{kind}]] are out of order");
            let label = format!(
                "must be after {} s, where the one before starts",
                before.start_seconds
            );
            problems.push(document.problem(&start_path, message, label));
        }
        if start_seconds >= duration_seconds {
            let message = format!("[[{table}.{kind}]] starts after the end of the run");
            let label = format!("the run ends at {duration_seconds} s");
            problems.push(document.problem(&start_path, message, label));
        }
        if piece
            .until_seconds
            .is_some_and(|until| until <= start_seconds)
        {
            let message = format!("[[{table}.{kind}]] ends before it begins");
            let label = format!("must be after {start_seconds} s");
            problems.push(document.problem(&piece.path(table, "until_seconds"), message, label));
        }
    }
    problems
}

/// Sines within the travel; single positions are in the schema's range already.
fn travel(document: &Document<'_>, reference: &Reference) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (index, sine) in reference.sine.iter().enumerate() {
        let lowest = sine.centre_millimetres - sine.amplitude_millimetres;
        let highest = sine.centre_millimetres + sine.amplitude_millimetres;
        if lowest < 0.0 || highest > TRAVEL_MILLIMETRES {
            let path = format!("reference.sine.{index}.amplitude_millimetres");
            let label = format!("goes from {lowest} to {highest} mm");
            let message = format!("the sine leaves the travel of 0 to {TRAVEL_MILLIMETRES} mm");
            problems.push(document.problem(&path, message, label));
        }
    }
    problems
}

/// Reads the tables of the set-point into their rows.
pub(crate) fn read_tables(
    document: &Document<'_>,
    tables: &mut [Table],
    mut read_table: impl FnMut(&str) -> io::Result<String>,
) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (index, entry) in tables.iter_mut().enumerate() {
        let path = format!("reference.table.{index}.file");
        let rows = read_beside(document, &path, &entry.file, &mut read_table)
            .and_then(|text| table::parse(&entry.file, &text));
        match rows {
            Ok(rows) => entry.rows = rows,
            Err(problem) => problems.push(problem),
        }
    }
    problems
}

/// The text of a table that the scenario names at a path.
fn read_beside(
    document: &Document<'_>,
    path: &str,
    file: &str,
    read_table: &mut impl FnMut(&str) -> io::Result<String>,
) -> Result<String, Problem> {
    if !table::is_inside_folder(file) {
        let message = "a table must lie in the scenario's folder";
        return Err(document.problem(path, message, "no absolute path, no `..`"));
    }
    read_table(file).map_err(|error| {
        let message = "the table cannot be read";
        document.problem(path, message, error.to_string())
    })
}

fn disturbances(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let pieces = disturbance_pieces(scenario);
    let mut problems = order(document, "disturbance", &pieces, scenario.duration_seconds);
    for (index, pair) in scenario.disturbance.fan.windows(2).enumerate() {
        let (first, second) = (&pair[0], &pair[1]);
        if first.from_seconds < second.from_seconds && second.from_seconds < first.until_seconds {
            let path = format!("disturbance.fan.{}.from_seconds", index + 1);
            let label = format!("the one before blows until {} s", first.until_seconds);
            problems.push(document.problem(&path, "two fans blow at a time", label));
        }
    }
    let Some(load_kilograms) = scenario.plant.load_kilograms() else {
        return problems;
    };
    let load_grams = load_kilograms * 1e3;
    for (index, load) in scenario.disturbance.load.iter().enumerate() {
        if load_grams + load.added_grams <= 0.0 {
            let path = format!("disturbance.load.{index}.added_grams");
            let label = format!("must leave something of {load_grams} g");
            problems.push(document.problem(&path, "nothing is left of the load", label));
        }
    }
    problems
}

/// Limits that can be met, on metrics that the scenario has.
fn limits(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let mut problems = Vec::new();
    let timing = scenario.expect.timing.limits();
    let limits = scenario.expect.limits();
    let limits = limits.map(|(name, limit)| (name.to_owned(), limit));
    for (name, limit) in limits.chain(timing.map(|(path, limit)| (format!("timing.{path}"), limit)))
    {
        let path = format!("expect.{name}");
        problems.extend(limit_problem(document, &path, &name, limit).or_else(|| {
            let missing = missing_for(&name, scenario)?;
            let message = format!("`{name}` cannot be judged");
            Some(document.problem(&path, message, format!("needs {missing}")))
        }));
    }
    problems
}

/// A limit that no value or every value meets.
fn limit_problem(document: &Document<'_>, path: &str, name: &str, limit: Limit) -> Option<Problem> {
    let (message, label) = match (limit.min, limit.max) {
        (None, None) => (
            format!("the limit `{name}` is empty"),
            "give min, max or both".to_owned(),
        ),
        (Some(min), Some(max)) if min > max => (
            format!("no value meets the limit `{name}`"),
            format!("min {min} is above max {max}"),
        ),
        _ => return None,
    };
    Some(document.problem(path, message, label))
}

/// Reactions that can be demanded: there is a fault, and emergencies are named as the standard numbers them.
fn reactions(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let expect = &scenario.expect;
    let mut problems = Vec::new();
    let demanded = [
        (
            "current_zero_within_milliseconds",
            expect.current_zero_within_milliseconds.is_some(),
        ),
        (
            "recovers_within_seconds",
            expect.recovers_within_seconds.is_some(),
        ),
        ("safe_state", expect.safe_state.is_some()),
        ("emcy", !expect.emcy.is_empty()),
    ];
    for (name, _) in demanded.into_iter().filter(|(_, is_given)| *is_given) {
        if scenario.fault.is_empty() {
            let message = format!("`{name}` cannot be judged");
            let path = format!("expect.{name}");
            problems.push(document.problem(&path, message, "needs a [[fault.…]]"));
        }
    }
    for (index, text) in expect.emcy.iter().enumerate() {
        if let Err(reason) = text.parse::<Emergency>() {
            let message = format!("\"{text}\" names no emergency");
            let path = format!("expect.emcy.{index}");
            problems.push(document.problem(&path, message, reason));
        }
    }
    if expect.recovers_within_seconds.is_some() && scenario.reference.is_empty() {
        let message = "`recovers_within_seconds` cannot be judged";
        let path = "expect.recovers_within_seconds";
        problems.push(document.problem(path, message, "needs a [[reference.…]]"));
    }
    problems
}

/// What the scenario lacks for a metric.
fn missing_for(metric: &str, scenario: &Scenario) -> Option<&'static str> {
    let disturbance = &scenario.disturbance;
    match metric {
        "settling_time_seconds" | "overshoot_percent" if scenario.reference.step.is_empty() => {
            Some("a [[reference.step]]")
        }
        "steady_state_error_millimetres" | "tracking_error_millimetres_rms"
            if scenario.reference.is_empty() =>
        {
            Some("a [[reference.…]]")
        }
        "sine_gain" | "sine_phase_degrees" | "sine_offset_millimetres"
            if scenario.judged_sine().is_none() =>
        {
            Some("a [[reference.sine]] of at least four periods")
        }
        "maximum_deviation_millimetres" | "recovery_time_seconds"
            if disturbance.fan.is_empty() && disturbance.load.is_empty() =>
        {
            Some("a [[disturbance.…]]")
        }
        "maximum_deviation_millimetres" | "recovery_time_seconds"
            if scenario.reference.is_empty() =>
        {
            Some("a [[reference.…]]")
        }
        _ => None,
    }
}
