//! A recording, decoded: one row a cycle, and the events between them.

use std::collections::BTreeSet;
use std::time::Duration;

use canopen::CanFrame;
use dbc::{Database, Signal, SignalHandle};
use scenario::Scenario;

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
    /// The value from the first row on that is not there yet.
    latest: f64,
    /// The rows up to the last change. Most signals keep a value for long, so rows are filled many at a time.
    rows: Vec<f64>,
}

impl Tracked {
    fn new(handle: SignalHandle, signal: &Signal) -> Self {
        Self {
            handle,
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            latest: f64::NAN,
            rows: Vec::new(),
        }
    }

    /// Has another value from a row on.
    fn change(&mut self, row: usize, value: f64) {
        self.fill(row);
        self.latest = value;
    }

    /// Has all rows before this one.
    fn fill(&mut self, row: usize) {
        match row.saturating_sub(self.rows.len()) {
            0 => {}
            // That of a signal which changes in each cycle.
            1 => self.rows.push(self.latest),
            _ => self.rows.resize(row, self.latest),
        }
    }
}

/// A message whose signals become columns.
struct TrackedMessage {
    raw_id: u32,
    signals: Vec<Tracked>,
    /// Measured values belong to their cycle; everything else holds until it changes.
    is_measured: bool,
    /// The latest frame; none where it was too short for a signal, or its values do not hold any more.
    latest: Option<CanFrame>,
    /// How many rows there were when it came.
    rows: usize,
}

impl TrackedMessage {
    fn take(&mut self, frame: &CanFrame, rows: usize) {
        // The latest row is not over, and there is none before the first cycle.
        let row = rows.saturating_sub(1);
        self.end_before(row);
        let changed = self.changed_bits(frame);
        let mut is_whole = true;
        for signal in &mut self.signals {
            if signal.handle.mask() & changed == 0 {
                continue;
            }
            if let Some(value) = signal.handle.decode(frame) {
                signal.change(row, value);
                continue;
            }
            is_whole = false;
            if self.is_measured && self.rows < rows {
                signal.change(row, f64::NAN);
            }
        }
        self.latest = is_whole.then_some(*frame);
        self.rows = rows;
    }

    /// The bits by which the frame differs from the latest; all where they cannot be compared.
    fn changed_bits(&self, frame: &CanFrame) -> u64 {
        let bits = |frame: &CanFrame| u64::from_le_bytes(frame.buffer());
        match &self.latest {
            Some(latest) if latest.data().len() == frame.data().len() => bits(latest) ^ bits(frame),
            _ => u64::MAX,
        }
    }

    /// Measured values that were not told again have none from the cycle behind theirs to this row.
    fn end_before(&mut self, row: usize) {
        if self.is_measured && self.rows < row {
            let told = self.rows;
            self.signals
                .iter_mut()
                .for_each(|signal| signal.change(told, f64::NAN));
            self.latest = None;
        }
    }

    /// Takes the first rows out.
    fn take_rows(&mut self, rows: usize) -> impl Iterator<Item = Column> {
        self.end_before(rows);
        self.rows = self.rows.saturating_sub(rows);
        self.signals.iter_mut().map(move |signal| {
            signal.fill(rows);
            Column {
                name: signal.name.clone(),
                unit: signal.unit.clone(),
                values: std::mem::take(&mut signal.rows),
            }
        })
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
    /// Raw identifiers of the messages that events, losses, the truth and the fan are read from.
    telling: BTreeSet<u32>,
    traces: TraceReader,
    last_frame: Duration,
    traffic: Traffic,
    /// In the order of the columns.
    messages: Vec<TrackedMessage>,
    cycle: Vec<u64>,
    cycles_due: u64,
}

impl Reader {
    /// A reader that has heard nothing.
    ///
    /// # Errors
    /// The database lacks a signal that the bench needs.
    pub(crate) fn new(scenario: &Scenario, database: &Database) -> Result<Self, SignalMissing> {
        let period = Duration::from_secs_f64(scenario.bus.sync_period_milliseconds / 1e3);
        let end = Duration::from_secs_f64(scenario.duration_seconds);
        let events = EventReader::new(database);
        let losses = LossReader::new(scenario, database);
        let truth = TruthReader::new(database)?;
        let fan = FanReader::new(database)?;
        let others = [truth.raw_id(), fan.heartbeat_id, fan.command_id];
        let telling = events.raw_ids().chain(losses.raw_ids()).chain(others);
        Ok(Self {
            clock: ScenarioClock::new(database)?,
            period,
            end,
            end_cycle: cycles(end, period),
            telling: telling.collect(),
            events,
            losses,
            truth,
            fan,
            traces: TraceReader::new(scenario, database),
            last_frame: Duration::ZERO,
            traffic: Traffic::new(scenario),
            messages: tracked_messages(database)?,
            cycle: Vec::new(),
            cycles_due: 0,
        })
    }

