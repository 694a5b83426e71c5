//! Differences between two runs: as a table for the terminal and as a page with plots.

use maud::{Markup, html};

use crate::play_record::PlayRecord;
use crate::recorded::JudgedRecording;
use dbc::names;
use judge::comparison::{Comparison, MetricDifference, SignalDifference, distances};
use platform::series::Series;
use recording::timeline::{self, Timeline};
use report::page;
use report::plot::{Colour, Patch, Plot, Shape};
use report::table::{Cell, Table, Text};
use report::{shown_unit, terminal};

/// Largest number of signals on the terminal; the page shows all.
const ROWS_MAX: usize = 8;
/// Largest number of signals with a plot that is not folded, in addition to positions and currents.
const PLOTS_MAX: usize = 12;
/// Largest number of marked stretches of one signal; more of them look like one.
const MARKED_MAX: usize = 200;

/// Returns the comparison as a text for the terminal.
pub(super) fn to_text(comparison: &Comparison) -> Text {
    let mut signals = Table::new([
        "signal",
        "rms",
        "differs by",
        "tolerance",
        "from",
        "B later by",
        "result",
    ]);
    let all = comparison.signals.iter();
    let differing = Vec::from_iter(all.filter(|signal| differs(signal)));
    for signal in differing.iter().take(ROWS_MAX) {
        signals.add([
            Cell::new(&signal.name),
            Cell::number(optional(signal.rms)),
            Cell::number(optional(signal.largest)),
            Cell::number(tolerance(signal.tolerance)),
            Cell::number(from(signal)),
            Cell::number(lag(signal)),
            result(signal_standing(signal)),
        ]);
    }
    let mut text = Text::default();
    if !differing.is_empty() {
        text.table(&signals);
    }
    if let Some(rest @ [_, ..]) = differing.get(ROWS_MAX..) {
        let worse = rest.iter().filter(|signal| !signal.agrees()).count();
        text.line(format!(
            "{} more signals differ, {worse} by more than their tolerance",
            rest.len()
        ));
    }
    let is_absent = |signal: &&SignalDifference| signal.largest.is_none();
    let absent = comparison.signals.iter().filter(is_absent).count();
    let same = comparison.signals.len() - differing.len() - absent;
    let mut counts = format!("{same} signals are exactly the same");
    if absent > 0 {
        counts += &format!(", {absent} have no values that could be compared");
    }
    text.line(counts);
    if !comparison.metrics.is_empty() {
        text.table(&metrics_table(&comparison.metrics));
    }
    for remark in &comparison.remarks {
        text.line(remark);
    }
    text.line(summary(comparison));
    text
}

fn metrics_table(metrics: &[MetricDifference]) -> Table {
    let mut table = Table::new(["metric", "A", "B", "tolerance", "result"]);
    for metric in metrics {
        table.add([
            Cell::new(&metric.name),
            Cell::number(value(metric, metric.a)),
            Cell::number(value(metric, metric.b)),
            Cell::number(terminal::rounded(metric.tolerance)),
            result(metric_standing(metric)),
        ]);
    }
    table
}

fn differs(signal: &SignalDifference) -> bool {
    signal.largest.is_some_and(|largest| largest > 0.0)
}

/// Returns the outcome in one line.
fn summary(comparison: &Comparison) -> String {
    if comparison.agrees {
        return format!("The runs agree in all {} cycles", comparison.shared_cycles);
    }
    let first = comparison
        .signals
        .iter()
        .filter_map(|signal| Some((signal.diverges_at_seconds?, &signal.name)));
    if let Some((time, name)) = first.min_by(|left, right| left.0.total_cmp(&right.0)) {
        return format!("The runs diverge, first in {name} at {time:.3} s");
    }
    let diverging = comparison.metrics.iter().filter(|metric| !metric.agrees);
    match &Vec::from_iter(diverging.map(|metric| metric.name.as_str()))[..] {
        [] => "The runs diverge".to_owned(),
        names => format!("The runs diverge in {}", names.join(", ")),
    }
}

fn optional(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), terminal::significant)
}

fn tolerance(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), terminal::rounded)
}

/// Returns the value of a metric in one of the runs: a number, or yes or no.
fn value(metric: &MetricDifference, value: Option<f64>) -> String {
    value.map_or("–".to_owned(), |value| {
        terminal::value(&metric.name, value)
    })
}

