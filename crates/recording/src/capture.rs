//! Capture of the frames of a running world: into the log of its folder, or into memory if it has none. Of a long run, memory
//! holds only the latest frames; without a folder, the others are in a file without a name.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use dbc::scenario_clock::ScenarioClock;
use plan::Plan;

use crate::bus_log::BusLog;
use crate::frame_queue::FrameQueue;
use crate::frames::{Frames, KEPT_MAX};
use crate::hits::{Hit, Hits};
use crate::log::Stamped;
use crate::progress::{ProgressReader, RunProgress};
use crate::run_folder::WriteError;
use crate::unrecorded::Unrecorded;

/// Largest number of frames of a run without a folder in memory, 40 MB: four minutes of a bus with four frames in a cycle of 1
/// ms.
const WITHOUT_LOG_MAX: usize = 8 * KEPT_MAX;
/// Number of identifiers whose last frame is remembered.
const IDENTIFIERS_MAX: usize = 4096;

/// State that the threads of a run share: its progress, and the request to end.
#[derive(Debug, Default)]
pub struct Watch {
    progress: Mutex<Option<RunProgress>>,
    is_interrupted: AtomicBool,
}

impl Watch {
    /// Returns the progress while frames are captured for a folder. A capture within another takes it away at its end, until the
    /// outer one shows its own again: that of a pre-flight, until scenario time 0.
    pub fn progress(&self) -> Option<RunProgress> {
        let progress = self.progress.lock();
        progress.unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn show(&self, progress: Option<RunProgress>) {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress;
    }

    /// Asks the run to end.
    pub fn interrupt(&self) {
        self.is_interrupted.store(true, Ordering::Relaxed);
    }

    /// Returns whether the run was asked to end.
    pub fn is_interrupted(&self) -> bool {
        self.is_interrupted.load(Ordering::Relaxed)
    }
}

/// Frames of one run so far.
pub struct Capture<'a> {
    /// Latest frames; for each identifier that is not among them, also its last frame before.
    frames: Vec<Stamped>,
    /// Number of frames so far.
    count: usize,
    /// Traffic that was on the bus and could not be taken.
    pub unrecorded: Unrecorded,
    /// Hits of the scenario's faults on the bus.
    pub hits_on_bus: Vec<Hit>,
    /// Number of the frames that are in the log.
    written: usize,
    log: Option<BusLog>,
    clock: ScenarioClock,
    /// Time of the last frame of a run that broke off; later frames show how the nodes stop.
    broke_off: Option<Duration>,
    progress: Option<ProgressReader>,
    watch: &'a Watch,
    observers: Vec<FrameQueue>,
}

impl<'a> Capture<'a> {
    /// Makes an empty capture of a run with a folder. It writes to `log`, shows the run's progress to `watch` and passes the
    /// frames on to `observers`.
    pub fn new(
        log: BusLog,
        progress: ProgressReader,
        clock: ScenarioClock,
        watch: &'a Watch,
        observers: Vec<FrameQueue>,
    ) -> Self {
        watch.show(Some(RunProgress::default()));
        Self {
            log: Some(log),
            progress: Some(progress),
            observers,
            ..Self::in_memory(clock, watch)
        }
    }

    /// Makes an empty capture of a run without a folder.
    pub fn in_memory(clock: ScenarioClock, watch: &'a Watch) -> Self {
        Self {
            frames: Vec::new(),
            count: 0,
            unrecorded: Unrecorded::default(),
            hits_on_bus: Vec::new(),
            written: 0,
            log: None,
            progress: None,
            clock,
            broke_off: None,
            watch,
            observers: Vec::new(),
        }
    }

    /// Takes the next frame of the bus.
    #[inline]
    pub fn record(&mut self, stamped: Stamped) {
        self.clock.on_frame(stamped.time, &stamped.frame);
        self.frames.push(stamped);
        self.count += 1;
        for observer in &mut self.observers {
            observer.push(stamped);
        }
    }

    /// Returns scenario time of the last frame; `None` before the scenario began.
    pub fn scenario_time(&self) -> Option<Duration> {
        self.frames
            .last()
            .and_then(|last| self.clock.scenario_time(last.time))
    }

    /// Returns the start of the scenario on the clock of the frames; `None` before it.
    pub fn zero(&self) -> Option<Duration> {
        self.clock.zero()
    }

    /// Notes that the run breaks off here, unless it did before.
    pub fn break_off(&mut self) {
        let last = self.frames.last().map(|last| last.time);
        self.broke_off = self.broke_off.or(last);
    }

    /// Returns the latest frames up to the point where the run broke off.
    pub fn frames_of_run(&self) -> &[Stamped] {
        let is_of_run = |stamped: &Stamped| self.broke_off.is_none_or(|end| stamped.time <= end);
        &self.frames[..self.frames.partition_point(is_of_run)]
    }