    /// Makes room for the rows of so many frames.
    fn reserve(&mut self, frames: usize) {
        let cycles = usize::try_from(self.end_cycle).unwrap_or(usize::MAX);
        let rows = cycles.min(frames);
        self.cycle.reserve(rows);
        let signals = self
            .messages
            .iter_mut()
            .flat_map(|message| &mut message.signals);
        signals.for_each(|signal| signal.rows.reserve(rows));
    }

    /// Takes every frame of the bus in order.
    pub(crate) fn take(&mut self, stamped: &Stamped) {
        let frame = &stamped.frame;
        let is_sync = self.clock.on_frame(stamped.time, frame);
        let now = stamped.time;
        let time = self.clock.scenario_time(stamped.time);
        self.last_frame = now;
        if let Some(time) = time {
            self.losses.pass(time);
        }
        if frame.is_error() || self.telling.contains(&frame.raw_id()) {
            self.take_telling(stamped, time);
        }
        // How the nodes stop after the scenario's end is no part of its last cycle.
        if time.is_none_or(|time| time < self.end) {
            self.traffic.take(frame, now, stamped.occupied_bits);
            self.take_signals(frame);
        }
        if let Some(time) = time.filter(|_| is_sync) {
            self.begin_cycle(cycles(time, self.period));
        }
        if !self.traces.is_empty() {
            self.traces.take(frame, time, self.cycle_seconds());
        }
    }

    /// Takes a frame for those that want few.
    fn take_telling(&mut self, stamped: &Stamped, time: Option<Duration>) {
        self.events.take(stamped);
        if let Some(time) = time {
            self.losses.take(&stamped.frame, time);
        }
        if stamped.frame.raw_id() == self.truth.raw_id() {
            self.truth.take(stamped);
        }
        self.fan.take(&stamped.frame);
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
    }

    fn take_signals(&mut self, frame: &CanFrame) {
        let mut messages = self.messages.iter_mut();
        if let Some(message) = messages.find(|message| message.raw_id == frame.raw_id()) {
            message.take(frame, self.cycle.len());
        }
    }

    /// The cycles that no later frame can change, and what happened until now; each is given once.
    #[cfg(feature = "rerun")]
    pub(crate) fn take_piece(&mut self, scenario: &Scenario) -> Result<Timeline, SignalMissing> {
        let closed = self.cycle.len().saturating_sub(1);
        let mut piece = self.take_rows(closed, scenario)?;
        let zero = self.clock.zero();
        piece.events = self.events.take_until(piece.end_seconds(), scenario, zero);
        Ok(piece)
    }

    /// Everything that was not given yet.
    pub(crate) fn take_rest(&mut self, scenario: &Scenario) -> Result<Timeline, SignalMissing> {
        let mut rest = self.take_rows(self.cycle.len(), scenario)?;
        let zero = self.clock.zero();
        rest.events = self.events.take_until(f64::INFINITY, scenario, zero);
        rest.events.extend(self.losses.take_all());
        rest.events
            .sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
        rest.emergencies = self.events.emergencies(zero);
        rest.truth = self.truth.take_all(zero);
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
        let messages = self.messages.iter_mut();
        let columns: Vec<Column> = messages
            .flat_map(|message| message.take_rows(rows))
            .collect();
        let zero = self.clock.zero();
        let since_zero = self.last_frame.saturating_sub(zero.unwrap_or_default());
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
            last_frame_seconds: since_zero.as_secs_f64(),
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
            first_sync: None,
            latest_sync: None,
            latest: Duration::ZERO,
            sync_interval_max: None,
            bits: 0,
        }
    }

