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

    /// The quantities of which the paper or a target speaks, of every law and plant.
    #[must_use]
    pub(crate) fn headline(&self) -> Vec<&Quantity> {
        let numbers = &self.evaluation.numbers;
        let is_compared = |name: &str| {
            let mut own = numbers.iter().filter(|number| number.name() == name);
            own.any(Quantity::is_compared)
        };
        let headline = numbers.iter().filter(|number| is_compared(number.name()));
        headline.collect()
    }
}
