//! Results of a sweep: as tables for the terminal and as a page.

use maud::{Markup, html};

use super::drivers::{Driven, nearest_end};
use super::row::Ended;
use super::summary::{MetricSpread, Summary};
use judge::verdict::Identity;
use report::plot::{Colour, Extent, Patch, Plot, Shape};
use report::table::{Cell, Table, Text};
use report::{page, terminal};
use scenario::expect::Limit;

/// Heads of the metrics' table.
const HEADS: [&str; 8] = [
    "metric",
    "runs",
    "min",
    "median",
    "p95",
    "max",
    "limit",
    "missed in",
];

/// Head of the column with the worst cases.
const WORST: &str = "next to a limit or beyond";

/// Number of worst cases that are named for each metric.
const WORST_NAMED: usize = 3;

/// Least ratio of the whole range to that of 98 % of the values from which values beyond count as outliers.
const OUTLIERS_FROM: f64 = 4.0;

/// Returns the metrics with their limits, then the number of cases for each way to end.
pub(super) fn to_text(summary: &Summary<'_>) -> Text {
    let mut table = Table::new(HEADS);
    for spread in &summary.spreads {
        let missed = Cell::number(missed(spread));
        let missed = if spread.missed > 0 {
            missed.bad()
        } else {
            missed
        };
        let numbers = spread
            .quantiles
            .map(|value| Cell::number(number(spread, value)));
        let name = [
            Cell::new(&spread.name),
            Cell::number(spread.count.to_string()),
        ];
        let limit = Cell::new(terminal::limit(&spread.name, spread.limit));
        table.add(name.into_iter().chain(numbers).chain([limit, missed]));
    }
    let mut text = Text::default();
    text.line(format!("\n{}", summary.cases.facts().name()));
    // Torture has no metrics; its results are broken invariants.
    if !summary.spreads.is_empty() {
        text.table(&table);
    }
    text.line(counts(summary));
    text
}

/// Returns the page of a campaign.
pub(super) fn to_html(summary: &Summary<'_>, identity: &Identity) -> String {
    let (worst, facts) = (summary.worst(), summary.cases.facts());
    let body = html! {
        h1 { (facts.name()) }
        p { span.outcome.(class(worst)) { (outcome_text(worst)) } " " (page::sentence(&format!("{} of {}", facts.kind, counts(summary)))) }
        @if let Some(criterion) = facts.criterion { p { (criterion) } }
        @if summary.runs != facts.runs { p { "This is a part of " (facts.runs) " runs." } }
        h2 { "Parameters" }
        (parameters(&facts.variations))
        @if !summary.spreads.is_empty() {
            h2 { "Results" }
            (metrics(&summary.spreads))
            div.plots.even { @for spread in &summary.spreads { (drawn(spread)) } }
            p.soft { "Each curve says how many of the runs have at most a value. The shaded stretch is what the limit admits, the dashed line is the limit." @if summary.spreads.iter().any(has_runs_outside) { " Runs beyond the edge are dots on it." } }
        }
        (driven(summary))
        @if !summary.failing.is_empty() {
            h2 { "Cases that do not pass" }
            (failing(summary))
        }
        h2 { "Versions" }
        dl.facts.versions {
            div { dt { "program" } dd { "canrig " (env!("CARGO_PKG_VERSION")) } }
            div { dt { "seed" } dd { (facts.seed) } }
            (page::identity(identity))
        }
        (page::undated())
    };
    page::page(facts.name(), &body)
}

fn parameters(keys: &[(String, String)]) -> Markup {
    html! { @match keys {
        [(first, variation), others @ ..] if !others.is_empty() && others.iter().all(|(_, other)| other == variation) => p {
            "Each is " (variation) ": " (page::key(first)) @for (key, _) in others { ", " (page::key(key)) } "."
        },
        _ => div.wide { table.stacked {
            thead { tr { th { "key" } th { "values" } } }
            tbody { @for (key, variation) in keys { tr { td.name { (page::key(key)) } td data-name="values" { (variation) } } } }
        } },
    } }
}

