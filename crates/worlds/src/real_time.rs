//! Real time: the processes keep their own time on a bus, and the bench listens.

use std::collections::BTreeMap;
use std::time::Duration;

use platform::clock::{Clock, sleep};
use platform::real_time::{RunError, run_reporting};

use crate::after_end;
use crate::bench_node::BenchNode;
use crate::blame::end_by_node;
use crate::bus_connection::{BusConnection, COLLECT_PERIOD, stop_signal};
use crate::child::{NodeProcess, Stopped};
use crate::error::{START_PATIENCE, WorldError};
use crate::law_process;
use crate::names::{self, BENCH};
use crate::played::{End, Played};
use crate::process_faults::{ProcessAction, ProcessFaults};
use crate::processes::Processes;
use crate::programs::ProgramOrder;
use crate::second_master::SecondMasterWatch;
use crate::silence::SilenceWatch;
use crate::stalls::StallRecorder;
use plan::Plan;
use recording::capture::Capture;
use recording::latency::{Host, NodeReport};
use recording::run_folder::RunFolder;
use recording::sources::{Sent, SentFrames};

/// Time for the controller beyond the bring-up until current flows, with a reserve.
const ENABLE_PATIENCE: Duration = Duration::from_secs(5);

/// Plays the loops in real time on an existing bus, with controller and plants as processes unless they are external: to their
/// end, until a node under test ends them, or until the recording is sufficient.
///
/// # Errors
/// If the bench or the bus failed, or the recording cannot be written.
pub fn play(
    plan: &Plan,
    folder: &RunFolder,
    capture: &mut Capture<'_>,
    connection: &mut BusConnection,
    is_enough: &mut dyn FnMut(&Capture<'_>) -> bool,
) -> Result<Played, WorldError> {
    let mut processes = start_nodes(plan, folder, connection)?;
    let stalls = StallRecorder::start(plan, &processes)?;
    let mut bench = BenchNode::new(plan)?;
    let mut bus = connection.join(&can::Node::filters(&bench))?;
    let (stopper, stop) = stop_signal()?;
    let mut stopper = Some(stopper);
    let mut run = Run {
        plan,
        folder,
        connection,
        capture,
        processes: &mut processes,
        stalls: &stalls,
        is_enough,
    };
    let (end, (report, ended), stopped) = std::thread::scope(|scope| {
        let bench = scope.spawn(|| run_reporting(&mut bench, &mut *bus, &stop));
        let end = run.follow(|| bench.is_finished());
        let is_second_master = matches!(end, Err(WorldError::SecondMaster(_)));
        if is_second_master {
            // The bench stops the drives at once.
            stopper = None;
        }
        let is_broken_off = (bench.is_finished() || end.is_err()) && !is_second_master;
        // After any end of the run no wire may stay heated, and no process running.
        let stopped = run.stop(is_broken_off);
        drop(stopper);
        let bench = bench
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        (end, bench, stopped)
    });
    connection.collect_rest(capture)?;
    if let Err(second_master @ WorldError::SecondMaster(_)) = end {
        return Err(second_master);
    }
    let end = match (ended, bench.violation()) {
        (Err(RunError::Node(_)), Some(violation)) => Err(violation),
        (ended, _) => end.and_then(|end| ended.map(|()| end).map_err(WorldError::Bench)),
    };
    let (end, mut reports) = with_reports(end, stopped);
    let controller = plan.controller().name.as_str();
    if let Some(controller) = reports.get_mut(controller)
        && plan.shared.run.faults.of("hang").next().is_some()
    {
        // A loop that was suspended on purpose wakes up late.
        controller.late.clear();
    }
    let stalls = stalls.finish(connection, &mut reports);
    let sent = sent(plan, &mut reports, report.sent_frames().collect());
    let end = end.or_else(|error| end_by_node(error, plan, capture).map(End::ByNode))?;
    let controller = reports.remove(controller);
    Ok(Played {
        end,
        host: Some(Host {
            controller,
            plant_emulator: reports.into_values().reduce(NodeReport::beside),
            wall_clock_step: connection.wall_clock_step(),
            on_this_machine: connection.on_this_machine(plan),
            stalls,
            sent,
        }),
    })
}

/// Returns the frames that canrig's nodes sent, as far as they report them. For a controller that a fault kills, the report is
/// that of the last process only, and is left out. The bench sends frames that the controller sends too, so without the
/// controller's report the bench's is left out as well.
fn sent(
    plan: &Plan,
    reports: &mut BTreeMap<String, NodeReport>,
    by_bench: Vec<(u16, u64)>,
) -> Sent {
    let mut has_controller = false;
    if let Some(report) = reports.get_mut(&plan.controller().name) {
        if plan.shared.run.faults.of("crash").next().is_some() {
            report.sent.clear();
        }
        has_controller = !report.sent.is_empty();
    }
    let reports = reports.iter_mut();
    let by_nodes = reports.map(|(name, report)| (name.as_str(), std::mem::take(&mut report.sent)));
    let mut sent = Vec::new();
    for (node, frames) in by_nodes.chain(has_controller.then_some((BENCH, by_bench))) {
        sent.extend(frames.into_iter().map(|(identifier, frames)| SentFrames {
            node: node.to_owned(),
            identifier,
            frames,
        }));
    }
    Sent(sent)
}

/// Starts the nodes that are not external, the manager last.
fn start_nodes(
    plan: &Plan,
    folder: &RunFolder,
    connection: &BusConnection,
) -> Result<Processes, WorldError> {
    let address = connection.address();
    let spawn = |name| {
        let spawned = NodeProcess::spawn(name, plan, folder, Some(address), None);
        spawned.map_err(WorldError::spawn(name))
    };
    let spawned = names::played(plan).into_iter().map(spawn);
    let mut processes = spawned.collect::<Result<Vec<_>, _>>()?;
    for order in ProgramOrder::all(plan, Some(folder.path()), None) {
        if order.command.is_some() {
            let refused = WorldError::spawn(order.name());
            processes.push(NodeProcess::start(order, address).map_err(refused)?);
        }
    }
    Ok(Processes::new(processes, plan))
}

/// Returns the end of the run with the reports of the nodes. The first error is the reason why the others stopped.
fn with_reports(
    mut end: Result<End, WorldError>,
    stopped: Vec<Stopped>,
) -> (Result<End, WorldError>, BTreeMap<String, NodeReport>) {
    let mut reports = BTreeMap::new();
    for stopped in stopped {
        let is_ok = stopped.ended.is_ok();
        if let Some(report) = stopped.report.filter(|report| is_ok || !report.is_empty()) {
            let report = serde_json::from_str(&report).unwrap_or_else(|_| NodeReport {
                refused: vec![format!("{} gave no report of its timing", stopped.name)],
                ..NodeReport::default()
            });
            reports.insert(stopped.name, report);
        }
        // A node that was killed takes the other with it, whose end may be noticed first.
        if let Err(error) = stopped.ended
            && (end.is_ok() || error.is_from_outside())
        {
            end = Err(error);
        }
    }
    (end, reports)
}

/// Run in progress.
struct Run<'a, 'b> {
    plan: &'a Plan,
    folder: &'a RunFolder,
    connection: &'a mut BusConnection,
    capture: &'a mut Capture<'b>,
    processes: &'a mut Processes,
    stalls: &'a StallRecorder<'a>,
    is_enough: &'a mut dyn FnMut(&Capture<'_>) -> bool,
}

