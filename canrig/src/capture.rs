//! Takes the frames of a running world: into memory for judging, into `bus.log` for everybody else.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use canopen::CanFrame;

use crate::recording::Stamped;
use crate::run_folder::{BusLog, WriteError};
use crate::scenario_clock::ScenarioClock;

/// What the threads of a run tell each other.
#[derive(Debug, Default)]
pub struct Watch {
    scenario_micros: AtomicU64,
    is_interrupted: AtomicBool,
}

impl Watch {
    /// How far the scenario is; zero before it begins.
    #[must_use]
    pub fn scenario_time(&self) -> Duration {
        Duration::from_micros(self.scenario_micros.load(Ordering::Relaxed))
    }

    /// Asks the run to end.
    pub fn interrupt(&self) {
        self.is_interrupted.store(true, Ordering::Relaxed);
    }

    /// Whether the run was asked to end.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.is_interrupted.load(Ordering::Relaxed)
    }
}

/// The frames of one run so far.
#[derive(Debug)]
pub struct Capture<'a> {
    frames: Vec<Stamped>,
    lost: u64,
    written: usize,
    log: BusLog,
    clock: ScenarioClock,
    watch: &'a Watch,
}

impl<'a> Capture<'a> {
    /// An empty capture that writes to `log` and reports its progress to `watch`.
    #[must_use]
    pub fn new(log: BusLog, clock: ScenarioClock, watch: &'a Watch) -> Self {
        Self {
            frames: Vec::new(),
            lost: 0,
            written: 0,
            log,
            clock,
            watch,
        }
    }

    /// Takes the next frame of the bus.
    pub fn take(&mut self, time: Duration, frame: CanFrame) {
        let stamped = Stamped::new(time, frame);
        self.clock.on_frame(stamped.time, &frame);
        self.frames.push(stamped);
        if let Some(time) = self.clock.scenario_time(stamped.time) {
            let micros = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
            self.watch.scenario_micros.store(micros, Ordering::Relaxed);
        }
    }

    /// Scenario time of the last frame; `None` before the scenario began.
    #[must_use]
    pub fn scenario_time(&self) -> Option<Duration> {
        self.frames
            .last()
            .and_then(|last| self.clock.scenario_time(last.time))
    }

    /// Scenario time at a time of the frames' clock; `None` before the scenario began.
    #[must_use]
    pub fn scenario_time_at(&self, time: Duration) -> Option<Duration> {
        self.clock.scenario_time(time)
    }

    /// Whether the user wants the run to end.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.watch.is_interrupted()
    }

    /// All frames so far.
    #[must_use]
    pub fn frames(&self) -> &[Stamped] {
        &self.frames
    }

    /// Writes what is not yet in `bus.log`.
    ///
    /// # Errors
    /// The disk does not take it.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.log.append(&self.frames[self.written..])?;
        self.written = self.frames.len();
        self.log.flush()
    }

    /// Notes frames that were on the bus and could not be taken.
    pub fn lose(&mut self, frames: u64) {
        self.lost += frames;
    }

    /// The frames, with everything in `bus.log`, and how many were lost.
    ///
    /// # Errors
    /// The disk does not take them.
    pub fn finish(mut self) -> Result<(Vec<Stamped>, u64), WriteError> {
        self.flush()?;
        Ok((self.frames, self.lost))
    }
}
