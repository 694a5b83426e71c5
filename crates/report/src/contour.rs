//! The loops of a contour, for the page and for the viewer.

use std::ops::Range;

use scenario::contour::Contour;

use crate::run::{Run, RunLoop};

/// Returns the loops of a contour, as far as the run has them.
pub(crate) fn axes<'a>(contour: &Contour, run: &Run<'a>) -> Vec<RunLoop<'a>> {
    let axis = |name: &String| run.loops().find(|one| one.control_loop.name() == name);
    contour.loops.iter().filter_map(axis).collect()
}

/// Returns the rows of a contour's window, which both loops have.
pub(crate) fn window(contour: &Contour, axes: [RunLoop<'_>; 2]) -> Range<usize> {
    let [times, others] = axes.map(|axis| &axis.timeline.time_seconds);
    let rows = times.len().min(others.len());
    let row_at = |seconds: f64| times.partition_point(|time| time < seconds).min(rows);
    let end = contour.until_seconds.map_or(rows, row_at);
    row_at(contour.from_seconds).min(end)..end
}
