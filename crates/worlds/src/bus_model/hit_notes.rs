//! Notes which frames the faults of the bus hit: which frame was lost, late or changed, by which fault, and for whom.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::Duration;

use can::CanFrame;
use canopen::emcy::{EmergencyMessage, ErrorCode};
use recording::hits::{Effect, Hit, HitLog};
use recording::reasons::{Reason, Reasons};

use super::faults::NODE_ID_BITS;

/// Identifiers of the emergencies of all nodes.
const EMERGENCIES: RangeInclusive<u16> = 0x081..=0x0FF;

/// Number of frames by identifier.
type Counts = BTreeMap<u16, u64>;

/// Notes of the hits on a bus, in scenario time.
#[derive(Debug)]
pub(crate) struct HitNotes {
    log: HitLog,
    stations: Vec<Station>,
    /// Reasons in the emergencies that the participants had to send.
    reasons: Reasons,
    passed: Counts,
    /// Time for which faults occupied the bus since it was last idle, and the path of the latest of these faults.
    occupied: Option<(Duration, String)>,
}

/// Participant with a CAN controller of its own.
#[derive(Debug)]
struct Station {
    /// Node-IDs and names of the nodes behind its CAN controller.
    nodes: Vec<(u8, String)>,
    queued: Counts,
    sent: Counts,
    /// Path of the fault that last disturbed a transmission on the bus.
    disturbed_by: Option<String>,
}

impl Station {
    /// Returns the node that sends frames with an identifier, if that is known.
    fn sender(&self, identifier: u16) -> Option<&str> {
        if let [(_, only)] = &self.nodes[..] {
            return Some(only);
        }
        let is_its = |(id, _): &&(u8, String)| identifier & NODE_ID_BITS == u16::from(*id);
        let node = self.nodes.iter().find(is_its);
        node.map(|(_, name)| name.as_str())
    }
}

/// Counts one more frame with an identifier and returns its number.
fn count(counts: &mut Counts, identifier: u16) -> u64 {
    let number = counts.entry(identifier).or_default();
    *number += 1;
    *number
}

impl HitNotes {
    /// Makes notes without hits for participants with these nodes.
    pub(crate) fn new(stations: impl Iterator<Item = Vec<(u8, String)>>) -> Self {
        let stations = stations.map(|nodes| Station {
            nodes,
            queued: Counts::new(),
            sent: Counts::new(),
            disturbed_by: None,
        });
        Self {
            log: HitLog::default(),
            reasons: Reasons::default(),
            stations: stations.collect(),
            passed: Counts::new(),
            occupied: None,
        }
    }

    /// Counts a frame that a participant queues; returns its number among those of its identifier.
    pub(crate) fn count_queued(&mut self, index: usize, frame: &CanFrame) -> u64 {
        let queued = &mut self.stations[index].queued;
        frame
            .standard_id()
            .map_or(0, |identifier| count(queued, identifier))
    }

    /// Notes what a gateway did to the frame of a participant with this number.
    pub(crate) fn note_queued(
        &mut self,
        index: usize,
        (fault, effect): (&str, Effect),
        (frame, number): (&CanFrame, u64),
        times: (f64, f64),
    ) {
        if let Some(identifier) = frame.standard_id() {
            let sender = self.stations[index].sender(identifier);
            self.log
                .note((fault, effect, sender), (identifier, number), times);
        }
    }

    /// Counts a frame that has passed on the bus.
    pub(crate) fn count_passed(&mut self, frame: &CanFrame) {
        if let Some(identifier) = frame.standard_id() {
            count(&mut self.passed, identifier);
        }
    }

    /// Notes that a participant did not receive the frame that has just passed.
    pub(crate) fn note_missed(
        &mut self,
        index: usize,
        fault: Option<&str>,
        frame: &CanFrame,
        at: f64,
    ) {
        let Some(identifier) = frame.standard_id() else {
            return;
        };
        let number = self.passed.get(&identifier).copied().unwrap_or_default();
        let station = &self.stations[index];
        let Some(fault) = fault.or(station.disturbed_by.as_deref()) else {
            return;
        };
        for (_, node) in &station.nodes {
            let hit = (fault, Effect::Lost, Some(node.as_str()));
            self.log.note(hit, (identifier, number), (at, at));
        }
    }

