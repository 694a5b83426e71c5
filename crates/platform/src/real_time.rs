//! Real time: moves a node by the monotonic clock and a bus.
//!
//! After its start the loop does not allocate, takes no lock and writes no log. Its deadlines are absolute. A tick that comes
//! late is counted with its lateness; a deadline that has passed when the tick before it is done is an overrun.

#[cfg(test)]
mod tests;
mod timer;

use std::fmt;
use std::time::Duration;

use can::{Node, Progress, STANDARD_IDS, earlier};
use hdrhistogram::Histogram;
use rustix::io::Errno;

use crate::bus::{Bus, BusError};
use crate::clock::{Clock, nanoseconds};
use crate::lockstep::{StepError, TICKS_PER_INSTANT_MAX};
use crate::stop::StopSignal;
use crate::wait::wait_for_any;
use timer::Timer;

/// Longest time for a node to reach its safe state.
pub const STOP_PATIENCE: Duration = Duration::from_millis(500);

/// Largest number of frames taken in a row, before ticks and the stop signal have their turn.
const BATCH_FRAMES: usize = 64;

/// Largest lateness that is counted; above 10 s it counts as 10 s.
const LATENESS_NANOSECONDS_MAX: u64 = 10_000_000_000;

/// Smallest lateness of a wake-up that is noted with its time.
pub const LATE_MIN: Duration = Duration::from_micros(500);

/// Largest number of late wake-ups that are noted: a report with all of them fits a pipe, and more of them add nothing new.
const LATE_COUNT_MAX: usize = 1000;

/// Report on a loop.
#[derive(Clone, Debug)]
pub struct RunReport {
    /// Number of ticks of the node.
    pub ticks: u64,
    /// Number of deadlines that had passed before the tick before them was done.
    pub overruns: u64,
    /// Lateness of the ticks in nanoseconds, to three digits.
    pub lateness_nanoseconds: Histogram<u64>,
    /// Number of frames that the node took.
    pub frames_received: u64,
    /// Number of frames that the node sent.
    pub frames_sent: u64,
    /// Number of frames sent, by standard identifier.
    pub sent: Vec<u64>,
    /// Number of frames that were lost before the node could take them.
    pub frames_dropped: u64,
    /// Number of frames that waited for room in a full queue before they were sent.
    pub frames_delayed: u64,
    /// Deadlines before which the loop waited and after which it woke up more than [`LATE_MIN`] late, each with the time of the
    /// wake-up, in nanoseconds of the monotonic clock of the system. The node did not cause these.
    pub late: Vec<[u64; 2]>,
}

impl RunReport {
    /// Returns the identifiers of which the node sent frames, each with their number.
    pub fn sent_frames(&self) -> impl Iterator<Item = (u16, u64)> {
        let counted = (0_u16..).zip(self.sent.iter().copied());
        counted.filter(|(_, frames)| *frames > 0)
    }

    fn new() -> Self {
        Self {
            ticks: 0,
            overruns: 0,
            lateness_nanoseconds: Histogram::new_with_max(LATENESS_NANOSECONDS_MAX, 3)
                .expect("constant bounds that the histogram takes"),
            frames_received: 0,
            frames_sent: 0,
            sent: vec![0; STANDARD_IDS],
            frames_dropped: 0,
            frames_delayed: 0,
            late: Vec::with_capacity(LATE_COUNT_MAX),
        }
    }
}

/// Writes the report on one line.
impl fmt::Display for RunReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let late = |quantile: f64| self.lateness_nanoseconds.value_at_quantile(quantile) / 1000;
        write!(
            formatter,
            "{} ticks, {} overruns, late by median {} us, p99 {} us, p99.9 {} us, max {} us; {} frames received, {} sent, {} dropped, {} delayed by a full queue",
            self.ticks,
            self.overruns,
            late(0.5),
            late(0.99),
            late(0.999),
            late(1.0),
            self.frames_received,
            self.frames_sent,
            self.frames_dropped,
            self.frames_delayed,
        )
    }
}

/// Reason why a loop ended before the node had stopped.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The node itself gave up, did not reach its safe state, or has a deadline that does not move.
    #[error("{0}")]
    Node(String),
    /// The system refused a timer or a wait.
    #[error("{0}")]
    System(String),
}

/// Runs `node` until it has stopped. Its time begins now. When `stop` is raised, the node is asked for its safe state and has
/// [`STOP_PATIENCE`] for it.
///
/// # Errors
/// If the bus fails, or if the node fails, hangs at a deadline or does not stop.
pub fn run(
    node: &mut dyn Node,
    bus: &mut dyn Bus,
    stop: &StopSignal,
) -> Result<RunReport, RunError> {
    let (report, ended) = run_reporting(node, bus, stop);
    ended.map(|()| report)
}

/// As [`run`], with a report also after a failure.
pub fn run_reporting(
    node: &mut dyn Node,
    bus: &mut dyn Bus,
    stop: &StopSignal,
) -> (RunReport, Result<(), RunError>) {
    let mut cycle = Cycle {
        node,
        bus,
        clock: Clock::start(),
        report: RunReport::new(),
        waits_since: Duration::ZERO,
        stop_asked_at: None,
        ticks_at_deadline: 0,
    };
    let ended = cycle.run(stop);
    (cycle.into_report(), ended)
}

/// Events other than the timer that ended a wait.
struct Ready {
    frames: bool,
    stop: bool,
}

