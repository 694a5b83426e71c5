//! What a verdict rests on: the decoded recording, windows of its samples, and the values that are made of them.

use std::ops::Range;
use std::rc::Rc;

use dbc::signals::{POSITION, TRUE_POSITION, TRUTH_MESSAGES};
use recording::ending::EndedBy;
use recording::timeline::{Series, TIME_TOLERANCE_SECONDS, Timeline};
use recording::traces::{SignalSample, SignalTrace, silence_seconds_max};
use rig::plan::ControlLoop;
use scenario::Scenario;
use scenario::events::Window;
use scenario::expect::Limit;
use scenario::fault::Group;
use scenario::loops::Contour;

use crate::circumstances::Circumstances;
use crate::metric::Metric;
use crate::misses::Misses;
use crate::quality::reaches;

/// One of several loops.
pub(crate) type RecordedLoop<'a> = (&'a ControlLoop, &'a Timeline);

/// What is judged, and by what.
pub(crate) struct Evidence<'a> {
    pub(crate) timeline: &'a Timeline,
    pub(crate) own: &'a ControlLoop,
    pub(crate) scenario: &'a Scenario,
    pub(crate) circumstances: &'a Circumstances,
    /// The contours of the run.
    pub(crate) contours: &'a [Contour],
    /// All loops that were played at once, where they are judged together.
    pub(crate) loops: &'a [RecordedLoop<'a>],
    misses: Rc<Misses<'a>>,
    /// The position that is judged: the measured one, or the true one beside it.
    position: &'a Series<f64>,
    /// Longest time between two samples of the position.
    pub(crate) silence_seconds_max: f64,
}

/// A value, or why there is none.
pub(crate) type MetricValue = Result<f64, Absence>;

/// Why there is no value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Absence {
    pub(crate) reason: String,
    /// The stretch of time in which nothing came, where that is why.
    silence: Option<Window>,
}

impl Absence {
    pub(crate) fn unseen(reason: impl Into<String>, silence: Window) -> Self {
        Self {
            reason: reason.into(),
            silence: Some(silence),
        }
    }

    pub(crate) fn silent(silence: Window) -> Self {
        let (from, until) = (silence.from_seconds, silence.until_seconds);
        Self::unseen(format!("silent from {from:.3} to {until:.3} s"), silence)
    }

    pub(crate) fn silent_between(from_seconds: f64, until_seconds: f64) -> Self {
        Self::silent(Window {
            from_seconds,
            until_seconds,
        })
    }

    /// The same, with the one of several that has no value.
    pub(crate) fn of(self, what: &str) -> Self {
        Self {
            reason: format!("{what}: {}", self.reason),
            ..self
        }
    }
}

impl From<String> for Absence {
    fn from(reason: String) -> Self {
        Self {
            reason,
            silence: None,
        }
    }
}

impl From<&str> for Absence {
    fn from(reason: &str) -> Self {
        reason.to_owned().into()
    }
}

/// What the recording shows of a metric.
pub(crate) enum Measurement {
    Seen(Observation),
    /// The scenario gives the metric no meaning, and this is why; that matters only where it has a limit.
    Meaningless(String),
    /// Nobody on this bus sends it, so a limit is neither met nor missed.
    Unavailable(String),
    /// Nothing is said of the metric.
    NotAsked,
}

impl From<MetricValue> for Measurement {
    fn from(value: MetricValue) -> Self {
        Self::Seen(value.into())
    }
}

impl Measurement {
    /// What only the emulated plant sends, where there is none.
    pub(crate) fn only_emulated() -> Self {
        Self::Unavailable(only_emulated())
    }

    /// The row of the verdict, if there is one.
    pub(crate) fn metric(
        self,
        evidence: &Evidence<'_>,
        name: &str,
        limit: Option<Limit>,
    ) -> Option<Metric> {
        match self {
            Self::Seen(observation) => Some(observation.metric(evidence, name.to_owned(), limit)),
            Self::Meaningless(reason) => limit.map(|_| Metric::new(name, Err(reason), limit)),
            Self::Unavailable(reason) => Some(Metric::not_judged(name, reason, limit)),
            Self::NotAsked => None,
        }
    }
}

/// What the recording shows of a metric or a check: a value, and when it was so.
pub(crate) struct Observation {
    pub(crate) value: MetricValue,
    pub(crate) at_seconds: Option<f64>,
    /// Nobody on this bus sends it, so it is neither met nor missed.
    is_unavailable: bool,
}

impl From<MetricValue> for Observation {
    fn from(value: MetricValue) -> Self {
        Self {
            value,
            at_seconds: None,
            is_unavailable: false,
        }
    }
}

