//! `report.html`: one run on one page.
//!
//! The page has a head, the verdict, `signals`, the `response` to chirps, `checks`, `bus`, the events, the scenario, and the
//! commands to make it again.

mod bus;
mod checks;
mod contour;
mod response;
mod signals;

use dbc::SignalMissing;
use maud::{Markup, html};

use crate::page;
use crate::run::{Run, RunLoop};
use crate::terminal;
use judge::verdict::{Outcome, Verdict};
use recording::events::{Event, Level};
use recording::frames::Clock;
use recording::occurrences::Occurrence;
use recording::run_folder::file;
use recording::timeline::{Timeline, all_events};

/// Largest number of listed events; a run with more of them has a single cause, which the first ones show.
const EVENTS_MAX: usize = 300;

/// Returns the page of a run. It depends on the recording and the verdict only. `remarks` name the parts of the log that cannot
/// be read.
///
/// # Errors
/// The database lacks a signal that the bench needs.
pub fn to_html(run: &Run<'_>, remarks: &[String]) -> Result<String, SignalMissing> {
    let (shared, verdict) = (&run.plan.shared, run.verdict);
    let body = html! {
        (head(run, remarks))
        @if run.plan.loops.len() > 1 { (contents(run)) }
        h2 #verdict { "Verdict" }
        (metrics(run))
        @for contour in &shared.contours { (contour::section(contour, run)) }
        @for (number, one) in run.loops().enumerate() { (loop_section(number, &one)) }
        (bus::section(run)?)
        (events(&all_events(run.timelines)))
        h2 #scenario { "Scenario" }
        details open { summary { (file::SCENARIO) } pre { (shared.text) } }
        @for (name, text) in shared.tables.iter().filter(|(name, _)| name.ends_with(".toml")) {
            details { summary { (name) } pre { (text) } }
        }
        (again(run.is_long))
        (foot(run))
    };
    Ok(page::page(
        &format!("{}: {}", shared.run.name, page::word(verdict.outcome)),
        &body,
    ))
}

/// Returns links to the parts of the page.
fn contents(run: &Run<'_>) -> Markup {
    html! { nav.contents aria-label="Contents" {
        a href="#verdict" { "Verdict" }
        @for (number, one) in run.loops().enumerate() { a href=(format!("#loop-{number}")) { "Loop " (one.control_loop.name()) } }
        @for (id, name) in [("bus", "Bus and timing"), ("events", "Events"), ("scenario", "Scenario"), ("again", "Again"), ("versions", "Versions")] {
            a href=(format!("#{id}")) { (name) }
        }
    } }
}

/// Returns the metrics; with several loops those of each loop, then those that all share.
fn metrics(run: &Run<'_>) -> Markup {
    let verdict = run.verdict;
    if verdict.metrics.is_empty() {
        return html! { p.soft { "Nothing was judged." } };
    }
    let mut rest = Vec::from_iter(&verdict.metrics);
    let mut groups = Vec::new();
    let loops = run.plan.loops.iter();
    for one in loops.filter(|one| one.loop_name().is_some()) {
        let prefix = one.prefix();
        let of_loop = rest.extract_if(.., |metric| metric.name.starts_with(&prefix));
        groups.push((format!("Loop {}", one.name()), Vec::from_iter(of_loop)));
    }
    let has_loops = !groups.is_empty();
    groups.push(("All loops".to_owned(), rest));
    html! { @for (title, metrics) in &groups { @if !metrics.is_empty() {
        @if has_loops { h3 { (title) } }
        (page::metrics(metrics.iter().copied(), verdict.outcome))
    } } }
}

/// Returns the sections on a loop.
fn loop_section(number: usize, run: &RunLoop<'_>) -> Markup {
    html! {
        @if let Some(name) = run.control_loop.loop_name() { h2 id=(format!("loop-{number}")) { "Loop " (name) } }
        @if run.timeline.cycle.is_empty() { p { "The scenario never began, so there is nothing to plot." } }
        @else { (signals::section(run)) }
        (response::section(run))
        (checks::section(run))
    }
}

