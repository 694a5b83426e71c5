//! The loops of a contour, for the page and for the viewer.

use std::ops::Range;

use scenario::contour::Contour;

use crate::run::{Run, RunLoop};

/// Returns the loops of a contour, as far as the run has them.
pub(crate) fn axes<'a>(contour: &Contour, run: &Run<'a>) -> Vec<RunLoop<'a>> {
    let axis = |name: &String| run.loops().find(|one| one.control_loop.name() == name);
    contour.loops.iter().filter_map(axis).collect()
}

/// Returns the rows of a contour's window, which all its loops have.
pub(crate) fn window(contour: &Contour, axes: &[RunLoop<'_>]) -> Range<usize> {
    let lengths = axes.iter().map(|axis| axis.timeline.time_seconds.len());
    let rows = lengths.min().unwrap_or(0);
    let times = axes
        .first()
        .map(|axis| axis.timeline.time_seconds.part(0..rows));
    let row_at = |seconds: f64| {
        let times = times.as_ref();
        times.map_or(0, |times| times.partition_point(|time| time < seconds))
    };
    let end = contour.until_seconds.map_or(rows, row_at);
    row_at(contour.from_seconds).min(end)..end
}
