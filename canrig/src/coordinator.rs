//! Lock-step: moves all participants and the bus model through virtual time, one event at a time.
//!
//! An event is the end of a frame, the start of the next one, or a participant's deadline. The earliest event comes
//! first; at equal times the end of a frame precedes deadlines, so that a node sees what was on the wire before it acts.
//! All participants that an event concerns work in parallel; their answers are taken in their fixed order. Hence the
//! run depends on nothing but the participants' answers.

use std::collections::VecDeque;
use std::time::Duration;

use canopen::{CanFrame, Progress};
use platform::lockstep::{Answer, LockstepError, Participant};

use crate::bus_model::{BusModel, arbitration_key};

/// Frames that one participant may have waiting; more means that the bus cannot carry what it sends.
const QUEUE_LIMIT: usize = 10_000;

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

struct Slot<'a> {
    participant: &'a mut dyn Participant,
    queue: VecDeque<CanFrame>,
    progress: Progress,
}

impl Slot<'_> {
    /// When the participant wants its next tick; one that has stopped wants none.
    fn deadline(&self) -> Option<Duration> {
        self.participant
            .next_deadline()
            .filter(|_| self.progress == Progress::Running)
    }
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
    /// An idle bus at time 0 without participants.
    #[must_use]
    pub fn new(bitrate_kilobits_per_second: u32) -> Self {
        let bus = BusModel::new(bitrate_kilobits_per_second);
        Self {
            slots: Vec::new(),
            bus,
            in_flight: None,
            now: Duration::ZERO,
        }
    }

    /// Adds a participant; its index names it afterwards.
    pub fn join(&mut self, participant: &'a mut dyn Participant) -> usize {
        self.slots.push(Slot {
            participant,
            queue: VecDeque::new(),
            progress: Progress::Running,
        });
        self.slots.len() - 1
    }

    /// The virtual time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.now
    }

    /// How long frames have occupied the bus.
    #[must_use]
    pub fn bus_busy(&self) -> Duration {
        self.bus.busy()
    }

    /// Does everything that is due at the next event and returns its time, or `None` when nothing will ever happen.
    ///
    /// # Errors
    /// A participant or the wire failed.
    pub fn step(&mut self, wire: &mut dyn Wire) -> Result<Option<Duration>, CoordinatorError> {
        let deadline = self.slots.iter().filter_map(Slot::deadline).min();
        let bus_event = self.next_bus_event();
        let Some(time) = [deadline, bus_event].into_iter().flatten().min() else {
            return Ok(None);
        };
        self.now = self.now.max(time);
        if bus_event.is_some_and(|event| event <= self.now) {
            match self.in_flight.take() {
                Some(passed) => self.deliver(&passed, wire)?,
                None => self.arbitrate(),
            }
        } else {
            self.tick()?;
        }
        Ok(Some(self.now))
    }

    /// Asks a participant for its safe state.
    ///
    /// # Errors
    /// It failed or does not answer.
    pub fn stop(&mut self, index: usize) -> Result<(), CoordinatorError> {
        self.slots[index].participant.begin_stop(self.now);
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
        slot.progress == Progress::Stopped && slot.queue.is_empty() && !is_sending
    }

    fn next_bus_event(&self) -> Option<Duration> {
        if let Some(passed) = &self.in_flight {
            return Some(passed.end);
        }
        let is_waiting = self.slots.iter().any(|slot| !slot.queue.is_empty());
        is_waiting.then(|| self.bus.free_at().max(self.now))
    }

    /// The lowest identifier among the heads of all queues goes on the bus.
    fn arbitrate(&mut self) {
        let heads = self.slots.iter().enumerate();
        let heads = heads.filter_map(|(index, slot)| {
            slot.queue
                .front()
                .map(|frame| (arbitration_key(frame), index))
        });
        let Some((_, sender)) = heads.min() else {
            return;
        };
        if let Some(frame) = self.slots[sender].queue.pop_front() {
            let end = self.bus.transmit(self.now, &frame);
            self.in_flight = Some(InFlight { frame, sender, end });
        }
    }

    fn deliver(&mut self, passed: &InFlight, wire: &mut dyn Wire) -> Result<(), CoordinatorError> {
        wire.put(self.now, &passed.frame)?;
        let is_addressee = |(index, slot): (usize, &Slot<'_>)| {
            let accepts = slot
                .participant
                .filters()
                .iter()
                .any(|filter| filter.accepts(&passed.frame));
            (index != passed.sender && slot.progress == Progress::Running && accepts)
                .then_some(index)
        };
        let addressees: Vec<usize> = self
            .slots
            .iter()
            .enumerate()
            .filter_map(is_addressee)
            .collect();
        self.advance(&addressees, &[(self.now, passed.frame)])
    }

    fn tick(&mut self) -> Result<(), CoordinatorError> {
        let now = self.now;
        let is_due = |(index, slot): (usize, &Slot<'_>)| {
            slot.deadline()
                .is_some_and(|deadline| deadline <= now)
                .then_some(index)
        };
        let due: Vec<usize> = self.slots.iter().enumerate().filter_map(is_due).collect();
        self.advance(&due, &[])
    }

    fn advance(
        &mut self,
        indices: &[usize],
        frames: &[(Duration, CanFrame)],
    ) -> Result<(), CoordinatorError> {
        for &index in indices {
            self.slots[index].participant.begin(self.now, frames);
        }
        indices.iter().try_for_each(|&index| self.finish(index))
    }

    fn finish(&mut self, index: usize) -> Result<(), CoordinatorError> {
        let Answer {
            frames, progress, ..
        } = self.slots[index].participant.finish()?;
        let slot = &mut self.slots[index];
        slot.queue
            .extend(frames.into_iter().map(|(_, frame)| frame));
        slot.progress = progress;
        if let Progress::Failed(reason) = &slot.progress {
            return Err(CoordinatorError::Failed {
                name: slot.participant.name().to_owned(),
                reason: reason.clone(),
            });
        }
        if slot.queue.len() > QUEUE_LIMIT {
            return Err(CoordinatorError::Overloaded {
                name: slot.participant.name().to_owned(),
            });
        }
        Ok(())
    }
}
