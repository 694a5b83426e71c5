//! The matrix of requirements and scenarios: as a table for the terminal and as a page.

use std::collections::BTreeSet;
use std::path::Path;

use maud::{Markup, html};

use super::matrix::{Requirement, RequirementTest};
use judge::verdict::Outcome;
use report::table::{Cell, Table, Text};
use report::{page, terminal};

/// Result of a requirement without tests.
const NEVER_TESTED: &str = "never tested";

/// Result of a test that judges no limit.
const NOT_COVERED: &str = "not covered";

/// Returns one line for each requirement and scenario, then the number of each kind.
pub(super) fn to_text(requirements: &[Requirement]) -> Text {
    let mut table = Table::new(["requirement", "scenario", "tested by", "played", "result"]);
    for requirement in requirements {
        let name = name(requirement);
        if requirement.tests.is_empty() {
            let result = Cell::new(NEVER_TESTED).bad();
            let [scenario, tested_by, played] = [(); 3].map(|()| Cell::new(""));
            table.add([Cell::new(name), scenario, tested_by, played, result]);
            continue;
        }
        for (place, test) in requirement.tests.iter().enumerate() {
            let name = if place == 0 { name.as_str() } else { "" };
            table.add([
                Cell::new(name),
                Cell::new(&test.scenario),
                Cell::new(tested_by(test)),
                Cell::new(played(test, "\n")),
                match test.outcome {
                    Some(outcome) => terminal::outcome(outcome),
                    None => Cell::new(NOT_COVERED).bad(),
                },
            ]);
        }
    }
    let mut text = Text::default();
    text.table(&table);
    text.line(summary(requirements));
    text
}

/// Returns the page. `page_of` gives the path to the page of a run.
pub(super) fn to_html(
    requirements: &[Requirement],
    page_of: impl Fn(&Path) -> Option<String>,
) -> String {
    let tests = requirements.iter().flat_map(|one| &one.tests);
    let scenarios: BTreeSet<&str> = tests.map(|test| test.scenario.as_str()).collect();
    let body = html! {
        h1 { "Requirements" }
        p { (summary(requirements)) }
        div.wide { table.stacked {
            thead { tr {
                th { "requirement" } th { "result" }
                @for scenario in &scenarios { th { (scenario) } }
            } }
            tbody { @for requirement in requirements { tr {
                td.name { (requirement.id) (remark(requirement)) }
                td.nowrap data-name="result" { (overall(requirement)) }
                @for scenario in &scenarios {
                    @let tested = cell(requirement, scenario, &page_of);
                    td.words.none[tested.is_none()] data-name=(scenario) { (tested.unwrap_or_default()) }
                }
            } } }
        } }
        p.soft { "Of several plays of a scenario the latest counts, of a sweep its worst run, and of several rows of a verdict the worst. Each result leads to its run." }
    };
    page::page("Requirements", &body)
}

fn name(requirement: &Requirement) -> String {
    let id = &requirement.id;
    match &requirement.text {
        // Only the list has texts.
        Some(text) => format!("{id} {text}"),
        None if requirement.is_listed => id.clone(),
        None => format!("{id} (not in the list)"),
    }
}

fn remark(requirement: &Requirement) -> Markup {
    html! {
        @if let Some(text) = &requirement.text { div.soft { (text) } }
        @if !requirement.is_listed { div.unsure { "not in the list" } }
    }
}

/// Returns the rows that count, and the runs of the sweep that decide.
fn tested_by(test: &RequirementTest) -> String {
    let rows = match (test.uncovered, test.rows.as_slice()) {
        (Some(why), _) => why.to_owned(),
        (None, []) => "all limits".to_owned(),
        (None, rows) => rows.join("\n"),
    };
    match runs_of_sweep(test) {
        None => rows,
        Some(runs) => format!("{rows}\n({runs})"),
    }
}

