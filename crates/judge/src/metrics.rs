//! What a run came to, in numbers, each with its limit.

use scenario::Scenario;
use scenario::events::{JudgedStep, Window};
use scenario::expect::Limit;

use super::{BUS_LOAD, reactions, sequences, signals};
use crate::harmonic::Harmonic;
use crate::verdict::Metric;
use recording::timeline::Timeline;
use rig::setup::Setup;

/// Half the width of the settling band, by the height of the step (PAPER, "Definitions").
pub const SETTLING_BAND: f64 = 0.05;
/// A deviation within this counts as recovered from a disturbance: four steps of a 10-bit converter over 60 mm.
const RECOVERY_BAND_MILLIMETRES: f64 = 0.25;
/// A disturbance is watched this long after its end.
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;
/// The steady state is the mean over this time before the end.
const STEADY_STATE_SECONDS: f64 = 0.5;
/// Sample times are multiples of the period; this absorbs their rounding.
pub(super) const TIME_TOLERANCE_SECONDS: f64 = 1e-9;

/// Metrics of what the fan and load module does.
const DISTURBANCE_METRICS: [&str; 2] = ["maximum_deviation_millimetres", "recovery_time_seconds"];
const NO_FAN: &str = "not available: no fan on the bus";

/// What is judged, and by what.
pub(super) struct Run<'a> {
    pub(super) timeline: &'a Timeline,
    pub(super) setup: &'a Setup,
    pub(super) scenario: &'a Scenario,
}

/// A metric's value, or why there is none.
pub(super) type Value = Result<f64, String>;

impl<'a> Run<'a> {
    pub(super) fn new(timeline: &'a Timeline, setup: &'a Setup) -> Self {
        Self {
            timeline,
            setup,
            scenario: &setup.scenario,
        }
    }
}

