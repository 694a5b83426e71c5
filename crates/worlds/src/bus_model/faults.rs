//! Faults of the bus: what happens to frames at their sender's gateway, on the wire and at a receiver, and foreign nodes.

use std::collections::VecDeque;
use std::time::Duration;

use canopen::CanFrame;
use dbc::scenario_clock::ScenarioClock;
use dbc::{Database, SignalMissing};
use faults::Stream;
use scenario::Scenario;
use scenario::fault::bus::{BitError, Corrupt, Delay, Duplicate, Lose, OfFrames, Reorder, Station};
use scenario::fault::{Lasting, Place};

use super::error_state::{Activity, ErrorState};

/// Frames that a driver keeps for a CAN controller which cannot send (assumed); it refuses more.
const SEND_FRAMES_MAX: usize = 32;

/// COB-ID of `plant_truth`.
const TRUTH_COB_ID: u16 = 0x6B0;

/// A frame and the time from which it waits.
type Timed = (Duration, CanFrame);

/// A fault that hits frames, with its random numbers.
#[derive(Debug)]
struct Hitting<F> {
    fault: F,
    stream: Stream,
    /// How many more of the present burst.
    burst_left: u32,
}

impl<F: OfFrames + Clone> Hitting<F> {
    fn all(faults: &[F], kind: &'static str, seed: u64) -> Vec<Self> {
        let faults = faults.iter().cloned().enumerate();
        let hitting = faults.map(|(index, fault)| {
            let group = "bus";
            Self {
                fault,
                stream: Stream::for_fault(seed, &Place { group, kind, index }),
                burst_left: 0,
            }
        });
        hitting.collect()
    }

    /// Whether this frame is hit; each matching frame is asked about once.
    fn hits(&mut self, time_seconds: f64, frame: &CanFrame) -> bool {
        let is_meant = |id| frame.standard_id() == Some(id);
        if !self.fault.acts_at(time_seconds) || !self.fault.identifier().is_none_or(is_meant) {
            return false;
        }
        if self.burst_left > 0 {
            self.burst_left -= 1;
            return true;
        }
        let begins = self.stream.happens(self.fault.probability());
        if begins {
            self.burst_left = self.fault.burst_frames().saturating_sub(1);
        }
        begins
    }
}

/// A foreign node; all times are scenario times.
#[derive(Debug)]
struct Foreign {
    identifier: u16,
    from: Duration,
    until: Duration,
    /// Time between two frames; 0 without a pause.
    period: Duration,
    sent: u32,
}

impl Foreign {
    fn new(fault: &impl Lasting, identifier: u16, period_milliseconds: f64) -> Self {
        let until = fault.end_seconds();
        Self {
            identifier,
            from: Duration::from_secs_f64(fault.start_seconds()),
            until: until.map_or(Duration::MAX, Duration::from_secs_f64),
            period: Duration::from_secs_f64(period_milliseconds * 1e-3),
            sent: 0,
        }
    }

    /// When its next frame is due, if the bus is free from a time on.
    fn next(&self, free_at: Duration) -> Option<Duration> {
        let due = self.from + self.period * self.sent;
        Some(due.max(free_at)).filter(|_| due < self.until && free_at < self.until)
    }

    fn frame(&self) -> CanFrame {
        let [a, b, c, d] = self.sent.to_le_bytes();
        CanFrame::new(self.identifier, &[a, b, c, d, 0, 0, 0, 0])
    }
}

/// All that goes wrong with the bus.
#[derive(Debug)]
pub(crate) struct BusFaults {
    stations: Vec<Station>,
    lose: Vec<Hitting<Lose>>,
    delay: Vec<Hitting<Delay>>,
    duplicate: Vec<Hitting<Duplicate>>,
    reorder: Vec<Hitting<Reorder>>,
    corrupt: Vec<Hitting<Corrupt>>,
    bit_error: Vec<Hitting<BitError>>,
    foreign: Vec<Foreign>,
    /// Frames that each station's gateway keeps until the next one has overtaken them.
    held: Vec<Vec<CanFrame>>,
    /// The error counters of each station.
    pub(crate) states: Vec<ErrorState>,
    clock: ScenarioClock,
}

