//! Takes the frames of a running world: into memory for judging and, of a run with a folder, into `bus.log` for
//! everybody else.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crate::gauge::{Gauge, Reading};
use crate::log::Stamped;
use crate::run_folder::{BusLog, WriteError};
use crate::tap::Tap;
use dbc::scenario_clock::ScenarioClock;

/// What the threads of a run tell each other.
#[derive(Debug, Default)]
pub struct Watch {
    reading: Mutex<Reading>,
    is_interrupted: AtomicBool,
}

impl Watch {
    /// The state of the run.
    #[must_use]
    pub fn reading(&self) -> Reading {
        *self.reading.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn show(&self, reading: Reading) {
        *self.reading.lock().unwrap_or_else(PoisonError::into_inner) = reading;
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
    log: Option<BusLog>,
    clock: ScenarioClock,
    gauge: Option<Gauge>,
    watch: &'a Watch,
    taps: Vec<Tap>,
}

impl<'a> Capture<'a> {
    /// An empty capture of a run with a folder: writes to `log`, shows the run's state to `watch` and hands the frames on
    /// to `taps`.
    #[must_use]
    pub fn new(
        log: BusLog,
        gauge: Gauge,
        clock: ScenarioClock,
        watch: &'a Watch,
        taps: Vec<Tap>,
    ) -> Self {
        Self {
            log: Some(log),
            gauge: Some(gauge),
            taps,
            ..Self::in_memory(clock, watch)
        }
    }

    /// An empty capture that writes nowhere.
    #[must_use]
    pub fn in_memory(clock: ScenarioClock, watch: &'a Watch) -> Self {
        Self {
            frames: Vec::new(),
            lost: 0,
            written: 0,
            log: None,
            gauge: None,
            clock,
            watch,
            taps: Vec::new(),
        }
    }

    /// Makes room for so many frames, since frames that have to move as they become more are copied again and again.
    pub fn expect(&mut self, frames: usize) {
        self.frames.reserve(frames);
    }

    /// Takes the next frame of the bus.
    #[inline]
    pub fn take(&mut self, stamped: Stamped) {
        self.clock.on_frame(stamped.time, &stamped.frame);
        self.frames.push(stamped);
        for tap in &mut self.taps {
            tap.take(stamped);
        }
    }

    /// Scenario time of the last frame; `None` before the scenario began.
    #[must_use]
    pub fn scenario_time(&self) -> Option<Duration> {
        self.frames
            .last()
            .and_then(|last| self.clock.scenario_time(last.time))
    }

    /// When the scenario began, on the clock of the frames; `None` before.
    #[must_use]
    pub fn zero(&self) -> Option<Duration> {
        self.clock.zero()
    }

    /// Whether the user wants the run to end.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.watch.is_interrupted()
    }

    /// Through which the threads of the run tell each other.
    #[must_use]
    pub fn watch(&self) -> &'a Watch {
        self.watch
    }

    /// All frames so far.
    #[must_use]
    pub fn frames(&self) -> &[Stamped] {
        &self.frames
    }

    /// Writes what is not yet in `bus.log`, and shows how the run stands.
    ///
    /// # Errors
    /// The disk does not take it.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        let Some(log) = &mut self.log else {
            return Ok(());
        };
        let new = &self.frames[self.written..];
        let gauge = self.gauge.as_ref();
        if let Some(reading) = gauge.and_then(|gauge| gauge.read(new, &self.clock)) {
            self.watch.show(reading);
        }
        log.append(new)?;
        self.written = self.frames.len();
        log.flush()
    }

    /// Notes frames that were on the bus and could not be taken.
    pub fn lose(&mut self, frames: u64) {
        self.lost += frames;
    }

    /// The frames, with everything in `bus.log` if there is one, and how many were lost.
    ///
    /// # Errors
    /// The disk does not take them.
    pub fn finish(mut self) -> Result<(Vec<Stamped>, u64), WriteError> {
        self.flush()?;
        Ok((self.frames, self.lost))
    }
}
