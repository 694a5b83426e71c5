//! The SDO servers of a device: the default channel 0x1200, and the channels of 0x1201 to 0x127F.

use std::time::Duration;

use crate::cob_id::{self, CobId};
use crate::nmt::NodeId;
use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};
use crate::sdo_server::{Access, SdoServer};
use can::CanFrame;
use can::earliest;

const DEFAULT: u16 = 0x1200;
const FIRST_ADDITIONAL: u16 = 0x1201;
const LAST: u16 = 0x127F;
const REQUEST_ID: u8 = 1;
const RESPONSE_ID: u8 = 2;

/// Checks whether an object describes an additional channel.
pub(crate) fn owns(index: u16) -> bool {
    (FIRST_ADDITIONAL..=LAST).contains(&index)
}

/// Checks the rule for writing a channel's COB-IDs: they stay while they are valid (CiA 301, 7.5.2.33).
pub(crate) fn check_write(
    dictionary: &ObjectDictionary,
    index: u16,
    sub_index: u8,
    bytes: &[u8],
) -> Accepted {
    let is_cob_id = matches!(sub_index, REQUEST_ID | RESPONSE_ID);
    if !is_cob_id || !CobId::from_bytes(bytes)?.is_valid() {
        return Ok(());
    }
    let object = (index, sub_index);
    cob_id::check_write(dictionary, object, bytes, AbortCode::DEVICE_STATE)
}

/// Servers of a node, one for each channel.
#[derive(Clone, Debug)]
pub(crate) struct SdoServers {
    /// Channels by their indices, the default one first. An additional one has no server while a COB-ID is invalid.
    channels: Vec<(u16, Option<SdoServer>)>,
}

impl SdoServers {
    /// Makes the servers of a dictionary.
    pub(crate) fn new(node_id: NodeId, dictionary: &ObjectDictionary) -> Self {
        let mut channels = vec![(DEFAULT, Some(SdoServer::for_node(node_id.get())))];
        let indices =
            (FIRST_ADDITIONAL..=LAST).filter(|index| dictionary.find(*index, REQUEST_ID).is_ok());
        channels.extend(indices.map(|index| (index, None)));
        let mut servers = Self { channels };
        servers.configure(dictionary);
        servers
    }

    /// Follows the dictionary after a write; a server whose COB-IDs have not changed continues its transfer.
    pub(crate) fn configure(&mut self, dictionary: &ObjectDictionary) {
        for (index, server) in &mut self.channels[1..] {
            let ids = channel_ids(dictionary, *index);
            let current = server.as_ref();
            if ids != current.map(|server| (server.request_id(), server.response_id())) {
                *server = ids.map(|(request, response)| SdoServer::new(request, response));
            }
        }
    }

    /// Forgets all transfers (NMT reset, Stopped).
    pub(crate) fn reset(&mut self, dictionary: &ObjectDictionary) {
        self.servers_mut().for_each(SdoServer::reset);
        self.configure(dictionary);
    }

    /// Checks whether a frame with this identifier is a request.
    #[inline]
    pub(crate) fn listens_to(&self, id: u16) -> bool {
        self.servers().any(|server| server.request_id() == id)
    }

    /// Handles a request.
    pub(crate) fn on_frame(&mut self, now: Duration, frame: &CanFrame, objects: &mut dyn Access) {
        for server in self.servers_mut() {
            server.on_frame(now, frame, objects);
        }
    }

    /// Ends transfers whose client is silent.
    #[inline]
    pub(crate) fn on_tick(&mut self, now: Duration) {
        self.servers_mut().for_each(|server| server.on_tick(now));
    }

    /// Returns the next answer.
    #[inline]
    pub(crate) fn next_frame(&mut self) -> Option<CanFrame> {
        self.servers_mut().find_map(SdoServer::next_frame)
    }

    /// Returns the time at which the next client's time passes.
    #[inline]
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        earliest(self.servers().map(SdoServer::next_deadline))
    }

    fn servers(&self) -> impl Iterator<Item = &SdoServer> {
        self.channels
            .iter()
            .filter_map(|(_, server)| server.as_ref())
    }

    fn servers_mut(&mut self) -> impl Iterator<Item = &mut SdoServer> {
        self.channels
            .iter_mut()
            .filter_map(|(_, server)| server.as_mut())
    }
}

/// Returns the COB-IDs of a channel, request first; `None` while one of them is invalid.
fn channel_ids(dictionary: &ObjectDictionary, index: u16) -> Option<(u16, u16)> {
    let id = |sub_index| {
        let cob_id = CobId(dictionary.unsigned(index, sub_index)?);
        let is_usable = cob_id.is_valid() && cob_id.check().is_ok();
        is_usable.then(|| cob_id.id())
    };
    Some((id(REQUEST_ID)?, id(RESPONSE_ID)?))
}
