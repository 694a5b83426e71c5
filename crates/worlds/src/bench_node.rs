//! Node of the bench on the bus. It commands the disturbance modules of all loops by the scenario, and sends the orders that are
//! faults. To a controller that does not know the scenario it sends the set-points. With a real drive it watches the limits of
//! the rig.

use std::collections::VecDeque;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use canopen::{NmtCommand, NodeId};
use dbc::Database;
use dbc::names::{RPDO1, SET_POINT, message as message_name, set_point};
use dbc::{MessageBuilder, SignalHandle, SignalMissing};
use plan::{ControlLoop, Plan};
use scenario::disturbance::{Change, value_at};
use scenario::wiring::IoOutput;

use crate::error::WorldError;
use crate::supervisor::Supervisor;
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use scenario::reference::Trajectory;
use scenario::{cycle_start_seconds, nearest_cycle};

/// Reserved number of frames, enough to stop as many real drives as a rig may have.
const FRAMES_AT_ONCE: usize = 64;

/// Node that sends its frames at the scenario's times.
pub struct BenchNode {
    clock: ScenarioClock,
    /// Frames to send, each with its scenario time in seconds.
    frames: VecDeque<(f64, CanFrame)>,
    /// Frames to send now.
    due: VecDeque<CanFrame>,
    set_points: SetPoints,
    /// Supervisors of the real drives.
    supervisors: Vec<Supervisor>,
    /// Name of the drive that violated a limit first, and the limit.
    violation: Option<(String, String)>,
    is_stopped: bool,
}

impl BenchNode {
    /// Makes the bench's node on the bus of these loops, before its first frame. At the first violation of a limit of a real
    /// drive it stops all real drives.
    ///
    /// # Errors
    /// If the database lacks a signal.
    ///
    /// # Panics
    /// If there is no loop.
    pub fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let mut frames = Vec::new();
        // On a bus without an io node its identifier may belong to another node.
        for (io, outputs) in plan.io_on_bus() {
            frames.extend(disturbances(plan, &plan.nodes[*io], outputs)?);
        }
        frames.extend(stop_orders(plan));
        frames.sort_by(|left, right| left.0.total_cmp(&right.0));
        let loops = plan.loops.iter();
        let real_drives = loops.filter(|one| one.drive().is_external());
        Ok(Self {
            clock: plan.scenario_clock()?,
            frames: frames.into(),
            due: VecDeque::with_capacity(FRAMES_AT_ONCE),
            set_points: SetPoints::new(plan)?,
            supervisors: real_drives.map(Supervisor::new).collect(),
            violation: None,
            is_stopped: false,
        })
    }

    /// Returns the violation of a limit after which it stopped all real drives.
    pub(crate) fn violation(&self) -> Option<WorldError> {
        let (drive, violation) = self.violation.clone()?;
        Some(WorldError::Violation { drive, violation })
    }

    fn stop_drives(&mut self) {
        for drive in &self.supervisors {
            self.due.extend(drive.stop());
        }
    }

    fn watch_limits(&mut self, now: Duration, frame: &CanFrame) {
        if self.violation.is_some() {
            return;
        }
        let violation = self.supervisors.iter_mut().find_map(|drive| {
            let violation = drive.check(now, frame)?;
            Some((drive.name.clone(), violation))
        });
        if violation.is_some() {
            self.violation = violation;
            self.stop_drives();
        }
    }
}

/// Set-points that the bench sends, each after a SYNC for the next one: it acts with the SYNC.
struct SetPoints {
    period: Duration,
    every_cycles: u64,
    loops: Vec<SentSetPoint>,
}

struct SentSetPoint {
    trajectory: Trajectory,
    frame: MessageBuilder,
    value: SignalHandle,
    rate: SignalHandle,
}

