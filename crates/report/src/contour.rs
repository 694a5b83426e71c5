//! The loops of a contour, for the page and for the viewer.

use std::ops::Range;

use scenario::loops::Contour;

use crate::run::Run;

/// A loop by its name.
pub(crate) type Axis<'a> = (&'a str, &'a Run<'a>);

/// The loops of a contour, as far as the run has them.
pub(crate) fn axes<'a>(contour: &'a Contour, runs: &'a [Run<'a>]) -> Vec<Axis<'a>> {
    let axis = |name: &'a String| {
        let is_named = |run: &&Run<'_>| {
            let names = run.setup.loop_name.as_ref();
            names.is_some_and(|names| names.name == *name)
        };
        Some((name.as_str(), runs.iter().find(is_named)?))
    };
    contour.loops.iter().filter_map(axis).collect()
}

/// The rows of a contour's window, which all its loops have.
pub(crate) fn window(contour: &Contour, axes: &[Axis<'_>]) -> Range<usize> {
    let timelines = || axes.iter().map(|(_, run)| run.timeline);
    let rows = timelines()
        .map(|timeline| timeline.time_seconds.len())
        .min();
    let rows = rows.unwrap_or(0);
    let row_at = |seconds: f64| {
        let times = timelines()
            .next()
            .map(|timeline| &timeline.time_seconds[..rows]);
        times.map_or(0, |times| times.partition_point(|time| *time < seconds))
    };
    let end = contour.until_seconds.map_or(rows, row_at);
    row_at(contour.from_seconds).min(end)..end
}
