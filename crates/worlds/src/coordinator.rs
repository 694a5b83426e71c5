//! Lock-step: moves all participants and the bus model through virtual time, one event at a time.
//!
//! A participant is asked as late and for as long a step as possible, since each question to a process costs two crossings:
//! - while a frame occupies the wire no participant is asked: frames queued meanwhile wait for its end;
//! - a frame that its addressee takes in silence waits in the addressee's inbox until there is another reason to ask;
//! - a participant that no frame can reach before some time is advanced to that time at once. It ends early by itself when it
//!   queues a frame that another participant may answer. Frames that it queued for later wait in its outbox.
//!
//! The proof that this changes no result is in docs/design/lock-step.md; a test compares it with asking at every event.

use std::collections::VecDeque;
use std::time::Duration;

use can::frame_bits::{arbitration_key, frame_bits};
use can::{CanFrame, Progress, earliest};
use platform::bus::Bus;
use platform::lockstep::{Failure, Participant};
use recording::capture::Capture;
use recording::hits::Hit;
use recording::log::Stamped;
use recording::reasons::Reasons;

use crate::agenda::{Agenda, NEVER, Nanos, Slot, Timed, audience, nanos};
use crate::bus_model::error_state::{Activity, SEQUENCE_BITS};
use crate::bus_model::faults::{BusFaults, is_truth};
use crate::bus_model::{BusModel, SUSPEND_BITS};
use crate::error::WorldError;
use crate::listeners::Listeners;

/// Largest number of waiting frames of one participant; more mean that the bus cannot carry its traffic.
const QUEUE_LIMIT: usize = 10_000;

/// Longest look-ahead of a participant, so that one that never sends does not run away.
const LOOK_AHEAD_MAX: Duration = Duration::from_millis(100);

/// Sinks for the winners of the arbitration other than their addressees: the recording and, if there is one, the real wire.
pub(crate) struct Wire<'a, 'b> {
    pub(crate) capture: &'a mut Capture<'b>,
    pub(crate) bus: Option<&'a mut dyn Bus>,
}

impl Wire<'_, '_> {
    /// Takes a frame whose last bit passed at `time` and which occupied the bus for this many bits.
    ///
    /// # Errors
    /// If the real wire cannot carry it.
    fn put(
        &mut self,
        time: Duration,
        frame: &CanFrame,
        occupied_bits: u32,
    ) -> Result<(), WorldError> {
        self.capture
            .record(Stamped::counted(time, *frame, occupied_bits));
        if let Some(bus) = &mut self.bus {
            bus.send(frame)?;
        }
        Ok(())
    }
}

struct InFlight {
    frame: CanFrame,
    /// Index of the sender; `None` for a foreign node.
    sender: Option<usize>,
    start: Duration,
    end: Duration,
    /// Number of bits that it takes if it passes whole; `None` if an error ends it, so its sender tries again.
    whole_bits: Option<u32>,
}

/// Participants, the bus between them, and the time.
pub(crate) struct Coordinator<'a, 'b, 'c> {
    pub(crate) wire: Wire<'b, 'c>,
    slots: Vec<Slot<'a>>,
    agenda: Agenda,
    listeners: Listeners,
    bus: BusModel,
    faults: Option<BusFaults>,
    in_flight: Option<InFlight>,
    /// Virtual time.
    pub(crate) now: Duration,
    /// Time beyond which no participant goes ahead, since one may be asked to stop then.
    pub(crate) horizon: Duration,
}

impl<'a, 'b, 'c> Coordinator<'a, 'b, 'c> {
    /// Makes an idle bus at time 0 with these participants, which are named by their index afterwards, also by the faults of the
    /// bus, and asked in this order.
    pub(crate) fn new(
        bitrate_kilobits_per_second: u32,
        participants: Vec<&'a mut dyn Participant>,
        faults: Option<BusFaults>,
        wire: Wire<'b, 'c>,
    ) -> Self {
        let mut slots: Vec<Slot<'_>> = participants.into_iter().map(Slot::new).collect();
        for index in 0..slots.len() {
            let audience = audience(&slots, index);
            slots[index].participant.meet(&audience);
            slots[index].audience = audience;
        }
        Self {
            wire,
            agenda: Agenda::new(&slots),
            listeners: Listeners::new(slots.iter().map(|slot| slot.accepted.clone()).collect()),
            slots,
            bus: BusModel::new(bitrate_kilobits_per_second),
            faults,
            in_flight: None,
            now: Duration::ZERO,
            horizon: Duration::MAX,
        }
    }