    /// Notes that a frame of a participant reaches nobody: it is off the bus, or faults that occupy the bus have filled the queue
    /// of its driver. A queue that the participant fills by itself is no hit.
    pub(crate) fn note_dropped(&mut self, index: usize, is_off: bool, frame: &CanFrame, at: f64) {
        let Some(identifier) = frame.standard_id() else {
            return;
        };
        let station = &mut self.stations[index];
        let number = count(&mut station.sent, identifier);
        let fault = if is_off {
            station.disturbed_by.as_deref()
        } else {
            self.occupied.as_ref().map(|(_, fault)| fault.as_str())
        };
        if let Some(fault) = fault {
            let hit = (fault, Effect::Lost, None);
            self.log.note(hit, (identifier, number), (at, at));
        }
    }

    /// Notes a frame of a foreign node, if it has the identifier of a message of the run.
    pub(crate) fn note_foreign(&mut self, fault: &str, frame: &CanFrame, number: u64, at: f64) {
        if let Some(identifier) = frame.standard_id() {
            let hit = (fault, Effect::Changed, None);
            self.log.note(hit, (identifier, number), (at, at));
        }
    }

    /// Takes the bus for idle: no fault delays the next frame.
    pub(crate) fn rest(&mut self) {
        self.occupied = None;
    }

    /// Adds a time for which a fault occupies the bus; for a disturbed transmission with its sender.
    pub(crate) fn occupy(&mut self, fault: &str, time: Duration, sender: Option<usize>) {
        let before = self
            .occupied
            .take()
            .map_or(Duration::ZERO, |(time, _)| time);
        self.occupied = Some((before + time, fault.to_owned()));
        if let Some(sender) = sender {
            self.stations[sender].disturbed_by = Some(fault.to_owned());
        }
    }

    /// Notes a frame that leaves after it has waited: as late as faults occupied the bus meanwhile.
    pub(crate) fn note_sent(&mut self, index: usize, frame: &CanFrame, waited: Duration, at: f64) {
        let Some(identifier) = frame.standard_id() else {
            return;
        };
        let number = count(&mut self.stations[index].sent, identifier);
        let Some((occupied, fault)) = &self.occupied else {
            return;
        };
        let late = waited.min(*occupied);
        if late > Duration::ZERO {
            let sender = self.stations[index].sender(identifier);
            let ready = at - waited.as_secs_f64();
            let hit = (fault.as_str(), Effect::Late, sender);
            self.log.note(
                hit,
                (identifier, number),
                (ready, ready + late.as_secs_f64()),
            );
        }
    }

    /// Notes the reason in an emergency that a participant has to send.
    pub(crate) fn note_reason(&mut self, frame: &CanFrame, at_seconds: f64) {
        let node_id = frame.standard_id().and_then(|id| {
            let is_emergency = EMERGENCIES.contains(&id);
            is_emergency.then_some(id & NODE_ID_BITS)
        });
        let emergency = EmergencyMessage::decode(frame.data());
        let Some((node_id, emergency)) = node_id.zip(emergency) else {
            return;
        };
        let [about, cause, ..] = emergency.manufacturer;
        let nodes = self.stations.iter().flat_map(|station| &station.nodes);
        let name = |node_id: u16| {
            let is_it = |(id, _): &&(u8, String)| u16::from(*id) == node_id;
            nodes.clone().find(is_it).map(|(_, name)| name.clone())
        };
        if let Some(node) = name(node_id).filter(|_| emergency.code != ErrorCode::NO_ERROR) {
            // Node-ID 0 means no node in particular.
            let about = Some(about).filter(|about| *about > 0);
            let about = about.and_then(|about| name(about.into()));
            let about = about.unwrap_or_default();
            self.reasons.add(Reason {
                node,
                at_seconds,
                code: emergency.code.0,
                cause,
                about,
            });
        }
    }

    /// Takes all reasons.
    pub(crate) fn take_reasons(&mut self) -> Reasons {
        std::mem::take(&mut self.reasons)
    }

    /// Takes all hits.
    pub(crate) fn take(&mut self) -> Vec<Hit> {
        self.log.take()
    }
}