impl BusFaults {
    /// The faults of a scenario for these participants; none where nothing goes wrong.
    ///
    /// # Errors
    /// The database has no statusword, from which scenario time follows.
    pub(crate) fn new(
        scenario: &Scenario,
        database: &Database,
        stations: Vec<Station>,
    ) -> Result<Option<Self>, SignalMissing> {
        let (faults, seed) = (&scenario.fault.bus, scenario.seed);
        if faults.is_empty() {
            return Ok(None);
        }
        let babble = faults
            .babble
            .iter()
            .map(|fault| Foreign::new(fault, fault.identifier, 0.0));
        let load = faults.load.iter();
        let load =
            load.map(|fault| Foreign::new(fault, fault.identifier, fault.period_milliseconds));
        Ok(Some(Self {
            lose: Hitting::all(&faults.lose, "lose", seed),
            delay: Hitting::all(&faults.delay, "delay", seed),
            duplicate: Hitting::all(&faults.duplicate, "duplicate", seed),
            reorder: Hitting::all(&faults.reorder, "reorder", seed),
            corrupt: Hitting::all(&faults.corrupt, "corrupt", seed),
            bit_error: Hitting::all(&faults.bit_error, "bit_error", seed),
            foreign: babble.chain(load).collect(),
            held: vec![Vec::new(); stations.len()],
            states: vec![ErrorState::default(); stations.len()],
            clock: ScenarioClock::new(database)?,
            stations,
        }))
    }

    /// Sees each frame that has passed.
    pub(crate) fn observe(&mut self, time: Duration, frame: &CanFrame) {
        self.clock.on_frame(time, frame);
    }

    fn seconds(&self, time: Duration) -> Option<f64> {
        Some(time.checked_sub(self.clock.zero()?)?.as_secs_f64())
    }

    /// Takes frames from a participant through its gateway into its outbox, which stays in the order of time. What a
    /// station sends while it is off the bus is lost.
    pub(crate) fn queue(&mut self, index: usize, frames: &[Timed], outbox: &mut VecDeque<Timed>) {
        for (time, frame) in frames {
            if is_truth(frame) {
                insert(outbox, *time, *frame);
            } else if self.states[index].activity() != Activity::Off {
                for (time, frame) in self.gateway(index, *time, *frame) {
                    if outbox.len() < SEND_FRAMES_MAX {
                        insert(outbox, time, frame);
                    }
                }
            }
        }
    }

    /// What becomes of one frame at its sender.
    fn gateway(&mut self, index: usize, time: Duration, mut frame: CanFrame) -> Vec<Timed> {
        let Some(seconds) = self.seconds(time) else {
            return vec![(time, frame)];
        };
        let station = self.stations[index];
        for corrupt in of_sender(&mut self.corrupt, |fault| fault.sender == station) {
            if corrupt.hits(seconds, &frame) {
                frame = inverted(&frame, corrupt.fault.inverted_bits, &mut corrupt.stream);
            }
        }
        let mut leaves = time;
        for delay in of_sender(&mut self.delay, |fault| fault.sender == station) {
            if delay.hits(seconds, &frame) {
                leaves += Duration::from_secs_f64(delay.fault.delay_milliseconds * 1e-3);
            }
        }
        let mut copies = 1;
        for duplicate in of_sender(&mut self.duplicate, |fault| fault.sender == station) {
            copies += usize::from(duplicate.hits(seconds, &frame));
        }
        let mut is_overtaken = false;
        for reorder in of_sender(&mut self.reorder, |fault| fault.sender == station) {
            is_overtaken |= reorder.hits(seconds, &frame);
        }
        if is_overtaken {
            self.held[index].push(frame);
            return Vec::new();
        }
        let overtaken = self.held[index].drain(..);
        let frames = std::iter::repeat_n(frame, copies).chain(overtaken);
        frames.map(|frame| (leaves, frame)).collect()
    }

    /// Whether a receiver overruns on this frame.
    pub(crate) fn misses(&mut self, index: usize, time: Duration, frame: &CanFrame) -> bool {
        let Some(seconds) = self.seconds(time) else {
            return false;
        };
        let station = self.stations[index];
        let mut is_missed = false;
        // Each is asked, so that none depends on another.
        for lose in of_sender(&mut self.lose, |fault| fault.receiver == station) {
            is_missed |= lose.hits(seconds, frame);
        }
        is_missed
    }

