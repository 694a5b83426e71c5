//! SYNC (CiA 301, 7.2.5): consumer with counter, length check, window and time-out; producer with absolute deadlines.

use std::time::Duration;

use crate::cob_id::CobId;
use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};
use can::{CanFrame, earlier};

pub(crate) const COB_ID: u16 = 0x1005;
const PERIOD: u16 = 0x1006;
const WINDOW: u16 = 0x1007;
const OVERFLOW: u16 = 0x1019;

/// A SYNC as the services of a node see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sync {
    /// Counter, 1 to 0x1019; `None` for a SYNC without one.
    pub counter: Option<u8>,
    /// Number of SYNCs since the previous one, by the counter: more than 1 if SYNCs were lost.
    pub elapsed: u8,
}

/// The objects 0x1005 to 0x1007 and 0x1019.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Parameters {
    cob_id: Option<u16>,
    is_producer: bool,
    period: Option<Duration>,
    window: Option<Duration>,
    overflow: u8,
}

impl Parameters {
    fn read(dictionary: &ObjectDictionary) -> Self {
        let cob_id = dictionary.unsigned(COB_ID, 0).map(CobId);
        let microseconds = |index| {
            let value = dictionary.unsigned(index, 0).filter(|value| *value != 0);
            value.map(|value| Duration::from_micros(u64::from(value)))
        };
        let overflow = dictionary.unsigned(OVERFLOW, 0).unwrap_or(0);
        Self {
            cob_id: cob_id.map(CobId::id),
            is_producer: cob_id.is_some_and(CobId::flag_30),
            period: microseconds(PERIOD),
            window: microseconds(WINDOW),
            overflow: u8::try_from(overflow).unwrap_or(0),
        }
    }
}

/// Checks whether an object configures SYNC.
pub(crate) fn owns(index: u16) -> bool {
    matches!(index, COB_ID | PERIOD | WINDOW | OVERFLOW)
}

/// Checks the rules for writing 0x1005 and 0x1019 (CiA 301, 7.5.2.5 and 7.5.2.22).
pub(crate) fn check_write(dictionary: &ObjectDictionary, index: u16, bytes: &[u8]) -> Accepted {
    match index {
        COB_ID => {
            let new = CobId::from_bytes(bytes)?;
            new.check_at(dictionary, (COB_ID, 0))?;
            let old = CobId(dictionary.unsigned(COB_ID, 0).unwrap_or(0));
            if old.flag_30() && new.id() != old.id() {
                return Err(AbortCode::DEVICE_STATE);
            }
            Ok(())
        }
        OVERFLOW if dictionary.unsigned(PERIOD, 0).unwrap_or(0) != 0 => {
            Err(AbortCode::DEVICE_STATE)
        }
        OVERFLOW if !matches!(bytes, [0 | 2..=240]) => Err(AbortCode::INVALID_VALUE),
        _ => Ok(()),
    }
}

/// SYNC of a node, which either consumes or produces it (0x1005).
///
/// The consumer recognises SYNC, and watches its counter and its absence. An empty SYNC is accepted whatever 0x1019 says, since
/// widely used managers send no other; any other wrong length is an error and no SYNC. The time-out starts with the first SYNC.
///
/// The producer's deadlines are multiples of 0x1006 from the start and never drift. A late tick sends one SYNC; the multiples that
/// have passed meanwhile are skipped and counted as overruns.
#[derive(Clone, Debug, Default)]
pub(crate) struct SyncService {
    parameters: Parameters,
    /// Shortest time-out of the consumer; 0 for 1.5 periods.
    timeout_min: Duration,
    /// Time-out of the consumer; `None` for a producer with a period, and without a period and a shortest time-out. A producer without
    /// a period makes no SYNC, so it has the shortest time-out.
    timeout: Option<Duration>,
    last_counter: Option<u8>,
    last: Option<Duration>,
    /// Deadline of the consumer from each SYNC on, until the time-out.
    deadline: Option<Duration>,
    has_timed_out: bool,
    /// Time of the producer's next SYNC, and the counter of its last one.
    next: Option<Duration>,
    counter: u8,
    overruns: u64,
}

impl SyncService {
    /// Sets the shortest time-out; see [`crate::Services::set_sync_timeout_min`].
    pub(crate) fn set_timeout_min(&mut self, timeout_min: Duration) {
        self.timeout_min = timeout_min;
        self.timeout = self.timeout();
    }

    /// Stops and reads the configuration (NMT reset).
    pub(crate) fn reset(&mut self, dictionary: &ObjectDictionary) {
        self.stop();
        self.parameters = Parameters::read(dictionary);
        self.timeout = self.timeout();
    }

    /// Forgets the received SYNCs and produces no more; the counter begins again with 1 (Stopped).
    pub(crate) fn stop(&mut self) {
        *self = Self {
            parameters: self.parameters,
            timeout_min: self.timeout_min,
            timeout: self.timeout,
            overruns: self.overruns,
            ..Self::default()
        };
    }

    /// Starts if 0x1005 and 0x1006 demand it and the producer is not running: the first SYNC comes one period after `now`.
    pub(crate) fn start(&mut self, now: Duration) {
        if self.next.is_none() {
            self.next = self.period().map(|period| now + period);
        }
    }

