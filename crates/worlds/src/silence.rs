//! Whether the nodes under test are still heard, while a scenario without faults is played in real time.

use std::time::Duration;

use dbc::scenario_clock::SYNC_COB_ID;
use dbc::{SignalMissing, signals};
use recording::capture::Capture;
use recording::log::Stamped;
use rig::setup::Setup;

use crate::error::WorldError;
use crate::nodes::{CONTROLLER, DRIVE};

/// A node without a frame for so long is gone.
const SILENCE_MAX: Duration = Duration::from_secs(2);
/// The same where cycles are long.
const PERIODS_MAX: u32 = 20;

/// When SYNC, the position and any frame came last, on the bench's clock: the stamps of frames may be stepped.
pub(super) struct SilenceWatch {
    position_id: u32,
    limit: Duration,
    /// Without faults a node may not be silent; with them, somebody must be heard.
    is_sound: bool,
    taken: usize,
    sync: Duration,
    position: Duration,
    any: Duration,
}

impl SilenceWatch {
    pub(super) fn new(setup: &Setup) -> Result<Self, SignalMissing> {
        let period = setup.scenario.bus.sync_period();
        Ok(Self {
            position_id: setup.database.require(signals::POSITION)?.raw_id(),
            limit: SILENCE_MAX.max(PERIODS_MAX * period),
            is_sound: setup.scenario.fault.is_empty(),
            taken: 0,
            sync: Duration::ZERO,
            position: Duration::ZERO,
            any: Duration::ZERO,
        })
    }

    /// Takes what was recorded until now.
    ///
    /// # Errors
    /// A node has been silent for too long since the scenario began.
    pub(super) fn check(&mut self, now: Duration, capture: &Capture<'_>) -> Result<(), WorldError> {
        let mut taken = self.taken;
        self.hear(now, capture.since(&mut taken));
        self.taken = taken;
        let is_silent = |last: Duration| now.saturating_sub(last) > self.limit;
        let silent = match (capture.zero(), self.is_sound) {
            (None, _) => None,
            (Some(_), true) if is_silent(self.sync) => Some(CONTROLLER),
            (Some(_), true) if is_silent(self.position) => Some(DRIVE),
            (Some(_), false) if is_silent(self.any) => Some(CONTROLLER),
            _ => None,
        };
        match silent {
            None => Ok(()),
            Some(node) => Err(WorldError::Silent {
                node,
                silence: self.limit,
            }),
        }
    }

    fn hear(&mut self, now: Duration, frames: &[Stamped]) {
        for stamped in frames {
            self.any = now;
            match stamped.frame.raw_id() {
                id if id == u32::from(SYNC_COB_ID) => self.sync = now,
                id if id == self.position_id => self.position = now,
                _ => {}
            }
        }
    }
}
