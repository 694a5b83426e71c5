//! Decoded recording: one row for each cycle.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use dbc::Quantities;
use plan::loop_prefix;
use platform::series::Series;
use scenario::cycle_start_seconds;

use crate::conduct::NodeAct;
use crate::drive_reports::DriveReports;
use crate::events::Events;
use crate::losses::LostHeartbeat;
use crate::occurrences::in_order;
use crate::sources::Sources;
use crate::traces::SignalTrace;
use crate::truth::PlantTruth;

/// Sample times are multiples of the period; this absorbs their rounding.
pub const TIME_TOLERANCE_SECONDS: f64 = 1e-9;

/// Signal over all cycles.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Name of the signal in the DBC, with the unit at its end.
    pub name: String,
    /// Unit in the DBC; empty for numbers without one.
    pub unit: String,
    /// Whether it is a term of the law.
    pub is_term: bool,
    /// Physical value per cycle; NaN if the signal was not on the bus yet, or, for the drive's measured values, in a cycle in
    /// which the drive was silent.
    pub values: Series<f64>,
}

/// Decoded recording.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// Name of its loop; empty for the only one.
    pub loop_name: String,
    /// SYNC period.
    pub period_seconds: f64,
    /// Number of the cycle since scenario time 0, per row. Rows of cycles that never began are absent.
    pub cycle: Series<u64>,
    /// Scenario time per row: the cycle's number times the period.
    pub time_seconds: Series<f64>,
    /// Number of cycles that should have begun by the latest SYNC, up to the scenario's end.
    pub cycles_due: u64,
    /// Numbers of the cycles with a position for which no command came; empty in a piece.
    pub uncommanded: Series<u64>,
    /// Numbers of the cycles whose command came a whole cycle late; empty in a piece.
    pub late_commands: Series<u64>,
    /// Scenario time of each SYNC from scenario time 0 on; empty in a piece.
    pub syncs_seconds: Series<f64>,
    /// Scenario time of each position and each command; empty in a piece, and without faults, which may delay them.
    pub positions_seconds: Series<f64>,
    pub commands_seconds: Series<f64>,
    /// Acts of the run's nodes beside their cyclic frames; empty in a piece, and where all nodes are canrig's and no fault acts.
    pub conduct: Arc<[NodeAct]>,
    /// Stretches of scenario time in which frames that no loop reads keep the nodes of the run from the bus, in their order.
    pub floods: Arc<[(f64, f64)]>,
    /// Heartbeats of controller and drive that did not come; empty in a piece.
    pub lost_heartbeats: Vec<LostHeartbeat>,
    /// First stretch of scenario time in which the drive sent no temperature although it did before or later.
    pub temperature_silence: Option<(f64, f64)>,
    /// Quantity that the loop measures; its values are called positions in this code.
    pub quantities: Quantities,
    /// Raw set-point of the scenario, which is NaN if the scenario has none, then the signals on the bus.
    pub columns: Vec<Column>,
    /// Counts of the frames that canrig's nodes may send.
    pub sources: Sources,
    /// Percentage of the time for which frames occupied the bus, from the first SYNC on; NaN without two SYNCs.
    pub bus_load_percent: f64,
    /// Scenario time from the first frame of the recording to its time 0: how long this run needed to bring its nodes up.
    pub bring_up_seconds: f64,
    /// Longest time between two SYNCs; NaN without two SYNCs.
    pub sync_interval_milliseconds_max: f64,
    /// Events in the order of time.
    pub events: Events,
    /// Reports of the emulated plant on itself; empty without faults.
    pub truth: Series<PlantTruth>,
    /// Spans of scenario time in which an io node let a current flow through a plant of the loop;
    /// empty in a piece.
    pub io_currents_seconds: Vec<(f64, f64)>,
    /// Whether the io nodes that disturb the loop were present and got their commands.
    pub is_disturbed: bool,
    /// Answers of the drive to the bench; empty in a piece.
    pub drive_reports: DriveReports,
    /// Signals that the scenario's checks name, and the true position if it is judged.
    pub traces: Vec<SignalTrace>,
    /// Start of the scenario on the recording's clock; `None` if it never began.
    pub zero_seconds: Option<f64>,
    /// Time 0 of all other times, on the recording's clock: the start of the scenario, or of a recording in which it never began.
    pub origin_seconds: f64,
    /// Scenario time of the last frame.
    pub last_frame_seconds: f64,
    /// Indices of columns that every recording has.
    pub(super) position: usize,
    pub(super) measured_position: usize,
    /// Index of the measured current, if the drive sends it.
    pub(super) current: Option<usize>,
}

impl Timeline {
    /// Returns the prefix of the names of its signals; empty if it is the only loop.
    pub fn prefix(&self) -> String {
        loop_prefix(&self.loop_name)
    }

