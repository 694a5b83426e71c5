//! A participant in this process.

use std::time::Duration;

use canopen::{CanFrame, Filter, Node, Progress};

use super::step::{StepError, Stepper};
use super::{Answer, Audience, LockstepError, Participant};

/// A node in this process; the step happens in `begin`.
pub struct Local<'a> {
    name: String,
    filters: Vec<Filter>,
    silent_filters: Vec<Filter>,
    node: &'a mut dyn Node,
    stepper: Stepper,
    answer: Option<Result<Answer, StepError>>,
    /// The list for the next answer's frames.
    spare: Vec<(Duration, CanFrame)>,
}

impl<'a> Local<'a> {
    /// Makes the node a participant; `name` is for messages.
    pub fn new(name: impl Into<String>, node: &'a mut dyn Node) -> Self {
        Self {
            name: name.into(),
            filters: node.filters(),
            silent_filters: node.silent_filters(),
            stepper: Stepper::new(node),
            node,
            answer: None,
            spare: Vec::new(),
        }
    }

    fn answer(&mut self, result: Result<Progress, StepError>, frames: Vec<(Duration, CanFrame)>) {
        self.answer = Some(result.map(|progress| Answer {
            frames,
            next_deadline: self.stepper.next_deadline(),
            reached: self.stepper.now(),
            progress,
        }));
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
        self.stepper.next_deadline()
    }

    fn silent_filters(&self) -> &[Filter] {
        &self.silent_filters
    }

    fn meet(&mut self, audience: &Audience) {
        self.stepper.meet(audience.clone());
    }

    fn begin_ahead(&mut self, to: Duration, until: Duration, frames: &[(Duration, CanFrame)]) {
        let mut queued = std::mem::take(&mut self.spare);
        let result = self
            .stepper
            .advance(self.node, (to, until), frames, &mut queued);
        self.answer(result, queued);
    }

    fn begin_stop(&mut self, at: Duration) {
        let mut queued = Vec::new();
        let result = self.stepper.stop(self.node, at, &mut queued);
        self.answer(result, queued);
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

    fn reuse(&mut self, emptied: Vec<(Duration, CanFrame)>) {
        self.spare = emptied;
    }
}
