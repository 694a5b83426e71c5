//! A page that compares several runs.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use maud::{Markup, html};

use super::Run;
use super::page;
use super::plot::{Colour, Plot, Shape};
use super::terminal;
use dbc::Quantities;
use judge::verdict::{Metric, Outcome};
use recording::timeline::Timeline;
use scenario::metrics::{METRICS, without_loop};
use scenario::reference::Reference;

/// Largest number of runs whose positions share a plot; more cannot be distinguished.
const RUNS_IN_A_PLOT: usize = 7;
/// Largest number of plots on the page; runs that do not pass come first.
const PLOTS_MAX: usize = 40;
/// Largest number of metrics side by side in one table; a wider table would exceed a screen of 1300 pixels.
const COLUMNS_MAX: usize = 8;
/// Largest number of metrics in the first table, which also describes the runs.
const FIRST_COLUMNS_MAX: usize = 6;

/// Run on the page.
pub struct ListedRun<'a> {
    /// Name of the run's folder.
    pub folder: String,
    /// Path to the page of the run.
    pub page: Option<String>,
    /// The run itself, with the date of its play.
    pub judged: Run<'a>,
}

impl ListedRun<'_> {
    fn scenario(&self) -> &str {
        &self.judged.verdict.scenario
    }

    fn metric(&self, name: &str) -> Option<&Metric> {
        let mut metrics = self.judged.verdict.metrics.iter();
        metrics.find(|metric| metric.name == name)
    }

    fn limits(&self, name: &str) -> bool {
        let metric = self.metric(name);
        metric.is_some_and(|metric| metric.limit.is_some())
    }

    /// Returns the course of each loop.
    fn courses(&self, number: usize) -> impl Iterator<Item = Course<'_>> {
        self.judged.loops().map(move |one| Course {
            run: self,
            number,
            timeline: one.timeline,
            reference: &one.control_loop.trial.reference,
        })
    }

    /// Returns the rows of the verdict that are no metrics but checks of the scenario, with their names in words.
    fn checks(&self) -> impl Iterator<Item = &Metric> {
        let metrics = self.judged.verdict.metrics.iter();
        metrics.filter(|metric| !is_key(&metric.name))
    }
}

/// Course of one loop of a run.
struct Course<'a> {
    run: &'a ListedRun<'a>,
    /// The number of the run on the page.
    number: usize,
    timeline: &'a Timeline,
    reference: &'a Reference,
}

/// Returns whether a row of a verdict is a metric, which other runs have, too.
fn is_key(name: &str) -> bool {
    !name.contains(' ')
}

/// Returns the page.
pub fn to_html(runs: &[ListedRun<'_>]) -> String {
    let passed = runs
        .iter()
        .filter(|run| run.judged.verdict.outcome == Outcome::Pass)
        .count();
    let title = format!("{passed} of {} runs passed", runs.len());
    let mut runs = Vec::from_iter(runs);
    runs.sort_by_key(|run| Reverse(run.judged.verdict.outcome));
    let runs = &runs[..];
    let (limited, others) = columns(runs);
    let (first, further) = most_limited(&limited, runs);
    let groups = by_set_point(runs);
    let plots = groups.iter().flat_map(|group| group.chunks(RUNS_IN_A_PLOT));
    let left_out = plots.clone().skip(PLOTS_MAX).map(<[_]>::len).sum::<usize>();
    let body = html! {
        h1 { (title) }
        (table(runs, &first, true))
        p.soft { "Below each value stands its limit. ✗ marks a limit that is not met." }
        @for few in further.chunks(COLUMNS_MAX) { (table(runs, few, false)) }
        @if !others.is_empty() { details.of-listed {
            summary { "Metrics without a limit" }
            @for few in others.chunks(COLUMNS_MAX) { (table(runs, few, false)) }
        } }
        (checks(runs))
        section.of-listed {
            h2 { (heading(&groups)) }
            div.plots.even { @for few in plots.take(PLOTS_MAX) { div data-runs=(numbers(few)) { (positions(few)) } } }
        }
        @if left_out > 0 { p.soft { (left_out) " more courses are not drawn here; the page of each run has its own." } }
    };
    page::page(&title, &body)
}

/// Returns the metrics that any run limits, then those of which any has a value, each in the order of verdicts.
fn columns<'a>(runs: &[&'a ListedRun<'_>]) -> (Vec<&'a str>, Vec<&'a str>) {
    let metrics = runs.iter().flat_map(|run| &run.judged.verdict.metrics);
    let known = metrics.filter(|metric| metric.value.is_some() || metric.limit.is_some());
    let each: BTreeSet<&str> = known
        .map(|metric| metric.name.as_str())
        .filter(|name| is_key(name))
        .collect();
    let mut names: Vec<&str> = each.into_iter().collect();
    let place = |name: &str| {
        let (row, shipped) = (without_loop(name), Quantities::default());
        METRICS
            .iter()
            .position(|metric| shipped.name(metric.name) == row)
    };
    names.sort_by_key(|name| place(name).unwrap_or(usize::MAX));
    let is_limited = |name: &&str| runs.iter().any(|run| run.limits(name));
    names.into_iter().partition(is_limited)
}