impl Run<'_> {
    /// All metrics that the scenario gives a meaning to or a limit.
    pub(super) fn metrics(&self) -> Vec<Metric> {
        let expect = &self.scenario.expect;
        let [gain, phase, offset] = self.sine_response();
        let all: [(&'static str, Value, Option<Limit>); 14] = [
            (
                "settling_time_seconds",
                self.worst_step(settling_time),
                expect.settling_time_seconds,
            ),
            (
                "overshoot_percent",
                self.worst_step(overshoot),
                expect.overshoot_percent,
            ),
            (
                "steady_state_error_millimetres",
                self.steady_state_error(),
                expect.steady_state_error_millimetres,
            ),
            (
                "tracking_error_millimetres_rms",
                self.tracking_error(),
                expect.tracking_error_millimetres_rms,
            ),
            ("sine_gain", gain, expect.sine_gain),
            ("sine_phase_degrees", phase, expect.sine_phase_degrees),
            (
                "sine_offset_millimetres",
                offset,
                expect.sine_offset_millimetres,
            ),
            (
                "maximum_deviation_millimetres",
                self.worst_disturbance(deviation),
                expect.maximum_deviation_millimetres,
            ),
            (
                "recovery_time_seconds",
                self.worst_disturbance(recovery),
                expect.recovery_time_seconds,
            ),
            (
                "position_millimetres_max",
                self.position_max(),
                expect.position_millimetres_max,
            ),
            (
                "current_amperes_rms",
                self.current_rms(),
                expect.current_amperes_rms,
            ),
            (
                "missed_cycles_percent",
                Ok(self.timeline.missed_cycles_percent()),
                expect.missed_cycles_percent,
            ),
            (
                BUS_LOAD,
                traffic(self.timeline.bus_load_percent),
                expect.bus_load_percent,
            ),
            (
                "sync_interval_milliseconds_max",
                traffic(self.timeline.sync_interval_milliseconds_max),
                expect.sync_interval_milliseconds_max,
            ),
        ];
        let all = all
            .into_iter()
            .filter(|(_, value, limit)| value.is_ok() || limit.is_some());
        let all = all.map(|(name, value, limit)| self.metric(name, value, limit));
        let mut all: Vec<Metric> = all
            .chain(reactions::metrics(self))
            .chain(signals::metrics(self))
            .chain(sequences::metrics(self))
            .collect();
        let requirements = expect.requirements_of_rows();
        for metric in &mut all {
            let own = requirements.get(&metric.name);
            metric.requirements = own.cloned().unwrap_or_default();
        }
        all
    }

    fn metric(&self, name: &'static str, value: Value, limit: Option<Limit>) -> Metric {
        if DISTURBANCE_METRICS.contains(&name) && value.is_ok() && !self.timeline.has_fan {
            return Metric::not_judged(name, NO_FAN.to_owned(), limit);
        }
        Metric::new(name, value, limit)
    }

    /// The samples `(time, set-point, position)` in a stretch of time; cycles without a position are left out.
    fn samples(&self, window: Window) -> impl Iterator<Item = (f64, f64, f64)> {
        let timeline = self.timeline;
        let times = timeline.time_seconds.iter().copied();
        let samples = times.zip(
            timeline
                .set_point_millimetres
                .iter()
                .copied()
                .zip(timeline.position().iter().copied()),
        );
        let samples = samples.map(|(time, (set_point, position))| (time, set_point, position));
        samples.filter(move |(time, _, position)| {
            let is_inside = *time >= window.from_seconds - TIME_TOLERANCE_SECONDS
                && *time < window.until_seconds - TIME_TOLERANCE_SECONDS;
            is_inside && !position.is_nan()
        })
    }

    /// The whole run.
    fn whole(&self) -> Window {
        Window {
            from_seconds: 0.0,
            until_seconds: self.scenario.duration_seconds,
        }
    }

    /// The largest value over all steps.
    fn worst_step(&self, metric: fn(&Self, &JudgedStep) -> Value) -> Value {
        worst(
            self.scenario
                .judged_steps()
                .iter()
                .map(|step| metric(self, step)),
        )
        .unwrap_or(Err("no step in the scenario".to_owned()))
    }

    /// The largest value over all disturbances, each watched for some time after its end.
    fn worst_disturbance(&self, metric: fn(&Self, Window) -> Value) -> Value {
        let windows = self.scenario.disturbance_windows();
        let values = windows.iter().map(|disturbance| {
            let mut window = disturbance.window;
            window.until_seconds += AFTER_DISTURBANCE_SECONDS;
            metric(self, window)
        });
        worst(values).unwrap_or(Err("no disturbance in the scenario".to_owned()))
    }

    fn steady_state_error(&self) -> Value {
        let until_seconds = self.scenario.duration_seconds;
        let window = Window {
            from_seconds: until_seconds - STEADY_STATE_SECONDS,
            until_seconds,
        };
        let set_points = || self.samples(window).map(|(_, set_point, _)| set_point);
        if set_points()
            .zip(set_points().skip(1))
            .any(|(before, after)| before != after)
        {
            return Err("the set-point moves at the end".to_owned());
        }
        mean(
            self.samples(window)
                .map(|(_, set_point, position)| (position - set_point).abs()),
        )
    }

    fn tracking_error(&self) -> Value {
        let window = self.scenario.judged_sine().unwrap_or(self.whole());
        let squares = self
            .samples(window)
            .map(|(_, set_point, position)| (position - set_point).powi(2));
        mean(squares).map(f64::sqrt)
    }

    /// Gain, phase and offset of the position against the set-point of a sine.
    fn sine_response(&self) -> [Value; 3] {
        let response = self.sine_fits().map(|(wanted, measured)| {
            let phase = measured.phase_degrees() - wanted.phase_degrees();
            let turns = libm::floor((phase + 270.0) / 360.0);
            [
                measured.amplitude() / wanted.amplitude(),
                phase - 360.0 * turns,
                measured.mean - wanted.mean,
            ]
        });
        match response {
            Ok(values) => values.map(checked),
            Err(reason) => [(); 3].map(|()| Err(reason.clone())),
        }
    }

    /// Set-point and position over the judged periods of a sine.
    fn sine_fits(&self) -> Result<(Harmonic, Harmonic), String> {
        let sine = self.scenario.reference.sine.last();
        let (window, sine) = (self.scenario.judged_sine().zip(sine))
            .ok_or("no sine of at least four periods in the scenario")?;
        let fit = |value: fn((f64, f64, f64)) -> f64| {
            let samples = self.samples(window).map(|sample| (sample.0, value(sample)));
            Harmonic::fit(samples, sine.period_seconds).ok_or_else(no_samples)
        };
        Ok((fit(|sample| sample.1)?, fit(|sample| sample.2)?))
    }

    fn position_max(&self) -> Value {
        largest(self.samples(self.whole()).map(|(_, _, position)| position))
    }

    fn current_rms(&self) -> Value {
        let currents = self
            .timeline
            .current()
            .iter()
            .copied()
            .filter(|current| !current.is_nan());
        mean(currents.map(|current| current.powi(2))).map(f64::sqrt)
    }
}

