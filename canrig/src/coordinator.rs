//! Lock-step: moves all participants and the bus model through virtual time, one event at a time.
//!
//! A participant is asked as late and as far as possible, since each question to a process costs two crossings:
//! - while a frame occupies the wire nobody is asked: what anybody queues meanwhile waits for its end;
//! - a frame that its addressee takes in silence waits in the addressee's inbox until there is something else to ask;
//! - a participant that nobody can reach before some time is let go on to that time, and ends early by itself when it
//!   queues a frame that somebody may answer. What it queued for later waits in its outbox.
//!
//! Why this changes nothing is told in ARCHITECTURE.md, "Lock-step"; a test compares it with asking at every event.

use std::collections::VecDeque;
use std::time::Duration;

use canopen::{CanFrame, Filter, Progress};
use platform::lockstep::{Answer, Audience, LockstepError, Participant};

use crate::bus_model::{BusModel, arbitration_key};

/// Frames that one participant may have waiting; more means that the bus cannot carry what it sends.
const QUEUE_LIMIT: usize = 10_000;

/// How far a participant goes ahead at most, so that one that never speaks does not run away.
const LOOK_AHEAD_MAX: Duration = Duration::from_millis(100);

/// Where the winners of the arbitration go besides their addressees.
pub trait Wire {
    /// Takes a frame whose last bit passed at `time`.
    ///
    /// # Errors
    /// The wire cannot carry it.
    fn put(&mut self, time: Duration, frame: &CanFrame) -> Result<(), CoordinatorError>;
}

/// Why virtual time cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum CoordinatorError {
    /// A participant did not answer.
    #[error(transparent)]
    Participant(#[from] LockstepError),
    /// A participant gave up.
    #[error("{name} failed: {reason}")]
    Failed {
        /// Which one.
        name: String,
        /// Its own words.
        reason: String,
    },
    /// A participant sends more than the bus carries.
    #[error(
        "{name} has more than {QUEUE_LIMIT} frames waiting: the bus cannot carry what it sends"
    )]
    Overloaded {
        /// Which one.
        name: String,
    },
    /// The real bus under the model failed.
    #[error("the bus does not carry the frame {frame}")]
    Wire {
        /// Which frame.
        frame: CanFrame,
        /// Why.
        source: platform::bus::BusError,
    },
}

/// A frame and the time from which it waits, or at which it arrived.
type Timed = (Duration, CanFrame);

struct Slot<'a> {
    participant: &'a mut dyn Participant,
    /// Whom its frames may make speak.
    audience: Audience,
    /// What has arrived and was not given to it yet, oldest first.
    inbox: Vec<Timed>,
    /// The inbox holds a frame that it may answer.
    must_hear: bool,
    /// What it has queued, oldest first: a frame takes part in the arbitration from its time on.
    outbox: VecDeque<Timed>,
    /// When it wants its next tick.
    next_deadline: Option<Duration>,
    /// How far it has gone.
    reached: Duration,
    progress: Progress,
}

impl<'a> Slot<'a> {
    fn new(participant: &'a mut dyn Participant) -> Self {
        Self {
            next_deadline: participant.next_deadline(),
            participant,
            audience: Audience::default(),
            inbox: Vec::new(),
            must_hear: false,
            outbox: VecDeque::new(),
            reached: Duration::ZERO,
            progress: Progress::Running,
        }
    }

    /// The earliest time at which it may queue something that is not known yet; none when it has stopped or when only
    /// a frame can wake it.
    fn may_speak_at(&self) -> Option<Duration> {
        match self.progress {
            Progress::Running if self.must_hear => self.inbox.last().map(|(time, _)| *time),
            Progress::Running => self.next_deadline,
            _ => None,
        }
    }

    fn accepts(&self, frame: &CanFrame) -> bool {
        accepts(self.participant.filters(), frame)
    }

    /// Takes a frame from the bus, if it is for this participant.
    fn hear(&mut self, time: Duration, frame: CanFrame) {
        if self.progress == Progress::Running && self.accepts(&frame) {
            self.inbox.push((time, frame));
            self.must_hear |= !accepts(self.participant.silent_filters(), &frame);
        }
    }
}

fn accepts(filters: &[Filter], frame: &CanFrame) -> bool {
    filters.iter().any(|filter| filter.accepts(frame))
}

struct InFlight {
    frame: CanFrame,
    sender: usize,
    end: Duration,
}

/// The participants, the bus between them and the time.
pub struct Coordinator<'a> {
    slots: Vec<Slot<'a>>,
    bus: BusModel,
    in_flight: Option<InFlight>,
    now: Duration,
}

impl<'a> Coordinator<'a> {
    /// An idle bus at time 0 with these participants, who are named by their index afterwards and asked in this order.
    #[must_use]
    pub fn new(
        bitrate_kilobits_per_second: u32,
        participants: impl IntoIterator<Item = &'a mut dyn Participant>,
    ) -> Self {
        let mut slots: Vec<Slot<'_>> = participants.into_iter().map(Slot::new).collect();
        for index in 0..slots.len() {
            let audience = audience(&slots, index);
            slots[index].participant.meet(&audience);
            slots[index].audience = audience;
        }
        Self {
            slots,
            bus: BusModel::new(bitrate_kilobits_per_second),
            in_flight: None,
            now: Duration::ZERO,
        }
    }