    pub fn watch(&self) -> &'a Watch {
        self.watch
    }

    /// Returns the latest frames; the last one of each identifier is among them.
    pub fn frames(&self) -> &[Stamped] {
        &self.frames
    }

    /// Returns the frames that came since `seen` was the number of frames, and updates it. A reader that calls this after each
    /// flush misses none.
    pub fn since(&self, seen: &mut usize) -> &[Stamped] {
        let new = self.count - std::mem::replace(seen, self.count);
        &self.frames[self.frames.len().saturating_sub(new)..]
    }

    /// Writes the frames that are not in `bus.log` yet, and updates the progress of the run.
    ///
    /// # Errors
    /// If the disk does not take them.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        if self.log.is_none() && self.frames.len() > WITHOUT_LOG_MAX {
            self.log = Some(BusLog::without_name()?);
        }
        let Some(log) = &mut self.log else {
            return Ok(());
        };
        let new = &self.frames[self.written..];
        let reader = self.progress.as_ref();
        if let Some(progress) = reader.and_then(|reader| reader.read(new, &self.clock)) {
            self.watch.show(Some(progress));
        }
        log.append(new)?;
        log.flush()?;
        if self.frames.len() > 2 * KEPT_MAX {
            self.forget();
        }
        self.written = self.frames.len();
        Ok(())
    }

    /// Removes all but the latest frames and the last one of each other identifier.
    #[cold]
    fn forget(&mut self) {
        let latest = self.frames.split_off(self.frames.len() - KEPT_MAX);
        let places = self.frames.iter().enumerate();
        let last: BTreeMap<u32, usize> = places
            .map(|(place, stamped)| (stamped.frame.raw_id(), place))
            .collect();
        let mut places: Vec<usize> = last.into_values().collect();
        places.sort_unstable();
        let last = places.into_iter().rev().take(IDENTIFIERS_MAX).rev();
        let kept: Vec<Stamped> = last.map(|place| self.frames[place]).collect();
        self.frames.clear();
        self.frames.extend(kept);
        self.frames.extend(latest);
    }

    /// Returns the frames, after all were written to the log if there is one, with what they do not show of a run of the plan.
    ///
    /// # Errors
    /// If the disk does not take them.
    pub fn finish(mut self, plan: &Plan) -> Result<(Frames, Unrecorded), WriteError> {
        let flushed = self.flush();
        self.watch.show(None);
        flushed?;
        let log = self.log.map(BusLog::finish).transpose()?;
        let frames = match log {
            Some(log) if self.count > self.frames.len() => Frames::in_log(log, self.count),
            _ => self.frames.into(),
        };
        let unrecorded = Unrecorded {
            hits: Some(Hits::new(self.hits_on_bus, plan)),
            ..self.unrecorded
        };
        Ok((frames, unrecorded))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    fn frame(number: usize) -> Stamped {
        // One identifier comes only once, at the beginning.
        let id = if number == 3 { 0x081 } else { 0x190 };
        let micros = u64::try_from(number).unwrap();
        Stamped::new(Duration::from_micros(micros), CanFrame::new(id, &[1]))
    }

    #[test]
    fn memory_has_the_latest_frames_of_a_long_run_and_the_log_all() {
        let folder = tempfile::tempdir().unwrap();
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"c\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let plan = testing::plan(text);
        let watch = Watch::default();
        let mut capture = Capture::new(
            BusLog::create(folder.path().join("bus.log.zst")).unwrap(),
            ProgressReader::new(&plan).unwrap(),
            plan.scenario_clock().unwrap(),
            &watch,
            Vec::new(),
        );
        let (count, part) = (5 * KEPT_MAX, KEPT_MAX / 8);
        let (mut seen, mut heard) = (0, 0);
        for begin in (0..count).step_by(part) {
            (begin..begin + part).for_each(|number| capture.record(frame(number)));
            capture.flush().unwrap();
            for stamped in capture.since(&mut seen) {
                assert_eq!(*stamped, frame(heard));
                heard += 1;
            }
            assert!(capture.frames().len() <= 2 * KEPT_MAX);
            assert_eq!(capture.frames().last(), Some(&frame(begin + part - 1)));
        }
        assert_eq!(heard, count);
        assert!(capture.frames().contains(&frame(3)));
        let (frames, _) = capture.finish(&plan).unwrap();
        assert_eq!(frames.len(), count);
        assert!(frames.iter().eq((0..count).map(frame)));
    }

    #[test]
    fn a_long_run_without_a_folder_is_not_in_memory_either() {
        let watch = Watch::default();
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"c\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let plan = testing::plan(text);
        let mut capture = Capture::in_memory(plan.scenario_clock().unwrap(), &watch);
        let (count, part) = (WITHOUT_LOG_MAX + 5 * KEPT_MAX, KEPT_MAX / 2);
        for begin in (0..count).step_by(part) {
            (begin..begin + part).for_each(|number| capture.record(frame(number)));
            capture.flush().unwrap();
            assert!(capture.frames().len() <= WITHOUT_LOG_MAX + part);
        }
        assert!(capture.frames().len() <= 2 * KEPT_MAX);
        let (frames, _) = capture.finish(&plan).unwrap();
        assert!(frames.iter().eq((0..count).map(frame)));
    }
}
