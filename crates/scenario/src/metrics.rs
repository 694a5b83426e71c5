//! The table of metrics that `[expect]` limits, in the order of the verdict's rows. The schema, the checks of a scenario and the
//! judge read its columns; the judge has the function of each row, under the same name.

use serde_json::{Value, json};

use crate::trial::Trial;

/// Metric of a run.
#[derive(Clone, Copy, Debug)]
pub struct Metric {
    /// Key in `[expect]`, and name in the verdict, with the unit in it unless it is a ratio, a count or an answer.
    pub name: &'static str,
    /// Part of a run that it measures.
    pub subject: Subject,
    /// Part of a scenario that gives it a meaning.
    pub needs: Needs,
    /// Largest value for a node under test that is not canrig's, if the scenario has no limit.
    pub default_max: Option<f64>,
    /// Form of its limit in `[expect]`.
    pub form: Form,
    /// Description in the schema and in the book.
    pub text: &'static str,
}

/// Part of a run that a metric measures.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Subject {
    /// Position of the loop. It has a second value if measured and true position differ.
    Position,
    /// Current of the drive.
    Current,
    /// Cycles of the drive. Their metrics have a value of any recording, however early it ends.
    Drive,
    /// Commands of the controller and its SYNC, as those of the drive.
    Cycles,
    /// The whole bus, which all loops share; its metrics have a value as those of the cycles have.
    Bus,
    /// Plant and its events.
    Plant,
}

/// Part of a scenario that gives a metric a meaning.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Needs {
    /// No part: it has a meaning in every scenario.
    Nothing,
    /// A step of the set-point.
    Step,
    /// A set-point.
    SetPoint,
    /// A sine of the set-point.
    Sine,
    /// A chirp of the set-point.
    Chirp,
    /// A set-point and a disturbance.
    Disturbance,
    /// A fault.
    Fault,
    /// A fault and a set-point.
    FaultAndSetPoint,
}

/// Form of a metric's limit in `[expect]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// `{ min = …, max = … }`
    TwoSided,
    /// Largest value, at most this number and at least 0.
    AtMost(f64),
    /// Yes or no.
    Answer,
    /// A list of texts.
    List,
}

use Form::{Answer, AtMost, List, TwoSided};

/// Longest time in milliseconds that a scenario can demand.
const MILLISECONDS_MAX: f64 = 1e6;
/// Largest number of entries of a list.
const ENTRIES_MAX: usize = 100;

