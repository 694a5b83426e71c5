//! Faults of the bus: of frames at their sender's gateway, on the wire and at a receiver, and foreign nodes.

use std::collections::VecDeque;
use std::time::Duration;

use can::CanFrame;
use can::frame_bits::arbitration_key;
use dbc::SignalMissing;
use dbc::loops::drive_seed;
use dbc::scenario_clock::ScenarioClock;
use faults::Stream;
use plan::Plan;
use recording::hits::{Effect, Hit};
use recording::reasons::Reasons;
use scenario::fault::{Actor, Fault, Group, Touch};
use scenario::node::Node;

use super::error_state::{Activity, ErrorState};
use super::hit_notes::HitNotes;
use crate::agenda::Timed;
use crate::names::emulator_name;

/// Largest number of frames that a driver keeps for a CAN controller which cannot send (assumed); it refuses more.
const SEND_FRAMES_MAX: usize = 32;

/// Bits of the node-ID in a COB-ID (CiA 301, 7.3.5).
pub(super) const NODE_ID_BITS: u16 = 0x7F;
/// Name of the receiver's fault; all other faults are of senders.
const LOSE: &str = "lose";

/// Returns the nodes behind the CAN controller of a participant, in the order of their node-IDs: a node, or the drives of an
/// emulator; that of canrig's own node is 0.
fn nodes_behind(participant: &str, plan: &Plan) -> Vec<(u8, String)> {
    if let Some(node) = plan.nodes.find(participant) {
        let node = &plan.nodes[node];
        return vec![(node.id(), node.name.clone())];
    }
    let loops = plan.loops.iter();
    let emulated = loops.filter(|one| one.drive().is_ours() && emulator_name(one) == participant);
    let drives = emulated.map(|one| one.drive());
    let mut nodes = Vec::from_iter(drives.map(|drive| (drive.id(), drive.name.clone())));
    nodes.sort_unstable();
    nodes
}

/// Fault that hits frames, with its random numbers.
#[derive(Debug)]
struct Hitting {
    fault: Fault,
    /// Path of the fault, which names its hits.
    path: String,
    /// Identifier of the frames to hit; all frames if `None`.
    identifier: Option<u16>,
    /// Node-ID of the node to hit; all nodes if `None`.
    node: Option<u8>,
    stream: Stream,
    /// Number of frames left in the present burst.
    burst_left: u32,
}

impl Hitting {
    fn new(plan: &Plan, fault: Fault) -> Self {
        let node = fault.node.map(|node| &plan.nodes[node]);
        let drive = node.filter(|node| node.is_drive());
        let run_seed = plan.shared.run.seed;
        let seed = drive.map_or(run_seed, |drive| drive_seed(run_seed, drive.id()));
        Self {
            identifier: identifier(&fault),
            node: node.map(Node::id),
            stream: Stream::for_fault(seed, &fault),
            burst_left: 0,
            path: fault.path(),
            fault,
        }
    }

    /// Returns whether this frame is hit at the CAN controller of these nodes. Call it once for each matching frame.
    fn hits(&mut self, nodes: &[u8], time_seconds: f64, frame: &CanFrame) -> bool {
        let is_meant = |id| frame.standard_id() == Some(id);
        let is_its = |node: u8| {
            let id = frame.standard_id();
            id.is_some_and(|id| id & NODE_ID_BITS == u16::from(node))
        };
        // A drive that shares its CAN controller with others is known by its own frames, if it is the sender.
        let is_alone = nodes.len() == 1 || self.fault.kind.touch == Touch::Receiver;
        let is_hit = |node: u8| nodes.contains(&node) && (is_alone || is_its(node));
        if !self.fault.acts_at(time_seconds)
            || !self.identifier.is_none_or(is_meant)
            || !self.node.is_none_or(is_hit)
        {
            return false;
        }
        if self.burst_left > 0 {
            self.burst_left -= 1;
            return true;
        }
        let begins = self.stream.happens(self.fault.number("probability"));
        if begins {
            let burst = self.fault.whole("burst_frames").unwrap_or_default();
            self.burst_left = burst.saturating_sub(1);
        }
        begins
    }
}

fn identifier(fault: &Fault) -> Option<u16> {
    u16::try_from(fault.whole("identifier")?).ok()
}

/// Foreign node; all times are scenario times.
#[derive(Debug)]
struct Foreign {
    path: String,
    identifier: u16,
    /// Whether a message of the run has this identifier.
    is_of_run: bool,
    from: Duration,
    until: Duration,
    /// Time between two frames; 0 without a pause.
    period: Duration,
    sent: u64,
}