impl SetPoints {
    fn new(plan: &Plan) -> Result<Self, SignalMissing> {
        let every_cycles = plan.set_points_every_cycles();
        let loops = plan.loops.iter();
        let sent = loops.filter(|one| every_cycles.is_some() && one.has_set_point());
        Ok(Self {
            period: plan.sync_period(),
            every_cycles: every_cycles.unwrap_or(1).into(),
            loops: sent
                .map(|one| SentSetPoint::new(plan.database(), one))
                .collect::<Result<_, _>>()?,
        })
    }

    /// Returns the frames after a SYNC at this scenario time, with the values for the next SYNC; before the scenario, those of
    /// time 0.
    fn behind_sync(&mut self, time: Option<Duration>) -> impl Iterator<Item = CanFrame> {
        let cycle = time.map(|time| nearest_cycle(time, self.period));
        let is_due = cycle.is_none_or(|cycle| cycle % self.every_cycles == 0);
        let at_seconds = cycle.map_or(0.0, |cycle| cycle_start_seconds(cycle + 1, self.period));
        let due = self.loops.iter_mut().filter(move |_| is_due);
        due.map(move |one| one.frame(at_seconds))
    }
}

impl SentSetPoint {
    fn new(database: &Database, one: &ControlLoop) -> Result<Self, SignalMissing> {
        let message = set_point(one.name());
        let value = one.trial.wiring.quantities.name(SET_POINT);
        Ok(Self {
            trajectory: one.trial.reference.trajectory(),
            frame: database.builder(&message)?,
            value: database.signal_of(&message, &value)?,
            rate: database.signal_of(&message, &format!("{value}_per_second"))?,
        })
    }

    fn frame(&mut self, at_seconds: f64) -> CanFrame {
        let wanted = self.trajectory.at(at_seconds);
        self.frame.set(&self.value, wanted.position);
        self.frame.set(&self.rate, wanted.velocity);
        self.frame.frame()
    }
}

/// Returns the NMT stops that are faults of the scenario, each with its scenario time.
fn stop_orders(plan: &Plan) -> impl Iterator<Item = (f64, CanFrame)> {
    let orders = plan.shared.run.faults.of("nmt_stop");
    orders.filter_map(|order| {
        let node = NodeId::new(plan.nodes[order.node?].id());
        Some((order.from_seconds?, NmtCommand::Stop.frame(node)))
    })
}

/// Returns the RPDOs of an io node with these outputs.
fn disturbances(
    plan: &Plan,
    io: &scenario::node::Node,
    outputs: &[IoOutput],
) -> Result<Vec<(f64, CanFrame)>, SignalMissing> {
    let mut changes = plan.shared.run.disturbance.changes();
    changes.retain(|change| change.node == io.name);
    let edges = |change: &Change| [change.window.from_seconds, change.window.until_seconds];
    let mut times = Vec::from_iter(changes.iter().flat_map(edges));
    times.sort_by(f64::total_cmp);
    times.dedup();
    if times.is_empty() {
        return Ok(Vec::new());
    }
    let (database, message) = (plan.database(), message_name(&io.name, RPDO1));
    let outputs = outputs.iter().map(|output| {
        let signal = database.signal_of(&message, &output.port.name)?;
        Ok((&output.port, signal))
    });
    let outputs = outputs.collect::<Result<Vec<_>, SignalMissing>>()?;
    let mut builder = database.builder(&message)?;
    let frames = times.into_iter().map(|at_seconds| {
        for (port, signal) in &outputs {
            let value = value_at(&changes, &port.name, at_seconds);
            builder.set(signal, value.unwrap_or(port.at_rest));
        }
        (at_seconds, builder.frame())
    });
    Ok(frames.collect())
}

impl Node for BenchNode {
    /// Leaves out the clock's frames for a node with nothing to send, which need not know the time.
    fn filters(&self) -> Vec<Filter> {
        let supervisors = self.supervisors.iter();
        let mut filters = Vec::from_iter(supervisors.flat_map(Supervisor::filters));
        let has_orders = !self.frames.is_empty() || !self.set_points.loops.is_empty();
        if has_orders || !self.supervisors.is_empty() {
            filters.extend(self.clock.filters());
        }
        filters
    }

