//! What a run came to, in numbers, each with its limit.

use scenario::events::Window;
use scenario::metrics::METRICS;

use crate::evidence::{Evidence, Measurement, MetricValue, largest, mean};
use crate::metric::Metric;
use crate::{disturbances, reactions, sequences, signals, sine, steps};

/// The steady state is the mean over this time before the end.
const STEADY_STATE_SECONDS: f64 = 0.5;

/// Measures one metric.
type Measure = fn(&Evidence<'_>) -> Measurement;

/// How each metric is measured, by the names of [`METRICS`] and in their order.
const MEASURES: [(&str, Measure); METRICS.len()] = [
    ("settling_time_seconds", |evidence| {
        steps::settling_time(evidence).into()
    }),
    ("overshoot_percent", |evidence| {
        steps::overshoot(evidence).into()
    }),
    ("steady_state_error_millimetres", |evidence| {
        steady_state_error(evidence).into()
    }),
    ("tracking_error_millimetres_rms", |evidence| {
        tracking_error(evidence).into()
    }),
    ("sine_gain", |evidence| sine::gain(evidence).into()),
    ("sine_phase_degrees", |evidence| {
        sine::phase_degrees(evidence).into()
    }),
    ("sine_offset_millimetres", |evidence| {
        sine::offset_millimetres(evidence).into()
    }),
    (
        "maximum_deviation_millimetres",
        disturbances::maximum_deviation,
    ),
    ("recovery_time_seconds", disturbances::recovery_time),
    ("position_millimetres_max", |evidence| {
        position_max(evidence).into()
    }),
    ("current_amperes_rms", |evidence| {
        current_rms(evidence).into()
    }),
    ("missed_cycles_percent", |evidence| {
        Measurement::Measured(Ok(evidence.misses().percent()))
    }),
    ("bus_load_percent", |evidence| {
        traffic(evidence.timeline.bus_load_percent).into()
    }),
    ("sync_interval_milliseconds_max", |evidence| {
        traffic(evidence.timeline.sync_interval_milliseconds_max).into()
    }),
    ("temperature_celsius", reactions::temperature_max),
    ("no_event", reactions::unwanted_events),
    ("current_zero_within_milliseconds", reactions::current_zero),
    ("recovers_within_seconds", reactions::recovery_from_faults),
    ("safe_state", reactions::safe_state),
    ("emcy", reactions::missing_emergencies),
];

/// All rows of the verdict: the metrics that the scenario gives a meaning to or a limit, then its checks.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let expect = &evidence.scenario.expect;
    let metrics = METRICS.iter().zip(MEASURES);
    let metrics = metrics.filter_map(|(metric, (name, measure))| {
        measure(evidence).metric(name, metric.limit(expect))
    });
    let mut rows: Vec<Metric> = metrics
        .chain(signals::metrics(evidence))
        .chain(sequences::metrics(evidence))
        .collect();
    let requirements = expect.requirements_of_rows();
    for row in &mut rows {
        let own = requirements.get(&row.name);
        row.requirements = own.cloned().unwrap_or_default();
    }
    rows
}

fn steady_state_error(evidence: &Evidence<'_>) -> MetricValue {
    let until_seconds = evidence.scenario.duration_seconds;
    let window = Window {
        from_seconds: until_seconds - STEADY_STATE_SECONDS,
        until_seconds,
    };
    let samples = || evidence.samples(window);
    let set_points = || samples().map(|sample| sample.set_point_millimetres);
    let mut pairs = set_points().zip(set_points().skip(1));
    if pairs.any(|(before, after)| before != after) {
        return Err("the set-point moves at the end".to_owned());
    }
    mean(samples().map(|sample| sample.deviation_millimetres()))
}

fn tracking_error(evidence: &Evidence<'_>) -> MetricValue {
    let window = evidence.scenario.judged_sine().unwrap_or(evidence.whole());
    let samples = evidence.samples(window);
    let squares = samples.map(|sample| sample.deviation_millimetres().powi(2));
    mean(squares).map(f64::sqrt)
}

fn position_max(evidence: &Evidence<'_>) -> MetricValue {
    let samples = evidence.samples(evidence.whole());
    largest(samples.map(|sample| sample.position_millimetres))
}

fn current_rms(evidence: &Evidence<'_>) -> MetricValue {
    let currents = evidence.timeline.current().iter();
    let squares = currents
        .filter(|current| !current.is_nan())
        .map(|current| current.powi(2));
    mean(squares).map(f64::sqrt)
}

fn traffic(value: f64) -> MetricValue {
    if value.is_nan() {
        Err("no two SYNCs in the recording".to_owned())
    } else {
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same names in the same order, and the keys of the schema's `[expect]`.
    #[test]
    fn each_metric_of_a_scenario_is_measured() {
        let names = MEASURES.map(|(name, _)| name);
        assert!(METRICS.iter().map(|metric| metric.name).eq(names));
        let schema = scenario::schema::json_schema();
        let schema: serde_json::Value = serde_json::from_str(&schema).unwrap();
        let keys = schema["definitions"]["Expect"]["properties"].as_object();
        let is_table = |key: &&String| {
            let tables = ["requirements", "sequence", "signal", "timing"];
            tables.contains(&key.as_str())
        };
        let keys = keys.unwrap().keys().filter(|key| !is_table(key));
        let mut names = names.to_vec();
        names.sort_unstable();
        assert!(keys.eq(names));
    }
}