impl Observation {
    pub(crate) fn at(value: MetricValue, at_seconds: f64) -> Self {
        Self {
            at_seconds: Some(at_seconds),
            ..value.into()
        }
    }

    pub(crate) fn none(reason: impl Into<Absence>) -> Self {
        Err(reason.into()).into()
    }

    /// The row of the verdict. What a node kept from being seen is missed, what the bench did is not judged.
    pub(crate) fn metric(
        self,
        evidence: &Evidence<'_>,
        name: String,
        limit: Option<Limit>,
    ) -> Metric {
        if self.is_unavailable {
            return Metric::not_judged(name, only_emulated(), limit);
        }
        match self.value {
            Err(Absence {
                reason,
                silence: Some(silence),
            }) if evidence.is_of_the_bench(silence) => Metric::not_judged(name, reason, limit),
            value => {
                let value = value.map_err(|absence| absence.reason);
                Metric::new(name, value, limit).at(self.at_seconds)
            }
        }
    }
}

/// Set-points that differ by less are the same: they are computed in metres and from sines, and rounding parts two of them.
pub(crate) const SAME_MILLIMETRES_MAX: f64 = 1e-6;

/// Set-point and position of one cycle.
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

    pub(crate) fn has_set_point_of(&self, other: &Self) -> bool {
        (self.set_point_millimetres - other.set_point_millimetres).abs() < SAME_MILLIMETRES_MAX
    }
}

impl<'a> Evidence<'a> {
    pub(crate) fn new(
        timeline: &'a Timeline,
        own: &'a ControlLoop,
        circumstances: &'a Circumstances,
    ) -> Self {
        let scenario = &own.scenario;
        let period = scenario.bus.sync_period();
        let message = POSITION.split('.').next().unwrap_or_default();
        let silence = silence_seconds_max(message, period, &own.database);
        Self {
            timeline,
            own,
            scenario,
            circumstances,
            contours: &[],
            loops: &[],
            misses: Rc::new(Misses::new(timeline, own, circumstances)),
            position: timeline.position(),
            silence_seconds_max: silence,
        }
    }

    /// The same among all loops of the run.
    pub(crate) fn among(self, contours: &'a [Contour], loops: &'a [RecordedLoop<'a>]) -> Self {
        Self {
            contours,
            loops,
            ..self
        }
    }

    /// That of one of the loops.
    pub(crate) fn of_loop(&self, name: &str) -> Option<Self> {
        let mut loops = self.loops.iter();
        let (own, timeline) = loops.find(|(own, _)| own.name() == name)?;
        Some(Self::new(timeline, own, self.circumstances).among(self.contours, self.loops))
    }

    /// The cycles that were missed, and whose doing that was.
    pub(crate) fn misses(&self) -> &Misses<'a> {
        &self.misses
    }

    /// As the plant itself was; none where its sensor and it are sound, or it reports nothing of itself.
    pub(crate) fn of_the_truth(&self) -> Option<Self> {
        let mut groups = self.scenario.own_faults().map(|fault| fault.kind.group);
        if !groups.any(|group| [Group::Sensor, Group::Plant].contains(&group)) {
            return None;
        }
        let column = self.timeline.column(TRUE_POSITION)?;
        let is_known = column.values.iter().any(|value| !value.is_nan());
        is_known.then_some(Self {
            position: &column.values,
            misses: Rc::clone(&self.misses),
            ..*self
        })
    }

    /// The samples of a window, up to but without its end; cycles without a position are left out.
    pub(crate) fn samples(&self, window: Window) -> impl Iterator<Item = CycleSample> {
        let timeline = self.timeline;
        let rows = self.rows(window);
        let times = timeline.time_seconds.range(rows.clone());
        let set_points = timeline.set_point_millimetres.range(rows.clone());
        // The true position holds until the drive sends another; where the drive is silent there is none.
        let measured = timeline.position().range(rows.clone());
        let positions = self.position.range(rows).zip(measured);
        let rows = times.zip(set_points).zip(positions);
        rows.filter_map(|((time, set_point), (position, measured))| {
            let sample = CycleSample {
                time_seconds: *time,
                set_point_millimetres: *set_point,
                position_millimetres: *position,
            };
            let is_missing = measured.is_nan() || position.is_nan();
            (!is_missing).then_some(sample)
        })
    }

    /// The rows of a window, up to but without its end.
    fn rows(&self, window: Window) -> Range<usize> {
        let times = &self.timeline.time_seconds;
        let before =
            |limit: f64| times.partition_point(|time| *time < limit - TIME_TOLERANCE_SECONDS);
        let (from, until) = (before(window.from_seconds), before(window.until_seconds));
        from..until.max(from)
    }