    /// Goes to the next event, the end of a frame or the start of one, and returns its time; `None` if there will be no further
    /// event.
    ///
    /// # Errors
    /// If a participant or the wire failed.
    pub(crate) fn step(&mut self) -> Result<Option<Duration>, WorldError> {
        if let Some(passed) = self.in_flight.take() {
            self.now = passed.end;
            self.pass(&passed)?;
            return Ok(Some(self.now));
        }
        let ready = self.now.max(self.bus.free_at);
        let next = self.agenda.next(nanos(ready)).min(self.next_fault());
        if next == NEVER {
            return Ok(None);
        }
        self.now = ready.max(Duration::from_nanos(next));
        self.recover()?;
        let now = nanos(self.now);
        let mut first = 0;
        while let Some(index) = self.agenda.first_to_ask(first, now) {
            let until = self.unreachable_until(index);
            self.advance(index, self.now, until)?;
            first = index + 1;
        }
        self.arbitrate();
        Ok(Some(self.now))
    }

    /// Continues until no participant is ahead any more, so that one may be asked to stop now: its frames must not reach others
    /// in their past.
    ///
    /// # Errors
    /// As [`Coordinator::step`].
    pub(crate) fn settle(&mut self) -> Result<(), WorldError> {
        self.horizon = self.now;
        while let Some(ahead) = self.furthest().filter(|reached| *reached > self.now) {
            if self.step()?.is_none() {
                self.now = ahead;
            }
        }
        Ok(())
    }

    /// Continues until this time, also if no event is left before it.
    ///
    /// # Errors
    /// As [`Coordinator::step`].
    pub(crate) fn run_until(&mut self, until: Duration) -> Result<(), WorldError> {
        self.horizon = until;
        while self.step()?.is_some_and(|now| now < until) {}
        if self.in_flight.is_none() {
            self.now = self.now.max(until);
        }
        Ok(())
    }

    /// Returns the latest time that a participant has reached.
    fn furthest(&self) -> Option<Duration> {
        self.slots.iter().map(|slot| slot.answer.reached).max()
    }

    /// Asks a participant for its safe state.
    ///
    /// # Errors
    /// If it failed or does not answer.
    pub(crate) fn stop(&mut self, index: usize) -> Result<(), WorldError> {
        // A participant that has gone ahead cannot go back.
        let at = self.now.max(self.slots[index].answer.reached);
        self.advance(index, at, at)?;
        let slot = &mut self.slots[index];
        let stopped = slot.participant.stop(at, &mut slot.answer);
        stopped.map_err(|failure| slot.failed(failure))?;
        self.accept_answer(index)
    }

    /// Continues without a participant that does not answer any more. Frames that it has queued still reach the bus.
    pub(crate) fn leave_out(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        slot.answer.progress = Progress::Stopped;
        slot.answer.reached = self.now;
        self.agenda.note(index, slot);
    }

    /// Puts a frame without a sender on the bus as soon as it is free, when no participant is ahead.
    ///
    /// # Errors
    /// As [`Coordinator::step`].
    pub(crate) fn put(&mut self, frame: CanFrame) -> Result<(), WorldError> {
        while self.in_flight.is_some() {
            self.step()?;
        }
        self.now = self.now.max(self.bus.free_at);
        self.transmit(None, frame);
        Ok(())
    }

