//! A recording, decoded: one row a cycle, and the events between them.

use std::ops::Range;
use std::time::Duration;

use canopen::CanFrame;
use dbc::{Database, Signal, SignalHandle};
use scenario::Scenario;

use crate::by_identifier::ByIdentifier;
use crate::events::{Event, EventReader, ToldEmergency};
use crate::losses::LossReader;
use crate::recording::Stamped;
use crate::signals::{self, COLUMN_MESSAGES, SignalMissing};
use crate::traces::{Trace, TraceReader};
use crate::truth::{Truth, TruthReader};
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};

/// One signal over all cycles.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// The signal's name in the DBC; the unit is its end.
    pub name: String,
    /// The unit in the DBC; empty for numbers without one.
    pub unit: String,
    /// Physical value per cycle; NaN where the signal was not on the bus yet, or, for the drive's measured values, in
    /// a cycle in which the drive was silent.
    pub values: Vec<f64>,
}

/// A recording, decoded.
#[derive(Clone, Debug)]
pub struct Timeline {
    /// The SYNC period.
    pub period_seconds: f64,
    /// Number of the cycle since scenario time 0, per row. Rows of cycles that never began are absent.
    pub cycle: Vec<u64>,
    /// Scenario time per row: the cycle's number times the period.
    pub time_seconds: Vec<f64>,
    /// The cycles that should have begun by the latest SYNC, up to the scenario's end.
    pub cycles_due: u64,
    /// The raw set-point of the scenario per row; NaN where the scenario has none.
    pub set_point_millimetres: Vec<f64>,
    /// All signals.
    pub columns: Vec<Column>,
    /// Time in which frames occupied the bus by all time, from the first SYNC on; NaN without two SYNCs.
    pub bus_load_percent: f64,
    /// The longest time between two SYNCs; NaN without two SYNCs.
    pub sync_interval_milliseconds_max: f64,
    /// What happened, in the order of time.
    pub events: Vec<Event>,
    /// The emergencies that nodes told.
    pub emergencies: Vec<ToldEmergency>,
    /// What the emulated plant said of itself; empty without faults.
    pub truth: Vec<Truth>,
    /// Whether the fan and load module was there and got its commands.
    pub has_fan: bool,
    /// The signals that the scenario's checks name.
    pub traces: Vec<Trace>,
    /// When the scenario began, on the recording's clock; none if it never did.
    pub zero_seconds: Option<f64>,
    /// Scenario time of the last frame.
    pub last_frame_seconds: f64,
    position: usize,
    current: usize,
}

/// Decodes frames until the scenario's end.
///
/// # Errors
/// The database lacks a signal that the bench needs.
pub fn decode(
    frames: &[Stamped],
    scenario: &Scenario,
    database: &Database,
) -> Result<Timeline, SignalMissing> {
    let mut reader = Reader::new(scenario, database)?;
    reader.reserve(frames.len());
    for stamped in frames {
        reader.take(stamped);
    }
    reader.take_rest(scenario)
}

impl Timeline {
    /// A column by its signal's name.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// The measured position in millimetres.
    #[must_use]
    pub fn position(&self) -> &[f64] {
        &self.columns[self.position].values
    }

    /// The measured current in amperes.
    #[must_use]
    pub fn current(&self) -> &[f64] {
        &self.columns[self.current].values
    }

    /// Scenario time at the end of the last cycle.
    #[must_use]
    pub fn end_seconds(&self) -> f64 {
        self.time_seconds
            .last()
            .map_or(0.0, |time| time + self.period_seconds)
    }

    /// Scenario time at the end of the last cycle that was due.
    #[must_use]
    pub fn due_seconds(&self) -> f64 {
        start_seconds(self.cycles_due, self.period_seconds)
    }

    /// Cycles that never began or in which the drive was silent, by all that were due.
    #[must_use]
    pub fn missed_cycles_percent(&self) -> f64 {
        if self.cycles_due == 0 {
            return 0.0;
        }
        let served = self
            .position()
            .iter()
            .filter(|position| !position.is_nan())
            .count();
        #[expect(
            clippy::cast_precision_loss,
            reason = "cycle counts stay far below 2^52"
        )]
        let (due, served) = (self.cycles_due as f64, served as f64);
        100.0 * (due - served) / due
    }
}

