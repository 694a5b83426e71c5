//! Stalls of the machine, the bus or one of canrig's nodes by the host, in scenario time, and the breaches that they explain.

use std::time::Duration;

use plan::ControlLoop;
use recording::latency::Host;
use recording::stalls::{Stall, Who};
use recording::timeline::{TIME_TOLERANCE_SECONDS, Timeline};
use scenario::node::NodeIndex;

use crate::timing::distrusted_percent;

/// Longest time, in periods, after a stall until the frames that it held up have come.
const BURST_PERIODS: f64 = 2.0;
/// Least length of a stall that moves the loop, in periods and in seconds.
const LONG_PERIODS: f64 = 5.0;
const LONG_SECONDS: f64 = 0.01;
/// Time that a loop needs to calm down after such a stall: a fixed time, and a multiple of the length of the stall.
const CALM_SECONDS: f64 = 0.5;
const CALM_LENGTHS: f64 = 20.0;

/// Stall in scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stretch {
    pub(crate) from_seconds: f64,
    pub(crate) until_seconds: f64,
    pub(crate) stall: Stall,
}

impl Stretch {
    pub(crate) fn length(&self) -> f64 {
        self.until_seconds - self.from_seconds
    }

    /// Describes the stall: `the machine stood still for 45.0 ms at 1.234 s`.
    pub(crate) fn description(&self) -> String {
        format!("{} at {:.3} s", self.stall, self.from_seconds)
    }

    /// Returns whether the stall moves the loop.
    fn is_long(&self, period_seconds: f64) -> bool {
        let long_seconds = LONG_SECONDS.max(LONG_PERIODS * period_seconds);
        self.length() + TIME_TOLERANCE_SECONDS >= long_seconds
    }

    /// Returns the end of its effect on the motion.
    fn calm_seconds(&self, period_seconds: f64) -> f64 {
        if self.is_long(period_seconds) {
            self.until_seconds + CALM_SECONDS + CALM_LENGTHS * self.length()
        } else {
            self.until_seconds
        }
    }
}

/// Returns the longest of some stalls; the last of several.
pub(crate) fn longest<'a>(stretches: impl IntoIterator<Item = &'a Stretch>) -> Option<Stretch> {
    let stretches = stretches.into_iter().copied();
    stretches.max_by(|left, right| left.length().total_cmp(&right.length()))
}

/// Returns the stalls of a run in the time of its timeline.
pub(super) fn stretches(timeline: &Timeline, stalls: &[Stall]) -> Vec<Stretch> {
    // Both times are whole microseconds since 1970. Seconds in an f64 would lose them.
    let since_origin =
        |time: Duration| (time.as_micros() as f64 - (1e6 * timeline.origin_seconds).round()) / 1e6;
    let stretch = |stall: &Stall| Stretch {
        from_seconds: since_origin(stall.from),
        until_seconds: since_origin(stall.until),
        stall: *stall,
    };
    stalls.iter().map(stretch).collect()
}

/// Returns the longest stall if stalls cover more of the run than is trusted and a node that canrig
/// did not start stands still with the machine: whether its process could run is not known.
pub(super) fn undecided(
    node: NodeIndex,
    stretches: &[Stretch],
    one: &ControlLoop,
    host: &Host,
) -> Option<Stretch> {
    let name = &one.node(node).name;
    let duration = Duration::from_secs_f64(one.trial.run.duration_seconds);
    let is_distrusted = || distrusted_percent(&host.stalls, duration).is_some();
    let is_open = host.on_this_machine.contains(name) && is_distrusted();
    longest(stretches).filter(|_| is_open)
}

/// Stalls that a node feels.
#[derive(Clone, Debug)]
pub(super) struct FeltStalls {
    /// Stalls in the order of their ends.
    stretches: Vec<Stretch>,
    /// Length of the longest stall, including the burst after it. A stall that ends later than that after a breach does not cover
    /// the breach.
    longest_seconds: f64,
    burst_seconds: f64,
    /// Times that the stalls cover together, including the bursts after them.
    covered: Spans,
    /// Times of the stalls themselves.
    held: Spans,
    /// Times in which the node could not run for as long as a period, including the burst at their
    /// end.
    standing: Spans,
    period_seconds: f64,
}

impl FeltStalls {
    /// Selects the stalls that a node feels: those of the machine and the bus, and those of its own
    /// process. The stalls of canrig's emulators do not explain a node that canrig does not play.
    pub(super) fn of(
        node: NodeIndex,
        stretches: &[Stretch],
        one: &ControlLoop,
        period_seconds: f64,
    ) -> Self {
        let is_controller = node == one.controller_index();
        let is_felt = |stretch: &&Stretch| match (stretch.stall.who, is_controller) {
            (Who::Machine | Who::Bus, _) | (Who::Controller, true) => true,
            (Who::PlantEmulator, true) => false,
            (Who::Controller | Who::PlantEmulator, false) => one.drive().is_ours(),
            (Who::Node(_), _) => stretch.stall.who.is_node(&one.node(node).name),
        };
        let mut felt: Vec<Stretch> = stretches.iter().filter(is_felt).copied().collect();
        felt.sort_by(|left, right| left.until_seconds.total_cmp(&right.until_seconds));
        let burst_seconds = BURST_PERIODS * period_seconds;
        let longest = felt.iter().map(Stretch::length).fold(0.0, f64::max);
        let spans = |longer: f64| {
            let spans = felt.iter();
            let spans = spans.map(|one| (one.from_seconds, one.until_seconds + longer));
            Spans::of(spans.collect())
        };
        let gap_max = period_seconds - TIME_TOLERANCE_SECONDS;
        let standing = spans(gap_max).longer(burst_seconds - gap_max);
        Self {
            covered: spans(burst_seconds),
            held: spans(0.0),
            standing,
            period_seconds,
            longest_seconds: longest + burst_seconds,
            stretches: felt,
            burst_seconds,
        }
    }

