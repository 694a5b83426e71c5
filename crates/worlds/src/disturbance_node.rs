//! The bench's own node on the bus: it commands the disturbance module 0x11 as the scenario says, and gives the orders
//! that are faults. Beside a real drive it watches the limits of the rig, and whether anybody else leads.

use std::collections::VecDeque;
use std::time::Duration;

use canopen::{CanFrame, Filter, NmtCommand, Node, NodeId, Progress};
use dbc::{Database, SignalMissing, signals};
use recording::masters::MasterWatch;
use scenario::Scenario;
use scenario::fault::node::Node as FaultyNode;

use crate::supervisor::Supervisor;
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};

/// Sends its frames at the scenario's times.
pub struct DisturbanceProducer {
    clock: ScenarioClock,
    drive: Filter,
    /// What it will send, each with its scenario time in seconds.
    frames: VecDeque<(f64, CanFrame)>,
    frame: Option<CanFrame>,
    supervisor: Option<Supervisor>,
    masters: Option<MasterWatch>,
    second_master: Option<String>,
    is_stopped: bool,
}

impl DisturbanceProducer {
    /// A producer that has sent nothing.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub fn new(scenario: &Scenario, database: &Database) -> Result<Self, SignalMissing> {
        let statusword = database.require(signals::STATUSWORD)?;
        let mut frames = disturbances(scenario, database)?;
        let orders = scenario.fault.node.nmt_stop.iter();
        frames.extend(orders.map(|order| {
            let node = NodeId::new(order.node.number());
            (order.at_seconds, NmtCommand::Stop.frame(node))
        }));
        frames.sort_by(|left, right| left.0.total_cmp(&right.0));
        Ok(Self {
            clock: ScenarioClock::new(database)?,
            drive: Filter {
                id: statusword.raw_id(),
                mask: Filter::exact(0).mask,
            },
            frames: frames.into(),
            frame: None,
            supervisor: None,
            masters: None,
            second_master: None,
            is_stopped: false,
        })
    }

    /// The same with a watch over a real drive.
    #[must_use]
    pub fn with_supervisor(mut self, supervisor: Option<Supervisor>) -> Self {
        self.supervisor = supervisor;
        self
    }

    /// The same with a watch for a second master, at the first frame of which the drive is stopped.
    #[must_use]
    pub fn with_master_watch(mut self, masters: Option<MasterWatch>) -> Self {
        self.masters = masters;
        self
    }

    /// What showed a second master, for people.
    #[must_use]
    pub fn second_master(&self) -> Option<&str> {
        self.second_master.as_deref()
    }

    fn stop_drive(&mut self) {
        match &mut self.supervisor {
            Some(supervisor) => supervisor.stop_drive(),
            None => {
                let drive = NodeId::new(FaultyNode::Drive.number());
                self.frame = Some(NmtCommand::Stop.frame(drive));
            }
        }
    }

    fn watch_masters(&mut self, now: Duration, frame: &CanFrame) {
        let Some(masters) = self
            .masters
            .as_mut()
            .filter(|_| self.second_master.is_none())
        else {
            return;
        };
        masters.on_frame(now, frame);
        if let Some(found) = masters.found().first() {
            self.second_master = Some(found.to_string());
            self.frames.clear();
            self.stop_drive();
        }
    }

    fn is_due(&self, now: Duration) -> bool {
        self.next_deadline().is_some_and(|deadline| deadline <= now)
    }
}

/// The RPDOs of the disturbance module.
fn disturbances(
    scenario: &Scenario,
    database: &Database,
) -> Result<Vec<(f64, CanFrame)>, SignalMissing> {
    let convection_factor = database.require(signals::CONVECTION_FACTOR)?;
    let added_load = database.require(signals::ADDED_LOAD)?;
    let mut message = database
        .builder(signals::DISTURBANCE_MESSAGE)
        .ok_or_else(|| SignalMissing::new(signals::DISTURBANCE_MESSAGE))?;
    let commands = scenario.disturbance.commands().into_iter();
    let frames = commands.map(|command| {
        message.set(&convection_factor, command.convection_factor);
        message.set(&added_load, command.added_grams);
        (command.at_seconds, message.frame())
    });
    Ok(frames.collect())
}

impl Node for DisturbanceProducer {
    /// A node with nothing to send need not know the time.
    fn filters(&self) -> Vec<Filter> {
        let supervisor = self.supervisor.iter().flat_map(Supervisor::filters);
        let mut filters: Vec<Filter> = supervisor.collect();
        filters.extend(self.masters.iter().flat_map(MasterWatch::filters));
        if !self.frames.is_empty() {
            filters.extend([Filter::exact(SYNC_COB_ID), self.drive]);
        }
        filters
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.clock.on_frame(now, frame);
        if let Some(supervisor) = &mut self.supervisor {
            supervisor.on_frame(now, frame);
        }
        self.watch_masters(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        if !self.is_due(now) {
            return;
        }
        self.frame = self.frames.pop_front().map(|(_, frame)| frame);
    }

    fn on_stop(&mut self, _now: Duration) {
        self.is_stopped = true;
        self.frames.clear();
        // Whoever controlled the drive, it is not left running.
        if let Some(supervisor) = &mut self.supervisor {
            supervisor.stop_drive();
        }
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        let supervisor = self.supervisor.as_mut();
        supervisor
            .and_then(Supervisor::next_frame)
            .or_else(|| self.frame.take())
    }

    fn next_deadline(&self) -> Option<Duration> {
        let (at_seconds, _) = self.frames.front()?;
        let zero = self.clock.zero()?;
        Some(zero + Duration::from_secs_f64(*at_seconds))
    }

    fn progress(&self) -> Progress {
        let supervisor = self.supervisor.as_ref();
        if let Some(violation) = supervisor.and_then(Supervisor::violation) {
            Progress::Failed(violation.to_string())
        } else if let Some(second_master) = &self.second_master {
            Progress::Failed(second_master.clone())
        } else if self.is_stopped {
            Progress::Stopped
        } else {
            Progress::Running
        }
    }
}