/// Waits for a frame, the stop signal or the next deadline.
fn wait(timer: &mut Timer, cycle: &Cycle<'_>, stop: &StopSignal) -> Result<Ready, RunError> {
    timer
        .set(cycle.next_deadline())
        .map_err(system("set its timer"))?;
    // Not watched after the request to stop, since a signal that stays raised would keep the loop awake.
    let [pipe, event] = match cycle.stop_asked_at {
        None => stop.fds(),
        Some(_) => [None, None],
    };
    let fds = [Some(cycle.bus.as_fd()), Some(timer.as_fd()), pipe, event];
    let [frames, _, pipe, event] = wait_for_any(fds, None).map_err(system("wait"))?;
    Ok(Ready {
        frames,
        stop: pipe || event,
    })
}

/// State of the loop: the node, its bus and its clock.
struct Cycle<'a> {
    node: &'a mut dyn Node,
    bus: &'a mut dyn Bus,
    clock: Clock,
    report: RunReport,
    /// Time at which the loop had no more to do.
    waits_since: Duration,
    stop_asked_at: Option<Duration>,
    ticks_at_deadline: u32,
}

impl Cycle<'_> {
    fn run(&mut self, stop: &StopSignal) -> Result<(), RunError> {
        let mut timer = Timer::new(self.clock).map_err(system("make a timer"))?;
        let mut ready = Ready {
            frames: true,
            stop: true,
        };
        loop {
            let now = self.clock.now();
            if ready.frames {
                self.deliver_frames(now)?;
            }
            if ready.stop && stop.is_raised() {
                self.ask_to_stop(now)?;
            }
            self.tick_when_due(now)?;
            match self.node.progress() {
                Progress::Running => {}
                Progress::Stopped => return Ok(()),
                Progress::Failed(text) => return Err(RunError::Node(text)),
            }
            self.check_stop_patience(now)?;
            self.waits_since = self.clock.now();
            ready = wait(&mut timer, self, stop)?;
        }
    }

    /// Delivers a batch of frames, all of which were there when the loop woke up, at `now`.
    fn deliver_frames(&mut self, now: Duration) -> Result<(), RunError> {
        for _ in 0..BATCH_FRAMES {
            let Some(frame) = self.bus.receive(Duration::ZERO)? else {
                break;
            };
            self.report.frames_received += 1;
            self.node.on_frame(now, &frame);
            self.send_queued()?;
        }
        Ok(())
    }

    fn tick_when_due(&mut self, woken_at: Duration) -> Result<(), RunError> {
        let deadline = self.node.next_deadline();
        let Some(deadline) = deadline.filter(|deadline| *deadline <= woken_at) else {
            return Ok(());
        };
        self.note_late(deadline, woken_at);
        // Frames came first, so the tick is later than the wake-up.
        let now = self.clock.now();
        let late = nanoseconds(now - deadline);
        self.report.lateness_nanoseconds.saturating_record(late);
        self.report.ticks += 1;
        self.node.on_tick(now);
        self.send_queued()?;
        let next = self.node.next_deadline();
        if next.is_some_and(|next| next <= self.clock.now()) {
            self.report.overruns += 1;
        }
        self.check_moved(deadline, next)
    }

    /// Notes a late wake-up if the machine caused it: the loop waited before the deadline. Otherwise the node was late by itself.
    fn note_late(&mut self, deadline: Duration, woken_at: Duration) {
        let is_late = self.waits_since <= deadline && woken_at > deadline + LATE_MIN;
        if is_late && self.report.late.len() < LATE_COUNT_MAX {
            let on_monotonic = |time| nanoseconds(self.clock.on_monotonic(time));
            let times = [deadline, woken_at].map(on_monotonic);
            self.report.late.push(times);
        }
    }

    /// Refuses a node whose deadline stays, a fault that would keep the processor at real-time priority.
    fn check_moved(&mut self, deadline: Duration, next: Option<Duration>) -> Result<(), RunError> {
        self.ticks_at_deadline = if next == Some(deadline) {
            self.ticks_at_deadline + 1
        } else {
            0
        };
        if self.ticks_at_deadline > TICKS_PER_INSTANT_MAX {
            return Err(RunError::Node(StepError::stuck(deadline).to_string()));
        }
        Ok(())
    }

    fn ask_to_stop(&mut self, now: Duration) -> Result<(), RunError> {
        self.stop_asked_at = Some(now);
        self.node.on_stop(now);
        self.send_queued()
    }

    fn check_stop_patience(&self, now: Duration) -> Result<(), RunError> {
        match self.stop_asked_at {
            Some(asked) if now >= asked + STOP_PATIENCE => Err(RunError::Node(format!(
                "the node did not stop within {} ms",
                STOP_PATIENCE.as_millis()
            ))),
            _ => Ok(()),
        }
    }

    /// Returns the node's next deadline, or the end of the patience if that is earlier.
    fn next_deadline(&self) -> Option<Duration> {
        let patience_ends = self.stop_asked_at.map(|asked| asked + STOP_PATIENCE);
        earlier(self.node.next_deadline(), patience_ends)
    }

    fn send_queued(&mut self) -> Result<(), RunError> {
        while let Some(frame) = self.node.next_frame() {
            self.bus.send(&frame)?;
            self.report.frames_sent += 1;
            let identifier = frame.standard_id().map(usize::from);
            if let Some(sent) = identifier.and_then(|id| self.report.sent.get_mut(id)) {
                *sent += 1;
            }
        }
        Ok(())
    }

    fn into_report(self) -> RunReport {
        RunReport {
            frames_dropped: self.bus.dropped(),
            frames_delayed: self.bus.delayed(),
            ..self.report
        }
    }
}

fn system(action: &'static str) -> impl Fn(Errno) -> RunError {
    move |errno| RunError::System(format!("the loop could not {action}: {errno}"))
}