/// Returns the metrics that most runs limit, for the first table, and the others; each in the same order as before.
fn most_limited<'a>(names: &[&'a str], runs: &[&ListedRun<'_>]) -> (Vec<&'a str>, Vec<&'a str>) {
    let count = |name: &&str| runs.iter().filter(|run| run.limits(name)).count();
    let mut by_count = names.to_vec();
    by_count.sort_by_cached_key(|name| Reverse(count(name)));
    by_count.truncate(FIRST_COLUMNS_MAX);
    names.iter().partition(|name| by_count.contains(name))
}

/// Returns a table with one row for each run and one column for each metric. Unless it must have every run, runs without any of
/// its metrics are left out.
fn table(runs: &[&ListedRun<'_>], names: &[&str], has_every_run: bool) -> Markup {
    let is_listed = |(_, run): &(usize, &&ListedRun<'_>)| {
        has_every_run || names.iter().any(|name| run.metric(name).is_some())
    };
    html! {
        div.wide { table.stacked.listed {
            thead { tr {
                th { "scenario" } th { "result" }
                @if has_every_run { th { "played" } }
                @for name in names { th.number { (page::name(name)) } }
            } }
            tbody { @for (number, run) in runs.iter().enumerate().filter(is_listed) { tr data-run=(number) data-outcome=(page::word(run.judged.verdict.outcome)) {
                td.name { (linked(run, runs)) }
                (result(run))
                @if has_every_run { td.nowrap data-name="played" { div {
                    (run.judged.played.unwrap_or_default())
                    div.soft { (run.judged.plan.shared.run.duration_seconds) " s" @if let Some(clock) = run.judged.frames.clock() { " in " (page::time_by(clock)) } }
                } } }
                @for name in names { (cell(run, name)) }
            } } }
        } }
    }
}

/// Returns a table of the scenarios' checks, one row each.
fn checks(runs: &[&ListedRun<'_>]) -> Markup {
    html! { @if runs.iter().any(|run| run.checks().next().is_some()) { section.of-listed {
        h2 { "Checks of signals and sequences" }
        div.wide { table.stacked.listed {
            thead { tr { th { "scenario" } th { "check" } th.number { "measured" } th.number { "limit" } th { "result" } } }
            tbody { @for run in runs { @for check in run.checks() { tr data-outcome=(page::word(run.judged.verdict.outcome)) {
                td.name { (linked(run, runs)) }
                td.words data-name="check" { (page::name(&check.name)) }
                td.number data-name="measured" { (terminal::measured(check)) }
                td.number data-name="limit" { (terminal::limit(&check.name, check.limit)) }
                td data-name="result" { (page::result(check, run.judged.verdict.outcome)) }
            } } } }
        } }
    } } }
}

/// Returns the scenario with the link to the run's page, and the folder if several runs are of this scenario.
fn linked(run: &ListedRun<'_>, runs: &[&ListedRun<'_>]) -> Markup {
    html! { div {
        @match &run.page { Some(page) => a href=(page) { (run.scenario()) }, None => (run.scenario()) }
        @for set in run.judged.set { div.soft { (page::set(set)) } }
        @if !is_alone(run, runs.iter().copied()) { div.soft { (run.folder) } }
    } }
}

/// Returns whether no other run is of the same scenario.
fn is_alone<'a>(run: &ListedRun<'_>, mut runs: impl Iterator<Item = &'a ListedRun<'a>>) -> bool {
    runs.all(|other| other.folder == run.folder || other.scenario() != run.scenario())
}

