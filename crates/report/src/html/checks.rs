//! The signals in the scenario's checks, each in a plot with its demands.

use maud::{Markup, html};
use scenario::expect::{Demand, SignalCheck};

use super::signals::{CHANGES, common_distance};
use crate::plot::{Colour, Patch, Plot, Shape};
use crate::run::RunLoop;
use plan::ControlLoop;
use platform::series::Series;
use recording::traces::SignalTrace;

/// Largest number of signals with a plot; the verdict lists the others, too.
const PLOTS_MAX: usize = 12;

/// Trace in the form for a plot.
struct Drawn<'a> {
    trace: &'a SignalTrace,
    time_seconds: Series<f64>,
    values: Series<f64>,
    /// Number of cycles from sample to sample, if that is not 1.
    each_cycles: Option<usize>,
    /// Rows of the courses that the signal must follow.
    courses: Vec<(Vec<f64>, Vec<f64>)>,
    patches: Vec<Patch>,
}

/// Returns a section with the plots; empty if no check names a signal.
pub(super) fn section(run: &RunLoop<'_>) -> Markup {
    let control_loop = run.control_loop;
    let checks = &control_loop.trial.expect.signal;
    let drawn: Vec<Drawn<'_>> = (run.timeline)
        .traces
        .iter()
        .filter(|trace| {
            checks
                .iter()
                .any(|check| is_about(control_loop, check, trace))
        })
        .take(PLOTS_MAX)
        .map(|trace| drawn(trace, control_loop, run.timeline.period_seconds))
        .collect();
    html! {
        @if !drawn.is_empty() {
            (super::heading(run, "Checked signals"))
            div.plots.even { @for one in &drawn { (plot(one, &shown(control_loop, one.trace)).render()) } }
            p.soft { "Green: where the signal must stay or get, and when." }
        }
    }
}

fn is_about(control_loop: &ControlLoop, check: &SignalCheck, trace: &SignalTrace) -> bool {
    control_loop.names().find(&check.name) == Ok(&trace.path)
}

fn drawn<'a>(trace: &'a SignalTrace, control_loop: &ControlLoop, period_seconds: f64) -> Drawn<'a> {
    let scenario = &control_loop.trial;
    let mut drawn = Drawn {
        trace,
        time_seconds: trace.samples.iter().map(|one| one.time_seconds).collect(),
        values: trace.samples.iter().map(|one| one.value).collect(),
        each_cycles: common_distance(&first_cycles(trace, period_seconds)),
        courses: Vec::new(),
        patches: Vec::new(),
    };
    let checks = scenario.expect.signal.iter();
    for check in checks.filter(|check| is_about(control_loop, check, trace)) {
        for demand in check.demands() {
            let window = check.window(&demand, scenario.run.duration_seconds);
            match demand {
                Demand::Stays(limit) | Demand::Reaches(limit) => drawn.patches.push(Patch {
                    class: "band",
                    x: (window.from_seconds, window.until_seconds),
                    y: (
                        limit.min.unwrap_or(f64::NEG_INFINITY),
                        limit.max.unwrap_or(f64::INFINITY),
                    ),
                }),
                Demand::Follows(course) => drawn.courses.push(course.rows.iter().copied().unzip()),
                Demand::RatePerSecond(_) => {}
            }
        }
    }
    drawn
}

/// Returns the cycles of the first samples.
fn first_cycles(trace: &SignalTrace, period_seconds: f64) -> Vec<usize> {
    let samples = trace.samples.iter().take(CHANGES);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a time since the begin of the scenario"
    )]
    let cycles = samples.map(|one| (one.time_seconds / period_seconds).round() as usize);
    cycles.collect()
}

/// Returns the name of a signal on the bus; with several loops it begins with the drive that sends the frame.
fn shown(control_loop: &ControlLoop, trace: &SignalTrace) -> String {
    let drive = &control_loop.nodes.drive.name;
    let rest = trace.path.strip_prefix("drive_");
    match (control_loop.loop_name(), rest) {
        (Some(_), Some(rest)) => format!("{drive}_{rest}"),
        _ => trace.path.clone(),
    }
}

fn plot<'a>(drawn: &'a Drawn<'_>, name: &'a str) -> Plot<'a> {
    let mut plot = Plot::over_time(name, &drawn.trace.unit);
    plot.patches.clone_from(&drawn.patches);
    let (label, shape) = match drawn.each_cycles {
        None => ("recorded".to_owned(), Shape::Line),
        Some(cycles) => (format!("recorded (each {cycles} cycles)"), Shape::Points),
    };
    plot.draw(
        label,
        Colour::Measured,
        shape,
        &drawn.time_seconds,
        &drawn.values,
    );
    for (time_seconds, values) in &drawn.courses {
        plot.draw(
            "course",
            Colour::Wanted,
            Shape::Dashed,
            time_seconds,
            values,
        );
    }
    plot
}
