//! What two runs differ in: as a table for the terminal and as a page with plots.

use comfy_table::{Cell, CellAlignment, Color};
use maud::{Markup, html};

use judge::comparison::{Comparison, MetricDifference, SignalDifference};
use platform::series::Series;
use recording::timeline::{self, Timeline};
use report::page;
use report::plot::{Colour, Patch, Plot, Shape};
use report::terminal;

/// Signals that the terminal shows; the page shows all.
const ROWS_MAX: usize = 8;
/// Signals that are plotted.
const PLOTS_MAX: usize = 6;

/// The comparison for people at a terminal.
#[must_use]
pub(super) fn to_text(comparison: &Comparison) -> String {
    let mut signals = terminal::empty_table([
        "signal",
        "rms",
        "differs by",
        "tolerance",
        "from",
        "B later by",
        "result",
    ]);
    let differing: Vec<_> = comparison
        .signals
        .iter()
        .filter(|signal| signal.largest.is_some_and(|largest| largest > 0.0))
        .collect();
    for signal in differing.iter().take(ROWS_MAX) {
        signals.add_row([
            Cell::new(&signal.name),
            number(optional(signal.rms)),
            number(optional(signal.largest)),
            number(optional(signal.tolerance)),
            number(from(signal)),
            number(lag(signal)),
            match signal.tolerance {
                Some(_) => result(signal.agrees()),
                None => Cell::new("not judged"),
            },
        ]);
    }
    let mut metrics = terminal::empty_table(["metric", "A", "B", "tolerance", "result"]);
    for metric in &comparison.metrics {
        metrics.add_row([
            Cell::new(&metric.name),
            number(value(metric, metric.a)),
            number(value(metric, metric.b)),
            number(terminal::significant(metric.tolerance)),
            result(metric.agrees),
        ]);
    }
    let mut text = String::new();
    if !differing.is_empty() {
        text += &format!("{signals}\n");
    }
    if let Some(rest @ [_, ..]) = differing.get(ROWS_MAX..) {
        let worse = rest.iter().filter(|signal| !signal.agrees()).count();
        text += &format!(
            "{} more signals differ, {worse} by more than their tolerance\n",
            rest.len()
        );
    }
    let absent = comparison
        .signals
        .iter()
        .filter(|signal| signal.largest.is_none())
        .count();
    let same = comparison.signals.len() - differing.len() - absent;
    text += &format!("{same} signals are exactly the same");
    if absent > 0 {
        text += &format!(", {absent} have no values that could be compared");
    }
    text.push('\n');
    if !comparison.metrics.is_empty() {
        text += &format!("{metrics}\n");
    }
    for remark in &comparison.remarks {
        text += &format!("{remark}\n");
    }
    text + summary(comparison).as_str()
}

/// The outcome in one line.
fn summary(comparison: &Comparison) -> String {
    if comparison.agrees {
        return format!("the runs agree in all {} cycles", comparison.shared_cycles);
    }
    let first = comparison
        .signals
        .iter()
        .filter_map(|signal| Some((signal.diverges_at_seconds?, &signal.name)));
    match first.min_by(|left, right| left.0.total_cmp(&right.0)) {
        Some((time, name)) => format!("the runs DIVERGE, first in {name} at {time:.3} s"),
        None => "the runs DIVERGE".to_owned(),
    }
}

fn optional(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), terminal::significant)
}

/// The value of a metric in one of the runs: a number, or yes or no.
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

/// Nothing for a signal that comes neither earlier nor later.
fn lag(signal: &SignalDifference) -> String {
    match signal.lag_seconds {
        Some(lag) if lag != 0.0 => format!("{lag:.3} s"),
        _ => String::new(),
    }
}

fn number(text: String) -> Cell {
    Cell::new(text).set_alignment(CellAlignment::Right)
}

fn result(agrees: bool) -> Cell {
    if agrees {
        Cell::new("same").fg(Color::Green)
    } else {
        Cell::new("DIVERGES").fg(Color::Red)
    }
}

/// The comparison as a page.
#[must_use]
pub(super) fn to_html(
    comparison: &Comparison,
    names: &[String; 2],
    runs: [&[Timeline]; 2],
) -> String {
    let class = if comparison.agrees { "pass" } else { "fail" };
    let body = html! {
        h1 { "Two runs compared" }
        p { span.outcome.(class) { @if comparison.agrees { "agree" } @else { "diverge" } } }
        p { (summary(comparison)) "." }
        @for remark in &comparison.remarks { p { (remark) } }
        dl.facts { @for (letter, name) in ["A", "B"].iter().zip(names) { div { dt { (letter) } dd { (name) } } } }
        h2 { "Plots" }
        div.plots { @for plot in plots(comparison, runs) { (plot) } }
        @if !comparison.agrees { p.soft { "Red: from where the runs diverge." } }
        h2 { "Metrics" }
        (metrics(&comparison.metrics))
        h2 { "Signals" }
        (signals(&comparison.signals))
    };
    page::page("Two runs compared", &body)
}

