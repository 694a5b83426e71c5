//! Decodes frames, cycle by cycle.

use std::iter;
use std::sync::Arc;
use std::time::Duration;

use dbc::scenario_clock::SYNC_COB_ID;
use dbc::{Database, SignalMissing, names};
use plan::{ControlLoop, Plan};
use platform::series::{KEPT_MAX, Series, SeriesWriter};
use scenario::{Trial, cycle_start_seconds, nearest_cycle};

use super::columns::Columns;
use super::commands::CommandReader;
use super::decoded::{Column, Timeline};
use super::passing::Passing;
use crate::conduct::{ConductReader, NodeAct};
use crate::drive_reports::DriveReportReader;
use crate::events::{Event, EventReader, planned};
use crate::frames::Frames;
use crate::identifiers::ByIdentifier;
use crate::io_currents::IoCurrentReader;
use crate::io_nodes::IoReader;
use crate::log::Stamped;
use crate::losses::LossReader;
use crate::occurrences::{Occurrence, in_order};
use crate::sources::SourceReader;
use crate::traces::TraceReader;
use crate::truth::TruthReader;

/// Decodes frames until the scenario's end: a timeline for each loop of the plan.
///
/// # Errors
/// If the database lacks a signal that the bench needs.
pub fn decode(frames: &Frames, plan: &Plan) -> Result<Vec<Timeline>, SignalMissing> {
    let mut reader = RunReader::new(plan)?;
    for stamped in frames.iter() {
        reader.on_frame(&stamped);
    }
    Ok(reader.take(true))
}

/// Decoder of the frames of a run as they come. The clock, the traffic and the events of the bus are read once for all loops.
pub struct RunReader<'a> {
    plan: &'a Plan,
    passing: Passing,
    events: EventReader,
    conduct: Option<ConductReader>,
    loops: Vec<LoopReader>,
    /// Indices of the loops that read an identifier: most frames are of one loop only.
    read_by: ByIdentifier<Vec<usize>>,
}

impl<'a> RunReader<'a> {
    /// Makes a reader, which keeps a bounded number of rows in memory.
    ///
    /// # Errors
    /// If the database lacks a signal that the bench needs.
    pub fn new(plan: &'a Plan) -> Result<Self, SignalMissing> {
        // All loops together have as much in memory as one.
        let kept_max = KEPT_MAX / plan.loops.len();
        let loops = plan.loops.iter();
        let readers = loops.map(|one| LoopReader::new(plan.database(), one, kept_max));
        let loops = readers.collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            passing: Passing::new(plan)?,
            events: EventReader::new(plan.database(), &plan.nodes, plan.loops.len() > 1),
            conduct: (plan.has_faults() || !plan.external_names().is_empty())
                .then(|| ConductReader::new(plan)),
            read_by: ByIdentifier::of_readers(loops.iter().map(LoopReader::raw_ids)),
            loops,
            plan,
        })
    }

    /// Takes every frame of the bus in order.
    #[inline]
    pub fn on_frame(&mut self, stamped: &Stamped) {
        let time = self.passing.on_frame(stamped);
        self.passing.traffic.on_frame(stamped, time);
        self.events.on_frame(stamped);
        if let Some(conduct) = &mut self.conduct {
            conduct.on_frame(&stamped.frame, time);
        }
        let id = stamped.frame.raw_id();
        match (self.read_by.get(id), time) {
            (Some(places), _) => {
                for place in places {
                    self.loops[*place].on_frame(id, stamped, time);
                }
            }
            (None, Some(time)) => self.passing.traffic.on_unknown(stamped, time),
            (None, None) => {}
        }
    }

    /// Takes for each loop the cycles that no later frame can change, and the events so far, each once; after the last frame all
    /// that was not taken yet. If the scenario never began, times are those of the recording.
    pub fn take(&mut self, is_last: bool) -> Vec<Timeline> {
        let passing = &self.passing;
        // Before the scenario began, the times of events are not known.
        let zero = passing.clock.zero().or(is_last.then_some(Duration::ZERO));
        let on_bus = zero.map(|zero| self.events.take(zero));
        let conduct = self.conduct.as_mut().filter(|_| is_last);
        let conduct: Arc<[NodeAct]> = conduct.map(ConductReader::take).unwrap_or_default().into();
        let loops = self.loops.iter_mut().zip(&self.plan.loops);
        let timelines = loops.map(|(reader, one)| {
            let mut taken = if is_last {
                Timeline {
                    conduct: Arc::clone(&conduct),
                    ..reader.take_rest(&one.trial, passing)
                }
            } else {
                reader.take_piece(&one.trial, passing)
            };
            let events = on_bus.iter().flatten().cloned();
            taken.events = in_order(events.chain(taken.events));
            taken
        });
        timelines.collect()
    }
}

