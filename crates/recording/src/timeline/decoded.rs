//! The decoded recording: one row for each cycle.

use std::ops::Range;
use std::time::Duration;

use plan::prefix_of;
use platform::series::Series;
use scenario::expect::Emergency;
use scenario::port::Measurand;

use crate::drive_reports::DriveReports;
use crate::events::{Event, Events};
use crate::losses::LostHeartbeat;
use crate::occurrences::{Occurrence, Occurrences};
use crate::sources::Sources;
use crate::traces::SignalTrace;
use crate::truth::PlantTruth;

/// Sample times are multiples of the period; this absorbs their rounding.
pub const TIME_TOLERANCE_SECONDS: f64 = 1e-9;

/// One signal over all cycles.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// The signal's name in the DBC; the unit is its end.
    pub name: String,
    /// The unit in the DBC; empty for numbers without one.
    pub unit: String,
    /// Physical value per cycle; NaN where the signal was not on the bus yet, or, for the drive's measured values, in
    /// a cycle in which the drive was silent.
    pub values: Series<f64>,
}

/// The beginnings of the names of what not every law computes: the controller sends 0 for what its law does not have.
const OF_SOME_LAWS: [&str; 5] = [
    "reference_position_",
    "estimated_",
    "sliding_variable_",
    "equivalent_part_",
    "switching_part_",
];

impl Column {
    /// Whether a node computes it.
    #[must_use]
    pub fn is_used(&self) -> bool {
        let is_of_some_laws = OF_SOME_LAWS
            .iter()
            .any(|start| self.name.starts_with(start));
        let mut values = self.values.iter();
        !is_of_some_laws || values.any(|value| !value.is_nan() && *value != 0.0)
    }
}

/// A recording, decoded.
#[derive(Clone, Debug)]
pub struct Timeline {
    /// The name of its loop; empty for the only one.
    pub loop_name: String,
    /// The SYNC period.
    pub period_seconds: f64,
    /// Number of the cycle since scenario time 0, per row. Rows of cycles that never began are absent.
    pub cycle: Series<u64>,
    /// Scenario time per row: the cycle's number times the period.
    pub time_seconds: Series<f64>,
    /// The cycles that should have begun by the latest SYNC, up to the scenario's end.
    pub cycles_due: u64,
    /// The numbers of the cycles with a position for which no command came; none in a piece.
    pub uncommanded: Series<u64>,
    /// The numbers of the cycles whose command came a whole cycle late; none in a piece.
    pub late_commands: Series<u64>,
    /// The scenario time of each SYNC from scenario time 0 on; none in a piece.
    pub syncs_seconds: Series<f64>,
    /// The heartbeats of controller and drive that did not come; none in a piece.
    pub lost_heartbeats: Vec<LostHeartbeat>,
    /// The first stretch of scenario time in which the drive sent no temperature although it did before or later.
    pub temperature_silence: Option<(f64, f64)>,
    /// The raw set-point of the scenario per row; NaN where the scenario has none.
    pub set_point_millimetres: Series<f64>,
    /// What the loop measures; `position_millimetres` in this code stands for it.
    pub measurand: Measurand,
    pub columns: Vec<Column>,
    /// The frames that canrig's nodes may send, counted.
    pub sources: Sources,
    /// Time in which frames occupied the bus by all time, from the first SYNC on; NaN without two SYNCs.
    pub bus_load_percent: f64,
    /// The longest time between two SYNCs; NaN without two SYNCs.
    pub sync_interval_milliseconds_max: f64,
    /// What happened, in the order of time.
    pub events: Events,
    /// The emergencies that nodes sent.
    pub emergencies: Occurrences<Emergency>,
    /// What the emulated plant reported of itself; empty without faults.
    pub truth: Series<PlantTruth>,
    /// Whether the fan and load module was there and got its commands.
    pub has_fan: bool,
    /// The drive's answers to the bench; none in a piece.
    pub drive_reports: DriveReports,
    /// The signals that the scenario's checks name.
    pub traces: Vec<SignalTrace>,
    /// When the scenario began, on the recording's clock; none if it never did.
    pub zero_seconds: Option<f64>,
    /// Time 0 of all other times, on the recording's clock: the begin of the scenario, or of a recording in which it never began.
    pub origin_seconds: f64,
    /// Scenario time of the last frame.
    pub last_frame_seconds: f64,
    /// Places of columns that every recording has.
    pub(super) position: usize,
    pub(super) own_position: usize,
    pub(super) current: usize,
}

impl Timeline {
    /// The beginning of the names of its signals: empty where it is the only loop.
    #[must_use]
    pub fn prefix(&self) -> String {
        prefix_of(&self.loop_name)
    }

