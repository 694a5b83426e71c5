//! What a sweep came to: as tables for the terminal and as a page.

use comfy_table::{Cell, CellAlignment, Color};
use maud::{Markup, html};

use super::drivers::Driven;
use super::row::Ended;
use super::summary::{Failing, MetricSpread, Summary};
use report::plot::{Colour, Extent, Patch, Plot, Shape};
use report::{page, terminal};

/// The heads of the metrics' table.
const HEADS: [&str; 8] = [
    "metric",
    "runs",
    "least",
    "median",
    "p95",
    "greatest",
    "limit",
    "missed by",
];

/// Worst cases that are named for each metric.
const WORST_NAMED: usize = 5;

/// Values lie far out when they stretch the range of 98 % of them so many times.
const OUTLIERS_FROM: f64 = 4.0;

/// The metrics with their limits, then how many cases ended how.
#[must_use]
pub(crate) fn to_text(summary: &Summary) -> String {
    let mut table = terminal::empty_table(HEADS);
    for spread in &summary.spreads {
        let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
        let missed = right(missed(spread));
        let missed = if spread.missed > 0 {
            missed.fg(Color::Red)
        } else {
            missed
        };
        let numbers = spread.quantiles.map(|value| right(number(spread, value)));
        let name = [Cell::new(&spread.name), right(spread.count.to_string())];
        let limit = Cell::new(terminal::limit(&spread.name, spread.limit));
        table.add_row(name.into_iter().chain(numbers).chain([limit, missed]));
    }
    let (name, counts) = (&summary.name, counts(summary));
    // Torture measures nothing: what it breaks are invariants.
    match summary.spreads.is_empty() {
        true => format!("\n{name}\n{counts}"),
        false => format!("\n{name}\n{table}\n{counts}"),
    }
}

/// The page. `place_of` says where the scenario of a case is.
#[must_use]
pub(crate) fn to_html(summary: &Summary, place_of: impl Fn(&Failing) -> String) -> String {
    let worst = summary.worst();
    let body = html! {
        h1 { (summary.name) }
        p { span.outcome.(class(worst)) { (worst.word()) } " " (counts(summary)) }
        dl.facts {
            div { dt { "runs" } dd { (summary.runs) } }
            @if summary.runs != summary.runs_of_whole { div { dt { "of the sweep's" } dd { (summary.runs_of_whole) } } }
            @for (ended, count) in &summary.ended { div { dt { (words(*ended)) } dd { (count) } } }
            div { dt { "canrig" } dd { (env!("CARGO_PKG_VERSION")) } }
        }
        h2 { "What varies" }
        div.wide { table {
            thead { tr { th { "key" } th { "values" } } }
            tbody { @for (key, way) in &summary.keys { tr { td { (key) } td { (way) } } } }
        } }
        @if !summary.spreads.is_empty() {
            h2 { "What came of it" }
            (metrics(&summary.spreads))
            div.plots.even { @for spread in &summary.spreads { (drawn(spread)) } }
            p.soft { "Each curve says how many of the runs have at most a value. The shaded stretch is what the limit admits." }
        }
        (driven(&summary.driven))
        @if !summary.failing.is_empty() {
            h2 { "Cases that do not pass" }
            (failing(summary, place_of))
        }
    };
    page::page(&summary.name, &body)
}

fn metrics(spreads: &[MetricSpread]) -> Markup {
    html! {
        div.wide { table {
            thead { tr { @for (place, head) in HEADS.iter().enumerate() { th.number[(1..6).contains(&place)] { (head) } } } }
            tbody { @for spread in spreads { tr {
                td { (page::name(&spread.name)) }
                td.number { (spread.count) }
                @for value in spread.quantiles { td.number { (number(spread, value)) } }
                td { (terminal::limit(&spread.name, spread.limit)) }
                td.fail[spread.missed > 0] { (missed(spread)) }
            } } }
        } }
    }
}

/// A value of the distribution; no case may have one.
fn number(spread: &MetricSpread, value: f64) -> String {
    match spread.count {
        0 => "never".to_owned(),
        _ => terminal::value(&spread.name, value),
    }
}

/// How many cases missed the limit; nothing where there is none.
fn missed(spread: &MetricSpread) -> String {
    match (spread.missed, spread.limit) {
        (0, None) => String::new(),
        (missed, _) => missed.to_string(),
    }
}

/// The distribution of a metric; nothing where all values are the same.
fn drawn(spread: &MetricSpread) -> Markup {
    if !spread.varies() {
        return html! {};
    }
    let name = &spread.name;
    let (x, y) = &spread.curve;
    let range = without_outliers(spread);
    let x_label = match range {
        Some(_) => format!("{name} (the outermost are not shown)"),
        None => name.clone(),
    };
    let mut plot = Plot {
        x_label: &x_label,
        extent: Extent::All,
        x_range: range,
        ..Plot::over_time(name.as_str(), "% of the runs")
    };
    plot.draw("runs up to a value", Colour::Measured, Shape::Line, x, y);
    plot.patches.extend(spread.limit.map(|limit| Patch {
        class: "band",
        x: (
            limit.min.unwrap_or(f64::NEG_INFINITY),
            limit.max.unwrap_or(f64::INFINITY),
        ),
        y: (f64::NEG_INFINITY, f64::INFINITY),
    }));
    plot.render()
}

