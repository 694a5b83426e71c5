//! The basis of a verdict: the decoded recording, windows of its samples, and the values that follow from them.

use std::ops::Range;
use std::rc::Rc;

use dbc::Database;
use dbc::names::{self, TPDO1, TRUE_POSITION};
use plan::ControlLoop;
use recording::ending::{EarlyEnd, EndedBy};
use recording::timeline::{Series, TIME_TOLERANCE_SECONDS, Timeline};
use recording::traces::{SignalSample, SignalTrace, silence_seconds_max};
use scenario::Trial;
use scenario::contour::Contour;
use scenario::events::Window;
use scenario::expect::{ExpectedRow, rounded};

use crate::attribution::stalls::{Spans, Stretch, longest, shadows};
use crate::attribution::{Attribution, Commands};
use crate::circumstances::Circumstances;
use crate::duties::undecided_period;
use crate::metric::{Metric, Unstored};
use crate::quality::reaches;

/// One of several loops, with its timeline.
pub(crate) type RecordedLoop<'a> = (&'a ControlLoop, &'a Timeline);

/// Recording of a loop, and the criteria by which it is judged.
#[derive(Clone)]
pub(crate) struct Evidence<'a> {
    /// Meaning of all frames on the bus.
    pub(crate) database: &'a Database,
    pub(crate) timeline: &'a Timeline,
    pub(crate) control_loop: &'a ControlLoop,
    pub(crate) trial: &'a Trial,
    pub(crate) circumstances: &'a Circumstances,
    /// Contours of the run.
    pub(crate) contours: &'a [Contour],
    /// All loops that were played at once, if they are judged together.
    pub(crate) loops: &'a [RecordedLoop<'a>],
    /// Attribution of the loop's breaches.
    pub(crate) attribution: Rc<Attribution<'a>>,
    /// Times that are left out, to judge the rest without the pieces that stalls explain.
    left_out: Option<LeftOut>,
    /// Position that is judged: the measured one or the true one.
    position: Series<f64>,
    /// Longest time between two samples of the position.
    pub(crate) silence_seconds_max: f64,
}

/// Pieces of a run that stalls explain.
#[derive(Clone)]
struct LeftOut {
    times: Rc<Spans>,
    only_long: bool,
}

/// Value, or the reason why there is none.
pub(crate) type MetricValue = Result<f64, Absence>;

/// Measurement of a metric or a check in the recording.
pub(crate) type Measurement = Result<Known, Absence>;

/// Value of a metric or a check.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known {
    pub(crate) value: f64,
    pub(crate) at_seconds: Option<f64>,
    /// Whether it can only grow by what is left out.
    pub(crate) is_least: bool,
}

impl From<f64> for Known {
    fn from(value: f64) -> Self {
        Self {
            value,
            at_seconds: None,
            is_least: false,
        }
    }
}

impl Known {
    pub(crate) fn at(value: f64, at_seconds: f64) -> Self {
        Self {
            at_seconds: Some(at_seconds),
            ..value.into()
        }
    }

    fn at_least(value: f64) -> Self {
        Self {
            is_least: true,
            ..value.into()
        }
    }
}

/// Reason why there is no value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Absence {
    pub(crate) reason: String,
    /// Time of the sample that shows the reason.
    pub(crate) at_seconds: Option<f64>,
    why: Why,
}

/// Meaning of an absence for a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Why {
    /// The loop did not do what is measured.
    NotDone,
    /// No sample came in this stretch of time.
    Unseen(Window),
    /// Stalls explain all samples that the value would need.
    LeftOut,
    /// No node on this bus sends the value, so a limit is neither met nor missed.
    Unavailable,
    /// The scenario gives the metric no meaning; relevant only if it has a limit.
    Meaningless,
    /// The metric is not reported.
    NotAsked,
}

impl Absence {
    fn new(reason: impl Into<String>, why: Why) -> Self {
        Self {
            reason: reason.into(),
            at_seconds: None,
            why,
        }
    }