impl Foreign {
    fn new(fault: &Fault, plan: &Plan) -> Self {
        let (from, until) = (fault.from_seconds, fault.until_seconds);
        let period_milliseconds = fault.optional("period_milliseconds");
        let identifier = identifier(fault).unwrap_or_default();
        let mut messages = plan.database().messages().iter();
        Self {
            path: fault.path(),
            identifier,
            is_of_run: messages.any(|message| message.raw_id == u32::from(identifier)),
            from: Duration::from_secs_f64(from.unwrap_or_default()),
            until: until.map_or(Duration::MAX, Duration::from_secs_f64),
            period: Duration::from_secs_f64(period_milliseconds.unwrap_or_default() * 1e-3),
            sent: 0,
        }
    }

    /// Returns when its next frame is due, if the bus is free from `free_at` on.
    fn next(&self, free_at: Duration) -> Option<Duration> {
        let periods = self.period.as_nanos() * u128::from(self.sent);
        let due = self.from + Duration::from_nanos_u128(periods);
        Some(due.max(free_at)).filter(|_| due < self.until && free_at < self.until)
    }

    fn frame(&self) -> CanFrame {
        let [a, b, c, d, ..] = self.sent.to_le_bytes();
        CanFrame::new(self.identifier, &[a, b, c, d, 0, 0, 0, 0])
    }
}

/// Frame that a gateway holds.
#[derive(Debug)]
struct Held {
    frame: CanFrame,
    /// Number of the frame among those of its identifier, and the path of the fault.
    number: u64,
    fault: String,
    since_seconds: f64,
}

/// All faults of the bus.
#[derive(Debug)]
pub(crate) struct BusFaults {
    /// Node-IDs behind the CAN controller of each participant.
    nodes: Vec<Vec<u8>>,
    hitting: Vec<Hitting>,
    foreign: Vec<Foreign>,
    /// Frames that each station's gateway holds until the next one has overtaken them.
    held: Vec<Vec<Held>>,
    /// Identifiers of the reports of emulated plants.
    pub(crate) truths: Vec<u16>,
    /// Error counters of each station.
    pub(crate) states: Vec<ErrorState>,
    clock: ScenarioClock,
    notes: HitNotes,
}

impl BusFaults {
    /// Makes the faults of the loops for these participants; `None` if there are none.
    ///
    /// # Errors
    /// If the database has no statusword, from which scenario time follows.
    pub(crate) fn new(plan: &Plan, participants: &[String]) -> Result<Option<Self>, SignalMissing> {
        let faults = &plan.shared.run.faults;
        if faults.in_group(Group::Bus).next().is_none() {
            return Ok(None);
        }
        let of_bus = faults.in_group(Group::Bus);
        let is_foreign = |fault: &&Fault| fault.kind.actor == Actor::Foreign;
        let (foreign, hitting): (Vec<_>, Vec<_>) = of_bus.partition(is_foreign);
        let nodes = participants.iter().map(|name| nodes_behind(name, plan));
        let nodes = Vec::from_iter(nodes);
        let ids = |nodes: &Vec<(u8, String)>| nodes.iter().map(|(id, _)| *id).collect();
        let loops = plan.loops.iter();
        let truths = loops.map(|one| one.trial.wiring.identifiers.truth);
        Ok(Some(Self {
            hitting: hitting
                .into_iter()
                .map(|fault| Hitting::new(plan, fault.clone()))
                .collect(),
            foreign: foreign
                .into_iter()
                .map(|fault| Foreign::new(fault, plan))
                .collect(),
            held: nodes.iter().map(|_| Vec::new()).collect(),
            truths: truths.collect(),
            states: vec![ErrorState::default(); nodes.len()],
            clock: plan.scenario_clock()?,
            nodes: nodes.iter().map(ids).collect(),
            notes: HitNotes::new(nodes.into_iter()),
        }))
    }

    /// Observes each frame that has passed.
    pub(crate) fn observe(&mut self, time: Duration, frame: &CanFrame) {
        self.clock.on_frame(time, frame);
        self.notes.count_passed(frame);
    }

    /// Notes that the bus has been idle.
    pub(crate) fn rest(&mut self) {
        self.notes.rest();
    }

    /// Notes that the bus is occupied by a foreign frame, or by a disturbed transmission of a participant, for a time.
    pub(crate) fn occupy(&mut self, fault: &str, time: Duration, sender: Option<usize>) {
        self.notes.occupy(fault, time, sender);
    }