/// Which keys drive what has a limit, and the worst runs.
fn driven(driven: &[Driven]) -> Markup {
    if driven.is_empty() {
        return html! {};
    }
    html! {
        h2 { "What drives it" }
        div.wide { table {
            thead { tr { th { "metric" } th { "follows most" } th.number { "runs looked at" } th { "worst cases" } } }
            tbody { @for one in driven { tr {
                td { (page::name(&one.name)) }
                td { @for (key, correlation) in &one.keys { (format!("{correlation:+.2} ")) (page::name(key)) br; } }
                td.number { (one.of) }
                td { (worst_cases(one)) }
            } } }
        } }
        div.plots.even.dots { @for one in driven { (scatter(one)) } }
        p.soft {
            "The numbers are rank correlations (Spearman): +1 or \u{2212}1 where the metric always grows or falls with the key, 0 where \
             it does not follow it. Below 0.1 no key is named. The worst runs are the farthest beyond a limit, or the nearest to one; a \
             run that misses its limit without a value counts as the worst. Dots are runs, by the first of the keys; the worst of all \
             runs have the second colour."
        }
    }
}

/// The first of the worst cases.
fn worst_cases(driven: &Driven) -> String {
    let worst = driven.worst.iter().take(WORST_NAMED);
    let worst: Vec<String> = worst.map(|(case, ..)| case.to_string()).collect();
    worst.join(", ")
}

/// The runs in the plane of the first key and the metric.
fn scatter(driven: &Driven) -> Markup {
    let Some((key, _)) = driven.keys.first() else {
        return html! {};
    };
    // A gap behind each point: none is joined with another.
    let apart = |points: &mut dyn Iterator<Item = (f64, f64)>| -> (Vec<f64>, Vec<f64>) {
        let gap = (f64::NAN, f64::NAN);
        points.flat_map(|point| [point, gap]).unzip()
    };
    let (x, y) = apart(&mut driven.sample.iter().copied());
    let worst = driven.worst.iter().filter(|(.., value)| value.is_finite());
    let (worst_x, worst_y) = apart(&mut worst.map(|(_, key, value)| (*key, *value)));
    let mut plot = Plot {
        x_label: key,
        extent: Extent::All,
        x_range: with_margins(x.iter().chain(&worst_x)),
        ..Plot::over_time(driven.name.as_str(), "")
    };
    plot.draw("runs", Colour::Measured, Shape::Path, &x, &y);
    plot.draw(
        "the worst",
        Colour::Estimated,
        Shape::Path,
        &worst_x,
        &worst_y,
    );
    plot.render()
}

/// A range in which no dot lies on the edge; none without dots.
fn with_margins<'a>(values: impl Iterator<Item = &'a f64>) -> Option<(f64, f64)> {
    let (least, greatest) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |range, value| {
        (range.0.min(*value), range.1.max(*value))
    });
    let margin = 0.02 * (greatest - least);
    (margin > 0.0).then_some((least - margin, greatest + margin))
}

/// The range that is drawn: where few values lie far out, that of the others.
fn without_outliers(spread: &MetricSpread) -> Option<(f64, f64)> {
    let [least, .., greatest] = spread.quantiles;
    let (low, high) = spread.bulk;
    let room = 0.5 * (high - low);
    let has_outliers = room > 0.0 && greatest - least > OUTLIERS_FROM * (high - low);
    has_outliers.then(|| (least.max(low - room), greatest.min(high + room)))
}

fn failing(summary: &Summary, place_of: impl Fn(&Failing) -> String) -> Markup {
    let (shown, total) = (summary.failing.len(), summary.failing_total());
    html! {
        @if shown < total { p.unsure { "The first " (shown) " of " (total) "; the tables have all." } }
        div.wide { table {
            thead { tr { th.number { "case" } th { "result" } th { "why" } th { "values" } } }
            tbody { @for one in &summary.failing { tr {
                td.number { a href=(place_of(one)) { (one.case) } }
                td.(class(one.ended)) { (words(one.ended)) }
                td { (one.why) }
                td { (one.values) }
            } } }
        } }
    }
}

/// How many cases ended how, in one line.
fn counts(summary: &Summary) -> String {
    let counts: Vec<String> = summary
        .ended
        .iter()
        .map(|(ended, count)| format!("{count} {}", words(*ended)))
        .collect();
    format!("{} runs: {}", summary.runs, counts.join(", "))
}

fn words(ended: Ended) -> String {
    ended.word().replace('_', " ")
}

fn class(ended: Ended) -> &'static str {
    match ended {
        Ended::Pass => "pass",
        Ended::Inconclusive | Ended::Incomplete => "unsure",
        Ended::Fail | Ended::Invalid | Ended::InternalError => "fail",
    }
}
