//! Checks the times of pieces of the set-point, of a current profile, and of disturbances.

use std::collections::BTreeMap;

use super::Check;
use crate::document::Document;
use crate::structure::number;

/// Entry of an array of timed tables.
pub(super) struct Piece<'a> {
    pub(super) kind: &'a str,
    /// Node and output on which it acts, where it names them.
    pub(super) target: [Option<&'a str>; 2],
    pub(super) path: String,
    pub(super) start_key: &'static str,
    pub(super) start_seconds: f64,
    pub(super) until_seconds: Option<f64>,
}

/// Returns the entries of the arrays in a table, kind by kind.
pub(super) fn entries<'a>(document: &'a Document<'_>, table: &str) -> Vec<Piece<'a>> {
    let kinds = document.keys(table).into_iter();
    let pieces = kinds.flat_map(|kind| {
        let path = format!("{table}.{kind}");
        let entries = document.entries(&path).iter().enumerate();
        entries.filter_map(move |(index, entry)| {
            let entry = entry.get_ref().as_table()?;
            let seconds = |key: &str| number(entry.get(key)?.get_ref());
            let mut starts = ["at_seconds", "from_seconds"].into_iter();
            let (start_key, start_seconds) = starts.find_map(|key| Some((key, seconds(key)?)))?;
            Some(Piece {
                kind,
                target: ["node", "name"].map(|key| entry.get(key)?.get_ref().as_str()),
                path: format!("{path}.{index}"),
                start_key,
                start_seconds,
                until_seconds: seconds("until_seconds"),
            })
        })
    });
    pieces.collect()
}

/// Checks that the times of a table's entries are in order, that windows end after they begin, that one piece acts at a time, and
/// that none is after the end.
pub(super) fn pieces(check: &mut Check<'_>, table: &str, duration_seconds: f64) {
    let mut by_start = entries(check.document, table);
    order(check, table, &by_start, duration_seconds);
    by_start.sort_by(|left, right| left.start_seconds.total_cmp(&right.start_seconds));
    let is_double = |pair: &&[Piece<'_>]| {
        pair[0].start_seconds == pair[1].start_seconds && pair[0].kind != pair[1].kind
    };
    for pair in by_start.windows(2).filter(is_double) {
        let (first, second) = (&pair[0], &pair[1]);
        let time = second.start_seconds;
        let message = format!("two pieces of [{table}] start at {time} s");
        let label = format!("a {} starts at the same time", first.kind);
        let path = format!("{}.{}", second.path, second.start_key);
        check.at(&path, message, label);
    }
}

/// Checks that the times are in order within each kind, that windows end after they begin, and that none is after the end.
pub(super) fn order(
    check: &mut Check<'_>,
    table: &str,
    pieces: &[Piece<'_>],
    duration_seconds: f64,
) {
    let mut latest = BTreeMap::new();
    for piece in pieces {
        let Some(before) = latest.insert((piece.kind, piece.target), piece) else {
            continue;
        };
        if piece.start_seconds <= before.start_seconds {
            let message = format!("times of [[{table}.{}]] are out of order", piece.kind);
            let start = before.start_seconds;
            let label = format!("must be after {start} s, where the one before starts");
            let path = format!("{}.{}", piece.path, piece.start_key);
            check.at(&path, message, label);
        }
    }
    windows(check, table, pieces, duration_seconds);
}

/// Checks that windows end after they begin, and begin within the run.
pub(super) fn windows(
    check: &mut Check<'_>,
    table: &str,
    pieces: &[Piece<'_>],
    duration_seconds: f64,
) {
    for piece in pieces {
        let (path, start_seconds) = (&piece.path, piece.start_seconds);
        let heading = format!("[[{table}.{}]]", piece.kind);
        if start_seconds >= duration_seconds {
            let message = format!("{heading} starts after the end of the run");
            let label = format!("the run ends at {duration_seconds} s");
            check.at(&format!("{path}.{}", piece.start_key), message, label);
        }
        if piece
            .until_seconds
            .is_some_and(|until| until <= start_seconds)
        {
            let message = format!("{heading} ends before it begins");
            let label = format!("must be after {start_seconds} s");
            check.at(&format!("{path}.until_seconds"), message, label);
        }
    }
}
