//! Agenda of lock-step: the participants with their waiting frames, and the times of their next actions side by side.

use std::collections::VecDeque;
use std::time::Duration;

use can::{CanFrame, Filter, FilterSet, Progress};
use platform::lockstep::{Answer, Audience, Failure, Participant};

use crate::error::WorldError;

/// Frame with the time from which it waits, or at which it arrived.
pub(crate) type Timed = (Duration, CanFrame);

/// Time in nanoseconds. The times of all participants are compared at every event, and one number is compared faster than the two
/// of a `Duration`.
pub(crate) type Nanos = u64;

/// Time of an event that does not happen by itself.
pub(crate) const NEVER: Nanos = Nanos::MAX;

/// Converts a time for comparison.
pub(crate) fn nanos(time: Duration) -> Nanos {
    Nanos::try_from(time.as_nanos()).unwrap_or(NEVER)
}

/// Participant with its waiting frames.
pub(crate) struct Slot<'a> {
    pub(crate) participant: &'a mut dyn Participant,
    /// Frames that it receives.
    pub(crate) accepted: FilterSet,
    /// Received frames that it takes in silence.
    pub(crate) silent: FilterSet,
    /// Listeners that its frames may make send.
    pub(crate) audience: Audience,
    /// Frames that have arrived and were not given to it yet, oldest first.
    pub(crate) inbox: Vec<Timed>,
    /// Whether the inbox holds a frame that it may answer.
    pub(crate) has_answerable: bool,
    /// Frames that it has queued, oldest first: a frame takes part in the arbitration from its time on.
    pub(crate) outbox: VecDeque<Timed>,
    /// Time before which an error passive station may not send.
    pub(crate) suspended_until: Duration,
    /// Last answer of the participant.
    pub(crate) answer: Answer,
}

impl<'a> Slot<'a> {
    pub(crate) fn new(participant: &'a mut dyn Participant) -> Self {
        let hello = participant.hello();
        let answer = Answer {
            next_deadline: hello.next_deadline,
            ..Answer::default()
        };
        Self {
            accepted: hello.filters.clone().into(),
            silent: hello.silent_filters.clone().into(),
            participant,
            audience: Audience::default(),
            inbox: Vec::new(),
            has_answerable: false,
            outbox: VecDeque::new(),
            suspended_until: Duration::ZERO,
            answer,
        }
    }

    /// Returns the time from which its first waiting frame takes part in the arbitration; [`NEVER`] if none waits.
    pub(crate) fn sends_at(&self) -> Nanos {
        let first = self.outbox.front();
        first.map_or(NEVER, |(time, _)| nanos((*time).max(self.suspended_until)))
    }

    /// Returns the earliest time at which it may queue a frame that is not known yet; [`NEVER`] if it has stopped or if only a
    /// frame can wake it.
    pub(crate) fn may_queue_at(&self) -> Nanos {
        let queues_at = match self.answer.progress {
            Progress::Running if self.has_answerable => self.inbox.last().map(|(time, _)| *time),
            Progress::Running => self.answer.next_deadline,
            _ => None,
        };
        queues_at.map_or(NEVER, nanos)
    }

    /// Returns the error for a failure of the participant.
    #[cold]
    pub(crate) fn failed(&self, failure: Failure) -> WorldError {
        let name = self.participant.name().to_owned();
        WorldError::Participant { name, failure }
    }

    /// Takes a frame from the bus that it accepts; returns whether it may answer.
    #[inline]
    pub(crate) fn receive(&mut self, time: Duration, frame: &CanFrame) -> bool {
        if self.answer.progress != Progress::Running {
            return false;
        }
        self.inbox.push((time, *frame));
        let is_answerable = !self.silent.accepts(frame);
        self.has_answerable |= is_answerable;
        is_answerable
    }
}

/// Times of the participants' next actions. All are compared at every event, so they are stored side by side.
pub(crate) struct Agenda {
    /// [`Slot::sends_at`] of each participant.
    pub(crate) sends_at: Vec<Nanos>,
    /// [`Slot::may_queue_at`] of each participant.
    pub(crate) may_queue_at: Vec<Nanos>,
}

impl Agenda {
    pub(crate) fn new(slots: &[Slot<'_>]) -> Self {
        Self {
            sends_at: slots.iter().map(Slot::sends_at).collect(),
            may_queue_at: slots.iter().map(Slot::may_queue_at).collect(),
        }
    }

    /// Updates the times of a participant after a change.
    #[inline]
    pub(crate) fn note(&mut self, index: usize, slot: &Slot<'_>) {
        self.sends_at[index] = slot.sends_at();
        self.may_queue_at[index] = slot.may_queue_at();
    }

    /// Returns the time of the next action of any participant; `now` if that is not later.
    pub(crate) fn next(&self, now: Nanos) -> Nanos {
        first_after(self.sends_at.iter().chain(&self.may_queue_at), now)
    }

    /// Returns the first participant from this index on that may queue a frame by now.
    pub(crate) fn first_to_ask(&self, from: usize, now: Nanos) -> Option<usize> {
        let mut times = self.may_queue_at[from..].iter();
        Some(from + times.position(|time| *time <= now)?)
    }

    /// Returns the time at which another participant may queue a frame; `now` if that is not later.
    pub(crate) fn others_may_queue_at(&self, index: usize, now: Nanos) -> Nanos {
        let (before, behind) = self.may_queue_at.split_at(index);
        first_after(before.iter().chain(&behind[1..]), now)
    }
}

/// Returns the first of some times, or `now`. On a busy bus the search soon ends with `now`.
fn first_after<'a>(mut times: impl Iterator<Item = &'a Nanos>, now: Nanos) -> Nanos {
    let first = times.try_fold(NEVER, |first, time| (*time > now).then(|| first.min(*time)));
    first.unwrap_or(now)
}

/// Returns the audience of one participant. A frame is silent only if all who receive it take it in silence.
pub(crate) fn audience(slots: &[Slot<'_>], index: usize) -> Audience {
    let others = || {
        let others = slots.iter().enumerate().filter(|(at, _)| *at != index);
        others.map(|(_, slot)| slot)
    };
    let is_silent = |filter: &&Filter| {
        let frame = CanFrame::from_raw(filter.id, 0, [0; 8]);
        frame.is_some_and(|frame| {
            others().all(|other| !other.accepted.accepts(&frame) || other.silent.accepts(&frame))
        })
    };
    let silent = others().flat_map(|other| other.silent.filters());
    Audience {
        accepted: FilterSet::union(others().map(|other| &other.accepted)),
        silent: silent.filter(is_silent).copied().collect::<Vec<_>>().into(),
    }
}
