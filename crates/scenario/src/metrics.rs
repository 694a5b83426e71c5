//! The metrics that `[expect]` limits, in the order of the verdict's rows: names, units and limits. The judge has the
//! functions that compute them, under the same names.

use crate::expect::Expect;
use crate::limit::Limit;

/// A metric of a run.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedMetric {
    /// Its key in `[expect]`, which is its name in the verdict.
    pub name: &'static str,
    /// The unit, as the name has it; empty for a ratio, a count or a yes.
    pub unit: &'static str,
    limit: Given,
}

/// How `[expect]` gives a metric its limit.
#[derive(Clone, Copy, Debug)]
enum Given {
    /// As a limit with two sides.
    Limit(fn(&Expect) -> Option<Limit>),
    /// As a value, a yes or no, or a list, which stand for a limit.
    Demand(fn(&Expect) -> Option<Limit>),
}

impl ExpectedMetric {
    const fn limited(
        name: &'static str,
        unit: &'static str,
        limit: fn(&Expect) -> Option<Limit>,
    ) -> Self {
        Self {
            name,
            unit,
            limit: Given::Limit(limit),
        }
    }

    const fn demanded(
        name: &'static str,
        unit: &'static str,
        limit: fn(&Expect) -> Option<Limit>,
    ) -> Self {
        Self {
            name,
            unit,
            limit: Given::Demand(limit),
        }
    }

    /// What passes; none where nothing is expected of the metric.
    #[must_use]
    pub fn limit(&self, expect: &Expect) -> Option<Limit> {
        let (Given::Limit(limit) | Given::Demand(limit)) = self.limit;
        limit(expect)
    }

    /// Whether the file gives the limit with its two sides.
    fn has_sides(&self) -> bool {
        matches!(self.limit, Given::Limit(_))
    }
}

/// All metrics.
pub static METRICS: [ExpectedMetric; 24] = {
    use ExpectedMetric as Metric;
    [
        Metric::limited("settling_time_seconds", "seconds", |expect| {
            expect.settling_time_seconds
        }),
        Metric::limited("overshoot_percent", "percent", |expect| {
            expect.overshoot_percent
        }),
        Metric::limited("steady_state_error_millimetres", "millimetres", |expect| {
            expect.steady_state_error_millimetres
        }),
        Metric::limited("tracking_error_millimetres_rms", "millimetres", |expect| {
            expect.tracking_error_millimetres_rms
        }),
        Metric::limited("sine_gain", "", |expect| expect.sine_gain),
        Metric::limited("sine_phase_degrees", "degrees", |expect| {
            expect.sine_phase_degrees
        }),
        Metric::limited("sine_offset_millimetres", "millimetres", |expect| {
            expect.sine_offset_millimetres
        }),
        Metric::limited("bandwidth_hertz", "hertz", |expect| expect.bandwidth_hertz),
        Metric::limited("maximum_deviation_millimetres", "millimetres", |expect| {
            expect.maximum_deviation_millimetres
        }),
        Metric::limited("recovery_time_seconds", "seconds", |expect| {
            expect.recovery_time_seconds
        }),
        Metric::limited("position_millimetres_max", "millimetres", |expect| {
            expect.position_millimetres_max
        }),
        Metric::limited("current_amperes_rms", "amperes", |expect| {
            expect.current_amperes_rms
        }),
        Metric::limited("current_ripple_amperes_rms", "amperes", |expect| {
            expect.current_ripple_amperes_rms
        }),
        Metric::limited("hunting_millimetres", "millimetres", |expect| {
            expect.hunting_millimetres
        }),
        Metric::limited("missed_cycles_percent", "percent", |expect| {
            expect.missed_cycles_percent
        }),
        Metric::limited("missed_commands_percent", "percent", |expect| {
            expect.missed_commands_percent
        }),
        Metric::limited("bus_load_percent", "percent", |expect| {
            expect.bus_load_percent
        }),
        Metric::limited("sync_interval_milliseconds_max", "milliseconds", |expect| {
            expect.sync_interval_milliseconds_max
        }),
        Metric::limited("temperature_celsius", "celsius", |expect| {
            expect.temperature_celsius
        }),
        Metric::demanded("no_event", "", |expect| nothing_of(&expect.no_event)),
        Metric::demanded(
            "current_zero_within_milliseconds",
            "milliseconds",
            |expect| expect.current_zero_within_milliseconds.map(at_most),
        ),
        Metric::demanded("recovers_within_seconds", "seconds", |expect| {
            expect.recovers_within_seconds.map(at_most)
        }),
        Metric::demanded("safe_state", "", |expect| {
            let wanted = |is_safe| exactly(if is_safe { 1.0 } else { 0.0 });
            expect.safe_state.map(wanted)
        }),
        Metric::demanded("emcy", "", |expect| nothing_of(&expect.emcy)),
    ]
};