fn metrics(spreads: &[MetricSpread]) -> Markup {
    html! {
        div.wide { table.stacked {
            thead { tr { @for (place, head) in HEADS.iter().enumerate() { th.number[(1..6).contains(&place)] { (head) } } } }
            tbody { @for spread in spreads { tr {
                td.name { (page::name(&spread.name)) }
                td.number data-name="runs" { (spread.count) }
                @for (head, value) in HEADS[2..].iter().zip(spread.quantiles) { td.number data-name=(head) { (number(spread, value)) } }
                td.none[spread.limit.is_none()] data-name="limit" { (terminal::limit(&spread.name, spread.limit)) }
                td.none[spread.limit.is_none()].fail[spread.missed > 0] data-name=(HEADS[7]) { (missed(spread)) }
            } } }
        } }
    }
}

/// Returns a value of the distribution as a text; "never" if no case has one.
fn number(spread: &MetricSpread, value: f64) -> String {
    match spread.count {
        0 => "never".to_owned(),
        _ => terminal::value(&spread.name, value),
    }
}

/// Returns the number of cases that missed the limit; empty without a limit.
fn missed(spread: &MetricSpread) -> String {
    match (spread.missed, spread.limit) {
        (0, None) => String::new(),
        (missed, _) => missed.to_string(),
    }
}

/// Draws the distribution of a metric; empty if all values are the same.
fn drawn(spread: &MetricSpread) -> Markup {
    if !spread.varies() {
        return html! {};
    }
    let name = &spread.name;
    let (x, y) = &spread.curve;
    let range = shown_range(spread);
    let mut plot = Plot {
        x_label: name,
        x_range: Some(range),
        ..Plot::over_time(name.as_str(), "% of the runs")
    };
    plot.draw("runs up to a value", Colour::Measured, Shape::Line, x, y);
    let limits = ends(spread).filter(|limit| range.0 < *limit && *limit < range.1);
    let limits = Vec::from_iter(limits.map(|limit| [limit; 2]));
    for limit in &limits {
        let label = format!("limit {}", terminal::as_written(limit[0]));
        plot.draw(label, Colour::Wanted, Shape::Dashed, limit, &[0.0, 100.0]);
    }
    let (edge_x, edge_y) = outside(spread, range);
    let outliers = match edge_x.len() {
        1 => "1 outlier",
        _ => "outliers",
    };
    let [least, .., greatest] = spread.quantiles.map(|value| terminal::value(name, value));
    let label = format!("{outliers} ({least} to {greatest})");
    plot.draw(label, Colour::Estimated, Shape::Points, &edge_x, &edge_y);
    let band = |limit: Limit| Patch::stretch("band", limit.ends());
    plot.patches.extend(spread.limit.map(band));
    plot.render()
}

/// Returns the ends of a metric's limit.
fn ends(spread: &MetricSpread) -> impl Iterator<Item = f64> {
    let ends = |limit: Limit| [limit.min, limit.max].into_iter().flatten();
    spread.limit.into_iter().flat_map(ends)
}

fn has_runs_outside(spread: &MetricSpread) -> bool {
    spread.varies() && !outside(spread, shown_range(spread)).0.is_empty()
}

/// Returns the runs beyond the edges, moved to the edges, with the percentage of runs up to each.
fn outside(spread: &MetricSpread, (from, until): (f64, f64)) -> (Vec<f64>, Vec<f64>) {
    let points = spread.curve.0.iter().zip(&spread.curve.1).step_by(2);
    let beyond = points.filter(|(x, _)| !(from..=until).contains(*x));
    beyond.map(|(x, y)| (x.clamp(from, until), *y)).unzip()
}

