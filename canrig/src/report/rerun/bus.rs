//! How punctual the cycles were and how busy the bus, from the stamps of the recording.

use std::mem;
use std::time::Duration;

use dbc::Database;
use rerun::RecordingStreamError;
use scenario::Scenario;

use super::groups;
use super::output::{Output, send_scalars, send_static};
use super::recording::line;
use super::times::{self, Moment};
use crate::recording::Stamped;
use crate::signals::SignalMissing;
use crate::timing::{CycleReader, Stage};

/// Stretch of time for which a load is told.
const LOAD_STRETCH_SECONDS: f64 = 0.1;
/// The signals in the group [`groups::TIMING`], with their names in the legend and their colours.
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

/// Rows of one signal.
#[derive(Default)]
struct Series {
    moments: Vec<Moment>,
    values: Vec<f64>,
}

impl Series {
    fn push(&mut self, moment: Moment, value: f64) {
        self.moments.push(moment);
        self.values.push(value);
    }
}

/// What the stamps say, cycle by cycle.
pub(crate) struct BusReader {
    cycle: CycleReader,
    period: Duration,
    end: Duration,
    bits_per_second: f64,
    timing: [Series; 3],
    now: Moment,
    stretch: f64,
    stretch_end_seconds: f64,
    bits: u32,
    loads: Series,
}

impl BusReader {
    /// A reader that has heard nothing.
    ///
    /// # Errors
    /// The database lacks a signal.
    pub(crate) fn new(scenario: &Scenario, database: &Database) -> Result<Self, SignalMissing> {
        Ok(Self {
            cycle: CycleReader::new(database)?,
            period: Duration::from_secs_f64(scenario.bus.sync_period_milliseconds / 1e3),
            end: Duration::from_secs_f64(scenario.duration_seconds),
            bits_per_second: 1e3 * f64::from(scenario.bus.bitrate_kilobits_per_second),
            timing: Default::default(),
            now: times::moment_at(0.0, 1.0),
            stretch: 1.0,
            stretch_end_seconds: LOAD_STRETCH_SECONDS,
            bits: 0,
            loads: Series::default(),
        })
    }

    /// Takes every frame of the bus in order.
    pub(crate) fn take(&mut self, stamped: &Stamped) {
        let time = self.cycle.hear(stamped).filter(|time| *time < self.end);
        let Some(time) = time else {
            return;
        };
        self.take_load(time, stamped.occupied_bits);
        let micros = |time: Duration| time.as_secs_f64() * 1e6;
        match self.cycle.stage(stamped, time) {
            Some(Stage::Sync { time }) => self.begin_cycle(time),
            Some(Stage::Position { after_sync }) => {
                self.timing[1].push(self.now, micros(after_sync));
            }
            Some(Stage::Command { after_sync, .. }) => {
                self.timing[2].push(self.now, micros(after_sync));
            }
            None => {}
        }
    }

    fn begin_cycle(&mut self, time: Duration) {
        let period_seconds = self.period.as_secs_f64();
        let number = (time.as_secs_f64() / period_seconds).round();
        let due_seconds = number * period_seconds;
        self.now = times::moment_at(due_seconds, period_seconds);
        let lateness = 1e6 * (time.as_secs_f64() - due_seconds);
        self.timing[0].push(self.now, lateness.round());
    }

    /// Counts bits; a stretch that is over becomes a row at its end.
    fn take_load(&mut self, time: Duration, bits: u32) {
        while time.as_secs_f64() >= self.stretch_end_seconds {
            let end = times::moment_at(self.stretch_end_seconds, self.period.as_secs_f64());
            let capacity = self.bits_per_second * LOAD_STRETCH_SECONDS;
            let load = 100.0 * f64::from(self.bits) / capacity;
            self.loads.push(end, load);
            self.stretch += 1.0;
            self.stretch_end_seconds = self.stretch * LOAD_STRETCH_SECONDS;
            self.bits = 0;
        }
        self.bits += bits;
    }

    /// Logs what there is since the last time.
    pub(super) fn log(&mut self, output: &mut impl Output) -> Result<(), RecordingStreamError> {
        let names = TIMING.map(|(name, ..)| format!("{}/{name}", groups::TIMING));
        let names = names.into_iter().chain([LOAD.to_owned()]);
        // Most cycles have a row of each timing, so the times are made once.
        let mut times = (Vec::new(), times::columns([].into_iter()));
        for (name, series) in names.zip(self.timing.iter_mut().chain([&mut self.loads])) {
            let Series { moments, values } = mem::take(series);
            if values.is_empty() {
                continue;
            }
            if moments != times.0 {
                let columns = times::columns(moments.iter().copied());
                times = (moments, columns);
            }
            send_scalars(output, name, times.1.clone(), values)?;
        }
        Ok(())
    }
}

const LOAD: &str = "bus/load_percent";

/// Names and colours.
pub(super) fn log_styles(output: &mut impl Output) -> Result<(), RecordingStreamError> {
    for (name, label, colour) in TIMING {
        send_static(
            output,
            format!("{}/{name}", groups::TIMING),
            &line(label, colour),
        )?;
    }
    send_static(output, LOAD, &line("bus load", groups::GREEN))
}
