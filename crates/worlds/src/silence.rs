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

/// Watch over the times at which nodes were heard, on the bench's clock: the stamps of frames may be stepped.
pub(super) struct SilenceWatch {
    nodes: Vec<Node>,
    limit: Duration,
    taken: usize,
}

struct Node {
    name: String,
    /// Identifier of the frame that must come; any frame if `None`.
    id: Option<u32>,
    heard: Duration,
}

impl SilenceWatch {
    /// Makes a watch for the controller's SYNC and the drives' positions. In a run with faults any node may be silent, but some
    /// frame must come.
    pub(super) fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let node = |name: &str, id| Node {
            name: name.to_owned(),
            id,
            heard: Duration::ZERO,
        };
        let is_sound = !plan.has_faults();
        let sync = is_sound.then_some(SYNC_COB_ID.into());
        let mut nodes = vec![node(&plan.controller().name, sync)];
        for one in plan.loops.iter().filter(|_| is_sound) {
            let position = one.drive_position(plan.database())?.raw_id();
            nodes.push(node(&one.drive().name, Some(position)));
        }
        Ok(Self {
            nodes,
            limit: SILENCE_MAX.max(PERIODS_MAX * plan.sync_period()),
            taken: 0,
        })
    }

    /// Reads the new frames of the recording.
    ///
    /// # Errors
    /// If a node has been silent for too long since the scenario began.
    pub(super) fn check(&mut self, now: Duration, capture: &Capture<'_>) -> Result<(), WorldError> {
        for stamped in capture.since(&mut self.taken) {
            let id = stamped.frame.raw_id();
            let nodes = self.nodes.iter_mut();
            let senders = nodes.filter(|node| node.id.is_none_or(|own| own == id));
            senders.for_each(|node| node.heard = now);
        }
        let is_silent = |node: &&Node| now.saturating_sub(node.heard) > self.limit;
        match self.nodes.iter().find(is_silent) {
            Some(node) if capture.zero().is_some() => Err(WorldError::Silent {
                node: node.name.clone(),
                silence: self.limit,
            }),
            _ => Ok(()),
        }
    }
}
