//! How punctual the cycles were and how busy the bus, from the stamps of the recording.

use std::time::Duration;

use dbc::Database;
use rerun::{RecordingStreamError, Scalars};
use scenario::Scenario;

use super::groups;
use super::output::{Output, send_rows, send_static};
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

/// What the stamps say, cycle by cycle.
pub(crate) struct BusReader {
    cycle: CycleReader,
    period: Duration,
    end: Duration,
    bits_per_second: f64,
    rows: [Vec<(Moment, f64)>; 3],
    now: Moment,
    stretch: f64,
    bits: u32,
    loads: Vec<(Moment, f64)>,
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
            rows: [const { Vec::new() }; 3],
            now: times::moment_at(0.0, 1.0),
            stretch: 1.0,
            bits: 0,
            loads: Vec::new(),
        })
    }

    /// Takes every frame of the bus in order.
    pub(crate) fn take(&mut self, stamped: &Stamped) {
        let stage = self.cycle.take(stamped, self.end);
        if let Some(time) = self.cycle.scenario_time(stamped)
            && time < self.end
        {
            self.take_load(time, stamped.occupied_bits);
        }
        let micros = |time: Duration| time.as_secs_f64() * 1e6;
        match stage {
            Some(Stage::Sync { time }) => self.begin_cycle(time),
            Some(Stage::Position { after_sync }) => {
                self.rows[1].push((self.now, micros(after_sync)))
            }
            Some(Stage::Command { after_sync, .. }) => {
                self.rows[2].push((self.now, micros(after_sync)));
            }
            None => {}
        }
    }

    fn begin_cycle(&mut self, time: Duration) {
        let period_seconds = self.period.as_secs_f64();
        let number = libm::round(time.as_secs_f64() / period_seconds);
        let due_seconds = number * period_seconds;
        self.now = times::moment_at(due_seconds, period_seconds);
        let lateness = 1e6 * (time.as_secs_f64() - due_seconds);
        self.rows[0].push((self.now, libm::round(lateness)));
    }

    /// Counts bits; a stretch that is over becomes a row at its end.
    fn take_load(&mut self, time: Duration, bits: u32) {
        while time.as_secs_f64() >= self.stretch * LOAD_STRETCH_SECONDS {
            let end = times::moment_at(
                self.stretch * LOAD_STRETCH_SECONDS,
                self.period.as_secs_f64(),
            );
            let capacity = self.bits_per_second * LOAD_STRETCH_SECONDS;
            self.loads
                .push((end, 100.0 * f64::from(self.bits) / capacity));
            self.stretch += 1.0;
            self.bits = 0;
        }
        self.bits += bits;
    }

    /// Logs what there is since the last time.
    pub(super) fn log(&mut self, output: &mut impl Output) -> Result<(), RecordingStreamError> {
        for ((name, _, _), rows) in TIMING.iter().zip(&mut self.rows) {
            send(output, &format!("{}/{name}", groups::TIMING), rows)?;
        }
        send(output, LOAD, &mut self.loads)
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

fn send(
    output: &mut impl Output,
    path: &str,
    rows: &mut Vec<(Moment, f64)>,
) -> Result<(), RecordingStreamError> {
    if rows.is_empty() {
        return Ok(());
    }
    let times = times::columns(rows.iter().map(|(moment, _)| *moment));
    let values = Scalars::new(rows.iter().map(|(_, value)| *value)).columns_of_unit_batches()?;
    rows.clear();
    send_rows(output, path, times, values)
}