    pub(crate) fn left_out() -> Self {
        Self::new("only in what stalls explain", Why::LeftOut)
    }

    pub(crate) fn unseen(reason: impl Into<String>, silence: Window) -> Self {
        Self::new(reason, Why::Unseen(silence))
    }

    pub(crate) fn unavailable(reason: impl Into<String>) -> Self {
        Self::new(reason, Why::Unavailable)
    }

    /// Returns the absence of a value that only the emulated plant sends.
    pub(crate) fn only_emulated() -> Self {
        Self::unavailable("not available: only the emulated plant publishes it")
    }

    pub(crate) fn meaningless(reason: impl Into<String>) -> Self {
        Self::new(reason, Why::Meaningless)
    }

    pub(crate) fn nothing() -> Self {
        Self::meaningless("nothing to measure")
    }

    pub(crate) fn not_asked() -> Self {
        Self::new("", Why::NotAsked)
    }

    pub(crate) fn silent(silence: Window) -> Self {
        Self::unseen(format!("silent {silence}"), silence)
    }

    /// Adds the time of the sample that shows the reason.
    pub(crate) fn at(self, seconds: f64) -> Self {
        Self {
            at_seconds: Some(seconds),
            ..self
        }
    }

    /// Adds the name of the one of several that has no value.
    pub(crate) fn of(self, what: &str) -> Self {
        Self::new(format!("{what}: {}", self.reason), self.why)
    }
}

impl<T: AsRef<str>> From<T> for Absence {
    fn from(reason: T) -> Self {
        Self::new(reason.as_ref(), Why::NotDone)
    }
}

/// Least time within a band for a stay; a shorter one may be a passage.
pub(crate) const STAY_SECONDS: f64 = 0.1;

/// Largest difference of equal set-points: they are computed from sines, and rounding separates two of them.
pub(crate) const SAME_MAX: f64 = 1e-6;

/// Edge of a band of 1, which is inside it: a difference of decimal numbers is rounded.
pub(crate) const EDGE: f64 = 1.0 + 1e-9;

/// Set-point and position in one cycle.
#[derive(Clone, Copy)]
pub(crate) struct CycleSample {
    pub(crate) time_seconds: f64,
    pub(crate) set_point: f64,
    pub(crate) position: f64,
}

impl CycleSample {
    pub(crate) fn deviation(&self) -> f64 {
        (self.position - self.set_point).abs()
    }

    pub(crate) fn has_same_set_point(&self, other: &Self) -> bool {
        (self.set_point - other.set_point).abs() <= SAME_MAX
    }
}

impl<'a> Evidence<'a> {
    pub(crate) fn new(
        database: &'a Database,
        timeline: &'a Timeline,
        control_loop: &'a ControlLoop,
        circumstances: &'a Circumstances,
    ) -> Self {
        let one = (database, control_loop);
        Self {
            database,
            timeline,
            control_loop,
            trial: &control_loop.trial,
            circumstances,
            contours: &[],
            loops: &[],
            attribution: Rc::new(Attribution::new(timeline, one, circumstances)),
            left_out: None,
            position: timeline.position().clone(),
            silence_seconds_max: drive_silence_seconds_max(one, TPDO1),
        }
    }

    /// Returns the same evidence among all loops of the run.
    pub(crate) fn among(self, contours: &'a [Contour], loops: &'a [RecordedLoop<'a>]) -> Self {
        Self {
            contours,
            loops,
            ..self
        }
    }

    /// Returns the evidence of one of the loops.
    pub(crate) fn for_loop(&self, name: &str) -> Option<Self> {
        let mut loops = self.loops.iter();
        let (control_loop, timeline) =
            loops.find(|(control_loop, _)| control_loop.name() == name)?;
        let evidence = Self::new(self.database, timeline, control_loop, self.circumstances)
            .among(self.contours, self.loops);
        Some(match &self.left_out {
            None => evidence,
            Some(left_out) => evidence.rest(left_out.only_long),
        })
    }

    /// Returns the stalls that explain breaches of the loop.
    fn stalls(&self) -> Vec<Stretch> {
        let mut stalls = self.attribution.cycles.stalls.clone();
        for commands in [Commands::Missed, Commands::Late] {
            stalls.extend_from_slice(&commands.totals(self).stalls);
        }
        stalls.extend(undecided_period(self));
        stalls
    }

    /// Returns the contours that are judged with the loop, which is their first.
    pub(crate) fn own_contours(&self) -> impl Iterator<Item = &'a Contour> {
        let name = self.control_loop.name();
        let is_first =
            move |contour: &&Contour| matches!(&contour.loops[..], [first, ..] if first == name);
        self.contours.iter().filter(is_first)
    }

