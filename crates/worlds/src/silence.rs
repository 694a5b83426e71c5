//! Watch for silent nodes under test, while a scenario is played in real time.

use std::time::Duration;

use dbc::SignalMissing;
use dbc::scenario_clock::SYNC_COB_ID;
use plan::Plan;
use recording::capture::Capture;

use crate::error::WorldError;

/// Longest time without a frame of a node.
const SILENCE_MAX: Duration = Duration::from_secs(2);
/// Longest time without a frame of a node in cycles, if these are long.
const PERIODS_MAX: u32 = 20;

/// Times of the last SYNC, position and frame of any kind, on the bench's clock: the stamps of frames may be stepped.
pub(super) struct SilenceWatch {
    controller: String,
    drives: Vec<Drive>,
    limit: Duration,
    /// Whether the run has no faults, so that no node may be silent; with faults, some frame must come.
    is_sound: bool,
    taken: usize,
    sync: Duration,
    any: Duration,
}

struct Drive {
    name: String,
    position_id: u32,
    /// Time of its last position.
    heard: Duration,
}

impl SilenceWatch {
    pub(super) fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let period = plan.sync_period();
        let drives = plan.loops.iter().map(|one| {
            Ok(Drive {
                name: one.nodes.drive.name.clone(),
                position_id: one.drive_position()?.raw_id(),
                heard: Duration::ZERO,
            })
        });
        Ok(Self {
            controller: plan.controller().name.clone(),
            drives: drives.collect::<Result<_, _>>()?,
            limit: SILENCE_MAX.max(PERIODS_MAX * period),
            is_sound: !plan.has_faults(),
            taken: 0,
            sync: Duration::ZERO,
            any: Duration::ZERO,
        })
    }

    /// Reads the new frames of the recording.
    ///
    /// # Errors
    /// If a node has been silent for too long since the scenario began.
    pub(super) fn check(&mut self, now: Duration, capture: &Capture<'_>) -> Result<(), WorldError> {
        for stamped in capture.since(&mut self.taken) {
            self.any = now;
            let id = stamped.frame.raw_id();
            if id == u32::from(SYNC_COB_ID) {
                self.sync = now;
            }
            let mut drives = self.drives.iter_mut();
            if let Some(drive) = drives.find(|drive| drive.position_id == id) {
                drive.heard = now;
            }
        }
        let is_silent = |last: Duration| now.saturating_sub(last) > self.limit;
        let silent_drive = || self.drives.iter().find(|drive| is_silent(drive.heard));
        let controller = self.controller.as_str();
        let silent = match (capture.zero(), self.is_sound) {
            (None, _) => None,
            (Some(_), true) if is_silent(self.sync) => Some(controller),
            (Some(_), true) => silent_drive().map(|drive| drive.name.as_str()),
            (Some(_), false) => Some(controller).filter(|_| is_silent(self.any)),
        };
        match silent {
            None => Ok(()),
            Some(node) => Err(WorldError::Silent {
                node: node.to_owned(),
                silence: self.limit,
            }),
        }
    }
}
