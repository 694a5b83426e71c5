//! Attribution of each breach of a duty: to the host, to a fault of the scenario, or to the node that has the duty. It follows
//! from the recording alone; docs/design/attribution.md states the rule.

pub(crate) mod breaches;
pub(crate) mod cause;
pub(crate) mod departures;
pub(crate) mod hits;
pub(crate) mod limits;
pub(crate) mod stalls;

use std::collections::BTreeMap;

use dbc::Database;
use plan::ControlLoop;
use recording::ending::{EarlyEnd, EndedBy};
use recording::losses::LostHeartbeat;
use recording::stalls::{Stall, What, Who};
use recording::timeline::{Series, TIME_TOLERANCE_SECONDS, Timeline};
use scenario::events::Window;
use scenario::node::NodeIndex;

use self::breaches::{Breach, Duty, command_breaches, has_next, missed_cycles, served};
use self::departures::{Departures, Root, expects_stop};
use self::hits::LoopHits;
use self::stalls::{Allowance, FeltStalls, Stretch, longest, stretches, undecided};
use crate::circumstances::Circumstances;
use crate::evidence::Evidence;

/// Longest time from the last other frame of a node that falls silent to the heartbeat that it owes.
const HEARTBEAT_SECONDS: f64 = 0.1;
/// Longest absence at the end that does not count as a silence, in cycles and in seconds.
const SILENT_AT_END: (u64, f64) = (5, 0.02);
/// Longest time from the last frame to the end of a recording with faults, in which the plant sends its truth at least every 10
/// ms.
pub(crate) const FAULTY_END_SECONDS: f64 = 0.05;
/// Longest such time without faults, in periods: the last SYNC comes a period before the end, or late.
const END_PERIODS: f64 = 1.5;
/// Factor by which the misses of stalls must exceed those of canrig's own nodes for stalls to explain the latter, too.
const PREVAILING: usize = 4;

/// Attribution of a breach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Cause {
    /// Stall of the host, which kept the machine, the bus or a node of canrig's from running.
    Host(Stretch),
    /// Fault of the scenario, or a node of another loop, whose verdict names it.
    Fault,
    /// Node that had this duty, canrig's own or under test.
    Node(Duty),
    /// No cause that the recording shows.
    Unknown(Duty),
}

/// Attribution of the breaches of a loop.
pub(crate) struct Attribution<'a> {
    timeline: &'a Timeline,
    control_loop: &'a ControlLoop,
    is_real_time: bool,
    /// Number of cycles that should have been played.
    pub(crate) due: u64,
    /// Stalls that controller and drive feel.
    felt: [FeltStalls; 2],
    pub(crate) hits: LoopHits<'a>,
    pub(crate) departures: Departures,
    /// Nodes whose otherwise unexplained breaches count as stalls, with the stall that is named for them.
    stood: [Option<Option<Stretch>>; 2],
    /// Longest stall, if stalls leave open what controller and drive broke that canrig did not
    /// start.
    undecided: [Option<Stretch>; 2],
    /// First cycle from which frames are missing to the end. Such a silence is not taken for an unnoticed stall.
    silent_from: u64,
    /// Totals of the missed cycles.
    pub(crate) cycles: Totals,
}

impl<'a> Attribution<'a> {
    pub(crate) fn new(
        timeline: &'a Timeline,
        (database, one): (&'a Database, &'a ControlLoop),
        circumstances: &'a Circumstances,
    ) -> Self {
        let host = &circumstances.host;
        let stretches = stretches(timeline, &host.stalls);
        let period_seconds = timeline.period_seconds;
        let felt = one
            .both()
            .map(|node| FeltStalls::of(node, &stretches, one, period_seconds));
        let due = due(timeline, one, circumstances.ended_early.as_ref());
        let hits = LoopHits::new(timeline, (database, one), circumstances, due);
        let reasons = &circumstances.unrecorded.reasons;
        let judged_until = one.trial.judged_end_seconds();
        let departures = Departures::new(timeline, (database, one), &hits, reasons, judged_until);
        let mut attribution = Self {
            timeline,
            control_loop: one,
            is_real_time: host.controller.is_some() || host.plant_emulator.is_some(),
            due,
            felt,
            hits,
            departures,
            stood: [None; 2],
            undecided: one
                .both()
                .map(|node| undecided(node, &stretches, one, host)),
            silent_from: 0,
            cycles: Totals::default(),
        };
        attribution.cycles = attribution.missed_totals();
        attribution.stood = attribution.standing(circumstances);
        let lasting = attribution.cycles.lasting(attribution.due);
        attribution.silent_from = lasting.map_or(u64::MAX, |stay| stay.first.cycle);
        if attribution.stood.iter().any(Option::is_some) {
            attribution.cycles = attribution.missed_totals();
        }
        attribution
    }