fn from(signal: &SignalDifference) -> String {
    signal
        .diverges_at_seconds
        .map_or(String::new(), |time| format!("{time:.3} s"))
}

/// Returns the lag of a signal; empty if it comes neither earlier nor later.
fn lag(signal: &SignalDifference) -> String {
    match signal.lag_seconds {
        Some(lag) if lag != 0.0 => terminal::with_minus(format!("{lag:.3} s")),
        _ => String::new(),
    }
}

/// Result of the comparison of a signal or a metric: its text, and its class in the style sheet.
type Standing = (&'static str, &'static str);

const NO_VALUES: Standing = ("no values", "soft");
const SAME: Standing = ("same", "pass");
const DIVERGES: Standing = ("diverges", "fail");

fn signal_standing(signal: &SignalDifference) -> Standing {
    match (signal.largest, signal.tolerance) {
        (None, _) => NO_VALUES,
        (Some(_), None) => ("does not count", "soft"),
        (Some(_), Some(_)) if signal.agrees() => SAME,
        (Some(_), Some(_)) => DIVERGES,
    }
}

fn metric_standing(metric: &MetricDifference) -> Standing {
    match (metric.a, metric.b) {
        (None, None) => NO_VALUES,
        (Some(_), None) => ("only in A", "unsure"),
        (None, Some(_)) => ("only in B", "unsure"),
        (Some(_), Some(_)) if metric.agrees => SAME,
        (Some(_), Some(_)) => DIVERGES,
    }
}

fn result((text, class): Standing) -> Cell {
    let cell = Cell::new(text);
    match class {
        "pass" => cell.good(),
        "fail" => cell.bad(),
        "unsure" => cell.unsure(),
        _ => cell,
    }
}

/// Names of the runs.
pub(super) const LETTERS: [&str; 2] = ["A", "B"];

/// Comparison of two runs, with its parameters.
pub(super) struct Compared<'a> {
    pub(super) comparison: &'a Comparison,
    pub(super) runs: [&'a JudgedRecording; 2],
    /// Links to the runs' own pages.
    pub(super) pages: [Option<String>; 2],
    /// Time by which a value of B may come earlier or later.
    pub(super) time_tolerance_seconds: f64,
}

impl Compared<'_> {
    fn timelines(&self) -> [&[Timeline]; 2] {
        self.runs.map(|run| &run.timelines[..])
    }
}

/// Returns the comparison as a page.
pub(super) fn to_html(compared: &Compared<'_>) -> String {
    let comparison = compared.comparison;
    let class = if comparison.agrees { "pass" } else { "fail" };
    let body = html! {
        h1 { "Two runs compared" }
        p { span.outcome.(class) { @if comparison.agrees { "agree" } @else { "diverge" } } }
        p { (summary(comparison)) "." }
        @for remark in &comparison.remarks { p { (page::sentence(remark)) } }
        (heads(compared))
        p.soft {
            "What counts: a signal beyond its tolerance, if no value of the other run within " (terminal::rounded(1e3 * compared.time_tolerance_seconds))
            " ms before or after is near enough, and a metric beyond its own. What has no tolerance, as currents, velocities and the terms of a \
             law, is shown and does not count. What only one run has a value of counts as a difference if it is a metric, and not if it is a \
             signal. Plots of a difference show 0 where each run has a value in that time that is near enough."
        }
        h2 { "Plots" }
        @let plots = Plots::of(compared);
        div.plots.even { @for plot in plots.open { (plot) } }
        @if !plots.folded.is_empty() { details {
            summary { "Other signals that count: " (plots.folded.len()) }
            div.plots.even { @for plot in plots.folded { (plot) } }
        } }
        @if comparison.signals.iter().any(|signal| !signal.agrees()) { p.soft { "Red: where a signal is beyond its tolerance." } }
        h2 { "Metrics" }
        (metrics(&comparison.metrics))
        h2 { "Signals" }
        (signals(&comparison.signals))
    };
    page::page("Two runs compared", &body)
}

