//! From a timeline to a verdict. Nothing but the recording counts.

mod reactions;
mod sequences;
mod signals;

use scenario::Scenario;
use scenario::events::{JudgedStep, Window};
use scenario::expect::Limit;
use scenario::timing::TimingLimits;

use crate::events::{Event, Level};
use crate::external::External;
use crate::harmonic::Harmonic;
use crate::timeline::Timeline;
use crate::timing::Timing;
use crate::verdict::{Metric, Outcome, Verdict};

/// Half the width of the settling band, by the height of the step (PAPER, "Definitions").
pub(crate) const SETTLING_BAND: f64 = 0.05;
/// A deviation within this counts as recovered from a disturbance: four steps of a 10-bit converter over 60 mm.
const RECOVERY_BAND_MILLIMETRES: f64 = 0.25;
/// A disturbance is watched this long after its end.
const AFTER_DISTURBANCE_SECONDS: f64 = 3.0;
/// The steady state is the mean over this time before the end.
const STEADY_STATE_SECONDS: f64 = 0.5;
/// With more missed cycles than this, control metrics decide nothing.
const MISSED_CYCLES_PERCENT_MAX: f64 = 1.0;
/// From this load on, a cycle that carries more than the others does not end in its time.
const BUSY_BUS_PERCENT: f64 = 70.0;
/// With faults the plant tells the truth every 10 ms at least.
const FAULTY_END_SECONDS: f64 = 0.05;
/// Sample times are multiples of the period; this absorbs their rounding.
const TIME_TOLERANCE_SECONDS: f64 = 1e-9;

/// Losses that a verdict tells at most.
const LOSSES_MAX: usize = 20;

/// The metric that decides before all others: on an overloaded bus nothing else means anything.
const BUS_LOAD: &str = "bus_load_percent";

/// Metrics that a busy host makes worse.
const HOST_METRICS: [&str; 2] = ["missed_cycles_percent", "sync_interval_milliseconds_max"];

/// Judges a run that broke off. Only what the traffic tells is reported; a bus that is loaded beyond its limit is a
/// failed limit, with what came of it as the reason.
#[must_use]
pub fn judge_broken(timeline: &Timeline, scenario: &Scenario, error: &str) -> Verdict {
    let run = Run { timeline, scenario };
    let mut metrics = run.metrics();
    metrics.retain(|metric| {
        matches!(
            metric.name.as_str(),
            BUS_LOAD | "sync_interval_milliseconds_max" | "missed_cycles_percent"
        ) && metric.value.is_some()
    });
    let mut verdict = Verdict::incomplete_of(scenario, error);
    if let Some(reason) = overload(&metrics) {
        verdict.outcome = Outcome::Fail;
        verdict.reason = Some(format!("{reason}; {error}"));
    }
    verdict.metrics = metrics;
    verdict
}

/// Adds the timing of a run in real time and judges its limits. Where the timing is not trusted they are neither met nor
/// missed, and the run cannot pass.
pub fn judge_timing(verdict: &mut Verdict, timing: Timing, limits: &TimingLimits) {
    let untold = not_judged(&verdict.metrics);
    let mut metrics = timing.metrics(limits);
    if !timing.distrust.is_empty() {
        metrics.iter_mut().for_each(|metric| metric.passed = None);
        // These are met by luck at worst, but missed by the machine.
        let late = verdict.metrics.iter_mut().filter(|metric| {
            HOST_METRICS.contains(&metric.name.as_str()) && metric.passed == Some(false)
        });
        late.for_each(|metric| metric.passed = None);
    }
    verdict.metrics.extend(metrics);
    let is_open = match verdict.outcome {
        Outcome::Pass | Outcome::Fail => true,
        // Only for what nobody tells; what the timing adds may fail still.
        Outcome::Inconclusive => untold.is_some() && verdict.reason == untold,
        Outcome::Incomplete => false,
    };
    if is_open {
        let limited = verdict
            .metrics
            .iter()
            .filter(|metric| metric.limit.is_some());
        let results: Vec<Option<bool>> = limited.map(|metric| metric.passed).collect();
        if results.contains(&Some(false)) {
            (verdict.outcome, verdict.reason) = (Outcome::Fail, None);
        } else if results.contains(&None) {
            let distrust = timing.distrust.join("; ");
            let late = (not_judged(&verdict.metrics) != untold)
                .then(|| format!("the timing cannot be judged: {distrust}"));
            let reasons: Vec<String> = untold.into_iter().chain(late).collect();
            verdict.outcome = Outcome::Inconclusive;
            verdict.reason = Some(reasons.join("; "));
        }
    }
    verdict.timing = Some(timing);
}