    fn missed_totals(&self) -> Totals {
        let missed = missed_cycles(self.timeline, self.due);
        Totals::of(self.due, self.control_loop, self.attributed(missed))
    }

    /// Returns those of canrig's nodes that stalled in the cycles that they left out. Such a node
    /// has a loop that counted no overrun. Any node counts if stalls explain four of five missed
    /// cycles, since no clock of the machine shows a processor that the host of a virtual machine
    /// took from a running thread. A node that canrig did not start counts if it stands still with
    /// the machine, and stalls cover more of the run than is trusted: nobody watches its process.
    fn standing(&self, circumstances: &Circumstances) -> [Option<Option<Stretch>>; 2] {
        let is_by_canrig = |duty: &Duty| !duty.is_of_external(self.control_loop);
        let by_nodes = self.cycles.by_nodes.iter();
        let breaches = by_nodes.filter(|(duty, _)| is_by_canrig(duty));
        let by_canrig: usize = breaches.map(|(_, (count, _))| count).sum();
        let by_canrig = by_canrig + self.cycles.unknown.map_or(0, |(count, _)| count);
        let prevails = by_canrig > 0 && PREVAILING * by_canrig <= self.cycles.by_host;
        let prevailing = longest(&self.cycles.stalls).filter(|_| prevails);
        [Duty::Sync, Duty::Position].map(|duty| {
            if !is_by_canrig(&duty) {
                return self.undecided[self.place(duty.node(self.control_loop))].map(Some);
            }
            let is_punctual = circumstances.is_punctual(duty == Duty::Sync);
            (prevails || is_punctual).then_some(prevailing)
        })
    }

    /// Returns the longest stall of a run whose stalls leave open what a node broke that stands
    /// still with the machine.
    pub(crate) fn undecided(&self, node: NodeIndex) -> Option<Stretch> {
        self.undecided[self.place(node)]
    }

    /// Attributes each of these breaches, which are in the order of time, to the first explanation that fits it: a hit on this very
    /// frame, a stall, or what made its node leave its duties. A controller also leaves where its drive has been silent for
    /// longer than the end of a run may be.
    fn attributed(
        &self,
        breaches: impl Iterator<Item = Breach>,
    ) -> impl Iterator<Item = (Breach, Cause)> {
        self.hits.rewind();
        let mut allowances = BTreeMap::new();
        let mut stay: Option<Silence> = None;
        breaches.map(move |breach| {
            let goes_on = stay.filter(|stay| stay.next_cycle == breach.cycle);
            let since = goes_on.map_or(breach.from_seconds, |stay| stay.since);
            let felt = &self.felt[self.place(breach.duty.node(self.control_loop))];
            let allowance = allowances.entry(breach.duty);
            let stall = allowance
                .or_insert_with(|| Allowance::of(felt))
                .explaining(breach.from_seconds, breach.until_seconds);
            let cause = self.explained(&breach, stall, since, goes_on.as_ref());
            let before = goes_on.and_then(|stay| stay.of_drive);
            let of_drive = match breach.duty {
                Duty::Position => Some(before.unwrap_or((breach.from_seconds, cause))),
                _ => before,
            };
            stay = Some(Silence {
                next_cycle: breach.cycle + 1,
                since,
                of_drive,
            });
            (breach, cause)
        })
    }

    fn explained(
        &self,
        breach: &Breach,
        stall: Option<Stretch>,
        since: f64,
        stay: Option<&Silence>,
    ) -> Cause {
        let (duty, from, until) = (breach.duty, breach.from_seconds, breach.until_seconds);
        let (one, hits) = (self.control_loop, &self.hits);
        if hits.took(breach, since) {
            return Cause::Fault;
        }
        if let Some(stretch) = stall {
            return Cause::Host(stretch);
        }
        if let Some(root) = self.departed(duty.node(one), since, until) {
            return match root {
                Root::Fault | Root::Elsewhere => Cause::Fault,
                Root::Own(begun) => self.by_node(begun, breach),
                Root::Unknown => self.by_node(duty, breach),
            };
        }
        let of_drive = stay.and_then(|stay| stay.of_drive);
        if let Some((began, cause)) = of_drive.filter(|_| duty == Duty::Sync) {
            let silent = from - began;
            let is_long = silent > silence_seconds_max(self.timeline) + TIME_TOLERANCE_SECONDS;
            // A stall explains no more than its own time.
            if is_long && !matches!(cause, Cause::Host(_)) {
                return cause;
            }
        }
        if duty == Duty::Position
            && one.drive().is_external()
            && let Some(cause) = self.answered_silence(since)
        {
            return cause;
        }
        if let Some(cause) = self.by_flood(breach) {
            return cause;
        }
        if hits.may_explain(from, until) {
            return Cause::Unknown(duty);
        }
        self.by_node(duty, breach)
    }