/// A signal that becomes a column.
struct Tracked {
    handle: SignalHandle,
    name: String,
    unit: String,
    /// Measured values belong to their cycle; everything else holds until it changes.
    is_measured: bool,
    /// The bits that were decoded last, and their value.
    decoded: (Option<u64>, f64),
    /// The value at the end of the latest row.
    latest: f64,
    rows: Vec<f64>,
}

impl Tracked {
    fn new(handle: SignalHandle, signal: &Signal, is_measured: bool) -> Self {
        Self {
            handle,
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            is_measured,
            decoded: (None, f64::NAN),
            latest: f64::NAN,
            rows: Vec::new(),
        }
    }

    fn begin_cycle(&mut self) {
        if self.is_measured {
            self.latest = f64::NAN;
        }
        self.rows.push(self.latest);
    }

    /// Most signals have the bits that they had before, and so the value.
    fn take(&mut self, frame: &CanFrame) {
        let Some(bits) = self.handle.bits(frame) else {
            return;
        };
        if self.decoded.0 != Some(bits) {
            self.decoded = (Some(bits), self.handle.decode(frame).unwrap_or(f64::NAN));
        }
        self.latest = self.decoded.1;
        if let Some(last) = self.rows.last_mut() {
            *last = self.latest;
        }
    }
}

/// What the frames say, cycle by cycle.
pub(crate) struct Reader {
    clock: ScenarioClock,
    period: Duration,
    end: Duration,
    end_cycle: u64,
    events: EventReader,
    losses: LossReader,
    truth: TruthReader,
    fan: FanReader,
    traces: TraceReader,
    last_frame: Duration,
    traffic: Traffic,
    /// Those of each message side by side.
    signals: Vec<Tracked>,
    /// Where the signals of each message are.
    signals_of_id: ByIdentifier<Range<usize>>,
    cycle: Vec<u64>,
    cycles_due: u64,
}

impl Reader {
    /// A reader that has heard nothing.
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub(crate) fn new(scenario: &Scenario, database: &Database) -> Result<Self, SignalMissing> {
        let signals = tracked_signals(database)?;
        let messages =
            signals.chunk_by(|left, right| left.handle.raw_id() == right.handle.raw_id());
        let signals_of_id = messages.scan(0, |end, message| {
            let first = std::mem::replace(end, *end + message.len());
            Some((message[0].handle.raw_id(), first..*end))
        });
        let period = Duration::from_secs_f64(scenario.bus.sync_period_milliseconds / 1e3);
        let end = Duration::from_secs_f64(scenario.duration_seconds);
        Ok(Self {
            clock: ScenarioClock::new(database)?,
            period,
            end,
            end_cycle: cycles(end, period),
            events: EventReader::new(database),
            losses: LossReader::new(scenario, database),
            truth: TruthReader::new(database)?,
            fan: FanReader::new(database)?,
            traces: TraceReader::new(scenario, database),
            last_frame: Duration::ZERO,
            traffic: Traffic::new(scenario),
            signals_of_id: signals_of_id.collect(),
            signals,
            cycle: Vec::new(),
            cycles_due: 0,
        })
    }

    /// Makes room for the rows of so many frames.
    fn reserve(&mut self, frames: usize) {
        let cycles = usize::try_from(self.end_cycle).unwrap_or(usize::MAX);
        let rows = cycles.min(frames);
        self.cycle.reserve(rows);
        let signals = self.signals.iter_mut();
        signals.for_each(|signal| signal.rows.reserve(rows));
    }

    /// Takes every frame of the bus in order.
    pub(crate) fn take(&mut self, stamped: &Stamped) {
        let is_sync = self.clock.on_frame(stamped.time, &stamped.frame);
        let time = self.clock.scenario_time(stamped.time);
        self.events.take(stamped, time);
        self.losses.take(stamped, time);
        self.truth.take(stamped);
        self.fan.take(&stamped.frame);
        self.last_frame = stamped.time;
        self.traffic.take(stamped, time);
        match time {
            Some(time) if is_sync => self.begin_cycle(cycles(time, self.period)),
            // How the nodes stop after the scenario's end is no part of its last cycle.
            Some(time) if time >= self.end => {}
            _ => self.take_signals(&stamped.frame),
        }
        if !self.traces.is_empty() {
            self.traces.take(stamped, time, self.cycle_seconds());
        }
    }

