//! PDOs that a node receives.

use std::time::Duration;

use super::configuration::{Mapping, Parameters, Place, read};
use crate::object_dictionary::{Accepted, Handle, ObjectDictionary};
use can::CanFrame;

/// A synchronous RPDO that has arrived and takes effect at the next SYNC.
#[derive(Clone, Copy, Debug)]
pub struct WaitingPdo {
    /// Number of the RPDO, from 1.
    pub number: u16,
    mapping: Mapping,
    data: [u8; 8],
}

impl WaitingPdo {
    /// Returns the integer that an object will get; `None` if it is not mapped here.
    pub fn integer(&self, dictionary: &ObjectDictionary, wanted: Handle) -> Option<i128> {
        let range = self.mapping.place_of(wanted)?;
        Some(dictionary.entry(wanted).decode_integer(&self.data[range]))
    }
}

/// Receive PDO.
#[derive(Clone, Debug)]
pub(crate) struct Rpdo {
    pub(crate) place: Place,
    parameters: Parameters,
    mapping: Mapping,
    waiting: Option<[u8; 8]>,
    /// Whether a value of the latest data in the dictionary was beyond its object's limits.
    is_cut: bool,
    deadline: Option<Duration>,
}

impl Rpdo {
    /// Makes the RPDO from the dictionary's configuration.
    pub(crate) fn new(dictionary: &ObjectDictionary, place: Place) -> Accepted<Self> {
        let (parameters, mapping) = read(dictionary, place)?;
        Ok(Self {
            place,
            parameters,
            mapping,
            waiting: None,
            is_cut: false,
            deadline: None,
        })
    }

    /// Checks whether the PDO carries an object.
    pub(crate) fn carries(&self, object: Handle) -> bool {
        self.mapping.place_of(object).is_some()
    }

    /// Reads the configuration again after a write; an invalid one leaves the PDO without effect.
    pub(crate) fn configure(&mut self, dictionary: &ObjectDictionary) {
        match read(dictionary, self.place) {
            Ok((parameters, mapping)) => (self.parameters, self.mapping) = (parameters, mapping),
            Err(_) => self.parameters.cob_id = None,
        }
        self.stop();
    }

    /// Returns the number, from 1.
    pub(crate) fn number(&self) -> u16 {
        self.place.number
    }

    /// Checks whether frames with this identifier are for this PDO.
    #[inline]
    pub(crate) fn listens_to(&self, id: u16) -> bool {
        self.parameters.cob_id == Some(id) && self.mapping.length > 0
    }

    /// Checks whether a limit cut a value of the latest data in the dictionary.
    pub(crate) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// Checks whether no frame has an effect before a SYNC, neither by its data nor by the end of a deadline.
    pub(crate) fn is_silent(&self) -> bool {
        self.is_synchronous() && !self.is_timed()
    }

    /// Checks whether the PDO has an event timer, which may run out.
    pub(crate) fn is_timed(&self) -> bool {
        self.parameters.event_timer.is_some()
    }

    /// Forgets the received data (Operational left, or new configuration).
    pub(crate) fn stop(&mut self) {
        self.waiting = None;
        self.is_cut = false;
        self.deadline = None;
    }

    /// Checks whether data that arrive now must wait for a SYNC.
    #[inline]
    pub(crate) fn is_synchronous(&self) -> bool {
        self.parameters.is_synchronous()
    }

    /// Checks whether a payload is longer than the mapping.
    #[inline]
    pub(crate) fn is_exceeded_by(&self, frame: &CanFrame) -> bool {
        frame.data().len() > self.mapping.length()
    }

    /// Stores the payload of a frame in the dictionary, or until the next SYNC; the deadline (sub-index 5) runs from here. A frame
    /// that is too short is ignored, and the result is false.
    pub(crate) fn on_frame(
        &mut self,
        now: Duration,
        dictionary: &mut ObjectDictionary,
        frame: &CanFrame,
    ) -> bool {
        if frame.data().len() < self.mapping.length() {
            return false;
        }
        self.deadline = self.parameters.event_timer.map(|timer| now + timer);
        if self.is_synchronous() {
            self.waiting = Some(frame.buffer());
        } else {
            self.is_cut = self.mapping.unpack(dictionary, &frame.buffer());
        }
        true
    }

    /// Returns the data that wait for the next SYNC.
    pub(crate) fn waiting(&self) -> Option<WaitingPdo> {
        self.waiting.map(|data| WaitingPdo {
            number: self.place.number,
            mapping: self.mapping,
            data,
        })
    }

    /// Stores the waiting data in the dictionary; false if there are none.
    #[inline]
    pub(crate) fn on_sync(&mut self, dictionary: &mut ObjectDictionary) -> bool {
        let waiting = self.waiting.take();
        if let Some(data) = &waiting {
            self.is_cut = self.mapping.unpack(dictionary, data);
        }
        waiting.is_some()
    }

    /// Returns true once when the deadline has passed.
    #[inline]
    pub(crate) fn has_timed_out(&mut self, now: Duration) -> bool {
        let passed = self.deadline.take_if(|deadline| now >= *deadline);
        passed.is_some()
    }

    /// Returns the time at which the deadline passes.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.deadline
    }
}