/// Returns the heading of a part of those sections.
fn heading(run: &RunLoop<'_>, text: &str) -> Markup {
    match run.control_loop.loop_name() {
        None => html! { h2 { (text) } },
        Some(_) => html! { h3 { (text) } },
    }
}

fn head(run: &Run<'_>, remarks: &[String]) -> Markup {
    let (shared, verdict) = (&run.plan.shared, run.verdict);
    let is_external = |one: RunLoop<'_>| one.control_loop.drive().is_external();
    html! {
        h1 { (shared.run.name) }
        p { (page::badge(verdict.outcome)) }
        @if let Some(tries) = &verdict.tries { p.unsure { (page::sentence(&terminal::tries(tries))) } }
        @if let Some(missed) = missed(verdict) { p.fail { (missed) } }
        @if let Some(reason) = &verdict.reason { p { (page::sentence(reason)) } }
        @else if verdict.judged_nothing() { p { "Nothing was limited, so nothing was judged." } }
        @if let Some(cause) = cause_besides(verdict) { p { (page::sentence(cause)) } }
        @if let Some(end) = end_besides(verdict) { p { (page::sentence(&end)) } }
        @for doubt in doubts(verdict) { p.unsure { (doubt) } }
        @if let Some(free) = without_limit(verdict) { p.soft { (free) } }
        @for remark in remarks { p.unsure { "Of the recording as it is now, " (remark) ". This page shows the other frames." } }
        @if let Some(description) = &shared.run.description { p.soft { (description) } }
        dl.facts {
            div { dt { "control law" } dd { (laws(run)) } }
            div { dt { "recorded" } dd { (recorded(run)) } }
            @if let Some(clock) = run.frames.clock() { div { dt { "clock" } dd { (page::time_by(clock)) } } }
            div { dt { "cycle" } dd { (shared.run.bus.sync_period_milliseconds) " ms" } }
            div { dt { "bus" } dd { (shared.run.bus.bitrate_kilobits_per_second) " kbit/s" } }
            div { dt { "frames" } dd { (run.frames.len()) } }
            @if !verdict.requirements.is_empty() { div { dt { "requirements" } dd { (verdict.requirements.join(", ")) } } }
            @if !run.set.is_empty() { div.hash { dt { "values of the command line" } dd { @for set in run.set { div { (page::set(set)) } } } } }
            @if !verdict.external.is_empty() { div { dt { "external" } dd { (verdict.external.join(", ")) } } }
        }
        @if run.loops().any(is_external) {
            p.soft { "Wire temperature, martensite fraction and true position are not available: the drive is external, and only the emulator knows them." }
        }
    }
}

/// Returns the law of all loops, or that of each.
fn laws(run: &Run<'_>) -> String {
    // The law of another loop may lead a loop's drive.
    let loops = run.plan.loops.iter();
    let leading = loops.filter(|one| one.trial.wiring.led_by.is_none());
    let laws =
        Vec::from_iter(leading.map(|one| (one.loop_name(), one.trial.controller.law_name())));
    let text = |(name, law): &(Option<&str>, &str)| match name {
        Some(name) => format!("{law} ({name})"),
        None => (*law).to_owned(),
    };
    match &laws[..] {
        [(_, first), others @ ..] if others.iter().all(|(_, law)| law == first) => {
            (*first).to_owned()
        }
        several => Vec::from_iter(several.iter().map(text)).join(", "),
    }
}

/// Returns how much of the scenario was recorded.
fn recorded(run: &Run<'_>) -> String {
    let ends = run.timelines.iter().map(Timeline::end_seconds);
    let reached = terminal::rounded(ends.fold(0.0, f64::max));
    let planned = run.plan.shared.run.duration_seconds;
    format!("{reached} s of {planned} s")
}

/// Returns the cause, unless the verdict's reason contains it.
fn cause_besides(verdict: &Verdict) -> Option<&str> {
    let description = verdict.cause.as_ref()?.description.as_str();
    let reason = verdict.reason.as_deref().unwrap_or_default();
    (!reason.contains(description)).then_some(description)
}

