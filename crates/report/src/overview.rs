//! A page that compares several runs.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::page;
use super::plot::{Colour, Plot, Shape};
use super::terminal;
use judge::verdict::Verdict;
use recording::timeline::Timeline;

/// Runs whose positions are laid over each other in one plot; with more they cannot be told apart.
const RUNS_IN_A_PLOT: usize = 7;

/// One of the runs.
pub struct ListedRun<'a> {
    /// What it is called on the page.
    pub name: String,
    /// The way to its own page.
    pub page: Option<String>,
    /// What was on the bus.
    pub timeline: &'a Timeline,
    /// What it came to.
    pub verdict: &'a Verdict,
}

/// The page.
#[must_use]
pub fn to_html(runs: &[ListedRun<'_>]) -> String {
    let passed = runs
        .iter()
        .filter(|run| run.verdict.outcome == judge::verdict::Outcome::Pass)
        .count();
    let title = format!("{passed} of {} runs passed", runs.len());
    let body = html! {
        h1 { (title) }
        (table(runs))
        h2 { "Position" }
        div.plots.even { @for group in by_set_point(runs) { @for few in group.chunks(RUNS_IN_A_PLOT) { (positions(few)) } } }
    };
    page::page(&title, &body)
}

/// One row a run, one column a metric.
fn table(runs: &[ListedRun<'_>]) -> Markup {
    let mut names: Vec<&str> = Vec::new();
    let mut seen = BTreeSet::new();
    for metric in runs.iter().flat_map(|run| &run.verdict.metrics) {
        if seen.insert(metric.name.as_str()) {
            names.push(metric.name.as_str());
        }
    }
    html! {
        div.wide { table {
            thead { tr {
                th { "run" } th { "result" }
                @for name in &names { th.number { (page::name(name)) } }
            } }
            tbody { @for run in runs { tr {
                td.name { @match &run.page { Some(page) => a href=(page) { (run.name) }, None => (run.name) } }
                td { span.(page::class(run.verdict.outcome)) { (run.verdict.outcome.word()) } }
                @for name in &names { (cell(run.verdict, name)) }
            } } }
        } }
        p.soft { "Red: a limit was not met." }
    }
}

fn cell(verdict: &Verdict, name: &str) -> Markup {
    let metric = verdict.metrics.iter().find(|metric| metric.name == name);
    html! { @match metric {
        Some(metric) => td.number.fail[metric.passed == Some(false)] title=(terminal::limit(name, metric.limit)) { (terminal::measured(metric)) },
        None => td.number.soft { "–" },
    } }
}

/// Runs with the same set-point belong in one plot.
fn by_set_point<'a, 'b>(runs: &'b [ListedRun<'a>]) -> Vec<Vec<&'b ListedRun<'a>>> {
    let mut groups: Vec<Vec<&ListedRun<'_>>> = Vec::new();
    for run in runs {
        let wanted = groups
            .iter_mut()
            .find(|group| has_same_set_point(group[0].timeline, run.timeline));
        match wanted {
            Some(group) => group.push(run),
            None => groups.push(vec![run]),
        }
    }
    groups
}

fn has_same_set_point(a: &Timeline, b: &Timeline) -> bool {
    let ahead = |timeline: &Timeline| timeline.cycle.last().copied();
    // Runs of one scenario may lack other cycles, so a few instants of the shorter one are compared.
    let last = ahead(a).min(ahead(b)).unwrap_or(0);
    let at = |timeline: &Timeline, cycle: u64| {
        let row = timeline.cycle.partition_point(|number| *number < cycle);
        timeline
            .set_point_millimetres
            .get(row)
            .copied()
            .unwrap_or(f64::NAN)
    };
    (0..=50).map(|part| last * part / 50).all(|cycle| {
        let (a, b) = (at(a, cycle), at(b, cycle));
        (a - b).abs() < 1e-6 || (a.is_nan() && b.is_nan())
    })
}

fn positions(runs: &[&ListedRun<'_>]) -> Markup {
    let mut plot = Plot::over_time(runs[0].verdict.scenario.as_str(), "mm");
    for (number, run) in runs.iter().enumerate() {
        plot.draw(
            run.name.as_str(),
            Colour::Run(number),
            Shape::Line,
            &run.timeline.time_seconds,
            run.timeline.position(),
        );
    }
    let first = runs[0].timeline;
    plot.draw(
        "set-point",
        Colour::Wanted,
        Shape::Dashed,
        &first.time_seconds,
        &first.set_point_millimetres,
    );
    plot.render()
}