/// The position first, then what diverges most; under each signal the difference.
fn plots(comparison: &Comparison, [a, b]: [&[Timeline]; 2]) -> Vec<Markup> {
    let names = a.iter().map(|timeline| {
        let position = timeline.measurand.rename("position_millimetres");
        format!("{}{position}", timeline.prefix())
    });
    let names = Vec::from_iter(names);
    let is_position = |signal: &&SignalDifference| names.contains(&signal.name);
    let positions = comparison.signals.iter().filter(is_position);
    let others = comparison.signals.iter();
    let diverging = others.filter(|signal| !signal.agrees() && !is_position(signal));
    let shown = positions.chain(diverging.take(PLOTS_MAX));
    let plots = shown.flat_map(|signal| [both(signal, [a, b]), difference(signal, [a, b])]);
    plots.collect()
}

fn values<'a>(run: &'a [Timeline], signal: &SignalDifference) -> &'a [f64] {
    let mut signals = timeline::signals(run).into_iter();
    let found = signals.find(|rows| rows.name == signal.name);
    found.map_or(&[], |rows| rows.values)
}

fn both(signal: &SignalDifference, [a, b]: [&[Timeline]; 2]) -> Markup {
    let mut plot = Plot::over_time(signal.name.as_str(), &signal.unit);
    for (label, colour, run) in [("A", Colour::Run(0), a), ("B", Colour::Run(3), b)] {
        let values = values(run, signal);
        plot.draw(label, colour, Shape::Line, &run[0].time_seconds, values);
    }
    plot.patches.extend(apart(signal));
    plot.render()
}

/// B less A at the cycles of A, within the tolerance or not.
fn difference(signal: &SignalDifference, [a, b]: [&[Timeline]; 2]) -> Markup {
    let [a_values, b_values] = [a, b].map(|run| values(run, signal));
    let (a, b) = (&a[0], &b[0]);
    let mut others = b.cycle.iter().zip(b_values).peekable();
    let mut at = |cycle: &u64| {
        while others.next_if(|(other, _)| *other < cycle).is_some() {}
        let found = others.next_if(|(other, _)| *other == cycle);
        found.map(|(_, value)| *value)
    };
    let rows = a.cycle.iter().zip(a_values);
    let differences: Series<f64> = rows
        .map(|(cycle, value)| at(cycle).unwrap_or(f64::NAN) - value)
        .collect();
    let title = format!("{}, B less A", signal.name);
    let mut plot = Plot::over_time(title, &signal.unit);
    let label = "difference";
    plot.draw(
        label,
        Colour::Run(5),
        Shape::Line,
        &a.time_seconds,
        &differences,
    );
    plot.patches.extend(apart(signal));
    plot.render()
}

/// What lies behind the curves from where the runs diverge.
fn apart(signal: &SignalDifference) -> Option<Patch> {
    signal.diverges_at_seconds.map(|from| Patch {
        class: "apart",
        x: (from, f64::INFINITY),
        y: (f64::NEG_INFINITY, f64::INFINITY),
    })
}

fn metrics(metrics: &[MetricDifference]) -> Markup {
    html! { div.wide { table {
        thead { tr { th { "metric" } th.number { "A" } th.number { "B" } th.number { "tolerance" } th { "result" } } }
        tbody { @for metric in metrics { tr {
            td { (page::name(&metric.name)) }
            td.number { (value(metric, metric.a)) }
            td.number { (value(metric, metric.b)) }
            td.number { (terminal::significant(metric.tolerance)) }
            td { (word(metric.agrees)) }
        } } }
    } } }
}

fn signals(signals: &[SignalDifference]) -> Markup {
    html! { div.wide { table {
        thead { tr {
            th { "signal" } th { "unit" } th.number { "rms" } th.number { "differs by at most" } th.number { "at (s)" } th.number { "tolerance" }
            th.number { "diverges from (s)" } th.number { "in % of the cycles" } th.number { "B later by" } th { "result" }
        } }
        tbody { @for signal in signals { tr {
            td { (page::name(&signal.name)) }
            td { (signal.unit) }
            td.number { (optional(signal.rms)) }
            td.number { (optional(signal.largest)) }
            td.number { (signal.largest_at_seconds.map_or(String::new(), |time| format!("{time:.3}"))) }
            td.number { (optional(signal.tolerance)) }
            td.number { (signal.diverges_at_seconds.map_or(String::new(), |time| format!("{time:.3}"))) }
            td.number { (terminal::significant(signal.beyond_percent)) }
            td.number { (lag(signal)) }
            td { @if signal.tolerance.is_some() { (word(signal.agrees())) } @else { span.soft { "not judged" } } }
        } } }
    } } }
}

fn word(agrees: bool) -> Markup {
    html! { @if agrees { span.pass { "same" } } @else { span.fail { "DIVERGES" } } }
}
