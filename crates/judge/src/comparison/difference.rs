//! The differences between two runs.

use serde::Serialize;

/// Difference of a signal between two runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SignalDifference {
    /// Name of the signal.
    pub name: String,
    /// Unit of the signal in the DBC.
    pub unit: String,
    /// Tolerance of the signal; `None` if any difference is allowed.
    pub tolerance: Option<f64>,
    /// Largest difference; `None` if one of the runs has no values.
    pub largest: Option<f64>,
    /// Time of the largest difference.
    pub largest_at_seconds: Option<f64>,
    /// Root mean square of the differences, cycle by cycle; `None` if the runs have no values in common.
    pub rms: Option<f64>,
    /// Time by which the second run comes later, if a shift explains a part of the differences; 0 if none does.
    pub lag_seconds: Option<f64>,
    /// Time at which the signal first differs by more than the tolerance.
    pub diverges_at_seconds: Option<f64>,
    /// Percentage of the cycles in which it differs by more than the tolerance.
    pub beyond_percent: f64,
    /// Number of cycles before and after each that count as the same time.
    #[serde(skip)]
    pub(super) reach: usize,
}

impl SignalDifference {
    /// Returns whether the signal stays within its tolerance.
    pub fn agrees(&self) -> bool {
        self.diverges_at_seconds.is_none()
    }

    /// Adds the differences with their times. A difference is NaN in a cycle in which a run has no value.
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

    /// Returns the largest difference divided by the tolerance, as a key to sort by.
    pub(super) fn weight(&self) -> f64 {
        match (self.largest, self.tolerance) {
            (Some(0.0), _) => 0.0,
            (Some(largest), Some(tolerance)) => largest / tolerance,
            // Signals that are not judged come after all that are, and before equal ones.
            (Some(_), None) => f64::MIN_POSITIVE,
            (None, _) => 0.0,
        }
    }
}

/// Difference of a metric between two runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricDifference {
    /// Name of the metric.
    pub name: String,
    /// Value in the first run.
    pub a: Option<f64>,
    /// Value in the second run.
    pub b: Option<f64>,
    /// Tolerance of the metric.
    pub tolerance: f64,
    /// Whether the difference is within the tolerance, or the metric is missing in both runs.
    pub agrees: bool,
}

/// Comparison of two runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Whether all differences are within their tolerances.
    pub agrees: bool,
    /// Differences other than those of signals and metrics.
    pub remarks: Vec<String>,
    /// Number of cycles that both runs have.
    pub shared_cycles: usize,
    /// All signals, sorted by difference relative to the tolerance, the largest first.
    pub signals: Vec<SignalDifference>,
    /// Difference of each metric.
    pub metrics: Vec<MetricDifference>,
}