    /// The samples of a window in which the drive never was silent.
    ///
    /// # Errors
    /// It was, or there is no sample.
    pub(crate) fn seen(
        &self,
        window: Window,
    ) -> Result<impl Iterator<Item = CycleSample>, Absence> {
        let mut times = self.samples(window).map(|sample| sample.time_seconds);
        if times.next().is_none() {
            return Err(self.no_position(window));
        }
        let times = self.samples(window).map(|sample| sample.time_seconds);
        match first_silence(times, window, self.silence_seconds_max) {
            Some(silence) => Err(Absence::silent(silence)),
            None => Ok(self.samples(window)),
        }
    }

    /// Why a window is empty.
    pub(crate) fn no_position(&self, window: Window) -> Absence {
        let reason = if self.position.iter().all(|position| position.is_nan()) {
            "no position in the recording".to_owned()
        } else {
            let (from, until) = (window.from_seconds, window.until_seconds);
            format!("no position from {from:.3} to {until:.3} s")
        };
        Absence::unseen(reason, window)
    }

    /// Whether so long without a position is a silence.
    pub(crate) fn is_silence(&self, from_seconds: f64, until_seconds: f64) -> bool {
        until_seconds - from_seconds > self.silence_seconds_max + TIME_TOLERANCE_SECONDS
    }

    /// Where the SYNC was silent up to the end of what is judged.
    pub(crate) fn silence_of_sync(&self) -> Option<Window> {
        let silence = Window {
            from_seconds: self.timeline.due_seconds(),
            until_seconds: self.scenario.judged_end_seconds(),
        };
        self.is_silence(silence.from_seconds, silence.until_seconds)
            .then_some(silence)
    }

    /// Whether a silence is the bench's doing, and not that of a node: the run broke off, its recording did, or every cycle in it
    /// was missed for a stall.
    fn is_of_the_bench(&self, silence: Window) -> bool {
        self.is_cut_before(silence.until_seconds) || self.misses.are_of_the_bench_in(silence)
    }

    /// Whether the bench or the user kept from being seen what came before a time.
    pub(crate) fn is_cut_before(&self, seconds: f64) -> bool {
        match &self.circumstances.ended_early {
            Some(end) => end.by != EndedBy::Node,
            None => !reaches(self.timeline, seconds),
        }
    }

    /// The window of all that is judged of the loop.
    pub(crate) fn whole(&self) -> Window {
        Window {
            from_seconds: 0.0,
            until_seconds: self.scenario.judged_end_seconds(),
        }
    }

    /// The window of the whole scenario.
    pub(crate) fn run(&self) -> Window {
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
        let path = self
            .own
            .names()
            .find(name)
            .map_err(|error| Observation::none(error.to_string()))?;
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

/// The first stretch of a window without a sample that is longer than it may be.
pub(crate) fn first_silence(
    times_seconds: impl Iterator<Item = f64>,
    window: Window,
    seconds_max: f64,
) -> Option<Window> {
    let mut from_seconds = window.from_seconds;
    for until_seconds in times_seconds.chain([window.until_seconds]) {
        if until_seconds - from_seconds > seconds_max + TIME_TOLERANCE_SECONDS {
            return Some(Window {
                from_seconds,
                until_seconds,
            });
        }
        from_seconds = until_seconds;
    }
    None
}

/// The largest value over all steps or disturbances; an error counts as worse than any value.
pub(crate) fn worst(values: impl Iterator<Item = MetricValue>) -> Option<MetricValue> {
    values.reduce(|worst, value| match (worst, value) {
        (Ok(worst), Ok(value)) => Ok(f64::max(worst, value)),
        (Err(reason), _) | (_, Err(reason)) => Err(reason),
    })
}

/// How far a value is within a limit; negative beyond it.
pub(crate) fn margin(value: f64, limit: Limit) -> f64 {
    let above_min = limit.min.map_or(f64::INFINITY, |min| value - min);
    let below_max = limit.max.map_or(f64::INFINITY, |max| max - value);
    above_min.min(below_max)
}

/// The largest of some values, of which there is one at least.
pub(crate) fn largest(values: impl Iterator<Item = f64>) -> MetricValue {
    let largest = values.reduce(|largest, value| if value <= largest { largest } else { value });
    checked(largest.unwrap_or(f64::NAN))
}

/// The mean of some values, of which there is one at least.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> MetricValue {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    checked(sum / count)
}

/// A position is never NaN here, so NaN means that there is no set-point.
pub(crate) fn checked(value: f64) -> MetricValue {
    if value.is_nan() {
        Err("no set-point".into())
    } else {
        Ok(value)
    }
}

fn only_emulated() -> String {
    "not available: only the emulated plant publishes it".to_owned()
}