    fn silent_filters(&self) -> Vec<Filter> {
        if self.supervisors.is_empty() {
            self.clock.silent_filters().collect()
        } else {
            Vec::new()
        }
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.clock.on_frame(now, frame);
        if frame.standard_id() == Some(SYNC_COB_ID) && !self.is_stopped {
            let time = self.clock.scenario_time(now);
            self.due.extend(self.set_points.behind_sync(time));
        }
        self.watch_limits(now, frame);
    }

    fn on_tick(&mut self, now: Duration) {
        if self.next_deadline().is_some_and(|deadline| deadline <= now) {
            let due = self.frames.pop_front();
            self.due.extend(due.map(|(_, frame)| frame));
        }
    }

    fn on_stop(&mut self, _now: Duration) {
        self.is_stopped = true;
        self.frames.clear();
        // The drives are not left running, whether or not this node controlled them.
        self.stop_drives();
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.due.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        let (at_seconds, _) = self.frames.front()?;
        let zero = self.clock.zero()?;
        Some(zero + Duration::from_secs_f64(*at_seconds))
    }

    fn progress(&self) -> Progress {
        if let Some((_, violation)) = self.violation.as_ref().filter(|_| self.due.is_empty()) {
            Progress::Failed(violation.clone())
        } else if self.is_stopped {
            Progress::Stopped
        } else {
            Progress::Running
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use plan::catalogue::Catalogue;
    use scenario::Beside;

    use super::*;

    /// Returns the plan of a real drive with this node-ID.
    fn real(node_id: u8) -> Plan {
        let text = "schema = 1\nrig = \"rig.toml\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let rig = format!(
            "schema = 1\nname = \"bench\"\n[node.controller]\nkind = \"controller\"\nnode_id = 1\n[node.drive]\nkind = \"drive\"\n\
             node_id = {node_id}\nlimits = {{ current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }}\n\
             [loop.position]\nfeedback = \"drive.position\"\noutputs = [\"drive.current\"]\n"
        );
        let beside = Beside::new(Path::new("t.toml"));
        let read = |_: &str| Ok(rig.clone());
        Plan::parse(&beside, text.to_owned(), read, &Catalogue::shipped()).unwrap()
    }

    fn position(node_id: u16, micrometres: i32) -> CanFrame {
        let mut data = [0x37, 2, 0, 0, 0, 0, 0, 0];
        data[2..6].copy_from_slice(&micrometres.to_le_bytes());
        CanFrame::new(0x180 + node_id, &data)
    }

    fn sent(bench: &mut BenchNode) -> Vec<CanFrame> {
        std::iter::from_fn(|| bench.next_frame()).collect()
    }

    #[test]
    fn a_violated_limit_stops_all_real_drives_at_once_and_only_once() {
        let mut plan = real(0x10);
        plan.loops.extend(real(0x12).loops);
        let mut bench = BenchNode::new(&plan).unwrap();
        let stop = [
            CanFrame::new(0x210, &[2, 0, 0, 0]),
            CanFrame::new(0x000, &[2, 0x10]),
            CanFrame::new(0x212, &[2, 0, 0, 0]),
            CanFrame::new(0x000, &[2, 0x12]),
        ];
        let times = (0..).map(|cycle| Duration::from_millis(10) * cycle);
        let outside = position(0x12, 46_000);
        for (now, frame) in times.zip([position(0x10, 10_000), outside, outside]) {
            bench.on_frame(now, &frame);
        }
        assert_eq!(bench.progress(), Progress::Running, "until it has sent all");
        assert_eq!(sent(&mut bench), stop);
        let Progress::Failed(text) = bench.progress() else {
            panic!("it goes on")
        };
        assert!(text.starts_with("limit of the rig: "), "{text}");
    }
}