    /// Returns whether a participant has reached its safe state and all its frames have passed.
    pub(crate) fn is_stopped(&self, index: usize) -> bool {
        let slot = &self.slots[index];
        let passed = self.in_flight.as_ref();
        let is_sending = passed.is_some_and(|passed| passed.sender == Some(index));
        slot.answer.progress == Progress::Stopped && slot.outbox.is_empty() && !is_sending
    }

    /// Puts the lowest identifier among the first frames of all outboxes on the bus.
    fn arbitrate(&mut self) {
        let now = nanos(self.now);
        let times = self.agenda.sends_at.iter().enumerate();
        let waiting = times.filter(|(_, time)| **time <= now);
        let firsts =
            waiting.filter_map(|(index, _)| Some((index, self.slots[index].outbox.front()?)));
        let winner = firsts
            .map(|(index, (_, frame))| (arbitration_key(frame), index))
            .min();
        let now = self.now;
        let has_rested = now > self.bus.free_at;
        let foreign = self.faults.as_mut().and_then(|faults| {
            if has_rested {
                faults.rest();
            }
            faults.take_foreign(now, winner.map(|(key, _)| key))
        });
        if let Some((frame, fault)) = foreign {
            self.transmit(None, frame);
            self.occupy(&fault, None);
        } else if let Some((_, sender)) = winner {
            self.send(sender);
        }
    }

    /// Puts a participant's next frame on the bus, where an error may end it.
    fn send(&mut self, sender: usize) {
        let Some((ready, frame)) = self.slots[sender].outbox.front().copied() else {
            return;
        };
        let now = self.now;
        let disturbed = self.faults.as_mut().and_then(|faults| {
            let disturbed = faults.disturbs(sender, now, &frame, frame_bits(&frame));
            if disturbed.is_none() {
                faults.note_sent(sender, &frame, ready, now);
            }
            let (bits, fault) = disturbed?;
            let is_passive = faults.states[sender].activity() == Activity::Passive;
            Some((bits, is_passive, fault))
        });
        let Some((bits, is_passive, fault)) = disturbed else {
            self.slots[sender].outbox.pop_front();
            self.agenda.note(sender, &self.slots[sender]);
            self.transmit(Some(sender), frame);
            return;
        };
        let end = self.bus.disturb(self.now, bits, is_passive);
        self.occupy(&fault, Some(sender));
        self.in_flight = Some(InFlight {
            frame,
            sender: Some(sender),
            start: self.now,
            end,
            whole_bits: None,
        });
    }

    /// Notes that a fault occupies the bus from now on until it is free.
    fn occupy(&mut self, fault: &str, sender: Option<usize>) {
        let time = self.bus.free_at.saturating_sub(self.now);
        if let Some(faults) = &mut self.faults {
            faults.occupy(fault, time, sender);
        }
    }

    /// Takes the hits of the faults on the bus.
    pub(crate) fn take_hits(&mut self) -> Vec<Hit> {
        let (now, slots) = (self.now, &self.slots);
        let faults = self.faults.as_mut();
        let outboxes = slots.iter().map(|slot| &slot.outbox);
        faults.map_or_else(Vec::new, |faults| faults.take_hits(outboxes, now))
    }

    /// Takes the reasons that the nodes gave on a bus with faults.
    pub(crate) fn take_reasons(&mut self) -> Reasons {
        let faults = self.faults.as_mut();
        faults.map(BusFaults::take_reasons).unwrap_or_default()
    }

    fn transmit(&mut self, sender: Option<usize>, frame: CanFrame) {
        let (end, occupied_bits) = self.bus.transmit(self.now, &frame);
        self.in_flight = Some(InFlight {
            frame,
            sender,
            start: self.now,
            end,
            whole_bits: Some(occupied_bits),
        });
    }

