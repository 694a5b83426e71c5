//! A CANopen device: dictionary, NMT slave, SDO servers, SYNC, PDOs, heartbeat and EMCY round an application.
//!
//! Decided and left out: storing parameters (0x1010, 0x1011) and LSS, since a bench's nodes get their values from their
//! EDS at every start and from their manager afterwards (both objects abort with "object does not exist"); node guarding
//! (see [`crate::heartbeat`]); time stamps (0x1012).
//!
//! Kernel error messages are the CAN controller's view of the bus: bus-off counts as loss of communication, error
//! passive and overrun raise their EMCY.

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::application::{Application, CommunicationLoss};
use crate::emcy::{self, Condition, EmergencyMessage, ErrorCode};
use crate::heartbeat::{self, HeartbeatProducer, Watch};
use crate::nmt::{NmtCommand, NmtState, NodeId};
use crate::object_dictionary::{Accepted, ObjectDictionary};
use crate::sdo_channels::SdoServers;
use crate::sdo_server::Access;
use crate::services::{InvalidPdo, Services};
use crate::sync::Sync;
use can::error_frames::{BUS_OFF, CONTROLLER, RESTARTED};
use can::{CanFrame, Filter, frame::REMOTE_FLAG};
use can::{Node, Progress, earlier};

/// Identifiers of PDOs and SDOs (CiA 301, 7.3.5). Identifiers below and above belong to other services.
pub const PDOS_AND_SDOS: RangeInclusive<u16> = 0x180..=0x67F;

const ERROR_BEHAVIOUR: u16 = 0x1029;

/// A node with an application.
#[derive(Clone, Debug)]
pub struct Device<A> {
    services: Services,
    application: A,
    sdo: SdoServers,
    is_stop_asked: bool,
    is_bus_off: bool,
}

impl<A: Application> Device<A> {
    /// Makes a device that boots with the first frame or tick, with the dictionary's defaults.
    ///
    /// # Errors
    /// The dictionary configures a PDO wrongly.
    pub fn new(
        node_id: NodeId,
        dictionary: ObjectDictionary,
        application: A,
    ) -> Result<Self, InvalidPdo> {
        let services = Services::new(node_id, dictionary)?;
        Ok(Self {
            sdo: SdoServers::new(node_id, services.dictionary()),
            services,
            application,
            is_stop_asked: false,
            is_bus_off: false,
        })
    }

    /// Returns the application.
    pub fn application(&self) -> &A {
        &self.application
    }

    /// Returns the application for changes by the owner of the node.
    pub fn application_mut(&mut self) -> &mut A {
        &mut self.application
    }

    /// Returns the services and the dictionary.
    pub fn services(&self) -> &Services {
        &self.services
    }

    /// Returns the services and the dictionary for changes by the owner of the node.
    pub fn services_mut(&mut self) -> &mut Services {
        &mut self.services
    }

    /// Reads an object as an SDO client would.
    ///
    /// # Errors
    /// As an SDO upload would be refused.
    pub fn read(&mut self, index: u16, sub_index: u8) -> Accepted<&[u8]> {
        self.application
            .on_read(&mut self.services, index, sub_index);
        self.services.read(index, sub_index)
    }

    /// Writes an object as an SDO client would.
    ///
    /// # Errors
    /// As an SDO download would be refused.
    pub fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted {
        self.objects().write(index, sub_index, bytes)?;
        self.sdo.configure(&self.services.dictionary);
        self.services.notice_changes();
        Ok(())
    }

    /// Checks whether the device, as it is configured now, sends nothing before its next SYNC or deadline after a PDO with this
    /// identifier: no RPDO listens to it, or only RPDOs that wait for the SYNC, and no TPDO goes by events (a waiting controlword
    /// may change the statusword on arrival).
    pub fn takes_silently(&self, pdo_id: u16) -> bool {
        let mut listening = self
            .services
            .rpdos
            .iter()
            .filter(|rpdo| rpdo.listens_to(pdo_id));
        listening.all(|rpdo| rpdo.is_silent() && !self.services.has_tpdos_that_follow_changes())
    }

    /// Checks whether a data frame of this identifier has an effect on the device, as it is configured now: PDOs and SDOs without
    /// a listener are dropped, all other frames are handled.
    pub fn reads(&self, id: u16) -> bool {
        let services = &self.services;
        !PDOS_AND_SDOS.contains(&id)
            || services.sync.listens_to(id)
            || self.sdo.listens_to(id)
            || services.rpdos.iter().any(|rpdo| rpdo.listens_to(id))
    }