    /// Returns the longest stall that explains a breach of the loop, or of a loop of its contours.
    pub(crate) fn longest_stall(&self) -> Option<Stretch> {
        let axes = self.own_contours().flat_map(|contour| &contour.loops);
        let of_axes = axes
            .filter_map(|name| self.for_loop(name))
            .flat_map(|axis| axis.stalls());
        longest(&Vec::from_iter(of_axes.chain(self.stalls())))
    }

    /// Returns the same evidence without the pieces that stalls explain, or only without those of the long ones.
    pub(crate) fn rest(&self, only_long: bool) -> Self {
        let times = shadows(&self.stalls(), self.timeline.period_seconds, only_long);
        let times = Rc::new(times);
        Self {
            left_out: Some(LeftOut { times, only_long }),
            ..self.clone()
        }
    }

    /// Returns a row of the verdict, if there is one. A value that a node kept from being seen is missed; one that the bench
    /// kept from it is not judged, unless what is known of it is too large already.
    pub(crate) fn row(&self, expected: ExpectedRow, measurement: Measurement) -> Option<Metric> {
        let (name, limit) = (expected.name, expected.limit);
        let mut row = match measurement {
            Ok(known) => {
                let mut row = Metric::new(name, Ok(known.value), limit).at(known.at_seconds);
                if known.is_least {
                    let max = limit.and_then(|limit| limit.max);
                    let is_too_large = max.is_some_and(|max| rounded(known.value) > max);
                    row.passed = is_too_large.then_some(false);
                }
                row
            }
            Err(absence) => {
                let is_judged = match absence.why {
                    Why::NotAsked => return None,
                    Why::Meaningless if limit.is_none() => return None,
                    Why::LeftOut | Why::Unavailable => false,
                    Why::Unseen(silence) => !self.is_of_the_bench(silence),
                    Why::NotDone | Why::Meaningless => true,
                };
                if is_judged {
                    Metric::new(name, Err(absence.reason), limit).at(absence.at_seconds)
                } else {
                    Metric {
                        is_unavailable: Unstored(matches!(absence.why, Why::Unavailable)),
                        ..Metric::not_judged(name, absence.reason, limit)
                    }
                }
            }
        };
        row.requirements = expected.requirements;
        Some(row)
    }

    /// Returns the value of an event in its window. If a part of the window is left out, it is at least that until a stall touches
    /// the window. A time that has not ended by then is longer.
    pub(crate) fn of_event(
        &self,
        window: Window,
        is_time: bool,
        value: impl FnOnce(&Self, Window) -> MetricValue,
    ) -> Measurement {
        let all = Self {
            left_out: None,
            ..self.clone()
        };
        let touched = self.left_out_from(window.from_seconds, window.until_seconds);
        let Some(touched_at) = touched else {
            return value(&all, window).map(Known::from);
        };
        let cut = Window {
            until_seconds: touched_at.max(window.from_seconds),
            ..window
        };
        let longer_than = cut.until_seconds - cut.from_seconds - STAY_SECONDS;
        match value(&all, cut) {
            Ok(value) => Ok(Known::at_least(value)),
            Err(absence) if matches!(absence.why, Why::Unseen(_)) => Err(Absence::left_out()),
            Err(_) if is_time => Ok(Known::at_least(longer_than)),
            Err(absence) => Err(absence),
        }
    }

