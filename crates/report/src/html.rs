//! `report.html`: one run on one page.

use dbc::signals::WIRE_TEMPERATURE;
use dbc::{Database, SignalMissing, signals};
use maud::{Markup, html};
use scenario::Scenario;
use scenario::events::JudgedStep;

use super::bus_timing::{BusTiming, Spread, histogram};
use super::plot::{Colour, Extent, Patch, Plot, Shape};
use super::{Run, checks, page, shown_unit};
use judge::SETTLING_BAND;
use judge::timing::Timing;
use recording::events::{Level, TimelineEvent};
use recording::run_folder::file;
use recording::timeline::Timeline;
use rig::external::ExternalNode;

/// Events that are listed; a run with more of them has its own trouble, told by the first ones.
const EVENTS_MAX: usize = 300;
/// Steps and disturbances that get a plot of their own.
const CLOSE_UPS_MAX: usize = 4;
/// What is seen of a step: before it, and at most after it.
const BEFORE_SECONDS: f64 = 0.1;
const AFTER_STEP_SECONDS: f64 = 1.0;
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;

/// The page. It depends on nothing but the recording and the verdict.
///
/// # Errors
/// The database lacks a signal that the bench needs.
pub fn to_html(run: &Run<'_>) -> Result<String, SignalMissing> {
    let (scenario, database) = (&run.setup.scenario, &*run.setup.database);
    let timing = BusTiming::of(
        run.frames,
        scenario.duration_seconds,
        scenario.bus.bitrate_kilobits_per_second,
        database,
    )?;
    let body = html! {
        (head(run))
        h2 { "Verdict" }
        @if run.verdict.metrics.is_empty() { p.soft { "Nothing was judged." } }
        @else { (page::metrics(&run.verdict.metrics, run.verdict.outcome)) }
        @if run.timeline.cycle.is_empty() { p { "The scenario never began, so there is nothing to plot." } }
        @else { (plots(run)) }
        (checks::section(run))
        (bus(&timing, run))
        (events(&run.timeline.events))
        h2 { "Scenario" }
        details open { summary { (file::SCENARIO) } pre { (run.setup.text) } }
        (again())
    };
    Ok(page::page(
        &format!("{}: {}", scenario.name, run.verdict.outcome.word()),
        &body,
    ))
}

fn head(run: &Run<'_>) -> Markup {
    let scenario = &run.setup.scenario;
    let Run {
        verdict, timeline, ..
    } = run;
    let law = scenario.controller.law_name();
    html! {
        h1 { (scenario.name) }
        p { (page::badge(verdict.outcome)) }
        @if let Some(reason) = &verdict.reason { p { (reason) } }
        @if let Some(description) = &scenario.description { p.soft { (description) } }
        dl.facts {
            div { dt { "control law" } dd { (law) } }
            div { dt { "recorded" } dd { (format!("{:.3} s of {} s", timeline.end_seconds(), scenario.duration_seconds)) } }
            div { dt { "cycle" } dd { (scenario.bus.sync_period_milliseconds) " ms" } }
            div { dt { "bus" } dd { (scenario.bus.bitrate_kilobits_per_second) " kbit/s" } }
            div { dt { "frames" } dd { (run.frames.len()) } }
            div { dt { "seed" } dd { (verdict.seed) } }
            div { dt { "canrig" } dd { (verdict.version) } }
            @if !verdict.requirements.is_empty() { div { dt { "requirements" } dd { (verdict.requirements.join(", ")) } } }
            @if !verdict.external.is_empty() { div { dt { "external" } dd { (verdict.external) } } }
        }
        @if verdict.external.has(ExternalNode::Drive) {
            p.soft { "Wire temperature, martensite fraction and true position are not available: the drive is external, and only the emulator knows them." }
        }
    }
}