/// Returns remarks on limits that were not judged, times that are not trusted, and frames that are missing.
fn doubts(verdict: &Verdict) -> Vec<String> {
    let metrics = || verdict.metrics.iter();
    let not_judged = metrics()
        .filter(|metric| metric.limit.is_some() && metric.passed.is_none())
        .map(|metric| match &metric.remark {
            Some(remark) => format!("Not judged: {}, {remark}.", metric.name),
            None => format!("Not judged: {}.", metric.name),
        });
    let distrust = verdict
        .timing
        .iter()
        .flat_map(|timing| &timing.distrust)
        .map(|reason| format!("The timing is not trusted: {reason}."));
    let frames = [
        (
            verdict.frames_lost,
            "the recorder lost, so they are not judged",
        ),
        (verdict.fd_frames, "of CAN FD, whose data are not recorded"),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0);
    let frames = frames.map(|(count, fate)| format!("{count} frames {fate}."));
    not_judged.chain(distrust).chain(frames).collect()
}

/// Returns the missed limits with their values; `None` unless the run failed by them.
fn missed(verdict: &Verdict) -> Option<String> {
    let metrics = verdict.metrics.iter();
    let missed = metrics.filter(|metric| metric.passed == Some(false));
    let missed = Vec::from_iter(missed.map(terminal::missed));
    let is_said = verdict.outcome == Outcome::Fail && !missed.is_empty();
    is_said.then(|| format!("Missed: {}.", missed.join(", ")))
}

/// Returns a remark on the values without a limit, which the verdict does not cover; `None` if no value has a limit, which
/// another remark says.
fn without_limit(verdict: &Verdict) -> Option<String> {
    let metrics = verdict.metrics.iter();
    let free = metrics.filter(|metric| metric.limit.is_none());
    let free = Vec::from_iter(free.map(|metric| metric.name.as_str()));
    let says_something = !free.is_empty() && free.len() < verdict.metrics.len();
    says_something.then(|| format!("Without a limit: {}.", free.join(", ")))
}

/// Returns the reason why the recording ends early, unless the verdict's reason contains it.
fn end_besides(verdict: &Verdict) -> Option<String> {
    let end = verdict.ended_early.as_ref()?.to_string();
    // The reason contains the end of a node's log.
    let why = end.lines().next()?;
    let reason = verdict.reason.as_deref().unwrap_or_default();
    (!reason.contains(why)).then(|| format!("The run ended early: {why}"))
}

fn events(events: &[Occurrence<Event>]) -> Markup {
    html! {
        h2 #events { "Events" }
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
    let (log, signals) = if is_long {
        (file::LONG_BUS_LOG, file::LONG_SIGNALS)
    } else {
        (file::BUS_LOG, file::SIGNALS)
    };
    html! {
        h2 #again { "Again" }
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
            @for (number, name) in [log, signals, file::VERDICT, file::JUNIT, file::PLAYED].into_iter().enumerate() {
                @if number > 0 { ", " }
                a href=(name) { (name) }
            }
            "."
        }
    }
}

/// Returns the versions, for readers who must reproduce the run. A run in virtual time has no date, so that two plays leave the
/// same page.
fn foot(run: &Run<'_>) -> Markup {
    let (shared, verdict) = (&run.plan.shared, run.verdict);
    let clock = run.frames.clock();
    let dated = run.played.filter(|_| clock == Some(Clock::Wall));
    html! {
        h2 #versions { "Versions" }
        dl.facts.versions {
            div { dt { "program" } dd { "canrig " (verdict.version) } }
            @if let Some(played) = dated { div { dt { "played" } dd { (played) } } }
            div { dt { "duration" } dd { (shared.run.duration_seconds) " s" } }
            div { dt { "seed" } dd { (verdict.seed) } }
            @if let Some(identity) = &verdict.identity { (page::identity(identity)) }
        }
        @if clock == Some(Clock::Virtual) { (page::undated()) }
    }
}
