//! The loops of a contour, for the page and for the viewer.

use std::ops::Range;

use scenario::contour::Contour;

use crate::run::{Run, RunLoop};

/// Loop by its name.
pub(crate) type Axis<'a> = (&'a str, RunLoop<'a>);

/// Returns the loops of a contour, as far as the run has them.
pub(crate) fn axes<'a>(contour: &'a Contour, run: &Run<'a>) -> Vec<Axis<'a>> {
    let axis = |name: &'a String| {
        let is_named = |one: &RunLoop<'_>| one.control_loop.name() == name;
        Some((name.as_str(), run.loops().find(is_named)?))
    };
    contour.loops.iter().filter_map(axis).collect()
}

/// Returns the rows of a contour's window, which all its loops have.
pub(crate) fn window(contour: &Contour, axes: &[Axis<'_>]) -> Range<usize> {
    let timelines = || axes.iter().map(|(_, run)| run.timeline);
    let rows = timelines()
        .map(|timeline| timeline.time_seconds.len())
        .min()
        .unwrap_or(0);
    let row_at = |seconds: f64| {
        let times = timelines()
            .next()
            .map(|timeline| timeline.time_seconds.part(0..rows));
        times.map_or(0, |times| times.partition_point(|time| time < seconds))
    };
    let end = contour.until_seconds.map_or(rows, row_at);
    row_at(contour.from_seconds).min(end)..end
}