    /// Reads the objects again after a write; a running time-out, and a new period, count from `now`.
    pub(crate) fn configure(&mut self, now: Duration, dictionary: &ObjectDictionary) {
        let old = std::mem::replace(&mut self.parameters, Parameters::read(dictionary));
        self.timeout = self.timeout();
        let is_watching = self.last.is_some() && !self.has_timed_out;
        self.deadline = self
            .timeout
            .filter(|_| is_watching)
            .map(|timeout| now + timeout);
        if old != self.parameters {
            self.next = None;
            self.start(now);
        }
        if old.overflow != self.parameters.overflow {
            self.counter = 0;
        }
    }

    /// Checks whether the frame's identifier is that of SYNC; a producer takes no foreign SYNC.
    pub(crate) fn listens_to(&self, id: u16) -> bool {
        self.parameters.cob_id == Some(id) && !self.parameters.is_producer
    }

    /// Handles a frame with SYNC's identifier; `None` if its length is wrong.
    pub(crate) fn on_frame(&mut self, now: Duration, data: &[u8]) -> Option<Sync> {
        let counter = match (data, self.parameters.overflow) {
            ([], _) => None,
            ([counter], overflow) if overflow != 0 => Some(*counter),
            _ => return None,
        };
        self.last = Some(now);
        self.has_timed_out = false;
        self.deadline = self.timeout.map(|timeout| now + timeout);
        let elapsed = self.elapsed_until(counter);
        self.last_counter = counter;
        Some(Sync { counter, elapsed })
    }

    /// Returns true once when the time-out has passed.
    pub(crate) fn has_timed_out(&mut self, now: Duration) -> bool {
        let passed = self.deadline.take_if(|deadline| now >= *deadline);
        self.has_timed_out |= passed.is_some();
        passed.is_some()
    }

    /// Returns the time at which the time-out passes, or the next SYNC is due.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        earlier(self.deadline, self.next)
    }

    /// Checks whether a synchronous RPDO may still arrive (0x1007).
    pub(crate) fn is_window_open(&self, now: Duration) -> bool {
        match (self.last, self.parameters.window) {
            (Some(last), Some(window)) => now <= last + window,
            _ => true,
        }
    }

    fn timeout(&self) -> Option<Duration> {
        let timeout = match self.parameters.period {
            Some(period) => {
                let missing = self.timeout_min.as_nanos() / period.as_nanos();
                let missing = u32::try_from(missing.max(1)).unwrap_or(u32::MAX);
                let half_periods = missing.saturating_mul(2).saturating_add(1);
                period.saturating_mul(half_periods) / 2
            }
            None => Some(self.timeout_min).filter(|timeout| !timeout.is_zero())?,
        };
        self.period().is_none().then_some(timeout)
    }

    /// Returns the number of SYNCs since the previous one; 1 if the counters do not show it.
    fn elapsed_until(&self, counter: Option<u8>) -> u8 {
        let overflow = self.parameters.overflow;
        let is_sound = |counter| (1..=overflow).contains(&counter);
        match (self.last_counter, counter) {
            (Some(last), Some(counter))
                if last != counter && is_sound(last) && is_sound(counter) =>
            {
                if counter > last {
                    counter - last
                } else {
                    overflow - last + counter
                }
            }
            _ => 1,
        }
    }

    /// Returns the SYNC that is due at `now`.
    pub(crate) fn on_tick(&mut self, now: Duration) -> Option<(CanFrame, Sync)> {
        let (period, cob_id) = (self.period()?, self.parameters.cob_id?);
        let due = self.next.filter(|next| now >= *next)?;
        self.next = Some(due + period);
        if now >= due + period {
            self.skip(due, now, period);
        }
        Some(self.sync(cob_id))
    }

    /// Skips the deadlines up to `now` that are multiples of the period after `due`.
    fn skip(&mut self, due: Duration, now: Duration, period: Duration) {
        let late_by_nanoseconds = (now - due).as_nanos();
        let missed = u64::try_from(late_by_nanoseconds / period.as_nanos()).unwrap_or(u64::MAX);
        self.overruns = self.overruns.saturating_add(missed);
        let remainder = u64::try_from(late_by_nanoseconds % period.as_nanos()).unwrap_or(0);
        self.next = Some(now - Duration::from_nanos(remainder) + period);
    }

    /// Returns the time at which the next SYNC is due that is produced here.
    pub(crate) fn next_sync(&self) -> Option<Duration> {
        self.next
    }

    /// Returns the number of deadlines that passed without a SYNC since the start.
    pub(crate) fn overruns(&self) -> u64 {
        self.overruns
    }

    fn period(&self) -> Option<Duration> {
        self.parameters
            .period
            .filter(|_| self.parameters.is_producer)
    }

    /// Returns the next SYNC; the counter runs from 1 to 0x1019.
    fn sync(&mut self, cob_id: u16) -> (CanFrame, Sync) {
        if self.parameters.overflow == 0 {
            let (counter, elapsed) = (None, 1);
            return (CanFrame::new(cob_id, &[]), Sync { counter, elapsed });
        }
        self.counter = self.counter % self.parameters.overflow + 1;
        let sync = Sync {
            counter: Some(self.counter),
            elapsed: 1,
        };
        (CanFrame::new(cob_id, &[self.counter]), sync)
    }
}
