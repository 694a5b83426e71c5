//! Heartbeat (CiA 301, 7.2.8.3.2.2): producer 0x1017, consumers 0x1016.
//!
//! Node guarding is not offered: CiA 301 recommends heartbeat in its place, and a node shall not use both.

use std::time::Duration;

use crate::nmt::{ERROR_CONTROL_ID, NmtState, NodeId};
use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};
use can::CanFrame;
use can::earliest;

const CONSUMER_TIME: u16 = 0x1016;
pub(crate) const PRODUCER_TIME: u16 = 0x1017;

/// Checks whether an object configures heartbeat.
pub(crate) fn owns(index: u16) -> bool {
    matches!(index, CONSUMER_TIME | PRODUCER_TIME)
}

/// Checks the rule for writing 0x1016: no node may be watched twice (CiA 301, 7.5.2.19).
pub(crate) fn check_write(
    dictionary: &ObjectDictionary,
    index: u16,
    sub_index: u8,
    bytes: &[u8],
) -> Accepted {
    let Ok(bytes) = <[u8; 4]>::try_from(bytes) else {
        return Ok(());
    };
    let Some((node_id, _)) = decode_consumer_time(u32::from_le_bytes(bytes)) else {
        return Ok(());
    };
    let watches = |other: u8| {
        let value = dictionary.unsigned(CONSUMER_TIME, other).unwrap_or(0);
        other != sub_index && decode_consumer_time(value).is_some_and(|(id, _)| id == node_id)
    };
    if index == CONSUMER_TIME && (1..=monitor_count(dictionary)).any(watches) {
        return Err(AbortCode::PARAMETER_INCOMPATIBLE);
    }
    Ok(())
}

/// Decodes the heartbeat of a node.
pub(crate) fn decode(id: u16, data: &[u8]) -> Option<(NodeId, NmtState)> {
    let node_id = NodeId::new(u8::try_from(id.checked_sub(ERROR_CONTROL_ID)?).ok()?)?;
    let [state] = *data else { return None };
    Some((node_id, NmtState::from_number(state & 0x7F)?))
}

/// Producer of the node's heartbeat: every 0x1017 milliseconds, and at once when that is written and when the state changes.
#[derive(Clone, Debug, Default)]
pub(crate) struct HeartbeatProducer {
    period: Option<Duration>,
    next: Option<Duration>,
}

impl HeartbeatProducer {
    /// Starts again with the dictionary's period; the first heartbeat is due at `first`.
    pub(crate) fn start(&mut self, dictionary: &ObjectDictionary, first: Duration) {
        let milliseconds = dictionary.unsigned(PRODUCER_TIME, 0).unwrap_or(0);
        self.period = (milliseconds != 0).then(|| Duration::from_millis(u64::from(milliseconds)));
        self.next = self.period.map(|_| first);
    }

    /// Starts again one period after the boot-up message, which counts as the first heartbeat.
    pub(crate) fn start_after_boot_up(&mut self, dictionary: &ObjectDictionary, now: Duration) {
        self.start(dictionary, now);
        self.next = self.period.map(|period| now + period);
    }

    /// Checks whether a heartbeat is due; the next one is due a multiple of the period after this one's deadline.
    pub(crate) fn is_due(&mut self, now: Duration) -> bool {
        let (Some(period), Some(due)) = (self.period, self.next.filter(|due| now >= *due)) else {
            return false;
        };
        let next = due + period;
        self.next = Some(if next > now { next } else { now + period });
        true
    }

    /// Returns the time at which the next heartbeat is due.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.next
    }

    /// Checks whether heartbeats are produced.
    pub(crate) fn is_enabled(&self) -> bool {
        self.period.is_some()
    }

    /// Returns the heartbeat.
    pub(crate) fn frame(node_id: NodeId, state: NmtState) -> CanFrame {
        CanFrame::new(node_id.with(ERROR_CONTROL_ID), &[state.number()])
    }
}

/// Result of a heartbeat for the watch over its node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Watch {
    /// The node is not watched, or its heartbeat came as expected.
    Normal,
    /// The node is back after a loss.
    Recovered,
    /// The node booted although it was alive: its former activity is over.
    Rebooted,
}

/// Entry of 0x1016.
#[derive(Clone, Copy, Debug)]
struct Monitor {
    node_id: NodeId,
    time: Duration,
    /// Deadline of the next heartbeat, until the loss.
    deadline: Option<Duration>,
    /// Whether a heartbeat began the present watch; else the node is only expected.
    is_alive: bool,
    is_lost: bool,
}

/// Consumer of other nodes' heartbeats. The watch over a node begins with its first heartbeat (CiA 301), or when it is expected.
#[derive(Clone, Debug, Default)]
pub(crate) struct HeartbeatConsumer {
    monitors: Vec<Option<Monitor>>,
}

