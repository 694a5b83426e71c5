//! The section with the plots over time: the position first, then all others.

use dbc::Signal;
use dbc::names::{self, WIRE_TEMPERATURE};
use maud::{Markup, html};
use plan::ControlLoop;
use scenario::Trial;
use scenario::events::{JudgedStep, Window};

use crate::plot::Colour::{self, Estimated, Measured, True, Wanted};
use crate::plot::{Extent, Patch, Plot, Shape};
use crate::run::RunLoop;
use crate::unit::{shown_unit, title};
use judge::SETTLING_BAND;
use platform::series::Series;
use recording::timeline::{Column, Timeline};

/// Largest number of steps and disturbances with separate plots, and of such sines.
const CLOSE_UPS_MAX: usize = 4;
/// Largest share of the run for a close-up of a judged sine; a longer one can be seen in the plot of the whole run.
const SINE_SHARE_MAX: f64 = 0.1;
/// Times in a close-up before the event, and at most after it.
const BEFORE_SECONDS: f64 = 0.1;
const AFTER_STEP_SECONDS: f64 = 1.0;
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;

/// Signal in a plot: its name, its label and its colour.
type Drawn<'a> = (&'a str, &'a str, Colour);

/// Temperatures of the SMA actuator: the controller's estimate and the true one.
const TEMPERATURES: [Drawn<'static>; 2] = [
    ("estimated_temperature_celsius", "estimated", Estimated),
    (WIRE_TEMPERATURE, "true", True),
];
/// Martensite fractions of the SMA actuator: the controller's estimate and the true one.
const FRACTIONS: [Drawn<'static>; 2] = [
    ("estimated_martensite_fraction", "estimated", Estimated),
    ("martensite_fraction", "true", True),
];
/// Terms of the sliding-mode laws; the other shipped laws have none of them.
const SLIDING_VARIABLE: Drawn<'static> = (
    "sliding_variable_metres_per_second_squared",
    "sliding variable",
    Estimated,
);
/// Parts of the squared current that these laws command.
const PARTS_OF_LAW: [Drawn<'static>; 2] = [
    ("switching_part_amperes_squared", "switching", Measured),
    ("equivalent_part_amperes_squared", "equivalent", Estimated),
];

