//! Checks of signals in `[[expect.signal]]`. A window without samples never passes.

use recording::timeline::Series;
use recording::traces::{SignalSample, SignalTrace};
use scenario::events::Window;
use scenario::expect::{Course, Demand, Limit, rounded};

use crate::evidence::{Absence, Evidence, Known, Measurement, samples_in};
use crate::metric::Metric;

/// Returns a row for each demand.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let duration_seconds = evidence.trial.run.duration_seconds;
    let checks = evidence.trial.expect.signal.iter();
    let rows = checks.flat_map(|check| {
        let demands = check.demands().zip(check.rows(duration_seconds));
        demands.filter_map(move |(demand, expected)| {
            let window = check.window(&demand, duration_seconds);
            let trace = evidence.trace(&check.name);
            let measurement = trace.and_then(|trace| measure(evidence, trace, window, &demand));
            evidence.row(expected, measurement)
        })
    });
    rows.collect()
}

/// Measures a signal. An arrival is left out as a whole if stalls explain a piece before it; for other demands each sample is.
fn measure(
    evidence: &Evidence<'_>,
    trace: &SignalTrace,
    window: Window,
    demand: &Demand<'_>,
) -> Measurement {
    let all = samples_in(&trace.samples, window);
    if let Demand::Reaches(wanted) = demand {
        let arrival = arrival(trace, &all, window, *wanted);
        let arrived_at = arrival.as_ref().ok().and_then(|known| known.at_seconds);
        let until = arrived_at.unwrap_or(window.until_seconds);
        return if evidence.leaves_out(window.from_seconds, until) {
            Err(Absence::left_out())
        } else {
            arrival
        };
    }
    if all.is_empty() {
        return Err(unseen(trace, window));
    }
    let is_kept = |one: &SignalSample| !evidence.leaves_out(one.time_seconds, one.time_seconds);
    let samples = if evidence.has_all() {
        all
    } else {
        all.iter().filter(is_kept).collect()
    };
    if samples.is_empty() {
        return Err(Absence::left_out());
    }
    if let Some(cut) = cut(trace, &samples) {
        return Err(cut);
    }
    if let Some(sample) = samples.iter().find(|sample| !sample.value.is_finite()) {
        let absence = Absence::from(format!("{} is no number", sample.value));
        return Err(absence.at(sample.time_seconds));
    }
    let silence = trace.silence_seconds_max.and_then(|seconds_max| {
        let times = samples.iter().map(|sample| sample.time_seconds);
        evidence.first_silence(times, window, seconds_max)
    });
    if let Some(silence) = silence {
        return Err(Absence::silent(silence));
    }
    let limit = demand.limit(window);
    match demand {
        Demand::RatePerSecond(_) if samples.len() < 2 => Err("a single sample has no rate".into()),
        Demand::RatePerSecond(_) => worst(rates(&samples), limit),
        Demand::Follows(course) => worst(distances(&samples, course), limit),
        Demand::Stays(_) | Demand::Reaches(_) => worst(samples.iter(), limit),
    }
}

/// Returns the reason why samples of a plant's output cannot be judged, if its field did not hold one of them.
fn cut(trace: &SignalTrace, samples: &Series<SignalSample>) -> Option<Absence> {
    let mut cut = samples
        .iter()
        .filter(|sample| trace.is_of_plant && sample.value.is_nan());
    let at_seconds = cut.next()?.time_seconds;
    let reason = format!("beyond what its field holds at {at_seconds:.3} s");
    Some(Absence::unavailable(reason))
}

/// Returns the reason why a window is empty.
fn unseen(trace: &SignalTrace, window: Window) -> Absence {
    let is_before = |sample: &SignalSample| sample.time_seconds < window.from_seconds;
    let mut samples = trace.samples.iter();
    // An empty window has a sample before it, or all behind it.
    let reason = match (samples.clone().filter(is_before).last(), samples.next()) {
        (Some(last), _) => format!("no sample; the last came at {:.3} s", last.time_seconds),
        (None, Some(next)) => format!("no sample; the first comes at {:.3} s", next.time_seconds),
        (None, None) => "no sample".to_owned(),
    };
    Absence::unseen(reason, window)
}

