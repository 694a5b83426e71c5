//! Logs a run, as a whole or piece by piece.

use std::collections::BTreeSet;
use std::iter::repeat_n;

use dbc::Quantity;
use re_sdk::EntityPath;
use re_sdk::log::TimeColumn;
use re_sdk_types::AnyValues;
use re_sdk_types::archetypes::{SeriesLines, TextDocument, TextLog};
use re_sdk_types::components::{AggregationPolicy, Text, TextLogLevel};
use scenario::disturbance::{Change, value_at};
use scenario::rig::nodes::{FAN_OUTPUT, LOAD_OUTPUT};

use super::ReportError;
use super::blueprint::Page;
use super::bus::{self, BusReader, stretch_seconds};
use super::drawing::Drawing;
use super::groups::{self, CustomView, Style, held, line};
use super::hysteresis::{self, Hysteresis};
use super::output::{Folder, Output, send_look, send_rows, send_scalars, send_static};
use super::times;
use crate::terminal;
use judge::SETTLING_BAND;
use judge::verdict::{Outcome, Verdict};
use plan::{ControlLoop, Plan};
use platform::series::Series;
use recording::events::{Event, Level};
use recording::log::Stamped;
use recording::occurrences::Occurrence;
use recording::timeline::Timeline;

/// Ratio of rows to changes above which a signal has rows only where it changes.
const CHANGES_SELDOM: usize = 4;

/// Part of a run that is known when its signals are logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    /// Whole run, which is logged at once.
    Whole,
    /// Run so far, which more pieces follow.
    SoFar,
    /// Piece of a long run, of which only the extremes in each stretch of time are logged.
    Thinned,
}

/// Log of a loop for a file or a viewer.
pub(crate) struct Recording<'o, 'a> {
    output: Folder<'o>,
    plan: &'a Plan,
    control_loop: &'a ControlLoop,
    known: Known,
    bus: BusReader,
    hysteresis: Hysteresis,
    /// Drawing of the rig; `None` if the plant is no SMA actuator.
    drawing: Option<Drawing>,
    /// Outputs of io nodes that the scenario changes.
    disturbed: Vec<String>,
    /// Paths with names and colours.
    styled: BTreeSet<String>,
    groups: BTreeSet<&'a str>,
    /// Views of the signals that only this plant and this law have.
    custom_views: Vec<CustomView<'a>>,
    /// Time of the last row or event.
    end_seconds: f64,
}