    /// Returns who kept a node from a bus that is full of frames of no node: the only node that is not canrig's. Of two the
    /// recording does not show which one sent them.
    fn by_flood(&self, breach: &Breach) -> Option<Cause> {
        let (from, until) = (breach.from_seconds, breach.until_seconds);
        let floods = &self.timeline.floods;
        let next = floods.partition_point(|(_, ends)| *ends < from);
        floods.get(next).filter(|(begins, _)| *begins <= until)?;
        let one = self.control_loop;
        match one.both().map(|node| one.node(node).is_ours()) {
            [true, true] => None,
            [false, true] => Some(self.by_node(Duty::Lead, breach)),
            [true, false] => Some(self.by_node(Duty::State(one.drive_index()), breach)),
            [false, false] => Some(Cause::Unknown(breach.duty)),
        }
    }

    /// Returns why a drive that is not canrig's is silent, if it fell silent when it had waited for the controller's heartbeat.
    fn answered_silence(&self, since: f64) -> Option<Cause> {
        let lost = departures::lost_heartbeat_before(self.timeline, self.control_loop, since)?;
        let explained = self.heartbeat_explained(lost);
        Some(explained.unwrap_or(Cause::Node(Duty::Heartbeat(
            self.control_loop.controller_index(),
        ))))
    }

    /// Returns why a node that is silent since a time, or the one that it depends on, has left its duties by another time. A
    /// controller that is not canrig's and goes on without its drive for longer than it waits for it falls silent by itself.
    fn departed(&self, node: NodeIndex, since: f64, until: f64) -> Option<Root> {
        let one = self.control_loop;
        let is_controller = node == one.controller_index();
        let other = if is_controller {
            one.drive_index()
        } else {
            one.controller_index()
        };
        let until = until + TIME_TOLERANCE_SECONDS;
        let departure = self.departures.latest(node, until);
        let departure = departure.or_else(|| {
            let others = self.departures.latest(other, until)?;
            let is_free = is_controller && one.controller().is_external();
            let patience = self.drive_lost_seconds();
            (!is_free || since <= others.at_seconds + patience).then_some(others)
        });
        departure.map(|one| one.root)
    }

    /// Longest time for which a controller goes on without its drive, and until it says so.
    fn drive_lost_seconds(&self) -> f64 {
        let real = self.control_loop.real_drive.as_ref();
        let limit = real.map(|drive| drive.real.timeouts.drive_lost_milliseconds);
        let limit = limit.map_or(0.0, |limit| f64::from(limit) / 1e3);
        2.0 * limit.max(HEARTBEAT_SECONDS)
    }

    /// Returns the first of the breaches that last to the end of a run with nodes that are not canrig's, if they follow from a
    /// fault that has ended: what comes after the recovery was not tried. A stop that the scenario limits is none.
    pub(crate) fn not_recovered(&self) -> Option<Breach> {
        let one = self.control_loop;
        let is_alone = one.controller().is_ours() && one.drive().is_ours();
        let lasting = self.cycles.lasting(self.due)?;
        let end = self.timeline.cycle_start_seconds(lasting.last_cycle);
        let is_open = lasting.cause == Cause::Fault && !self.hits.go_on(end);
        (is_open && !is_alone && !expects_stop(one)).then_some(lasting.first)
    }

    /// Returns why the heartbeats of a node stay away, unless that is a stall or its own.
    fn heartbeat_explained(&self, lost: &LostHeartbeat) -> Option<Cause> {
        let node = self.control_loop.node(lost.node);
        let (due, back) = (lost.due_seconds, lost.back_seconds);
        if self
            .hits
            .took_heartbeats(node, due, back, HEARTBEAT_SECONDS)
        {
            return Some(Cause::Fault);
        }
        if self.hits.may_explain(due, due) {
            return Some(Cause::Unknown(Duty::Heartbeat(lost.node)));
        }
        match self.departed(lost.node, due, due)? {
            Root::Fault | Root::Elsewhere => Some(Cause::Fault),
            Root::Own(duty) => Some(Cause::Node(duty)),
            Root::Unknown => Some(Cause::Unknown(Duty::Heartbeat(lost.node))),
        }
    }

