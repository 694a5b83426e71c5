//! The CiA 301 services of one node and its dictionary, as its application uses them.

use std::collections::VecDeque;
use std::time::Duration;

use crate::emcy::{self, Condition, Emcy, ErrorCode};
use crate::heartbeat::{self, HeartbeatConsumer, HeartbeatProducer};
use crate::nmt::{NmtCommand, NmtState, NodeId};
use crate::object_dictionary::{AbortCode, Accepted, Handle, ObjectDictionary};
use crate::pdo::{self, Direction, Place, Rpdo, Tpdo};
use crate::sdo_channels;
use crate::sync::{self, SyncService};
use can::CanFrame;
use can::{earlier, earliest};

/// Largest number of frames that wait to be drained; further ones are dropped and counted.
const OUTPUT_LENGTH: usize = 256;
/// Source of an overrun of the output, as opposed to one that the CAN controller reports.
const OUTPUT_OVERRUN: u16 = 1;

/// Wrong configuration of a PDO in a dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("PDO parameters at {index:#06x}: {reason}")]
pub struct InvalidPdo {
    /// Index of the PDO's communication parameters.
    pub index: u16,
    /// Error of the parameters or of the mapping.
    pub reason: AbortCode,
}

/// Dictionary and services of a node. An application gets it with every call.
#[derive(Clone, Debug)]
pub struct Services {
    pub(crate) now: Duration,
    pub(crate) node_id: NodeId,
    pub(crate) state: NmtState,
    pub(crate) requests: VecDeque<NmtCommand>,
    pub(crate) dictionary: ObjectDictionary,
    pub(crate) sync: SyncService,
    pub(crate) rpdos: Vec<Rpdo>,
    pub(crate) tpdos: Vec<Tpdo>,
    /// Whether any PDO may have a deadline; few nodes have one, and the question comes after every event.
    has_timed_pdos: bool,
    pub(crate) heartbeat: HeartbeatProducer,
    pub(crate) monitors: HeartbeatConsumer,
    pub(crate) emcy: Emcy,
    output: VecDeque<CanFrame>,
    dropped_frames: u64,
}

/// Largest number of the application's NMT commands that wait.
const REQUESTS_MAX: usize = 8;

impl Services {
    /// Makes the services from the dictionary's defaults, not yet booted.
    pub(crate) fn new(
        node_id: NodeId,
        mut dictionary: ObjectDictionary,
    ) -> Result<Self, InvalidPdo> {
        dictionary.restore_defaults(0x0000..=0xFFFF);
        let rpdos = read_pdos(&dictionary, Direction::Receive, Rpdo::new)?;
        let tpdos = read_pdos(&dictionary, Direction::Transmit, Tpdo::new)?;
        let mut services = Self {
            now: Duration::ZERO,
            node_id,
            state: NmtState::Initialising,
            requests: VecDeque::with_capacity(REQUESTS_MAX),
            sync: SyncService::default(),
            rpdos,
            tpdos,
            has_timed_pdos: false,
            heartbeat: HeartbeatProducer::default(),
            monitors: HeartbeatConsumer::default(),
            emcy: Emcy::new(),
            output: VecDeque::with_capacity(OUTPUT_LENGTH),
            dropped_frames: 0,
            dictionary,
        };
        services.restart();
        Ok(services)
    }

    /// Returns the time of the present call, since the node's start.
    pub fn now(&self) -> Duration {
        self.now
    }

    /// Returns the node-ID.
    pub fn node_id(&self) -> NodeId {
        self.node_id
    }

    /// Returns the node's own NMT state.
    pub fn nmt_state(&self) -> NmtState {
        self.state
    }

    /// Returns the dictionary.
    pub fn dictionary(&self) -> &ObjectDictionary {
        &self.dictionary
    }

