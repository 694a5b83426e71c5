//! One step of a node in virtual time.

use std::time::Duration;

use can::{CanFrame, FilterSet, Node, Progress};

use super::participant::Answer;
use super::protocol::FRAMES_MAX;

/// Largest number of ticks at one instant before a node counts as stuck.
pub(crate) const TICKS_PER_INSTANT_MAX: u32 = 1000;

/// Reason why a step was not possible.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct StepError(String);

impl StepError {
    /// Returns the error for a node that queues more frames than one answer holds.
    #[cold]
    fn too_many_frames() -> Self {
        Self(format!(
            "the node queued more than {FRAMES_MAX} frames in one step"
        ))
    }

    /// Returns the error for a node whose deadline does not move.
    #[cold]
    pub(crate) fn stuck(at: Duration) -> Self {
        Self(format!(
            "the node wants more than {TICKS_PER_INSTANT_MAX} ticks at {at:?}: its deadline does not move"
        ))
    }
}

/// Steps a node and keeps its time.
#[derive(Debug)]
pub(super) struct Stepper {
    now: Duration,
    /// Deadline of the node as of the latest event; the node is asked for it after each event only.
    next_deadline: Option<Duration>,
    /// Progress of the node as of the latest event.
    progress: Progress,
    /// Frames that the node takes in silence.
    silent: FilterSet,
    /// Frames of the node that no participant answers.
    quiet: FilterSet,
}

impl Stepper {
    /// Makes the stepper of a new node, at time zero.
    pub(super) fn new(node: &dyn Node) -> Self {
        Self {
            now: Duration::ZERO,
            next_deadline: node.next_deadline(),
            progress: node.progress(),
            silent: node.silent_filters().into(),
            quiet: Vec::new().into(),
        }
    }

    /// Remembers the frames that no participant answers.
    pub(super) fn meet(&mut self, quiet: FilterSet) {
        self.quiet = quiet;
    }

    /// Advances the node to `to`, then on to `until` if it may.
    pub(super) fn advance(
        &mut self,
        node: &mut dyn Node,
        times: (Duration, Duration),
        frames: &[(Duration, CanFrame)],
        answer: &mut Answer,
    ) -> Result<(), StepError> {
        answer.frames.clear();
        self.go(node, times, frames, &mut answer.frames)?;
        self.fill(answer);
        Ok(())
    }

    fn go(
        &mut self,
        node: &mut dyn Node,
        (to, until): (Duration, Duration),
        frames: &[(Duration, CanFrame)],
        queued: &mut Vec<(Duration, CanFrame)>,
    ) -> Result<(), StepError> {
        self.check_forwards(to)?;
        for (place, (at, frame)) in frames.iter().enumerate() {
            if *at < self.now || *at > to {
                let from = self.now;
                return Err(StepError(format!(
                    "frame {frame} at {at:?} is out of order in the step from {from:?} to {to:?}"
                )));
            }
            self.tick_until(node, queued, |deadline| deadline < *at)?;
            if !self.is_running() {
                return Ok(());
            }
            self.now = *at;
            node.on_frame(self.now, frame);
            let next = frames.get(place + 1);
            if next.is_some_and(|(next, _)| self.needs_nothing_until(*next, frame)) {
                continue;
            }
            self.end_event(node, queued)?;
            if !self.is_running() {
                return Ok(());
            }
        }
        self.tick_until(node, queued, |deadline| deadline <= to)?;
        self.now = to;
        self.look_ahead(node, until, queued)
    }

    /// Completes an answer, except for its frames.
    fn fill(&self, answer: &mut Answer) {
        answer.next_deadline = self.next_deadline;
        answer.reached = self.now;
        answer.progress.clone_from(&self.progress);
    }

    /// Returns whether the node need not be asked after this frame: it took the frame in silence, and its next tick, which may
    /// only have moved away, was not due before `next` anyway.
    fn needs_nothing_until(&self, next: Duration, frame: &CanFrame) -> bool {
        let is_due_before = |deadline| deadline < next;
        self.silent.accepts(frame) && !self.next_deadline.is_some_and(is_due_before)
    }

    /// Continues by the node's own deadlines, one instant after the other.
    fn look_ahead(
        &mut self,
        node: &mut dyn Node,
        until: Duration,
        queued: &mut Vec<(Duration, CanFrame)>,
    ) -> Result<(), StepError> {
        let mut checked = 0;
        while self.is_running() && self.now < until {
            let fresh = &queued[checked..];
            if fresh.iter().any(|(_, frame)| !self.quiet.accepts(frame)) {
                break;
            }
            checked = queued.len();
            let next = self.next_deadline.unwrap_or(until).clamp(self.now, until);
            self.tick_until(node, queued, |deadline| deadline <= next)?;
            self.now = next;
        }
        Ok(())
    }

    /// Asks the node for its safe state.
    pub(super) fn stop(
        &mut self,
        node: &mut dyn Node,
        at: Duration,
        answer: &mut Answer,
    ) -> Result<(), StepError> {
        answer.frames.clear();
        self.check_forwards(at)?;
        self.now = at;
        node.on_stop(at);
        self.end_event(node, &mut answer.frames)?;
        self.fill(answer);
        Ok(())
    }

    /// Ticks the node at each deadline that is `due`. A deadline in the past is met now: time never goes back.
    fn tick_until(
        &mut self,
        node: &mut dyn Node,
        queued: &mut Vec<(Duration, CanFrame)>,
        due: impl Fn(Duration) -> bool,
    ) -> Result<(), StepError> {
        let mut ticks_at_instant = 0;
        while self.is_running() {
            let deadline = self.next_deadline.map(|deadline| deadline.max(self.now));
            let Some(deadline) = deadline.filter(|deadline| due(*deadline)) else {
                break;
            };
            ticks_at_instant = if deadline == self.now {
                ticks_at_instant + 1
            } else {
                0
            };
            if ticks_at_instant > TICKS_PER_INSTANT_MAX {
                return Err(StepError::stuck(self.now));
            }
            self.now = deadline;
            node.on_tick(self.now);
            self.end_event(node, queued)?;
        }
        Ok(())
    }

    fn is_running(&self) -> bool {
        self.progress == Progress::Running
    }

    fn check_forwards(&self, to: Duration) -> Result<(), StepError> {
        if to < self.now {
            let from = self.now;
            return Err(StepError(format!(
                "time would go back from {from:?} to {to:?}"
            )));
        }
        Ok(())
    }

    /// Ends an event: takes all frames that the node wants to send, and asks for its deadline and its progress.
    #[inline]
    fn end_event(
        &mut self,
        node: &mut dyn Node,
        queued: &mut Vec<(Duration, CanFrame)>,
    ) -> Result<(), StepError> {
        while let Some(frame) = node.next_frame() {
            if queued.len() == FRAMES_MAX {
                return Err(StepError::too_many_frames());
            }
            queued.push((self.now, frame));
        }
        self.next_deadline = node.next_deadline();
        self.progress = node.progress();
        Ok(())
    }
}
