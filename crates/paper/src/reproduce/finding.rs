//! What an experiment came to.

use super::experiment::{Evaluation, Experiment};
use super::number::Number;

/// An experiment with what it came to.
pub struct Finding {
    /// What was done.
    pub experiment: Experiment,
    /// What came of it.
    pub evaluation: Evaluation,
}

impl Finding {
    /// False where a target is missed.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.evaluation.numbers.iter().all(Number::holds)
    }
}