impl HeartbeatConsumer {
    /// Forgets the received heartbeats and reads 0x1016.
    pub(crate) fn reset(&mut self, dictionary: &ObjectDictionary) {
        let entries =
            (1..=monitor_count(dictionary)).map(|sub_index| monitor(dictionary, sub_index));
        self.monitors.clear();
        self.monitors.extend(entries);
    }

    /// Reads one entry again after a write. If its node is under watch, the new time counts from `now`. The node that the entry
    /// watched before is returned, so that its loss can be ended.
    pub(crate) fn configure(
        &mut self,
        now: Duration,
        dictionary: &ObjectDictionary,
        sub_index: u8,
    ) -> Option<NodeId> {
        let place = usize::from(sub_index).checked_sub(1)?;
        let slot = self.monitors.get_mut(place)?;
        let old = slot.take();
        *slot = monitor(dictionary, sub_index);
        if let (Some(old), Some(new)) = (old, slot.as_mut())
            && old.node_id == new.node_id
        {
            (new.is_lost, new.is_alive) = (old.is_lost, old.is_alive);
            new.deadline = old.deadline.map(|_| now + new.time);
            return None;
        }
        old.map(|old| old.node_id)
    }

    /// Checks whether an entry names the node.
    pub(crate) fn watches(&self, node_id: NodeId) -> bool {
        let mut monitors = self.monitors.iter().flatten();
        monitors.any(|monitor| monitor.node_id == node_id)
    }

    /// Begins the watch over the nodes that are not under watch, before their first heartbeat. A boot-up begins it again.
    pub(crate) fn expect(&mut self, now: Duration) {
        for monitor in self.monitors.iter_mut().flatten() {
            monitor.deadline.get_or_insert(now + monitor.time);
        }
    }

    /// Ends the watch over the nodes that were expected and not heard.
    pub(crate) fn forget_expected(&mut self) {
        let monitors = self.monitors.iter_mut().flatten();
        for monitor in monitors.filter(|monitor| !monitor.is_alive) {
            monitor.deadline = None;
        }
    }

    /// Notes a heartbeat.
    pub(crate) fn on_heartbeat(
        &mut self,
        now: Duration,
        node_id: NodeId,
        state: NmtState,
    ) -> Watch {
        let mut monitors = self.monitors.iter_mut().flatten();
        let Some(monitor) = monitors.find(|monitor| monitor.node_id == node_id) else {
            return Watch::Normal;
        };
        if state == NmtState::Initialising {
            let was_alive = std::mem::take(&mut monitor.is_alive);
            // A node that is expected has its time again from here on.
            let is_expected = monitor.deadline.is_some() && !was_alive;
            monitor.deadline = is_expected.then(|| now + monitor.time);
            monitor.is_lost |= was_alive;
            return if was_alive {
                Watch::Rebooted
            } else {
                Watch::Normal
            };
        }
        monitor.deadline = Some(now + monitor.time);
        monitor.is_alive = true;
        if std::mem::take(&mut monitor.is_lost) {
            Watch::Recovered
        } else {
            Watch::Normal
        }
    }

    /// Returns a node whose time has passed; each loss is returned once.
    pub(crate) fn next_lost(&mut self, now: Duration) -> Option<NodeId> {
        let mut monitors = self.monitors.iter_mut().flatten();
        let is_overdue =
            |monitor: &&mut Monitor| monitor.deadline.is_some_and(|deadline| now >= deadline);
        let monitor = monitors.find(is_overdue)?;
        monitor.deadline = None;
        monitor.is_alive = false;
        monitor.is_lost = true;
        Some(monitor.node_id)
    }

    /// Returns the time at which the next node's time passes.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        let monitors = self.monitors.iter().flatten();
        earliest(monitors.map(|monitor| monitor.deadline))
    }
}

/// Returns the number of sub-indices of 0x1016, without gaps from 1.
fn monitor_count(dictionary: &ObjectDictionary) -> u8 {
    let exists = |sub_index: &u8| dictionary.find(CONSUMER_TIME, *sub_index).is_ok();
    (1..=127).take_while(exists).last().unwrap_or(0)
}

/// Reads an entry of 0x1016 that watches a node.
fn monitor(dictionary: &ObjectDictionary, sub_index: u8) -> Option<Monitor> {
    let value = dictionary.unsigned(CONSUMER_TIME, sub_index)?;
    let (node_id, time) = decode_consumer_time(value)?;
    Some(Monitor {
        node_id,
        time,
        deadline: None,
        is_alive: false,
        is_lost: false,
    })
}

/// Decodes the node-ID in bits 16 to 23 and the milliseconds in bits 0 to 15; `None` if the entry is unused (CiA 301, figure 71).
fn decode_consumer_time(value: u32) -> Option<(NodeId, Duration)> {
    let [low, high, node_id, reserved] = value.to_le_bytes();
    let milliseconds = u16::from_le_bytes([low, high]);
    let node_id = NodeId::new(node_id).filter(|_| milliseconds != 0 && reserved == 0)?;
    Some((node_id, Duration::from_millis(u64::from(milliseconds))))
}
