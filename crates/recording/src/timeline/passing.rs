//! Properties of all frames: time, order, and bus load.

use std::time::Duration;

use dbc::SignalMissing;
use dbc::scenario_clock::ScenarioClock;
use plan::ControlLoop;

use super::traffic::Traffic;
use crate::log::STEP_MAX;
use crate::log::Stamped;

/// Reader that looks at every frame once, even if several loops read them.
#[derive(Clone)]
pub(super) struct Passing {
    pub(super) clock: ScenarioClock,
    /// Whether time ran backwards by more than a clock is ever stepped in a run.
    pub(super) is_order_lost: bool,
    pub(super) traffic: Traffic,
    /// Time of the first frame, on the recording's clock.
    pub(super) first_frame: Option<Duration>,
    /// Time of the last frame, on the recording's clock.
    pub(super) last_frame: Duration,
    /// Latest time of any frame, on the recording's clock.
    highest: Duration,
    /// Scenario time of the last frame before the scenario's end.
    pub(super) latest: Duration,
    end: Duration,
    /// End of the time for which the traffic is judged.
    judged_end: Duration,
}

/// Place of a frame in scenario time.
#[derive(Clone, Copy)]
pub(super) struct Passed {
    /// Scenario time; `None` before its beginning.
    pub(super) time: Option<Duration>,
    /// Whether it is a SYNC of the scenario.
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

    /// Returns whether another loop's reader sees the same. On one bus only the ends of the judged time may differ.
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
