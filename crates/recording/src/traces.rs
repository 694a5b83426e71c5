//! Samples of the signals that a scenario's checks name, and of the true position.

use std::collections::BTreeMap;
use std::time::Duration;

use can::CanFrame;
use dbc::names::TRUE_POSITION;
use dbc::{Database, SignalHandle};
use plan::ControlLoop;
use platform::series::{Series, SeriesWriter};

use crate::losses::PERIODS_MAX;

/// Value of a signal on the bus.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct SignalSample {
    /// Scenario time of its cycle for messages that follow SYNC, otherwise of the frame.
    pub time_seconds: f64,
    pub value: f64,
}

/// Signal from scenario time 0 to the scenario's end.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalTrace {
    /// `message.signal`.
    pub path: String,
    /// Unit in the DBC; empty for numbers without one.
    pub unit: String,
    /// Longest time between two samples of a message that is sent cyclically.
    pub silence_seconds_max: Option<f64>,
    /// Whether it is an output of a plant; a value that its field cannot hold is not a number.
    pub is_of_plant: bool,
    /// Samples in the order of time, at most one at each time.
    pub samples: Series<SignalSample>,
}

struct Collected {
    handle: SignalHandle,
    follows_sync: bool,
    /// Trace without its samples.
    trace: SignalTrace,
    samples: SeriesWriter<SignalSample>,
}

impl Collected {
    /// Appends a sample. The latest sample of a cycle counts, as in `signals.csv`, so later ones are removed after a clock went
    /// back.
    fn push(&mut self, sample: SignalSample) {
        let is_over = |last: &SignalSample| last.time_seconds >= sample.time_seconds;
        while self.samples.last().is_some_and(is_over) {
            self.samples.pop();
        }
        self.samples.push(sample);
    }
}

/// Reader of the samples of signals from the frames.
pub(crate) struct TraceReader {
    collected: Vec<Collected>,
}

impl TraceReader {
    /// Makes a reader of all signals that the scenario names, and of the true position that it judges. The judge reports names
    /// without a signal.
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Self {
        let scenario = &one.trial;
        let mut collected = BTreeMap::new();
        let named = scenario.expect.named_signals().map(|(_, name)| name);
        let truth = scenario.wiring.quantities.name(TRUE_POSITION);
        let truth = scenario.has_true_metrics().then_some(truth.as_str());
        for name in named.chain(truth) {
            let Ok(path) = one.names().find(name) else {
                continue;
            };
            if let Some(found) = collect(path, database, one) {
                collected.insert(path, found);
            }
        }
        Self {
            collected: collected.into_values().collect(),
        }
    }

    /// Returns the identifiers of the messages that are read.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        let collected = self.collected.iter();
        collected.map(|collected| collected.handle.raw_id())
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.collected.is_empty()
    }

    /// Takes a frame of the scenario with its time and the start of its cycle, which few frames need.
    pub(crate) fn on_frame(
        &mut self,
        frame: &CanFrame,
        time: Duration,
        cycle_seconds: impl Fn() -> Option<f64>,
    ) {
        for collected in &mut self.collected {
            let Some(value) = collected.handle.decode(frame) else {
                continue;
            };
            let is_cut = collected.trace.is_of_plant && collected.handle.is_cut(frame);
            let cycle = collected.follows_sync.then(&cycle_seconds).flatten();
            collected.push(SignalSample {
                time_seconds: cycle.unwrap_or(time.as_secs_f64()),
                value: if is_cut { f64::NAN } else { value },
            });
        }
    }

    /// Takes the traces, each once.
    pub(crate) fn take_all(&mut self) -> Vec<SignalTrace> {
        let traces = self.collected.drain(..);
        let trace = |collected: Collected| SignalTrace {
            samples: collected.samples.finish(),
            ..collected.trace
        };
        traces.map(trace).collect()
    }
}

/// Returns the longest time between two messages of a kind; without a cycle time of their own they follow the SYNC.
pub fn silence_seconds_max(message: &str, database: &Database, one: &ControlLoop) -> f64 {
    let cycle_time = cycle_time(message, database).unwrap_or_default();
    let period = one.trial.run.bus.sync_period() * one.every_cycles(database, message);
    (PERIODS_MAX * cycle_time.max(period)).as_secs_f64()
}

fn cycle_time(message: &str, database: &Database) -> Option<Duration> {
    let message = database.message(message)?;
    Some(Duration::from_millis(message.cycle_time_milliseconds))
}

fn collect(path: &str, database: &Database, one: &ControlLoop) -> Option<Collected> {
    let (message, _) = path.split_once('.')?;
    let is_cyclic = !cycle_time(message, database)?.is_zero();
    let silence = || silence_seconds_max(message, database, one);
    let column = one
        .columns(database)
        .find(|one| one.message.name == message);
    Some(Collected {
        handle: database.signal(path)?,
        follows_sync: column.is_some(),
        trace: SignalTrace {
            path: path.to_owned(),
            unit: database.definition(path)?.unit.clone(),
            silence_seconds_max: is_cyclic.then(silence),
            is_of_plant: column.is_some_and(|column| column.is_of_plant),
            samples: Series::default(),
        },
        samples: SeriesWriter::default(),
    })
}