/// What to say of a bus load beyond its limit.
fn overload(metrics: &[Metric]) -> Option<String> {
    let load = metrics.iter().find(|metric| metric.name == BUS_LOAD)?;
    (load.passed == Some(false)).then(|| {
        let percent = load.value.unwrap_or(f64::NAN);
        format!("the bus is overloaded ({percent:.1} %), so frames come late")
    })
}

/// Judges a run.
#[must_use]
pub fn judge(timeline: &Timeline, scenario: &Scenario, frames_lost: u64) -> Verdict {
    let run = Run { timeline, scenario };
    let metrics = run.metrics();
    let (outcome, reason) = outcome(timeline, scenario, &metrics, frames_lost);
    Verdict {
        schema: 1,
        scenario: scenario.name.clone(),
        version: env!("CARGO_PKG_VERSION"),
        seed: scenario.seed,
        requirements: scenario.requirements.clone(),
        external: External::default(),
        outcome,
        reason,
        frames_lost,
        metrics,
        losses: losses(timeline, scenario),
        timing: None,
    }
}

/// The errors among the events, with their times, for people.
fn losses(timeline: &Timeline, scenario: &Scenario) -> Vec<String> {
    let end_seconds = timeline
        .zero_seconds
        .map_or(f64::INFINITY, |_| scenario.duration_seconds);
    let is_error =
        |event: &&Event| event.level == Level::Error && event.time_seconds <= end_seconds;
    let errors = timeline.events.iter().filter(is_error).take(LOSSES_MAX);
    errors
        .map(|event| format!("{:.3} s {}", event.time_seconds, event.text))
        .collect()
}

fn outcome(
    timeline: &Timeline,
    scenario: &Scenario,
    metrics: &[Metric],
    lost: u64,
) -> (Outcome, Option<String>) {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(reason));
    }
    if lost > 0 {
        return (Outcome::Inconclusive, Some(lost_frames(lost)));
    }
    if let Some(undecided) = undecided(timeline, scenario) {
        return undecided;
    }
    if metrics.iter().any(|metric| metric.passed == Some(false)) {
        return (Outcome::Fail, None);
    }
    match not_judged(metrics) {
        None => (Outcome::Pass, None),
        reason => (Outcome::Inconclusive, reason),
    }
}

/// Says so when a limit is on something that nobody on the bus tells: such a run does not pass.
fn not_judged(metrics: &[Metric]) -> Option<String> {
    let undecided = |metric: &&Metric| metric.limit.is_some() && metric.passed.is_none();
    let names = metrics
        .iter()
        .filter(undecided)
        .map(|metric| metric.name.as_str());
    let names: Vec<&str> = names.collect();
    (!names.is_empty()).then(|| format!("not judged: {}", names.join(", ")))
}

/// Says so when the recording is not good enough. In a scenario with faults, cycles are missed on purpose.
fn undecided(timeline: &Timeline, scenario: &Scenario) -> Option<(Outcome, Option<String>)> {
    let planned = scenario.duration_seconds;
    let is_sound = scenario.fault.is_empty();
    if let Some(reason) = too_many_missed(timeline).filter(|_| is_sound) {
        return Some((Outcome::Inconclusive, Some(reason)));
    }
    if timeline.zero_seconds.is_none() && has_boot_fault(scenario) {
        return None;
    }
    let (reached, tolerance) = if is_sound {
        (timeline.end_seconds(), 1.5 * timeline.period_seconds)
    } else {
        (timeline.last_frame_seconds, FAULTY_END_SECONDS)
    };
    (timeline.zero_seconds.is_none() || reached + tolerance < planned).then(|| {
        let reached = timeline.zero_seconds.map_or(0.0, |_| reached);
        let reason = format!("the recording ends after {reached:.3} s of {planned} s");
        (Outcome::Incomplete, Some(reason))
    })
}