    /// Ends a transmission: the others receive the frame, or all count the error.
    fn pass(&mut self, passed: &InFlight) -> Result<(), WorldError> {
        let (now, frame) = (self.now, &passed.frame);
        if let Some(occupied_bits) = passed.whole_bits {
            self.wire.put(now, frame, occupied_bits)?;
            if let Some(faults) = &mut self.faults {
                faults.observe(now, frame);
            }
            for index in self.listeners.of(frame) {
                if Some(index) == passed.sender {
                    continue;
                }
                let faults = self.faults.as_mut();
                let is_missed = faults.is_some_and(|faults| faults.misses(index, now, frame));
                if !is_missed && self.slots[index].receive(now, frame) {
                    self.agenda.may_queue_at[index] = nanos(now);
                }
            }
        }
        self.count_errors(passed)
    }

    /// Updates the error counters and reports each changed state.
    fn count_errors(&mut self, passed: &InFlight) -> Result<(), WorldError> {
        let Some(faults) = &mut self.faults else {
            return Ok(());
        };
        let (now, start) = (self.now, passed.start);
        let free_at = self.bus.free_at;
        let sequence = self.bus.bit_time(SEQUENCE_BITS);
        let is_disturbed = passed.whole_bits.is_none();
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let number = faults.node_number(index);
            let state = &mut faults.states[index];
            let before = state.activity();
            match (before, Some(index) == passed.sender, is_disturbed) {
                (Activity::Off, ..) => state.on_bus_used(start, free_at, sequence),
                (_, true, true) => state.on_transmit_error(free_at),
                (_, false, true) => state.on_receive_error(),
                (_, true, false) => state.on_transmitted(),
                (_, false, false) => state.on_received(),
            }
            let after = state.activity();
            if after == Activity::Off {
                let (outbox, truths) = (std::mem::take(&mut slot.outbox), &faults.truths);
                let (kept, dropped): (VecDeque<_>, VecDeque<_>) = outbox
                    .into_iter()
                    .partition(|(_, frame)| is_truth(truths, frame));
                slot.outbox = kept;
                for (_, frame) in &dropped {
                    faults.note_dropped(index, frame, now);
                }
            } else if after == Activity::Passive && Some(index) == passed.sender {
                slot.suspended_until = free_at + self.bus.bit_time(SUSPEND_BITS);
            }
            if after != before {
                let message = faults.states[index].message(number, false);
                self.wire.put(now, &message, 0)?;
                if slot.accepted.accepts(&message) {
                    slot.receive(self.now, &message);
                }
            }
            self.agenda.note(index, slot);
        }
        Ok(())
    }

    /// Returns stations from bus-off whose time has come.
    #[inline]
    fn recover(&mut self) -> Result<(), WorldError> {
        let Some(faults) = &mut self.faults else {
            return Ok(());
        };
        let (now, sequence) = (self.now, self.bus.bit_time(SEQUENCE_BITS));
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let recovers_at = faults.states[index].recovers_at(sequence);
            if recovers_at.is_some_and(|time| time <= now) {
                faults.states[index].recover();
                let number = faults.node_number(index);
                let message = faults.states[index].message(number, true);
                self.wire.put(now, &message, 0)?;
                if slot.accepted.accepts(&message) && slot.receive(self.now, &message) {
                    self.agenda.note(index, slot);
                }
            }
        }
        Ok(())
    }

    /// Returns the time at which a fault next acts by itself.
    fn next_fault(&self) -> Nanos {
        self.faults
            .as_ref()
            .map_or(NEVER, |faults| self.next_of(faults))
    }

    fn next_of(&self, faults: &BusFaults) -> Nanos {
        let sequence = self.bus.bit_time(SEQUENCE_BITS);
        let states = faults.states.iter();
        let recoveries = states.map(|state| state.recovers_at(sequence));
        let free_at = self.now.max(self.bus.free_at);
        let foreign = faults.next_foreign(free_at);
        earliest(recoveries.chain([foreign])).map_or(NEVER, nanos)
    }

    /// Returns the time before which no frame can arrive at a participant, apart from answers to its own. The bus must be idle.
    /// If no frame waits that is for it or may be answered, the participant that queues next does so at a known time, and that
    /// frame arrives later.
    fn unreachable_until(&self, index: usize) -> Duration {
        let receiver = &self.slots[index];
        let now = nanos(self.now);
        let others = self.agenda.others_may_queue_at(index, now);
        if others <= now {
            return self.now;
        }
        let mut next = nanos(self.horizon.min(self.now + LOOK_AHEAD_MAX)).min(others);
        if let Some(faults) = &self.faults {
            if faults.forbids_look_ahead() {
                return self.now;
            }
            next = self.next_fault().min(next);
        }
        let times = self.agenda.sends_at.iter().enumerate();
        for (at, _) in times.filter(|(_, time)| **time != NEVER) {
            let slot = &self.slots[at];
            let may_reach = |(_, frame): &Timed| {
                slot.audience.may_answer(frame) || (at != index && receiver.accepted.accepts(frame))
            };
            if slot.outbox.iter().any(may_reach) {
                return self.now;
            }
        }
        self.now.max(Duration::from_nanos(next))
    }

    /// Gives a participant its arrived frames and advances it.
    fn advance(&mut self, index: usize, to: Duration, until: Duration) -> Result<(), WorldError> {
        let slot = &mut self.slots[index];
        slot.participant
            .advance(to, until, &slot.inbox, &mut slot.answer)
            .map_err(|failure| slot.failed(failure))?;
        slot.inbox.clear();
        slot.has_answerable = false;
        self.accept_answer(index)
    }

    fn accept_answer(&mut self, index: usize) -> Result<(), WorldError> {
        let slot = &mut self.slots[index];
        match &mut self.faults {
            None => slot.outbox.extend(&slot.answer.frames),
            Some(faults) => faults.queue(index, &slot.answer.frames, &mut slot.outbox),
        }
        self.agenda.note(index, slot);
        if let Progress::Failed(reason) = &slot.answer.progress {
            return Err(slot.failed(Failure::GaveUp(reason.clone())));
        }
        if slot.outbox.len() > QUEUE_LIMIT {
            return Err(slot.failed(Failure::Overloaded(QUEUE_LIMIT)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use can::{Filter, Node};
    use dbc::Database;
    use dbc::scenario_clock::ScenarioClock;
    use platform::lockstep::Local;
    use recording::capture::Watch;

    use super::*;

    /// Node that queues a number of frames each millisecond.
    struct Talker {
        frames: usize,
        waiting: usize,
        deadline: Duration,
    }

    impl Node for Talker {
        fn filters(&self) -> Vec<Filter> {
            Vec::new()
        }

        fn on_frame(&mut self, _now: Duration, _frame: &CanFrame) {}

        fn on_tick(&mut self, now: Duration) {
            self.waiting = self.frames;
            self.deadline = now + Duration::from_millis(1);
        }

        fn on_stop(&mut self, _now: Duration) {}

        fn next_frame(&mut self) -> Option<CanFrame> {
            self.waiting = self.waiting.checked_sub(1)?;
            Some(CanFrame::new(0x100, &[]))
        }

        fn next_deadline(&self) -> Option<Duration> {
            Some(self.deadline)
        }

        fn progress(&self) -> Progress {
            Progress::Running
        }
    }

    #[test]
    fn a_node_that_sends_more_than_the_bus_carries_is_named() {
        for (frames, said) in [
            (
                1000,
                "talker has more than 10000 frames waiting: the bus cannot carry what it sends",
            ),
            (
                2000,
                "talker could not be stepped: the node queued more than 1024 frames in one step",
            ),
        ] {
            let mut node = Talker {
                frames,
                waiting: 0,
                deadline: Duration::ZERO,
            };
            let mut talker = Local::new("talker", &mut node);
            let watch = Watch::default();
            let clock = ScenarioClock::new(Database::shipped(), []).unwrap();
            let wire = Wire {
                capture: &mut Capture::in_memory(clock, &watch),
                bus: None,
            };
            let mut coordinator = Coordinator::new(1000, vec![&mut talker], None, wire);
            coordinator.horizon = Duration::ZERO;
            let error = (0..10_000).find_map(|_| coordinator.step().err());
            assert_eq!(error.unwrap().to_string(), said);
        }
    }
}
