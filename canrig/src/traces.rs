//! The samples of the signals that a scenario's checks name.

use std::collections::BTreeMap;
use std::time::Duration;

use canopen::CanFrame;
use dbc::{Database, SignalHandle};
use scenario::Scenario;

use crate::signal_names::SignalNames;
use crate::signals::COLUMN_MESSAGES;

/// So many times without a cyclic message are a silence, as in `losses`.
const PERIODS_MAX: u32 = 20;

/// One value that was on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Scenario time: of its cycle for messages that follow SYNC, else of the frame.
    pub time_seconds: f64,
    /// The physical value.
    pub value: f64,
}

/// One signal from scenario time 0 to the scenario's end.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// `message.signal`.
    pub path: String,
    /// The unit in the DBC; empty for numbers without one.
    pub unit: String,
    /// Longest time between two samples of a message that is sent cyclically.
    pub silence_seconds_max: Option<f64>,
    /// The samples in the order of time, at most one at a time.
    pub samples: Vec<Sample>,
}

/// A signal to be collected.
struct Collected {
    handle: SignalHandle,
    follows_sync: bool,
    trace: Trace,
}

/// Collects the samples from the frames.
pub(crate) struct TraceReader {
    collected: Vec<Collected>,
    end: Duration,
}

impl TraceReader {
    /// A reader for all signals that the scenario names; names that stand for no signal are left to the judge.
    pub(crate) fn new(scenario: &Scenario, database: &Database) -> Self {
        let period = scenario.bus.sync_period();
        let mut collected = BTreeMap::new();
        for (_, name) in scenario.expect.named_signals() {
            let path = SignalNames::of(scenario).find(name);
            if let Some((path, found)) = path
                .ok()
                .and_then(|path| Some((path, collect(path, period, database)?)))
            {
                collected.insert(path, found);
            }
        }
        Self {
            collected: collected.into_values().collect(),
            end: Duration::from_secs_f64(scenario.duration_seconds),
        }
    }

    /// The scenario names no signal.
    pub(crate) fn is_empty(&self) -> bool {
        self.collected.is_empty()
    }

    /// Takes a frame with its scenario time and the start of its cycle.
    pub(crate) fn take(
        &mut self,
        frame: &CanFrame,
        scenario_time: Option<Duration>,
        cycle_seconds: Option<f64>,
    ) {
        let Some(time) = scenario_time.filter(|time| *time < self.end) else {
            return;
        };
        let time_seconds = time.as_secs_f64();
        for collected in &mut self.collected {
            let Some(value) = collected.handle.decode(frame) else {
                continue;
            };
            let of_cycle = cycle_seconds.filter(|_| collected.follows_sync);
            let time_seconds = of_cycle.unwrap_or(time_seconds);
            let samples = &mut collected.trace.samples;
            // The latest of a cycle counts, as in `signals.csv`; a clock that went back leaves no order behind.
            while samples
                .last()
                .is_some_and(|last| last.time_seconds >= time_seconds)
            {
                samples.pop();
            }
            samples.push(Sample {
                time_seconds,
                value,
            });
        }
    }

    /// The traces, each given once.
    pub(crate) fn take_all(&mut self) -> Vec<Trace> {
        let traces = self.collected.drain(..);
        traces.map(|collected| collected.trace).collect()
    }
}

fn collect(path: &str, sync_period: Duration, database: &Database) -> Option<Collected> {
    let (message, _) = path.split_once('.')?;
    let cycle_time = Duration::from_millis(database.message(message)?.cycle_time_milliseconds);
    let silence = PERIODS_MAX * cycle_time.max(sync_period);
    Some(Collected {
        handle: database.signal(path)?,
        follows_sync: COLUMN_MESSAGES.contains(&message),
        trace: Trace {
            path: path.to_owned(),
            unit: database.definition(path)?.unit.clone(),
            silence_seconds_max: (!cycle_time.is_zero()).then_some(silence.as_secs_f64()),
            samples: Vec::new(),
        },
    })
}
