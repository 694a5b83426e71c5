//! Bus load from the first SYNC to the end of the judged time.

use std::time::Duration;

use can::CanFrame;
use dbc::scenario_clock::SYNC_COB_ID;
use scenario::Trial;

/// Counter of the bits of all frames and of the time between SYNCs.
#[derive(Clone)]
pub(super) struct Traffic {
    bitrate_kilobits_per_second: f64,
    first_sync: Option<Duration>,
    latest_sync: Option<Duration>,
    latest: Duration,
    sync_interval_max: Option<Duration>,
    bits: u64,
}

impl Traffic {
    pub(super) fn new(trial: &Trial) -> Self {
        Self {
            bitrate_kilobits_per_second: f64::from(trial.run.bus.bitrate_kilobits_per_second),
            first_sync: None,
            latest_sync: None,
            latest: Duration::ZERO,
            sync_interval_max: None,
            bits: 0,
        }
    }

    pub(super) fn on_frame(&mut self, frame: &CanFrame, now: Duration, occupied_bits: u32) {
        if self.first_sync.is_some() {
            self.bits += u64::from(occupied_bits);
        }
        self.latest = now;
        if frame.standard_id() == Some(SYNC_COB_ID) {
            self.first_sync.get_or_insert(now);
            if let Some(before) = self.latest_sync.replace(now) {
                let interval = now.saturating_sub(before);
                self.sync_interval_max = self.sync_interval_max.max(Some(interval));
            }
        }
    }

    /// Returns NaN before there are two frames from the first SYNC on.
    pub(super) fn load_percent(&self) -> f64 {
        let Some(first) = self.first_sync else {
            return f64::NAN;
        };
        #[expect(clippy::cast_precision_loss, reason = "bit counts stay far below 2^52")]
        let milliseconds = self.bits as f64 / self.bitrate_kilobits_per_second;
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
