//! Explanations by the hits of a scenario's faults: of a frame that they took or held up, and of the time in which they kept a
//! node from running, no longer.

use std::cell::Cell;
use std::collections::BTreeSet;

use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID};
use dbc::Database;
use dbc::scenario_clock::SYNC_COB_ID;
use plan::ControlLoop;
use recording::hits::{Effect, Hit, Hits};
use recording::timeline::{Series, Timeline};
use scenario::fault::Fault;
use scenario::node::Node;

use super::breaches::{Breach, Duty};
use crate::circumstances::Circumstances;

/// Times of hits and of frames are whole microseconds, each rounded by itself.
const MICROSECONDS: f64 = 2e-6;
/// Bits of the node-ID in an identifier (CiA 301, 7.3.5).
const NODE_ID_BITS: u16 = 0x7F;
/// Parts in a million.
const MILLION: f64 = 1e6;

/// Cycles without a frame of a duty in time, where its frames serve the cycles in their order.
#[derive(Default)]
struct HeldUp {
    /// Cycles whose frame came too late by no more than faults held it up.
    cycles: BTreeSet<u64>,
    /// Cycles for which no frame is left, in their order.
    unserved: Vec<u64>,
    /// Numbers of the breaches so far, and of those that were explained by this.
    seen: Cell<u64>,
    explained: Cell<u64>,
}

impl HeldUp {
    /// Whether the frame of this cycle was held up. A frame that serves an earlier cycle is missing in its own: of the breaches
    /// so far, as many remain as there are cycles without any frame.
    fn explains(&self, cycle: u64) -> bool {
        let seen = self.seen.get() + 1;
        self.seen.set(seen);
        let unserved = self.unserved.partition_point(|one| *one <= cycle) as u64;
        let is_free = unserved + self.explained.get() < seen;
        let is_held_up = is_free && self.cycles.contains(&cycle);
        self.explained
            .set(self.explained.get() + u64::from(is_held_up));
        is_held_up
    }

    fn rewind(&self) {
        self.seen.set(0);
        self.explained.set(0);
    }
}

/// Hits that concern a loop.
pub(crate) struct LoopHits<'a> {
    timeline: &'a Timeline,
    database: &'a Database,
    control_loop: &'a ControlLoop,
    hits: Option<&'a Hits>,
    /// Cycles whose SYNC, position or command a fault only held up, and those in which none came at all.
    held_up: [HeldUp; 3],
    /// Number of SYNCs that a wrong clock has cost so far, while breaches are explained in their order.
    by_clock: Cell<u64>,
}

impl<'a> LoopHits<'a> {
    pub(super) fn new(
        timeline: &'a Timeline,
        (database, control_loop): (&'a Database, &'a ControlLoop),
        circumstances: &'a Circumstances,
        due: u64,
    ) -> Self {
        let hits = circumstances.unrecorded.hits.as_ref();
        let mut found = Self {
            timeline,
            database,
            control_loop,
            hits,
            held_up: Default::default(),
            by_clock: Cell::new(0),
        };
        if found.of(Effect::Late).next().is_some() {
            found.held_up = [Duty::Sync, Duty::Position, Duty::Command]
                .map(|duty| found.find_held_up(duty, due));
        }
        found
    }

    /// Whether the recording says what its faults hit, if it has any.
    pub(crate) fn are_known(&self) -> bool {
        self.hits.is_some() || self.control_loop.trial.run.faults.is_empty()
    }

    /// Whether a fault acts in this time, in a recording that does not say what its faults hit.
    pub(super) fn may_explain(&self, from_seconds: f64, until_seconds: f64) -> bool {
        let acts = |fault: &Fault| {
            let (from, until) = span(fault);
            from <= until_seconds && until >= from_seconds
        };
        !self.are_known() && self.control_loop.faults().any(acts)
    }