    /// When the latest cycle began.
    fn cycle_seconds(&self) -> Option<f64> {
        let latest = self.cycle.last()?;
        Some(start_seconds(*latest, self.period.as_secs_f64()))
    }

    fn begin_cycle(&mut self, number: u64) {
        let due = number.saturating_add(1).min(self.end_cycle);
        self.cycles_due = self.cycles_due.max(due);
        let is_new = self.cycle.last().is_none_or(|last| number > *last);
        if !is_new || number >= self.end_cycle {
            return;
        }
        self.cycle.push(number);
        self.signals.iter_mut().for_each(Tracked::begin_cycle);
    }

    fn take_signals(&mut self, frame: &CanFrame) {
        if let Some(places) = self.signals_of_id.get_mut(frame.raw_id()) {
            let signals = self.signals[places.clone()].iter_mut();
            signals.for_each(|signal| signal.take(frame));
        }
    }

    /// The cycles that no later frame can change, and what happened until now; each is given once.
    #[cfg(feature = "rerun")]
    pub(crate) fn take_piece(&mut self, scenario: &Scenario) -> Result<Timeline, SignalMissing> {
        let closed = self.cycle.len().saturating_sub(1);
        let mut piece = self.take_rows(closed, scenario)?;
        piece.events = self.events.take_until(piece.end_seconds(), scenario);
        Ok(piece)
    }

    /// Everything that was not given yet.
    pub(crate) fn take_rest(&mut self, scenario: &Scenario) -> Result<Timeline, SignalMissing> {
        let mut rest = self.take_rows(self.cycle.len(), scenario)?;
        rest.events = self.events.take_until(f64::INFINITY, scenario);
        rest.events.extend(self.losses.take_all());
        rest.events
            .sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
        rest.emergencies = self.events.emergencies();
        rest.truth = self.truth.take_all(self.events.zero());
        rest.traces = self.traces.take_all();
        Ok(rest)
    }

    /// The first rows as a timeline of their own, without events.
    fn take_rows(&mut self, rows: usize, scenario: &Scenario) -> Result<Timeline, SignalMissing> {
        let period_seconds = self.period.as_secs_f64();
        let cycle = take_front(&mut self.cycle, rows);
        let time_seconds: Vec<f64> = cycle
            .iter()
            .map(|cycle| start_seconds(*cycle, period_seconds))
            .collect();
        let columns = self.signals.iter_mut().map(|signal| Column {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            values: take_front(&mut signal.rows, rows),
        });
        let columns: Vec<Column> = columns.collect();
        let zero = self.events.zero();
        let place = |path: &str| {
            let name = path.split_once('.').map_or(path, |(_, name)| name);
            columns
                .iter()
                .position(|column| column.name == name)
                .ok_or_else(|| SignalMissing::new(path))
        };
        Ok(Timeline {
            period_seconds,
            set_point_millimetres: set_points(scenario, &time_seconds),
            cycle,
            time_seconds,
            cycles_due: self.cycles_due,
            position: place(signals::POSITION)?,
            current: place(signals::CURRENT)?,
            columns,
            events: Vec::new(),
            emergencies: Vec::new(),
            truth: Vec::new(),
            has_fan: self.fan.is_heard && self.fan.is_commanded,
            traces: Vec::new(),
            zero_seconds: zero.map(|zero| zero.as_secs_f64()),
            last_frame_seconds: self
                .last_frame
                .saturating_sub(zero.unwrap_or_default())
                .as_secs_f64(),
            bus_load_percent: self.traffic.load_percent(),
            sync_interval_milliseconds_max: self.traffic.sync_interval_milliseconds_max(),
        })
    }
}

/// Takes the first values out, without moving them.
fn take_front<T>(values: &mut Vec<T>, count: usize) -> Vec<T> {
    let rest = values.split_off(count);
    std::mem::replace(values, rest)
}

/// Whether the scenario's disturbances reach anybody.
struct FanReader {
    heartbeat_id: u32,
    command_id: u32,
    is_heard: bool,
    is_commanded: bool,
}