/// Decoder of the frames of a loop.
struct LoopReader {
    loop_name: String,
    period: Duration,
    /// Time after a SYNC from which a frame does not belong to its cycle.
    late_after: Duration,
    /// Scenario time after which a frame does not belong to the latest cycle.
    late_from: Duration,
    /// End of the scenario.
    end: Duration,
    end_cycle: u64,
    /// Time until which the events of the scenario were given.
    given_until_seconds: f64,
    losses: LossReader,
    truth: TruthReader,
    io_nodes: IoReader,
    io_currents: IoCurrentReader,
    drive_reports: DriveReportReader,
    traces: TraceReader,
    sources: SourceReader,
    columns: Columns,
    /// Indices of columns, as in a timeline.
    position: usize,
    measured_position: usize,
    current: Option<usize>,
    commands: CommandReader,
    cycle: SeriesWriter<u64>,
    syncs_seconds: SeriesWriter<f64>,
    arrivals: Option<Arrivals>,
    cycles_due: u64,
    /// Whether a cycle has begun after the last one of the scenario.
    is_over: bool,
}

/// Times of the frames that a fault may delay.
struct Arrivals {
    position_id: u32,
    command_id: u32,
    positions_seconds: SeriesWriter<f64>,
    commands_seconds: SeriesWriter<f64>,
}

impl Arrivals {
    fn new(database: &Database, one: &ControlLoop, kept_max: usize) -> Result<Self, SignalMissing> {
        Ok(Self {
            position_id: one.drive_position(database)?.raw_id(),
            command_id: one.target(database)?.raw_id(),
            positions_seconds: SeriesWriter::keeping(kept_max),
            commands_seconds: SeriesWriter::keeping(kept_max),
        })
    }

    fn on_frame(&mut self, id: u32, time: Duration) {
        if id == self.position_id {
            self.positions_seconds.push(time.as_secs_f64());
        } else if id == self.command_id {
            self.commands_seconds.push(time.as_secs_f64());
        }
    }
}

impl LoopReader {
    /// Makes a reader that keeps at most `kept_max` rows in memory.
    ///
    /// # Errors
    /// If the database lacks a signal that the bench needs.
    fn new(database: &Database, one: &ControlLoop, kept_max: usize) -> Result<Self, SignalMissing> {
        let period = one.trial.run.bus.sync_period();
        let late_after = period + period / 2;
        let end = Duration::from_secs_f64(one.trial.run.duration_seconds);
        let (wiring, columns) = (&one.trial.wiring, Columns::new(database, one, kept_max));
        let quantities = &wiring.quantities;
        let measured_position = wiring.name_in_loop(&wiring.sensor.quantity.key());
        Ok(Self {
            loop_name: one.name().to_owned(),
            end,
            end_cycle: nearest_cycle(end, period),
            given_until_seconds: f64::NEG_INFINITY,
            period,
            late_after,
            late_from: late_after,
            losses: LossReader::new(database, one),
            commands: CommandReader::new(database, one, period, kept_max)?,
            truth: TruthReader::new(database, one)?,
            io_nodes: IoReader::new(database, one),
            io_currents: IoCurrentReader::new(database, one),
            drive_reports: DriveReportReader::new(database, one),
            traces: TraceReader::new(database, one),
            sources: SourceReader::new(database, one),
            position: columns.place(&quantities.name(names::POSITION))?,
            measured_position: columns.place(&measured_position)?,
            current: columns.place(&quantities.name(names::OUTPUT)).ok(),
            columns,
            cycle: SeriesWriter::keeping(kept_max),
            syncs_seconds: SeriesWriter::keeping(kept_max),
            arrivals: (!one.trial.run.faults.is_empty())
                .then(|| Arrivals::new(database, one, kept_max))
                .transpose()?,
            cycles_due: 0,
            is_over: false,
        })
    }

