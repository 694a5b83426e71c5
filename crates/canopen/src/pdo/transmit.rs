//! PDOs that a node transmits.

use std::time::Duration;

use super::configuration::{Mapping, Parameters, Place, read};
use crate::object_dictionary::{Accepted, ObjectDictionary};
use crate::sync::Sync;
use can::CanFrame;
use can::earlier;

/// Transmit PDO.
#[derive(Clone, Debug)]
pub(crate) struct Tpdo {
    pub(crate) place: Place,
    parameters: Parameters,
    mapping: Mapping,
    is_started: bool,
    /// SYNCs until the next transmission; `None` until the SYNC with the start value.
    countdown: Option<u8>,
    is_requested: bool,
    /// Mapped values at the last check: a change is an event for types 0, 254 and 255.
    known: [u8; 8],
    /// Values that were sampled at the last SYNC, for remote frames.
    sampled: Option<[u8; 8]>,
    next_allowed: Duration,
    event_deadline: Option<Duration>,
}

impl Tpdo {
    /// Makes the TPDO from the dictionary's configuration.
    pub(crate) fn new(dictionary: &ObjectDictionary, place: Place) -> Accepted<Self> {
        let (parameters, mapping) = read(dictionary, place)?;
        Ok(Self {
            place,
            parameters,
            mapping,
            is_started: false,
            countdown: None,
            is_requested: false,
            known: [0; 8],
            sampled: None,
            next_allowed: Duration::ZERO,
            event_deadline: None,
        })
    }

    /// Reads the configuration again after a write; an invalid one leaves the PDO without effect.
    pub(crate) fn configure(&mut self, now: Duration, dictionary: &ObjectDictionary) {
        match read(dictionary, self.place) {
            Ok((parameters, mapping)) => (self.parameters, self.mapping) = (parameters, mapping),
            Err(_) => self.parameters.cob_id = None,
        }
        if self.is_started {
            self.start(now, dictionary);
        }
    }

    /// Returns the number, from 1.
    #[cfg(test)]
    pub(crate) fn number(&self) -> u16 {
        self.place.number
    }

    /// Starts (Operational entered, or new configuration): SYNCs are counted anew; an event-driven PDO is sent at once.
    pub(crate) fn start(&mut self, now: Duration, dictionary: &ObjectDictionary) {
        let waits_for_start = self.parameters.sync_start != 0;
        self.is_started = true;
        self.countdown = (!waits_for_start).then_some(self.parameters.transmission_type);
        self.is_requested = self.is_event_driven();
        self.known = self.mapping.pack(dictionary);
        self.sampled = None;
        self.event_deadline = self.parameters.event_timer.map(|timer| now + timer);
    }

    /// Stops (Operational left).
    pub(crate) fn stop(&mut self) {
        self.is_started = false;
        self.is_requested = false;
        self.event_deadline = None;
    }

    /// Requests transmission, as a change of a mapped value does by itself: at once for types 254 and 255 (after the inhibit
    /// time), at the next SYNC for type 0.
    #[cfg(test)]
    pub(crate) fn request(&mut self) {
        self.is_requested = self.is_started;
    }

    /// Returns the frame to send at this SYNC.
    #[inline]
    pub(crate) fn on_sync(
        &mut self,
        sync: &Sync,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        if !self.is_active() {
            return None;
        }
        let is_due = match self.parameters.transmission_type {
            0 => {
                self.notice_change(dictionary);
                std::mem::take(&mut self.is_requested)
            }
            period @ 1..=240 => self.count(period, sync),
            252 => false,
            _ => return None,
        };
        if is_due || self.parameters.allows_remote_frames {
            self.sampled = Some(self.mapping.pack(dictionary));
        }
        self.sampled
            .filter(|_| is_due)
            .and_then(|data| self.frame(&data))
    }

    /// Returns the frame to send at `now` because of a change, a request or the event timer.
    #[inline]
    pub(crate) fn on_tick(
        &mut self,
        now: Duration,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        self.notice_event(dictionary);
        if !self.is_active() || !self.is_event_driven() || now < self.next_allowed {
            return None;
        }
        let elapsed = self.event_deadline.filter(|deadline| now >= *deadline);
        if !self.is_requested && elapsed.is_none() {
            return None;
        }
        self.is_requested = false;
        self.next_allowed = now + self.parameters.inhibit_time;
        self.event_deadline = self.parameters.event_timer.map(|timer| {
            let from_deadline = elapsed.map(|deadline| deadline + timer);
            from_deadline
                .filter(|next| *next > now)
                .unwrap_or(now + timer)
        });
        self.frame(&self.mapping.pack(dictionary))
    }

