//! How two runs differ.

use serde::Serialize;

/// How a signal of two runs differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignalDifference {
    /// The signal.
    pub name: String,
    /// Its unit in the DBC.
    pub unit: String,
    /// What it may differ by; none for any difference.
    pub tolerance: Option<f64>,
    /// The largest difference; none where one of the runs has no values.
    pub largest: Option<f64>,
    /// When that is.
    pub largest_at_seconds: Option<f64>,
    /// Root mean square of the differences, cycle by cycle; none where the runs have no values in common.
    pub rms: Option<f64>,
    /// By how much the second run comes later, where a shift explains a part of the differences; 0 where none does.
    pub lag_seconds: Option<f64>,
    /// When it first differs by more than the tolerance.
    pub diverges_at_seconds: Option<f64>,
    /// Share of the cycles in which it does.
    pub beyond_percent: f64,
}

impl SignalDifference {
    /// Whether it stays within its tolerance.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.diverges_at_seconds.is_none()
    }

    /// Takes in the differences with their times; those that are NaN are of cycles in which a run has no value.
    pub(super) fn judge(&mut self, differences: impl Iterator<Item = (f64, f64)>, tolerance: f64) {
        let (mut compared, mut beyond) = (0.0, 0.0);
        for (difference, time) in differences.filter(|(difference, _)| !difference.is_nan()) {
            compared += 1.0;
            if self.largest.is_none_or(|largest| difference > largest) {
                (self.largest, self.largest_at_seconds) = (Some(difference), Some(time));
            }
            if difference > tolerance {
                beyond += 1.0;
                self.diverges_at_seconds.get_or_insert(time);
            }
        }
        if compared > 0.0 {
            self.beyond_percent = 100.0 * beyond / compared;
        }
    }

    /// The largest difference by the tolerance, to sort by.
    pub(super) fn weight(&self) -> f64 {
        match (self.largest, self.tolerance) {
            (Some(0.0), _) => 0.0,
            (Some(largest), Some(tolerance)) => largest / tolerance,
            // What is not judged comes after all that is, and before what is the same.
            (Some(_), None) => f64::MIN_POSITIVE,
            (None, _) => 0.0,
        }
    }
}

/// How a metric of two runs differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricDifference {
    /// The metric.
    pub name: String,
    /// Its value in the first run.
    pub a: Option<f64>,
    /// Its value in the second run.
    pub b: Option<f64>,
    /// What it may differ by.
    pub tolerance: f64,
    /// Whether it stays within that, or is missing in both.
    pub agrees: bool,
}

/// Two runs side by side.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Whether nothing differs by more than its tolerance.
    pub agrees: bool,
    /// What is not a signal and not a metric.
    pub remarks: Vec<String>,
    /// Cycles that both runs have.
    pub shared_cycles: usize,
    /// All signals, what differs most by its tolerance first.
    pub signals: Vec<SignalDifference>,
    /// All metrics.
    pub metrics: Vec<MetricDifference>,
}
