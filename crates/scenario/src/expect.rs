//! The `[expect]` table: conditions of a pass. Every key is optional, every limit two-sided.

mod sequence;
mod signal;

use std::collections::BTreeMap;
use std::str::FromStr;

use schemars::{JsonSchema, Schema};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

pub use crate::limit::{Limit, rounded};
use crate::metrics::{Form, METRICS, Metric, Subject};
use crate::timing::TimingLimits;
use crate::trial::Trial;

pub use sequence::{Expected, Sequence};
pub use signal::{Course, Demand, SignalCheck};

/// Names of requirements, such as "REQ-12", in the system that lists them.
pub type Requirements = Vec<String>;

/// Expectation of a metric.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expectation {
    /// Limit of its value. A yes is exactly 1, a no exactly 0.
    pub limit: Limit,
    /// Texts of a list. The limit is then exactly 0: none of its events may happen, and none of its emergencies may be missing.
    pub texts: Vec<String>,
}

/// Row that a scenario demands of a verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedRow {
    /// Name of the row.
    pub name: String,
    /// Limit of its value; `None` if the value is only reported.
    pub limit: Option<Limit>,
    /// Requirements that it tests.
    pub requirements: Requirements,
}

/// Limits on the metrics of a run.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default, remote = "Self")]
#[schemars(transform = add_metrics)]
pub struct Expect {
    /// Expectations of metrics, each by the name of its metric. The others are keys of their own.
    #[serde(skip)]
    metrics: BTreeMap<&'static str, Expectation>,
    /// Largest deviation from the set-point that counts as recovered, for `recovery_time_seconds`, `recovers_within_seconds` and
    /// `current_ripple_amperes_rms`. If absent 0.25 mm; in a loop of another unit 1/240 of the sensor's range, as 0.25 mm are of
    /// 60 mm.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    #[serde(rename = "recovery_band_{unit}")]
    pub recovery_band: Option<f64>,
    /// Requirements that single limits test, by the limit's key, `overshoot_percent = ["REQ-12"]`; for limits of
    /// `[expect.timing]` by key and quantile, `round_trip_microseconds_p99 = ["REQ-13"]`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub requirements: BTreeMap<String, Requirements>,
    /// End of the time on which the metrics of position, current and traffic are judged; later the loop is meant to be open,
    /// because a node dies on purpose. Reactions to faults, signals and sequences are judged to the end of the scenario.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = crate::TIME_SECONDS_MAX))]
    pub judged_until_seconds: Option<f64>,
    /// Demands on signals, each in its window of time.
    #[schemars(length(max = 1000))]
    pub signal: Vec<SignalCheck>,
    /// Lists of events that must come one after the other.
    #[schemars(length(max = 100))]
    pub sequence: Vec<Sequence>,
    /// Limits on latencies in real time; virtual time ignores them.
    pub timing: TimingLimits,
}

impl Expect {
    /// Returns the expectation of a metric.
    pub fn of(&self, metric: &str) -> Option<&Expectation> {
        self.metrics.get(metric)
    }

    /// Returns the limit of a metric; `None` if it has no expectation.
    pub fn limit(&self, metric: &str) -> Option<Limit> {
        self.of(metric).map(|expected| expected.limit)
    }

    /// Returns the texts that a metric lists.
    pub fn listed(&self, metric: &str) -> &[String] {
        self.of(metric).map_or(&[], |expected| &expected.texts)
    }

    /// Sets the largest value of a metric that has a two-sided limit.
    ///
    /// # Panics
    /// No metric has this name.
    #[must_use]
    pub fn with_max(mut self, metric: &str, max: f64) -> Self {
        let metric = Metric::named(metric).expect("a metric of the table");
        let expected = Expectation {
            limit: at_most(max),
            ..Expectation::default()
        };
        self.metrics.insert(metric.name, expected);
        self
    }

    /// Returns the metrics that have an expectation, each with its limit, in the order of the table.
    pub fn limits(&self) -> impl Iterator<Item = (&'static Metric, Limit)> {
        let metrics = METRICS.iter();
        metrics.filter_map(|metric| Some((metric, self.limit(metric.name)?)))
    }

    /// Returns the row of a metric.
    pub fn row(&self, name: String, limit: Option<Limit>) -> ExpectedRow {
        let requirements = self.requirements.get(&name).cloned().unwrap_or_default();
        ExpectedRow {
            name,
            limit,
            requirements,
        }
    }

