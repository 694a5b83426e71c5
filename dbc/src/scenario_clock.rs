//! Scenario time, computed from frames alone.

use std::time::Duration;

use crate::names::{STATUSWORD, TPDO1, message};
use crate::{Database, SignalHandle, SignalMissing};
use can::{CanFrame, Filter};

/// COB-ID of the SYNC (CiA 301, default of 0x1005).
pub const SYNC_COB_ID: u16 = 0x080;

/// Label, in the DBC's value table, of the drive's state in which current flows.
const OPERATION_ENABLED: &str = "operation enabled";

/// Watches the bus for scenario time 0: the first SYNC at which the latest statusword of every drive is Operation Enabled.
#[derive(Clone, Debug)]
pub struct ScenarioClock {
    drives: Vec<Drive>,
    enabled_values: Vec<i64>,
    zero: Option<Duration>,
}

#[derive(Clone, Debug)]
struct Drive {
    statusword: SignalHandle,
    is_enabled: bool,
}

impl ScenarioClock {
    /// Makes a clock that has not begun, on a bus with these drives.
    ///
    /// # Errors
    /// The database has no statusword of a drive.
    pub fn new<'a>(
        database: &Database,
        drives: impl IntoIterator<Item = &'a str>,
    ) -> Result<Self, SignalMissing> {
        let mut enabled_values = Vec::new();
        let drives = drives.into_iter().map(|name| {
            let path = format!("{}.{STATUSWORD}", message(name, TPDO1));
            let statusword = database.require(&path)?;
            let definition = database.definition(&path);
            let labels = definition.into_iter().flat_map(|signal| &signal.labels);
            let enabled = labels.filter(|(_, label)| label == OPERATION_ENABLED);
            enabled_values = enabled.map(|(value, _)| *value).collect();
            Ok(Drive {
                statusword,
                is_enabled: false,
            })
        });
        Ok(Self {
            drives: drives.collect::<Result<_, SignalMissing>>()?,
            enabled_values,
            zero: None,
        })
    }

    /// Returns the frames that it must receive.
    pub fn filters(&self) -> impl Iterator<Item = Filter> {
        let sync = Filter::exact(SYNC_COB_ID);
        [sync].into_iter().chain(self.silent_filters())
    }

    /// Returns those of these frames that have no effect before the next SYNC.
    pub fn silent_filters(&self) -> impl Iterator<Item = Filter> {
        let mask = Filter::exact(0).mask;
        let statuswords = self.drives.iter().map(|drive| drive.statusword.raw_id());
        statuswords.map(move |id| Filter { id, mask })
    }

    /// Reads every frame of the bus, in order; `true` for a SYNC of the scenario.
    #[inline]
    pub fn on_frame(&mut self, time: Duration, frame: &CanFrame) -> bool {
        let is_sync = frame.standard_id() == Some(SYNC_COB_ID);
        if self.zero.is_none() {
            self.look(time, frame, is_sync);
        }
        is_sync && self.zero.is_some()
    }

    /// Reads a frame before scenario time 0.
    fn look(&mut self, time: Duration, frame: &CanFrame, is_sync: bool) {
        if is_sync && self.drives.iter().all(|drive| drive.is_enabled) {
            self.zero = Some(time);
        }
        for drive in &mut self.drives {
            if let Some(statusword) = drive.statusword.decode(frame) {
                #[expect(clippy::cast_possible_truncation, reason = "a signal of 7 bits")]
                let statusword = statusword as i64;
                drive.is_enabled = self.enabled_values.contains(&statusword);
            }
        }
    }

    /// Returns the start of scenario time, on the clock of the frames.
    pub fn zero(&self) -> Option<Duration> {
        self.zero
    }

    /// Returns scenario time at a time of the frames' clock; `None` before it began.
    #[inline]
    pub fn scenario_time(&self, time: Duration) -> Option<Duration> {
        self.zero.map(|zero| time.saturating_sub(zero))
    }
}