fn plots(run: &Run<'_>) -> Markup {
    let (timeline, database) = (run.timeline, &*run.setup.database);
    let error: Vec<f64> = timeline
        .set_point_millimetres
        .iter()
        .zip(timeline.position())
        .map(|(wanted, measured)| wanted - measured)
        .collect();
    let mut in_time = vec![position(run)];
    in_time.extend(close_ups(run));
    let mut error_plot = Plot::over_time("Error", "mm");
    error_plot.draw(
        "set-point − measured",
        Colour::Measured,
        Shape::Line,
        &timeline.time_seconds,
        &error,
    );
    in_time.push(error_plot);
    in_time.push(of_signals(
        timeline,
        "Current",
        "A",
        &[
            ("target_current_amperes", "commanded", Colour::Wanted),
            ("current_amperes", "measured", Colour::Measured),
        ],
    ));
    let has_wire = signals::of_the_plant(database).any(|signal| signal.name == WIRE_TEMPERATURE);
    if has_wire {
        in_time.extend(of_the_wire(timeline));
    } else {
        in_time.extend(of_another_plant(timeline, database));
    }
    if run.setup.scenario.controller.own.is_some() {
        in_time.extend(of_own_terms(timeline, database));
    } else {
        in_time.extend(of_the_sliding_mode(timeline));
    }
    for plot in &mut in_time {
        plot.patches.extend(disturbances(&run.setup.scenario));
    }
    html! {
        h2 { "Position" }
        div.plots { (in_time[0].render()) }
        h2 { "Signals" }
        div.plots.even {
            @for plot in &in_time[1..] { (plot.render()) }
            @if has_wire { (hysteresis(timeline).render()) }
        }
        p.soft { "Green: settling band of a step. Yellow: a disturbance acts." }
    }
}

/// The terms of the sliding-mode laws; the other shipped laws leave them 0.
fn of_the_sliding_mode(timeline: &Timeline) -> [Plot<'_>; 2] {
    let mut sliding = of_signals(
        timeline,
        "Sliding variable",
        "m/s²",
        &[(
            "sliding_variable_metres_per_second_squared",
            "sliding variable",
            Colour::Estimated,
        )],
    );
    let mut parts = of_signals(
        timeline,
        "Parts of the law",
        "A²",
        &[
            (
                "switching_part_amperes_squared",
                "switching",
                Colour::Measured,
            ),
            (
                "equivalent_part_amperes_squared",
                "equivalent",
                Colour::Estimated,
            ),
        ],
    );
    // Their first values, far from the set-point, can be a thousand times the later ones.
    (sliding.extent, parts.extent) = (Extent::Typical, Extent::Typical);
    [sliding, parts]
}

/// The terms of a law from outside, each by itself.
fn of_own_terms<'a>(
    timeline: &'a Timeline,
    database: &'a Database,
) -> impl Iterator<Item = Plot<'a>> {
    signals::of_the_own_law(database).map(|term| {
        let title = term.comment.trim_end_matches('.');
        let drawn = [(term.name.as_str(), "law", Colour::Estimated)];
        let mut plot = of_signals(timeline, title, shown_unit(&term.unit), &drawn);
        plot.extent = Extent::Typical;
        plot
    })
}

/// The SMA actuator's own signals, with what a controller believes of them.
fn of_the_wire(timeline: &Timeline) -> [Plot<'_>; 2] {
    let temperature = of_signals(
        timeline,
        "Wire temperature",
        "°C",
        &[
            (
                "estimated_temperature_celsius",
                "estimated",
                Colour::Estimated,
            ),
            (WIRE_TEMPERATURE, "true", Colour::True),
        ],
    );
    let fraction = of_signals(
        timeline,
        "Martensite fraction ξ",
        "",
        &[
            (
                "estimated_martensite_fraction",
                "estimated",
                Colour::Estimated,
            ),
            ("martensite_fraction", "true", Colour::True),
        ],
    );
    [temperature, fraction]
}

/// The own signals of any other plant, each by itself.
fn of_another_plant<'a>(
    timeline: &'a Timeline,
    database: &'a Database,
) -> impl Iterator<Item = Plot<'a>> {
    signals::of_the_plant(database).map(|signal| {
        let name = signal.name.as_str();
        let unit = shown_unit(&signal.unit);
        of_signals(
            timeline,
            signal.comment.trim_end_matches('.'),
            unit,
            &[(name, "true", Colour::True)],
        )
    })
}

