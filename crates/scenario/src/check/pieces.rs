//! Checks the times of pieces of the set-point, of a current profile, and of disturbances.

use crate::controller::OpenLoop;
use crate::document::Document;
use crate::error::Problem;
use crate::reference::Reference;
use crate::trial::Trial;

/// Entry of an array of timed tables.
pub(super) struct Piece {
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

pub(super) fn reference_pieces(reference: &Reference) -> Vec<Piece> {
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
    let chirps = reference.chirp.iter().enumerate();
    pieces.extend(chirps.map(|(index, chirp)| {
        Piece::from(
            "chirp",
            index,
            chirp.from_seconds,
            Some(chirp.until_seconds),
        )
    }));
    let tables = reference.table.iter().enumerate();
    pieces
        .extend(tables.map(|(index, table)| Piece::from("table", index, table.from_seconds, None)));
    pieces
}

pub(super) fn current_pieces(open_loop: &OpenLoop) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let steps = open_loop.step.iter().enumerate();
    pieces.extend(steps.map(|(index, step)| Piece::at("step", index, step.at_seconds)));
    let ramps = open_loop.ramp.iter().enumerate();
    pieces.extend(ramps.map(|(index, ramp)| {
        Piece::from("ramp", index, ramp.from_seconds, Some(ramp.until_seconds))
    }));
    let tables = open_loop.table.iter().enumerate();
    pieces
        .extend(tables.map(|(index, table)| Piece::from("table", index, table.from_seconds, None)));
    pieces
}

pub(super) fn disturbance_pieces(trial: &Trial) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let fans = trial.disturbance.fan.iter().enumerate();
    pieces.extend(
        fans.map(|(index, fan)| {
            Piece::from("fan", index, fan.from_seconds, Some(fan.until_seconds))
        }),
    );
    let loads = trial.disturbance.load.iter().enumerate();
    pieces.extend(loads.map(|(index, load)| Piece::at("load", index, load.at_seconds)));
    let outputs = trial.disturbance.output.iter().enumerate();
    pieces.extend(outputs.map(|(index, output)| Piece {
        until_seconds: output.until_seconds,
        ..Piece::at("output", index, output.at_seconds)
    }));
    pieces
}

/// Checks that the times are in order, that windows end after they begin, that one piece acts at a time, and that none is after
/// the end.
pub(super) fn pieces(
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

/// Checks that the times are in order within each kind, that windows end after they begin, and that none is after the end.
pub(super) fn order(
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
