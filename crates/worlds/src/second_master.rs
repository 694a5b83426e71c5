//! Whether anybody else leads beside a real drive, while a scenario is played in real time.

use dbc::SignalMissing;
use recording::capture::Capture;
use recording::masters::MasterWatch;
use rig::external::ExternalNode;
use rig::plan::{ControlLoop, Plan};

use crate::error::WorldError;

/// Watches what is recorded, by its stamps: the bench itself may be late.
pub(super) struct SecondMasterWatch {
    drives: Vec<MasterWatch>,
    taken: usize,
}

impl SecondMasterWatch {
    /// A watch beside each real drive.
    pub(super) fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let is_real = |one: &&ControlLoop| one.external.has(ExternalNode::Drive);
        let watch =
            |one: &ControlLoop| MasterWatch::new(&one.scenario, &one.database, &one.external);
        let drives = plan.loops.iter().filter(is_real).map(watch);
        Ok(Self {
            drives: drives.collect::<Result<_, _>>()?,
            taken: 0,
        })
    }

    /// Takes what was recorded until now.
    ///
    /// # Errors
    /// Somebody else leads.
    pub(super) fn check(&mut self, capture: &Capture<'_>) -> Result<(), WorldError> {
        let new = capture.since(&mut self.taken);
        for drive in &mut self.drives {
            for stamped in new {
                drive.on_frame(stamped.time, &stamped.frame);
            }
            if let Some(found) = drive.found().first() {
                return Err(WorldError::SecondMaster(found.to_string()));
            }
        }
        Ok(())
    }
}
