//! The signals in the scenario's checks, each in a plot with its demands.

use maud::{Markup, html};
use scenario::expect::{Demand, SignalCheck};

use super::signals::{CHANGES, common_distance, few};
use crate::plot::{Colour, Patch, Plot, Shape};
use crate::run::RunLoop;
use plan::ControlLoop;
use platform::series::Series;
use recording::traces::SignalTrace;

/// Largest number of signals with a plot; the verdict lists the others, too.
const PLOTS_MAX: usize = 12;

/// Returns a section with the plots; empty if no check names a signal.
pub(super) fn section(run: &RunLoop<'_>) -> Markup {
    let (control_loop, timeline) = (run.control_loop, run.timeline);
    let checks = control_loop.trial.expect.signal.iter();
    let is_checked = |trace: &&SignalTrace| {
        checks
            .clone()
            .any(|check| is_about(control_loop, check, trace))
    };
    let traces = timeline.traces.iter().filter(is_checked).take(PLOTS_MAX);
    let plots = traces.map(|trace| plot(trace, control_loop, timeline.period_seconds));
    let plots = Vec::from_iter(plots);
    html! {
        @if !plots.is_empty() {
            (super::heading(run, "Checked signals"))
            div.plots.even { @for plot in &plots { (plot.render()) } }
            p.soft { "Green: where the signal must stay or get, and when." }
        }
    }
}

fn is_about(control_loop: &ControlLoop, check: &SignalCheck, trace: &SignalTrace) -> bool {
    control_loop.names().find(&check.name) == Ok(&trace.path)
}

/// Plots a trace with the demands of its checks.
fn plot<'a>(trace: &'a SignalTrace, control_loop: &ControlLoop, period_seconds: f64) -> Plot<'a> {
    let trial = &control_loop.trial;
    let mut plot = Plot::over_time(trace.path.as_str(), &trace.unit);
    let distance = common_distance(&first_cycles(trace, period_seconds));
    let shape = distance.map_or(Shape::Line, |_| Shape::Points);
    let label = format!("recorded{}", distance.map_or_else(String::new, few));
    let times: Series<f64> = trace.samples.iter().map(|one| one.time_seconds).collect();
    let values: Series<f64> = trace.samples.iter().map(|one| one.value).collect();
    plot.draw(label, Colour::Measured, shape, times, values);
    let checks = trial.expect.signal.iter();
    for check in checks.filter(|check| is_about(control_loop, check, trace)) {
        for demand in check.demands() {
            let window = check.window(&demand, trial.run.duration_seconds);
            match demand {
                Demand::Stays(limit) | Demand::Reaches(limit) => {
                    let x = (window.from_seconds, window.until_seconds);
                    plot.patches.push(Patch::band(x, limit.ends()));
                }
                Demand::Follows(course) => {
                    let (x, y): (Vec<f64>, Vec<f64>) = course.rows.iter().copied().unzip();
                    plot.draw("course", Colour::Wanted, Shape::Dashed, x, y);
                }
                Demand::RatePerSecond(_) => {}
            }
        }
    }
    plot
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use plan::Plan;
    use plan::catalogue::Catalogue;

    use super::*;

    /// Names of nodes have no meaning, not even those that begin with "drive_".
    #[test]
    fn a_checked_signal_is_called_as_on_the_bus() {
        let rig = include_str!("../../../../scenarios/rigs/two_axes.toml")
            .replace("node.x]", "node.drive_x]")
            .replace("\"x.", "\"drive_x.");
        let plan = Plan::from_rig(Path::new("rig.toml"), &rig, &Catalogue::shipped()).unwrap();
        let trace = SignalTrace {
            path: "drive_x_tpdo1.position_millimetres".to_owned(),
            unit: "mm".to_owned(),
            silence_seconds_max: None,
            is_of_plant: false,
            samples: Series::default(),
        };
        for one in &plan.loops {
            assert_eq!(plot(&trace, one, 0.001).title, trace.path);
        }
    }
}