fn heads(compared: &Compared<'_>) -> Markup {
    let row = |name: &str, value: fn(&JudgedRecording, &Option<String>) -> Markup| {
        let runs = compared.runs.into_iter().zip(&compared.pages);
        html! { tr {
            td.name { (name) }
            @for (letter, (run, page)) in LETTERS.iter().zip(runs) { td.broken data-name=(letter) { div { (value(run, page)) } } }
        } }
    };
    html! { div.wide { table.stacked {
        thead { tr { th { "run" } @for letter in LETTERS { th { (letter) } } } }
        tbody {
            (row("folder", |run, page| html! { @let path = run.recorded.path.display(); @match page { Some(page) => a href=(page) { (path) }, None => (path) } }))
            (row("scenario", |run, _| html! { (run.verdict.scenario) @for set in run.record.iter().flat_map(|play| &play.set) { div.soft { (page::set(set)) } } }))
            (row("rig", |run, _| html! { (run.recorded.plan.shared.rig.name) }))
            (row("law", |run, _| html! { @if let Some(identity) = &run.verdict.identity { (identity.law) } }))
            (row("seed", |run, _| html! { (run.verdict.seed) }))
            (row("result", |run, _| html! { span.(page::class(run.verdict.outcome)) { (page::word(run.verdict.outcome)) } }))
            (row("played", |run, _| html! { (run.record.as_ref().map(PlayRecord::place).unwrap_or_default()) div.soft { @if let Some(clock) = run.recorded.log.frames.clock() { "in " (page::time_by(clock)) ", " } "canrig " (run.verdict.version) @if let Some(identity) = &run.verdict.identity { ", program " code { (identity.program) } } } }))
        }
    } } }
}

/// Plots of a comparison.
struct Plots {
    /// Positions and currents, then the judged signals that diverge most, each next to its difference.
    open: Vec<Markup>,
    /// Other judged signals, unless they keep one value throughout.
    folded: Vec<Markup>,
}

impl Plots {
    fn of(compared: &Compared<'_>) -> Self {
        let comparison = compared.comparison;
        let names = compared.timelines()[0].iter().flat_map(|timeline| {
            let judged = [names::POSITION, names::OUTPUT];
            judged.map(|name| format!("{}{}", timeline.prefix(), timeline.quantities.name(name)))
        });
        let names = Vec::from_iter(names);
        let is_first = |signal: &&SignalDifference| names.contains(&signal.name);
        let first = names
            .iter()
            .filter_map(|name| comparison.signals.iter().find(|one| one.name == *name));
        let others = comparison.signals.iter().filter(|signal| !is_first(signal));
        let judged = others.filter(|signal| signal.tolerance.is_some());
        let (differing, same): (Vec<_>, Vec<_>) = judged.partition(|signal| differs(signal));
        let (most, less) = differing.split_at(differing.len().min(PLOTS_MAX));
        let same = same.into_iter().filter(|signal| changes(signal, compared));
        let drawn = |signal| drawn(signal, compared);
        Self {
            open: first.chain(most.iter().copied()).flat_map(drawn).collect(),
            folded: less.iter().copied().chain(same).flat_map(drawn).collect(),
        }
    }
}

/// Checks whether a signal has more than one value.
fn changes(signal: &SignalDifference, compared: &Compared<'_>) -> bool {
    compared.timelines().into_iter().any(|run| {
        let series = values(run, signal);
        let mut values = series.iter().filter(|value| value.is_finite());
        let first = values.next();
        values.any(|value| Some(value) != first)
    })
}

/// Draws a signal, and its difference if there is one.
fn drawn(signal: &SignalDifference, compared: &Compared<'_>) -> Vec<Markup> {
    if !differs(signal) {
        return vec![both(signal, compared.timelines(), &[])];
    }
    let [a, b] = compared.timelines();
    let both_values = [&values(a, signal), &values(b, signal)];
    let (rows, difference) = distances(signal, [&a[0], &b[0]], both_values);
    let marked = stretches(signal, &rows, &difference);
    vec![
        both(signal, compared.timelines(), &marked),
        difference_plot(signal, &rows, &difference, &marked),
    ]
}

fn values(run: &[Timeline], signal: &SignalDifference) -> Series<f64> {
    let mut signals = timeline::signals(run).into_iter();
    let found = signals.find(|rows| rows.name == signal.name);
    found.map_or_else(Series::default, |rows| rows.values)
}

fn both(signal: &SignalDifference, runs: [&[Timeline]; 2], marked: &[Patch]) -> Markup {
    let mut plot = Plot::over_time(signal.name.as_str(), &signal.unit);
    let [a, b] = runs.map(|run| values(run, signal));
    let bits = |values: &Series<f64>| Vec::from_iter(values.iter().map(f64::to_bits));
    let rows = runs.map(|run| &run[0].time_seconds);
    if !differs(signal) && bits(&a) == bits(&b) {
        plot.draw("A and B", Colour::Run(0), Shape::Line, rows[0], a);
    } else {
        plot.draw("A", Colour::Run(0), Shape::Line, rows[0], a);
        plot.draw("B", Colour::Run(2), Shape::Line, rows[1], b);
    }
    plot.patches.extend(marked);
    plot.render()
}