    /// Returns the largest value of a window. If a part of the window is left out, it is at least that of the rest.
    pub(crate) fn of_largest(&self, window: Window, largest: MetricValue) -> Measurement {
        Ok(Known {
            is_least: self.leaves_out(window.from_seconds, window.until_seconds),
            ..largest?.into()
        })
    }

    /// Returns the stall that explains an end of the run by a node: one that covers half of the time in which the node was at
    /// fault, or that had moved the loop.
    pub(crate) fn stall_of_end(&self, end: &EarlyEnd) -> Option<Stretch> {
        let until = end.at_seconds?;
        let one = self.control_loop;
        let node = if end.node.as_ref() == Some(&one.drive().name) {
            one.drive_index()
        } else {
            one.controller_index()
        };
        let from = end.since_seconds.unwrap_or(until);
        self.attribution.stall(node, from, until)
    }

    /// Returns the stall that explains missing frames of the controller.
    pub(crate) fn stall_of_controller(&self, from: f64, until: f64) -> Option<Stretch> {
        let controller = self.control_loop.controller_index();
        self.attribution.stall(controller, from, until)
    }

    /// Returns the times at which the set-point changes, in order.
    pub(crate) fn set_point_changes(&self) -> impl Iterator<Item = f64> {
        let mut latest = None;
        self.samples(self.whole()).filter_map(move |sample| {
            let before: Option<CycleSample> = latest.replace(sample);
            let is_other = !sample.has_same_set_point(&before?);
            is_other.then_some(sample.time_seconds)
        })
    }

    /// Returns whether the pieces that stalls explain count.
    pub(crate) fn has_all(&self) -> bool {
        self.left_out.is_none()
    }

    /// Returns whether a part of a stretch of time is left out.
    pub(crate) fn leaves_out(&self, from_seconds: f64, until_seconds: f64) -> bool {
        self.left_out_from(from_seconds, until_seconds).is_some()
    }

    /// Returns the begin of the first piece that is left out of a stretch of time.
    fn left_out_from(&self, from_seconds: f64, until_seconds: f64) -> Option<f64> {
        let left_out = self.left_out.as_ref()?;
        left_out.times.first_in(from_seconds, until_seconds)
    }

    /// Returns the first stretch of a window without a sample that is longer than allowed, and not left out.
    pub(crate) fn first_silence(
        &self,
        times_seconds: impl Iterator<Item = f64>,
        window: Window,
        seconds_max: f64,
    ) -> Option<Window> {
        let longest = seconds_max + TIME_TOLERANCE_SECONDS;
        let mut from = window.from_seconds;
        let mut untils = times_seconds.chain([window.until_seconds]);
        untils.find_map(|until| {
            let silence = Window::new(std::mem::replace(&mut from, until), until);
            let seconds = until - silence.from_seconds;
            let left_out = self.left_out.as_ref().filter(|_| seconds > longest);
            let explained = left_out.map_or(0.0, |left_out| {
                left_out.times.seconds_in(silence.from_seconds, until)
            });
            (seconds - explained > longest).then_some(silence)
        })
    }

    /// Returns the evidence with the true position, in the cycles in which it was published; `None` if it is not judged, or the
    /// plant does not report itself.
    pub(crate) fn of_the_truth(&self) -> Option<Self> {
        let name = self.trial.wiring.quantities.name(TRUE_POSITION);
        let judged = Some(&name).filter(|_| self.trial.has_true_metrics());
        let trace = self.trace(judged?).ok()?;
        let mut samples = trace.samples.iter().peekable();
        let times = self.timeline.time_seconds.iter();
        let position = times.map(|time| {
            while samples.next_if(|one| one.time_seconds < time).is_some() {}
            let sample = samples.next_if(|one| one.time_seconds == time);
            sample.map_or(f64::NAN, |one| one.value)
        });
        let position = Series::from_iter(position);
        let silence_seconds_max = trace.silence_seconds_max?;
        let is_known = position.iter().any(|value| !value.is_nan());
        is_known.then(|| Self {
            position,
            silence_seconds_max,
            ..self.clone()
        })
    }