pub(super) fn section(run: &RunLoop<'_>) -> Markup {
    let (timeline, control_loop) = (run.timeline, run.control_loop);
    let pairs = timeline.set_point().iter().zip(timeline.position());
    let error: Series<f64> = pairs.map(|(wanted, measured)| wanted - measured).collect();
    let mut in_time = vec![position(run)];
    let (close_ups, left_out) = close_ups(run);
    in_time.extend(close_ups);
    let mut error_plot = Plot::over_time("Error", timeline.quantities.feedback.unit.symbol());
    let label = "set-point − measured";
    draw(&mut error_plot, timeline, label, Measured, (0, &error));
    in_time.push(error_plot);
    let command = &timeline.quantities.output;
    let currents = [
        (names::TARGET, "commanded", Wanted),
        (names::OUTPUT, "measured", Measured),
    ];
    let plot =
        |title: &str, unit, signals: &[Drawn<'_>]| signal_plot(timeline, title, unit, signals);
    in_time.push(plot(&command.title(), command.unit.symbol(), &currents));
    let mut signals = Vec::from_iter(control_loop.plant_signals(run.plan.database()));
    let has_wire = signals.iter().any(|signal| signal.name == WIRE_TEMPERATURE);
    if has_wire {
        in_time.push(plot("Wire temperature", "°C", &TEMPERATURES));
        in_time.push(plot("Martensite fraction ξ", "", &FRACTIONS));
        signals.retain(|signal| ![TEMPERATURES[1].0, FRACTIONS[1].0].contains(&&*signal.name));
    }
    let signals = signals.into_iter();
    in_time.extend(signals.map(|signal| own_plot(timeline, signal, "true", True)));
    let terms = if control_loop.trial.controller.is_from_outside() {
        let terms = control_loop.terms(run.plan.database());
        Vec::from_iter(terms.map(|term| own_plot(timeline, term, "law", Estimated)))
    } else {
        let variable = plot("Sliding variable", "m/s²", &[SLIDING_VARIABLE]);
        vec![variable, plot("Parts of the law", "A²", &PARTS_OF_LAW)]
    };
    // The first values, far from the set-point, can be a thousand times the later ones.
    let extent = Extent::Typical;
    in_time.extend(terms.into_iter().map(|plot| Plot { extent, ..plot }));
    for plot in &mut in_time {
        plot.patches.extend(patches(control_loop));
    }
    let text = patches_text(&in_time[0]);
    html! {
        (super::heading(run, &timeline.quantities.feedback.title()))
        div.plots { (in_time[0].render()) }
        (super::heading(run, "Signals"))
        div.plots.even {
            @for plot in &in_time[1..] { (plot.render()) }
            @if has_wire { (hysteresis(timeline).render()) }
        }
        @if !text.is_empty() { p.soft { (text) } }
        @if left_out > 0 { p.soft { (left_out) " more judged steps, disturbances or sines are not drawn by themselves; the Rerun viewer shows each in " code { "run.rrd" } "." } }
    }
}

/// Describes the coloured patches behind the curves of a plot; empty if there are none.
fn patches_text(plot: &Plot<'_>) -> String {
    let sentences = [
        ("band", "Green: settling band of a step."),
        ("span", "Yellow: a disturbance acts."),
        (
            "fault",
            "Violet: a fault acts, here or elsewhere on the bus.",
        ),
    ];
    let is_drawn = |class: &str| plot.patches.iter().any(|patch| patch.class == class);
    let said = sentences.iter().filter(|(class, _)| is_drawn(class));
    Vec::from_iter(said.map(|(_, sentence)| *sentence)).join(" ")
}

/// Plots a signal of a plant or a custom law by itself.
fn own_plot<'a>(
    timeline: &'a Timeline,
    signal: &'a Signal,
    label: &str,
    colour: Colour,
) -> Plot<'a> {
    let drawn = (signal.name.as_str(), label, colour);
    signal_plot(timeline, title(signal), &signal.unit, &[drawn])
}

fn position<'a>(run: &RunLoop<'a>) -> Plot<'a> {
    let timeline = run.timeline;
    let quantities = &timeline.quantities;
    let mut plot = Plot::over_time(
        quantities.feedback.title(),
        quantities.feedback.unit.symbol(),
    );
    let steps = run.control_loop.trial.judged_steps();
    plot.patches = steps.iter().map(settling_band).collect();
    if let Some(column) = timeline.column(names::TRUE_POSITION) {
        draw(&mut plot, timeline, "true", True, (0, &column.values));
    }
    let measured = (0, timeline.position());
    draw(&mut plot, timeline, "measured", Measured, measured);
    if let Some(column) = timeline.column("reference_{signal}_{unit}") {
        let label = "filtered reference";
        draw(&mut plot, timeline, label, Estimated, first_sent(column));
    }
    let (times, set_point) = (&timeline.time_seconds, timeline.set_point());
    plot.draw("set-point", Wanted, Shape::Dashed, times, set_point);
    plot
}

/// Judged stretch of time: title, begin and end.
type Stretch = (String, f64, f64);

/// Plots the position at each step and each disturbance, and in the judged periods of sines in a long run. Also returns the
/// number of stretches that are left out.
fn close_ups<'a>(run: &RunLoop<'a>) -> (Vec<Plot<'a>>, usize) {
    let end = run.timeline.end_seconds();
    let (mut shown, mut left_out) = (Vec::new(), 0);
    for stretches in [sudden, sines].map(|find| find(&run.control_loop.trial)) {
        let reached = stretches.into_iter().filter(|(_, from, _)| *from < end);
        let reached = Vec::from_iter(reached);
        left_out += reached.len().saturating_sub(CLOSE_UPS_MAX);
        shown.extend(reached.into_iter().take(CLOSE_UPS_MAX));
    }
    let plots = shown.into_iter().map(|(title, from, until)| {
        let mut plot = position(run);
        plot.title = title;
        plot.x_range = Some((from, until.min(end)));
        plot
    });
    (plots.collect(), left_out)
}

