//! `run.rrd`: the run for the Rerun viewer, with a layout of its own.
//!
//! A signal that is drawn has a row in every cycle, one that is not only where its value changes. Nothing in the file
//! comes from this machine's clock, so two equal runs are equal files once decoded (only the SDK's random numbers of
//! rows differ).

mod blueprint;
mod groups;
mod hysteresis;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::Path;

use rerun::{
    AnyValues, RecordingStream, RecordingStreamBuilder, RecordingStreamError, Scalars, SeriesLines,
    TextDocument, TextLog, TextLogLevel, TimeColumn,
};
use scenario::Scenario;
use scenario::events::DisturbanceCommand;
use sha2::{Digest, Sha256};

use crate::events::{Event, Level};
use crate::judge::SETTLING_BAND;
use crate::report::terminal;
use crate::timeline::Timeline;
use crate::verdict::Verdict;
use groups::Style;

/// The viewer keeps one layout per application.
const APPLICATION: &str = "canrig";
/// Scenario time.
const RUN_TIME: &str = "run_time";
/// Number of the cycle since scenario time 0.
const CYCLE: &str = "cycle";

/// Why the recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RerunError {
    /// The SDK refuses.
    #[error(transparent)]
    Recording(#[from] RecordingStreamError),
    /// The disk does not take the file.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The SDK did not hand everything to the disk.
    #[error("the end of the recording is not on the disk")]
    NotFlushed,
}

/// Writes the recording as a whole: a reader sees none or a complete one.
///
/// # Errors
/// The file cannot be written.
pub fn write(
    path: &Path,
    timeline: &Timeline,
    verdict: &Verdict,
    scenario: &Scenario,
) -> Result<(), RerunError> {
    let partial = path.with_added_extension("partial");
    let stream = RecordingStreamBuilder::new(APPLICATION)
        .enabled(true) // whatever the environment variable RERUN says
        .recording_id(recording_id(timeline, verdict))
        .send_properties(true) // recording_id() has switched it off
        .recording_name(&scenario.name)
        .recording_started(0_i64)
        .save(&partial)?;
    stream.set_log_time_enabled(false);
    log_properties(&stream, verdict)?;
    let mut groups = log_signals(&stream, timeline, scenario)?;
    if hysteresis::log(&stream, timeline)? {
        groups.insert("hysteresis");
    }
    log_settling_bands(&stream, timeline, scenario)?;
    log_events(&stream, timeline)?;
    blueprint::send(&stream, &groups)?;
    stream
        .flush_blocking()
        .map_err(|_| RerunError::NotFlushed)?;
    drop(stream); // writes the footer
    Ok(fs::rename(partial, path)?)
}

/// Names what was recorded: two recordings of one id would be mixed by a viewer that is open.
fn recording_id(timeline: &Timeline, verdict: &Verdict) -> String {
    let mut hasher = Sha256::new();
    hasher.update(verdict.to_json());
    for event in &timeline.events {
        hasher.update(event.time_seconds.to_le_bytes());
        hasher.update(&event.text);
    }
    for column in &timeline.columns {
        hasher.update(&column.name);
        for value in &column.values {
            hasher.update(value.to_le_bytes());
        }
    }
    let digest = hasher.finalize();
    digest
        .iter()
        .take(16)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// The verdict, as a page and as the recording's properties.
fn log_properties(stream: &RecordingStream, verdict: &Verdict) -> Result<(), RecordingStreamError> {
    stream.log_static("verdict", &TextDocument::from_markdown(page(verdict)))?;
    let text = |text: &str| rerun::components::Text(text.into());
    let properties = AnyValues::default()
        .with_component::<rerun::components::Text>("outcome", [text(verdict.outcome.word())])
        .with_component::<rerun::components::Text>("seed", [text(&verdict.seed.to_string())])
        .with_component::<rerun::components::Text>("canrig_version", [text(verdict.version)]);
    stream.send_property("run", &properties)
}

/// The verdict as Markdown.
fn page(verdict: &Verdict) -> String {
    let mut text = format!("**{}: {}**\n", verdict.scenario, verdict.outcome.word());
    if let Some(reason) = &verdict.reason {
        text += &format!("\n{reason}\n");
    }
    text += "\n| metric | measured | limit | |\n|---|---|---|---|\n";
    for metric in &verdict.metrics {
        let passed = match metric.passed {
            Some(true) => "pass",
            Some(false) => "**FAIL**",
            None => "",
        };
        text += &format!(
            "| {} | {} | {} | {passed} |\n",
            metric.name.replace('_', " "),
            terminal::measured(metric),
            terminal::limit(metric),
        );
    }
    text
}

/// Set-point, error, disturbances and all signals of the bus; the groups that there are.
fn log_signals(
    stream: &RecordingStream,
    timeline: &Timeline,
    scenario: &Scenario,
) -> Result<BTreeSet<&'static str>, RecordingStreamError> {
    let samples = timeline
        .set_point_millimetres
        .iter()
        .zip(timeline.position());
    let error: Vec<f64> = samples
        .map(|(set_point, position)| set_point - position)
        .collect();
    let factors = asked(scenario, timeline, 1.0, |command| command.convection_factor);
    let grams = asked(scenario, timeline, 0.0, |command| command.added_grams);
    let own = [
        ("set_point_millimetres", &timeline.set_point_millimetres),
        ("error_millimetres", &error),
        ("scenario_convection_factor", &factors),
        ("scenario_added_load_grams", &grams),
    ];
    let columns = timeline
        .columns
        .iter()
        .map(|column| (column.name.as_str(), &column.values));
    let mut groups = BTreeSet::new();
    for (name, values) in own.into_iter().chain(columns) {
        let style = groups::style(name, values);
        let rows = rows(style.group, values);
        if !rows.is_empty() {
            let values = rows.iter().map(|&row| values[row]);
            log_signal(stream, name, style, values, times(timeline, &rows))?;
            groups.insert(style.group);
        }
    }
    Ok(groups)
}