/// Returns a text on the runs of a sweep that count; `None` for a single run.
fn runs_of_sweep(test: &RequirementTest) -> Option<String> {
    Some(match (test.sweep_runs?, test.case) {
        (runs, Some(case)) => format!("the worst of {runs} runs: case {case}"),
        (runs, None) if test.outcome.is_none_or(|one| one == Outcome::Pass) => {
            format!("all {runs} runs")
        }
        (_, None) => "not all runs of the sweep were played".to_owned(),
    })
}

/// Returns a row with its value and its limit.
fn measured(test: &RequirementTest, row: &str) -> Markup {
    html! {
        (page::name(row))
        @if let Some((value, limit)) = test.measured.get(row) { ": " (terminal::with_limit(value, limit)) }
    }
}

/// Returns the date and the program of the play that counts.
fn played(test: &RequirementTest, between: &str) -> String {
    let at = match test.played_at {
        Some(at) => at.strftime("%Y-%m-%d %H:%M UTC").to_string(),
        None => "no date".to_owned(),
    };
    let version = test.version.as_deref();
    let program = version.map(|version| format!("canrig {version}"));
    let plays = (test.plays > 1).then(|| format!("(the latest of {})", test.plays));
    let parts = [Some(at), program, plays].into_iter().flatten();
    parts.collect::<Vec<_>>().join(between)
}

fn overall(requirement: &Requirement) -> Markup {
    html! { @match requirement.outcome() {
        Some(outcome) => span.(page::class(outcome)) { (page::word(outcome)) },
        None if requirement.tests.is_empty() => span.fail { (NEVER_TESTED) },
        None => span.fail { (NOT_COVERED) },
    } }
}

fn cell(
    requirement: &Requirement,
    scenario: &str,
    page_of: impl Fn(&Path) -> Option<String>,
) -> Option<Markup> {
    let mut tests = requirement.tests.iter();
    let test = tests.find(|test| test.scenario == scenario)?;
    Some(html! { div {
        @let word = html! { @match test.outcome {
            Some(outcome) => span.(page::class(outcome)) { (page::word(outcome)) },
            None => span.fail { (NOT_COVERED) },
        } };
        @match page_of(&test.run) {
            Some(page) => a href=(page) title=(tested_by(test)) { (word) },
            None => span title=(tested_by(test)) { (word) },
        }
        @for row in &test.rows { div { (measured(test, row)) } }
        @if test.rows.is_empty() { div { (test.uncovered.unwrap_or("all limits")) } }
        @if let Some(runs) = runs_of_sweep(test) { div.soft { (runs) } }
        div.soft { (played(test, " ")) }
    } })
}

fn summary(requirements: &[Requirement]) -> String {
    let kind = |one: &Requirement| match one.outcome() {
        Some(Outcome::Pass) => "met",
        Some(Outcome::Fail) => "failed",
        Some(Outcome::Incomplete) => "incomplete",
        Some(Outcome::Inconclusive) => "inconclusive",
        None if one.tests.is_empty() => NEVER_TESTED,
        None => NOT_COVERED,
    };
    let kinds = [
        "met",
        "failed",
        "incomplete",
        "inconclusive",
        NOT_COVERED,
        NEVER_TESTED,
    ];
    let count = |name| requirements.iter().filter(|one| kind(one) == name).count();
    let counted = kinds.map(|name| (count(name), name));
    let found = counted.iter().filter(|(count, _)| *count > 0);
    let counts = Vec::from_iter(found.map(|(count, name)| format!("{count} {name}")));
    match requirements.len() {
        0 => "no scenario names a requirement".to_owned(),
        1 => format!("1 requirement: {}", counts.join(", ")),
        total => format!("{total} requirements: {}", counts.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_counts_the_requirements() {
        let never = Requirement::new("REQ-1".to_owned(), true);
        for (requirements, expected) in [
            (vec![], "no scenario names a requirement"),
            (vec![never.clone()], "1 requirement: 1 never tested"),
            (vec![never; 2], "2 requirements: 2 never tested"),
        ] {
            assert_eq!(summary(&requirements), expected);
        }
    }
}
