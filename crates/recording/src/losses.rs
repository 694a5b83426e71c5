//! Losses: messages that stopped coming, namely SYNC, the drive's position and heartbeats, judged by the recording alone.

use std::time::Duration;

use can::CanFrame;
use dbc::names;
use plan::ControlLoop;
use scenario::node::{LoopNodes, Part};

use crate::events::{Event, Events, Level};
use crate::identifiers::ByIdentifier;
use crate::node_names::NodeNames;
use crate::occurrences::Notes;

/// Number of periods without a cyclic frame that count as a loss, as for the controller.
pub(crate) const PERIODS_MAX: u32 = 20;
/// Number of periods without a heartbeat that count as a loss; the nodes wait as long (0x1016).
const HEARTBEATS_MAX: u32 = 5;

/// Time in which the heartbeat of a node did not come for longer than the others wait for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostHeartbeat {
    pub node: Part,
    /// Scenario time at which the first missing heartbeat was due.
    pub due_seconds: f64,
    /// Scenario time of the next heartbeat; infinite if none came.
    pub back_seconds: f64,
}

/// Message that must keep coming.
struct Watched {
    /// Name for the user.
    what: String,
    /// Node of this heartbeat, if the others stop without it.
    heartbeat_sender: Option<Part>,
    /// Whether it carries the temperature of the plant; its loss has no consequence.
    is_temperature: bool,
    period: Duration,
    limit: Duration,
    /// Scenario time of the last one.
    last: Option<Duration>,
}

impl Watched {
    /// Returns the time at which the first missing frame after `last` was due.
    fn due(&self, last: Duration) -> Duration {
        last + self.period
    }

    /// Returns the heartbeat that was lost from the last one until a scenario time.
    fn lost(&self, back_seconds: f64) -> Option<LostHeartbeat> {
        // A heartbeat that was never heard in the scenario is not missed.
        let last = self.last.filter(|last| !last.is_zero())?;
        Some(LostHeartbeat {
            node: self.heartbeat_sender?,
            due_seconds: self.due(last).as_secs_f64(),
            back_seconds,
        })
    }
}

/// Reader that watches for losses from the start of the scenario to its end.
pub(crate) struct LossReader {
    watched: ByIdentifier<Watched>,
    end: Duration,
    /// Events with scenario times.
    events: Notes<Event>,
    heartbeats: Vec<LostHeartbeat>,
    temperature_silence: Option<(f64, f64)>,
}

impl LossReader {
    pub(crate) fn new(one: &ControlLoop, node_names: &NodeNames) -> Self {
        let scenario = &one.trial;
        let (controller, drive) = (node_names.controller(), node_names.drive());
        let LoopNodes {
            controller: leader,
            drive: led,
            io,
            ..
        } = &one.nodes;
        let of = |node, service| one.message(node, service).ok();
        let sync_period = scenario.run.bus.sync_period();
        let cyclic_limit = PERIODS_MAX * sync_period;
        let sync = one.database.message(names::SYNC);
        let position = of(led, names::TPDO1);
        let temperature = of(led, names::TPDO2);
        let heartbeat = |node| of(node, names::HEARTBEAT);
        let cyclic = [
            (sync, format!("SYNC from {controller}")),
            (position, format!("position from {drive}")),
            (temperature, String::new()),
        ]
        .map(|(message, what)| (message, what, Some(cyclic_limit), None));
        let heartbeats = [
            (heartbeat(leader), controller, Some(Part::Controller)),
            (heartbeat(led), drive, Some(Part::Drive)),
        ];
        let io_nodes = io.iter().map(|io| (heartbeat(io), io.in_sentence(), None));
        let heartbeats = heartbeats
            .into_iter()
            .chain(io_nodes)
            .map(|(message, from, node)| (message, format!("heartbeat from {from}"), None, node));
        let regular = cyclic.into_iter().chain(heartbeats);
        let watched = regular.filter_map(|(message, what, limit, heartbeat_sender)| {
            let message = message?;
            let heartbeat_period = Duration::from_millis(message.cycle_time_milliseconds);
            let period = limit.map_or(heartbeat_period, |_| sync_period);
            let watched = Watched {
                heartbeat_sender,
                is_temperature: what.is_empty(),
                what,
                period,
                limit: limit.unwrap_or(HEARTBEATS_MAX * period),
                last: None,
            };
            Some((message.raw_id, watched))
        });
        Self {
            watched: watched.collect(),
            end: Duration::from_secs_f64(scenario.run.duration_seconds),
            events: Notes::default(),
            heartbeats: Vec::new(),
            temperature_silence: None,
        }
    }

    /// Returns the identifiers of the messages that are watched.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.watched.raw_ids()
    }

    /// Takes a frame of a watched message.
    pub(crate) fn on_frame(&mut self, frame: &CanFrame, time: Duration) {
        if time > self.end {
            return;
        }
        let Some(watched) = self.watched.get_mut(frame.raw_id()) else {
            return;
        };
        let last = *watched.last.get_or_insert_default();
        if time.saturating_sub(last) > watched.limit {
            if watched.is_temperature {
                let silence = (last.as_secs_f64(), time.as_secs_f64());
                self.temperature_silence.get_or_insert(silence);
                watched.last = Some(time);
                return;
            }
            let what = &watched.what;
            let silent = time.saturating_sub(last);
            let text = format!("loss: no {what} for {} ms", silent.as_millis());
            let loss = Event::new(Level::Error, &text);
            self.events.add(watched.due(last).as_secs_f64(), loss);
            let back = Event::new(Level::Info, &format!("{what} is back"));
            self.events.add(time.as_secs_f64(), back);
            self.heartbeats.extend(watched.lost(time.as_secs_f64()));
        }
        watched.last = Some(time);
    }

    /// Takes all losses, with those that last; `latest` is the scenario time of the last frame before the end.
    pub(crate) fn take_all(&mut self, latest: Duration) -> Events {
        for watched in self.watched.values() {
            let Some(last) = watched.last else { continue };
            if latest.saturating_sub(last) <= watched.limit {
                continue;
            }
            if watched.is_temperature {
                let silence = (last.as_secs_f64(), latest.as_secs_f64());
                self.temperature_silence.get_or_insert(silence);
            } else {
                let text = format!("loss: no {} from here on", watched.what);
                let loss = Event::new(Level::Error, &text);
                self.events.add(watched.due(last).as_secs_f64(), loss);
                self.heartbeats.extend(watched.lost(f64::INFINITY));
            }
        }
        self.events.take_since(0.0)
    }

    /// Returns the first stretch of time in which no temperature was sent, after [`LossReader::take_all`].
    pub(crate) fn temperature_silence(&self) -> Option<(f64, f64)> {
        self.temperature_silence
    }

    /// Takes the heartbeats that did not come, after [`LossReader::take_all`].
    pub(crate) fn take_heartbeats(&mut self) -> Vec<LostHeartbeat> {
        std::mem::take(&mut self.heartbeats)
    }
}