    /// The virtual time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.now
    }

    /// Goes to the next event, the end of a frame or the start of one, and returns its time, or `None` when nothing
    /// will ever happen.
    ///
    /// # Errors
    /// A participant or the wire failed.
    pub fn step(&mut self, wire: &mut dyn Wire) -> Result<Option<Duration>, CoordinatorError> {
        if let Some(passed) = self.in_flight.take() {
            self.now = passed.end;
            wire.put(self.now, &passed.frame)?;
            for (index, slot) in self.slots.iter_mut().enumerate() {
                if index != passed.sender {
                    slot.hear(self.now, passed.frame);
                }
            }
            return Ok(Some(self.now));
        }
        let waiting = self.heads().map(|(time, ..)| time);
        let speaking = self.slots.iter().filter_map(Slot::may_speak_at);
        let Some(time) = waiting.chain(speaking).min() else {
            return Ok(None);
        };
        self.now = self.now.max(time).max(self.bus.free_at());
        for index in 0..self.slots.len() {
            let is_due = |time| time <= self.now;
            if self.slots[index].may_speak_at().is_some_and(is_due) {
                self.ask(index)?;
            }
        }
        self.arbitrate();
        Ok(Some(self.now))
    }

    /// Asks a participant for its safe state.
    ///
    /// # Errors
    /// It failed or does not answer.
    pub fn stop(&mut self, index: usize) -> Result<(), CoordinatorError> {
        // One that has gone ahead cannot go back.
        let at = self.now.max(self.slots[index].reached);
        self.advance(index, at, at)?;
        self.slots[index].participant.begin_stop(at);
        self.finish(index)
    }

    /// True when a participant has reached its safe state and everything it had to say has passed.
    #[must_use]
    pub fn is_stopped(&self, index: usize) -> bool {
        let slot = &self.slots[index];
        let is_sending = self
            .in_flight
            .as_ref()
            .is_some_and(|passed| passed.sender == index);
        slot.progress == Progress::Stopped && slot.outbox.is_empty() && !is_sending
    }

    /// The first frame of each outbox, with its time and its sender.
    fn heads(&self) -> impl Iterator<Item = (Duration, &CanFrame, usize)> {
        let slots = self.slots.iter().enumerate();
        slots.filter_map(|(index, slot)| {
            let (time, frame) = slot.outbox.front()?;
            Some((*time, frame, index))
        })
    }

    /// The lowest identifier among the waiting heads goes on the bus.
    fn arbitrate(&mut self) {
        let waiting = self.heads().filter(|(time, ..)| *time <= self.now);
        let Some((_, sender)) = waiting
            .map(|(_, frame, index)| (arbitration_key(frame), index))
            .min()
        else {
            return;
        };
        if let Some((_, frame)) = self.slots[sender].outbox.pop_front() {
            let end = self.bus.transmit(self.now, &frame);
            self.in_flight = Some(InFlight { frame, sender, end });
        }
    }

    /// Gives a participant what has arrived for it and lets it go as far as nobody can reach it.
    fn ask(&mut self, index: usize) -> Result<(), CoordinatorError> {
        self.advance(index, self.now, self.unreachable_until(index))
    }

    /// The time before which no frame can arrive at a participant that is not an answer to its own. While the bus is
    /// idle: when no frame waits that is for it or may be answered, whoever speaks next speaks at a known time, and
    /// what is said then arrives later.
    fn unreachable_until(&self, index: usize) -> Duration {
        let mut others = self.slots.iter().enumerate().filter(|(at, _)| *at != index);
        let may_reach = |(at, slot): (usize, &Slot<'_>)| {
            slot.outbox.iter().any(|(_, frame)| {
                slot.audience.may_answer(frame) || (at != index && self.slots[index].accepts(frame))
            })
        };
        if self.slots.iter().enumerate().any(may_reach) {
            return self.now;
        }
        let horizon = self.now + LOOK_AHEAD_MAX;
        others
            .by_ref()
            .filter_map(|(_, slot)| slot.may_speak_at())
            .fold(horizon, Duration::min)
            .max(self.now)
    }

    fn advance(
        &mut self,
        index: usize,
        to: Duration,
        until: Duration,
    ) -> Result<(), CoordinatorError> {
        let slot = &mut self.slots[index];
        slot.participant.begin_ahead(to, until, &slot.inbox);
        slot.inbox.clear();
        slot.must_hear = false;
        self.finish(index)
    }

    fn finish(&mut self, index: usize) -> Result<(), CoordinatorError> {
        let slot = &mut self.slots[index];
        let Answer {
            frames,
            next_deadline,
            reached,
            progress,
        } = slot.participant.finish()?;
        slot.outbox.extend(frames);
        slot.next_deadline = next_deadline;
        slot.reached = reached;
        slot.progress = progress;
        if let Progress::Failed(reason) = &slot.progress {
            return Err(CoordinatorError::Failed {
                name: slot.participant.name().to_owned(),
                reason: reason.clone(),
            });
        }
        if slot.outbox.len() > QUEUE_LIMIT {
            return Err(CoordinatorError::Overloaded {
                name: slot.participant.name().to_owned(),
            });
        }
        Ok(())
    }
}

/// What the others do with the frames of one participant. A frame is silent only if all who hear it are.
fn audience(slots: &[Slot<'_>], index: usize) -> Audience {
    let others = || {
        let others = slots.iter().enumerate().filter(|(at, _)| *at != index);
        others.map(|(_, slot)| &*slot.participant)
    };
    let heard = others()
        .flat_map(|other| other.filters())
        .copied()
        .collect();
    let is_silent = |filter: &&Filter| {
        let frame = CanFrame::from_raw(filter.id, 0, [0; 8]);
        frame.is_some_and(|frame| {
            others().all(|other| {
                !accepts(other.filters(), &frame) || accepts(other.silent_filters(), &frame)
            })
        })
    };
    let silent = others().flat_map(|other| other.silent_filters());
    let silent = silent.filter(is_silent).copied().collect();
    Audience { heard, silent }
}