/// Returns the stretches of steps and disturbances.
fn sudden(trial: &Trial) -> Vec<Stretch> {
    let symbol = shown_unit(trial.wiring.feedback.quantity.unit.symbol());
    let steps = trial.judged_steps().into_iter().map(|step| {
        let from = step.window.from_seconds;
        let until = step.window.until_seconds.min(from + AFTER_STEP_SECONDS);
        let title = format!("Step to {} {symbol} at {from} s", step.to);
        (title, from, until)
    });
    let disturbances = trial.judged_disturbances().into_iter().map(|disturbance| {
        let title = format!("Disturbance: {}", disturbance.text);
        let until = disturbance.window.until_seconds + AFTER_DISTURBANCE_SECONDS;
        (title, disturbance.window.from_seconds, until)
    });
    let before = |(title, from, until): Stretch| (title, (from - BEFORE_SECONDS).max(0.0), until);
    steps.chain(disturbances).map(before).collect()
}

/// Returns the sines whose judged periods are too short a part of the run to be seen in it.
fn sines(trial: &Trial) -> Vec<Stretch> {
    let share =
        |window: Window| (window.until_seconds - window.from_seconds) / trial.run.duration_seconds;
    let sines = trial.judged_sines().into_iter();
    let short = sines.filter(|sine| share(sine.window) < SINE_SHARE_MAX);
    let stretches = short.map(|sine| {
        let title = format!("Judged periods of the sine of {} s", sine.period_seconds);
        (title, sine.window.from_seconds, sine.window.until_seconds)
    });
    stretches.collect()
}

fn settling_band(step: &JudgedStep) -> Patch {
    let half = SETTLING_BAND * (step.to - step.from).abs();
    let x = (step.window.from_seconds, step.window.until_seconds);
    Patch::band(x, (step.to - half, step.to + half))
}

/// Returns patches for disturbances and faults, wide enough to be seen.
fn patches(control_loop: &ControlLoop) -> Vec<Patch> {
    let duration_seconds = control_loop.trial.run.duration_seconds;
    // A load stays until the next one; the patch marks the change.
    let disturbances = control_loop.trial.judged_disturbances().into_iter();
    let spans = disturbances.map(|disturbance| {
        let window = disturbance.window;
        ("span", window.from_seconds, window.until_seconds)
    });
    // Faults of the boot are over when the scenario begins.
    let faults = control_loop.faults().filter_map(|fault| {
        let until_seconds = fault.until_seconds.unwrap_or(duration_seconds);
        Some(("fault", fault.from_seconds?, until_seconds))
    });
    let patch = |(class, from_seconds, until_seconds)| {
        let seen_until = f64::max(until_seconds, from_seconds + 0.003 * duration_seconds);
        Patch::stretch(class, (from_seconds, seen_until))
    };
    spans.chain(faults).map(patch).collect()
}

fn signal_plot<'a>(
    timeline: &'a Timeline,
    title: &str,
    unit: &'a str,
    signals: &[Drawn<'_>],
) -> Plot<'a> {
    let mut plot = Plot::over_time(title, unit);
    for (name, label, colour) in signals {
        if let Some(column) = timeline.column(name) {
            draw(&mut plot, timeline, label, *colour, first_sent(column));
        }
    }
    plot
}

/// Draws a signal: as points if it has a sample in few cycles only, which its label says.
fn draw<'a>(
    plot: &mut Plot<'a>,
    timeline: &'a Timeline,
    label: &str,
    colour: Colour,
    (first, values): (usize, impl Into<Series<f64>>),
) {
    let values = values.into();
    let (remark, shape) = sampling(&values);
    let label = format!("{label}{remark}");
    let times = &timeline.time_seconds;
    plot.draw(label, colour, shape, times.part(first..times.len()), values);
}

/// Number of changes of a signal that determine its sampling.
pub(super) const CHANGES: usize = 64;

/// Determines the sampling of a signal from its first changes: a remark on it, and the shape that shows it. A signal with few
/// changes counts as sampled in each cycle.
fn sampling(values: &Series<f64>) -> (String, Shape) {
    let first = values.part(0..values.len().min(1 << 20));
    let (mut held, mut lone) = (Vec::new(), Vec::new());
    for (row, (before, value)) in (1..).zip(first.pairs()) {
        let rows = if before.is_finite() {
            &mut held
        } else {
            &mut lone
        };
        if value != before && value.is_finite() && rows.len() < CHANGES {
            rows.push(row);
        }
        if held.len() == CHANGES {
            break;
        }
    }
    match (held.len(), common_distance(&lone), common_distance(&held)) {
        (..CHANGES, Some(cycles), _) => (few(cycles), Shape::Points),
        (_, None, Some(cycles)) => (format!(" (held for {cycles} cycles)"), Shape::Line),
        _ => (String::new(), Shape::Line),
    }
}