    /// Returns the samples of a window without its end; cycles without a position are left out.
    pub(crate) fn samples(&self, window: Window) -> impl Iterator<Item = CycleSample> {
        let timeline = self.timeline;
        let rows = self.rows(window);
        let times = timeline.time_seconds.range(rows.clone());
        let set_points = timeline.set_point().range(rows.clone());
        let rows = times.zip(set_points).zip(self.position.range(rows));
        rows.filter_map(|((time, set_point), position)| {
            let sample = CycleSample {
                time_seconds: time,
                set_point,
                position,
            };
            (!position.is_nan() && !self.leaves_out(time, time)).then_some(sample)
        })
    }

    /// Returns the values of a signal in a window without its end, each with its time; cycles without a value are left out.
    pub(crate) fn values(
        &self,
        values: &Series<f64>,
        window: Window,
    ) -> impl Iterator<Item = (f64, f64)> {
        let rows = self.rows(window);
        let times = self.timeline.time_seconds.range(rows.clone());
        let values = times.zip(values.range(rows));
        values.filter(|(time, value)| !value.is_nan() && !self.leaves_out(*time, *time))
    }

    /// Returns the rows of a window without its end.
    fn rows(&self, window: Window) -> Range<usize> {
        let times = &self.timeline.time_seconds;
        rows(window, |limit| times.partition_point(|time| time < limit))
    }

    /// Returns the samples of a window in which the drive was never silent.
    ///
    /// # Errors
    /// The drive was silent, or there is no sample.
    pub(crate) fn seen(
        &self,
        window: Window,
    ) -> Result<impl Iterator<Item = CycleSample>, Absence> {
        let mut times = self
            .samples(window)
            .map(|sample| sample.time_seconds)
            .peekable();
        if times.peek().is_none() {
            return Err(self.no_position(window));
        }
        match self.first_silence(times, window, self.silence_seconds_max) {
            Some(silence) => Err(Absence::silent(silence)),
            None => Ok(self.samples(window)),
        }
    }

    /// Returns the name of the quantity that the amplifier puts out.
    pub(crate) fn command_name(&self) -> String {
        self.trial.wiring.quantities.output.words()
    }

    /// Returns the reason why a window is empty.
    pub(crate) fn no_position(&self, window: Window) -> Absence {
        let silence = self.first_silence([].into_iter(), window, self.silence_seconds_max);
        if !self.has_all() && silence.is_none() {
            return Absence::left_out();
        }
        let signal = &self.trial.wiring.feedback.quantity.name;
        let reason = if self.position.iter().all(|position| position.is_nan()) {
            format!("no {signal} in the recording")
        } else {
            format!("no {signal} {window}")
        };
        Absence::unseen(reason, window)
    }

    /// Returns whether this time without a position is a silence.
    pub(crate) fn is_silence(&self, from_seconds: f64, until_seconds: f64) -> bool {
        until_seconds - from_seconds > self.silence_seconds_max + TIME_TOLERANCE_SECONDS
    }

    /// Returns the silence of the SYNC up to the end of the judged time.
    pub(crate) fn silence_of_sync(&self) -> Option<Window> {
        let timeline = self.timeline;
        let from = timeline.cycle_start_seconds(timeline.cycles_due);
        let until = self.trial.judged_end_seconds();
        self.is_silence(from, until)
            .then(|| Window::new(from, until))
    }

    /// Returns whether the bench caused a silence, and not a node: the run broke off, its recording did, or every cycle in the
    /// silence was missed because of a stall.
    fn is_of_the_bench(&self, silence: Window) -> bool {
        self.is_cut_before(silence.until_seconds) || self.attribution.is_of_the_host(silence)
    }

    /// Returns whether the bench or the user kept frames before a time from being seen.
    pub(crate) fn is_cut_before(&self, seconds: f64) -> bool {
        match &self.circumstances.ended_early {
            Some(end) => end.by != EndedBy::Node,
            None => !reaches(self.timeline, seconds),
        }
    }