impl FanReader {
    fn new(database: &Database) -> Result<Self, SignalMissing> {
        Ok(Self {
            heartbeat_id: database.require(signals::FAN_STATE)?.raw_id(),
            command_id: database.require(signals::CONVECTION_FACTOR)?.raw_id(),
            is_heard: false,
            is_commanded: false,
        })
    }

    fn take(&mut self, frame: &CanFrame) {
        self.is_heard |= frame.raw_id() == self.heartbeat_id;
        self.is_commanded |= frame.raw_id() == self.command_id;
    }
}

/// How busy the bus is, from the first SYNC to the end of the scenario.
struct Traffic {
    bitrate_kilobits_per_second: f64,
    end: Duration,
    first_sync: Option<Duration>,
    latest_sync: Option<Duration>,
    latest: Duration,
    sync_interval_max: Option<Duration>,
    bits: u64,
}

impl Traffic {
    fn new(scenario: &Scenario) -> Self {
        Self {
            bitrate_kilobits_per_second: f64::from(scenario.bus.bitrate_kilobits_per_second),
            end: Duration::from_secs_f64(scenario.duration_seconds),
            first_sync: None,
            latest_sync: None,
            latest: Duration::ZERO,
            sync_interval_max: None,
            bits: 0,
        }
    }

    fn take(&mut self, stamped: &Stamped, scenario_time: Option<Duration>) {
        if scenario_time.is_some_and(|time| time >= self.end) {
            return;
        }
        if self.first_sync.is_some() {
            self.bits += u64::from(stamped.occupied_bits);
        }
        self.latest = stamped.time;
        if stamped.frame.standard_id() == Some(SYNC_COB_ID) {
            self.first_sync.get_or_insert(stamped.time);
            if let Some(before) = self.latest_sync.replace(stamped.time) {
                let interval = stamped.time.saturating_sub(before);
                self.sync_interval_max = self.sync_interval_max.max(Some(interval));
            }
        }
    }

    fn load_percent(&self) -> f64 {
        let Some(first) = self.first_sync else {
            return f64::NAN;
        };
        #[expect(clippy::cast_precision_loss, reason = "bit counts stay far below 2^52")]
        let milliseconds = self.bits as f64 / self.bitrate_kilobits_per_second;
        let recorded = 1e3 * self.latest.saturating_sub(first).as_secs_f64();
        if recorded > 0.0 {
            100.0 * milliseconds / recorded
        } else {
            f64::NAN
        }
    }

    fn sync_interval_milliseconds_max(&self) -> f64 {
        self.sync_interval_max
            .map_or(f64::NAN, |interval| 1e3 * interval.as_secs_f64())
    }
}

fn tracked_signals(database: &Database) -> Result<Vec<Tracked>, SignalMissing> {
    let mut tracked = Vec::new();
    for name in COLUMN_MESSAGES {
        let message = match database.message(name) {
            Some(message) => message,
            None if signals::OPTIONAL_MESSAGES.contains(&name) => continue,
            None => return Err(SignalMissing::new(name)),
        };
        for signal in &message.signals {
            let handle = database.require(&format!("{name}.{}", signal.name))?;
            let is_measured = signals::POSITION.starts_with(name);
            tracked.push(Tracked::new(handle, signal, is_measured));
        }
    }
    Ok(tracked)
}

/// Scenario time at which a cycle begins.
#[expect(
    clippy::cast_precision_loss,
    reason = "cycle numbers stay far below 2^52"
)]
fn start_seconds(cycle: u64, period_seconds: f64) -> f64 {
    cycle as f64 * period_seconds
}

/// The nearest whole number of periods.
fn cycles(time: Duration, period: Duration) -> u64 {
    // 64 bits last for 584 years, and divide much faster than 128.
    let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    nanos(time).saturating_add(nanos(period) / 2) / nanos(period).max(1)
}

fn set_points(scenario: &Scenario, time_seconds: &[f64]) -> Vec<f64> {
    if scenario.reference.is_empty() {
        return vec![f64::NAN; time_seconds.len()];
    }
    let trajectory = scenario.reference.trajectory();
    time_seconds
        .iter()
        .map(|time| trajectory.at(*time).position_metres * 1e3)
        .collect()
}