    /// Returns the first time at which a node left its duties for a reason of its own, with the duty that was not done. What a stall
    /// may have caused does not count, nor what canrig's own nodes did but for their protections.
    pub(crate) fn left(&self) -> Option<(f64, Duty)> {
        let one = self.control_loop;
        let is_faulty = !one.trial.run.faults.is_empty();
        let mut own = self.departures.own();
        own.find(|(at, duty)| {
            let node = duty.node(one);
            let is_protection = is_faulty && matches!(duty, Duty::State(_));
            let is_stalled = self.stall(node, at - HEARTBEAT_SECONDS, *at).is_some()
                || self.undecided(node).is_some()
                || self.hits.may_explain(at - HEARTBEAT_SECONDS, *at);
            (duty.is_of_external(one) || is_protection) && !is_stalled
        })
    }

    /// Returns the place of a node among controller and drive.
    fn place(&self, node: NodeIndex) -> usize {
        usize::from(node != self.control_loop.controller_index())
    }

    /// Returns the stall that explains the missing frames of a node.
    pub(crate) fn stall(&self, node: NodeIndex, from: f64, until: f64) -> Option<Stretch> {
        self.felt[self.place(node)].explaining(from, until)
    }

    /// Attributes a miss that neither a noticed stall nor a fault explains.
    fn by_node(&self, duty: Duty, breach: &Breach) -> Cause {
        let node = duty.node(self.control_loop);
        let stood = self.stood[self.place(node)].filter(|_| breach.cycle < self.silent_from);
        let cause =
            stood.map(|prevailing| {
                Cause::Host(prevailing.unwrap_or_else(|| {
                    self.stood_in(node, breach.from_seconds, breach.until_seconds)
                }))
            });
        // Beside faults a node of canrig's does what it must: what nothing explains is not its own. Where no other node is in the
        // loop, it follows from what the faults hit before.
        let one = self.control_loop;
        let is_by_canrig = !duty.is_of_external(one)
            && !matches!(duty, Duty::State(_))
            && !one.trial.run.faults.is_empty();
        let is_alone = one.controller().is_ours() && one.drive().is_ours();
        cause.unwrap_or_else(|| {
            if !is_by_canrig {
                Cause::Node(duty)
            } else if is_alone && self.hits.has_begun(breach.until_seconds) {
                Cause::Fault
            } else {
                Cause::Unknown(duty)
            }
        })
    }

    /// Returns the stall of one of canrig's nodes that shows in the cycle that it missed.
    fn stood_in(&self, node: NodeIndex, from_seconds: f64, until_seconds: f64) -> Stretch {
        let who = if node == self.control_loop.controller_index() {
            Who::Controller
        } else {
            Who::PlantEmulator
        };
        let [from, until] =
            [from_seconds, until_seconds].map(|time| self.timeline.recorded_time(time));
        Stretch {
            from_seconds,
            until_seconds,
            stall: Stall::new(from, until, who, What::StoodStill),
        }
    }

    /// Returns the stall of one of canrig's nodes that was silent in real time and came back.
    fn stood_since(&self, node: NodeIndex, from_seconds: f64) -> Option<Stretch> {
        let mut lost = self.timeline.lost_heartbeats.iter().filter(|lost| {
            let is_in = from_seconds + HEARTBEAT_SECONDS >= lost.due_seconds
                && from_seconds <= lost.back_seconds;
            lost.node == node && lost.back_seconds.is_finite() && is_in
        });
        let lost = lost
            .next()
            .filter(|_| self.is_real_time && self.control_loop.node(node).is_ours())?;
        Some(self.stood_in(node, lost.due_seconds, lost.back_seconds))
    }

    /// Returns whether cycles were missed in a window, and all of them because of stalls.
    pub(crate) fn is_of_the_host(&self, window: Window) -> bool {
        let inside = |(breach, _): &(Breach, Cause)| {
            breach.from_seconds >= window.from_seconds - TIME_TOLERANCE_SECONDS
                && breach.from_seconds < window.until_seconds - TIME_TOLERANCE_SECONDS
        };
        let mut missed = self
            .attributed(missed_cycles(self.timeline, self.due))
            .filter(inside)
            .peekable();
        missed.peek().is_some() && missed.all(|(_, cause)| matches!(cause, Cause::Host(_)))
    }
}