    /// Returns the dictionary for the application's own values. Objects of the services are written with [`Services::write`], so
    /// that the services notice; none may be inserted.
    pub fn dictionary_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.dictionary
    }

    /// Writes an object as a client would, without the application's own `on_write`: access, limits and the services' rules
    /// count, and the services notice.
    ///
    /// # Errors
    /// As an SDO download would be refused.
    pub fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted {
        let handle = self.check_write(index, sub_index, bytes)?;
        self.commit(handle, bytes)
    }

    /// Requests an NMT state change or reset of this node itself, after the present call. At most eight wait; more are dropped.
    pub fn request_nmt(&mut self, command: NmtCommand) {
        if self.requests.len() < REQUESTS_MAX {
            self.requests.push_back(command);
        }
    }

    /// Orders, as NMT manager, one node, or all others if `target` is `None`. The node itself is not meant; see
    /// [`Services::request_nmt`].
    pub fn send_nmt(&mut self, command: NmtCommand, target: Option<NodeId>) {
        self.send(command.frame(target));
    }

    /// Queues a frame of the application's own.
    pub fn send(&mut self, frame: CanFrame) {
        if self.output.len() < OUTPUT_LENGTH {
            self.output.push_back(frame);
        } else {
            self.dropped_frames += 1;
            self.raise_from(ErrorCode::CAN_OVERRUN, OUTPUT_OVERRUN);
        }
    }

    /// Requests a TPDO, as a change of a mapped value does by itself: types 254 and 255 are packed now, or when their inhibit
    /// time has passed; type 0 goes with the next SYNC. Without effect outside Operational and for other types.
    #[cfg(test)]
    pub(crate) fn request_tpdo(&mut self, number: u16) {
        let now = self.now;
        self.send_tpdos(|tpdo, dictionary| {
            if tpdo.number() != number {
                return None;
            }
            tpdo.request();
            tpdo.on_tick(now, dictionary)
        });
    }

    /// Queues the frames of all TPDOs that have one.
    #[inline]
    pub(crate) fn send_tpdos(
        &mut self,
        frame_of: impl Fn(&mut Tpdo, &ObjectDictionary) -> Option<CanFrame>,
    ) {
        for place in 0..self.tpdos.len() {
            if let Some(frame) = frame_of(&mut self.tpdos[place], &self.dictionary) {
                self.send(frame);
            }
        }
    }

    /// Checks whether an RPDO's latest data held a value beyond the limits of its object, which got the limit instead.
    pub fn is_rpdo_cut(&self, number: u16) -> bool {
        let mut rpdos = self.rpdos.iter();
        rpdos.any(|rpdo| rpdo.number() == number && rpdo.is_cut())
    }

    /// Checks whether an RPDO carries an object, as it is configured now.
    pub fn is_in_rpdo(&self, number: u16, object: Handle) -> bool {
        let mut rpdos = self.rpdos.iter();
        rpdos.any(|rpdo| rpdo.number() == number && rpdo.carries(object))
    }

    /// Makes the TPDOs of types 254 and 255 due whose mapped values have changed.
    #[inline]
    pub(crate) fn notice_changes(&mut self) {
        if self.has_timed_pdos {
            let dictionary = &self.dictionary;
            let tpdos = self.tpdos.iter_mut();
            tpdos.for_each(|tpdo| tpdo.notice_event(dictionary));
        }
    }

    /// Checks whether a change of a value may cause a TPDO without SYNC, now or once the node is Operational.
    pub(crate) fn has_tpdos_that_follow_changes(&self) -> bool {
        let is_one = |tpdo: &Tpdo| tpdo.is_event_driven() && tpdo.exists();
        self.has_timed_pdos && self.tpdos.iter().any(is_one)
    }

    /// Raises an error: 0x1001, 0x1003, 0x603F and the EMCY follow. An error that is active already is not raised again.
    pub fn raise_error(&mut self, code: ErrorCode, manufacturer: [u8; 5]) {
        let condition = Condition { code, source: 0 };
        self.emcy
            .raise(&mut self.dictionary, condition, manufacturer);
    }

    /// Ends an error: 0x1001 and the EMCY "no error" follow. An error that is not active does not end.
    pub fn clear_error(&mut self, code: ErrorCode) {
        self.clear_from(code, 0);
    }

    /// Sets the shortest time without a SYNC before [`crate::CommunicationLoss::Sync`], which CiA 301 leaves open. The time-out
    /// is half a period (0x1006) and as many whole ones as fit into this time, but at least one; without a period it is this
    /// time. The default is 0: 1.5 periods, and no time-out without a period.
    pub fn set_sync_timeout_min(&mut self, timeout_min: Duration) {
        self.sync.set_timeout_min(timeout_min);
    }

    /// Begins the watch over all nodes of 0x1016 now, also over those that were never heard: CiA 301 begins it with the first
    /// heartbeat of each. The watch over a node that stays unheard ends when this node leaves Operational.
    pub fn expect_heartbeats(&mut self) {
        self.monitors.expect(self.now);
    }

    /// Returns the time at which the next SYNC is due that this node produces.
    pub fn next_sync(&self) -> Option<Duration> {
        self.sync.next_sync()
    }

    /// Returns the number of SYNC deadlines that this producer let pass.
    pub fn sync_overruns(&self) -> u64 {
        self.sync.overruns()
    }

    /// Returns the number of frames that were dropped because the output was not drained.
    pub fn dropped_frames(&self) -> u64 {
        self.dropped_frames
    }

    /// Raises an error of one RPDO or node.
    pub(crate) fn raise_from(&mut self, code: ErrorCode, source: u16) {
        let [low, high] = source.to_le_bytes();
        let manufacturer = [low, high, 0, 0, 0];
        let condition = Condition { code, source };
        self.emcy
            .raise(&mut self.dictionary, condition, manufacturer);
    }

    /// Ends an error of one RPDO or node.
    #[inline]
    pub(crate) fn clear_from(&mut self, code: ErrorCode, source: u16) {
        let condition = Condition { code, source };
        self.emcy.clear(&mut self.dictionary, condition);
    }

    /// Returns an object's value as a client reads it.
    pub(crate) fn read(&self, index: u16, sub_index: u8) -> Accepted<&[u8]> {
        let value = self.dictionary.read(index, sub_index)?;
        emcy::check_read(&self.dictionary, index, sub_index)?;
        Ok(value)
    }

    /// Checks a write against the dictionary and the services' rules, without effect.
    pub(crate) fn check_write(&self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted<Handle> {
        let dictionary = &self.dictionary;
        let handle = dictionary.check_write(index, sub_index, bytes)?;
        if let Some(place) = Place::from_index(index) {
            pdo::check_write(dictionary, place, sub_index, bytes)?;
        } else if sync::owns(index) {
            sync::check_write(dictionary, index, bytes)?;
        } else if heartbeat::owns(index) {
            heartbeat::check_write(dictionary, index, sub_index, bytes)?;
        } else if sdo_channels::owns(index) {
            sdo_channels::check_write(dictionary, index, sub_index, bytes)?;
        } else {
            Emcy::check_write(dictionary, index, bytes)?;
        }
        Ok(handle)
    }

    /// Stores a checked value and lets the service that it configures follow at once.
    pub(crate) fn commit(&mut self, handle: Handle, bytes: &[u8]) -> Accepted {
        self.dictionary.store(handle, bytes)?;
        let entry = self.dictionary.entry(handle);
        let (index, sub_index) = (entry.index, entry.sub_index);
        if let Some(place) = Place::from_index(index) {
            self.configure_pdo(place);
        } else if sync::owns(index) {
            self.configure_sync();
        } else if heartbeat::owns(index) {
            self.configure_heartbeat(index, sub_index);
        } else {
            self.emcy.on_write(&mut self.dictionary, index);
        }
        Ok(())
    }

    /// Restores the defaults of a range of indices, and the state of all services after power-on.
    pub(crate) fn reset(&mut self, indices: std::ops::RangeInclusive<u16>) {
        self.dictionary.restore_defaults(indices);
        self.restart();
    }

    /// Gives all services the state after power-on, with the dictionary's present values.
    fn restart(&mut self) {
        let dictionary = &self.dictionary;
        self.sync.reset(dictionary);
        self.monitors.reset(dictionary);
        self.emcy.reset(dictionary);
        for rpdo in &mut self.rpdos {
            rpdo.configure(dictionary);
        }
        for tpdo in &mut self.tpdos {
            tpdo.stop();
            tpdo.configure(self.now, dictionary);
        }
        self.look_for_timed_pdos();
        self.output.clear();
    }

    /// Lets the services follow a change of the NMT state.
    pub(crate) fn enter(&mut self, state: NmtState) {
        let was_operational = self.state == NmtState::Operational;
        self.state = state;
        if was_operational {
            self.rpdos.iter_mut().for_each(Rpdo::stop);
            self.tpdos.iter_mut().for_each(Tpdo::stop);
            self.monitors.forget_expected();
        }
        if state == NmtState::Operational {
            let now = self.now;
            let dictionary = &self.dictionary;
            let tpdos = self.tpdos.iter_mut();
            tpdos.for_each(|tpdo| tpdo.start(now, dictionary));
        }
        if state.allows_sdo() {
            self.sync.start(self.now);
        } else {
            self.sync.stop();
        }
        if self.heartbeat.is_enabled() {
            self.send(HeartbeatProducer::frame(self.node_id, state));
        }
    }

    /// Returns the oldest frame in the output.
    #[inline]
    pub(crate) fn next_output(&mut self) -> Option<CanFrame> {
        let frame = self.output.pop_front();
        if frame.is_some() || !self.state.allows_sdo() {
            return frame;
        }
        self.clear_from(ErrorCode::CAN_OVERRUN, OUTPUT_OVERRUN);
        self.emcy.next_frame(self.now)
    }

    /// Returns the time at which a service is due next.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        let deadline = self.emcy.next_deadline();
        let emcy = deadline.filter(|_| self.state.allows_sdo());
        let heartbeats = earlier(
            self.heartbeat.next_deadline(),
            self.monitors.next_deadline(),
        );
        let syncs = self.sync.next_deadline();
        let pdos = self.has_timed_pdos.then(|| self.next_pdo_deadline());
        earlier(earlier(heartbeats, syncs), earlier(emcy, pdos.flatten()))
    }

    fn next_pdo_deadline(&self) -> Option<Duration> {
        let rpdos = earliest(self.rpdos.iter().map(Rpdo::next_deadline));
        let tpdos = earliest(self.tpdos.iter().map(Tpdo::next_deadline));
        earlier(rpdos, tpdos)
    }

    fn look_for_timed_pdos(&mut self) {
        self.has_timed_pdos =
            self.rpdos.iter().any(Rpdo::is_timed) || self.tpdos.iter().any(Tpdo::is_event_driven);
    }

    /// Lets a PDO follow a write to its parameters or its mapping.
    fn configure_pdo(&mut self, written: Place) {
        let place = Place::from_parameters(written.direction, written.number);
        let dictionary = &self.dictionary;
        let rpdos = self.rpdos.iter_mut().filter(|rpdo| rpdo.place == place);
        rpdos.for_each(|rpdo| rpdo.configure(dictionary));
        let tpdos = self.tpdos.iter_mut().filter(|tpdo| tpdo.place == place);
        tpdos.for_each(|tpdo| tpdo.configure(self.now, dictionary));
        self.look_for_timed_pdos();
    }

    fn configure_sync(&mut self) {
        self.sync.configure(self.now, &self.dictionary);
        if !self.state.allows_sdo() {
            self.sync.stop();
        }
    }

    fn configure_heartbeat(&mut self, index: u16, sub_index: u8) {
        if index == heartbeat::PRODUCER_TIME {
            self.heartbeat.start(&self.dictionary, self.now);
            return;
        }
        let dropped = self
            .monitors
            .configure(self.now, &self.dictionary, sub_index);
        if let Some(node_id) = dropped {
            self.clear_from(ErrorCode::HEARTBEAT, u16::from(node_id.get()));
        }
    }
}

/// Reads all PDOs of a direction for which the dictionary has parameters.
fn read_pdos<Pdo>(
    dictionary: &ObjectDictionary,
    direction: Direction,
    read: impl Fn(&ObjectDictionary, Place) -> Accepted<Pdo>,
) -> Result<Vec<Pdo>, InvalidPdo> {
    let pdos = pdo::places(dictionary, direction).map(|place| {
        let index = place.parameters_index();
        read(dictionary, place).map_err(|reason| InvalidPdo { index, reason })
    });
    pdos.collect()
}
