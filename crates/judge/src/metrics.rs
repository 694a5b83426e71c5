//! The metrics of a run, each with its limit.

use scenario::events::Window;
use scenario::metrics::{METRICS, Subject};

use crate::evidence::{Absence, Evidence, Known, Measurement, MetricValue, largest, mean, worst};
use crate::metric::Metric;
use crate::{
    chirp, contour, disturbances, duties, holds, reactions, sequences, signals, sine, steps,
};

/// Time before the end over which the mean is the steady state.
const STEADY_STATE_SECONDS: f64 = 0.5;

/// Function that measures one metric.
type Measure = fn(&Evidence<'_>) -> Measurement;

/// Measurement of each metric, by the names of [`METRICS`] and in their order.
static MEASURES: &[(&str, Measure)] = &[
    ("settling_time_seconds", steps::settling_time),
    ("overshoot_percent", steps::overshoot),
    ("steady_state_error_{unit}", steady_state_error),
    ("tracking_error_{unit}_rms", tracking_error),
    ("sine_gain", sine::gain),
    ("sine_phase_degrees", sine::phase_degrees),
    ("sine_offset_{unit}", sine::offset),
    ("bandwidth_hertz", chirp::bandwidth),
    ("bandwidth_with_mean_hertz", chirp::bandwidth_with_mean),
    ("maximum_deviation_{unit}", disturbances::maximum_deviation),
    ("recovery_time_seconds", disturbances::recovery_time),
    ("{signal}_{unit}_max", position_max),
    ("{command}_{command_unit}_rms", current_rms),
    ("{command}_ripple_{command_unit}_rms", holds::current_ripple),
    ("hunting_{unit}", holds::hunting),
    ("missed_cycles_percent", duties::missed_cycles),
    ("missed_commands_percent", duties::missed_commands),
    ("late_commands_percent", duties::late_commands),
    ("sync_period_error_percent", duties::sync_period_error),
    ("bus_load_percent", |evidence| {
        traffic(evidence.timeline.bus_load_percent)
    }),
    ("sync_interval_milliseconds_max", sync_interval),
    ("temperature_celsius", reactions::temperature_max),
    ("no_event", reactions::unwanted_events),
    (
        "{command}_zero_within_milliseconds",
        reactions::current_zero,
    ),
    ("recovers_within_seconds", reactions::recovery_from_faults),
    ("safe_state", reactions::safe_state),
    ("emcy", reactions::missing_emergencies),
];

/// Returns all rows of the verdict: the metrics that have a meaning or a limit in the scenario, then its checks, then the
/// contours whose first axis is this loop.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let mut rows = rows_of_metrics(evidence);
    rows.extend(signals::metrics(evidence));
    rows.extend(sequences::metrics(evidence));
    rows.extend(contour::metrics(evidence));
    rows
}

fn rows_of_metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let quantities = &evidence.trial.wiring.quantities;
    let truth = evidence.of_the_truth();
    let is_cut = evidence.is_cut_before(evidence.trial.judged_end_seconds());
    let mut rows = Vec::new();
    for (metric, &(name, measure)) in METRICS.iter().zip(MEASURES) {
        let expect = evidence.trial.expect_of(metric);
        let expected = expect.row(quantities.name(name), expect.limit(name));
        if let Some(missing) = metric.missing_in(evidence.trial) {
            let lacks = Absence::meaningless(format!("the scenario lacks {missing}"));
            rows.extend(evidence.row(expected, Err(lacks)));
            continue;
        }
        let true_name = format!("true_{}", expected.name);
        let mut row = evidence.row(expected, measure(evidence));
        // A limit that was met until the bench ended the run may have been missed later.
        if let Some(row) = &mut row
            && is_cut
            && metric.is_traffic_metric()
        {
            row.passed = row.passed.filter(|passed| !passed);
        }
        rows.extend(row);
        if let Some(truth) = &truth
            && metric.subject == Subject::Position
        {
            rows.extend(truth.row(expect.row(true_name, None), measure(truth)));
        }
    }
    rows
}

fn steady_state_error(evidence: &Evidence<'_>) -> Measurement {
    let end = evidence.trial.judged_end_seconds();
    let window = Window::new((end - STEADY_STATE_SECONDS).max(0.0), end);
    let samples = || evidence.samples(window);
    let mut pairs = samples().zip(samples().skip(1));
    if pairs.any(|(before, after)| !after.has_same_set_point(&before)) {
        return Err(Absence::meaningless("the set-point moves at the end"));
    }
    let deviations = evidence.seen(window)?.map(|sample| sample.deviation());
    mean(deviations).map(Known::from)
}

fn tracking_error(evidence: &Evidence<'_>) -> Measurement {
    let sines = evidence.trial.judged_sines().into_iter();
    let mut windows = Vec::from_iter(sines.map(|sine| sine.window));
    if windows.is_empty() {
        windows.push(evidence.whole());
    }
    let errors = windows.into_iter();
    worst(errors.map(|window| deviation_rms(evidence, window).map(Known::from)))
}

fn deviation_rms(evidence: &Evidence<'_>, window: Window) -> MetricValue {
    let samples = evidence.seen(window)?;
    let squares = samples.map(|sample| sample.deviation().powi(2));
    mean(squares).map(f64::sqrt)
}

fn position_max(evidence: &Evidence<'_>) -> Measurement {
    let whole = evidence.whole();
    let positions = evidence.seen(whole)?.map(|sample| sample.position);
    evidence.of_largest(whole, largest(positions))
}

fn current_rms(evidence: &Evidence<'_>) -> Measurement {
    let whole = evidence.whole();
    let current = evidence.timeline.current();
    let rows = || {
        current
            .into_iter()
            .flat_map(|values| evidence.values(values, whole))
    };
    if rows().next().is_none() && !evidence.has_all() {
        return Err(Absence::left_out());
    }
    if rows().next().is_none() {
        let reason = format!("no {} in the recording", evidence.command_name());
        return Err(Absence::unseen(reason, whole));
    }
    let times = rows().map(|(time, _)| time);
    if let Some(silence) = evidence.first_silence(times, whole, evidence.silence_seconds_max) {
        return Err(Absence::silent(silence));
    }
    let squares = rows().map(|(_, current)| current.powi(2));
    Ok(mean(squares)?.sqrt().into())
}

fn sync_interval(evidence: &Evidence<'_>) -> Measurement {
    if evidence.timeline.zero_seconds.is_none() {
        return Err("the scenario never began".into());
    }
    // If the bench ended the SYNC, the recording still shows the run until then.
    let silence = evidence
        .silence_of_sync()
        .filter(|silence| !evidence.is_cut_before(silence.until_seconds));
    let longest = evidence.timeline.sync_interval_milliseconds_max;
    match silence {
        Some(silence) if !longest.is_nan() || !evidence.has_all() => {
            Err(Absence::unseen(format!("no SYNC {silence}"), silence))
        }
        _ if evidence.has_all() => traffic(longest),
        _ => {
            let longest = duties::longest_interval_milliseconds(evidence);
            evidence.of_largest(evidence.whole(), Ok(longest))
        }
    }
}

fn traffic(value: f64) -> Measurement {
    if value.is_nan() {
        Err("no two SYNCs in the recording".into())
    } else {
        Ok(value.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The two tables have the same names in the same order.
    #[test]
    fn each_metric_of_a_scenario_is_measured() {
        let names = MEASURES.iter().map(|(name, _)| *name);
        assert!(METRICS.iter().map(|metric| metric.name).eq(names));
    }
}
