//! What a verdict rests on: the decoded recording, windows of its samples, and the values that are made of them.

use dbc::signals::TRUTH_MESSAGES;
use recording::timeline::Timeline;
use recording::traces::{SignalSample, SignalTrace};
use rig::setup::Setup;
use scenario::Scenario;
use scenario::events::Window;
use scenario::expect::Limit;

use crate::circumstances::Circumstances;
use crate::metric::Metric;
use crate::misses::Misses;

/// Sample times are multiples of the period; this absorbs their rounding.
pub(crate) const TIME_TOLERANCE_SECONDS: f64 = 1e-9;

/// What is judged, and by what.
pub(crate) struct Evidence<'a> {
    pub(crate) timeline: &'a Timeline,
    pub(crate) setup: &'a Setup,
    pub(crate) scenario: &'a Scenario,
    pub(crate) circumstances: &'a Circumstances,
    misses: Misses,
}

/// A value, or why there is none.
pub(crate) type MetricValue = Result<f64, String>;

/// What the recording shows of a metric.
pub(crate) enum Measurement {
    Measured(MetricValue),
    /// There is no value, which matters only where the metric has a limit.
    Missing(String),
    /// Nobody on this bus sends it, so a limit is neither met nor missed.
    Unavailable(String),
    /// The scenario gives the metric no meaning.
    NotAsked,
}

impl From<MetricValue> for Measurement {
    fn from(value: MetricValue) -> Self {
        match value {
            Ok(value) => Self::Measured(Ok(value)),
            Err(reason) => Self::Missing(reason),
        }
    }
}

impl Measurement {
    /// What only the emulated plant sends, where there is none.
    pub(crate) fn only_emulated() -> Self {
        Self::Unavailable(only_emulated())
    }

    /// The row of the verdict, if there is one.
    pub(crate) fn metric(self, name: &str, limit: Option<Limit>) -> Option<Metric> {
        match self {
            Self::Measured(value) => Some(Metric::new(name, value, limit)),
            Self::Missing(reason) => limit.map(|_| Metric::new(name, Err(reason), limit)),
            Self::Unavailable(reason) => Some(Metric::not_judged(name, reason, limit)),
            Self::NotAsked => None,
        }
    }
}

/// What the recording shows of a check: a value, and when it was so.
pub(crate) struct Observation {
    pub(crate) value: MetricValue,
    pub(crate) at_seconds: Option<f64>,
    /// Nobody on this bus sends it, so it is neither met nor missed.
    is_unavailable: bool,
}

impl Observation {
    pub(crate) fn at(value: MetricValue, at_seconds: f64) -> Self {
        Self {
            value,
            at_seconds: Some(at_seconds),
            is_unavailable: false,
        }
    }

    pub(crate) fn none(reason: impl Into<String>) -> Self {
        Self {
            value: Err(reason.into()),
            at_seconds: None,
            is_unavailable: false,
        }
    }

    /// The row of the verdict.
    pub(crate) fn metric(self, name: String, limit: Limit) -> Metric {
        if self.is_unavailable {
            return Metric::not_judged(name, only_emulated(), Some(limit));
        }
        Metric::new(name, self.value, Some(limit)).at(self.at_seconds)
    }
}

/// Set-point and measured position of one cycle.
#[derive(Clone, Copy)]
pub(crate) struct CycleSample {
    pub(crate) time_seconds: f64,
    pub(crate) set_point_millimetres: f64,
    pub(crate) position_millimetres: f64,
}

impl CycleSample {
    pub(crate) fn deviation_millimetres(&self) -> f64 {
        (self.position_millimetres - self.set_point_millimetres).abs()
    }
}

impl<'a> Evidence<'a> {
    pub(crate) fn new(
        timeline: &'a Timeline,
        setup: &'a Setup,
        circumstances: &'a Circumstances,
    ) -> Self {
        Self {
            timeline,
            setup,
            scenario: &setup.scenario,
            circumstances,
            misses: Misses::of(timeline, setup, circumstances),
        }
    }