/// Breaches without interruption.
#[derive(Clone, Copy)]
struct Silence {
    next_cycle: u64,
    /// Scenario time of the first one.
    since: f64,
    /// Scenario time of the first one that is the drive's, with the explanation of it.
    of_drive: Option<(f64, Cause)>,
}

/// Returns the longest time without a frame that is no silence yet.
fn silence_seconds_max(timeline: &Timeline) -> f64 {
    let (periods, seconds) = SILENT_AT_END;
    seconds.max(periods as f64 * timeline.period_seconds)
}

/// Kinds of cycles whose commands break their duty: missing or late.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Commands {
    Missed,
    Late,
}

impl Commands {
    /// Describes the command in such a cycle; `None` if it is missing.
    pub(crate) fn breach(self) -> Option<&'static str> {
        match self {
            Self::Missed => None,
            Self::Late => Some("a command a cycle late"),
        }
    }

    /// Returns whether there are no such cycles.
    pub(crate) fn are_sound(self, timeline: &Timeline) -> bool {
        self.breaking(timeline).is_empty()
    }

    fn breaking(self, timeline: &Timeline) -> &Series<u64> {
        match self {
            Self::Missed => &timeline.uncommanded,
            Self::Late => &timeline.late_commands,
        }
    }

    /// Returns the totals over the cycles in which a command was due: those with all positions that a law may read.
    pub(crate) fn totals(self, evidence: &Evidence<'_>) -> Totals {
        let attribution = &evidence.attribution;
        if self.are_sound(evidence.timeline) {
            return Totals::default();
        }
        let breaking = self.breaking(evidence.timeline).iter();
        let mut due = 0;
        let counted = commands_due(evidence).inspect(|_| due += 1);
        let breaches = command_breaches(
            evidence.timeline,
            breaking,
            counted,
            matches!(self, Self::Late),
        );
        let totals = Totals::of(0, evidence.control_loop, attribution.attributed(breaches));
        Totals { due, ..totals }
    }
}

fn commands_due(evidence: &Evidence<'_>) -> impl Iterator<Item = u64> {
    let all = evidence.attribution.due;
    let loops = evidence.loops.iter();
    let mut others = Vec::from_iter(loops.map(|(_, timeline)| served(timeline).peekable()));
    let cycles = served(evidence.timeline).take_while(move |cycle| *cycle < all);
    cycles.filter(move |cycle| others.iter_mut().all(|other| has_next(other, *cycle)))
}

/// Totals of the breaches of a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// Number of cycles that were due; 0 if no command breaks its duty, as then they are not counted.
    due: u64,
    all: usize,
    by_host: usize,
    /// Stalls that explain breaches. A stall that explains several in a row is listed once.
    pub(crate) stalls: Vec<Stretch>,
    /// Breaches of the nodes by the duty that was not done first: number, and time of the first.
    by_nodes: BTreeMap<Duty, (usize, f64)>,
    /// Breaches that nothing explains: number, and the first one.
    pub(crate) unknown: Option<(usize, Breach)>,
    /// Last breaches without interruption.
    latest: Option<Stay>,
}

/// Breaches without interruption.
#[derive(Clone, Copy, Debug)]
struct Stay {
    first: Breach,
    last_cycle: u64,
    cause: Cause,
}

impl Totals {
    fn of(due: u64, one: &ControlLoop, breaches: impl Iterator<Item = (Breach, Cause)>) -> Self {
        let mut totals = Self {
            due,
            ..Self::default()
        };
        breaches.for_each(|(breach, cause)| totals.add(one, breach, cause));
        totals
    }

