//! What is read from all frames, whatever they are: time, order, and how busy the bus was.

use std::time::Duration;

use dbc::SignalMissing;
use dbc::scenario_clock::ScenarioClock;
use plan::ControlLoop;

use super::traffic::Traffic;
use crate::log::STEP_MAX;
use crate::log::Stamped;

/// Looks at every frame once, also where several loops read them.
#[derive(Clone)]
pub(super) struct Passing {
    pub(super) clock: ScenarioClock,
    /// Time ran backwards by more than a clock is ever stepped in a run.
    pub(super) is_order_lost: bool,
    pub(super) traffic: Traffic,
    /// When the first frame came, on the recording's clock.
    pub(super) first_frame: Option<Duration>,
    /// When the last frame came, on the recording's clock.
    pub(super) last_frame: Duration,
    /// The latest time of any frame, on the recording's clock.
    highest: Duration,
    /// Scenario time of the last one before the scenario's end.
    pub(super) latest: Duration,
    end: Duration,
    /// What the traffic is judged on ends here.
    judged_end: Duration,
}

/// A frame's place in scenario time.
#[derive(Clone, Copy)]
pub(super) struct Passed {
    /// None before the scenario began.
    pub(super) time: Option<Duration>,
    /// It is a SYNC of the scenario.
    pub(super) is_sync: bool,
}

impl Passing {
    pub(super) fn new(one: &ControlLoop) -> Result<Self, SignalMissing> {
        let scenario = &one.trial;
        Ok(Self {
            clock: one.scenario_clock()?,
            is_order_lost: false,
            traffic: Traffic::new(scenario),
            first_frame: None,
            last_frame: Duration::ZERO,
            highest: Duration::ZERO,
            latest: Duration::ZERO,
            end: Duration::from_secs_f64(scenario.run.duration_seconds),
            judged_end: Duration::from_secs_f64(scenario.judged_end_seconds()),
        })
    }

    /// Whether another loop's sees the same. On one bus only what is judged may end at other times.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.judged_end == other.judged_end
    }

    #[inline]
    pub(super) fn on_frame(&mut self, stamped: &Stamped) -> Passed {
        let is_sync = self.clock.on_frame(stamped.time, &stamped.frame);
        let time = self.clock.scenario_time(stamped.time);
        self.first_frame.get_or_insert(stamped.time);
        self.highest = self.highest.max(stamped.time);
        self.is_order_lost |= self.highest - stamped.time > STEP_MAX;
        self.last_frame = stamped.time;
        if let Some(time) = time.filter(|time| *time <= self.end) {
            self.latest = time;
        }
        if time.is_none_or(|time| time < self.judged_end) {
            let bits = stamped.occupied_bits;
            self.traffic.on_frame(&stamped.frame, stamped.time, bits);
        }
        Passed { time, is_sync }
    }
}
