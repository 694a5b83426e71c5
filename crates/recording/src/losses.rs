//! What fell silent: SYNC, the drive's position, heartbeats; by the recording alone.

use std::time::Duration;

use canopen::CanFrame;
use dbc::Database;
use scenario::Scenario;

use crate::events::{Event, Events, Level};
use crate::identifiers::ByIdentifier;
use crate::node_words::NodeWords;
use crate::occurrences::Notes;

/// Periods without a cyclic frame that count as a loss, as for the controller.
pub(crate) const PERIODS_MAX: u32 = 20;
/// Periods without a heartbeat that count as a loss; the nodes wait as long (0x1016).
const HEARTBEATS_MAX: u32 = 5;

/// One message that must keep coming.
struct Watched {
    /// For people.
    what: String,
    limit: Duration,
    /// In scenario time.
    last: Option<Duration>,
}

/// Watches from the start of the scenario to its end.
pub(crate) struct LossReader {
    watched: ByIdentifier<Watched>,
    end: Duration,
    /// By scenario time.
    events: Notes<Event>,
}

impl LossReader {
    pub(crate) fn new(scenario: &Scenario, database: &Database, words: &NodeWords) -> Self {
        let (controller, drive, module) = (words.controller(), words.drive(), words.module());
        let cyclic = PERIODS_MAX * scenario.bus.sync_period();
        let cyclic = [
            ("sync", format!("SYNC from {controller}")),
            ("drive_tpdo1", format!("position from {drive}")),
        ]
        .map(|(name, what)| (name, what, Some(cyclic)));
        let heartbeats = [
            (
                "controller_heartbeat",
                format!("heartbeat from {controller}"),
            ),
            ("drive_heartbeat", format!("heartbeat from {drive}")),
            ("disturbance_heartbeat", format!("heartbeat from {module}")),
        ]
        .map(|(name, what)| (name, what, None));
        let regular = cyclic.into_iter().chain(heartbeats);
        let watched = regular.filter_map(|(name, what, limit)| {
            let message = database.message(name)?;
            let period = Duration::from_millis(message.cycle_time_milliseconds);
            let watched = Watched {
                what,
                limit: limit.unwrap_or(HEARTBEATS_MAX * period),
                last: None,
            };
            Some((message.raw_id, watched))
        });
        Self {
            watched: watched.collect(),
            end: Duration::from_secs_f64(scenario.duration_seconds),
            events: Notes::default(),
        }
    }

    /// The identifiers of the messages that are watched.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.watched.raw_ids()
    }

    /// Takes a frame of a message that is watched.
    pub(crate) fn on_frame(&mut self, frame: &CanFrame, time: Duration) {
        if time > self.end {
            return;
        }
        let Some(watched) = self.watched.get_mut(frame.raw_id()) else {
            return;
        };
        let last = watched.last.replace(time).unwrap_or_default();
        let silent = time.saturating_sub(last);
        if silent > watched.limit {
            let what = &watched.what;
            let text = format!("loss: no {what} for {} ms", silent.as_millis());
            let loss = Event::new(Level::Error, &text);
            self.events.add(last.as_secs_f64(), loss);
            let back = Event::new(Level::Info, &format!("{what} is back"));
            self.events.add(time.as_secs_f64(), back);
        }
    }

    /// All losses, those that last among them; `latest` is the scenario time of the last frame of all before the end.
    pub(crate) fn take_all(&mut self, latest: Duration) -> Events {
        for watched in self.watched.values() {
            let Some(last) = watched.last else { continue };
            if latest.saturating_sub(last) > watched.limit {
                let text = format!("loss: no {} from here on", watched.what);
                let loss = Event::new(Level::Error, &text);
                self.events.add(last.as_secs_f64(), loss);
            }
        }
        self.events.take_since(0.0)
    }
}