    fn add(&mut self, one: &ControlLoop, breach: Breach, cause: Cause) {
        self.all += 1;
        // A breach of another node behind a stall is separate, and one that is no longer explained by a fault.
        let is_of_another = |stay: &Stay| match (stay.cause, cause) {
            (Cause::Host(_), Cause::Node(duty)) => duty.node(one) != stay.first.duty.node(one),
            (Cause::Fault, Cause::Node(_) | Cause::Unknown(_)) => true,
            _ => false,
        };
        let goes_on = |stay: &Stay| stay.last_cycle + 1 == breach.cycle && !is_of_another(stay);
        let begun = self.latest.filter(goes_on);
        self.latest = Some(Stay {
            first: begun.map_or(breach, |stay| stay.first),
            last_cycle: breach.cycle,
            cause: match begun.map(|stay| stay.cause) {
                None | Some(Cause::Host(_)) => cause,
                Some(begun) => begun,
            },
        });
        match cause {
            Cause::Fault => {}
            Cause::Unknown(_) => {
                let unknown = self.unknown.get_or_insert((0, breach));
                unknown.0 += 1;
            }
            Cause::Host(stretch) => {
                self.by_host += 1;
                if self.stalls.last() != Some(&stretch) {
                    self.stalls.push(stretch);
                }
            }
            Cause::Node(duty) => {
                let known = self.by_nodes.entry(duty);
                known.or_insert((0, breach.from_seconds)).0 += 1;
            }
        }
    }

    fn share_percent(&self, count: usize) -> f64 {
        let (due, count) = (self.due as f64, count as f64);
        if self.due == 0 {
            0.0
        } else {
            100.0 * count / due
        }
    }

    /// Returns the percentage of due cycles with a breach: with any, or with one that no stall explains.
    pub(crate) fn percent(&self, with_host: bool) -> f64 {
        self.share_percent(if with_host {
            self.all
        } else {
            self.all - self.by_host
        })
    }

    /// Returns the duties that nodes broke too often for a limit: each with its share of the cycles and the time of the first
    /// breach. Each frame that the recorder lost may have been one of theirs.
    pub(crate) fn too_many(&self, percent_max: f64, frames_lost: u64) -> Vec<(Duty, f64, f64)> {
        let lost = usize::try_from(frames_lost).unwrap_or(usize::MAX);
        let by_nodes = self.by_nodes.iter();
        let exceeded = by_nodes.filter(|(_, (count, _))| {
            let sure = count.saturating_sub(lost);
            sure > 0 && self.share_percent(sure) > percent_max
        });
        exceeded
            .map(|(duty, (count, first))| (*duty, self.share_percent(*count), *first))
            .collect()
    }

    /// Returns the duties that nodes broke without a stall or a fault as the cause.
    pub(crate) fn broken_by_nodes(&self) -> impl Iterator<Item = Duty> {
        self.by_nodes.keys().copied()
    }

    /// Returns the breaches that nothing explains, if there are too many for a limit.
    pub(crate) fn too_many_unknown(&self, percent_max: f64) -> Option<Breach> {
        let (count, first) = self.unknown?;
        (self.share_percent(count) > percent_max).then_some(first)
    }

    /// Returns the breaches that last to the last cycle or beyond it.
    fn lasting(&self, cycles: u64) -> Option<Stay> {
        self.latest.filter(|stay| stay.last_cycle + 1 >= cycles)
    }
}

/// Returns the number of cycles that should have been played: all of them if the run was to continue, even without any SYNC.
fn due(timeline: &Timeline, one: &ControlLoop, ended_early: Option<&EarlyEnd>) -> u64 {
    let scenario = &one.trial;
    if timeline.zero_seconds.is_none() {
        return 0;
    }
    let was_to_go_on = match ended_early {
        None => is_recorded_to_its_end(timeline, one),
        Some(end) => end.by == EndedBy::Node,
    };
    let cycles = scenario.judged_end_seconds() / timeline.period_seconds;
    // A cycle that begins before an earlier end of the judged time is judged.
    let judged = match scenario.expect.judged_until_seconds {
        None => libm::round(cycles),
        Some(_) => libm::ceil(cycles - TIME_TOLERANCE_SECONDS),
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a positive number of cycles"
    )]
    let judged = judged as u64;
    match (was_to_go_on, scenario.expect.judged_until_seconds) {
        (true, None) => timeline.cycles_due.max(judged),
        (true, Some(_)) => judged,
        (false, _) => timeline.cycles_due.min(judged),
    }
}

/// Returns whether frames came until the scenario's end.
pub(crate) fn is_recorded_to_its_end(timeline: &Timeline, one: &ControlLoop) -> bool {
    let is_sound = one.trial.run.faults.is_empty();
    let tolerance = if is_sound {
        END_PERIODS * timeline.period_seconds
    } else {
        FAULTY_END_SECONDS
    };
    timeline.zero_seconds.is_some()
        && timeline.last_frame_seconds + tolerance >= one.trial.run.duration_seconds
}

#[cfg(test)]
mod tests;