    /// Whether this transmission is disturbed, and after how many of the frame's bits.
    pub(crate) fn disturbs(
        &mut self,
        index: usize,
        time: Duration,
        frame: &CanFrame,
        bits: u32,
    ) -> Option<u32> {
        let seconds = self.seconds(time).filter(|_| !is_truth(frame))?;
        let station = self.stations[index];
        let is_of = |fault: &BitError| fault.sender.is_none_or(|sender| sender == station);
        let mut disturbed = None;
        for error in of_sender(&mut self.bit_error, is_of) {
            if error.hits(seconds, frame) {
                let place = error.stream.below(u64::from(bits));
                disturbed = Some(1 + u32::try_from(place).unwrap_or_default());
            }
        }
        disturbed
    }

    /// When a foreign node next wants to send, if the bus is free from `free_at` on.
    #[must_use]
    pub(crate) fn next_foreign(&self, free_at: Duration) -> Option<Duration> {
        let zero = self.clock.zero()?;
        let free_at = free_at.saturating_sub(zero);
        let next = self.foreign.iter().filter_map(|node| node.next(free_at));
        next.min().map(|next| zero + next)
    }

    /// The frame with which the foreign nodes take part in the arbitration at `now`: that with the lowest identifier.
    #[must_use]
    pub(crate) fn foreign(&self, now: Duration) -> Option<CanFrame> {
        self.due(now).map(|place| self.foreign[place].frame())
    }

    /// The foreign frame has won.
    pub(crate) fn take_foreign(&mut self, now: Duration) {
        if let Some(place) = self.due(now) {
            self.foreign[place].sent = self.foreign[place].sent.wrapping_add(1);
        }
    }

    fn due(&self, now: Duration) -> Option<usize> {
        let time = now.checked_sub(self.clock.zero()?)?;
        let is_due = |node: &&Foreign| node.next(time) == Some(time);
        let due = self.foreign.iter().enumerate();
        due.filter(|(_, node)| is_due(node))
            .min_by_key(|(_, node)| node.identifier)
            .map(|(place, _)| place)
    }

    /// Errors on the wire may reach a participant at the end of anybody's frame, so nobody may go ahead.
    #[must_use]
    pub(crate) fn forbids_look_ahead(&self) -> bool {
        !self.bit_error.is_empty()
    }

    /// The number of a participant's node, for its error messages.
    #[must_use]
    pub(crate) fn node_number(&self, index: usize) -> u8 {
        match self.stations[index] {
            Station::Controller => 0x01,
            Station::Drive => 0x10,
            Station::Bench => 0,
        }
    }
}

/// The emulated plant has a CAN controller of its own, with which nothing is ever wrong: it must report what became of the
/// wire.
#[must_use]
pub(crate) fn is_truth(frame: &CanFrame) -> bool {
    frame.standard_id() == Some(TRUTH_COB_ID)
}

fn insert(outbox: &mut VecDeque<Timed>, time: Duration, frame: CanFrame) {
    let place = outbox.partition_point(|(other, _)| *other <= time);
    outbox.insert(place, (time, frame));
}

fn of_sender<'a, F>(
    faults: &'a mut [Hitting<F>],
    is_of: impl Fn(&F) -> bool + 'a,
) -> impl Iterator<Item = &'a mut Hitting<F>> {
    faults.iter_mut().filter(move |one| is_of(&one.fault))
}

/// The frame with some bits of its payload inverted.
fn inverted(frame: &CanFrame, bits: u32, stream: &mut Stream) -> CanFrame {
    let (mut data, length) = (frame.buffer(), frame.data().len());
    for _ in 0..bits {
        let Ok(place) = usize::try_from(stream.below(8 * length as u64)) else {
            continue;
        };
        if let Some(byte) = data[..length].get_mut(place / 8) {
            *byte ^= 1 << (place % 8);
        }
    }
    let length = u8::try_from(length).unwrap_or(8);
    CanFrame::from_raw(frame.raw_id(), length, data).unwrap_or(*frame)
}

#[cfg(test)]
mod tests;