/// Returns the time from the start of the window to the first sample within the limit.
fn arrival(
    trace: &SignalTrace,
    samples: &Series<SignalSample>,
    window: Window,
    wanted: Limit,
) -> Measurement {
    if let Some(first) = samples.iter().find(|sample| wanted.admits(sample.value)) {
        let since = first.time_seconds - window.from_seconds;
        return Ok(Known::at(since, first.time_seconds));
    }
    if let Some(cut) = cut(trace, samples) {
        return Err(cut);
    }
    Err(match nearest(samples, wanted) {
        Some(nearest) => {
            let reason = format!("not reached, only {}", rounded(nearest.value));
            Absence::unseen(reason, window).at(nearest.time_seconds)
        }
        None if samples.is_empty() => unseen(trace, window),
        None => "NaN is no number".into(),
    })
}

/// Returns the sample that is nearest to the wanted range; the first of several.
pub(crate) fn nearest(samples: &Series<SignalSample>, wanted: Limit) -> Option<SignalSample> {
    let outside = |sample: &SignalSample| -wanted.margin(sample.value);
    let numbers = samples.iter().filter(|sample| !sample.value.is_nan());
    numbers.min_by(|left, right| outside(left).total_cmp(&outside(right)))
}

/// Returns the value that is nearest to a limit or farthest beyond it; the first of several.
fn worst(values: impl Iterator<Item = SignalSample>, limit: Limit) -> Measurement {
    let worst = values.reduce(|worst, sample| {
        if limit.margin(sample.value) < limit.margin(worst.value) {
            sample
        } else {
            worst
        }
    });
    let worst = worst.ok_or("no sample")?;
    Ok(Known::at(worst.value, worst.time_seconds))
}

/// Returns the change per second up to each sample.
fn rates(samples: &Series<SignalSample>) -> impl Iterator<Item = SignalSample> {
    samples.pairs().map(|(one, next)| SignalSample {
        time_seconds: next.time_seconds,
        value: (next.value - one.value) / (next.time_seconds - one.time_seconds),
    })
}

