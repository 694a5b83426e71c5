//! Watch for a second master on the bus of a real drive, while a scenario is played in real time.

use std::sync::Arc;

use dbc::scenario_clock::ScenarioClock;
use dbc::{Database, SignalMissing};
use plan::{ControlLoop, Plan};
use recording::capture::Capture;
use recording::sources::{Sent, SourceReader};

use crate::error::WorldError;
use crate::senders::Senders;

/// Watch over the recorded frames, by their stamps: the bench itself may be late.
pub(super) struct SecondMasterWatch {
    clock: ScenarioClock,
    database: Arc<Database>,
    drives: Vec<SourceReader>,
    taken: usize,
}

impl SecondMasterWatch {
    /// Makes a watch for each real drive.
    pub(super) fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let is_real = |one: &&ControlLoop| one.drive().is_external();
        let real = plan.loops.iter().filter(is_real);
        Ok(Self {
            clock: plan.scenario_clock()?,
            database: Arc::clone(plan.database()),
            drives: real
                .map(|one| SourceReader::new(plan.database(), one))
                .collect(),
            taken: 0,
        })
    }

    /// Reads the new frames of the recording. No node has reported yet how much it sent, so where the senders are not known, rates
    /// and contents must show another one.
    ///
    /// # Errors
    /// If another controller leads.
    pub(super) fn check(
        &mut self,
        capture: &Capture<'_>,
        senders: Option<&Senders>,
    ) -> Result<(), WorldError> {
        if let Some(senders) = senders {
            let first = senders.first_foreign().filter(|_| !self.drives.is_empty());
            return first.map_or(Ok(()), |identifier| {
                let what = self.database.purpose(identifier);
                Err(WorldError::SecondMaster(format!(
                    "0x{identifier:03X} ({what}) from another client of the bus"
                )))
            });
        }
        for stamped in capture.since(&mut self.taken) {
            self.clock.on_frame(stamped.time, &stamped.frame);
            let scenario_time = self.clock.scenario_time(stamped.time);
            for drive in &mut self.drives {
                drive.on_frame(stamped.time, scenario_time, &stamped.frame);
            }
        }
        let mut drives = self.drives.iter();
        let found =
            drives.find_map(|drive| drive.sources().found(&Sent::default()).into_iter().next());
        found.map_or(Ok(()), |found| {
            Err(WorldError::SecondMaster(found.to_string()))
        })
    }
}
