//! Stalls of the machine, the bus or one of canrig's nodes by the host, in scenario time, and the breaches that they explain.

use std::time::Duration;

use plan::ControlLoop;
use recording::latency::Host;
use recording::stalls::{Stall, Who};
use recording::timeline::{TIME_TOLERANCE_SECONDS, Timeline};
use scenario::node::Part;

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

/// Returns the longest stall if stalls cover more of the run than is trusted and a node that canrig did not start stands still
/// with the machine: whether its process could run is not known.
pub(super) fn undecided(
    node: Part,
    stretches: &[Stretch],
    one: &ControlLoop,
    host: &Host,
) -> Option<Stretch> {
    let name = &one.nodes.of(node)?.name;
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
}

impl FeltStalls {
    /// Selects the stalls that a node feels. Only processes that canrig started are watched, and their stalls do not explain an
    /// external node.
    pub(super) fn of(
        node: Part,
        stretches: &[Stretch],
        one: &ControlLoop,
        period_seconds: f64,
    ) -> Self {
        let is_felt = |stretch: &&Stretch| match (stretch.stall.who, node) {
            (Who::Machine | Who::Bus, _) | (Who::Controller, Part::Controller) => true,
            (Who::PlantEmulator, Part::Controller) => false,
            (Who::Controller | Who::PlantEmulator, _) => one.is_ours(Part::Drive),
        };
        let mut felt: Vec<Stretch> = stretches.iter().filter(is_felt).copied().collect();
        felt.sort_by(|left, right| left.until_seconds.total_cmp(&right.until_seconds));
        let burst_seconds = BURST_PERIODS * period_seconds;
        let longest = felt.iter().map(Stretch::length).fold(0.0, f64::max);
        let spans = felt
            .iter()
            .map(|stretch| (stretch.from_seconds, stretch.until_seconds + burst_seconds));
        Self {
            covered: Spans::of(spans.collect()),
            longest_seconds: longest + burst_seconds,
            stretches: felt,
            burst_seconds,
        }
    }

    /// Returns the longest of the stalls that, with the bursts after them, together cover half of a stretch of time.
    pub(super) fn explaining(&self, from: f64, until: f64) -> Option<Stretch> {
        let is_covered =
            self.covered.seconds_in(from, until) + TIME_TOLERANCE_SECONDS >= (until - from) / 2.0;
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