    /// Returns the longest of the stalls that, with the bursts after them, together cover half of a
    /// stretch of time. A node that ran for a period between two of them owed its frames again, so
    /// a silence must be covered without such a gap.
    pub(super) fn explaining(&self, from: f64, until: f64) -> Option<Stretch> {
        let half = (until - from) / 2.0 - TIME_TOLERANCE_SECONDS;
        let is_covered = if until - from > self.burst_seconds + TIME_TOLERANCE_SECONDS {
            self.standing.longest_in(from, until) >= half
        } else {
            self.covered.seconds_in(from, until) >= half
        };
        let ends_before = |stretch: &Stretch| {
            stretch.until_seconds + self.burst_seconds < from - TIME_TOLERANCE_SECONDS
        };
        let first = self.stretches.partition_point(ends_before);
        let may_overlap =
            |stretch: &&Stretch| stretch.until_seconds <= until + self.longest_seconds;
        let candidates = self.stretches[first..].iter().take_while(may_overlap);
        let overlaps = |stretch: &&Stretch| stretch.from_seconds <= until + TIME_TOLERANCE_SECONDS;
        longest(candidates.filter(|stretch| is_covered && overlaps(stretch)))
    }
}

/// Allowance of stalls for the missing frames of one duty: each explains as many as were due in it.
pub(super) struct Allowance<'a> {
    felt: &'a FeltStalls,
    /// Place of the first stall that may explain a later frame, and the number of frames that it
    /// has explained.
    place: usize,
    explained: u64,
}

impl<'a> Allowance<'a> {
    pub(super) fn of(felt: &'a FeltStalls) -> Self {
        Self {
            felt,
            place: 0,
            explained: 0,
        }
    }

    /// Returns the stall that explains a missing frame, as [`FeltStalls::explaining`]. The frames
    /// come in the order of time.
    pub(super) fn explaining(&mut self, from: f64, until: f64) -> Option<Stretch> {
        let stretch = self.felt.explaining(from, until)?;
        let burst = self.felt.burst_seconds + TIME_TOLERANCE_SECONDS;
        let held = &self.felt.held.0;
        while let Some((begins, ends)) = held.get(self.place) {
            if *begins > until + TIME_TOLERANCE_SECONDS {
                break;
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a positive number of periods"
            )]
            let due =
                1 + ((ends - begins) / self.felt.period_seconds + TIME_TOLERANCE_SECONDS) as u64;
            if ends + burst >= from && self.explained < due {
                self.explained += 1;
                return Some(stretch);
            }
            (self.place, self.explained) = (self.place + 1, 0);
        }
        None
    }
}

/// Spans of time that do not overlap, in their order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spans(Vec<(f64, f64)>);

impl Spans {
    pub(crate) fn of(mut spans: Vec<(f64, f64)>) -> Self {
        spans.sort_by(|left, right| left.0.total_cmp(&right.0));
        let mut joined: Vec<(f64, f64)> = Vec::new();
        for (from, until) in spans {
            match joined.last_mut() {
                Some((_, reached)) if from <= *reached => *reached = reached.max(until),
                _ => joined.push((from, until)),
            }
        }
        Self(joined)
    }

    /// Returns the spans that touch a stretch of time.
    fn touching(&self, from: f64, until: f64) -> impl Iterator<Item = &(f64, f64)> {
        let first = self
            .0
            .partition_point(|(_, ends)| *ends < from - TIME_TOLERANCE_SECONDS);
        let begins_in = move |span: &&(f64, f64)| span.0 <= until + TIME_TOLERANCE_SECONDS;
        self.0[first..].iter().take_while(begins_in)
    }

    /// Returns the begin of the first span that touches a stretch of time.
    pub(crate) fn first_in(&self, from: f64, until: f64) -> Option<f64> {
        self.touching(from, until).next().map(|(begins, _)| *begins)
    }

    /// Returns the spans, each with a later end.
    fn longer(self, seconds: f64) -> Self {
        let spans = self.0.into_iter();
        Self(spans.map(|(from, until)| (from, until + seconds)).collect())
    }

    /// Returns the longest part of a stretch of time that one of the spans covers, in seconds.
    fn longest_in(&self, from: f64, until: f64) -> f64 {
        // With later ends, the spans overlap: their ends are in order, too.
        let covered = self
            .touching(from, until)
            .map(|(begins, ends)| ends.min(until) - begins.max(from));
        covered.fold(0.0, f64::max)
    }

    /// Returns how many seconds of a stretch of time the spans cover.
    pub(crate) fn seconds_in(&self, from: f64, until: f64) -> f64 {
        let covered = self
            .touching(from, until)
            .map(|(begins, ends)| ends.min(until) - begins.max(from));
        covered.map(|seconds| seconds.max(0.0)).sum()
    }
}

/// Returns the times in which these stalls, or only the long ones, distort the motion of the nodes.
pub(crate) fn shadows(stretches: &[Stretch], period_seconds: f64, only_long: bool) -> Spans {
    let cast = stretches
        .iter()
        .filter(|one| !only_long || one.is_long(period_seconds));
    let shadow = |one: &Stretch| (one.from_seconds, one.calm_seconds(period_seconds));
    Spans::of(cast.map(shadow).collect())
}
