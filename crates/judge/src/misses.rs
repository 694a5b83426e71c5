//! Whose doing it was that a cycle, or the command in it, was missed: the bench's, a fault's of the scenario, or a node's. By
//! evidence only: without a stall in the recording's evidence nothing is the bench's, and nothing of a node that is somebody else's
//! unless the stall was in that cycle; a fault explains what it touches.

mod faults;

use std::time::Duration;

use recording::ending::{EarlyEnd, EndedBy};
use recording::stalls::{Stall, Who};
use recording::timeline::{TIME_TOLERANCE_SECONDS, Timeline};
use rig::external::{External, ExternalNode};
use rig::plan::ControlLoop;
use scenario::events::Window;
use scenario::fault::Part;

use self::faults::ScenarioFaults;
use crate::circumstances::Circumstances;

/// Nodes wait at least for so long for each other's heartbeat.
const HEARD_SECONDS: f64 = 0.1;
/// After a shorter stall no node counts as silent.
const SILENT_PERIODS: f64 = 5.0;
/// So many periods after a stall, at most, come the frames that it held up.
const BURST_PERIODS: f64 = 2.0;
/// What is missing at the end for at most so many cycles, or so long, is no silence.
const SILENT_AT_END: (u64, f64) = (5, 0.02);
/// With faults the plant sends its truth every 10 ms at least.
pub(crate) const FAULTY_END_SECONDS: f64 = 0.05;
/// Without faults the last SYNC comes a period before the end, or late.
const END_PERIODS: f64 = 1.5;

/// What was missing in a cycle, and so by whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Missing {
    /// No SYNC: the controller's.
    Sync,
    /// A SYNC but no position: the drive's.
    Position,
    /// A position but no command: the controller's.
    Command,
}

impl Missing {
    const ALL: [Self; 3] = [Self::Sync, Self::Position, Self::Command];

    /// The node that was to send it.
    fn sender(self) -> Part {
        match self {
            Self::Sync | Self::Command => Part::Controller,
            Self::Position => Part::Drive,
        }
    }

    /// Whether somebody else's node was to send it.
    fn is_of(self, external: &External) -> bool {
        external.has(match self.sender() {
            Part::Controller => ExternalNode::Controller,
            Part::Drive | Part::Bench => ExternalNode::Drive,
        })
    }

    /// Among what is kept of each.
    fn place(self) -> usize {
        self as usize
    }

    /// `controller: no SYNC`
    fn words(self) -> &'static str {
        match self {
            Self::Sync => "controller: no SYNC",
            Self::Position => "drive: no position",
            Self::Command => "controller: no command",
        }
    }
}

/// Whose doing it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Doing {
    /// The bench's: of all stalls of that time, this one.
    Bench(Stretch),
    Fault,
    /// That of the node which was to send this.
    Node(Missing),
}

/// A stall in scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stretch {
    pub(crate) from_seconds: f64,
    pub(crate) until_seconds: f64,
    pub(crate) stall: Stall,
}

impl Stretch {
    fn length(&self) -> f64 {
        self.until_seconds - self.from_seconds
    }

    /// `the machine stood still for 45.0 ms at 1.234 s`
    pub(crate) fn words(&self) -> String {
        format!("{} at {:.3} s", self.stall, self.from_seconds)
    }
}

/// The stalls that explain why something was missing.
#[derive(Clone, Debug)]
struct Stalls {
    /// In the order of their ends.
    stretches: Vec<Stretch>,
    /// How long the longest is: what ends so much later than a cycle does not overlap it.
    longest_seconds: f64,
}

impl Stalls {
    /// Only processes that canrig started are watched, and what happened to them explains nothing of somebody else's node.
    fn excusing(stretches: &[Stretch], missing: Missing, external: &External) -> Self {
        let excuses = |stretch: &&Stretch| match (stretch.stall.who, missing.sender()) {
            (Who::Machine | Who::Bus, _) | (Who::Controller, Part::Controller) => true,
            (Who::PlantEmulator, Part::Controller) => false,
            (Who::Controller | Who::PlantEmulator, Part::Drive | Part::Bench) => {
                !external.has(ExternalNode::Drive)
            }
        };
        let mut excusing: Vec<Stretch> = stretches.iter().filter(excuses).copied().collect();
        excusing.sort_by(|left, right| left.until_seconds.total_cmp(&right.until_seconds));
        Self {
            longest_seconds: excusing.iter().map(Stretch::length).fold(0.0, f64::max),
            stretches: excusing,
        }
    }