    /// Makes a PDO of type 254 or 255 due when a mapped value has changed.
    pub(crate) fn notice_event(&mut self, dictionary: &ObjectDictionary) {
        if self.is_active() && self.is_event_driven() {
            self.notice_change(dictionary);
        }
    }

    /// Notices a change of a mapped object. CiA 301, 7.5.2.37, leaves the event of types 0, 254 and 255 to profile or
    /// manufacturer; here a change is the event.
    fn notice_change(&mut self, dictionary: &ObjectDictionary) {
        let present = self.mapping.pack(dictionary);
        self.is_requested |= present != self.known;
        self.known = present;
    }

    /// Returns the answer to a remote frame with this identifier.
    pub(crate) fn on_remote_frame(
        &mut self,
        id: u16,
        dictionary: &ObjectDictionary,
    ) -> Option<CanFrame> {
        let is_asked = self.parameters.cob_id == Some(id) && self.parameters.allows_remote_frames;
        if !is_asked || !self.is_active() {
            return None;
        }
        let is_sampled_at_sync =
            self.parameters.is_synchronous() || self.parameters.transmission_type == 252;
        let data = if is_sampled_at_sync {
            self.sampled?
        } else {
            self.mapping.pack(dictionary)
        };
        self.frame(&data)
    }

    /// Returns the time at which an event-driven transmission is due.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        if !self.is_active() || !self.is_event_driven() {
            return None;
        }
        let requested = self.is_requested.then_some(self.next_allowed);
        let elapsed = self.event_deadline.map(|due| due.max(self.next_allowed));
        earlier(requested, elapsed)
    }

    fn is_active(&self) -> bool {
        self.is_started && self.exists()
    }

    pub(crate) fn exists(&self) -> bool {
        self.parameters.cob_id.is_some() && self.mapping.length > 0
    }

    /// Checks whether events or time cause transmission, so that it may have a deadline.
    pub(crate) fn is_event_driven(&self) -> bool {
        self.parameters.transmission_type >= 254
    }

    fn frame(&self, data: &[u8; 8]) -> Option<CanFrame> {
        let cob_id = self.parameters.cob_id?;
        CanFrame::from_raw(u32::from(cob_id), self.mapping.length, *data)
    }

    /// Counts SYNCs, and returns whether this is the period's last. A lost SYNC counts by the counter, so that the phase stays.
    /// The SYNC with the start value is a transmission itself (CiA 301, 7.5.2.37).
    fn count(&mut self, period: u8, sync: &Sync) -> bool {
        let Some(remaining) = self.remaining(period, sync) else {
            return false;
        };
        let overshoot = sync.elapsed.saturating_sub(remaining);
        let is_due = remaining <= sync.elapsed;
        self.countdown = Some(if remaining == 0 {
            period
        } else if is_due {
            period - overshoot % period
        } else {
            remaining - sync.elapsed
        });
        is_due
    }

    /// Returns the SYNCs that were left before this one; `None` until the SYNC with the start value.
    fn remaining(&self, period: u8, sync: &Sync) -> Option<u8> {
        match (self.countdown, sync.counter) {
            (Some(remaining), _) => Some(remaining),
            (None, Some(counter)) if counter != self.parameters.sync_start => None,
            (None, Some(_)) => Some(0),
            (None, None) => Some(period),
        }
    }

    /// Checks whether its mapped values matter at this SYNC. A change of them is an event for types 0, 254 and 255.
    pub(crate) fn is_sampled_at(&self, sync: &Sync) -> bool {
        let is_due = |period| {
            let remaining = self.remaining(period, sync);
            remaining.is_some_and(|remaining| remaining <= sync.elapsed)
        };
        let is_of_this_sync = match self.parameters.transmission_type {
            period @ 1..=240 => is_due(period),
            252 => false,
            _ => true,
        };
        self.is_active() && (is_of_this_sync || self.parameters.allows_remote_frames)
    }
}