/// A fault with which the scenario need not begin.
fn has_boot_fault(scenario: &Scenario) -> bool {
    let windows = scenario.fault.windows();
    windows.iter().any(|fault| fault.from_seconds.is_none())
}

/// What is said of frames that are missing in a recording.
#[must_use]
pub fn lost_frames(lost: u64) -> String {
    format!("the recorder lost {lost} frames")
}

/// Says so when too many cycles were missed for anything to be decided.
#[must_use]
pub fn too_many_missed(timeline: &Timeline) -> Option<String> {
    let missed = timeline.missed_cycles_percent();
    (missed > MISSED_CYCLES_PERCENT_MAX).then(|| {
        let load = timeline.bus_load_percent;
        let cause = if load > BUSY_BUS_PERCENT {
            format!("the bus is nearly full (load {load:.1} %)")
        } else {
            "the machine was too busy for real time; try --clock lockstep".to_owned()
        };
        format!(
            "{missed:.1} % of the cycles were missed (limit {MISSED_CYCLES_PERCENT_MAX} %): {cause}"
        )
    })
}

/// Metrics of what the fan and load module does.
const DISTURBANCE_METRICS: [&str; 2] = ["maximum_deviation_millimetres", "recovery_time_seconds"];
const NO_FAN: &str = "not available: no fan on the bus";

struct Run<'a> {
    timeline: &'a Timeline,
    scenario: &'a Scenario,
}

type Value = Result<f64, String>;

