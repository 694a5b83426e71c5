//! Participant in this process.

use std::time::Duration;

use can::{CanFrame, Node};

use super::audience::Audience;
use super::participant::{Answer, Failure, Participant};
use super::protocol::Hello;
use super::step::Stepper;

/// Node in this process.
pub struct Local<'a> {
    name: String,
    hello: Hello,
    node: &'a mut dyn Node,
    stepper: Stepper,
}

impl<'a> Local<'a> {
    /// Makes the node a participant; `name` is for messages.
    pub fn new(name: impl Into<String>, node: &'a mut dyn Node) -> Self {
        Self {
            name: name.into(),
            hello: Hello::of(node),
            stepper: Stepper::new(node),
            node,
        }
    }
}

impl Participant for Local<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn meet(&mut self, audience: &Audience) {
        self.stepper.meet(audience.quiet().into());
    }

    fn advance(
        &mut self,
        to: Duration,
        until: Duration,
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), Failure> {
        let times = (to, until);
        Ok(self.stepper.advance(self.node, times, frames, answer)?)
    }

    fn stop(&mut self, at: Duration, answer: &mut Answer) -> Result<(), Failure> {
        Ok(self.stepper.stop(self.node, at, answer)?)
    }
}
