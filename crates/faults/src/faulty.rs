//! Node that fails as planned.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use dbc::scenario_clock::ScenarioClock;

use crate::plan::{FaultPlan, PlannedFault};

/// Largest number of frames that a hanging node's CAN controller and driver keep for it (assumed).
const RECEIVE_FRAMES_MAX: usize = 32;

const NANOSECONDS_PER_SECOND: f64 = 1e9;

/// Operating condition of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Condition {
    Working,
    Hanging,
    Dead(Output),
}

const SWITCHED_OFF: Condition = Condition::Dead(Output::Off);

/// Output of a dead drive's amplifier.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Output {
    /// The amplifier keeps its last command.
    Held,
    /// The amplifier is switched off.
    Off,
}

/// Effects of all faults on a node at a time.
#[derive(Default)]
struct Effects {
    crash: Option<Output>,
    is_hanging: bool,
    delay: Duration,
    drift: f64,
    loses_heartbeat: bool,
}

/// Function that puts a node in its state after power-on.
type Renew<N> = Box<dyn FnMut(&mut N) + Send>;

/// Node in a scenario with faults. It never fails as a whole: a node that gives up has gone to its safe state, and the run
/// continues to show that it stays there.
pub struct Faulty<N> {
    node: N,
    renew: Renew<N>,
    plan: FaultPlan,
    scenario: ScenarioClock,
    now: Duration,
    /// Latest time up to which the plan was followed.
    followed: Option<Duration>,
    condition: Condition,
    clock: NodeClock,
    inbox: Vec<CanFrame>,
    outbox: VecDeque<(Duration, CanFrame)>,
    is_stop_asked: bool,
}

impl<N: fmt::Debug> fmt::Debug for Faulty<N> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = formatter.debug_struct("Faulty");
        text.field("node", &self.node).field("plan", &self.plan);
        text.finish_non_exhaustive()
    }
}

impl<N: Node> Faulty<N> {
    /// Makes a node before its power-on, with the function that renews it. Faults come by a clock of scenario time.
    pub fn new(
        node: N,
        plan: FaultPlan,
        scenario: ScenarioClock,
        renew: impl FnMut(&mut N) + Send + 'static,
    ) -> Self {
        Self {
            node,
            renew: Box::new(renew),
            scenario,
            now: Duration::ZERO,
            followed: None,
            condition: if plan.late_boot > Duration::ZERO {
                SWITCHED_OFF
            } else {
                Condition::Working
            },
            plan,
            clock: NodeClock::default(),
            inbox: Vec::new(),
            outbox: VecDeque::new(),
            is_stop_asked: false,
        }
    }

    /// Returns the node itself.
    pub fn node(&self) -> &N {
        &self.node
    }

    /// Returns the node itself.
    pub fn node_mut(&mut self) -> &mut N {
        &mut self.node
    }

    /// Takes a frame of another node on the same CAN controller, which does not receive it: scenario time follows from the
    /// statuswords of all drives.
    pub fn overhear(&mut self, frame: &CanFrame) {
        self.scenario.on_frame(self.now, frame);
    }

    /// Returns the start of the scenario.
    pub fn scenario_zero(&self) -> Option<Duration> {
        self.scenario.zero()
    }

    /// Checks whether it is dead, and its drive's amplifier is switched off.
    pub fn is_switched_off(&self) -> bool {
        self.condition == SWITCHED_OFF
    }

    /// Follows the plan to `now`.
    fn follow(&mut self, now: Duration) {
        self.now = now;
        let before = self.scenario_time(self.followed);
        let time = self.scenario_time(Some(now));
        self.followed = Some(now);
        let effects = self.effects(time);
        self.clock.set_rate(now, effects.drift);
        let has_restarted = self.plan.faults.iter().any(|fault| {
            let is_new = before.is_none_or(|before| before < fault.from);
            fault.name() == "restart" && is_new && time.is_some_and(|time| time >= fault.from)
        });
        let condition = match effects.crash {
            _ if now < self.plan.late_boot => SWITCHED_OFF,
            Some(output) => Condition::Dead(output),
            None if effects.is_hanging => Condition::Hanging,
            None => Condition::Working,
        };
        let was = std::mem::replace(&mut self.condition, condition);
        match (was, condition) {
            (Condition::Dead(_), Condition::Dead(_)) => {}
            (_, Condition::Dead(_)) => self.forget(),
            (Condition::Dead(_), _) => (self.renew)(&mut self.node),
            (Condition::Hanging, Condition::Working) => self.wake_up(),
            _ if has_restarted => {
                self.forget();
                (self.renew)(&mut self.node);
            }
            _ => {}
        }
    }

    /// Discards the frames that it had to send and those that it had not received yet.
    fn forget(&mut self) {
        self.outbox.clear();
        self.inbox.clear();
    }

    /// Continues after a hang: receives the frames that were kept for it.
    fn wake_up(&mut self) {
        let time = self.clock.node_time(self.now);
        for frame in std::mem::take(&mut self.inbox) {
            self.node.on_frame(time, &frame);
            self.collect();
        }
    }

    fn scenario_time(&self, now: Option<Duration>) -> Option<Duration> {
        now?.checked_sub(self.scenario.zero()?)
    }