impl<'o, 'a: 'o> Recording<'o, 'a> {
    /// Begins a recording with the constant properties.
    pub(crate) fn begin(
        output: &'o mut dyn Output,
        (plan, control_loop): (&'a Plan, &'a ControlLoop),
        known: Known,
    ) -> Result<Self, ReportError> {
        let mut output = Folder::for_loop(output, control_loop);
        bus::log_styles(&mut output)?;
        send_look(&mut output, hysteresis::NOW, groups::ORANGE)?;
        let trial = &control_loop.trial;
        let pause_seconds = match known {
            Known::Whole | Known::SoFar => 0.0,
            Known::Thinned => stretch_seconds(trial),
        };
        let changes = trial.disturbances().into_iter();
        let drawing = Drawing::new(trial, pause_seconds);
        if let Some(drawing) = &drawing {
            drawing.draw(&mut output)?;
        }
        Ok(Self {
            output,
            plan,
            control_loop,
            known,
            bus: BusReader::new(plan, control_loop, known == Known::Thinned)?,
            drawing,
            hysteresis: Hysteresis::new(pause_seconds),
            disturbed: changes.map(|change| change.output).collect(),
            styled: BTreeSet::new(),
            groups: BTreeSet::new(),
            custom_views: groups::custom_views(plan, control_loop),
            end_seconds: 0.0,
        })
    }

    /// Reads every frame of the bus, in order; returns the scenario time of its cycle.
    pub(crate) fn observe(&mut self, stamped: &Stamped) -> f64 {
        self.bus.observe(stamped)
    }

    /// Logs the next piece of the run, with the frames since the last one.
    pub(crate) fn log(&mut self, timeline: &Timeline) -> Result<(), ReportError> {
        self.log_signals(timeline)?;
        self.hysteresis.log(&mut self.output, timeline)?;
        if let Some(drawing) = &mut self.drawing {
            drawing.log(&mut self.output, timeline)?;
        }
        self.log_settling_bands(timeline)?;
        log_events(&mut self.output, timeline.period_seconds, &timeline.events)?;
        let last = timeline.events.last();
        let last_event = last.map_or(0.0, |event| event.time_seconds);
        let end_seconds = timeline.end_seconds().max(last_event);
        self.end_seconds = self.end_seconds.max(end_seconds);
        self.bus.log(&mut self.output)
    }

    /// Ends a loop; returns its page of the layout, and the time of its end.
    pub(crate) fn end(mut self) -> Result<(Page<'a>, f64), ReportError> {
        self.hysteresis.log_path(&mut self.output)?;
        if self.hysteresis.is_there() {
            self.groups.insert(groups::HYSTERESIS);
        }
        let page = Page {
            plan: self.plan,
            control_loop: self.control_loop,
            groups: self.groups,
        };
        Ok((page, self.end_seconds))
    }

    /// Logs set-point, error, disturbances and all signals of the bus.
    fn log_signals(&mut self, timeline: &Timeline) -> Result<(), ReportError> {
        let samples = timeline.set_point().iter().zip(timeline.position());
        let error: Series<f64> = samples
            .map(|(set_point, position)| set_point - position)
            .collect();
        let trial = &self.control_loop.trial;
        let changes = trial.disturbances();
        let factors = asked(timeline, &changes, FAN_OUTPUT, 1.0);
        let grams = asked(timeline, &changes, LOAD_OUTPUT, 0.0);
        let error_name = timeline.quantities.name("error_{unit}");
        let computed = [
            (error_name.as_str(), &error),
            ("scenario_convection_factor", &factors),
            ("scenario_added_load_grams", &grams),
        ];
        let columns = timeline.columns.iter();
        let named = columns.map(|column| (column.name.as_str(), &column.values));
        let stretch = timeline.cycles_in(stretch_seconds(trial));
        let stretch = usize::try_from(stretch).unwrap_or(usize::MAX);
        // Most signals have the same rows, so the times are computed once.
        let mut times = (Vec::new(), times::at_rows(timeline, &[]));
        for (name, values) in computed.into_iter().chain(named) {
            let quantities = &trial.wiring.quantities;
            let style = groups::style(name, quantities, &self.disturbed, &self.custom_views);
            let rows = match self.known {
                Known::Thinned => Rows::extremes(values, stretch),
                known => Rows::new(values, style.group, known),
            };
            let numbers = rows.numbers();
            if numbers.is_empty() {
                continue;
            }
            if numbers != times.0 {
                times = (numbers.to_vec(), times::at_rows(timeline, numbers));
            }
            self.log_signal(name, style, &rows, values, times.1.clone())?;
        }
        Ok(())
    }

    /// Logs a signal as an entity of its group.
    fn log_signal(
        &mut self,
        name: &str,
        style: Style<'a>,
        rows: &Rows,
        values: &Series<f64>,
        times: [TimeColumn; 2],
    ) -> Result<(), ReportError> {
        let path = format!("{}/{name}", style.group);
        self.groups.insert(style.group);
        if self.styled.insert(path.clone()) {
            let look = rows.drawn(if style.group == groups::OTHER {
                held()
            } else {
                line(style.label, style.colour)
            });
            send_static(&mut self.output, path.as_str(), &look)?;
        }
        let values = values.at(rows.numbers().iter().copied());
        send_scalars(&mut self.output, path, times, values.collect())
    }

    /// Logs the band in which each judged step must settle, as far as the piece reaches.
    fn log_settling_bands(&mut self, timeline: &Timeline) -> Result<(), ReportError> {
        let Some(begin) = timeline.time_seconds.first() else {
            return Ok(());
        };
        for (number, step) in self.control_loop.trial.judged_steps().iter().enumerate() {
            let from = step.window.from_seconds.max(begin);
            let until = step.window.until_seconds.min(timeline.end_seconds());
            if from >= until {
                continue;
            }
            let band = SETTLING_BAND * (step.to - step.from).abs();
            let ends = [from, until];
            let moments = ends.map(|time| times::moment_at(time, timeline.period_seconds));
            let times = times::columns(moments.into_iter());
            for (side, edge) in [("upper", band), ("lower", -band)] {
                let number = number + 1;
                let Quantity { name, unit } = &timeline.quantities.feedback;
                let path = format!("{name}/settling_band/step_{number}/{side}_{unit}");
                if self.styled.insert(path.clone()) {
                    let look = line("settling band", groups::GREY).with_widths([1.0]);
                    send_static(&mut self.output, path.as_str(), &look)?;
                }
                let values = vec![step.to + edge; 2];
                send_scalars(&mut self.output, path, times.clone(), values)?;
            }
        }
        Ok(())
    }
}

/// Logs the verdict at the end of a run: as a page, as the last event, and as properties of the recording.
pub(crate) fn log_verdict(
    output: &mut dyn Output,
    plan: &Plan,
    verdict: &Verdict,
    end_seconds: f64,
) -> Result<(), ReportError> {
    let page = TextDocument::from_markdown(page(verdict));
    send_static(output, "verdict", &page)?;
    let level = match verdict.outcome {
        Outcome::Pass => Level::Info,
        Outcome::Fail => Level::Error,
        _ => Level::Warning,
    };
    let event = Event::new(level, &format!("verdict: {}", verdict.outcome.word()));
    let period_seconds = plan.shared.run.bus.sync_period_milliseconds / 1e3;
    let events = [Occurrence::new(end_seconds, event)];
    log_events(output, period_seconds, &events)?;
    let text = |text: &str| Text(text.into());
    let properties = AnyValues::default()
        .with_component::<Text>("outcome", [text(verdict.outcome.word())])
        .with_component::<Text>("seed", [text(&verdict.seed.to_string())])
        .with_component::<Text>("canrig_version", [text(&verdict.version)]);
    let path = EntityPath::properties().join(&EntityPath::from("run"));
    send_static(output, path, &properties)
}