fn difference_plot(
    signal: &SignalDifference,
    rows: &Series<f64>,
    differences: &Series<f64>,
    marked: &[Patch],
) -> Markup {
    let title = format!("{}, B less A", signal.name);
    let mut plot = Plot::over_time(title, &signal.unit);
    plot.draw("difference", Colour::Run(5), Shape::Line, rows, differences);
    plot.patches.extend(marked);
    plot.render()
}

/// Returns patches for the stretches in which a signal that diverges is beyond its tolerance; empty for other signals.
fn stretches(
    signal: &SignalDifference,
    rows: &Series<f64>,
    differences: &Series<f64>,
) -> Vec<Patch> {
    let (Some(tolerance), false) = (signal.tolerance, signal.agrees()) else {
        return Vec::new();
    };
    let mut found: Vec<(f64, f64)> = Vec::new();
    let near = rows.last().map_or(0.0, |last| last / 500.0);
    for (time, difference) in rows.iter().zip(differences) {
        match found.last_mut() {
            _ if difference.abs() <= tolerance || difference.is_nan() => {}
            Some((_, until)) if time - *until <= near => *until = time,
            _ => found.push((time, time)),
        }
    }
    let patch = |(from, until): (f64, f64)| Patch::stretch("apart", (from, until.max(from + near)));
    found.into_iter().take(MARKED_MAX).map(patch).collect()
}

fn metrics(metrics: &[MetricDifference]) -> Markup {
    html! { div.wide { table.stacked {
        thead { tr { th { "metric" } th.number { "A" } th.number { "B" } th.number { "tolerance" } th { "result" } } }
        tbody { @for metric in metrics { tr {
            td.name { (page::name(&metric.name)) }
            td.number data-name="A" { (value(metric, metric.a)) }
            td.number data-name="B" { (value(metric, metric.b)) }
            td.number data-name="tolerance" { (terminal::rounded(metric.tolerance)) }
            td data-name="result" { (word(metric_standing(metric))) }
        } } }
    } } }
}

fn signals(signals: &[SignalDifference]) -> Markup {
    let time = |time: Option<f64>| time.map_or(String::new(), |time| format!("{time:.3}"));
    let is_same = |signal: &&SignalDifference| signal.largest == Some(0.0);
    let (same, different): (Vec<_>, Vec<_>) = signals.iter().partition(is_same);
    html! {
        @if !different.is_empty() { div.wide { table.stacked {
        thead { tr {
            th { "signal" } th { "unit" } th.number { "rms" } th.number { "differs by at most" } th.number { "at (s)" } th.number { "tolerance" }
            th.number { "diverges from (s)" } th.number { "in % of the cycles" } th.number { "B later by" } th { "result" }
        } }
        tbody { @for signal in different { tr {
            td.name { (page::name(&signal.name)) }
            td.none[signal.unit.is_empty()] data-name="unit" { (shown_unit(&signal.unit)) }
            td.number data-name="rms" { (optional(signal.rms)) }
            td.number data-name="differs by at most" { (optional(signal.largest)) }
            td.number.none[signal.largest_at_seconds.is_none()] data-name="at (s)" { (time(signal.largest_at_seconds)) }
            td.number data-name="tolerance" { (tolerance(signal.tolerance)) }
            td.number.none[signal.agrees()] data-name="diverges from (s)" { (time(signal.diverges_at_seconds)) }
            td.number data-name="in % of the cycles" { (terminal::significant(signal.beyond_percent)) }
            td.number.nowrap.none[lag(signal).is_empty()] data-name="B later by" { (lag(signal)) }
            td data-name="result" { (word(signal_standing(signal))) }
        } } }
        } } }
        @if !same.is_empty() { details {
            summary { "Signals without a difference: " (same.len()) }
            p { @for (number, signal) in same.iter().enumerate() { @if number > 0 { ", " } (page::name(&signal.name)) } }
        } }
    }
}

fn word((text, class): Standing) -> Markup {
    html! { span.nowrap.(class) { (text) } }
}