/// Shows the keys that drive each metric with a limit, and the worst runs.
fn driven(summary: &Summary<'_>) -> Markup {
    let driven = &summary.driven;
    if driven.is_empty() {
        return html! {};
    }
    html! {
        h2 { "Sensitivity" }
        div.wide { table.stacked {
            thead { tr { th { "metric" } th { "follows most" } th.number { "runs looked at" } th { (WORST) } } }
            tbody { @for one in driven { tr {
                td.name { (page::name(&one.name)) }
                td data-name="follows most" { div { @for (key, correlation) in &one.keys { div { (format!("{correlation:+.2} ").replace('-', "\u{2212}")) (page::key(key)) } } } }
                td.number data-name="runs looked at" { (one.of) }
                td.broken.words data-name=(WORST) { div { @for worst in one.worst.iter().take(WORST_NAMED) { (worst_case(summary, one, worst)) } } }
            } } }
        } }
        div.plots.even.dots { @for one in driven { (scatter(summary, one)) } }
        p.soft {
            "The numbers are rank correlations (Spearman): +1 or \u{2212}1 where the metric always grows or falls with the key, 0 where \
             it does not follow it. Below 0.1 no key is named. A run that misses its limit without a value counts as the farthest beyond \
             it. Dots are runs, by the first of the keys; those next to a limit or beyond it have the second colour, and what plays one of \
             them is said when you point at it."
        }
    }
}

/// Returns one of the worst cases with its value, its limit, and the command that plays it.
fn worst_case(
    summary: &Summary<'_>,
    driven: &Driven,
    (case, _, value): &(usize, f64, f64),
) -> Markup {
    let name = &driven.name;
    let shown = terminal::reached(name, Some(*value).filter(|value| value.is_finite()));
    let limit = driven.limit.map(|limit| {
        let end = terminal::limit(name, Some(nearest_end(limit, *value)));
        format!(": {}", terminal::with_limit(&shown, &end))
    });
    let title = format!("case {case}{}", limit.unwrap_or_default());
    html! { @match summary.command(*case) {
        Some(command) => details { summary { (title) } code { (command) } },
        None => div { (title) },
    } }
}

/// Returns the label of the second colour, with the end of the limit if it is the same for all of these runs.
fn worst_label(driven: &Driven) -> String {
    let Some(limit) = driven.limit else {
        return "it was broken".to_owned();
    };
    let worst = driven.worst.iter();
    let ends = worst.map(|(.., value)| nearest_end(limit, *value));
    let ends = Vec::from_iter(ends.map(|end| terminal::limit(&driven.name, Some(end))));
    match &ends[..] {
        [first, others @ ..] if others.iter().all(|other| other == first) => {
            format!("next to or beyond {first}")
        }
        _ => "next to or beyond a limit".to_owned(),
    }
}

/// Draws the runs in the plane of the first key and the metric.
fn scatter(summary: &Summary<'_>, driven: &Driven) -> Markup {
    let Some((key, _)) = driven.keys.first() else {
        return html! {};
    };
    // The gap behind each point keeps it from being joined with the next.
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
    let label = worst_label(driven);
    plot.draw(label, Colour::Estimated, Shape::Path, &worst_x, &worst_y);
    let note = |(case, key, value): &(usize, f64, f64)| {
        let command = summary.command(*case).map(|command| format!(": {command}"));
        let text = format!("case {case}{}", command.unwrap_or_default());
        value.is_finite().then_some((*key, *value, text))
    };
    plot.notes = driven.worst.iter().filter_map(note).collect();
    plot.render()
}

/// Returns a range in which no dot lies on the edge; `None` without dots.
fn with_margins<'a>(values: impl Iterator<Item = &'a f64>) -> Option<(f64, f64)> {
    let (least, greatest) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |range, value| {
        (range.0.min(*value), range.1.max(*value))
    });
    let margin = 0.02 * (greatest - least);
    (margin > 0.0).then_some((least - margin, greatest + margin))
}

/// Returns the range to draw: that of the bulk if few values lie far out, and in any case a limit that is near.
fn shown_range(spread: &MetricSpread) -> (f64, f64) {
    let [least, .., greatest] = spread.quantiles;
    let (low, high) = spread.bulk;
    let room = 0.5 * (high - low);
    let has_outliers = room > 0.0 && greatest - least > OUTLIERS_FROM * (high - low);
    let (mut from, mut until) = if has_outliers {
        (least.max(low - room), greatest.min(high + room))
    } else {
        (least, greatest)
    };
    // A limit far from all runs would press them together.
    let near = 2.0 * (until - from);
    for end in ends(spread) {
        if end > from - near && end < until + near {
            (from, until) = (from.min(end), until.max(end));
        }
    }
    let margin = 0.02 * (until - from);
    (from - margin, until + margin)
}