    /// Checks whether the device watches the heartbeat of a node, as it is configured now (0x1016). The application hears all.
    pub fn watches(&self, node_id: NodeId) -> bool {
        self.services.monitors.watches(node_id)
    }

    fn objects(&mut self) -> Objects<'_, A> {
        Objects {
            services: &mut self.services,
            application: &mut self.application,
        }
    }

    /// Sets the time and boots if that has not happened.
    fn begin(&mut self, now: Duration) {
        self.services.now = self.services.now.max(now);
        if self.services.state == NmtState::Initialising {
            self.reset(NmtCommand::ResetNode);
        }
    }

    /// Obeys the application's requests for its own NMT state; bounded, since each may cause another one.
    fn finish(&mut self) {
        for _ in 0..8 {
            let Some(command) = self.services.requests.pop_front() else {
                return;
            };
            self.obey(command);
        }
    }

    fn obey(&mut self, command: NmtCommand) {
        match command.target_state() {
            Some(state) => self.enter(state),
            None => self.reset(command),
        }
    }

    fn enter(&mut self, state: NmtState) {
        if self.services.state == state {
            return;
        }
        self.services.enter(state);
        if !state.allows_sdo() {
            self.sdo.reset(&self.services.dictionary);
        }
        self.application.on_nmt_state(&mut self.services, state);
    }

    /// Power-on or NMT reset: defaults, boot-up, Pre-operational (CiA 301, 7.3.2.2.1).
    fn reset(&mut self, command: NmtCommand) {
        let indices = match command {
            NmtCommand::ResetCommunication => 0x1000..=0x1FFF,
            _ => 0x0000..=0xFFFF,
        };
        self.services.state = NmtState::Initialising;
        self.services.reset(indices);
        self.sdo.reset(&self.services.dictionary);
        self.application.on_reset(&mut self.services, command);
        // The boot-up message (CiA 301, 7.2.8.3.3).
        let boot_up = HeartbeatProducer::frame(self.services.node_id, NmtState::Initialising);
        self.services.send(boot_up);
        self.services.heartbeat = HeartbeatProducer::default();
        self.enter(NmtState::PreOperational);
        let services = &mut self.services;
        let heartbeat = &mut services.heartbeat;
        heartbeat.start_after_boot_up(&services.dictionary, services.now);
    }

    fn dispatch(&mut self, id: u16, frame: &CanFrame) {
        let data = frame.data();
        if id == 0 {
            if let Some(command) = NmtCommand::decode(data, self.services.node_id) {
                self.obey(command);
            }
        } else if self.services.sync.listens_to(id) {
            self.on_sync_frame(data);
        } else if self.sdo.listens_to(id) {
            self.on_sdo_frame(frame);
        } else if self.services.rpdos.iter().any(|rpdo| rpdo.listens_to(id)) {
            self.on_rpdo_frame(id, frame);
        } else if (0x701..=0x77F).contains(&id) {
            self.on_heartbeat_frame(id, data);
        } else if (0x081..=0x0FF).contains(&id) {
            self.on_emergency_frame(id, data);
        } else {
            self.application.on_frame(&mut self.services, frame);
        }
    }

    fn on_sync_frame(&mut self, data: &[u8]) {
        if !self.services.state.allows_sdo() {
            return;
        }
        let now = self.services.now;
        match self.services.sync.on_frame(now, data) {
            Some(sync) => {
                self.services.clear_from(ErrorCode::SYNC_LENGTH, 0);
                self.recover(CommunicationLoss::Sync);
                self.on_sync(&sync);
            }
            None => self.services.raise_from(ErrorCode::SYNC_LENGTH, 0),
        }
    }

    /// The cyclic order: RPDO data become valid, the application works, TPDOs are packed.
    fn on_sync(&mut self, sync: &Sync) {
        for place in 0..self.services.rpdos.len() {
            let services = &mut self.services;
            let rpdo = &mut services.rpdos[place];
            if rpdo.on_sync(&mut services.dictionary) {
                let number = rpdo.number();
                self.application.on_rpdo(services, number);
            }
        }
        self.application.on_sync(&mut self.services, sync);
        let mut tpdos = self.services.tpdos.iter();
        if tpdos.any(|tpdo| tpdo.is_sampled_at(sync)) {
            self.application.on_sampling(&mut self.services);
        }
        self.services
            .send_tpdos(|tpdo, dictionary| tpdo.on_sync(sync, dictionary));
    }

    fn on_sdo_frame(&mut self, frame: &CanFrame) {
        if !self.services.state.allows_sdo() {
            return;
        }
        let now = self.services.now;
        let mut objects = Objects {
            services: &mut self.services,
            application: &mut self.application,
        };
        self.sdo.on_frame(now, frame, &mut objects);
        self.sdo.configure(&self.services.dictionary);
    }

    fn on_rpdo_frame(&mut self, id: u16, frame: &CanFrame) {
        if self.services.state != NmtState::Operational {
            return;
        }
        for place in 0..self.services.rpdos.len() {
            if self.services.rpdos[place].listens_to(id) {
                self.receive(place, frame);
            }
        }
    }

    fn receive(&mut self, place: usize, frame: &CanFrame) {
        let services = &mut self.services;
        let rpdo = &mut services.rpdos[place];
        if rpdo.is_synchronous() && !services.sync.is_window_open(services.now) {
            return;
        }
        let (number, is_exceeded) = (rpdo.number(), rpdo.is_exceeded_by(frame));
        if !rpdo.on_frame(services.now, &mut services.dictionary, frame) {
            services.raise_from(ErrorCode::PDO_TOO_SHORT, number);
            return;
        }
        services.clear_from(ErrorCode::PDO_TOO_SHORT, number);
        if is_exceeded {
            services.raise_from(ErrorCode::PDO_TOO_LONG, number);
        } else {
            services.clear_from(ErrorCode::PDO_TOO_LONG, number);
        }
        self.recover(CommunicationLoss::Rpdo(number));
        match self.services.rpdos[place].waiting() {
            Some(waiting) => self
                .application
                .on_waiting_rpdo(&mut self.services, &waiting),
            None => self.application.on_rpdo(&mut self.services, number),
        }
    }

    fn on_heartbeat_frame(&mut self, id: u16, data: &[u8]) {
        let Some((node_id, state)) = heartbeat::decode(id, data) else {
            return;
        };
        let now = self.services.now;
        let loss = CommunicationLoss::Heartbeat(node_id);
        match self.services.monitors.on_heartbeat(now, node_id, state) {
            Watch::Normal => {}
            Watch::Recovered => self.recover(loss),
            Watch::Rebooted => self.lose(loss),
        }
        self.application
            .on_heartbeat(&mut self.services, node_id, state);
    }

    fn on_emergency_frame(&mut self, id: u16, data: &[u8]) {
        let node_id = u8::try_from(id - emcy::DEFAULT_ID)
            .ok()
            .and_then(NodeId::new);
        if let (Some(node_id), Some(message)) = (node_id, EmergencyMessage::decode(data)) {
            self.application
                .on_emergency(&mut self.services, node_id, &message);
        }
    }

    /// The kernel's error messages (`linux/can/error.h`).
    fn on_error_frame(&mut self, frame: &CanFrame) {
        const OVERFLOW: u8 = 0x01 | 0x02;
        const PASSIVE: u8 = 0x10 | 0x20;
        const ACTIVE: u8 = 0x40;
        let controller = frame.buffer()[1];
        let class = frame.raw_id();
        if class & CONTROLLER != 0 && controller & OVERFLOW != 0 {
            self.services.raise_from(ErrorCode::CAN_OVERRUN, 0);
            self.services.clear_from(ErrorCode::CAN_OVERRUN, 0);
        }
        if class & CONTROLLER != 0 && controller & PASSIVE != 0 {
            self.services.raise_from(ErrorCode::ERROR_PASSIVE, 0);
        }
        if class & CONTROLLER != 0 && controller & ACTIVE != 0 {
            self.services.clear_from(ErrorCode::ERROR_PASSIVE, 0);
        }
        if class & BUS_OFF != 0 && !self.is_bus_off {
            self.is_bus_off = true;
            self.lose(CommunicationLoss::BusOff);
        }
        if class & RESTARTED != 0 && self.is_bus_off {
            self.is_bus_off = false;
            let code = ErrorCode::RECOVERED_FROM_BUS_OFF;
            self.services.raise_from(code, 0);
            self.services.clear_from(code, 0);
            self.application
                .on_communication_recovery(&mut self.services, CommunicationLoss::BusOff);
        }
    }

    /// Reports a loss and obeys 0x1029, which is about heartbeat and bus-off only.
    fn lose(&mut self, loss: CommunicationLoss) {
        if let Some(Condition { code, source }) = loss.error() {
            self.services.raise_from(code, source);
        }
        self.application
            .on_communication_loss(&mut self.services, loss);
        let obeys_error_behaviour = matches!(
            loss,
            CommunicationLoss::Heartbeat(_) | CommunicationLoss::BusOff
        );
        if obeys_error_behaviour && self.services.state == NmtState::Operational {
            self.behave_on_error();
        }
    }

    /// 0x1029:01 (CiA 301, 7.5.2.32): 0 Pre-operational, which is also the default; 1 no change; 2 Stopped.
    fn behave_on_error(&mut self) {
        match self.services.dictionary.integer(ERROR_BEHAVIOUR, 1) {
            Some(1) => {}
            Some(2) => self.enter(NmtState::Stopped),
            _ => self.enter(NmtState::PreOperational),
        }
    }

    /// Reports the end of a loss, if there was one.
    fn recover(&mut self, loss: CommunicationLoss) {
        let emcy = &self.services.emcy;
        let active = loss.error().filter(|error| emcy.is_active(*error));
        if let Some(Condition { code, source }) = active {
            self.services.clear_from(code, source);
            self.application
                .on_communication_recovery(&mut self.services, loss);
        }
    }

    /// Reports the deadlines that have passed. Only a tick does this: if a busy host delivers a frame together with the deadline
    /// that it should have met, the frame counts.
    fn expire(&mut self) {
        let now = self.services.now;
        if self.services.sync.has_timed_out(now) {
            self.lose(CommunicationLoss::Sync);
        }
        for place in 0..self.services.rpdos.len() {
            if self.services.rpdos[place].has_timed_out(now) {
                let number = self.services.rpdos[place].number();
                self.lose(CommunicationLoss::Rpdo(number));
            }
        }
        while let Some(node_id) = self.services.monitors.next_lost(now) {
            self.lose(CommunicationLoss::Heartbeat(node_id));
        }
    }

    /// Sends the frames that are due by time.
    fn produce(&mut self) {
        let now = self.services.now;
        if let Some((frame, sync)) = self.services.sync.on_tick(now) {
            self.services.send(frame);
            self.on_sync(&sync);
        }
        self.services
            .send_tpdos(|tpdo, dictionary| tpdo.on_tick(now, dictionary));
        if self.services.heartbeat.is_due(now) {
            let frame = HeartbeatProducer::frame(self.services.node_id, self.services.state);
            self.services.send(frame);
        }
    }
}

