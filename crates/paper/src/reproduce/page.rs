//! The page of `canrig reproduce`: every figure redrawn, every number next to the paper's and its target.

use maud::{Markup, html};

use super::experiment::{ExperimentResult, NumberTable};
use super::quantity::{Model, Quantity};
use judge::verdict::Outcome;
use report::page;
use report::table::{Cell, Table, Text};
use report::terminal::{self, limit, measured};

/// Introduction for the reader.
const PREAMBLE: &str = "Experiments of Romano and Tannuri, \"New development on shape memory alloys actuators\", played on the emulated \
    actuator in virtual time: controller and plant exchange CAN frames in cycles of 1 ms with one cycle of delay, and every number is read from the \
    recording of that bus. The position is measured by a 10-bit converter over 60 mm, without noise where none is named. Where the paper gives no value \
    (Young's moduli, inertia, damping, span of the sensor) it is assumed. The controller's model has the paper's identified values. So has the plant, where none is named: \
    such rows say that the model equals the plant, number for number, and what they show is how well a law does that knows everything. Beside each of them \
    stands our law on another plant, drawn at random, of which it knows nothing.";

/// Returns the page.
pub(crate) fn to_html(is_reduced: bool, results: &[ExperimentResult]) -> String {
    let numbers = results.iter().flat_map(|one| &one.evaluation.numbers);
    let passed = Vec::from_iter(numbers.filter_map(|number| number.metric.passed));
    let judged = passed.len();
    let met = passed.into_iter().filter(|is_met| *is_met).count();
    let runs: usize = results
        .iter()
        .map(|result| result.experiment.runs.len())
        .sum();
    let title = format!("The paper, reproduced: {met} of {judged} targets met");
    let outcome = if met == judged {
        Outcome::Pass
    } else {
        Outcome::Fail
    };
    let body = html! {
        h1 { (title) }
        p { (page::badge(outcome)) }
        p.soft { (PREAMBLE) }
        @if is_reduced { p.unsure { "Reduced: fewer plants, frequencies and settings." } }
        dl.facts {
            div { dt { "experiments" } dd { (results.len()) } }
            div { dt { "runs" } dd { (runs) } }
            div { dt { "canrig" } dd { (env!("CARGO_PKG_VERSION")) } }
        }
        h2 { "Targets" }
        (summary(results))
        @for result in results { (section(result)) }
    };
    page::page(&title, &body)
}

/// Returns the numbers of a reproduction that have a value in the paper or a target.
pub(crate) fn to_text(results: &[ExperimentResult]) -> Text {
    let header = [
        "experiment",
        "quantity",
        "of",
        "model",
        "paper",
        "target",
        "measured",
        "result",
    ];
    let mut table = Table::new(header);
    for result in results {
        for number in result.headline() {
            table.add([
                Cell::new(result.experiment.id),
                Cell::new(number.name()),
                Cell::new(&number.of),
                Cell::new(number.model.map_or("", Model::word)),
                Cell::new(number.paper.unwrap_or_default()),
                Cell::new(limit(number.name(), number.metric.limit)),
                Cell::number(measured(&number.metric)),
                terminal::result(&number.metric, Outcome::Pass),
            ]);
        }
    }
    let holds = results.iter().all(ExperimentResult::holds);
    let outcome = if holds { Outcome::Pass } else { Outcome::Fail };
    let mut text = Text::default();
    text.table(&table);
    text.line(outcome.word());
    text
}

fn summary(results: &[ExperimentResult]) -> Markup {
    html! {
        div.wide { table.stacked {
            thead { tr { th { "experiment" } (head()) } }
            tbody { @for result in results {
                @let headline = result.headline();
                @for (place, number) in headline.iter().enumerate() { tr {
                    @if place == 0 {
                        td.name rowspan=(headline.len()) { a href=(format!("#{}", result.experiment.id)) { (result.experiment.title) } }
                    }
                    (cells(number))
                } }
            } }
        } }
    }
}

fn section(result: &ExperimentResult) -> Markup {
    let (experiment, evaluation) = (&result.experiment, &result.evaluation);
    html! {
        h2 id=(experiment.id) { (experiment.title) }
        p { (experiment.text) }
        @for table in &evaluation.tables { (plain(table)) }
        @if !evaluation.numbers.is_empty() {
            div.wide { table.stacked {
                thead { tr { (head()) } }
                tbody { @for number in &evaluation.numbers { tr { (cells(number)) } } }
            } }
        }
        @if !evaluation.figures.is_empty() {
            div.plots.even { @for figure in &evaluation.figures { (figure.render()) } }
        }
    }
}

fn head() -> Markup {
    html! { th { "quantity" } th { "of" } th { "model" } th.number { "paper" } th.number { "target" } th.number { "measured" } th { "result" } }
}

fn cells(number: &Quantity) -> Markup {
    html! {
        td.name { (page::name(number.name())) }
        td data-name="of" { (number.of) }
        td.none[number.model.is_none()] data-name="model" { (number.model.map_or("", Model::word)) }
        td.number data-name="paper" { (number.paper.unwrap_or("–")) }
        td.number data-name="target" { @if number.metric.limit.is_some() { (limit(number.name(), number.metric.limit)) } @else { "–" } }
        td.number data-name="measured" { (measured(&number.metric)) }
        td data-name="result" { (page::result(&number.metric, Outcome::Pass)) }
    }
}

fn plain(table: &NumberTable) -> Markup {
    html! {
        div.wide { table.stacked {
            thead { tr { @for (place, head) in table.header.iter().enumerate() { th.number[place > 0] { (head) } } } }
            tbody { @for row in &table.rows { tr {
                @for (place, (cell, head)) in row.iter().zip(&table.header).enumerate() {
                    @if place == 0 { td.name { (cell) } } @else { td.number data-name=(head) { (cell) } }
                }
            } } }
        } }
    }
}
