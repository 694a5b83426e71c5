//! The bench's own voice on the bus: it commands the disturbance module 0x11 as the scenario says.

use std::collections::VecDeque;
use std::time::Duration;

use canopen::{CanFrame, Filter, Node, Progress};
use dbc::{Database, MessageBuilder, SignalHandle};
use scenario::Scenario;
use scenario::events::DisturbanceCommand;

use crate::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use crate::signals::{self, SignalMissing};

/// Sends the RPDO of the disturbance module at the scenario's times.
pub struct DisturbanceProducer {
    message: MessageBuilder,
    convection_factor: SignalHandle,
    added_load: SignalHandle,
    clock: ScenarioClock,
    drive: Filter,
    commands: VecDeque<DisturbanceCommand>,
    frame: Option<CanFrame>,
    is_stopped: bool,
}

impl DisturbanceProducer {
    /// A producer that has sent nothing.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn new(scenario: &Scenario, database: &Database) -> Result<Self, SignalMissing> {
        let statusword = signals::find(database, signals::STATUSWORD)?;
        Ok(Self {
            message: database
                .builder(signals::DISTURBANCE_MESSAGE)
                .ok_or_else(|| signals::missing(signals::DISTURBANCE_MESSAGE))?,
            convection_factor: signals::find(database, signals::CONVECTION_FACTOR)?,
            added_load: signals::find(database, signals::ADDED_LOAD)?,
            clock: ScenarioClock::new(database)?,
            drive: Filter {
                id: statusword.raw_id(),
                mask: Filter::exact(0).mask,
            },
            commands: scenario.disturbance.commands().into(),
            frame: None,
            is_stopped: false,
        })
    }

    fn is_due(&self, now: Duration) -> bool {
        self.next_deadline().is_some_and(|deadline| deadline <= now)
    }
}

impl Node for DisturbanceProducer {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::exact(SYNC_COB_ID), self.drive]
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.clock.on_frame(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        if !self.is_due(now) {
            return;
        }
        if let Some(command) = self.commands.pop_front() {
            self.message
                .set(&self.convection_factor, command.convection_factor);
            self.message.set(&self.added_load, command.added_grams);
            self.frame = Some(self.message.frame());
        }
    }

    fn on_stop(&mut self, _now: Duration) {
        self.is_stopped = true;
        self.commands.clear();
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.frame.take()
    }

    fn next_deadline(&self) -> Option<Duration> {
        let command = self.commands.front()?;
        let zero = self.clock.zero()?;
        Some(zero + Duration::from_secs_f64(command.at_seconds))
    }

    fn progress(&self) -> Progress {
        if self.is_stopped {
            Progress::Stopped
        } else {
            Progress::Running
        }
    }
}