/// All metrics.
pub static METRICS: &[Metric] = &[
    Metric {
        name: "settling_time_seconds",
        needs: Needs::Step,
        text: "Time from a step to the first sample from which on the position stays within ± 5 % of the step's height.",
        ..POSITION
    },
    Metric {
        name: "overshoot_percent",
        needs: Needs::Step,
        text: "Largest distance of the position beyond the final set-point, in percent of the step's height.",
        ..POSITION
    },
    Metric {
        name: "steady_state_error_{unit}",
        text: "Mean absolute error over the last 0.5 s of the scenario, in which the set-point must not move.",
        ..POSITION
    },
    Metric {
        name: "tracking_error_{unit}_rms",
        text: "RMS of set-point minus position: over the last three periods of a sine, else over the whole run.",
        ..POSITION
    },
    Metric {
        name: "sine_gain",
        needs: Needs::Sine,
        text: "Amplitude of the position divided by that of the set-point, at the frequency of a sine, over its last three periods.",
        ..POSITION
    },
    Metric {
        name: "sine_phase_degrees",
        needs: Needs::Sine,
        text: "Phase of the position minus that of the set-point, from -270 to 90, measured as `sine_gain`.",
        ..POSITION
    },
    Metric {
        name: "sine_offset_{unit}",
        needs: Needs::Sine,
        text: "Mean of the position minus that of the set-point, measured as `sine_gain`.",
        ..POSITION
    },
    Metric {
        name: "bandwidth_hertz",
        needs: Needs::Chirp,
        text: "Last frequency of a chirp before the gain first falls below 0.708.",
        ..POSITION
    },
    Metric {
        name: "bandwidth_with_mean_hertz",
        needs: Needs::Chirp,
        text: "As `bandwidth_hertz`, but at most the last frequency before the mean of the position differs from that of the set-point by more than a tenth of the amplitude.",
        ..POSITION
    },
    Metric {
        name: "maximum_deviation_{unit}",
        needs: Needs::Disturbance,
        text: "Largest deviation from the set-point, from the start of a disturbance until the next change of the set-point, a disturbance or a fault, for at least 3 s after its end.",
        ..POSITION
    },
    Metric {
        name: "recovery_time_seconds",
        needs: Needs::Disturbance,
        text: "Time from the start of a disturbance until the deviation stays within the recovery band.",
        ..POSITION
    },
    Metric {
        name: "{signal}_{unit}_max",
        needs: Needs::Nothing,
        text: "Largest position over the run.",
        ..POSITION
    },
    Metric {
        name: "{command}_{command_unit}_rms",
        text: "RMS of the current over the run.",
        ..CURRENT
    },
    Metric {
        name: "{command}_ripple_{command_unit}_rms",
        needs: Needs::SetPoint,
        text: "Standard deviation of the commanded current in the last hold, from 1 s after the position last entered the recovery band, for at least 2 s.",
        ..CURRENT
    },
    Metric {
        name: "hunting_{unit}",
        text: "Highest minus lowest mean position over 10 ms in the last second, in which the set-point must not move. Above 0.25 mm the loop hunts.",
        ..POSITION
    },
    Metric {
        name: "missed_cycles_percent",
        subject: Subject::Drive,
        default_max: Some(1.0),
        text: "Share of the cycles in which the drive sent no position.",
        ..CYCLES
    },
    Metric {
        name: "missed_commands_percent",
        default_max: Some(1.0),
        text: "Share of the cycles with a position for which the controller sent no command before the next position.",
        ..CYCLES
    },
    Metric {
        name: "late_commands_percent",
        default_max: Some(5.0),
        text: "Share of the cycles with a position whose command came after the next SYNC, and so acts a cycle late.",
        ..CYCLES
    },
    Metric {
        name: "sync_period_error_percent",
        default_max: Some(2.0),
        text: "Largest difference between the mean of 64 consecutive SYNC periods and the SYNC period.",
        ..CYCLES
    },
    Metric {
        name: "bus_load_percent",
        text: "Share of the time since the first SYNC in which frames occupy the bus, computed from their bits.",
        ..BUS
    },
    Metric {
        name: "sync_interval_milliseconds_max",
        text: "Longest time between two SYNCs; longer than the period if the bus or the machine was late.",
        ..BUS
    },
    Metric {
        name: "temperature_celsius",
        text: "Highest temperature of the part that the current heats, wire or winding. Only the emulator knows it; a real drive does not.",
        ..PLANT
    },
    Metric {
        name: "no_event",
        form: List,
        text: "Texts that no event of the run may contain, such as \"emergency\".",
        ..PLANT
    },
    Metric {
        name: "{command}_zero_within_milliseconds",
        needs: Needs::Fault,
        form: AtMost(MILLISECONDS_MAX),
        text: "Longest time from the start of the first fault until no current flows through the plant for at least 0.1 s.",
        ..PLANT
    },
    Metric {
        name: "recovers_within_seconds",
        needs: Needs::FaultAndSetPoint,
        form: AtMost(crate::TIME_SECONDS_MAX),
        text: "Longest time from the end of the last fault until the deviation from the set-point stays within the recovery band.",
        ..POSITION
    },
    Metric {
        name: "safe_state",
        needs: Needs::Fault,
        form: Answer,
        text: "`true`: at the end no current flows, and the drive is disabled or silent. `false`: a current flows, or the drive is enabled.",
        ..PLANT
    },
    Metric {
        name: "emcy",
        needs: Needs::Fault,
        form: List,
        text: "Emergencies that must be sent, each as node and code: \"drive 0x8130\".",
        ..PLANT
    },
];

/// Columns that all rows of a subject share.
const POSITION: Metric = Metric {
    name: "",
    subject: Subject::Position,
    needs: Needs::SetPoint,
    default_max: None,
    form: TwoSided,
    text: "",
};
const CURRENT: Metric = of(Subject::Current);
const CYCLES: Metric = of(Subject::Cycles);
const BUS: Metric = of(Subject::Bus);
const PLANT: Metric = of(Subject::Plant);

const fn of(subject: Subject) -> Metric {
    Metric {
        subject,
        needs: Needs::Nothing,
        ..POSITION
    }
}

impl Metric {
    /// Returns the metric of a name, which may begin with that of a loop, as that of a verdict's row does.
    pub fn named(name: &str) -> Option<&'static Self> {
        let name = without_loop(name);
        METRICS.iter().find(|metric| metric.name == name)
    }

    /// Checks whether it measures the traffic on the bus. Such a metric has a value of a run that broke off, too.
    pub fn is_traffic_metric(&self) -> bool {
        let of_traffic = [Subject::Drive, Subject::Cycles, Subject::Bus];
        of_traffic.contains(&self.subject)
    }

    /// Returns the table of the file that the metric needs and the scenario lacks; a fault is not considered.
    pub fn missing_in(&self, trial: &Trial) -> Option<&'static str> {
        let end_seconds = trial.judged_end_seconds();
        let has_set_point = !trial.reference.is_empty();
        let has_disturbance = || {
            let windows = trial.judged_disturbances();
            let mut begins = windows.iter().map(|one| one.window.from_seconds);
            begins.any(|begin| begin < end_seconds)
        };
        const SET_POINT: &str = "a [[reference.…]]";
        match self.needs {
            Needs::Step if trial.judged_steps().is_empty() => Some("a [[reference.step]]"),
            Needs::Sine if trial.judged_sines().is_empty() => {
                Some("a [[reference.sine]] of at least four periods")
            }
            Needs::Chirp if trial.judged_chirps().is_empty() => {
                Some("a [[reference.chirp]] of at least four turns")
            }
            Needs::Disturbance if !has_disturbance() => Some("a [[disturbance.…]]"),
            Needs::SetPoint | Needs::Disturbance if !has_set_point => Some(SET_POINT),
            Needs::FaultAndSetPoint if !has_set_point => Some(SET_POINT),
            _ => None,
        }
    }

    /// Returns the schema of its key in `[expect]`.
    pub(crate) fn schema(&self) -> Value {
        let mut schema = match self.form {
            TwoSided => json!({ "allOf": [{ "$ref": "#/definitions/Limit" }] }),
            AtMost(max) => {
                json!({ "type": "number", "format": "double", "minimum": 0.0, "maximum": max })
            }
            Answer => json!({ "type": "boolean" }),
            List => json!({
                "type": "array", "items": { "type": "string" }, "maxItems": ENTRIES_MAX
            }),
        };
        schema["description"] = self.text.into();
        schema
    }
}