    /// Notes a frame of a participant that goes on the bus now, with the time from which it has been ready.
    pub(crate) fn note_sent(
        &mut self,
        index: usize,
        frame: &CanFrame,
        ready: Duration,
        now: Duration,
    ) {
        if let Some(at) = self.seconds(now).filter(|_| !is_truth(&self.truths, frame)) {
            self.notes
                .note_sent(index, frame, now.saturating_sub(ready), at);
        }
    }

    /// Notes that a frame of a participant is dropped, since it has gone off the bus.
    pub(crate) fn note_dropped(&mut self, index: usize, frame: &CanFrame, now: Duration) {
        if let Some(at) = self.seconds(now) {
            self.notes.note_dropped(index, true, frame, at);
        }
    }

    /// Takes the reasons of all nodes.
    pub(crate) fn take_reasons(&mut self) -> Reasons {
        self.notes.take_reasons()
    }

    /// Takes all hits of a run that ends now, with the frames that still wait.
    pub(crate) fn take_hits<'a>(
        &mut self,
        outboxes: impl Iterator<Item = &'a VecDeque<Timed>>,
        now: Duration,
    ) -> Vec<Hit> {
        for (index, outbox) in outboxes.enumerate() {
            for (ready, frame) in outbox {
                self.note_sent(index, frame, *ready, now);
            }
        }
        if let Some(at) = self.seconds(now) {
            for (index, held) in self.held.iter().enumerate() {
                for one in held {
                    let (hit, frame) = ((&*one.fault, Effect::Late), (&one.frame, one.number));
                    self.notes
                        .note_queued(index, hit, frame, (one.since_seconds, at));
                }
            }
        }
        self.notes.take()
    }

    /// Returns the faults of a kind at a participant that hit a frame. Count them to the end: every fault is asked, so that none
    /// depends on another.
    fn hits(
        &mut self,
        kind: &'static str,
        index: usize,
        seconds: f64,
        frame: CanFrame,
    ) -> impl Iterator<Item = &mut Hitting> {
        let nodes = &self.nodes[index];
        let faults = self.hitting.iter_mut();
        let of_kind = faults.filter(move |one| one.fault.kind.name == kind);
        of_kind.filter_map(move |one| one.hits(nodes, seconds, &frame).then_some(one))
    }

    fn seconds(&self, time: Duration) -> Option<f64> {
        Some(time.checked_sub(self.clock.zero()?)?.as_secs_f64())
    }

    /// Takes frames from a participant through its gateway into its outbox, which stays in the order of time. Frames that a
    /// station sends while it is off the bus are lost.
    pub(crate) fn queue(&mut self, index: usize, frames: &[Timed], outbox: &mut VecDeque<Timed>) {
        for (time, frame) in frames {
            if let Some(at) = self.seconds(*time) {
                self.notes.note_reason(frame, at);
            }
            if is_truth(&self.truths, frame) {
                insert(outbox, *time, *frame);
            } else if self.states[index].activity() == Activity::Off {
                self.note_dropped(index, frame, *time);
            } else {
                for (time, frame) in self.gateway(index, *time, *frame) {
                    if outbox.len() < SEND_FRAMES_MAX {
                        insert(outbox, time, frame);
                    } else if let Some(at) = self.seconds(time) {
                        self.notes.note_dropped(index, false, &frame, at);
                    }
                }
            }
        }
    }

    /// Applies the sender's faults to one frame.
    fn gateway(&mut self, index: usize, time: Duration, mut frame: CanFrame) -> Vec<Timed> {
        let Some(seconds) = self.seconds(time) else {
            return vec![(time, frame)];
        };
        let number = self.notes.count_queued(index, &frame);
        let mut noted: Vec<(String, Effect, f64)> = Vec::new();
        for corrupt in self.hits("corrupt", index, seconds, frame) {
            let bits = corrupt.fault.whole("inverted_bits").unwrap_or_default();
            frame = inverted(&frame, bits, &mut corrupt.stream);
            noted.push((corrupt.path.clone(), Effect::Changed, seconds));
        }
        let mut leaves = time;
        for delay in self.hits("delay", index, seconds, frame) {
            let later = Duration::from_secs_f64(delay.fault.number("delay_milliseconds") * 1e-3);
            leaves += later;
            let until = seconds + later.as_secs_f64();
            noted.push((delay.path.clone(), Effect::Late, until));
        }
        let mut copies = 1;
        for duplicate in self.hits("duplicate", index, seconds, frame) {
            copies += 1;
            noted.push((duplicate.path.clone(), Effect::Copied, seconds));
        }
        let reorders = self.hits("reorder", index, seconds, frame);
        let reorder = reorders.map(|one| one.path.clone()).last();
        for (fault, effect, until) in noted {
            let (hit, frame) = ((&*fault, effect), (&frame, number));
            self.notes.note_queued(index, hit, frame, (seconds, until));
        }
        if let Some(fault) = reorder {
            self.held[index].push(Held {
                frame,
                number,
                fault,
                since_seconds: seconds,
            });
            return Vec::new();
        }
        let mut frames = vec![(leaves, frame); copies];
        for held in self.held[index].drain(..) {
            let (hit, frame) = ((&*held.fault, Effect::Late), (&held.frame, held.number));
            self.notes
                .note_queued(index, hit, frame, (held.since_seconds, seconds));
            frames.push((leaves, held.frame));
        }
        frames
    }

    /// Returns whether a receiver is off the bus, or overruns on this frame.
    pub(crate) fn misses(&mut self, index: usize, time: Duration, frame: &CanFrame) -> bool {
        let seconds = self.seconds(time);
        if self.states[index].activity() == Activity::Off {
            if let Some(at) = seconds {
                self.notes.note_missed(index, None, frame, at);
            }
            return true;
        }
        let Some(at) = seconds else {
            return false;
        };
        let losing = self.hits(LOSE, index, at, *frame);
        let Some(fault) = losing.map(|one| one.path.clone()).last() else {
            return false;
        };
        self.notes.note_missed(index, Some(&fault), frame, at);
        true
    }

    /// Returns after how many of the frame's bits this transmission is disturbed, and the path of the fault; `None` if it is not.
    pub(crate) fn disturbs(
        &mut self,
        index: usize,
        time: Duration,
        frame: &CanFrame,
        bits: u32,
    ) -> Option<(u32, String)> {
        let seconds = self
            .seconds(time)
            .filter(|_| !is_truth(&self.truths, frame))?;
        let errors = self.hits("bit_error", index, seconds, *frame);
        let places = errors.map(|error| (error.stream.below(u64::from(bits)), &error.path));
        let (last, path) = places.last()?;
        Some((1 + u32::try_from(last).unwrap_or_default(), path.clone()))
    }

    /// Returns the time at which a foreign node next wants to send, if the bus is free from `free_at` on.
    pub(crate) fn next_foreign(&self, free_at: Duration) -> Option<Duration> {
        let zero = self.clock.zero()?;
        let free_at = free_at.saturating_sub(zero);
        let next = self.foreign.iter().filter_map(|node| node.next(free_at));
        next.min().map(|next| zero + next)
    }

    /// Takes the frame of the foreign nodes in the arbitration at `now`, the one with the lowest identifier, if it beats a rival
    /// with this key; with the path of its fault.
    pub(crate) fn take_foreign(
        &mut self,
        now: Duration,
        rival: Option<u32>,
    ) -> Option<(CanFrame, String)> {
        let time = now.checked_sub(self.clock.zero()?)?;
        let foreign = self.foreign.iter_mut();
        let due = foreign.filter(|node| node.next(time) == Some(time));
        let first = due.min_by_key(|node| node.identifier)?;
        let frame = first.frame();
        if rival.is_some_and(|rival| arbitration_key(&frame) >= rival) {
            return None;
        }
        first.sent += 1;
        if first.is_of_run {
            let at = time.as_secs_f64();
            self.notes.note_foreign(&first.path, &frame, first.sent, at);
        }
        Some((frame, first.path.clone()))
    }

    /// Returns whether no participant may go ahead: errors on the wire may reach it at the end of any frame.
    pub(crate) fn forbids_look_ahead(&self) -> bool {
        let mut kinds = self.hitting.iter().map(|one| one.fault.kind.name);
        kinds.any(|kind| kind == "bit_error")
    }

    /// Returns the number of a participant's first node, for its error messages.
    pub(crate) fn node_number(&self, index: usize) -> u8 {
        self.nodes[index].first().copied().unwrap_or_default()
    }
}

/// Returns whether a frame is a report of an emulated plant. `truths` has the identifiers of these reports. Their CAN controller
/// has no faults, since a report must tell the true effect of faults on the wire.
pub(crate) fn is_truth(truths: &[u16], frame: &CanFrame) -> bool {
    let id = frame.standard_id();
    id.is_some_and(|id| truths.contains(&id))
}

fn insert(outbox: &mut VecDeque<Timed>, time: Duration, frame: CanFrame) {
    let place = outbox.partition_point(|(other, _)| *other <= time);
    outbox.insert(place, (time, frame));
}

/// Returns the frame with some bits of its payload inverted.
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
