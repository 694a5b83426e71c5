//! Losses: messages that stopped coming, namely SYNC, the drive's position and heartbeats, judged by the recording alone.

use std::time::Duration;

use can::CanFrame;
use dbc::{Database, Message, names};
use plan::{ControlLoop, message_of};
use scenario::node::NodeIndex;

use crate::events::{Event, Level};
use crate::identifiers::ByIdentifier;
use crate::occurrences::Notes;
use crate::truth::is_temperature;

/// Number of periods without a cyclic frame that count as a loss, as for the controller.
pub(crate) const PERIODS_MAX: u32 = 20;
/// Number of periods without a heartbeat that count as a loss; the nodes wait as long (0x1016).
pub const HEARTBEATS_MAX: u32 = 5;

/// Time in which the heartbeat of a node did not come for longer than the others wait for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostHeartbeat {
    pub node: NodeIndex,
    /// Scenario time at which the first missing heartbeat was due.
    pub due_seconds: f64,
    /// Scenario time of the next heartbeat; infinite if none came.
    pub back_seconds: f64,
}

/// Message that must keep coming.
struct Watched {
    /// Name for the user; empty for the temperature of the plant, whose loss has no consequence.
    what: String,
    /// Node of this heartbeat, if the others stop without it.
    heartbeat_sender: Option<NodeIndex>,
    period: Duration,
    limit: Duration,
    /// Scenario time of the last one.
    last: Option<Duration>,
}

/// Losses of a run.
#[derive(Default)]
pub(crate) struct Losses {
    /// Events with scenario times.
    pub(crate) events: Notes<Event>,
    /// Heartbeats that did not come.
    pub(crate) heartbeats: Vec<LostHeartbeat>,
    /// First stretch of time in which no temperature was sent.
    pub(crate) temperature_silence: Option<(f64, f64)>,
}

/// Reader that watches for losses from the start of the scenario to its end.
pub(crate) struct LossReader {
    watched: ByIdentifier<Watched>,
    end: Duration,
    losses: Losses,
}

impl LossReader {
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Self {
        let sync_period = one.trial.run.bus.sync_period();
        let [controller, drive] = one.both().map(|node| one.node(node).in_sentence());
        let signal = &one.trial.wiring.sensor.quantity.name;
        let drives = |service| message_of(database, one.drive(), service).ok();
        let watch = |message: &Message, what, heartbeat_sender, period, periods_max: u32| {
            let watched = Watched {
                what,
                heartbeat_sender,
                period,
                limit: periods_max * period,
                last: None,
            };
            (message.raw_id, watched)
        };
        let cyclic = [
            (
                database.message(names::SYNC),
                format!("SYNC from {controller}"),
            ),
            (drives(names::TPDO1), format!("{signal} from {drive}")),
        ]
        .map(|(message, what)| Some(watch(message?, what, None, sync_period, PERIODS_MAX)));
        let of_plant = database.plant_messages(&one.drive().name);
        let period = sync_period * u32::from(one.trial.wiring.truth_every_cycles());
        let truth = |message| Some(watch(message, String::new(), None, period, PERIODS_MAX));
        let is_heated = |message: &&Message| message.signals.iter().any(is_temperature);
        let heated = of_plant.filter(is_heated).map(truth);
        let heartbeats = one.trial.wiring.all_nodes().map(|index| {
            let node = one.node(index);
            let message = message_of(database, node, names::HEARTBEAT).ok()?;
            let period = Duration::from_millis(message.cycle_time_milliseconds);
            let what = format!("heartbeat from {}", node.in_sentence());
            let sender = Some(index).filter(|index| one.both().contains(index));
            Some(watch(message, what, sender, period, HEARTBEATS_MAX))
        });
        let watched = cyclic.into_iter().chain(heated).chain(heartbeats);
        Self {
            watched: watched.flatten().collect(),
            end: Duration::from_secs_f64(one.trial.run.duration_seconds),
            losses: Losses::default(),
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
            self.losses.add(watched, last, time, true);
        }
        watched.last = Some(time);
    }

    /// Takes all losses, with those that last; `latest` is the scenario time of the last frame before the end.
    pub(crate) fn take_all(&mut self, latest: Duration) -> Losses {
        for watched in self.watched.values() {
            let is_lost = |last: &Duration| latest.saturating_sub(*last) > watched.limit;
            if let Some(last) = watched.last.filter(is_lost) {
                self.losses.add(watched, last, latest, false);
            }
        }
        std::mem::take(&mut self.losses)
    }
}

impl Losses {
    /// Adds a loss from the last message to a time, at which the next one came or the recording ended.
    fn add(&mut self, watched: &Watched, last: Duration, until: Duration, is_back: bool) {
        let until_seconds = until.as_secs_f64();
        if watched.what.is_empty() {
            let silence = (last.as_secs_f64(), until_seconds);
            self.temperature_silence.get_or_insert(silence);
            return;
        }
        let what = &watched.what;
        let due_seconds = (last + watched.period).as_secs_f64();
        let text = if is_back {
            format!("loss: no {what} for {} ms", (until - last).as_millis())
        } else {
            format!("loss: no {what} from here on")
        };
        let loss = Event::new(Level::Error, &text);
        self.events.add(due_seconds, loss);
        if is_back {
            let back = Event::new(Level::Info, &format!("{what} is back"));
            self.events.add(until_seconds, back);
        }
        // A heartbeat that was never heard in the scenario is not missed.
        if let Some(node) = watched.heartbeat_sender.filter(|_| !last.is_zero()) {
            let back_seconds = if is_back {
                until_seconds
            } else {
                f64::INFINITY
            };
            self.heartbeats.push(LostHeartbeat {
                node,
                due_seconds,
                back_seconds,
            });
        }
    }
}