/// First sample of the uninterrupted stay within the band, less the time of the step.
fn settling_time(run: &Run<'_>, step: &JudgedStep) -> Value {
    let band = SETTLING_BAND * (step.to_millimetres - step.from_millimetres).abs();
    let mut settled_at = None;
    for (time, _, position) in run.samples(step.window) {
        if (position - step.to_millimetres).abs() > band {
            settled_at = None;
        } else if settled_at.is_none() {
            settled_at = Some(time);
        }
    }
    settled_at
        .map(|time| time - step.window.from_seconds)
        .ok_or_else(|| "never settled".to_owned())
}

/// How far the position goes beyond the set-point in the direction of the step, by its height.
fn overshoot(run: &Run<'_>, step: &JudgedStep) -> Value {
    let height = step.to_millimetres - step.from_millimetres;
    if height == 0.0 {
        return Err("a step without height".to_owned());
    }
    let beyond = run
        .samples(step.window)
        .map(|(_, _, position)| (position - step.to_millimetres) / height);
    Ok(100.0 * beyond.fold(0.0, f64::max))
}

fn deviation(run: &Run<'_>, window: Window) -> Value {
    largest(
        run.samples(window)
            .map(|(_, set_point, position)| (position - set_point).abs()),
    )
}

/// From the start of the disturbance until the deviation stays small.
pub(super) fn recovery(run: &Run<'_>, window: Window) -> Value {
    let is_outside =
        |set_point: f64, position: f64| (position - set_point).abs() > RECOVERY_BAND_MILLIMETRES;
    let samples = run.samples(window);
    let last_outside = samples.fold(None, |last, (time, set_point, position)| {
        if is_outside(set_point, position) {
            Some(time)
        } else {
            last
        }
    });
    match last_outside {
        None => deviation(run, window).map(|_| 0.0),
        Some(time)
            if time + 1.5 * run.timeline.period_seconds
                >= window.until_seconds.min(run.timeline.end_seconds()) =>
        {
            Err("not recovered".to_owned())
        }
        Some(time) => Ok(time + run.timeline.period_seconds - window.from_seconds),
    }
}

/// The largest value; an error counts as worse than any value.
fn worst(values: impl Iterator<Item = Value>) -> Option<Value> {
    values.reduce(|worst, value| match (worst, value) {
        (Ok(worst), Ok(value)) => Ok(f64::max(worst, value)),
        (Err(reason), _) | (_, Err(reason)) => Err(reason),
    })
}

pub(super) fn largest(values: impl Iterator<Item = f64>) -> Value {
    let largest = values.reduce(|largest, value| if value <= largest { largest } else { value });
    checked(largest.ok_or_else(no_samples)?)
}

fn mean(values: impl Iterator<Item = f64>) -> Value {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count == 0.0 {
        Err(no_samples())
    } else {
        checked(sum / count)
    }
}

/// A position is never NaN here, so NaN means that there is no set-point.
fn checked(value: f64) -> Value {
    if value.is_nan() {
        Err("no set-point".to_owned())
    } else {
        Ok(value)
    }
}

fn traffic(value: f64) -> Value {
    if value.is_nan() {
        Err("no two SYNCs in the recording".to_owned())
    } else {
        Ok(value)
    }
}

fn no_samples() -> String {
    "no position in the recording".to_owned()
}