impl Run<'_, '_> {
    /// Collects frames until the scenario is over, the user or the bench's own node stops it, or an error occurs.
    fn follow(&mut self, is_stopped: impl Fn() -> bool) -> Result<End, WorldError> {
        let clock = Clock::start();
        let mut silence = SilenceWatch::new(self.plan)?;
        let mut second_master = SecondMasterWatch::new(self.plan)?;
        let mut faults = ProcessFaults::new(self.plan);
        loop {
            sleep(COLLECT_PERIOD);
            // An error of the bench's own node is reported later.
            if is_stopped() {
                return Ok(End::Interrupted);
            }
            if let Some(error) = self.processes.early_end() {
                return Err(error);
            }
            let now = clock.now();
            self.connection.collect(self.capture)?;
            if let Some(senders) = self.connection.senders() {
                self.stalls.watch_heard(senders);
            }
            second_master.check(self.capture, self.connection.senders())?;
            if self.capture.watch().is_interrupted() {
                return Ok(End::Interrupted);
            }
            if (self.is_enough)(self.capture) {
                return Ok(End::Completed);
            }
            self.play_faults(&mut faults)?;
            if self.is_over(now)? {
                return Ok(End::Completed);
            }
            silence.check(now, self.capture)?;
        }
    }

    /// Returns whether the scenario has reached its end.
    ///
    /// # Errors
    /// If it never will, since it did not begin.
    fn is_over(&self, now: Duration) -> Result<bool, WorldError> {
        let patience = start_patience(self.plan);
        match self.capture.scenario_time() {
            Some(time) => Ok(time >= self.plan.duration()),
            // A fault that keeps the scenario from beginning is played to its end.
            None if now > patience && self.plan.has_faults() => Ok(true),
            None if now > patience => Err(WorldError::NoStart { patience }),
            None => Ok(false),
        }
    }

    /// Stops all nodes, the manager first. After a run that broke off it records whether the drives are off by themselves.
    fn stop(&mut self, is_broken_off: bool) -> Vec<Stopped> {
        if is_broken_off && self.connection.collect(self.capture).is_ok() {
            self.capture.break_off();
        }
        let mut stopped = self.processes.stop(true);
        if is_broken_off && self.capture.zero().is_some() {
            // The end of the run is known, whatever happens now.
            let _ = self.ask_drives();
        }
        stopped.extend(self.processes.stop(false));
        stopped
    }

    /// Lets the drives without a controller run until their watches have run out, and asks them then whether they are off.
    fn ask_drives(&mut self) -> Result<(), WorldError> {
        let mut bus = self.connection.join(&[])?;
        for (requests, time) in after_end::rounds(self.plan) {
            for request in requests {
                bus.send(&request)?;
            }
            let clock = Clock::start();
            while clock.now() < time {
                sleep(COLLECT_PERIOD);
                self.connection.collect(self.capture)?;
            }
        }
        Ok(())
    }

    /// Plays the scenario's faults that are due on the processes of nodes. Faults of an external controller were refused before
    /// the run.
    fn play_faults(&mut self, faults: &mut ProcessFaults) -> Result<(), WorldError> {
        let Some(time) = self.capture.scenario_time() else {
            return Ok(());
        };
        while let Some((name, action)) = faults.due(time) {
            let Some(process) = self.processes.get_mut(&name) else {
                continue;
            };
            if action == ProcessAction::Start {
                *process = process.again(self.plan, self.folder, self.connection.address())?;
                self.stalls.watch(process);
            } else {
                process.play_fault(action)?;
            }
        }
        Ok(())
    }
}

/// Returns the time until the scenario must begin. A real drive may take the time that its controller allows.
fn start_patience(plan: &Plan) -> Duration {
    let drives = plan.loops.iter().filter_map(|one| one.real_drive.as_ref());
    let bring_ups = drives.map(|drive| drive.real.timeouts.bring_up() + ENABLE_PATIENCE);
    bring_ups.fold(START_PATIENCE, Duration::max) + law_process::processes_patience(plan)
}