    /// Returns the identifiers of the messages from which everything but events is read. On a rig with several loops, most frames
    /// are those of others.
    fn raw_ids(&self) -> impl Iterator<Item = u32> {
        let cyclic = self.traces.raw_ids().chain(self.columns.raw_ids());
        cyclic
            .chain(self.sources.raw_ids())
            .chain(self.losses.raw_ids())
            .chain(self.truth.raw_id())
            .chain(self.io_nodes.raw_ids())
            .chain(self.io_currents.raw_ids())
            .chain([SYNC_COB_ID.into(), self.drive_reports.raw_id])
    }

    /// Takes a frame of a message that is read in each cycle, or watched.
    fn on_frame(&mut self, id: u32, stamped: &Stamped, time: Option<Duration>) {
        let frame = &stamped.frame;
        self.sources.on_frame(stamped.time, time, frame);
        // A node that was heard before the scenario is missed from its start on.
        self.losses.on_frame(frame, time.unwrap_or_default());
        if Some(id) == self.truth.raw_id() {
            self.truth.on_frame(stamped);
        }
        if let Some(time) = time.filter(|_| id == self.drive_reports.raw_id) {
            self.drive_reports.on_frame(time, frame);
        }
        self.io_nodes.on_frame(frame);
        self.io_currents.on_frame(time.unwrap_or_default(), frame);
        let is_sync = frame.standard_id() == Some(SYNC_COB_ID);
        // After the end of the latest cycle and before the SYNC of another.
        let is_late = time.is_some_and(|time| time > self.late_from);
        // Frames after the last cycle, with which the nodes stop, are no part of it.
        if time.is_none_or(|time| time < self.end) && !self.is_over {
            self.columns.on_frame(frame, self.cycle.len(), is_late);
            if let Some(time) = time {
                self.commands.on_frame(frame, time, is_late);
                if let Some(arrivals) = &mut self.arrivals {
                    arrivals.on_frame(id, time);
                }
            }
        }
        if let Some(time) = time.filter(|_| is_sync) {
            self.late_from = time.saturating_add(self.late_after);
            if time < self.end {
                self.syncs_seconds.push(time.as_secs_f64());
            }
            self.begin_cycle(nearest_cycle(time, self.period));
        }
        if let Some(time) = time.filter(|time| !self.traces.is_empty() && *time < self.end) {
            let (cycle, period) = (&self.cycle, self.period);
            let cycle_seconds = || {
                let latest = cycle.last().filter(|_| is_sync || !is_late)?;
                Some(cycle_start_seconds(*latest, period))
            };
            self.traces.on_frame(frame, time, cycle_seconds);
        }
    }

    fn begin_cycle(&mut self, number: u64) {
        let due = number.saturating_add(1).min(self.end_cycle);
        self.cycles_due = self.cycles_due.max(due);
        let is_new = self.cycle.last().is_none_or(|last| number > *last);
        // If the duration is no multiple of the period, a cycle may begin that is not the scenario's.
        let begin = u32::try_from(number).unwrap_or(u32::MAX);
        let begin = self.period.saturating_mul(begin);
        self.is_over |= number >= self.end_cycle && begin < self.end;
        if is_new && number < self.end_cycle {
            self.cycle.push(number);
            self.commands.begin_cycle(number);
        }
    }

    /// Takes the events of the scenario that were not taken yet, up to a time, in no order.
    fn planned_until(&mut self, until_seconds: f64, trial: &Trial) -> Vec<Occurrence<Event>> {
        let from_seconds = std::mem::replace(&mut self.given_until_seconds, until_seconds);
        let loop_name = Some(&*self.loop_name).filter(|name| !name.is_empty());
        let mut planned = planned(trial, loop_name);
        planned.retain(|event| (from_seconds..until_seconds).contains(&event.time_seconds));
        planned
    }