    /// A column by its signal's name; that of a position may be its name in millimetres too.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&Column> {
        let by = |name: &str| self.columns.iter().find(|column| column.name == name);
        by(name).or_else(|| by(&self.measurand.rename(name)))
    }

    /// The measured position that the loop follows, in its unit.
    #[must_use]
    pub fn position(&self) -> &Series<f64> {
        &self.columns[self.position].values
    }

    /// What the drive of the loop measures itself; the same where the loop follows that.
    #[must_use]
    pub fn own_position(&self) -> &Series<f64> {
        &self.columns[self.own_position].values
    }

    /// The measured current in amperes.
    #[must_use]
    pub fn current(&self) -> &Series<f64> {
        &self.columns[self.current].values
    }

    /// Scenario time at the end of the last cycle.
    #[must_use]
    pub fn end_seconds(&self) -> f64 {
        self.time_seconds
            .last()
            .map_or(0.0, |time| time + self.period_seconds)
    }

    /// A time on the recording's clock.
    #[must_use]
    pub fn recorded_time(&self, seconds: f64) -> Duration {
        let since = Duration::try_from_secs_f64(self.origin_seconds + seconds);
        since.unwrap_or_default()
    }

    /// Scenario time at the end of the last cycle that was due.
    #[must_use]
    pub fn due_seconds(&self) -> f64 {
        cycle_start_seconds(self.cycles_due, self.period_seconds)
    }

    /// Some of the rows with what happened in their time, as a timeline of its own: the first and the last have what was before
    /// and after all rows. How busy the bus was is that of the whole recording.
    #[must_use]
    pub fn piece(&self, rows: Range<usize>) -> Self {
        let part = |values: &Series<f64>| values.part(rows.clone());
        let begins = |row: usize| self.time_seconds.get(row).copied();
        let from = begins(rows.start).filter(|_| rows.start > 0);
        let until = begins(rows.end);
        let is_inside =
            |time| from.is_none_or(|from| time >= from) && until.is_none_or(|until| time < until);
        let columns = self.columns.iter().map(|column| Column {
            name: column.name.clone(),
            unit: column.unit.clone(),
            values: part(&column.values),
        });
        Self {
            loop_name: self.loop_name.clone(),
            cycle: self.cycle.part(rows.clone()),
            time_seconds: part(&self.time_seconds),
            set_point_millimetres: part(&self.set_point_millimetres),
            columns: columns.collect(),
            measurand: self.measurand.clone(),
            uncommanded: Series::default(),
            late_commands: Series::default(),
            syncs_seconds: Series::default(),
            lost_heartbeats: Vec::new(),
            temperature_silence: None,
            drive_reports: DriveReports::default(),
            events: self.events.at_times(is_inside),
            emergencies: Occurrences::default(),
            truth: Series::default(),
            traces: Vec::new(),
            sources: self.sources.clone(),
            ..*self
        }
    }

    /// Cycles in so much time, at least one.
    #[must_use]
    pub fn cycles_in(&self, seconds: f64) -> u64 {
        let cycles = (seconds / self.period_seconds).round().clamp(1.0, 1e6);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped just above"
        )]
        let cycles = cycles as u64;
        cycles
    }

    /// Cycles that never began or in which the drive was silent, by all that were due.
    #[must_use]
    pub fn missed_cycles_percent(&self) -> f64 {
        if self.cycles_due == 0 {
            return 0.0;
        }
        let is_served = |position: &&f64| !position.is_nan();
        let served = self.own_position().iter().filter(is_served).count();
        #[expect(
            clippy::cast_precision_loss,
            reason = "cycle counts stay far below 2^52"
        )]
        let (due, served) = (self.cycles_due as f64, served as f64);
        100.0 * (due - served) / due
    }
}

/// A signal over all cycles, by the name that it has among those of all loops.
#[derive(Clone, Debug)]
pub struct SignalRows<'a> {
    /// Its name.
    pub name: String,
    /// Its unit; empty for a number without one.
    pub unit: &'a str,
    /// Its value per cycle.
    pub values: &'a Series<f64>,
}

/// The signals of loops that were played at once: of each its set-point, then what was on the bus.
#[must_use]
pub fn signals(timelines: &[Timeline]) -> Vec<SignalRows<'_>> {
    let mut all = Vec::new();
    for timeline in timelines {
        let prefix = timeline.prefix();
        let set_point = (
            timeline.measurand.rename("set_point_millimetres"),
            timeline.measurand.unit.symbol(),
            &timeline.set_point_millimetres,
        );
        let columns = timeline.columns.iter();
        let columns = columns.map(|column| (column.name.clone(), &*column.unit, &column.values));
        let signals = [set_point].into_iter().chain(columns);
        let signals = signals.map(|(name, unit, values)| SignalRows {
            name: format!("{prefix}{name}"),
            unit,
            values,
        });
        all.extend(signals);
    }
    all
}

/// The events of loops that were played at once, in the order of time; what several of them saw stands once.
#[must_use]
pub fn events_of(timelines: &[Timeline]) -> Events {
    let of_each = timelines.iter().map(|timeline| timeline.events.clone());
    let all = of_each.reduce(Events::merged).unwrap_or_default();
    if timelines.len() < 2 {
        return all;
    }
    let mut earlier: Option<Occurrence<'_, Event>> = None;
    let once = all.iter().filter(|later| {
        let is_again = earlier.is_some_and(|earlier| {
            let is_then = later.time_seconds.total_cmp(&earlier.time_seconds).is_eq();
            is_then && later.text == earlier.text
        });
        if !is_again {
            earlier = Some(*later);
        }
        !is_again
    });
    once.map(|event| (event.time_seconds, event.what.clone()))
        .collect()
}

/// Scenario time at which a cycle begins.
#[expect(
    clippy::cast_precision_loss,
    reason = "cycle numbers stay far below 2^52"
)]
pub(super) fn cycle_start_seconds(cycle: u64, period_seconds: f64) -> f64 {
    cycle as f64 * period_seconds
}
