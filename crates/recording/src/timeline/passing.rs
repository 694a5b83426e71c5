//! Properties of all frames: time and order, and the bus load of the judged time.

use std::sync::Arc;
use std::time::Duration;

use dbc::SignalMissing;
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use plan::Plan;

use super::floods::FloodReader;
use crate::log::STEP_MAX;
use crate::log::Stamped;

/// Reader that looks at every frame once, whatever the number of loops.
pub(super) struct Passing {
    pub(super) clock: ScenarioClock,
    /// Whether time ran backwards by more than a clock is ever stepped in a run.
    pub(super) is_order_lost: bool,
    /// Time of the first frame, on the recording's clock.
    pub(super) first_frame: Option<Duration>,
    /// Time of the last frame, on the recording's clock.
    pub(super) last_frame: Duration,
    /// Latest time of any frame, on the recording's clock.
    highest: Duration,
    /// Scenario time of the last frame before the scenario's end.
    pub(super) latest: Duration,
    /// End of the scenario.
    end: Duration,
    pub(super) traffic: Traffic,
}

/// Number of the bits of all frames from the first SYNC to the end of the judged time, and the times of the SYNCs.
#[derive(Default)]
pub(super) struct Traffic {
    judged_end: Duration,
    first_sync: Option<Duration>,
    latest_sync: Option<Duration>,
    latest: Duration,
    sync_interval_max: Option<Duration>,
    bits: u64,
    floods: FloodReader,
}

impl Passing {
    pub(super) fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        Ok(Self {
            clock: plan.scenario_clock()?,
            is_order_lost: false,
            first_frame: None,
            last_frame: Duration::ZERO,
            highest: Duration::ZERO,
            latest: Duration::ZERO,
            end: plan.duration(),
            traffic: Traffic::new(plan),
        })
    }

    /// Takes each frame of the bus; returns its scenario time, `None` before the scenario began.
    // It is called for each frame, and a call would cost a third of its work.
    #[inline(always)]
    pub(super) fn on_frame(&mut self, stamped: &Stamped) -> Option<Duration> {
        self.clock.on_frame(stamped.time, &stamped.frame);
        let time = self.clock.scenario_time(stamped.time);
        self.first_frame.get_or_insert(stamped.time);
        if stamped.time < self.highest {
            self.is_order_lost |= self.highest - stamped.time > STEP_MAX;
        }
        self.highest = self.highest.max(stamped.time);
        self.last_frame = stamped.time;
        if let Some(time) = time.filter(|time| *time <= self.end) {
            self.latest = time;
        }
        time
    }
}

impl Traffic {
    fn new(plan: &Plan) -> Self {
        // The bus is judged for as long as one of the loops.
        let ends = plan.loops.iter().map(|one| one.trial.judged_end_seconds());
        Self {
            judged_end: Duration::from_secs_f64(ends.fold(0.0, f64::max)),
            floods: FloodReader::new(plan.shared.run.bus.bitrate_kilobits_per_second),
            ..Self::default()
        }
    }

    /// Takes each frame of the bus with its scenario time.
    #[inline]
    pub(super) fn on_frame(&mut self, stamped: &Stamped, time: Option<Duration>) {
        if time.is_some_and(|time| time >= self.judged_end) {
            return;
        }
        let now = stamped.time;
        if self.first_sync.is_some() {
            self.bits += u64::from(stamped.occupied_bits);
        }
        self.latest = now;
        if stamped.frame.standard_id() == Some(SYNC_COB_ID) {
            self.first_sync.get_or_insert(now);
            if let Some(before) = self.latest_sync.replace(now) {
                let interval = now.saturating_sub(before);
                self.sync_interval_max = self.sync_interval_max.max(Some(interval));
            }
        }
    }

    /// Takes a frame that no loop reads.
    #[cold]
    pub(super) fn on_unknown(&mut self, stamped: &Stamped, time: Duration) {
        if time >= self.judged_end || can::error_frames::read(&stamped.frame).is_some() {
            return;
        }
        self.floods.on_frame(time, stamped.occupied_bits);
    }

    /// Returns the stretches of scenario time in which frames that no loop reads keep the nodes of the run from the bus.
    pub(super) fn floods(&self) -> Arc<[(f64, f64)]> {
        self.floods.found().into()
    }

    /// Returns NaN before there are two frames from the first SYNC on.
    pub(super) fn load_percent(&self, bitrate_kilobits_per_second: u32) -> f64 {
        let milliseconds = self.bits as f64 / f64::from(bitrate_kilobits_per_second);
        let first = self.first_sync.unwrap_or(self.latest);
        let recorded = 1e3 * self.latest.saturating_sub(first).as_secs_f64();
        if recorded > 0.0 {
            100.0 * milliseconds / recorded
        } else {
            f64::NAN
        }
    }

    /// Returns NaN before there are two SYNCs.
    pub(super) fn sync_interval_milliseconds_max(&self) -> f64 {
        self.sync_interval_max
            .map_or(f64::NAN, |interval| 1e3 * interval.as_secs_f64())
    }
}
