//! The matrix of requirements and scenarios: as a table for the terminal and as a page.

use std::collections::BTreeSet;
use std::path::Path;

use comfy_table::{Cell, Color};
use maud::{Markup, html};

use super::matrix::{Requirement, RequirementTest};
use judge::verdict::Outcome;
use report::{page, terminal};

/// What is said of a requirement that nothing tests.
const NEVER_TESTED: &str = "never tested";

/// One line a requirement and scenario, then how many there are of each kind.
#[must_use]
pub(super) fn to_text(requirements: &[Requirement]) -> String {
    let mut table = terminal::empty_table(["requirement", "scenario", "tested by", "result"]);
    for requirement in requirements {
        let name = name(requirement);
        if requirement.tests.is_empty() {
            let result = Cell::new(NEVER_TESTED).fg(Color::Red);
            table.add_row([Cell::new(name), Cell::new(""), Cell::new(""), result]);
            continue;
        }
        for (place, test) in requirement.tests.iter().enumerate() {
            let name = if place == 0 { name.as_str() } else { "" };
            table.add_row([
                Cell::new(name),
                Cell::new(&test.scenario),
                Cell::new(tested_by(test)),
                result(test.outcome),
            ]);
        }
    }
    format!("{table}\n{}", summary(requirements))
}

/// The page. `page_of` gives the way to the page of a run.
#[must_use]
pub(super) fn to_html(
    requirements: &[Requirement],
    page_of: impl Fn(&Path) -> Option<String>,
) -> String {
    let tests = requirements.iter().flat_map(|one| &one.tests);
    let scenarios: BTreeSet<&str> = tests.map(|test| test.scenario.as_str()).collect();
    let body = html! {
        h1 { "Requirements" }
        p { (summary(requirements)) }
        div.wide { table {
            thead { tr {
                th { "requirement" } th { "result" }
                @for scenario in &scenarios { th { (scenario) } }
            } }
            tbody { @for requirement in requirements { tr {
                td.name { (requirement.id) (remark(requirement)) }
                td { (overall(requirement)) }
                @for scenario in &scenarios { td { (cell(requirement, scenario, &page_of)) } }
            } } }
        } }
        p.soft { "Of several runs of a scenario, and of several rows of its verdict, the worst counts. Each result leads to its run." }
    };
    page::page("Requirements", &body)
}

fn name(requirement: &Requirement) -> String {
    let text = (requirement.text.as_deref())
        .map(|text| format!(" {text}"))
        .unwrap_or_default();
    match requirement.is_listed {
        true => format!("{}{text}", requirement.id),
        false => format!("{} (not in the list)", requirement.id),
    }
}

fn remark(requirement: &Requirement) -> Markup {
    html! {
        @if let Some(text) = &requirement.text { div.soft { (text) } }
        @if !requirement.is_listed { div.unsure { "not in the list" } }
    }
}

/// The rows that count, and how many runs there are.
fn tested_by(test: &RequirementTest) -> String {
    let rows = match test.rows.as_slice() {
        [] => "all limits".to_owned(),
        rows => rows.join("\n"),
    };
    match test.runs {
        1 => rows,
        runs => format!("{rows}\n(the worst of {runs} runs)"),
    }
}

fn result(outcome: Outcome) -> Cell {
    let colour = match outcome {
        Outcome::Pass => Color::Green,
        Outcome::Fail => Color::Red,
        Outcome::Inconclusive | Outcome::Incomplete => Color::Yellow,
    };
    Cell::new(outcome.word()).fg(colour)
}

fn overall(requirement: &Requirement) -> Markup {
    html! { @match requirement.outcome() {
        Some(outcome) => span.(page::class(outcome)) { (outcome.word()) },
        None => span.fail { (NEVER_TESTED) },
    } }
}

fn cell(
    requirement: &Requirement,
    scenario: &str,
    page_of: impl Fn(&Path) -> Option<String>,
) -> Markup {
    let test = requirement
        .tests
        .iter()
        .find(|test| test.scenario == scenario);
    html! { @if let Some(test) = test {
        @let word = html! { span.(page::class(test.outcome)) { (test.outcome.word()) } };
        @match page_of(&test.run) {
            Some(page) => a href=(page) title=(tested_by(test)) { (word) },
            None => span title=(tested_by(test)) { (word) },
        }
    } }
}

fn summary(requirements: &[Requirement]) -> String {
    let count = |outcome: Option<Outcome>| {
        let same = requirements.iter().filter(|one| one.outcome() == outcome);
        same.count()
    };
    let kinds = [
        (Some(Outcome::Pass), "met"),
        (Some(Outcome::Fail), "failed"),
        (Some(Outcome::Incomplete), "incomplete"),
        (Some(Outcome::Inconclusive), "inconclusive"),
        (None, NEVER_TESTED),
    ];
    let counts: Vec<String> = kinds
        .map(|(outcome, words)| (count(outcome), words))
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, words)| format!("{count} {words}"))
        .collect();
    match requirements.len() {
        0 => "no scenario names a requirement".to_owned(),
        1 => format!("1 requirement: {}", counts.join(", ")),
        total => format!("{total} requirements: {}", counts.join(", ")),
    }
}
