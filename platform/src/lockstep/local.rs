//! A participant in this process.

use std::time::Duration;

use canopen::{CanFrame, Filter, Node};

use super::step::{StepError, Stepper};
use super::{Answer, LockstepError, Participant};

/// A node in this process; the step happens in `begin`.
pub struct Local<'a> {
    name: String,
    filters: Vec<Filter>,
    node: &'a mut dyn Node,
    stepper: Stepper,
    answer: Option<Result<Answer, StepError>>,
}

impl<'a> Local<'a> {
    /// Makes the node a participant; `name` is for messages.
    pub fn new(name: impl Into<String>, node: &'a mut dyn Node) -> Self {
        Self {
            name: name.into(),
            filters: node.filters(),
            node,
            stepper: Stepper::default(),
            answer: None,
        }
    }
}

impl Participant for Local<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn filters(&self) -> &[Filter] {
        &self.filters
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.node.next_deadline()
    }

    fn begin(&mut self, to: Duration, frames: &[(Duration, CanFrame)]) {
        let mut queued = Vec::new();
        let result = self.stepper.advance(self.node, to, frames, &mut queued);
        self.answer = Some(result.map(|progress| Answer {
            frames: queued,
            next_deadline: self.node.next_deadline(),
            progress,
        }));
    }

    fn begin_stop(&mut self, at: Duration) {
        let mut queued = Vec::new();
        let result = self.stepper.stop(self.node, at, &mut queued);
        self.answer = Some(result.map(|progress| Answer {
            frames: queued,
            next_deadline: self.node.next_deadline(),
            progress,
        }));
    }

    fn finish(&mut self) -> Result<Answer, LockstepError> {
        match self.answer.take() {
            Some(Ok(answer)) => Ok(answer),
            Some(Err(source)) => Err(LockstepError::Step {
                name: self.name.clone(),
                source,
            }),
            None => Err(LockstepError::NothingBegun {
                name: self.name.clone(),
            }),
        }
    }
}