/// Returns the distance of each sample from the course.
fn distances(
    samples: &Series<SignalSample>,
    course: &Course,
) -> impl Iterator<Item = SignalSample> {
    samples.iter().map(|sample| SignalSample {
        value: (sample.value - course.at(sample.time_seconds)).abs(),
        ..sample
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use recording::timeline::decode;

    use super::*;
    use crate::Circumstances;
    use crate::tests::{frames, step_plan};

    fn trace(samples: Vec<SignalSample>) -> SignalTrace {
        SignalTrace {
            path: "message.signal".to_owned(),
            unit: String::new(),
            silence_seconds_max: Some(0.02),
            is_of_plant: false,
            samples: samples.into(),
        }
    }

    /// Returns a trace with a sample in each millisecond of the first second.
    fn every_millisecond(value: impl Fn(f64) -> f64) -> SignalTrace {
        let sample = |number| {
            let time_seconds = f64::from(number) * 1e-3;
            SignalSample {
                time_seconds,
                value: value(time_seconds),
            }
        };
        trace((0..1000).map(sample).collect())
    }

    fn limit(min: f64, max: f64) -> Limit {
        Limit {
            min: Some(min),
            max: Some(max),
        }
    }

    fn window(from_seconds: f64, until_seconds: f64) -> Window {
        Window {
            from_seconds,
            until_seconds,
        }
    }

    /// Measures a signal in a run without stalls.
    fn measured(trace: &SignalTrace, window: Window, demand: &Demand<'_>) -> Measurement {
        let plan = step_plan("");
        let timeline = decode(&frames(4, |_| Some(10.0)).into(), &plan)
            .unwrap()
            .remove(0);
        let circumstances = Circumstances::default();
        let evidence = Evidence::new(
            plan.database(),
            &timeline,
            plan.only_loop().unwrap(),
            &circumstances,
        );
        measure(&evidence, trace, window, demand)
    }

    #[track_caller]
    fn check(
        trace: &SignalTrace,
        window: Window,
        demand: &Demand<'_>,
        expected: Result<f64, &str>,
        at_seconds: Option<f64>,
    ) {
        let (value, at) = match measured(trace, window, demand) {
            Ok(known) => (Ok(rounded(known.value)), known.at_seconds),
            Err(absence) => (Err(absence.reason), absence.at_seconds),
        };
        assert_eq!(value, expected.map_err(str::to_owned));
        assert_eq!(at.map(rounded), at_seconds);
    }

    #[track_caller]
    fn check_stays(
        trace: &SignalTrace,
        within: Window,
        expected: Result<f64, &str>,
        at: Option<f64>,
    ) {
        let demand = Demand::Stays(limit(0.0, 1.0));
        check(trace, within, &demand, expected, at);
    }

    /// A window that a value beyond the field does not touch is judged, and so is an arrival before it.
    #[test]
    fn a_value_beyond_its_field_leaves_its_window_open() {
        let far = |time: f64| (0.4..0.6).contains(&time);
        let output = SignalTrace {
            is_of_plant: true,
            ..every_millisecond(|time| if far(time) { f64::NAN } else { time })
        };
        let beyond = Err("beyond what its field holds at 0.400 s");
        check_stays(&output, window(0.2, 0.4), Ok(0.2), Some(0.2));
        check_stays(&output, window(0.7, 0.9), Ok(0.899), Some(0.899));
        check_stays(&output, window(0.2, 0.9), beyond, None);
        let reaches = |from, to| Demand::Reaches(limit(from, to));
        check(
            &output,
            window(0.0, 1.0),
            &reaches(0.1, 0.2),
            Ok(0.1),
            Some(0.1),
        );
        check(&output, window(0.0, 1.0), &reaches(4.0, 5.0), beyond, None);
    }

    #[test]
    fn the_sample_nearest_to_a_limit_or_beyond_it_is_reported() {
        let ramp = every_millisecond(|time| time);
        check_stays(&ramp, window(0.2, 0.9), Ok(0.899), Some(0.899));
        check_stays(&ramp, window(0.2, 0.4), Ok(0.2), Some(0.2));
        let peak = every_millisecond(|time| if (time - 0.5).abs() < 1e-6 { 7.0 } else { 0.5 });
        check_stays(&peak, window(0.0, 1.0), Ok(7.0), Some(0.5));
        // The end of the window is not part of it.
        check_stays(&peak, window(0.0, 0.5), Ok(0.5), Some(0.0));
    }

    #[test]
    fn a_rate_is_that_of_two_successive_samples() {
        let jump = every_millisecond(|time| if time < 0.2995 { 0.0 } else { 0.25 });
        let demand = Demand::RatePerSecond(limit(-100.0, 100.0));
        let whole = window(0.0, 1.0);
        check(&jump, whole, &demand, Ok(250.0), Some(0.3));
        let single = Err("a single sample has no rate");
        check(&jump, window(0.3, 0.301), &demand, single, None);
    }

    #[test]
    fn an_arrival_counts_from_the_start_of_the_window() {
        let ramp = every_millisecond(|time| 10.0 * time);
        let demand = Demand::Reaches(limit(4.0, 5.0));
        check(&ramp, window(0.1, 1.0), &demand, Ok(0.3), Some(0.4));
        let missed = Err("not reached, only 2.99");
        check(&ramp, window(0.1, 0.3), &demand, missed, Some(0.299));
    }

    #[test]
    fn a_course_is_met_between_its_rows_too() {
        let course = Course {
            file: "golden.csv".to_owned(),
            column: None,
            tolerance: 0.1,
            rows: vec![(0.0, 0.0), (1.0, 10.0)],
        };
        let demand = Demand::Follows(&course);
        let off = |time: f64| 10.0 * time + if time < 0.6995 { 0.0 } else { 0.2 };
        let whole = window(0.0, 1.0);
        check(&every_millisecond(off), whole, &demand, Ok(0.2), Some(0.7));
    }

    #[test]
    fn what_was_not_seen_never_passes() {
        let ramp = every_millisecond(|time| time);
        let late = Err("no sample; the last came at 0.999 s");
        check_stays(&ramp, window(2.0, 3.0), late, None);
        let early = trace(vec![SignalSample {
            time_seconds: 5.0,
            value: 0.5,
        }]);
        let none = Err("no sample; the first comes at 5.000 s");
        check_stays(&early, window(2.0, 3.0), none, None);
        let silent = Err("silent from 0.999 to 1.500 s");
        check_stays(&ramp, window(0.0, 1.5), silent, None);
        let gap = every_millisecond(|time| time);
        let kept = |sample: &SignalSample| !(0.3..0.6).contains(&sample.time_seconds);
        let gap = trace(gap.samples.iter().filter(kept).collect());
        let silent = Err("silent from 0.299 to 0.600 s");
        check_stays(&gap, window(0.0, 1.0), silent, None);
        let nan = every_millisecond(|time| if time > 0.4995 { f64::NAN } else { 0.5 });
        let no_number = Err("NaN is no number");
        check_stays(&nan, window(0.0, 1.0), no_number, Some(0.5));
        let reaches = Demand::Reaches(limit(2.0, 3.0));
        let only = window(0.6, 1.0);
        check(&nan, only, &reaches, no_number, None);
    }

    #[test]
    fn a_signal_that_is_sent_on_occasion_may_be_silent() {
        let mut rare = every_millisecond(|time| time);
        rare.silence_seconds_max = None;
        check_stays(&rare, window(0.5, 3.0), Ok(0.999), Some(0.999));
    }

    proptest! {
        /// The verdict agrees with a check of each sample by itself, and its time is that of such a sample.
        #[test]
        fn a_band_is_kept_when_each_sample_keeps_it(
            values in prop::collection::vec(-2.0..2.0_f64, 1..60),
            (low, high) in (-1.5..0.0_f64, 0.0..1.5_f64),
            (from, length) in (0.0..0.05_f64, 0.001..0.06_f64),
        ) {
            let values: Vec<f64> = values.into_iter().map(rounded).collect();
            let wanted = limit(rounded(low), rounded(high));
            let trace = SignalTrace {
                silence_seconds_max: None,
                ..every_millisecond(|time| {
                    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 999")]
                    let number = (time * 1e3).round() as usize;
                    values.get(number).copied().unwrap_or(0.0)
                })
            };
            let within = window(from, from + length);
            let inside = |sample: &SignalSample| {
                sample.time_seconds >= from - 1e-9 && sample.time_seconds < from + length - 1e-9
            };
            let seen: Vec<SignalSample> = trace.samples.iter().filter(inside).collect();
            let Ok(known) = measured(&trace, within, &Demand::Stays(wanted)) else {
                prop_assert!(seen.is_empty());
                return Ok(());
            };
            let all = seen.iter().all(|sample| wanted.admits(sample.value));
            prop_assert_eq!(wanted.admits(known.value), all);
            let judged = SignalSample { time_seconds: known.at_seconds.unwrap(), value: known.value };
            prop_assert!(seen.contains(&judged));
            // A wider band never turns a pass into a failure, and a signal that keeps a band has reached it at once.
            let wider = limit(rounded(low) - 0.5, rounded(high) + 0.5);
            let again = measured(&trace, within, &Demand::Stays(wider)).unwrap();
            prop_assert!(!all || wider.admits(again.value));
            let reached = measured(&trace, within, &Demand::Reaches(wanted));
            prop_assert!(!all || reached.unwrap().at_seconds == Some(seen[0].time_seconds));
        }
    }
}
