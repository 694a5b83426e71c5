//! Scenario time, computed from frames alone.

use std::time::Duration;

use crate::{Database, SignalHandle, SignalMissing};
use canopen::CanFrame;

/// COB-ID of the SYNC (CiA 301, default of 0x1005).
pub const SYNC_COB_ID: u16 = 0x080;

/// The drive's state in which current flows, as the DBC's value table has it.
const OPERATION_ENABLED: &str = "operation enabled";

/// State bits of the drive's statusword.
pub const STATUSWORD: &str = "drive_tpdo1.statusword_state";

/// Watches the bus for scenario time 0: the first SYNC after the drive reported Operation Enabled.
#[derive(Clone, Debug)]
pub struct ScenarioClock {
    statusword: SignalHandle,
    enabled_values: Vec<i64>,
    is_enabled: bool,
    zero: Option<Duration>,
}

impl ScenarioClock {
    /// A clock that has not begun.
    ///
    /// # Errors
    /// The database has no statusword of the drive.
    pub fn new(database: &Database) -> Result<Self, SignalMissing> {
        let statusword = database.require(STATUSWORD)?;
        let definition = database.definition(STATUSWORD);
        let labels = definition.into_iter().flat_map(|signal| &signal.labels);
        let enabled_values = labels
            .filter(|(_, label)| label == OPERATION_ENABLED)
            .map(|(value, _)| *value)
            .collect();
        Ok(Self {
            statusword,
            enabled_values,
            is_enabled: false,
            zero: None,
        })
    }

    /// Reads every frame of the bus, in order; `true` when it is a SYNC of the scenario.
    #[inline]
    pub fn on_frame(&mut self, time: Duration, frame: &CanFrame) -> bool {
        if frame.standard_id() == Some(SYNC_COB_ID) {
            if self.is_enabled && self.zero.is_none() {
                self.zero = Some(time);
            }
            return self.zero.is_some();
        }
        if !self.is_enabled
            && let Some(statusword) = self.statusword.decode(frame)
        {
            #[expect(clippy::cast_possible_truncation, reason = "a signal of 7 bits")]
            let statusword = statusword as i64;
            self.is_enabled = self.enabled_values.contains(&statusword);
        }
        false
    }

    /// When scenario time began, on the clock of the frames.
    #[must_use]
    pub fn zero(&self) -> Option<Duration> {
        self.zero
    }

    /// Scenario time at a time of the frames' clock; `None` before it began.
    #[must_use]
    #[inline]
    pub fn scenario_time(&self, time: Duration) -> Option<Duration> {
        self.zero.map(|zero| time.saturating_sub(zero))
    }
}