    /// The longest that overlaps a stretch.
    fn overlapping(&self, from: f64, until: f64) -> Option<Stretch> {
        let ends_before =
            |stretch: &Stretch| stretch.until_seconds <= from + TIME_TOLERANCE_SECONDS;
        let first = self.stretches.partition_point(ends_before);
        let may_overlap =
            |stretch: &&Stretch| stretch.until_seconds <= until + self.longest_seconds;
        let candidates = self.stretches[first..].iter().take_while(may_overlap);
        candidates
            .filter(|stretch| stretch.from_seconds < until - TIME_TOLERANCE_SECONDS)
            .max_by(|left, right| left.length().total_cmp(&right.length()))
            .copied()
    }
}

/// A cycle that was missed, or the command in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Miss {
    cycle: u64,
    pub(crate) at_seconds: f64,
    pub(crate) doing: Doing,
}

/// All cycles that were missed, of those that were due. There may be as many as the run has cycles, so they are looked up
/// when they are needed, and only what they come to together is kept.
pub(crate) struct Misses<'a> {
    timeline: &'a Timeline,
    pub(crate) due: u64,
    /// The stalls that explain each of what may be missing.
    stalls: [Stalls; Missing::ALL.len()],
    /// The stall that explains what canrig's own nodes left out beside all others.
    prevailing: [Option<Stretch>; Missing::ALL.len()],
    faults: ScenarioFaults,
    totals: Totals,
}

/// What misses come to together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// Of so many cycles.
    due: u64,
    all: usize,
    by_bench: usize,
    /// Of those that a cycle was missed for.
    longest_stall: Option<Stretch>,
    /// When the first of the bench's own was, or the stall that it was missed for.
    first_by_bench_seconds: Option<f64>,
    /// Those of the nodes by what they left out first, with the time of the first.
    by_nodes: [(usize, f64); Missing::ALL.len()],
    /// The last of the nodes' without interruption, the first and the last of them.
    latest: Option<(Miss, Miss)>,
}

impl Totals {
    fn of(due: u64, misses: impl Iterator<Item = Miss>) -> Self {
        let mut totals = Self {
            due,
            ..Self::default()
        };
        misses.for_each(|miss| totals.add(miss));
        totals
    }

    fn add(&mut self, miss: Miss) {
        self.all += 1;
        match miss.doing {
            Doing::Fault => {}
            Doing::Bench(stretch) => {
                self.by_bench += 1;
                let longest = self.longest_stall.map_or(0.0, |longest| longest.length());
                if stretch.length() >= longest {
                    self.longest_stall = Some(stretch);
                }
                let begins = miss.at_seconds.min(stretch.from_seconds);
                let first = self.first_by_bench_seconds.get_or_insert(begins);
                *first = first.min(begins);
            }
            Doing::Node(missing) => {
                let (count, first_seconds) = &mut self.by_nodes[missing.place()];
                if *count == 0 {
                    *first_seconds = miss.at_seconds;
                }
                *count += 1;
                let goes_on = |(_, last): &(Miss, Miss)| last.cycle + 1 == miss.cycle;
                let first = self.latest.filter(goes_on).map_or(miss, |(first, _)| first);
                self.latest = Some((first, miss));
            }
        }
    }