fn result(run: &ListedRun<'_>) -> Markup {
    let outcome = run.judged.verdict.outcome;
    html! { td data-name="result" { span.(page::class(outcome)) { (page::word(outcome)) } } }
}

fn cell(run: &ListedRun<'_>, name: &str) -> Markup {
    html! { @match run.metric(name) {
        Some(metric) => td.number data-name=(name) {
            div {
                span.fail[metric.passed == Some(false)] { @if metric.passed == Some(false) { "✗ " } (terminal::measured(metric)) }
                @if metric.limit.is_some() { div.soft { (terminal::limit(name, metric.limit)) } }
            }
        },
        None => td.number.soft.none { "–" },
    } }
}

/// Groups the loops of runs with the same reference, which share a plot.
fn by_set_point<'a>(runs: &[&'a ListedRun<'_>]) -> Vec<Vec<Course<'a>>> {
    let mut groups: Vec<Vec<Course<'_>>> = Vec::new();
    let numbered = runs.iter().enumerate();
    for course in numbered.flat_map(|(number, run)| run.courses(number)) {
        let is_alike = |other: &Course<'_>| {
            other.timeline.loop_name == course.timeline.loop_name
                && other.timeline.quantities == course.timeline.quantities
                && other.reference == course.reference
        };
        match groups.iter_mut().find(|group| is_alike(&group[0])) {
            Some(group) => group.push(course),
            None => groups.push(vec![course]),
        }
    }
    groups
}

/// Returns the quantities of all loops, if it is the same.
fn heading(groups: &[Vec<Course<'_>>]) -> String {
    let courses = groups.iter().flatten();
    let mut titles = courses.map(|course| course.timeline.quantities.feedback.title());
    let first = titles.next().unwrap_or_default();
    if titles.all(|title| title == first) {
        first
    } else {
        "Courses".to_owned()
    }
}

/// Returns the numbers of the runs that a plot shows, for the filter.
fn numbers(courses: &[Course<'_>]) -> String {
    let numbers = courses.iter().map(|course| course.number.to_string());
    Vec::from_iter(numbers).join(" ")
}

fn positions(courses: &[Course<'_>]) -> Markup {
    let first = &courses[0];
    let runs = || courses.iter().map(|course| course.run);
    let is_one_scenario = runs().all(|run| run.scenario() == first.run.scenario());
    let title = if is_one_scenario {
        first.run.scenario().to_owned()
    } else {
        first.timeline.quantities.feedback.title()
    };
    let title = match first.timeline.loop_name.as_str() {
        "" => title,
        name => format!("{title}: {name}"),
    };
    let mut plot = Plot::over_time(title, first.timeline.quantities.feedback.unit.symbol());
    for (number, Course { run, timeline, .. }) in courses.iter().enumerate() {
        let name = if is_alone(run, runs()) {
            run.scenario()
        } else {
            &run.folder
        };
        let (colour, times) = (Colour::Run(number), &timeline.time_seconds);
        plot.draw(name, colour, Shape::Line, times, timeline.position());
    }
    let (times, set_point) = (&first.timeline.time_seconds, first.timeline.set_point());
    plot.draw("set-point", Colour::Wanted, Shape::Dashed, times, set_point);
    plot.render()
}