/// Returns the remark on a signal with a value in every n-th cycle, and none between them.
pub(super) fn few(cycles: usize) -> String {
    format!(" (each {cycles} cycles)")
}

/// Returns the number of cycles from a row to the next, if all distances are multiples of it; `None` if that is 1, or if there are
/// too few rows.
pub(super) fn common_distance(rows: &[usize]) -> Option<usize> {
    let mut apart = rows.array_windows().map(|[from, to]| to.abs_diff(*from));
    let cycles = apart.clone().min().filter(|cycles| *cycles > 1)?;
    (rows.len() >= CHANGES && apart.all(|one| one % cycles == 0)).then_some(cycles)
}

/// Returns the first row with a value of a column, and the values from there on. A node that has not computed anything yet sends
/// 0, which holds for some cycles of the scenario.
fn first_sent(column: &Column) -> (usize, Series<f64>) {
    const NOTHING_YET_CYCLES: usize = 20;
    let values = &column.values;
    let zeros = values.iter().take_while(|value| *value == 0.0).count();
    let first = if column.is_term && zeros < NOTHING_YET_CYCLES {
        zeros
    } else {
        0
    };
    (first, values.part(first..values.len()))
}

/// Plots ξ over the temperature: the hysteresis that makes the wire hard to control.
fn hysteresis(timeline: &Timeline) -> Plot<'_> {
    let mut plot = Plot::over_time("Hysteresis", "ξ");
    plot.x_label = "wire temperature (°C)";
    for ((temperature, label, colour), (fraction, ..)) in TEMPERATURES.into_iter().zip(FRACTIONS) {
        let columns = timeline.column(temperature).zip(timeline.column(fraction));
        if let Some((temperature, fraction)) = columns {
            let (x, y) = (&temperature.values, &fraction.values);
            plot.draw(label, colour, Shape::Path, x, y);
        }
    }
    plot
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_begins_when_its_law_has_computed_it() {
        let first = |name: &str, zeros: usize| {
            let values = (0..100).map(|row| if row < zeros { 0.0 } else { 25.0 });
            let (first, values) = first_sent(&Column {
                name: name.to_owned(),
                unit: String::new(),
                is_term: name != "position_millimetres",
                values: values.collect(),
            });
            assert_eq!(values.len(), 100 - first);
            first
        };
        assert_eq!(first("estimated_temperature_celsius", 6), 6);
        assert_eq!(first("estimated_temperature_celsius", 50), 0);
        assert_eq!(first("position_millimetres", 6), 0);
    }

    #[test]
    fn a_signal_is_sampled_in_each_cycle_in_few_or_held() {
        let rows = |value: fn(u32) -> f64| Series::from_iter((0..2000).map(value));
        let each = rows(|row| f64::from(row % 7));
        let few = rows(|row| {
            if row % 10 == 3 {
                f64::from(row)
            } else {
                f64::NAN
            }
        });
        let held = rows(|row| f64::from(row.saturating_sub(5) / 10));
        let step = rows(|row| if row < 1000 { 10.0 } else { 35.0 });
        let each_cycle = (String::new(), Shape::Line);
        assert_eq!(sampling(&each), each_cycle);
        let remark = " (each 10 cycles)".to_owned();
        assert_eq!(sampling(&few), (remark, Shape::Points));
        let remark = " (held for 10 cycles)".to_owned();
        assert_eq!(sampling(&held), (remark, Shape::Line));
        assert_eq!(sampling(&step), each_cycle);
        // Lost samples are gaps and do not change the rate.
        let lossy = rows(|row| {
            if row % 97 == 5 {
                f64::NAN
            } else {
                f64::from(row % 7)
            }
        });
        assert_eq!(sampling(&lossy), each_cycle);
    }
}