    /// Returns the signals that checks and sequences name, each with the path of its name in the file.
    pub fn named_signals(&self) -> impl Iterator<Item = (String, &str)> {
        let checks = self.signal.iter().enumerate();
        let checks = checks
            .map(|(index, check)| (format!("expect.signal.{index}.name"), check.name.as_str()));
        let sequences = self.sequence.iter().enumerate();
        let events = sequences.flat_map(|(index, sequence)| {
            let events = sequence.event.iter().enumerate();
            events.filter_map(move |(place, event)| {
                let path = format!("expect.sequence.{index}.event.{place}.signal");
                Some((path, event.signal.as_deref()?))
            })
        });
        checks.chain(events)
    }
}

impl Trial {
    /// Returns the expectations to which a metric belongs: those of the loop or of the bus.
    pub fn expect_of(&self, metric: &Metric) -> &Expect {
        match metric.subject {
            Subject::Bus => &self.run.expect,
            _ => &self.expect,
        }
    }

    /// Returns the rows of the loop's verdict that have a limit, in their order, without those on timing.
    pub fn expected_rows(&self) -> Vec<ExpectedRow> {
        let (expect, duration_seconds) = (&self.expect, self.run.duration_seconds);
        let metrics = METRICS.iter().filter_map(|metric| {
            let expect = self.expect_of(metric);
            let name = self.wiring.quantities.name(metric.name);
            Some(expect.row(name, Some(expect.limit(metric.name)?)))
        });
        let checks = expect.signal.iter();
        let check_rows = checks.flat_map(|check| check.rows(duration_seconds));
        let sequences = expect.sequence.iter();
        let sequence_rows = sequences.flat_map(|sequence| sequence.rows(duration_seconds));
        metrics.chain(check_rows).chain(sequence_rows).collect()
    }
}

impl<'de> Deserialize<'de> for Expect {
    /// Reads the table. The loader has checked its keys and types by the schema before.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut table = toml::Table::deserialize(deserializer)?;
        let mut metrics = BTreeMap::new();
        for metric in METRICS {
            if let Some(value) = table.remove(metric.name) {
                let read = expected(metric.form, value)
                    .map_err(|error| D::Error::custom(error.message()))?;
                // An empty list expects nothing.
                if metric.form != Form::List || !read.texts.is_empty() {
                    metrics.insert(metric.name, read);
                }
            }
        }
        let others = Self::deserialize(toml::Value::from(table))
            .map_err(|error| D::Error::custom(error.message()))?;
        Ok(Self { metrics, ..others })
    }
}

fn expected(form: Form, value: toml::Value) -> Result<Expectation, toml::de::Error> {
    let mut texts = Vec::new();
    let limit = match form {
        Form::TwoSided => value.try_into()?,
        Form::AtMost(_) => at_most(value.try_into()?),
        Form::Answer => exactly(if value.try_into()? { 1.0 } else { 0.0 }),
        Form::List => {
            texts = value.try_into()?;
            exactly(0.0)
        }
    };
    Ok(Expectation { limit, texts })
}

/// Returns an upper limit.
pub fn at_most(max: f64) -> Limit {
    let max = Some(max);
    Limit { min: None, max }
}

fn exactly(value: f64) -> Limit {
    let (min, max) = (Some(value), Some(value));
    Limit { min, max }
}

/// Adds the keys of the metrics to the schema.
fn add_metrics(schema: &mut Schema) {
    let keys = METRICS
        .iter()
        .map(|metric| (metric.name.to_owned(), metric.schema()));
    if let Some(Value::Object(properties)) = schema.get_mut("properties") {
        properties.extend(keys);
    }
}

/// Emergency of a node, written as "drive 0x8130".
#[derive(Clone, Debug, Default, Eq, Ord, PartialEq, PartialOrd)]
pub struct Emergency {
    /// Name of the node on the rig.
    pub node: String,
    /// Error code (CiA 301, table 26).
    pub code: u16,
}

impl FromStr for Emergency {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (node, code) = text
            .split_once(" 0x")
            .ok_or("must be node and code, as in \"drive 0x8130\"")?;
        let code = u16::from_str_radix(code, 16)
            .map_err(|_| "the code must have four hexadecimal digits")?;
        Ok(Self {
            node: node.to_owned(),
            code,
        })
    }
}