/// Returns the name of a verdict's row without that of its loop.
pub fn without_loop(row: &str) -> &str {
    row.rsplit_once('.').map_or(row, |(_, name)| name)
}

/// Checks whether a row of a verdict is a metric of the bus, which all loops share.
pub fn is_bus_metric(row: &str) -> bool {
    Metric::named(row).is_some_and(|metric| metric.subject == Subject::Bus)
}

/// Checks whether a row of a verdict is a metric of the traffic.
pub fn is_traffic_metric(row: &str) -> bool {
    Metric::named(row).is_some_and(Metric::is_traffic_metric)
}

/// Returns the answer of a metric that is not a number: the bench is safe, none of the events happened, every emergency came.
/// `None` for metrics that are numbers.
pub fn answer(name: &str, value: f64) -> Option<bool> {
    match Metric::named(name)?.form {
        Answer => Some(value == 1.0),
        // The value counts the events that should not have happened, or the emergencies that did not come.
        List => Some(value == 0.0),
        TwoSided | AtMost(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expect::Expect;
    use dbc::{Quantities, known_units};

    fn given(metric: &Metric) -> String {
        // A pattern is a separate name for TOML.
        let name = format!("\"{}\"", metric.name);
        match metric.form {
            TwoSided => format!("{name} = {{ max = 1.0 }}"),
            AtMost(_) => format!("{name} = 1.0"),
            Answer => format!("{name} = true"),
            List => format!("{name} = [\"drive 0x8130\"]"),
        }
    }

    #[test]
    fn each_metric_reads_its_own_key() {
        for metric in METRICS {
            let expect: Expect = toml::from_str(&given(metric)).unwrap();
            let limited = METRICS
                .iter()
                .filter(|one| expect.limit(one.name).is_some());
            assert!(limited.map(|one| one.name).eq([metric.name]));
            assert!(expect.limits().map(|(one, _)| one.name).eq([metric.name]));
        }
    }

    /// The limit of such a demand is the value that means yes.
    #[test]
    fn a_demand_that_is_no_number_is_a_yes() {
        let text = "safe_state = true\nno_event = [\"loss\"]\nemcy = [\"drive 0x8130\"]\n";
        let expect: Expect = toml::from_str(text).unwrap();
        let answers = METRICS.iter().filter_map(|metric| {
            let wanted = expect.limit(metric.name)?.min?;
            Some((metric.name, answer(metric.name, wanted)))
        });
        let yes = ["no_event", "safe_state", "emcy"].map(|name| (name, Some(true)));
        assert!(answers.eq(yes));
        assert_eq!(answer("safe_state", 0.0), Some(false));
        assert_eq!(answer("overshoot_percent", 0.0), None);
    }

    /// The keys of `[expect]` are the metrics, the end of the judgement, and the tables of checks.
    #[test]
    fn the_schema_has_the_same_names() {
        let schema = crate::schema::schema_of::<Expect>();
        let keys = schema["properties"].as_object().unwrap().keys();
        let others = [
            "judged_until_seconds",
            "recovery_band_{unit}",
            "requirements",
            "sequence",
            "signal",
            "timing",
        ];
        let mut names = Vec::from_iter(METRICS.iter().map(|metric| metric.name));
        names.extend(others);
        names.sort_unstable();
        assert!(names.iter().eq(keys));
    }

    #[test]
    fn a_name_has_its_unit() {
        let has_unit = |metric: &&Metric| {
            let name = Quantities::default().name(metric.name);
            let mut units = known_units().chain(["milliseconds"]);
            units.any(|unit| name.split('_').any(|word| word == unit))
        };
        let without = METRICS.iter().filter(|metric| !has_unit(metric));
        let names = Vec::from_iter(without.map(|metric| metric.name));
        assert_eq!(names, ["sine_gain", "no_event", "safe_state", "emcy"]);
    }
}