    /// Takes the cycles that no later frame can change, with the events of the loop alone.
    fn take_piece(&mut self, trial: &Trial, passing: &Passing) -> Timeline {
        let mut piece = self.take_rows(self.cycle.len().saturating_sub(1), trial, passing);
        if passing.clock.zero().is_some() {
            piece.events = self.planned_until(piece.end_seconds(), trial);
        }
        piece
    }

    /// Takes everything that was not taken yet, with the events of the loop alone.
    fn take_rest(&mut self, trial: &Trial, passing: &Passing) -> Timeline {
        let mut rest = self.take_rows(self.cycle.len(), trial, passing);
        let events = self.planned_until(f64::INFINITY, trial);
        let (zero, latest) = (passing.clock.zero(), passing.latest);
        let (uncommanded, late_commands, silences) = self.commands.take_all(latest);
        rest.uncommanded = uncommanded;
        rest.late_commands = late_commands;
        rest.syncs_seconds = self.syncs_seconds.take(self.syncs_seconds.len());
        if let Some(arrivals) = &mut self.arrivals {
            let take = |times: &mut SeriesWriter<f64>| times.take(times.len());
            rest.positions_seconds = take(&mut arrivals.positions_seconds);
            rest.commands_seconds = take(&mut arrivals.commands_seconds);
        }
        let mut losses = self.losses.take_all(latest);
        let lost = losses.events.take_since(0.0);
        rest.events = events.into_iter().chain(lost).chain(silences).collect();
        rest.lost_heartbeats = losses.heartbeats;
        rest.temperature_silence = losses.temperature_silence;
        rest.truth = self.truth.take_all(zero);
        rest.io_currents_seconds = self.io_currents.take_all(latest);
        rest.traces = self.traces.take_all();
        rest.drive_reports = std::mem::take(&mut self.drive_reports.reports);
        rest
    }

    /// Takes the first rows as a timeline of their own, without events.
    fn take_rows(&mut self, rows: usize, trial: &Trial, passing: &Passing) -> Timeline {
        let cycle = self.cycle.take(rows);
        let starts = cycle.iter();
        let time_seconds: Series<f64> = starts
            .map(|cycle| cycle_start_seconds(cycle, self.period))
            .collect();
        let zero = passing.clock.zero();
        let origin = zero.unwrap_or(passing.first_frame.unwrap_or_default());
        let since_zero = (passing.last_frame).saturating_sub(zero.unwrap_or_default());
        let mut sources = self.sources.sources().clone();
        sources.is_order_lost = passing.is_order_lost;
        let quantities = &trial.wiring.quantities;
        let set_point = Column {
            name: quantities.name(names::SET_POINT),
            unit: quantities.feedback.unit.symbol().to_owned(),
            is_term: false,
            values: set_points(trial, &time_seconds),
        };
        let on_bus = self.columns.take_rows(rows);
        let columns = Vec::from_iter([set_point].into_iter().chain(on_bus));
        Timeline {
            loop_name: self.loop_name.clone(),
            period_seconds: self.period.as_secs_f64(),
            quantities: quantities.clone(),
            cycle,
            time_seconds,
            cycles_due: self.cycles_due,
            position: self.position,
            measured_position: self.measured_position,
            current: self.current,
            columns,
            is_disturbed: self.io_nodes.is_disturbed(),
            zero_seconds: zero.map(|zero| zero.as_secs_f64()),
            origin_seconds: origin.as_secs_f64(),
            last_frame_seconds: since_zero.as_secs_f64(),
            sources,
            bus_load_percent: passing
                .traffic
                .load_percent(trial.run.bus.bitrate_kilobits_per_second),
            sync_interval_milliseconds_max: passing.traffic.sync_interval_milliseconds_max(),
            bring_up_seconds: origin
                .saturating_sub(passing.first_frame.unwrap_or_default())
                .as_secs_f64(),
            floods: passing.traffic.floods(),
            ..Timeline::default()
        }
    }
}

fn set_points(trial: &Trial, time_seconds: &Series<f64>) -> Series<f64> {
    if trial.reference.is_empty() {
        return iter::repeat_n(f64::NAN, time_seconds.len()).collect();
    }
    let trajectory = trial.reference.trajectory();
    let times = time_seconds.iter();
    times.map(|time| trajectory.at(time).position).collect()
}