    /// Returns the window in which the loop is judged.
    pub(crate) fn whole(&self) -> Window {
        Window::new(0.0, self.trial.judged_end_seconds())
    }

    /// Returns the window of the whole scenario.
    pub(crate) fn run(&self) -> Window {
        Window::new(0.0, self.trial.run.duration_seconds)
    }

    /// Returns the end of the scenario, or of the recording if the scenario never began.
    pub(crate) fn end_seconds(&self) -> f64 {
        match self.timeline.zero_seconds {
            Some(_) => self.trial.run.duration_seconds,
            None => f64::INFINITY,
        }
    }

    /// Returns the trace of a signal that was on the bus.
    pub(crate) fn trace(&self, name: &str) -> Result<&'a SignalTrace, Absence> {
        let one = self.control_loop;
        // An external drive publishes no truth.
        let is_external = one.drive().is_external();
        let path = one.names().find(name).map_err(|objection| {
            let unavailable = is_external.then(Absence::only_emulated);
            unavailable.unwrap_or_else(|| objection.message.into())
        })?;
        if self.timeline.zero_seconds.is_none() {
            return Err("the scenario never began".into());
        }
        let mut traces = self.timeline.traces.iter();
        let trace = traces.find(|trace| trace.path == path && !trace.samples.is_empty());
        trace.ok_or_else(|| {
            let unavailable = one.is_truth(path).then(Absence::only_emulated);
            unavailable.unwrap_or_else(|| format!("{path} never was on the bus").into())
        })
    }
}

/// Returns the longest time between two messages of a kind that the drive of a loop sends.
pub(crate) fn drive_silence_seconds_max(
    (database, one): (&Database, &ControlLoop),
    service: &str,
) -> f64 {
    let message = names::message(&one.drive().name, service);
    silence_seconds_max(&message, database, one)
}

/// Returns the rows of a window without its end; `before` counts the rows before a time.
fn rows(window: Window, before: impl Fn(f64) -> usize) -> Range<usize> {
    let [from, until] = [window.from_seconds, window.until_seconds]
        .map(|limit| before(limit - TIME_TOLERANCE_SECONDS));
    from..until.max(from)
}

/// Returns the samples of a window without its end.
pub(crate) fn samples_in(samples: &Series<SignalSample>, window: Window) -> Series<SignalSample> {
    let before = |limit| samples.partition_point(|sample| sample.time_seconds < limit);
    samples.part(rows(window, before))
}

/// Returns the largest value over all steps or disturbances, of which there is at least one. An error counts as worse than any
/// value. One that is left out may be larger than the others.
pub(crate) fn worst(values: impl Iterator<Item = Measurement>) -> Measurement {
    let worst = values.reduce(|worst, value| match (worst, value) {
        (Ok(worst), Ok(value)) => Ok(Known {
            is_least: worst.is_least || value.is_least,
            ..f64::max(worst.value, value.value).into()
        }),
        (Err(absence), other) | (other, Err(absence)) if absence.why == Why::LeftOut => {
            other.map(|known| Known::at_least(known.value))
        }
        (Err(absence), _) | (_, Err(absence)) => Err(absence),
    });
    worst.unwrap_or_else(|| Err(Absence::nothing()))
}

/// Returns the largest of some values, of which there is at least one.
pub(crate) fn largest(values: impl Iterator<Item = f64>) -> MetricValue {
    let largest = values.reduce(|largest, value| if value <= largest { largest } else { value });
    checked(largest.unwrap_or(f64::NAN))
}

/// Returns the mean of some values, of which there is at least one.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> MetricValue {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    checked(sum / count)
}

/// Checks a value for NaN, which means that there is no set-point, since a position is never NaN here.
pub(crate) fn checked(value: f64) -> MetricValue {
    if value.is_nan() {
        Err("no set-point".into())
    } else {
        Ok(value)
    }
}