impl Run<'_> {
    /// All metrics that the scenario gives a meaning to or a limit.
    fn metrics(&self) -> Vec<Metric> {
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
fn recovery(run: &Run<'_>, window: Window) -> Value {
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

fn largest(values: impl Iterator<Item = f64>) -> Value {
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use canopen::CanFrame;
    use dbc::Database;

    use super::*;
    use crate::recording::Stamped;
    use crate::timeline::decode;

    const OPERATION_ENABLED: f64 = 39.0;

    /// A scenario of 4 s with a step from 10 mm to 35 mm at 1 s, and whatever is added.
    fn scenario(added: &str) -> Scenario {
        let text = format!(
            "schema = 1\nname = \"judged\"\nduration_seconds = 4.0\n[controller.sliding_mode]\n{added}\n\
             [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
             [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n"
        );
        Scenario::parse(&text, "judged.toml", |_| unreachable!("no table")).unwrap()
    }

    /// What a drive with this position by cycle would leave; a cycle without a position has no TPDO1.
    fn frames(cycles: u32, position: impl Fn(u32) -> Option<f64>) -> Vec<Stamped> {
        let database = Database::sma_actuator();
        let signal = |path| database.signal(path).unwrap();
        let feedback = |position: f64| {
            let mut message = database.builder("drive_tpdo1").unwrap();
            message.set(&signal("drive_tpdo1.statusword_state"), OPERATION_ENABLED);
            message.set(&signal("drive_tpdo1.position_millimetres"), position);
            message.set(&signal("drive_tpdo1.current_amperes"), 0.5);
            message.frame()
        };
        let fan = [CanFrame::new(0x711, &[0]), CanFrame::new(0x211, &[0; 8])];
        let mut frames: Vec<Stamped> = [feedback(0.0), fan[0], fan[1]]
            .map(|frame| Stamped::new(Duration::ZERO, frame))
            .into();
        for cycle in 0..cycles {
            let start = Duration::from_millis(u64::from(cycle) + 1);
            frames.push(Stamped::new(start, CanFrame::new(0x080, &[1])));
            if let Some(position) = position(cycle) {
                let time = start + Duration::from_micros(130);
                frames.push(Stamped::new(time, feedback(position)));
            }
        }
        frames
    }

    fn verdict_of(scenario: &Scenario, frames: &[Stamped], lost: u64) -> Verdict {
        let timeline = decode(frames, scenario, Database::sma_actuator()).unwrap();
        judge(&timeline, scenario, lost)
    }

    fn value(verdict: &Verdict, name: &str) -> Option<f64> {
        let metric = verdict.metrics.iter().find(|metric| metric.name == name);
        metric.unwrap_or_else(|| panic!("no {name}")).value
    }

    fn check(added: &str, position: impl Fn(f64) -> f64, name: &str, expected: f64) {
        let verdict = verdict_of(
            &scenario(added),
            &frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3))),
            0,
        );
        let measured = value(&verdict, name).unwrap();
        assert!(
            (measured - expected).abs() < 1e-6,
            "{name}: {measured}, expected {expected}"
        );
    }

    /// 10 mm before the step, 35 mm from `settled` on, and 34 mm (inside the band of 1.25 mm) or 30 mm for one sample.
    fn step_response(settled: f64) -> impl Fn(f64) -> f64 {
        move |time| if time < settled { 10.0 } else { 35.0 }
    }

    #[test]
    fn settling_counts_from_the_step_to_the_first_sample_of_the_last_stay() {
        check("", step_response(1.1), "settling_time_seconds", 0.1);
        let leaves_again = |time: f64| {
            if (time - 1.5).abs() < 5e-4 {
                30.0
            } else {
                step_response(1.1)(time)
            }
        };
        check("", leaves_again, "settling_time_seconds", 0.501);
        let stays_inside = |time: f64| {
            if (time - 1.5).abs() < 5e-4 {
                34.0
            } else {
                step_response(1.1)(time)
            }
        };
        check("", stays_inside, "settling_time_seconds", 0.1);
        let never = verdict_of(&scenario(""), &frames(4000, |_| Some(10.0)), 0);
        assert!(
            never
                .metrics
                .iter()
                .all(|metric| metric.name != "settling_time_seconds")
        );
    }

    #[test]
    fn overshoot_is_by_the_height_of_the_step() {
        let peak = |time: f64| {
            if (time - 1.2).abs() < 5e-4 {
                36.0
            } else {
                step_response(1.1)(time)
            }
        };
        check("", peak, "overshoot_percent", 4.0);
        check("", step_response(1.1), "overshoot_percent", 0.0);
        check("", peak, "position_millimetres_max", 36.0);
    }

    #[test]
    fn errors_are_means_over_their_windows() {
        let offset = |time: f64| step_response(1.0)(time) + 0.2;
        check("", offset, "steady_state_error_millimetres", 0.2);
        check("", offset, "tracking_error_millimetres_rms", 0.2);
        check("", offset, "current_amperes_rms", 0.5);
    }

    #[test]
    fn a_sine_is_followed_with_gain_phase_and_offset() {
        let text = "schema = 1\nname = \"sine\"\nduration_seconds = 4.0\n[controller.pid]\n[[reference.sine]]\n\
                    from_seconds = 0.0\ncentre_millimetres = 25.0\namplitude_millimetres = 10.0\nperiod_seconds = 0.8\n";
        let sine = Scenario::parse(text, "sine.toml", |_| unreachable!("no table")).unwrap();
        let omega = std::f64::consts::TAU / 0.8;
        let judged = |lag: f64| {
            let position = |cycle| 24.0 + 7.0 * libm::sin(omega * f64::from(cycle) / 1e3 - lag);
            verdict_of(&sine, &frames(4000, |cycle| Some(position(cycle))), 0)
        };
        for (lag, degrees) in [(0.5, -28.647_889), (4.0, -229.183_118), (-1.0, 57.295_780)] {
            let verdict = judged(lag);
            let expected = [
                ("sine_gain", 0.7),
                ("sine_phase_degrees", degrees),
                ("sine_offset_millimetres", -1.0),
            ];
            for (name, expected) in expected {
                let measured = value(&verdict, name).unwrap();
                // The position on the bus has steps of 1 µm.
                assert!(
                    (measured - expected).abs() < 1e-3,
                    "{name}: {measured}, expected {expected}"
                );
            }
        }
    }

    #[test]
    fn a_disturbance_is_watched_until_3_s_after_its_end() {
        let fan =
            "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 2.5\nconvection_factor = 5.0";
        let dip = |time: f64| match time {
            time if (1.99..2.3).contains(&time) => 34.5,
            time => step_response(1.0)(time),
        };
        check(fan, dip, "maximum_deviation_millimetres", 0.5);
        check(fan, dip, "recovery_time_seconds", 0.3);
        let early = |time: f64| if time < 1.9 { 20.0 } else { 35.0 };
        check(fan, early, "maximum_deviation_millimetres", 0.0);
        check(fan, early, "recovery_time_seconds", 0.0);
    }

    #[test]
    fn what_nobody_tells_is_not_judged_and_does_not_pass() {
        let fan = "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 2.5\nconvection_factor = 5.0\n";
        let limits = "[expect]\nrecovery_time_seconds = { max = 1.0 }\ntemperature_celsius = { max = 90.0 }\n";
        let step = |time: f64| step_response(1.1)(time);
        let mut frames = frames(4000, |cycle| Some(step(f64::from(cycle) / 1e3)));
        // Without the module's heartbeat its commands reach nobody.
        frames.retain(|stamped| stamped.frame.standard_id() != Some(0x711));
        let judged = |limits: &str| verdict_of(&scenario(&format!("{fan}{limits}")), &frames, 0);
        let verdict = judged(limits);
        assert_eq!(verdict.outcome, Outcome::Inconclusive);
        let reason = "not judged: recovery_time_seconds, temperature_celsius";
        assert_eq!(verdict.reason.as_deref(), Some(reason));
        assert_eq!(value(&verdict, "maximum_deviation_millimetres"), None);
        let failing = format!("{limits}settling_time_seconds = {{ max = 0.01 }}\n");
        assert_eq!(judged(&failing).outcome, Outcome::Fail);
        assert_eq!(judged("").outcome, Outcome::Pass, "nothing is demanded");
    }

    #[test]
    fn without_a_set_point_nothing_deviates_or_recovers() {
        let text = "schema = 1\nname = \"open\"\nduration_seconds = 4.0\n[controller.open_loop]\n\
                    [[disturbance.fan]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\nconvection_factor = 5.0\n";
        let open = Scenario::parse(text, "open.toml", |_| unreachable!("no table")).unwrap();
        let verdict = verdict_of(&open, &frames(4000, |_| Some(10.0)), 0);
        let judged: Vec<_> = verdict
            .metrics
            .iter()
            .map(|metric| metric.name.as_str())
            .collect();
        assert!(!judged.contains(&"recovery_time_seconds"), "{judged:?}");
        assert!(
            !judged.contains(&"maximum_deviation_millimetres"),
            "{judged:?}"
        );
    }

    #[test]
    fn a_step_that_never_settles_misses_its_limit() {
        let limited = scenario("[expect]\nsettling_time_seconds = { max = 3.0 }");
        let verdict = verdict_of(&limited, &frames(4000, |_| Some(10.0)), 0);
        assert_eq!(verdict.outcome, Outcome::Fail);
        assert_eq!(verdict.metrics[0].remark.as_deref(), Some("never settled"));
    }

    #[test]
    fn what_comes_after_the_end_is_no_part_of_the_last_cycle() {
        let mut frames = frames(4000, |_| Some(35.0));
        // The scenario begins at 1 ms and ends at 4.001 s; then a drive that stops may say anything.
        let late = Duration::from_micros(4_001_200);
        frames.push(Stamped::new(late, frames[0].frame));
        let verdict = verdict_of(&scenario(""), &frames, 0);
        assert_eq!(value(&verdict, "steady_state_error_millimetres"), Some(0.0));
    }

    #[test]
    fn a_bad_recording_decides_nothing() {
        let whole = frames(4000, |cycle| {
            Some(step_response(1.1)(f64::from(cycle) / 1e3))
        });
        let outcome = |frames: &[Stamped], lost| verdict_of(&scenario(""), frames, lost).outcome;
        assert_eq!(outcome(&whole, 0), Outcome::Pass);
        assert_eq!(outcome(&whole, 1), Outcome::Inconclusive);
        assert_eq!(outcome(&whole[..whole.len() / 2], 0), Outcome::Incomplete);
        assert_eq!(outcome(&[], 0), Outcome::Incomplete);
        // Every 50th cycle without a position, then every 50th without its SYNC: 2 % missed, more than 1 %.
        let silent = frames(4000, |cycle| (cycle % 50 != 7).then_some(35.0));
        assert_eq!(outcome(&silent, 0), Outcome::Inconclusive);
        let is_kept = |stamped: &&Stamped| {
            let is_sync = stamped.frame.standard_id() == Some(0x080);
            !(is_sync && stamped.time.as_millis() % 50 == 7)
        };
        let skipped: Vec<Stamped> = whole.iter().filter(is_kept).copied().collect();
        assert_eq!(outcome(&skipped, 0), Outcome::Inconclusive);
    }
}