    fn percent_of(&self, count: usize) -> f64 {
        #[expect(
            clippy::cast_precision_loss,
            reason = "cycle counts stay far below 2^52"
        )]
        let (due, count) = (self.due as f64, count as f64);
        if self.due == 0 {
            0.0
        } else {
            100.0 * count / due
        }
    }

    /// All of them, by all that were due.
    pub(crate) fn percent(&self) -> f64 {
        self.percent_of(self.all)
    }

    /// Those that the bench does not explain.
    pub(crate) fn percent_unexplained(&self) -> f64 {
        self.percent_of(self.all - self.by_bench)
    }

    pub(crate) fn percent_by_nodes(&self) -> f64 {
        self.percent_of(self.count_by_nodes())
    }

    fn count_by_nodes(&self) -> usize {
        self.by_nodes.iter().map(|(count, _)| count).sum()
    }

    pub(crate) fn percent_by_bench(&self) -> f64 {
        self.percent_of(self.by_bench)
    }

    /// When the first of the bench's own was, or the stall that it was missed for, and the longest stall for which one was missed.
    pub(crate) fn first_stall(&self) -> Option<(f64, Stretch)> {
        self.first_by_bench_seconds.zip(self.longest_stall)
    }

    /// Why a run fails whose nodes left out more than so many percent: who, how many and since when. Of the frames that the recorder
    /// lost, each may have been one of theirs.
    pub(crate) fn too_many_by_nodes(&self, percent_max: f64, frames_lost: u64) -> Option<String> {
        let lost = usize::try_from(frames_lost).unwrap_or(usize::MAX);
        let sure = self.count_by_nodes().saturating_sub(lost);
        if sure == 0 || self.percent_of(sure) <= percent_max {
            return None;
        }
        let parts = Missing::ALL.map(|missing| {
            let (count, first) = self.by_nodes[missing.place()];
            let (percent, words) = (self.percent_of(count), missing.words());
            (count > 0)
                .then(|| format!("{words} in {percent:.2} % of the cycles, first at {first:.3} s"))
        });
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        Some(format!("{} (limit {percent_max} %)", parts.join("; ")))
    }

    /// Why a run fails at whose end, the last cycle that was due, a node was silent and nothing explains it.
    pub(crate) fn silent_at_end(
        &self,
        last_due: u64,
        period_seconds: f64,
        frames_lost: u64,
    ) -> Option<String> {
        let (first, last) = self.latest.filter(|(_, last)| last.cycle >= last_due)?;
        let Doing::Node(missing) = first.doing else {
            return None;
        };
        let cycles = last.cycle + 1 - first.cycle;
        let seconds = stretch_of(cycles, period_seconds).0;
        let is_silence = cycles.saturating_sub(frames_lost) > SILENT_AT_END.0
            && seconds > SILENT_AT_END.1 + TIME_TOLERANCE_SECONDS;
        let (words, from) = (missing.words(), first.at_seconds);
        is_silence.then(|| format!("{words} from {from:.3} s to the end"))
    }
}

impl<'a> Misses<'a> {
    pub(crate) fn new(
        timeline: &'a Timeline,
        one: &ControlLoop,
        circumstances: &Circumstances,
    ) -> Self {
        let stretches = stretches(timeline, &circumstances.stalls);
        let mut misses = Self {
            timeline,
            prevailing: [None; Missing::ALL.len()],
            due: due(timeline, one, circumstances.ended_early.as_ref()),
            stalls: Missing::ALL
                .map(|missing| Stalls::excusing(&stretches, missing, &one.external)),
            faults: ScenarioFaults::new(timeline, one),
            totals: Totals::default(),
        };
        misses.totals = Totals::of(misses.due, misses.all());
        misses.prevailing = misses.prevailing(&one.external);
        if misses.prevailing.iter().any(Option::is_some) {
            misses.totals = Totals::of(misses.due, misses.all());
        }
        misses
    }

    /// Where stalls explain four of five missed cycles at least, they are the reason of what canrig's own nodes left out
    /// besides: a processor that the host of a virtual machine took from a running thread shows in no clock of the machine.
    fn prevailing(&self, external: &External) -> [Option<Stretch>; Missing::ALL.len()] {
        let own = (Missing::ALL.into_iter()).filter(|missing| !missing.is_of(external));
        let by_own: usize = own
            .map(|missing| self.totals.by_nodes[missing.place()].0)
            .sum();
        let prevails = by_own > 0 && 4 * by_own <= self.totals.by_bench;
        let longest = self.totals.longest_stall.filter(|_| prevails);
        Missing::ALL.map(|missing| longest.filter(|_| !missing.is_of(external)))
    }

