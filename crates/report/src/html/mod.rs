//! `report.html`: one run on one page.
//!
//! The head, the verdict, `signals`, the `response` to chirps, `checks`, `bus`, the events, the scenario, and how to make it again.

mod bus;
mod checks;
mod contour;
mod response;
mod signals;

use dbc::SignalMissing;
use maud::{Markup, html};

use crate::page;
use crate::run::{Run, RunLoop};
use judge::verdict::Verdict;
use recording::events::{Events, Level};
use recording::run_folder::file;
use recording::timeline::{Timeline, events_of};
use scenario::node::Part;

/// Events that are listed; a run with more of them has one cause, which the first ones show.
const EVENTS_MAX: usize = 300;

/// The page of a run. It depends on nothing but the recording and the verdict; `remarks` say what of the log cannot be read.
///
/// # Errors
/// The database lacks a signal that the bench needs.
pub fn to_html(run: &Run<'_>, remarks: &[String]) -> Result<String, SignalMissing> {
    let (shared, verdict) = (&run.plan.shared, run.verdict);
    let body = html! {
        (head(run, remarks))
        h2 { "Verdict" }
        @if verdict.metrics.is_empty() { p.soft { "Nothing was judged." } }
        @else { (page::metrics(&verdict.metrics, verdict.outcome)) }
        @for contour in &shared.contours { (contour::section(contour, run)) }
        @for one in run.loops() { (of_loop(&one)) }
        (bus::section(run)?)
        (events(&events_of(run.timelines)))
        h2 { "Scenario" }
        details open { summary { (file::SCENARIO) } pre { (shared.text) } }
        @for (name, text) in shared.tables.iter().filter(|(name, _)| name.ends_with(".toml")) {
            details { summary { (name) } pre { (text) } }
        }
        (again(run.is_long))
    };
    Ok(page::page(
        &format!("{}: {}", shared.run.name, verdict.outcome.word()),
        &body,
    ))
}

/// What a loop did.
fn of_loop(run: &RunLoop<'_>) -> Markup {
    html! {
        @if let Some(name) = run.own.loop_name() { h2 { "Loop " (name) } }
        @if run.timeline.cycle.is_empty() { p { "The scenario never began, so there is nothing to plot." } }
        @else { (signals::section(run)) }
        (response::section(run))
        (checks::section(run))
    }
}

/// The heading of a part of that.
fn heading(run: &RunLoop<'_>, text: &str) -> Markup {
    match run.own.loop_name() {
        None => html! { h2 { (text) } },
        Some(_) => html! { h3 { (text) } },
    }
}

fn head(run: &Run<'_>, remarks: &[String]) -> Markup {
    let (shared, verdict) = (&run.plan.shared, run.verdict);
    let is_external = |one: RunLoop<'_>| one.own.is_external(Part::Drive);
    html! {
        h1 { (shared.run.name) }
        p { (page::badge(verdict.outcome)) }
        @if let Some(remark) = verdict.remark() { p { (remark) } }
        @if let Some(cause) = cause_besides(verdict) { p { (cause) } }
        @if let Some(end) = end_besides(verdict) { p { (end) } }
        @for remark in remarks { p.unsure { "Of the recording as it is now, " (remark) ". This page shows the other frames." } }
        @if let Some(description) = &shared.run.description { p.soft { (description) } }
        dl.facts {
            div { dt { "control law" } dd { (laws(run)) } }
            div { dt { "recorded" } dd { (recorded(run)) } }
            div { dt { "cycle" } dd { (shared.run.bus.sync_period_milliseconds) " ms" } }
            div { dt { "bus" } dd { (shared.run.bus.bitrate_kilobits_per_second) " kbit/s" } }
            div { dt { "frames" } dd { (run.frames.len()) } }
            div { dt { "seed" } dd { (verdict.seed) } }
            div { dt { "canrig" } dd { (verdict.version) } }
            @if !verdict.requirements.is_empty() { div { dt { "requirements" } dd { (verdict.requirements.join(", ")) } } }
            @if !verdict.external.is_empty() { div { dt { "external" } dd { (verdict.external.join(", ")) } } }
        }
        @if run.loops().any(is_external) {
            p.soft { "Wire temperature, martensite fraction and true position are not available: the drive is external, and only the emulator knows them." }
        }
    }
}

/// The law of all loops, or that of each.
fn laws(run: &Run<'_>) -> String {
    let laws = run.loops().filter_map(|one| Some((one, law_of(&one)?)));
    let laws = Vec::from_iter(laws);
    let of_loop = |(one, law): &(RunLoop<'_>, &str)| match one.own.loop_name() {
        Some(name) => format!("{law} ({name})"),
        None => (*law).to_owned(),
    };
    match &laws[..] {
        [(_, first), others @ ..] if others.iter().all(|(_, law)| law == first) => {
            (*first).to_owned()
        }
        several => Vec::from_iter(several.iter().map(of_loop)).join(", "),
    }
}

/// The law of a loop; none where that of another loop leads its drive.
fn law_of<'a>(run: &RunLoop<'a>) -> Option<&'a str> {
    let scenario = &run.own.trial;
    let is_led = scenario.wiring.led_by.is_some();
    (!is_led).then(|| scenario.controller.law_name())
}

/// How much was recorded.
fn recorded(run: &Run<'_>) -> String {
    let ends = run.timelines.iter().map(Timeline::end_seconds);
    let reached = ends.fold(0.0, f64::max);
    let planned = run.plan.shared.run.duration_seconds;
    format!("{reached:.3} s of {planned} s")
}

/// The cause, where the verdict's reason does not say it.
fn cause_besides(verdict: &Verdict) -> Option<&str> {
    let words = verdict.cause.as_ref().map(|cause| cause.words.as_str())?;
    let reason = verdict.reason.as_deref().unwrap_or_default();
    (!reason.contains(words)).then_some(words)
}

/// Why no more was recorded, where the verdict's reason does not say it.
fn end_besides(verdict: &Verdict) -> Option<String> {
    let end = verdict.ended_early.as_ref()?.to_string();
    // The end of a node's log stands in the reason.
    let why = end.lines().next()?;
    let reason = verdict.reason.as_deref().unwrap_or_default();
    (!reason.contains(why)).then(|| format!("The run ended early: {why}"))
}

fn events(events: &Events) -> Markup {
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

fn again(is_long: bool) -> Markup {
    let (log, signals) = match is_long {
        false => (file::BUS_LOG, file::SIGNALS),
        true => (file::LONG_BUS_LOG, file::LONG_SIGNALS),
    };
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
            @for (number, name) in [log, signals, file::VERDICT, file::JUNIT].into_iter().enumerate() {
                @if number > 0 { ", " }
                a href=(name) { (name) }
            }
            "."
        }
    }
}