#[cfg(test)]
mod tests {
    use can::CanFrame;
    use dbc::SignalHandle;
    use proptest::prelude::*;

    use super::*;

    const POSITION: &str = "drive_tpdo1.position_millimetres";
    const STATUSWORD: &str = "drive_tpdo1.statusword_state";

    /// Signal that is read cycle by cycle.
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

        fn on_frame(&mut self, frame: &CanFrame) {
            if let Some(value) = self.handle.decode(frame) {
                self.latest = value;
                self.rows
                    .last_mut()
                    .into_iter()
                    .for_each(|last| *last = value);
            }
        }
    }

    /// Returns two cycles, after which the drive continues to send.
    fn two_cycles() -> (Plan, Vec<Stamped>) {
        two_cycles_with("position_millimetres", (0, CanFrame::new(0x7FF, &[])))
    }

    /// Returns these cycles with one more frame, judged by a signal.
    fn two_cycles_with(signal: &str, more: (u64, CanFrame)) -> (Plan, Vec<Stamped>) {
        let text = &format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 10.0\n[controller.open_loop]\n\
             [[expect.signal]]\nname = \"{signal}\"\nreaches = {{ min = 9.0 }}\n"
        );
        let plan = testing::plan(text);
        let database = plan.database();
        let position = |millimetres: f64| {
            let mut message = database.builder("drive_tpdo1").unwrap();
            message.set(&database.require(STATUSWORD).unwrap(), 39.0);
            message.set(&database.require(POSITION).unwrap(), millimetres);
            message.frame()
        };
        let sync = CanFrame::new(SYNC_COB_ID, &[]);
        let mut frames = [
            more,
            (0, position(0.0)),
            (1000, sync),
            (1130, position(1.0)),
            (2000, sync),
            (2130, position(2.0)),
            (3700, position(9.0)),
        ];
        frames.sort_by_key(|(micros, _)| *micros);
        let frames =
            frames.map(|(micros, frame)| Stamped::new(Duration::from_micros(micros), frame));
        (plan, frames.into())
    }

    #[test]
    fn a_position_after_the_last_cycle_is_in_no_row() {
        let (plan, frames) = two_cycles();
        let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        assert_eq!(timeline.position().to_vec(), [1.0, 2.0]);
        let samples: Vec<_> = timeline.traces[0]
            .samples
            .iter()
            .map(|one| (one.time_seconds, one.value))
            .collect();
        assert_eq!(samples, [(0.0, 1.0), (0.001, 2.0), (0.0027, 9.0)]);
    }

    #[test]
    fn what_follows_no_sync_is_sampled_when_it_comes() {
        let heartbeat = (1500, CanFrame::new(0x710, &[5]));
        let (plan, frames) = two_cycles_with("drive_heartbeat.nmt_state", heartbeat);
        let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        let sample = timeline.traces[0].samples.first().unwrap();
        assert_eq!((sample.time_seconds, sample.value), (0.0005, 5.0));
    }

    #[test]
    fn pieces_have_all_rows_and_events_once() {
        let (plan, frames) = two_cycles();
        let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        let [first, second] = [0..1, 1..2].map(|rows| timeline.piece(rows));
        let rows = |piece: &Timeline| (piece.cycle.to_vec(), piece.position().to_vec());
        assert_eq!(rows(&first), (vec![0], vec![1.0]));
        assert_eq!(rows(&second), (vec![1], vec![2.0]));
        assert!(!timeline.events.is_empty());
        assert!(
            timeline
                .events
                .iter()
                .all(|event| event.emergency.is_none())
        );
        let texts = |timelines: &[&Timeline]| {
            let events = timelines.iter().flat_map(|timeline| timeline.events.iter());
            Vec::from_iter(events.map(|event| (event.time_seconds, event.what.clone())))
        };
        assert_eq!(texts(&[&first, &second]), texts(&[&timeline]));
        assert_eq!(texts(&[&timeline.piece(0..2)]), texts(&[&timeline]));
    }

    #[test]
    fn a_message_that_comes_at_the_very_end_of_the_scenario_is_back() {
        for (late, expected) in [(0, true), (1, false)] {
            let (plan, mut frames) = two_cycles();
            let end = Duration::from_micros(10_001_000 + late);
            frames.push(Stamped::new(end, CanFrame::new(SYNC_COB_ID, &[])));
            let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
            let mut texts = timeline.events.iter().map(|event| event.text.as_str());
            let is_back = texts.any(|text| text == "SYNC from the controller is back");
            assert_eq!(is_back, expected, "{late}");
        }
    }

    /// Only the whole recording has the silence, none of its pieces.
    #[test]
    fn no_piece_has_the_silence_of_the_whole() {
        let (plan, frames) = two_cycles();
        let [mut timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        timeline.temperature_silence = Some((0.5, 1.0));
        assert_eq!(timeline.piece(0..1).temperature_silence, None);
    }

    #[test]
    fn a_bit_that_changes_alone_is_a_change() {
        let (plan, mut frames) = two_cycles();
        let database = plan.database();
        let warning = database.require("drive_tpdo1.statusword_warning").unwrap();
        for (cycle, value) in [(4, 0.0), (5, 1.0), (6, 0.0)] {
            let mut message = database.builder("drive_tpdo1").unwrap();
            message.set(&database.require(STATUSWORD).unwrap(), 39.0);
            message.set(&warning, value);
            let at = |micros: u64| Duration::from_micros(1000 * cycle + micros);
            frames.push(Stamped::new(at(0), CanFrame::new(SYNC_COB_ID, &[])));
            frames.push(Stamped::new(at(130), message.frame()));
        }
        let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        let values = &timeline.column("statusword_warning").unwrap().values;
        assert_eq!(values.to_vec(), [0.0, 0.0, 0.0, 1.0, 0.0]);
    }

    /// Two cycles are served, two never begin, and the last has no position.
    #[test]
    fn three_cycles_of_five_are_missed() {
        let (plan, mut frames) = two_cycles();
        let sync = CanFrame::new(SYNC_COB_ID, &[]);
        frames.push(Stamped::new(Duration::from_micros(5000), sync));
        let [timeline] = <[_; 1]>::try_from(decode(&frames.into(), &plan).unwrap()).unwrap();
        assert_eq!(timeline.missed_cycles_percent(), 60.0);
    }

    proptest! {
        #[test]
        fn rows_hold_what_was_sent_in_their_cycles(steps in prop::collection::vec((0..8u8, any::<u8>(), 0..=8usize), 0..200)) {
            let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 10.0\n[controller.open_loop]\n";
            let plan = testing::plan(text);
            let database = plan.database();
            let paths = [POSITION, "drive_tpdo1.current_amperes", STATUSWORD, "drive_rpdo1.target_current_amperes"];
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
            let mut reader = RunReader::new(&plan).unwrap();
            let mut pieces = Vec::new();
            let mut micros = 0;
            for (kind, byte, length) in [(8, 0, 0), (0, 0, 0)].into_iter().chain(steps) {
                let sent = |id| CanFrame::new(id, &[byte & 3; 8][..length]);
                let frame = match kind {
                    0 | 1 => sync,
                    2..5 => sent(ids[0]),
                    5 | 6 => sent(ids[1]),
                    7 => {
                        pieces.extend(reader.take(false));
                        continue;
                    }
                    _ => enabled.frame(),
                };
                if frame == sync {
                    micros += 1000 * (1 + u64::from(byte % 3));
                    expected.iter_mut().for_each(Simple::begin_cycle);
                }
                expected.iter_mut().for_each(|signal| signal.on_frame(&frame));
                reader.on_frame(&Stamped::new(Duration::from_micros(micros), frame));
            }
            pieces.extend(reader.take(true));
            for (path, signal) in paths.iter().zip(&expected) {
                let (_, name) = path.split_once('.').unwrap();
                let rows = pieces.iter().flat_map(|piece| &piece.column(name).unwrap().values);
                let bits = |rows: Vec<f64>| rows.into_iter().map(f64::to_bits).collect::<Vec<_>>();
                prop_assert_eq!(bits(rows.collect()), bits(signal.rows.clone()), "{}", path);
            }
        }
    }
}