    fn all(&self) -> impl Iterator<Item = &'a Hit> {
        self.hits.into_iter().flat_map(Hits::iter)
    }

    fn of(&self, effect: Effect) -> impl Iterator<Item = &'a Hit> {
        self.hits.into_iter().flat_map(move |hits| hits.of(effect))
    }

    /// Hits with an effect in a time. Times of frames and of hits are rounded each by itself.
    fn within(&self, effect: Effect, from: f64, until: f64) -> impl Iterator<Item = &'a Hit> {
        let (from, until) = (from - MICROSECONDS, until + MICROSECONDS);
        let hits = self.hits.into_iter();
        hits.flat_map(move |hits| hits.overlapping(effect, from, until))
    }

    /// Whether a fault has hit anything by a time.
    pub(super) fn has_begun(&self, until: f64) -> bool {
        // They are in the order of their starts.
        self.all()
            .next()
            .is_some_and(|hit| hit.from_seconds <= until)
    }

    /// Begins the explanation of breaches in the order of time.
    pub(super) fn rewind(&self) {
        self.by_clock.set(0);
        self.held_up.iter().for_each(HeldUp::rewind);
    }

    /// Whether a fault took this very frame, or kept its node from running. `stays_since` is the start of the breaches without
    /// interruption that this one belongs to.
    pub(super) fn took(&self, breach: &Breach, stays_since: f64) -> bool {
        let (duty, from, until) = (breach.duty, breach.from_seconds, breach.until_seconds);
        // Each breach counts among those that remain, also one that has another explanation.
        let is_held_up = if breach.is_late {
            self.is_as_late_as_hit(breach.cycle)
        } else {
            self.is_held_up(duty, breach.cycle)
        };
        let node = self.node_of(duty);
        is_held_up
            || self.kept_from_running(node, from, until, stays_since)
            || self.is_lost(duty, breach.cycle)
            || duty == Duty::Sync && self.is_by_clock(node, from)
    }

    /// Whether a node did not run at a time, or had no more time since then than this run needed to bring it up.
    pub(super) fn kept_from_running(
        &self,
        node: &Node,
        from: f64,
        until: f64,
        stays_since: f64,
    ) -> bool {
        let period = self.timeline.period_seconds;
        let bring_up = self.timeline.bring_up_seconds;
        let is_down = |hit: &&Hit| {
            let has_stayed = stays_since <= hit.until_seconds + period
                && hit.from_seconds <= until
                && from <= hit.until_seconds + bring_up;
            hit.is_at(&node.name) && (hit.overlaps(from, until) || has_stayed)
        };
        self.of(Effect::NotRun).any(|hit| is_down(&hit))
    }

    /// Whether the frame of a duty reached nobody, or the frame that triggers it did not reach its node.
    fn is_lost(&self, duty: Duty, cycle: u64) -> bool {
        let own = self.identifier(duty);
        let trigger = match duty {
            Duty::Position => Some((self.control_loop.drive(), self.identifier(Duty::Sync))),
            Duty::Command => {
                let controller = self.control_loop.controller();
                Some((controller, self.identifier(Duty::Position)))
            }
            _ => None,
        };
        let due = self.timeline.cycle_start_seconds(cycle);
        let half = self.timeline.period_seconds / 2.0;
        let span = |identifier: u16| match identifier {
            SYNC_COB_ID => (due - half, due + half),
            _ => (self.begins(cycle), self.begins(cycle + 1)),
        };
        let lost = |identifier: Option<u16>, is_by: &dyn Fn(&Hit) -> bool| {
            identifier.is_some_and(|identifier| {
                let (from, until) = span(identifier);
                let mut lost = self.within(Effect::Lost, from, until);
                lost.any(|hit| hit.is_of(identifier) && is_by(hit))
            })
        };
        lost(own, &|hit| hit.node.is_none())
            || trigger.is_some_and(|(node, identifier)| {
                lost(identifier, &|hit| hit.node.as_ref() == Some(&node.name))
            })
    }

    /// Scenario time at which a cycle begins: when its SYNC came, or when it was due if none came near that time.
    fn begins(&self, cycle: u64) -> f64 {
        let due = self.timeline.cycle_start_seconds(cycle);
        let half = self.timeline.period_seconds / 2.0;
        let sync = self.first_sync_of(cycle).filter(|at| *at < due + half);
        sync.unwrap_or(due)
    }

    /// Scenario time of the first SYNC that a cycle may begin with: one that comes half a period early, or later.
    fn first_sync_of(&self, cycle: u64) -> Option<f64> {
        let timeline = self.timeline;
        let earliest = timeline.cycle_start_seconds(cycle) - timeline.period_seconds / 2.0;
        first_from(&timeline.syncs_seconds, earliest)
    }

    fn is_held_up(&self, duty: Duty, cycle: u64) -> bool {
        let place = match duty {
            Duty::Sync => 0,
            Duty::Position => 1,
            Duty::Command => 2,
            _ => return false,
        };
        self.held_up[place].explains(cycle)
    }

    /// Whether the command of a cycle, which came after the next SYNC, would have come before it without the faults.
    fn is_as_late_as_hit(&self, cycle: u64) -> bool {
        let timeline = self.timeline;
        let at = timeline.cycle_start_seconds(cycle);
        let next = self.first_sync_of(cycle + 1);
        let sync = next.unwrap_or(at + timeline.period_seconds);
        let arrival = first_from(&timeline.commands_seconds, sync - MICROSECONDS);
        let delay = self.delay(Duty::Command, at);
        arrival.is_some_and(|arrival| delay > 0.0 && arrival - delay <= sync + MICROSECONDS)
    }

    /// Whether a gateway sent a SYNC again at a time: the second one is a copy.
    pub(crate) fn is_copy(&self, at: f64) -> bool {
        let identifier = self.identifier(Duty::Sync);
        let since = at - self.timeline.period_seconds / 2.0;
        let mut copied = self.within(Effect::Copied, since, at);
        copied.any(|hit| identifier.is_some_and(|id| hit.is_of(id)))
    }

    /// Number of SYNCs that faults changed.
    pub(crate) fn count_changed_syncs(&self) -> u64 {
        let identifier = self.identifier(Duty::Sync);
        let changed = self.of(Effect::Changed);
        let changed = changed.filter(|hit| identifier.is_some_and(|id| hit.identifier == Some(id)));
        changed.map(|hit| hit.frames).sum()
    }

    /// Whether the controller's clock is wrong by so much that it has cost this SYNC, too.
    fn is_by_clock(&self, controller: &Node, from: f64) -> bool {
        let wrong = self
            .of(Effect::Clock)
            .filter(|hit| hit.is_at(&controller.name) && hit.overlaps(from, from));
        let cost = wrong.map(|hit| {
            let periods = (from - hit.from_seconds.max(0.0)) / self.timeline.period_seconds;
            1.0 + hit.amount.abs() / MILLION * periods.max(0.0)
        });
        let cost: f64 = cost.sum();
        let used = self.by_clock.get();
        let is_explained = (used as f64) < cost;
        self.by_clock.set(used + u64::from(is_explained));
        is_explained
    }

    /// Error of the mean SYNC period in percent that faults explain until a time.
    pub(crate) fn period_error_percent(&self, at: f64, periods: f64) -> f64 {
        let controller = self.node_of(Duty::Sync);
        let length = periods * self.timeline.period_seconds;
        let sync = self.identifier(Duty::Sync);
        let acts = |hit: &&Hit| hit.is_at(&controller.name) && hit.overlaps(at - length, at);
        let clock = self.of(Effect::Clock).filter(acts);
        let late = self.of(Effect::Late).filter(acts);
        let late = late.filter(|hit| sync.is_some_and(|id| hit.is_of(id)));
        let clock: f64 = clock.map(|hit| 100.0 * hit.amount.abs() / MILLION).sum();
        let late = late.map(|hit| hit.amount / 1e3).fold(0.0, f64::max);
        clock + 100.0 * late / length
    }

    /// Whether the heartbeats of a node were taken from the time of the first missing one on, for as long as they are missing but
    /// for `patience`.
    pub(super) fn took_heartbeats(
        &self,
        node: &Node,
        from: f64,
        until: f64,
        patience: f64,
    ) -> bool {
        let identifier = ERROR_CONTROL_ID + u16::from(node.id());
        let is_taken = |hit: &Hit| {
            let is_lost = hit.effect == Effect::Lost && hit.node.is_none() && hit.is_of(identifier);
            let is_down = hit.effect == Effect::NotRun && hit.is_at(&node.name);
            let is_late =
                hit.effect == Effect::Late && hit.is_at(&node.name) && hit.is_of(identifier);
            let ends = match hit.effect {
                Effect::NotRun => hit.until_seconds + self.timeline.bring_up_seconds,
                _ => hit.until_seconds,
            };
            (is_lost || is_down || is_late)
                && hit.from_seconds <= from + patience
                && ends + patience >= until.min(self.end_seconds())
        };
        let effects = [Effect::Lost, Effect::NotRun, Effect::Late];
        let mut hits = effects.into_iter().flat_map(|effect| self.of(effect));
        hits.any(is_taken)
    }

    fn end_seconds(&self) -> f64 {
        self.control_loop.trial.run.duration_seconds
    }

    /// Whether a receiver missed frames with one of these identifiers in a time.
    pub(super) fn missed(
        &self,
        receiver: &Node,
        identifiers: &[u16],
        from: f64,
        until: f64,
    ) -> bool {
        self.within(Effect::Lost, from, until)
            .any(|hit| hit.is_at(&receiver.name) && identifiers.iter().any(|id| hit.is_of(*id)))
    }

    /// Whether faults changed what a node measures or sends, or gave it a command, before a time.
    pub(super) fn changed(&self, node: &Node, from: f64, until: f64) -> bool {
        let effects = [Effect::Changed, Effect::Commanded].into_iter();
        let mut hits = effects.flat_map(|effect| self.within(effect, from, until));
        hits.any(|hit| hit.is_at(&node.name))
    }

    /// Whether faults changed a frame that a drive obeys, in the cycles before a time.
    pub(super) fn changed_order(&self, drive: &Node, at: f64) -> bool {
        let command = self.identifier(Duty::Command);
        let is_obeyed = |identifier: u16| {
            let is_to_node = identifier & NODE_ID_BITS == u16::from(drive.id());
            let is_to_all = [COMMAND_ID, SYNC_COB_ID].contains(&identifier);
            is_to_node || is_to_all || Some(identifier) == command
        };
        let from = at - 3.0 * self.timeline.period_seconds;
        let mut changed = self.within(Effect::Changed, from, at);
        changed.any(|hit| hit.identifier.is_some_and(is_obeyed))
    }

    /// Whether a fault changed the position or the command of the cycle before a time, or may have.
    pub(crate) fn changed_value(&self, at: f64) -> bool {
        let values = [Duty::Position, Duty::Command].map(|duty| self.identifier(duty));
        let from = at - self.timeline.period_seconds;
        let is_value = |hit: &Hit| values.iter().flatten().any(|id| hit.is_of(*id));
        let mut changed = self.within(Effect::Changed, from, at);
        changed.any(is_value) || self.may_explain(from, at)
    }

    /// Whether frames of a node reached no other node in a time, since it was off the bus.
    pub(super) fn was_off(&self, node: &Node, from: f64, until: f64) -> bool {
        let is_its = |identifier: u16| identifier & NODE_ID_BITS == u16::from(node.id());
        let mut lost = self.within(Effect::Lost, from, until);
        lost.any(|hit| hit.node.is_none() && hit.identifier.is_some_and(is_its))
    }

    /// Whether a fault still acts at a time, or has shortly before.
    pub(super) fn go_on(&self, at: f64) -> bool {
        let lately = at - self.timeline.bring_up_seconds - self.timeline.period_seconds;
        self.all().any(|hit| hit.overlaps(lately, at))
    }

    /// Scenario time of the first hit on a frame or value that a node receives from others.
    pub(super) fn first_on_others(&self, node: &Node) -> Option<f64> {
        let is_received = |hit: &&Hit| match hit.effect {
            Effect::Lost => hit.is_at(&node.name),
            _ => hit.node.as_deref() != Some(&*node.name),
        };
        let received = self.all().filter(is_received);
        received.map(|hit| hit.from_seconds).reduce(f64::min)
    }

    /// Whether a fault lost or held up frames of a duty in a time.
    pub(super) fn is_hit_in(&self, duty: Duty, from: f64, until: f64) -> bool {
        let (node, Some(identifier)) = (self.node_of(duty), self.identifier(duty)) else {
            return false;
        };
        let lost = self.within(Effect::Lost, from, until);
        let lost = lost.filter(|hit| hit.node.is_none());
        let late = self.within(Effect::Late, from, until);
        let late = late.filter(|hit| hit.is_at(&node.name));
        lost.chain(late).any(|hit| hit.is_of(identifier))
    }

    /// Whether the scenario gave an NMT command at a time.
    pub(super) fn commanded(&self, at: f64) -> bool {
        let slack = 2.0 * self.timeline.period_seconds;
        self.within(Effect::Commanded, at - slack, at)
            .next()
            .is_some()
    }

    fn node_of(&self, duty: Duty) -> &'a Node {
        self.control_loop.node(duty.node(self.control_loop))
    }

    /// Identifier of the frame of a duty.
    pub(super) fn identifier(&self, duty: Duty) -> Option<u16> {
        let one = self.control_loop;
        let raw_id = match duty {
            Duty::Sync => SYNC_COB_ID.into(),
            Duty::Position => one.drive_position(self.database).ok()?.raw_id(),
            Duty::Command => one.target(self.database).ok()?.raw_id(),
            _ => return None,
        };
        u16::try_from(raw_id).ok()
    }

    /// Largest delay in seconds of the frame of a duty that is due at a time, with that of the frame that triggers it.
    fn delay(&self, duty: Duty, at: f64) -> f64 {
        let trigger = match duty {
            Duty::Position => self.delay(Duty::Sync, at),
            Duty::Command => self.delay(Duty::Position, at),
            _ => 0.0,
        };
        let (node, Some(identifier)) = (self.node_of(duty), self.identifier(duty)) else {
            return trigger;
        };
        let late = self.within(Effect::Late, at, at + self.timeline.period_seconds);
        let late = late.filter(|hit| hit.is_at(&node.name) && hit.is_of(identifier));
        trigger + late.map(|hit| hit.amount / 1e3).sum::<f64>()
    }

    /// Number of frames of a duty that faults may still hold up at the end.
    fn pending(&self, duty: Duty) -> u64 {
        let (node, Some(identifier)) = (self.node_of(duty), self.identifier(duty)) else {
            return 0;
        };
        let (period, end) = (self.timeline.period_seconds, self.end_seconds());
        let late = self.of(Effect::Late).filter(|hit| {
            let is_of_duty = hit.is_at(&node.name) && hit.is_of(identifier);
            is_of_duty && hit.until_seconds + period >= end
        });
        late.map(|hit| match hit.frames {
            0 => self.timeline.cycles_in(hit.amount / 1e3 + period),
            frames => frames,
        })
        .sum()
    }

    /// Finds the cycles whose frame came too late, but no later than faults held it up. Each frame serves the first cycle that
    /// waits for it, so frames that were never sent remain missing.
    fn find_held_up(&self, duty: Duty, due: u64) -> HeldUp {
        let timeline = self.timeline;
        let period = timeline.period_seconds;
        let (lead, arrivals): (f64, &Series<f64>) = match duty {
            Duty::Sync => (period / 2.0, &timeline.syncs_seconds),
            Duty::Position => (0.0, &timeline.positions_seconds),
            _ => (0.0, &timeline.commands_seconds),
        };
        let due: Vec<(u64, f64)> = match duty {
            Duty::Sync => (0..due)
                .map(|cycle| (cycle, timeline.cycle_start_seconds(cycle)))
                .collect(),
            Duty::Position => cycles_of(&timeline.syncs_seconds, timeline, 0.5),
            _ => cycles_of(&timeline.positions_seconds, timeline, 0.0),
        };
        let end = self.end_seconds();
        let mut pending = self.pending(duty);
        let mut arrivals = arrivals.iter().peekable();
        let mut held_up = HeldUp::default();
        for (place, (cycle, at)) in due.iter().copied().enumerate() {
            while arrivals
                .next_if(|time| *time < at - lead - MICROSECONDS)
                .is_some()
            {}
            // What triggers the next one ends the time of this one, also if it comes early.
            let next = due.get(place + 1).filter(|(next, _)| *next == cycle + 1);
            let next = next.map_or(f64::INFINITY, |(_, at)| *at);
            let deadline = (at + period).min(next) - lead;
            let latest = deadline + self.delay(duty, at) + MICROSECONDS;
            match arrivals.next_if(|time| *time <= latest) {
                Some(time) if time + MICROSECONDS > deadline => {
                    held_up.cycles.insert(cycle);
                }
                Some(_) => {}
                // It still waits when the run ends.
                None if latest >= end && pending > 0 => {
                    pending -= 1;
                    held_up.cycles.insert(cycle);
                }
                None => held_up.unserved.push(cycle),
            }
        }
        held_up
    }
}

/// First of some times, which are in order, that is not before another one.
fn first_from(times: &Series<f64>, from: f64) -> Option<f64> {
    times.get(times.partition_point(|time| time < from))
}

/// Cycles in which these frames came, each once, with the time of the first. Frames belong to the cycle that began before them, or
/// at most `early` periods after them.
fn cycles_of(times: &Series<f64>, timeline: &Timeline, early: f64) -> Vec<(u64, f64)> {
    let mut cycles: Vec<(u64, f64)> = Vec::new();
    for time in times.iter() {
        let number = ((time + MICROSECONDS) / timeline.period_seconds + early).floor();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a time of the scenario, which lasts at most days"
        )]
        let cycle = number.max(0.0) as u64;
        if cycles.last().is_none_or(|(last, _)| *last < cycle) {
            cycles.push((cycle, time));
        }
    }
    cycles
}

/// Returns the span of a fault. A fault of the boot begins with the recording, and has ended at time 0.
pub(crate) fn span(fault: &Fault) -> (f64, f64) {
    match fault.from_seconds {
        None => (f64::NEG_INFINITY, 0.0),
        Some(from) => (from, fault.until_seconds.unwrap_or(f64::INFINITY)),
    }
}