/// The dictionary as SDO clients see it: rights, limits and the services' rules, then the application, then the value.
struct Objects<'a, A> {
    services: &'a mut Services,
    application: &'a mut A,
}

impl<A: Application> Access for Objects<'_, A> {
    fn read(&mut self, index: u16, sub_index: u8) -> Accepted<&[u8]> {
        self.application.on_read(self.services, index, sub_index);
        self.services.read(index, sub_index)
    }

    fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted {
        let handle = self.services.check_write(index, sub_index, bytes)?;
        self.application
            .on_write(self.services, index, sub_index, bytes)?;
        self.services.commit(handle, bytes)
    }

    fn dictionary(&self) -> &ObjectDictionary {
        &self.services.dictionary
    }
}

impl<A: Application> Node for Device<A> {
    fn filters(&self) -> Vec<Filter> {
        self.application.filters()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.begin(now);
        if frame.is_error() {
            self.on_error_frame(frame);
        } else if frame.is_remote() && !frame.is_extended() {
            let id = (frame.raw_id() & !REMOTE_FLAG & 0x7FF) as u16;
            self.services
                .send_tpdos(|tpdo, dictionary| tpdo.on_remote_frame(id, dictionary));
        } else if let Some(id) = frame.standard_id() {
            self.dispatch(id, frame);
        }
        self.finish();
        self.services.notice_changes();
    }

    fn on_tick(&mut self, now: Duration) {
        self.begin(now);
        self.expire();
        self.sdo.on_tick(now);
        self.application.on_tick(&mut self.services);
        self.finish();
        self.produce();
        self.finish();
    }

    fn on_stop(&mut self, now: Duration) {
        self.begin(now);
        self.is_stop_asked = true;
        self.application.on_stop(&mut self.services);
        self.finish();
        self.services.notice_changes();
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        let frame = self.services.next_output();
        frame.or_else(|| self.sdo.next_frame())
    }

    fn next_deadline(&self) -> Option<Duration> {
        if self.services.state == NmtState::Initialising {
            return Some(Duration::ZERO);
        }
        let application = self.application.next_deadline();
        let sdo = self.sdo.next_deadline();
        earlier(self.services.next_deadline(), earlier(application, sdo))
    }

    fn progress(&self) -> Progress {
        self.application.progress(self.is_stop_asked)
    }
}

#[cfg(test)]
mod tests;