/// Logs the events with their levels.
fn log_events(
    output: &mut dyn Output,
    period_seconds: f64,
    events: &[Occurrence<Event>],
) -> Result<(), ReportError> {
    if events.is_empty() {
        return Ok(());
    }
    let moments = events
        .iter()
        .map(|event| times::moment_at(event.time_seconds, period_seconds));
    let texts = events.iter().map(|event| event.what.text.as_str());
    let rows = TextLog::update_fields()
        .with_many_text(texts)
        .with_many_level(events.iter().map(level))
        .columns_of_unit_batches()?;
    send_rows(output, "events", times::columns(moments), rows)
}

/// Returns the verdict as Markdown.
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
            "| `{}` | {} | {} | {passed} |\n",
            metric.name,
            terminal::measured(metric),
            terminal::limit(&metric.name, metric.limit),
        );
    }
    text
}

/// Returns the value that the scenario gives an output of an io node, per row; NaN if it gives none.
fn asked(timeline: &Timeline, changes: &[Change], output: &str, at_rest: f64) -> Series<f64> {
    if changes.iter().all(|change| change.output != output) {
        return repeat_n(f64::NAN, timeline.cycle.len()).collect();
    }
    let times = timeline.time_seconds.iter();
    times
        .map(|time| value_at(changes, output, time).unwrap_or(at_rest))
        .collect()
}

/// Rows of a signal to write. Rows without a value are left out.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Rows {
    /// All rows with a value.
    All(Vec<usize>),
    /// Rows in which the value changes, and the last row.
    Changes(Vec<usize>),
}

impl Rows {
    pub(super) fn new(values: &Series<f64>, group: &str, known: Known) -> Self {
        let changes_max = match known {
            _ if group == groups::OTHER => usize::MAX,
            Known::Whole => values.len().div_ceil(CHANGES_SELDOM),
            Known::SoFar | Known::Thinned => 0,
        };
        let mut changes: Vec<usize> = Vec::new();
        let (mut held, mut rest) = (f64::NAN, values.iter());
        while let Some(value) = rest.find(|value| *value != held) {
            if value.is_nan() {
                continue;
            }
            if changes.len() + 1 >= changes_max {
                let rows = values
                    .iter()
                    .enumerate()
                    .filter(|(_, value)| !value.is_nan());
                return Self::All(rows.map(|(row, _)| row).collect());
            }
            changes.push(values.len() - rest.len() - 1);
            held = value;
        }
        let has_value = |row: &usize| values.get(*row).is_some_and(|value| !value.is_nan());
        let last = (0..values.len()).rfind(has_value);
        changes.extend(last.filter(|last| changes.last() != Some(last)));
        Self::Changes(changes)
    }

    /// Returns the rows with the least and the largest value in each part of `count` rows, if these differ from those before.
    pub(super) fn extremes(values: &Series<f64>, count: usize) -> Self {
        let mut rows: Vec<usize> = Vec::new();
        let (mut held, mut last) = (f64::NAN, None);
        let (mut values, mut part) = (values.iter(), Vec::new());
        for begin in (0..values.len()).step_by(count) {
            part.clear();
            part.extend(values.by_ref().take(count));
            let last_here = part.iter().rposition(|value| !value.is_nan());
            last = last_here.map(|row| begin + row).or(last);
            let numbers = || part.iter().enumerate().filter(|(_, value)| !value.is_nan());
            let order = |left: &(usize, &f64), right: &(usize, &f64)| left.1.total_cmp(right.1);
            let mut ends = [numbers().min_by(order), numbers().max_by(order)];
            ends.sort_by_key(|end| end.map(|(row, _)| row));
            for (row, value) in ends.into_iter().flatten() {
                if *value != held {
                    rows.push(begin + row);
                    held = *value;
                }
            }
        }
        rows.extend(last.filter(|last| rows.last().is_none_or(|row| row < last)));
        Self::Changes(rows)
    }

    fn numbers(&self) -> &[usize] {
        match self {
            Self::All(rows) | Self::Changes(rows) => rows,
        }
    }

    /// Sets the drawing of a signal. If many rows fall on one pixel, the viewer draws their extremes and holds the largest until
    /// the next row. A signal with long pauses between its rows must be drawn unchanged.
    fn drawn(&self, look: SeriesLines) -> SeriesLines {
        match self {
            Self::All(_) => look,
            Self::Changes(_) => look.with_aggregation_policy(AggregationPolicy::Off),
        }
    }
}

fn level(event: &Occurrence<Event>) -> TextLogLevel {
    match event.level {
        Level::Info => TextLogLevel::INFO,
        Level::Warning => TextLogLevel::WARN,
        Level::Error => TextLogLevel::ERROR,
    }
    .into()
}
