//! What an experiment came to.

use super::experiment::{Evaluation, Experiment};
use super::quantity::Quantity;

/// An experiment with what it came to.
pub(crate) struct ExperimentResult {
    /// What was done.
    pub experiment: Experiment,
    /// What came of it.
    pub evaluation: Evaluation,
}

impl ExperimentResult {
    /// False where a target is missed.
    #[must_use]
    pub(crate) fn holds(&self) -> bool {
        self.evaluation.numbers.iter().all(Quantity::holds)
    }
}