fn position<'a>(run: &Run<'a>) -> Plot<'a> {
    let timeline = run.timeline;
    let time = &timeline.time_seconds;
    let mut plot = Plot::over_time("Position", "mm");
    plot.patches = run
        .setup
        .scenario
        .judged_steps()
        .iter()
        .map(settling_band)
        .collect();
    if let Some(column) = timeline.column("true_position_millimetres") {
        plot.draw("true", Colour::True, Shape::Line, time, &column.values);
    }
    plot.draw(
        "measured",
        Colour::Measured,
        Shape::Line,
        time,
        timeline.position(),
    );
    if let Some(column) = timeline.column("reference_position_millimetres") {
        plot.draw(
            "filtered reference",
            Colour::Estimated,
            Shape::Line,
            time,
            &column.values,
        );
    }
    plot.draw(
        "set-point",
        Colour::Wanted,
        Shape::Dashed,
        time,
        &timeline.set_point_millimetres,
    );
    plot
}

/// The position round each step and each disturbance.
fn close_ups<'a>(run: &Run<'a>) -> Vec<Plot<'a>> {
    let steps = run.setup.scenario.judged_steps().into_iter().map(|step| {
        let until = step
            .window
            .until_seconds
            .min(step.window.from_seconds + AFTER_STEP_SECONDS);
        let title = format!("Step to {} mm", step.to_millimetres);
        (title, step.window.from_seconds, until)
    });
    let disturbances = run
        .setup
        .scenario
        .disturbance_windows()
        .into_iter()
        .map(|disturbance| {
            let until = disturbance.window.until_seconds + AFTER_DISTURBANCE_SECONDS;
            (
                format!("Disturbance: {}", disturbance.text),
                disturbance.window.from_seconds,
                until,
            )
        });
    let end = run.timeline.end_seconds();
    let reached = steps.chain(disturbances).filter(|(_, from, _)| *from < end);
    let close_ups = reached.take(CLOSE_UPS_MAX).map(|(title, from, until)| {
        let mut plot = position(run);
        plot.title = title;
        plot.x_range = Some(((from - BEFORE_SECONDS).max(0.0), until.min(end)));
        plot
    });
    close_ups.collect()
}

fn settling_band(step: &JudgedStep) -> Patch {
    let half = SETTLING_BAND * (step.to_millimetres - step.from_millimetres).abs();
    Patch {
        class: "band",
        x: (step.window.from_seconds, step.window.until_seconds),
        y: (step.to_millimetres - half, step.to_millimetres + half),
    }
}

fn disturbances(scenario: &Scenario) -> Vec<Patch> {
    let windows = scenario.disturbance_windows();
    let ends = windows.iter().map(|disturbance| {
        let window = disturbance.window;
        // A load stays until the next one; it is marked where it changes.
        let until = window
            .until_seconds
            .max(window.from_seconds + scenario.duration_seconds * 0.003);
        (window.from_seconds, until)
    });
    let patches = ends.map(|x| Patch {
        class: "span",
        x,
        y: (f64::NEG_INFINITY, f64::INFINITY),
    });
    patches.collect()
}

fn of_signals<'a>(
    timeline: &'a Timeline,
    title: &str,
    unit: &'a str,
    signals: &[(&str, &str, Colour)],
) -> Plot<'a> {
    let mut plot = Plot::over_time(title, unit);
    for (name, label, colour) in signals {
        if let Some(column) = timeline.column(name) {
            plot.draw(
                *label,
                *colour,
                Shape::Line,
                &timeline.time_seconds,
                &column.values,
            );
        }
    }
    plot
}

/// ξ over the temperature: the loop that makes the wire hard to control.
fn hysteresis(timeline: &Timeline) -> Plot<'_> {
    let mut plot = Plot::over_time("Hysteresis", "ξ");
    plot.x_label = "wire temperature (°C)";
    let pairs = [
        (
            "estimated_temperature_celsius",
            "estimated_martensite_fraction",
            "estimated",
            Colour::Estimated,
        ),
        (
            WIRE_TEMPERATURE,
            "martensite_fraction",
            "true",
            Colour::True,
        ),
    ];
    for (temperature, fraction, label, colour) in pairs {
        if let (Some(temperature), Some(fraction)) =
            (timeline.column(temperature), timeline.column(fraction))
        {
            plot.draw(
                label,
                colour,
                Shape::Path,
                &temperature.values,
                &fraction.values,
            );
        }
    }
    plot
}