fn failing(summary: &Summary<'_>) -> Markup {
    let (shown, total) = (summary.failing.len(), summary.failing_total());
    html! {
        @if shown < total { p.unsure { "The first " (shown) " of " (total) "; the tables have all." } }
        p.soft { "The commands play a case alone, in this folder." }
        div.wide { table.stacked {
            thead { tr { th { "case" } th { "result" } th { "why" } th { "values, and what plays it" } } }
            tbody { @for one in &summary.failing { tr {
                td.case { a href=(one.place()) { "case " (one.case) } }
                td.nowrap.(class(one.ended)) data-name="result" { (outcome_text(one.ended)) }
                td.broken.words data-name="why" { (page::name(&one.why)) }
                td.broken.words data-name="values" { div {
                    (one.values)
                    @if let Some(command) = summary.command(one.case) { div { code { (command) } } }
                } }
            } } }
        } }
    }
}

/// Returns the number of cases for each way to end, in one line.
fn counts(summary: &Summary<'_>) -> String {
    let counts: Vec<String> = summary
        .ended
        .iter()
        .map(|(ended, count)| format!("{count} {}", outcome_text(*ended)))
        .collect();
    format!("{} runs: {}", summary.runs, counts.join(", "))
}

fn outcome_text(ended: Ended) -> String {
    ended.word().replace('_', " ")
}

fn class(ended: Ended) -> &'static str {
    match ended {
        Ended::Invalid | Ended::InternalError => "fail",
        judged => page::class(judged.outcome()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread(max: Option<f64>, sorted: &[f64]) -> MetricSpread {
        let limit = max.map(|max| Limit {
            min: None,
            max: Some(max),
        });
        MetricSpread::new("overshoot_percent", limit, 0, sorted)
    }

    #[test]
    fn each_key_has_the_values_that_were_played() {
        let keys = |variations: &[&str]| {
            let named = ('a'..).zip(variations);
            let keys = named.map(|(key, values)| (key.to_string(), (*values).to_owned()));
            parameters(&Vec::from_iter(keys)).into_string()
        };
        assert!(keys(&["1 to 2", "1 to 2", "1 to 2"]).contains("Each is 1 to 2"));
        let last_differs = keys(&["1 to 2", "1 to 2", "3 to 4"]);
        assert!(last_differs.contains("3 to 4"), "{last_differs}");
        assert!(keys(&["1 to 2", "3 to 4"]).contains("3 to 4"));
        assert!(keys(&["1 to 2"]).contains("1 to 2"));
    }

    #[test]
    fn a_distribution_is_drawn_where_most_runs_are_and_a_near_limit_is() {
        let even = Vec::from_iter((0..=100).map(f64::from));
        let with_outlier = [&even[..], &[10_000.0]].concat();
        let all_but_one_same = [&[0.0; 200][..], &[100.0]].concat();
        for (sorted, max, (from, until)) in [
            (&even, None, (-2.0, 102.0)),
            (&even, Some(150.0), (-3.0, 153.0)),
            (&even, Some(400.0), (-2.0, 102.0)),
            (&with_outlier, None, (-2.99, 152.49)),
            (&all_but_one_same, None, (-2.0, 102.0)),
        ] {
            let shown = shown_range(&spread(max, sorted));
            let is_near = (shown.0 - from).abs() < 1e-9 && (shown.1 - until).abs() < 1e-9;
            assert!(is_near, "{shown:?} is not {from} to {until}");
        }
        let drawn = drawn(&spread(None, &with_outlier)).into_string();
        for text in [">overshoot_percent</p>", "1 outlier (0 to "] {
            assert!(drawn.contains(text), "{text}: {drawn}");
        }
    }
}
