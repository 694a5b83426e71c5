//! Punctuality of the cycles and load of the bus, from the stamps of the recording.

use dbc::SignalMissing;
use std::mem;
use std::time::Duration;

use super::groups;
use super::groups::line;
use super::output::{Output, send_scalars, send_static};
use super::times::{self, Moment};
use crate::ReportError;
use plan::{ControlLoop, Plan};
use recording::latency::{CycleReader, CycleStage};
use recording::log::Stamped;
use scenario::{Trial, cycle_start_seconds, nearest_cycle};

/// Shortest stretch of time over which a load is averaged, and of which a long run logs the extremes. Stretches are longer if
/// there would be more of them than the viewer can hold.
const STRETCH_SECONDS: f64 = 0.1;
/// Largest number of stretches in a run: ten hours with stretches of 0.1 s.
const STRETCHES_MAX: f64 = 360_000.0;

/// Returns the length of the stretches over which a load is averaged, and of which a long run logs the extremes.
pub(super) fn stretch_seconds(trial: &Trial) -> f64 {
    (trial.run.duration_seconds / STRETCHES_MAX).max(STRETCH_SECONDS)
}

/// Signals in the group [`groups::TIMING`], with their names in the legend and their colours.
const TIMING: [(&str, &str, [u8; 3]); 3] = [
    (
        "sync_lateness_microseconds",
        "SYNC behind its time",
        groups::PINK,
    ),
    (
        "sync_to_position_microseconds",
        "SYNC to position",
        groups::SKY,
    ),
    (
        "sync_to_command_microseconds",
        "SYNC to command",
        groups::ORANGE,
    ),
];

/// Times of one cycle, from the stamps.
struct Cycle {
    moment: Moment,
    /// Times in the order of [`TIMING`]; NaN if the frame did not come.
    microseconds: [f64; 3],
}

/// Reader of the times and the load, cycle by cycle, from the stamps.
pub(super) struct BusReader {
    cycle: CycleReader,
    period: Duration,
    end: Duration,
    bits_per_second: f64,
    now: Moment,
    cycles: Vec<Cycle>,
    stretch_seconds: f64,
    stretch: f64,
    bits: u32,
    loads: Vec<(Moment, f64)>,
    /// Whether only the largest times among the cycles of each stretch are kept.
    is_thinned: bool,
}

impl BusReader {
    /// Returns a reader before the first frame.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub(super) fn new(
        plan: &Plan,
        control_loop: &ControlLoop,
        is_thinned: bool,
    ) -> Result<Self, SignalMissing> {
        let trial = &control_loop.trial;
        Ok(Self {
            cycle: CycleReader::new(plan, control_loop)?,
            period: Duration::from_secs_f64(trial.run.bus.sync_period_milliseconds / 1e3),
            end: Duration::from_secs_f64(trial.run.duration_seconds),
            bits_per_second: 1e3 * f64::from(trial.run.bus.bitrate_kilobits_per_second),
            now: times::moment_at(0.0, 1.0),
            cycles: Vec::new(),
            stretch_seconds: stretch_seconds(trial),
            stretch: 1.0,
            bits: 0,
            loads: Vec::new(),
            is_thinned,
        })
    }

    /// Reads every frame of the bus, in order; returns the scenario time of its cycle.
    pub(super) fn observe(&mut self, stamped: &Stamped) -> f64 {
        let time = self.cycle.on_frame(stamped).filter(|time| *time < self.end);
        let Some(time) = time else {
            return self.now.seconds;
        };
        self.add_load(time, stamped.occupied_bits);
        let micros = |time: Duration| time.as_secs_f64() * 1e6;
        match self.cycle.stage(stamped) {
            Some(CycleStage::Sync) => self.begin_cycle(time),
            Some(CycleStage::Position { after_sync }) => self.set(1, micros(after_sync)),
            Some(CycleStage::Command { after_sync, .. }) => self.set(2, micros(after_sync)),
            None => {}
        }
        self.now.seconds
    }

    /// Sets one of the [`TIMING`] values of this cycle, the begin of which may have been logged already.
    fn set(&mut self, place: usize, microseconds: f64) {
        if self.cycles.is_empty() {
            self.push_cycle();
        }
        if let Some(cycle) = self.cycles.last_mut() {
            cycle.microseconds[place] = microseconds;
        }
    }

    fn push_cycle(&mut self) {
        self.cycles.push(Cycle {
            moment: self.now,
            microseconds: [f64::NAN; 3],
        });
    }

    fn begin_cycle(&mut self, time: Duration) {
        let due_seconds = cycle_start_seconds(nearest_cycle(time, self.period), self.period);
        self.now = times::moment_at(due_seconds, self.period.as_secs_f64());
        let lateness = 1e6 * (time.as_secs_f64() - due_seconds);
        self.thin();
        self.push_cycle();
        self.set(0, lateness.round());
    }

    /// Merges the latest cycle into the one before if cycles are thinned and both are of one stretch.
    fn thin(&mut self) {
        let stretch_seconds = self.stretch_seconds;
        let stretch = |cycle: &Cycle| (cycle.moment.seconds / stretch_seconds).floor();
        if let [.., before, latest] = &mut self.cycles[..]
            && self.is_thinned
            && stretch(before) == stretch(latest)
        {
            for (most, new) in before.microseconds.iter_mut().zip(latest.microseconds) {
                *most = most.max(new);
            }
            self.cycles.pop();
        }
    }

    /// Counts bits; a stretch that is over becomes a row at its end.
    fn add_load(&mut self, time: Duration, bits: u32) {
        while time.as_secs_f64() >= self.stretch * self.stretch_seconds {
            let end_seconds = self.stretch * self.stretch_seconds;
            let end = times::moment_at(end_seconds, self.period.as_secs_f64());
            let capacity = self.bits_per_second * self.stretch_seconds;
            let load = 100.0 * f64::from(self.bits) / capacity;
            self.loads.push((end, load));
            self.stretch += 1.0;
            self.bits = 0;
        }
        self.bits += bits;
    }

    /// Logs the cycles and loads since the last time.
    pub(super) fn log(&mut self, output: &mut dyn Output) -> Result<(), ReportError> {
        let cycles = mem::take(&mut self.cycles);
        for (place, (name, ..)) in TIMING.into_iter().enumerate() {
            let is_heard = |cycle: &&Cycle| !cycle.microseconds[place].is_nan();
            let heard = cycles.iter().filter(is_heard);
            let values: Vec<f64> = heard.clone().map(|it| it.microseconds[place]).collect();
            let times = times::columns(heard.map(|cycle| cycle.moment));
            send_scalars(output, format!("{}/{name}", groups::TIMING), times, values)?;
        }
        let (moments, loads): (Vec<_>, Vec<_>) = self.loads.drain(..).unzip();
        send_scalars(output, LOAD, times::columns(moments.into_iter()), loads)
    }
}

const LOAD: &str = "bus/load_percent";

/// Logs names and colours.
pub(super) fn log_styles(output: &mut dyn Output) -> Result<(), ReportError> {
    for (name, label, colour) in TIMING {
        send_static(
            output,
            format!("{}/{name}", groups::TIMING),
            &line(label, colour),
        )?;
    }
    send_static(output, LOAD, &line("bus load", groups::GREEN))
}