    /// One by one, in the order of time.
    pub(crate) fn all(&self) -> impl Iterator<Item = Miss> {
        self.attributed(missed(self.timeline, self.due))
    }

    /// What they come to together.
    pub(crate) fn totals(&self) -> &Totals {
        &self.totals
    }

    /// The same of the commands that were missed in some of so many cycles.
    pub(crate) fn of_commands(&self, due: u64, cycles: impl Iterator<Item = u64>) -> Totals {
        let missed = cycles.map(|cycle| (cycle, Missing::Command));
        Totals::of(due, self.attributed(missed))
    }

    /// Whose doing each was. What is missing without interruption has the cause of the first that no stall explains.
    fn attributed(
        &self,
        missed: impl Iterator<Item = (u64, Missing)>,
    ) -> impl Iterator<Item = Miss> {
        // The cycle that would go on with what was missing last, and what that began with.
        let mut goes_on: Option<(u64, Doing)> = None;
        missed.map(move |(cycle, missing)| {
            let (from, until) = stretch_of(cycle, self.timeline.period_seconds);
            let cause = goes_on.filter(|(next, _)| *next == cycle);
            let stall = self.stalls[missing.place()].overlapping(from, until);
            let cause = match (cause, stall) {
                (Some((_, cause)), _) => Some(cause),
                (None, Some(_)) => None,
                (None, None) if self.faults.explain(missing, from, until) => Some(Doing::Fault),
                (None, None) => Some(Doing::Node(missing)),
            };
            goes_on = cause.map(|cause| (cycle + 1, cause));
            let doing = match (stall, cause) {
                (Some(stretch), _) => Doing::Bench(stretch),
                (None, Some(Doing::Fault)) => Doing::Fault,
                (None, cause) => {
                    let own = left_out(cause, missing);
                    self.prevailing[own.place()].map_or(Doing::Node(own), Doing::Bench)
                }
            };
            Miss {
                cycle,
                at_seconds: from,
                doing,
            }
        })
    }

    /// Whether cycles were missed in a window, and none of them by a node or a fault.
    pub(crate) fn are_of_the_bench_in(&self, window: Window) -> bool {
        let inside = |miss: &Miss| {
            miss.at_seconds >= window.from_seconds - TIME_TOLERANCE_SECONDS
                && miss.at_seconds < window.until_seconds - TIME_TOLERANCE_SECONDS
        };
        let mut missed = self.all().filter(inside).peekable();
        missed.peek().is_some() && missed.all(|miss| matches!(miss.doing, Doing::Bench(_)))
    }
}

/// Of what is missing without interruption, what a node left out first: a controller gives up where the drive is silent.
fn left_out(cause: Option<Doing>, missing: Missing) -> Missing {
    match cause {
        Some(Doing::Node(Missing::Position)) => Missing::Position,
        _ => missing,
    }
}

/// When a cycle begins and ends.
#[expect(
    clippy::cast_precision_loss,
    reason = "cycle numbers stay far below 2^52"
)]
fn stretch_of(cycle: u64, period_seconds: f64) -> (f64, f64) {
    let from = cycle as f64 * period_seconds;
    (from, from + period_seconds)
}

/// The numbers of the cycles that were missed.
fn missed(timeline: &Timeline, due: u64) -> impl Iterator<Item = (u64, Missing)> {
    let mut rows = timeline.cycle.iter().zip(timeline.position()).peekable();
    (0..due).filter_map(
        move |cycle| match rows.next_if(|(number, _)| **number <= cycle) {
            None => Some((cycle, Missing::Sync)),
            Some((_, position)) => position.is_nan().then_some((cycle, Missing::Position)),
        },
    )
}