fn bus(timing: &BusTiming, run: &Run<'_>) -> Markup {
    let mut load = Plot::over_time("Bus load", "%");
    load.extent = Extent::FromZero;
    load.draw(
        "load",
        Colour::Measured,
        Shape::Line,
        &timing.load_seconds,
        &timing.load_percent,
    );
    let sets = [
        ("SYNC to SYNC", &timing.cycles),
        ("SYNC to the drive's answer", &timing.answers),
        ("SYNC to the controller's command", &timing.commands),
    ];
    let bars: Vec<_> = sets
        .iter()
        .map(|(_, durations)| histogram(durations))
        .collect();
    let bars_plot = |title: &str, (edges, heights): &'_ (Vec<f64>, Vec<f64>)| {
        let mut plot = Plot::over_time(title, "cycles");
        plot.x_label = "time (µs)";
        plot.extent = Extent::Logarithmic;
        plot.draw("cycles", Colour::Measured, Shape::Area, edges, heights);
        plot.render()
    };
    html! {
        h2 { "Bus and timing" }
        p.soft { "Scenario time 0 to " (run.setup.scenario.duration_seconds) " s, by the stamps of the recorder." }
        div.wide { table {
            thead { tr { th { "in µs" } th.number { "least" } th.number { "median" } th.number { "99 %" } th.number { "most" } } }
            tbody { @for (name, durations) in &sets { @if let Some(spread) = Spread::of(durations) { tr {
                td { (name) }
                @for value in [spread.least, spread.median, spread.percentile_99, spread.most] { td.number { (value) } }
            } } } }
        } }
        @if let Some(timing) = &run.verdict.timing { (host(timing)) }
        div.plots.even {
            (load.render())
            @for ((name, _), bars) in sets.iter().zip(&bars) { (bars_plot(name, bars)) }
        }
    }
}

/// What the nodes' loops counted, which the recording does not tell.
fn host(timing: &Timing) -> Markup {
    html! {
        h3 { "As the nodes saw it" }
        div.wide { table {
            thead { tr { th { "in µs" } th.number { "median" } th.number { "99 %" } th.number { "99.9 %" } th.number { "most" } } }
            tbody { @for (name, quantiles) in timing.rows() { tr {
                td { (name) }
                @for value in [quantiles.median, quantiles.p99, quantiles.p99_9, quantiles.max] { td.number { (format!("{value:.0}")) } }
            } } }
        } }
        @for reason in &timing.distrust { p.unsure { "The timing is not trusted: " (reason) } }
    }
}

fn events(events: &[TimelineEvent]) -> Markup {
    html! {
        h2 { "Events" }
        div.wide { table {
            thead { tr { th.number { "time (s)" } th { "event" } } }
            tbody { @for event in events.iter().take(EVENTS_MAX) { tr {
                td.time { (format!("{:.3}", event.time_seconds)) }
                td.fail[event.level == Level::Error].unsure[event.level == Level::Warning] { (event.text) }
            } } }
        } }
        @if events.len() > EVENTS_MAX { p.soft { (events.len() - EVENTS_MAX) " more are not listed." } }
    }
}

fn again() -> Markup {
    html! {
        h2 { "Again" }
        p { "In this folder:" }
        pre {
            "canrig simulate " (file::SCENARIO) "                # in virtual time, in one process\n"
            "canrig run " (file::SCENARIO) " --clock lockstep    # in virtual time, over a bus\n"
            "canrig run " (file::SCENARIO) "                     # in real time\n"
            "canrig replay .                              # judge this recording again\n"
            "canrig report .                              # make this page again"
        }
        p {
            "Beside this page: "
            @for (number, name) in [file::BUS_LOG, file::SIGNALS, file::VERDICT, file::JUNIT].into_iter().enumerate() {
                @if number > 0 { ", " }
                a href=(name) { (name) }
            }
            "."
        }
    }
}