    /// Returns a column by its signal's name; or by the pattern of that name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        let by = |name: &str| self.columns.iter().find(|column| column.name == name);
        by(name).or_else(|| by(&self.quantities.name(name)))
    }

    /// Returns the scenario time at which a cycle begins.
    pub fn cycle_start_seconds(&self, cycle: u64) -> f64 {
        cycle_start_seconds(cycle, Duration::from_secs_f64(self.period_seconds))
    }

    /// Returns the raw set-point of the scenario; NaN if the scenario has none.
    pub fn set_point(&self) -> &Series<f64> {
        &self.columns[0].values
    }

    /// Returns the measured position that the loop follows, in its unit.
    pub fn position(&self) -> &Series<f64> {
        &self.columns[self.position].values
    }

    /// Returns the quantity that the drive of the loop measures itself; the same as [`Self::position`] if the loop follows it.
    pub fn measured_position(&self) -> &Series<f64> {
        &self.columns[self.measured_position].values
    }

    /// Returns the measured current in amperes, or another quantity of the amplifier; `None` if the drive does not send it.
    pub fn current(&self) -> Option<&Series<f64>> {
        self.current.map(|place| &self.columns[place].values)
    }

    /// Returns scenario time at the end of the last cycle.
    pub fn end_seconds(&self) -> f64 {
        self.time_seconds
            .last()
            .map_or(0.0, |time| time + self.period_seconds)
    }

    /// Converts a time to the recording's clock.
    pub fn recorded_time(&self, seconds: f64) -> Duration {
        let since = Duration::try_from_secs_f64(self.origin_seconds + seconds);
        since.unwrap_or_default()
    }

    /// Returns some of the rows with the events of their time, as a timeline of its own. The first and the last piece also have
    /// the events before and after all rows. A piece has nothing that is known of the whole recording only.
    pub fn piece(&self, rows: Range<usize>) -> Self {
        let part = |values: &Series<f64>| values.part(rows.clone());
        let begins = |row: usize| self.time_seconds.get(row);
        let from = begins(rows.start).filter(|_| rows.start > 0);
        let until = begins(rows.end);
        let is_inside =
            |time| from.is_none_or(|from| time >= from) && until.is_none_or(|until| time < until);
        let columns = self.columns.iter().map(|column| Column {
            name: column.name.clone(),
            unit: column.unit.clone(),
            is_term: column.is_term,
            values: part(&column.values),
        });
        let all = self.events.iter();
        let events = all.filter(|event| is_inside(event.time_seconds));
        Self {
            loop_name: self.loop_name.clone(),
            period_seconds: self.period_seconds,
            cycle: self.cycle.part(rows.clone()),
            time_seconds: part(&self.time_seconds),
            columns: columns.collect(),
            position: self.position,
            measured_position: self.measured_position,
            current: self.current,
            quantities: self.quantities.clone(),
            events: events.cloned().collect(),
            ..Self::default()
        }
    }

    /// Returns the number of cycles in a time, at least one.
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

    /// Returns the percentage of due cycles that never began or in which the drive was silent.
    pub fn missed_cycles_percent(&self) -> f64 {
        if self.cycles_due == 0 {
            return 0.0;
        }
        let is_served = |position: &f64| !position.is_nan();
        let served = self.measured_position().iter().filter(is_served).count();
        let (due, served) = (self.cycles_due as f64, served as f64);
        100.0 * (due - served) / due
    }
}

/// Returns the columns of a table of loops that were played at once, with unique names: the time, then for each loop its set-point
/// and the signals on the bus.
pub fn signals(timelines: &[Timeline]) -> Vec<Column> {
    let time = timelines.first().map(|first| Column {
        name: "time_seconds".to_owned(),
        unit: "s".to_owned(),
        is_term: false,
        values: first.time_seconds.clone(),
    });
    let mut all = Vec::from_iter(time);
    for timeline in timelines {
        let prefix = timeline.prefix();
        for mut column in timeline.columns.iter().cloned() {
            column.name.insert_str(0, &prefix);
            all.push(column);
        }
    }
    all
}

/// Returns the events of loops that were played at once, in the order of time; events that several of them saw appear once.
pub fn all_events(timelines: &[Timeline]) -> Events {
    let each = timelines.iter().flat_map(|timeline| &timeline.events);
    let mut all = in_order(each.cloned());
    if timelines.len() > 1 {
        let mut seen = BTreeSet::new();
        all.retain(|event| seen.insert((event.time_seconds.to_bits(), event.text.clone())));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::{Event, Level};
    use crate::occurrences::Occurrence;

    #[test]
    fn an_event_that_several_loops_saw_appears_once() {
        let saw = |texts: [&str; 2]| Timeline {
            events: texts
                .map(|text| Occurrence::new(1.0, Event::new(Level::Info, text)))
                .into(),
            ..Timeline::default()
        };
        let loops = [saw(["x: step", "fault"]), saw(["y: step", "fault"])];
        let events = all_events(&loops);
        let texts = Vec::from_iter(events.iter().map(|event| event.text.as_str()));
        assert_eq!(texts, ["x: step", "fault", "y: step"]);
    }
}