    /// The cycles that were missed, and whose doing that was.
    pub(crate) fn misses(&self) -> &Misses {
        &self.misses
    }

    /// The samples of a window, up to but without its end; cycles without a position are left out.
    pub(crate) fn samples(&self, window: Window) -> impl Iterator<Item = CycleSample> {
        let timeline = self.timeline;
        let times = timeline.time_seconds.iter();
        let set_points = timeline.set_point_millimetres.iter();
        let rows = times.zip(set_points).zip(timeline.position());
        let samples = rows.map(|((time, set_point), position)| CycleSample {
            time_seconds: *time,
            set_point_millimetres: *set_point,
            position_millimetres: *position,
        });
        samples.filter(move |sample| {
            let is_inside = sample.time_seconds >= window.from_seconds - TIME_TOLERANCE_SECONDS
                && sample.time_seconds < window.until_seconds - TIME_TOLERANCE_SECONDS;
            is_inside && !sample.position_millimetres.is_nan()
        })
    }

    /// The window of the whole run.
    pub(crate) fn whole(&self) -> Window {
        Window {
            from_seconds: 0.0,
            until_seconds: self.scenario.duration_seconds,
        }
    }

    /// The end of the scenario; of the recording, if it never began.
    pub(crate) fn end_seconds(&self) -> f64 {
        match self.timeline.zero_seconds {
            Some(_) => self.scenario.duration_seconds,
            None => f64::INFINITY,
        }
    }

    /// The trace of a signal that was on the bus.
    pub(crate) fn trace(&self, name: &str) -> Result<&'a SignalTrace, Observation> {
        let path = self.setup.names().find(name);
        let path = path.map_err(|error| Observation::none(error.to_string()))?;
        if self.timeline.zero_seconds.is_none() {
            return Err(Observation::none("the scenario never began"));
        }
        let mut traces = self.timeline.traces.iter();
        let trace = traces.find(|trace| trace.path == path);
        let message = path.split('.').next().unwrap_or_default();
        trace
            .filter(|trace| !trace.samples.is_empty())
            .ok_or_else(|| Observation {
                is_unavailable: TRUTH_MESSAGES.contains(&message),
                ..Observation::none(format!("{path} never was on the bus"))
            })
    }
}

/// The samples of a window, up to but without its end.
pub(crate) fn samples_in(samples: &[SignalSample], window: Window) -> &[SignalSample] {
    let before = |limit: f64| {
        samples.partition_point(|sample| sample.time_seconds < limit - TIME_TOLERANCE_SECONDS)
    };
    let (from, until) = (before(window.from_seconds), before(window.until_seconds));
    &samples[from..until.max(from)]
}

/// The largest value over all steps or disturbances; an error counts as worse than any value.
pub(crate) fn worst(values: impl Iterator<Item = MetricValue>) -> Option<MetricValue> {
    values.reduce(|worst, value| match (worst, value) {
        (Ok(worst), Ok(value)) => Ok(f64::max(worst, value)),
        (Err(reason), _) | (_, Err(reason)) => Err(reason),
    })
}

pub(crate) fn largest(values: impl Iterator<Item = f64>) -> MetricValue {
    let largest = values.reduce(|largest, value| if value <= largest { largest } else { value });
    checked(largest.ok_or_else(no_samples)?)
}

pub(crate) fn mean(values: impl Iterator<Item = f64>) -> MetricValue {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count == 0.0 {
        Err(no_samples())
    } else {
        checked(sum / count)
    }
}

/// A position is never NaN here, so NaN means that there is no set-point.
pub(crate) fn checked(value: f64) -> MetricValue {
    if value.is_nan() {
        Err("no set-point".to_owned())
    } else {
        Ok(value)
    }
}

pub(crate) fn no_samples() -> String {
    "no position in the recording".to_owned()
}

fn only_emulated() -> String {
    "not available: only the emulated plant publishes it".to_owned()
}