/// What the scenario asks of the disturbance node, per row; NaN where it never asks.
fn asked(
    scenario: &Scenario,
    timeline: &Timeline,
    before: f64,
    output: fn(&DisturbanceCommand) -> f64,
) -> Vec<f64> {
    let commands = scenario.disturbance.commands();
    if commands.iter().all(|command| output(command) == before) {
        return vec![f64::NAN; timeline.cycle.len()];
    }
    let at = |time: &f64| {
        let begun = commands
            .iter()
            .rev()
            .find(|command| command.at_seconds <= *time);
        begun.map_or(before, output)
    };
    timeline.time_seconds.iter().map(at).collect()
}

/// One signal as an entity of its group.
fn log_signal(
    stream: &RecordingStream,
    name: &str,
    style: Style,
    values: impl IntoIterator<Item = f64>,
    times: [TimeColumn; 2],
) -> Result<(), RecordingStreamError> {
    let path = format!("{}/{name}", style.group);
    stream.log_static(path.as_str(), &line(style.label, style.colour))?;
    let scalars = Scalars::new(values).columns_of_unit_batches()?;
    stream.send_columns(path, times, scalars)
}

/// The rows to write of a signal. Those without a value are left out.
///
/// A drawn signal has all others: the viewer draws no more than the extremes of what falls on one pixel, and would hold
/// an extreme until the next row.
fn rows(group: &str, values: &[f64]) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..values.len())
        .filter(|&row| !values[row].is_nan())
        .collect();
    if group == groups::OTHER {
        let last = rows.last().copied();
        rows.dedup_by(|row, before| values[*row] == values[*before]);
        rows.extend(last.filter(|last| rows.last() != Some(last)));
    }
    rows
}

/// How a signal is drawn: held between its rows.
fn line(label: &str, colour: [u8; 3]) -> SeriesLines {
    SeriesLines::new()
        .with_names([label])
        .with_colors([colour])
        .with_interpolation_mode(rerun::components::InterpolationMode::StepAfter)
}

/// Both timelines at some rows.
fn times(timeline: &Timeline, rows: &[usize]) -> [TimeColumn; 2] {
    let seconds = rows.iter().map(|&row| timeline.time_seconds[row]);
    let cycles = rows
        .iter()
        .map(|&row| i64::try_from(timeline.cycle[row]).unwrap_or(i64::MAX));
    [
        TimeColumn::new_duration_nanos(RUN_TIME, seconds.map(nanoseconds)),
        TimeColumn::new_sequence(CYCLE, cycles),
    ]
}

/// Both timelines at some times, which may lie before the first cycle.
fn times_between(timeline: &Timeline, seconds: &[f64]) -> [TimeColumn; 2] {
    let cycle = |seconds: &f64| whole((seconds / timeline.period_seconds + 1e-6).floor());
    [
        TimeColumn::new_duration_nanos(RUN_TIME, seconds.iter().copied().map(nanoseconds)),
        TimeColumn::new_sequence(CYCLE, seconds.iter().map(cycle)),
    ]
}

fn nanoseconds(seconds: f64) -> i64 {
    whole((seconds * 1e9).round())
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "run times stay far below 292 years"
)]
fn whole(value: f64) -> i64 {
    value as i64
}

/// The band that each judged step must settle in.
fn log_settling_bands(
    stream: &RecordingStream,
    timeline: &Timeline,
    scenario: &Scenario,
) -> Result<(), RecordingStreamError> {
    for (number, step) in scenario.judged_steps().iter().enumerate() {
        let band = SETTLING_BAND * (step.to_millimetres - step.from_millimetres).abs();
        let window = [step.window.from_seconds, step.window.until_seconds];
        let times = times_between(timeline, &window);
        for (side, edge) in [("upper", band), ("lower", -band)] {
            let path = format!(
                "position/settling_band/step_{}/{side}_millimetres",
                number + 1
            );
            stream.log_static(
                path.as_str(),
                &line("settling band", groups::GREY).with_widths([1.0]),
            )?;
            let scalars =
                Scalars::new([step.to_millimetres + edge; 2]).columns_of_unit_batches()?;
            stream.send_columns(path, times.clone(), scalars)?;
        }
    }
    Ok(())
}

/// What happened.
fn log_events(stream: &RecordingStream, timeline: &Timeline) -> Result<(), RecordingStreamError> {
    let seconds: Vec<f64> = timeline
        .events
        .iter()
        .map(|event| event.time_seconds)
        .collect();
    let texts = timeline.events.iter().map(|event| event.text.as_str());
    let rows = TextLog::update_fields()
        .with_many_text(texts)
        .with_many_level(timeline.events.iter().map(level))
        .columns_of_unit_batches()?;
    stream.send_columns("events", times_between(timeline, &seconds), rows)
}

fn level(event: &Event) -> TextLogLevel {
    match event.level {
        Level::Info => TextLogLevel::INFO,
        Level::Warning => TextLogLevel::WARN,
        Level::Error => TextLogLevel::ERROR,
    }
    .into()
}