    /// Returns what the faults do to the node at a scenario time.
    fn effects(&self, time: Option<Duration>) -> Effects {
        let mut effects = Effects::default();
        let acts = |fault: &&PlannedFault| time.is_some_and(|time| fault.acts_at(time));
        for planned in self.plan.faults.iter().filter(acts) {
            let fault = &planned.fault;
            match planned.name() {
                "crash" => {
                    let is_held = fault.says("output", "hold");
                    let output = if is_held { Output::Held } else { Output::Off };
                    effects.crash = effects.crash.or(Some(output));
                }
                "hang" => effects.is_hanging = true,
                "slow_cycle" => {
                    let seconds = fault.number("delay_milliseconds") * 1e-3;
                    effects.delay += Duration::from_secs_f64(seconds);
                }
                "clock_drift" => effects.drift += fault.number("parts_per_million") * 1e-6,
                "lost_heartbeat" => effects.loses_heartbeat = true,
                _ => {}
            }
        }
        effects
    }

    /// Returns the next time at which a fault of the plan begins or ends.
    fn next_change(&self) -> Option<Duration> {
        let followed = self.followed.unwrap_or_default();
        let boot = Some(self.plan.late_boot).filter(|boot| *boot > followed);
        let zero = self.scenario.zero();
        let planned = self.plan.faults.iter();
        let edges = planned.flat_map(|fault| [fault.from, fault.until]);
        let changes = edges.filter_map(|change| zero?.checked_add(change));
        changes
            .filter(|change| *change > followed)
            .chain(boot)
            .min()
    }

    /// Collects the frames that the node sends.
    fn collect(&mut self) {
        let effects = self.effects(self.scenario_time(Some(self.now)));
        let heartbeat = 0x700 + u16::from(self.plan.number);
        while let Some(frame) = self.node.next_frame() {
            if effects.loses_heartbeat && frame.standard_id() == Some(heartbeat) {
                continue;
            }
            self.scenario.on_frame(self.now, &frame);
            self.outbox.push_back((self.now + effects.delay, frame));
        }
    }

    fn tick(&mut self) {
        let time = self.clock.node_time(self.now);
        let is_due = |deadline| deadline <= time;
        if self.condition == Condition::Working && self.node.next_deadline().is_some_and(is_due) {
            self.node.on_tick(time);
            self.collect();
        }
    }
}

impl<N: Node> Node for Faulty<N> {
    fn filters(&self) -> Vec<Filter> {
        let mut filters = self.node.filters();
        // Scenario time follows from SYNC and statusword.
        filters.extend(self.scenario.filters());
        filters.sort_unstable_by_key(|filter| (filter.id, filter.mask));
        filters.dedup();
        filters
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.follow(now);
        self.scenario.on_frame(now, frame);
        match self.condition {
            Condition::Dead(_) => {}
            Condition::Hanging => {
                if self.inbox.len() < RECEIVE_FRAMES_MAX {
                    self.inbox.push(*frame);
                }
            }
            Condition::Working => {
                self.node.on_frame(self.clock.node_time(now), frame);
                self.collect();
            }
        }
        // The frame may have begun the scenario.
        self.follow(now);
    }

    fn on_tick(&mut self, now: Duration) {
        self.follow(now);
        self.tick();
        self.follow(now);
    }

    fn on_stop(&mut self, now: Duration) {
        self.follow(now);
        self.is_stop_asked = true;
        if self.condition == Condition::Working {
            self.node.on_stop(self.clock.node_time(now));
            self.collect();
        }
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        let (_, frame) = self
            .outbox
            .pop_front_if(|(leaves, _)| *leaves <= self.now)?;
        Some(frame)
    }

    fn next_deadline(&self) -> Option<Duration> {
        let node_deadline = match self.condition {
            Condition::Working => self.node.next_deadline(),
            _ => None,
        };
        let deadline = node_deadline.map(|deadline| self.clock.true_time(deadline));
        let leaves = self.outbox.front().map(|(leaves, _)| *leaves);
        [deadline, leaves, self.next_change()]
            .into_iter()
            .flatten()
            .min()
    }

    fn progress(&self) -> Progress {
        let is_over = match (self.condition, self.node.progress()) {
            (Condition::Working, Progress::Running) => false,
            _ => self.is_stop_asked,
        };
        if is_over && self.outbox.is_empty() {
            Progress::Stopped
        } else {
            Progress::Running
        }
    }
}

/// Clock that may run fast or slow.
#[derive(Clone, Copy, Debug, Default)]
struct NodeClock {
    /// Point of the last change of the rate: true time and the node's.
    anchor: (Duration, Duration),
    rate: f64,
}

impl NodeClock {
    fn set_rate(&mut self, now: Duration, rate: f64) {
        if rate != self.rate {
            self.anchor = (now, self.node_time(now));
            self.rate = rate;
        }
    }

    fn node_time(&self, now: Duration) -> Duration {
        let (true_anchor, node_anchor) = self.anchor;
        let elapsed = now.saturating_sub(true_anchor);
        node_anchor + scaled(elapsed, 1.0 + self.rate)
    }

    /// Returns the first true time at which the node's clock has reached a time.
    fn true_time(&self, node_time: Duration) -> Duration {
        let (true_anchor, node_anchor) = self.anchor;
        let elapsed = node_time.saturating_sub(node_anchor);
        let mut time = true_anchor + scaled(elapsed, 1.0 / (1.0 + self.rate));
        // Rounding may leave it just short of it.
        while self.node_time(time) < node_time {
            time += Duration::from_nanos(1);
        }
        time
    }
}

/// Scales a time by a factor; exact for the factor 1.
fn scaled(time: Duration, factor: f64) -> Duration {
    if factor == 1.0 {
        return time;
    }
    let seconds = time.as_secs_f64() * factor;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "never negative, and a run lasts far below 2^63 ns"
    )]
    let nanoseconds = libm::round(seconds * NANOSECONDS_PER_SECOND) as u64;
    Duration::from_nanos(nanoseconds)
}

#[cfg(test)]
mod tests;