/// Whether the value of a metric means yes: the bench is safe, none of the events happened, every emergency came. None for
/// metrics that are numbers. `name` may begin with that of a loop.
#[must_use]
pub fn answer(name: &str, value: f64) -> Option<bool> {
    match name.rsplit('.').next()? {
        "safe_state" => Some(value == 1.0),
        // The number of those that should not have been, or that were missed.
        "no_event" | "emcy" => Some(value == 0.0),
        _ => None,
    }
}

impl Expect {
    /// The limits with two sides that are given, each with the name of its metric.
    pub fn limits(&self) -> impl Iterator<Item = (&'static str, Limit)> {
        let limits = METRICS.iter().filter(|metric| metric.has_sides());
        limits.filter_map(|metric| Some((metric.name, metric.limit(self)?)))
    }

    /// The names of all metrics of which something is expected.
    pub fn keys(&self) -> impl Iterator<Item = &'static str> {
        let is_given = |metric: &&ExpectedMetric| metric.limit(self).is_some();
        METRICS.iter().filter(is_given).map(|metric| metric.name)
    }
}

fn at_most(max: f64) -> Limit {
    Limit {
        min: None,
        max: Some(max),
    }
}

fn exactly(value: f64) -> Limit {
    Limit {
        min: Some(value),
        max: Some(value),
    }
}

/// None of what is listed may be there, or missing; without a list there is no limit.
fn nothing_of(listed: &[String]) -> Option<Limit> {
    (!listed.is_empty()).then(|| exactly(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_reads_its_own_key() {
        for metric in METRICS {
            let text = match metric.name {
                "no_event" | "emcy" => format!("{} = [\"drive 0x8130\"]", metric.name),
                "safe_state" => "safe_state = true".to_owned(),
                name if metric.has_sides() => format!("{name} = {{ max = 1.0 }}"),
                name => format!("{name} = 1.0"),
            };
            let expect: Expect = toml::from_str(&text).unwrap();
            let given: Vec<&str> = METRICS
                .iter()
                .filter(|one| one.limit(&expect).is_some())
                .map(|metric| metric.name)
                .collect();
            assert_eq!(given, [metric.name]);
            assert!(expect.keys().eq([metric.name]));
        }
    }

    /// What a scenario that demands it must be shown as its limit.
    #[test]
    fn a_demand_that_is_no_number_is_a_yes() {
        let text = "safe_state = true\nno_event = [\"loss\"]\nemcy = [\"drive 0x8130\"]\n";
        let expect: Expect = toml::from_str(text).unwrap();
        let answers = METRICS.iter().filter_map(|metric| {
            let wanted = metric.limit(&expect)?.min?;
            Some((metric.name, answer(metric.name, wanted)))
        });
        let yes = ["no_event", "safe_state", "emcy"].map(|name| (name, Some(true)));
        assert!(answers.eq(yes));
        assert_eq!(answer("safe_state", 0.0), Some(false));
        assert_eq!(answer("overshoot_percent", 0.0), None);
    }

    #[test]
    fn a_name_has_its_unit() {
        for metric in METRICS {
            let words: Vec<&str> = metric.name.split('_').collect();
            assert!(metric.unit.is_empty() || words.contains(&metric.unit));
        }
    }

    /// The keys of `[expect]` are the metrics, the end of the judgement, and the tables of checks.
    #[test]
    fn the_schema_has_the_same_names() {
        let schema = crate::schema::schema_of::<Expect>();
        let keys = schema["properties"].as_object().unwrap().keys();
        let others = [
            "judged_until_seconds",
            "recovery_band_millimetres",
            "requirements",
            "sequence",
            "signal",
            "timing",
        ];
        let mut names = METRICS.map(|metric| metric.name).to_vec();
        names.extend(others);
        names.sort_unstable();
        assert!(names.iter().eq(keys));
    }
}