/// The cycles that should have been played: all of them where the run was to go on, even if nobody sent a SYNC any more.
fn due(timeline: &Timeline, one: &ControlLoop, ended_early: Option<&EarlyEnd>) -> u64 {
    let scenario = &one.scenario;
    if timeline.zero_seconds.is_none() {
        return 0;
    }
    let was_to_go_on = match ended_early {
        None => is_recorded_to_its_end(timeline, one),
        Some(end) => end.by == EndedBy::Node,
    };
    let cycles = scenario.judged_end_seconds() / timeline.period_seconds;
    // A cycle that begins before an earlier end is judged.
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

/// Whether frames came until the scenario's end.
pub(crate) fn is_recorded_to_its_end(timeline: &Timeline, one: &ControlLoop) -> bool {
    let is_sound = one.scenario.faults.is_empty();
    let tolerance = match is_sound {
        true => END_PERIODS * timeline.period_seconds,
        false => FAULTY_END_SECONDS,
    };
    timeline.zero_seconds.is_some()
        && timeline.last_frame_seconds + tolerance >= one.scenario.duration_seconds
}

/// The stalls in the time of the timeline.
fn stretches(timeline: &Timeline, stalls: &[Stall]) -> Vec<Stretch> {
    // Where the scenario never began, times are those of the recording.
    let zero = timeline.zero_seconds.unwrap_or_default();
    // Both are whole microseconds since 1970, which seconds in an f64 do not hold.
    #[expect(
        clippy::cast_precision_loss,
        reason = "microseconds since 1970 stay below 2^52"
    )]
    let since_zero = |time: Duration| (time.as_micros() as f64 - (1e6 * zero).round()) / 1e6;
    let stretch = |stall: &Stall| Stretch {
        from_seconds: since_zero(stall.from),
        until_seconds: since_zero(stall.until),
        stall: *stall,
    };
    stalls.iter().map(stretch).collect()
}

/// The longest stall of those that fill at least half of the time in which a node was amiss, or in which it was to be heard
/// again: then the end of the run says nothing of the node.
pub(crate) fn excuse_of_end(
    timeline: &Timeline,
    stalls: &[Stall],
    end: &EarlyEnd,
) -> Option<Stretch> {
    let until = end.at_seconds?;
    let mut stretches = stretches(timeline, stalls);
    stretches.sort_by(|left, right| left.from_seconds.total_cmp(&right.from_seconds));
    let period_seconds = timeline.period_seconds;
    let since = match end.since_seconds {
        Some(since) => sent_seconds(&stretches, since, until, period_seconds),
        None => until,
    };
    [since, until - HEARD_SECONDS]
        .into_iter()
        .find_map(|from| longest_of_half(&stretches, from, until))
}

/// When what came last of a silent node was sent. What a stall held up comes all at once behind it: of frames between which there
/// is no more than that, the stamps say nothing of a silence.
fn sent_seconds(stretches: &[Stretch], came: f64, until: f64, period_seconds: f64) -> f64 {
    let held_up = |stretch: &&Stretch| {
        stretch.length() >= SILENT_PERIODS * period_seconds
            && stretch.from_seconds <= came
            && until <= stretch.until_seconds + BURST_PERIODS * period_seconds
    };
    let stall = stretches.iter().find(held_up);
    stall.map_or(came, |stall| stall.from_seconds)
}

/// The longest of the stalls, sorted by their begins, that overlap a stretch, if together they fill at least half of it.
fn longest_of_half(stretches: &[Stretch], from: f64, until: f64) -> Option<Stretch> {
    let overlaps =
        |stretch: &&Stretch| stretch.until_seconds > from && stretch.from_seconds < until;
    let mut reached = from;
    let mut covered = 0.0;
    for stretch in stretches.iter().filter(overlaps) {
        let begins = stretch.from_seconds.max(reached);
        let ends = stretch.until_seconds.min(until);
        covered += f64::max(ends - begins, 0.0);
        reached = reached.max(ends);
    }
    let is_filled = covered > 0.0 && covered >= (until - from) / 2.0;
    let longest = stretches.iter().filter(overlaps);
    longest
        .max_by(|left, right| left.length().total_cmp(&right.length()))
        .filter(|_| is_filled)
        .copied()
}

#[cfg(test)]
mod tests;
