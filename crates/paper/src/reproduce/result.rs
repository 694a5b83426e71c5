//! Result of an experiment.

use super::experiment::{Evaluation, Experiment};
use super::quantity::Quantity;

/// An experiment with its result.
pub(crate) struct ExperimentResult {
    /// The experiment.
    pub experiment: Experiment,
    /// Numbers and figures.
    pub evaluation: Evaluation,
}

impl ExperimentResult {
    /// Returns whether no target is missed.
    pub(crate) fn holds(&self) -> bool {
        self.evaluation.numbers.iter().all(Quantity::holds)
    }

    /// Returns the quantities that have a value in the paper or a target, for every law and plant.
    pub(crate) fn headline(&self) -> Vec<&Quantity> {
        let numbers = &self.evaluation.numbers;
        let is_compared = |name: &str| {
            let mut named = numbers.iter().filter(|number| number.name() == name);
            named.any(Quantity::is_compared)
        };
        let headline = numbers.iter().filter(|number| is_compared(number.name()));
        headline.collect()
    }
}
