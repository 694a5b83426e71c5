//! Collection of host stalls of the nodes' processes, during a run in real time.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::time::Duration;

use plan::Plan;
use platform::stall_watch::{SeenStall, StallWatch};
use recording::latency::NodeReport;
use recording::stalls::{NodeName, Stall, What, Who};

use crate::bus_connection::BusConnection;
use crate::child::NodeProcess;
use crate::error::WorldError;
use crate::names::BENCH;
use crate::processes::Processes;
use crate::senders::Senders;

/// Name of the thread that carries the frames of an embedded bus.
const HUB_THREAD: &str = "hub";

/// Watch over the machine during one run.
pub(super) struct StallRecorder<'a> {
    watch: StallWatch<Who>,
    plan: &'a Plan,
    /// Names of the nodes whose processes canrig did not start, and has not found yet.
    expected: RefCell<Vec<String>>,
    /// Half a SYNC period: a shorter stall makes no cycle miss.
    longer_than: Duration,
}

impl<'a> StallRecorder<'a> {
    /// # Errors
    /// If no thread can be started.
    pub(super) fn start(plan: &'a Plan, processes: &Processes) -> Result<Self, WorldError> {
        let longer_than = plan.sync_period() / 2;
        let watch = StallWatch::start(longer_than).map_err(WorldError::spawn(BENCH))?;
        watch.watch(Who::Bus, std::process::id(), Some(HUB_THREAD));
        let recorder = Self {
            watch,
            plan,
            expected: RefCell::new(plan.expected_names()),
            longer_than,
        };
        for process in &processes.all {
            recorder.watch(process);
        }
        Ok(recorder)
    }

    /// Watches the process of a node, too.
    pub(super) fn watch(&self, process: &NodeProcess) {
        let who = who(process.name(), self.plan);
        self.watch.watch(who, process.number(), None);
    }

    /// Watches the processes of nodes that canrig did not start, once they are heard on an embedded bus.
    pub(super) fn watch_heard(&self, senders: &Senders) {
        self.expected.borrow_mut().retain(|name| {
            let process = senders.process_of(name);
            if let Some(process) = process {
                self.watch.watch(who(name, self.plan), process, None);
            }
            process.is_none()
        });
    }

    /// Returns all observed stalls, and the late wake-ups that the nodes' own loops report, on the clock of the recording.
    pub(super) fn finish(
        self,
        connection: &BusConnection,
        reports: &mut BTreeMap<String, NodeReport>,
    ) -> Vec<Stall> {
        let stall = |who, what, times: [Duration; 2]| {
            let [from, until] = times.map(|time| connection.recorded_time(time));
            Stall::new(from, until, who, what)
        };
        let mut stalls = Vec::new();
        for SeenStall { who, from, until } in self.watch.stop() {
            stalls.push(match who {
                None => stall(Who::Machine, What::StoodStill, [from, until]),
                Some(who) => stall(who, What::Waited, [from, until]),
            });
        }
        for (name, report) in reports {
            let late = std::mem::take(&mut report.late).into_iter();
            let late = late.map(|times| times.map(Duration::from_nanos));
            let long = late.filter(|[from, until]| *until > *from + self.longer_than);
            let who = who(name, self.plan);
            stalls.extend(long.map(|times| stall(who, What::WokeLate, times)));
        }
        stalls.sort_by_key(|stall| (stall.from, stall.until));
        stalls
    }
}

/// Returns the owner of a process by its participant's name: a node that canrig plays is the
/// controller or emulates a plant.
fn who(name: &str, plan: &Plan) -> Who {
    let node = plan.nodes.find(name).map(|node| &plan.nodes[node]);
    let other = node.filter(|node| node.is_external());
    match other.and_then(|node| NodeName::new(&node.name)) {
        _ if name == plan.controller().name => Who::Controller,
        Some(node) => Who::Node(node),
        None => Who::PlantEmulator,
    }
}