    fn take(&mut self, frame: &CanFrame, now: Duration, occupied_bits: u32) {
        if self.first_sync.is_some() {
            self.bits += u64::from(occupied_bits);
        }
        self.latest = now;
        if frame.standard_id() == Some(SYNC_COB_ID) {
            self.first_sync.get_or_insert(now);
            if let Some(before) = self.latest_sync.replace(now) {
                let interval = now.saturating_sub(before);
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

fn tracked_messages(database: &Database) -> Result<Vec<TrackedMessage>, SignalMissing> {
    let mut messages = Vec::new();
    for name in COLUMN_MESSAGES {
        let message = match database.message(name) {
            Some(message) => message,
            None if signals::OPTIONAL_MESSAGES.contains(&name) => continue,
            None => return Err(SignalMissing::new(name)),
        };
        let signals = message.signals.iter().map(|signal| {
            let handle = database.require(&format!("{name}.{}", signal.name))?;
            Ok(Tracked::new(handle, signal))
        });
        messages.push(TrackedMessage {
            raw_id: message.raw_id,
            signals: signals.collect::<Result<_, SignalMissing>>()?,
            is_measured: signals::POSITION.starts_with(name),
            latest: None,
            rows: 0,
        });
    }
    Ok(messages)
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
    let cycles = time.saturating_add(period / 2).as_nanos() / period.as_nanos().max(1);
    u64::try_from(cycles).unwrap_or(u64::MAX)
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

#[cfg(all(test, feature = "rerun"))]
mod tests {
    use super::*;
    use crate::signals::STATUSWORD;
    use proptest::prelude::*;

    /// A signal that is read cycle by cycle.
    struct Simple {
        handle: SignalHandle,
        is_measured: bool,
        latest: f64,
        rows: Vec<f64>,
    }

    impl Simple {
        fn begin_cycle(&mut self) {
            if self.is_measured {
                self.latest = f64::NAN;
            }
            self.rows.push(self.latest);
        }

        fn take(&mut self, frame: &CanFrame) {
            if let Some(value) = self.handle.decode(frame) {
                self.latest = value;
                self.rows
                    .last_mut()
                    .into_iter()
                    .for_each(|last| *last = value);
            }
        }
    }

    proptest! {
        #[test]
        fn rows_hold_what_was_told_in_their_cycles(steps in prop::collection::vec((0..8u8, any::<u8>(), 0..=8usize), 0..200)) {
            let text = "schema = 1\nname = \"t\"\nduration_seconds = 10.0\n[controller.open_loop]\n";
            let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
            let database = Database::sma_actuator();
            let paths = [signals::POSITION, signals::CURRENT, STATUSWORD, signals::TARGET_CURRENT];
            let mut expected = paths.map(|path| Simple {
                handle: database.require(path).unwrap(),
                is_measured: path.starts_with("drive_tpdo1"),
                latest: f64::NAN,
                rows: Vec::new(),
            });
            let ids = [0, 3].map(|place: usize| u16::try_from(expected[place].handle.raw_id()).unwrap());
            let mut enabled = database.builder("drive_tpdo1").unwrap();
            enabled.set(&expected[2].handle, 55.0);
            let sync = CanFrame::new(SYNC_COB_ID, &[]);
            let mut reader = Reader::new(&scenario, database).unwrap();
            let mut pieces = Vec::new();
            let mut micros = 0;
            for (kind, byte, length) in [(8, 0, 0), (0, 0, 0)].into_iter().chain(steps) {
                let told = |id| CanFrame::new(id, &[byte & 3; 8][..length]);
                let frame = match kind {
                    0 | 1 => sync,
                    2..5 => told(ids[0]),
                    5 | 6 => told(ids[1]),
                    7 => {
                        pieces.push(reader.take_piece(&scenario).unwrap());
                        continue;
                    }
                    _ => enabled.frame(),
                };
                if frame == sync {
                    micros += 1000 * (1 + u64::from(byte % 3));
                    expected.iter_mut().for_each(Simple::begin_cycle);
                }
                expected.iter_mut().for_each(|signal| signal.take(&frame));
                reader.take(&Stamped::new(Duration::from_micros(micros), frame));
            }
            pieces.push(reader.take_rest(&scenario).unwrap());
            for (path, signal) in paths.iter().zip(&expected) {
                let (_, name) = path.split_once('.').unwrap();
                let rows = pieces.iter().flat_map(|piece| &piece.column(name).unwrap().values);
                let bits = |rows: Vec<f64>| rows.into_iter().map(f64::to_bits).collect::<Vec<_>>();
                prop_assert_eq!(bits(rows.copied().collect()), bits(signal.rows.clone()), "{}", path);
            }
        }
    }
}
