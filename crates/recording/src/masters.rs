//! A second master: frames that are sent once in a cycle and came more often, and NMT commands that nobody of the run gives.
//!
//! On a bus all frames look alike; what distinguishes two senders from one is how often they send. A busy machine only delays
//! frames, so what comes in a burst after a pause is one sender's, and what comes too often without one is two senders'. Nor is
//! an answer to a SYNC too many, however late it is.

use std::fmt;
use std::time::Duration;

use crate::log::STEP_MAX;
use canopen::{CanFrame, NmtCommand, NmtState};
use dbc::scenario_clock::{SYNC_COB_ID, ScenarioClock};
use dbc::{Database, SignalHandle, SignalMissing};
use rig::external::{External, ExternalNode};
use scenario::Scenario;
use scenario::fault::{Fault, Faults, Group};

/// So much of a frame too early is no jitter.
const AHEAD_MAX: f64 = 0.75;
/// Frames may have been held up for so long, and then come in a burst: virtual machines stand still for most of a second.
const BACKLOG_MAX: Duration = Duration::from_secs(2);
/// A slow drive may still answer SYNCs that are so old. What answers them in its place for longer is found.
const ANSWERS_BACKLOG_MAX: Duration = Duration::from_secs(5);
/// The first frame of all may have come so late.
const FIRST_LATENESS: Duration = Duration::from_millis(3);
/// In so many periods a lead or a backlog is forgotten, since no clock is exact, and who was late may have left frames out.
const MEMORY_PERIODS: f64 = 64.0;
/// A frame that comes so many periods after the one before ends a pause.
const PAUSE_PERIODS: f64 = 1.5;
/// But who is late by less than a period leaves none out. On a busy machine it may be so for long, and then in time again.
const LATENESS_MEMORY_PERIODS: f64 = 4096.0;

/// So long after NMT Stop the run of whoever gave it is over.
const STOP_TIME: Duration = Duration::from_secs(1);

const COMMAND: &str = "drive_rpdo1.controlword_command";
/// The only command that lets a current flow.
const ENABLE: &str = "enable operation";
const NMT_COB_ID: u16 = 0x000;
const HEARTBEATS: u16 = 0x700;
const CONTROLLER_HEARTBEAT: &str = "controller_heartbeat";

/// What shows a second master.
#[derive(Clone, Debug, PartialEq)]
pub struct SecondMaster {
    /// What it sends, for people.
    pub what: String,
    /// Scenario time of the first frame of it.
    pub first_seconds: f64,
    pub frames: u64,
}

/// `0x080 (SYNC), 512 frames too many from 1.234 s on`
impl fmt::Display for SecondMaster {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            what,
            first_seconds,
            frames,
        } = self;
        let noun = if *frames == 1 { "frame" } else { "frames" };
        write!(
            formatter,
            "{what}, {frames} {noun} too many from {first_seconds:.3} s on"
        )
    }
}

/// Watches the frames of a run for those that another master sends.
#[derive(Debug)]
pub struct MasterWatch {
    clock: ScenarioClock,
    end: Duration,
    rates: Vec<Rate>,
    nmt: Option<Nmt>,
    order: Order,
}

/// Whether time ran backwards by more than a clock is ever stepped in a run: then how often somebody sends is not known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Order {
    latest: Duration,
    is_lost: bool,
}

impl Order {
    /// Takes the time of every frame.
    #[inline]
    pub(crate) fn pass(&mut self, time: Duration) {
        self.is_lost |= self.latest.saturating_sub(time) > STEP_MAX;
        self.latest = self.latest.max(time);
    }
}

impl MasterWatch {
    /// A watch that has seen nothing. Frames that the scenario puts on the bus by its faults are not watched, nor what is
    /// sent by a controller that is somebody else's, but for its SYNC.
    ///
    /// # Errors
    /// The database has no statusword of the drive.
    pub fn new(
        scenario: &Scenario,
        database: &Database,
        external: &External,
    ) -> Result<Self, SignalMissing> {
        let (wiring, faults) = (&scenario.wiring, &scenario.faults);
        let own = faults.of_loop(wiring.drive_node_id, &wiring.plant);
        let is_unwatched =
            |fault: &Fault| fault.kind.group == Group::Bus || fault.kind.name == "clock_drift";
        let is_watched = !own.iter().any(is_unwatched);
        let is_ours = !external.has(ExternalNode::Controller);
        let cycle = scenario.bus.sync_period();
        let rate = |name, what, period: Option<Duration>| {
            let message = database.message(name)?;
            let of_message = Duration::from_millis(message.cycle_time_milliseconds);
            Some(Rate::new(
                message.raw_id,
                what,
                period.unwrap_or(of_message),
            ))
        };
        let command = || {
            let rate = rate("drive_rpdo1", "commands to the drive", Some(cycle))?;
            let rate = rate.only(database.signal(COMMAND)?, enabling(database));
            Some(rate.of_answers())
        };
        // When a node is no longer slow, its next frame comes sooner by so much.
        let delays = own.of("slow_cycle");
        let delays = delays.map(|fault| fault.number("delay_milliseconds") / 1e3);
        let slow_seconds = delays.fold(0.0, f64::max);
        let sync = rate("sync", "SYNC", Some(cycle));
        let of_ours = [
            rate("drive_tpdo1", "positions of the drive", Some(cycle)).map(Rate::of_answers),
            command(),
            rate(CONTROLLER_HEARTBEAT, "heartbeats of the controller", None)
                .map(|rate| rate.of_heartbeats(Heartbeats::new(faults))),
        ]
        .into_iter()
        .flatten()
        .filter(|_| is_ours);
        let rates = sync.into_iter().chain(of_ours);
        Ok(Self {
            clock: ScenarioClock::new(database)?,
            end: Duration::from_secs_f64(scenario.duration_seconds),
            rates: rates
                .filter(|_| is_watched)
                .map(|rate| rate.of_slow_nodes(slow_seconds))
                .collect(),
            nmt: (is_watched && is_ours).then(|| Nmt::new(scenario, database)),
            order: Order::default(),
        })
    }

    /// Takes every frame of the bus in order.
    pub fn on_frame(&mut self, time: Duration, frame: &CanFrame) {
        self.clock.on_frame(time, frame);
        let scenario_time = self.clock.scenario_time(time);
        self.order.pass(time);
        self.on_frame_at(time, scenario_time, frame);
    }

    /// Knows the order of all frames from somebody else.
    pub(crate) fn set_order(&mut self, order: Order) {
        self.order = order;
    }

    /// The identifiers of the messages that are watched.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        let rates = self.rates.iter().map(|rate| rate.raw_id);
        let nmt = self.nmt.iter().flat_map(|_| {
            let heartbeats = HEARTBEATS..HEARTBEATS + 0x80;
            [NMT_COB_ID, SYNC_COB_ID].into_iter().chain(heartbeats)
        });
        rates.chain(nmt.map(u32::from))
    }

    /// Takes a frame of a message that is watched, whose scenario time is known.
    #[inline]
    pub(crate) fn on_frame_at(
        &mut self,
        time: Duration,
        scenario_time: Option<Duration>,
        frame: &CanFrame,
    ) {
        let id = frame.raw_id();
        let scenario_time = scenario_time.filter(|time| *time < self.end);
        if let Some(rate) = self.rates.iter_mut().find(|rate| rate.raw_id == id) {
            rate.on_frame(time, scenario_time, frame);
        }
        if frame.standard_id() == Some(SYNC_COB_ID) {
            let answers = self
                .rates
                .iter_mut()
                .filter_map(|rate| rate.answers.as_mut());
            answers.for_each(Answers::on_sync);
        }
        if let (Some(nmt), Some(time)) = (&mut self.nmt, scenario_time)
            && nmt.reads(id)
        {
            nmt.on_frame(time, frame);
        }
    }

    /// What was seen of a second master, the first of it first.
    #[must_use]
    pub fn found(&self) -> Vec<SecondMaster> {
        if self.order.is_lost {
            return Vec::new();
        }
        let rates = self
            .rates
            .iter()
            .filter(|rate| rate.surplus.first.is_some())
            .filter_map(|rate| {
                let period_milliseconds = 1e3 * rate.period.as_secs_f64();
                let what = format!(
                    "0x{:03X} ({}, one every {period_milliseconds} ms)",
                    rate.raw_id, rate.what
                );
                rate.surplus.found(what)
            });
        let nmt = self.nmt.iter().filter_map(|nmt| {
            let what = format!("0x{NMT_COB_ID:03X} (NMT {})", nmt.first);
            nmt.surplus.found(what)
        });
        let mut found: Vec<SecondMaster> = rates.chain(nmt).collect();
        found.sort_by(|left, right| left.first_seconds.total_cmp(&right.first_seconds));
        found
    }
}

/// The values of the command that lets a current flow.
fn enabling(database: &Database) -> Vec<i64> {
    let signal = database.definition(COMMAND).into_iter();
    let labels = signal.flat_map(|signal| &signal.labels);
    let enabling = labels.filter(|(_, label)| label == ENABLE);
    enabling.map(|(value, _)| *value).collect()
}

/// Frames beyond those of one sender, while the scenario is played.
#[derive(Clone, Copy, Debug, Default)]
struct Surplus {
    first: Option<Duration>,
    frames: u64,
}

impl Surplus {
    fn add(&mut self, scenario_time: Duration) {
        self.first.get_or_insert(scenario_time);
        self.frames += 1;
    }

    fn found(&self, what: String) -> Option<SecondMaster> {
        Some(SecondMaster {
            what,
            first_seconds: self.first?.as_secs_f64(),
            frames: self.frames,
        })
    }
}

/// How often a message comes.
#[derive(Debug)]
struct Rate {
    raw_id: u32,
    what: &'static str,
    period: Duration,
    /// Only frames with one of these values count.
    only: Option<(SignalHandle, Vec<i64>)>,
    heartbeats: Option<Heartbeats>,
    /// Of a message that answers each SYNC.
    answers: Option<Answers>,
    latest: Option<Duration>,
    frames_per_second: f64,
    /// Frames that came before their time; a backlog, if negative.
    ahead: f64,
    /// The longest backlog.
    ahead_min: f64,
    /// More of them are another sender's.
    ahead_max: f64,
    surplus: Surplus,
}

impl Rate {
    fn new(raw_id: u32, what: &'static str, period: Duration) -> Self {
        Self {
            raw_id,
            what,
            period,
            only: None,
            heartbeats: None,
            answers: None,
            latest: None,
            frames_per_second: 1.0 / period.as_secs_f64(),
            ahead: -periods(FIRST_LATENESS, period),
            ahead_min: -periods(BACKLOG_MAX, period),
            ahead_max: AHEAD_MAX,
            surplus: Surplus::default(),
        }
    }

    fn only(self, signal: SignalHandle, values: Vec<i64>) -> Self {
        Self {
            only: Some((signal, values)),
            ..self
        }
    }

    fn of_slow_nodes(self, delay_seconds: f64) -> Self {
        Self {
            ahead_max: AHEAD_MAX + delay_seconds * self.frames_per_second,
            ..self
        }
    }

    fn of_heartbeats(self, heartbeats: Heartbeats) -> Self {
        Self {
            heartbeats: Some(heartbeats),
            ..self
        }
    }

    fn of_answers(self) -> Self {
        let answers = Answers {
            due: 0.0,
            due_max: periods(ANSWERS_BACKLOG_MAX, self.period),
        };
        Self {
            answers: Some(answers),
            ..self
        }
    }

    /// What is left of lead or backlog after so many periods. Who pauses may be late still: of what it held up nothing is forgotten.
    fn remembered(&self, periods: f64) -> f64 {
        if periods > PAUSE_PERIODS {
            return self.ahead;
        }
        let left = |memory: f64| (1.0 - periods / memory).max(0.0);
        let lateness = self.ahead.clamp(-1.0, 0.0);
        left(LATENESS_MEMORY_PERIODS) * lateness + left(MEMORY_PERIODS) * (self.ahead - lateness)
    }

    fn counts(&self, frame: &CanFrame) -> bool {
        self.only.as_ref().is_none_or(|(signal, values)| {
            let value = signal.decode(frame);
            #[expect(clippy::cast_possible_truncation, reason = "a signal of a few bits")]
            value.is_some_and(|value| values.contains(&(value as i64)))
        })
    }

    /// Takes a frame of the message; outside the scenario's time none is too many.
    fn on_frame(&mut self, time: Duration, scenario_time: Option<Duration>, frame: &CanFrame) {
        if !self.counts(frame) {
            return;
        }
        let heartbeats = self.heartbeats.as_mut();
        match heartbeats.map_or(Beat::Periodic, |beats| beats.on_frame(scenario_time, frame)) {
            Beat::Periodic => {}
            Beat::Extra => return,
            Beat::Foreign(time) => return self.surplus.add(time),
        }
        if let Some(latest) = self.latest.replace(time) {
            let since = time.saturating_sub(latest).as_secs_f64() * self.frames_per_second;
            self.ahead = (self.remembered(since) + 1.0 - since).max(self.ahead_min);
        }
        if let Some(answers) = &mut self.answers {
            answers.on_answer();
        }
        if self.ahead > self.ahead_max {
            self.ahead -= 1.0;
            let is_asked_for = self.answers.as_ref().is_some_and(Answers::are_asked_for);
            if let Some(time) = scenario_time.filter(|_| !is_asked_for) {
                self.surplus.add(time);
            }
        }
    }
}

/// SYNCs and their answers. A slow node may have a queue of SYNCs for long, and then answer all of them at once.
#[derive(Debug)]
struct Answers {
    /// So many SYNCs have no answer yet; so many answers nobody asked for, if negative.
    due: f64,
    due_max: f64,
}

impl Answers {
    fn on_sync(&mut self) {
        let memory = if self.due < 0.0 {
            MEMORY_PERIODS
        } else {
            LATENESS_MEMORY_PERIODS
        };
        let remembered = self.due * (1.0 - 1.0 / memory);
        self.due = (remembered + 1.0).min(self.due_max);
    }

    fn on_answer(&mut self) {
        self.due = (self.due - 1.0).max(-1.0);
    }

    /// Whether no answer of late was one too many.
    fn are_asked_for(&self) -> bool {
        self.due > -0.5
    }
}

/// When a scenario starts the controller anew; never where it stays dead.
fn starts_anew(faults: &Faults) -> impl Iterator<Item = f64> {
    let starts = faults.of("restart").chain(faults.of("crash"));
    let of_controller = starts.filter(|fault| fault.is_at_controller());
    of_controller.map(|fault| fault.until_seconds.unwrap_or(f64::INFINITY))
}

/// What a heartbeat is besides one of many.
enum Beat {
    Periodic,
    /// A boot-up or a new state, which comes at once.
    Extra,
    /// A boot-up of somebody else, at a scenario time.
    Foreign(Duration),
}

/// The heartbeats of the controller. It boots before the scenario begins, and then as often as the scenario starts it anew.
#[derive(Debug)]
struct Heartbeats {
    /// States since the latest boot-up, a bit for each: of two senders in two states, each sends its state again.
    states: u128,
    /// So often the scenario will still start it anew.
    boot_ups_left: usize,
}

impl Heartbeats {
    fn new(faults: &Faults) -> Self {
        Self {
            states: 0,
            boot_ups_left: starts_anew(faults).count(),
        }
    }

    fn on_frame(&mut self, scenario_time: Option<Duration>, frame: &CanFrame) -> Beat {
        let Some(byte) = frame.data().first() else {
            return Beat::Periodic;
        };
        let state = byte & 0x7F;
        if state == NmtState::Initialising.number() {
            if let Some(time) = scenario_time {
                let Some(left) = self.boot_ups_left.checked_sub(1) else {
                    return Beat::Foreign(time);
                };
                self.boot_ups_left = left;
            }
            self.states = 0;
        }
        let bit = 1 << state;
        let is_new = self.states & bit == 0;
        self.states |= bit;
        if is_new { Beat::Extra } else { Beat::Periodic }
    }
}

fn periods(time: Duration, period: Duration) -> f64 {
    time.as_secs_f64() / period.as_secs_f64()
}

/// NMT commands. Our controller starts and resets nodes before the scenario begins, when the scenario starts it anew, or one that
/// comes up later; with Stop it ends a run, as canrig does.
#[derive(Debug)]
struct Nmt {
    /// Which frames are the controller's heartbeats.
    controller: Option<u32>,
    is_stop_scripted: bool,
    /// When the scenario will still start the controller anew, the latest first: a fault may keep its boot-up from the bus.
    starts_anew_seconds: Vec<f64>,
    has_newcomer: bool,
    /// When Stop was given, and to whom.
    stop: Option<(Duration, String)>,
    /// The first command that nobody of the run gave.
    first: String,
    surplus: Surplus,
}

impl Nmt {
    fn new(scenario: &Scenario, database: &Database) -> Self {
        let heartbeat = database.message(CONTROLLER_HEARTBEAT);
        let is_stop = |fault: &Fault| fault.kind.name == "nmt_stop";
        let mut starts = Vec::from_iter(starts_anew(&scenario.faults));
        starts.sort_by(|one, other| other.total_cmp(one));
        Self {
            controller: heartbeat.map(|message| message.raw_id),
            is_stop_scripted: scenario.own_faults().any(is_stop),
            starts_anew_seconds: starts,
            has_newcomer: false,
            stop: None,
            first: String::new(),
            surplus: Surplus::default(),
        }
    }

    /// Whether a frame of this identifier changes anything.
    fn reads(&self, raw_id: u32) -> bool {
        raw_id == u32::from(NMT_COB_ID)
            || raw_id & !0x7F == u32::from(HEARTBEATS)
            || self.stop.is_some() && raw_id == u32::from(SYNC_COB_ID)
    }

    fn on_frame(&mut self, scenario_time: Duration, frame: &CanFrame) {
        let is_past = |start: &mut f64| *start <= scenario_time.as_secs_f64();
        while self.starts_anew_seconds.pop_if(is_past).is_some() {
            self.on_controller_anew();
        }
        match (frame.standard_id(), frame.data()) {
            (Some(SYNC_COB_ID), _) => self.on_sync(scenario_time),
            (Some(NMT_COB_ID), &[specifier, node, ..]) => {
                if let Some(command) = NmtCommand::from_specifier(specifier) {
                    self.on_command(scenario_time, command, node);
                }
            }
            (Some(id), &[state, ..]) if id & !0x7F == HEARTBEATS => {
                let state = NmtState::from_number(state & 0x7F);
                let is_new = [NmtState::Initialising, NmtState::PreOperational].map(Some);
                self.has_newcomer |= is_new.contains(&state);
                if Some(u32::from(id)) == self.controller && state == Some(NmtState::Initialising) {
                    self.on_controller_anew();
                }
            }
            _ => {}
        }
    }

    /// It resets and starts whom it finds. Whoever of the run gave Stop before had ended it.
    fn on_controller_anew(&mut self) {
        self.has_newcomer = true;
        self.stop = None;
    }

    fn on_command(&mut self, scenario_time: Duration, command: NmtCommand, node: u8) {
        let what = format!("{command:?} to node {node}");
        match command {
            NmtCommand::Stop if self.is_stop_scripted => {}
            NmtCommand::Stop => {
                self.stop.get_or_insert((scenario_time, what));
            }
            _ if self.has_newcomer => {}
            _ => self.add(scenario_time, what),
        }
    }

    /// Whoever of the run had given Stop would have ended it by now.
    fn on_sync(&mut self, scenario_time: Duration) {
        let is_over = |stop: &mut (Duration, String)| scenario_time > stop.0 + STOP_TIME;
        if let Some((time, what)) = self.stop.take_if(is_over) {
            self.add(time, what);
        }
    }

    fn add(&mut self, scenario_time: Duration, what: String) {
        if self.surplus.first.is_none() {
            self.first = what;
        }
        self.surplus.add(scenario_time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);
    const MICRO: Duration = Duration::from_micros(1);

    fn scenario(added: &str) -> Scenario {
        let text = format!(
            "schema = 1\nname = \"t\"\nduration_seconds = 2.0\n[controller.open_loop]\n{added}"
        );
        Scenario::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap()
    }

    fn sync() -> CanFrame {
        CanFrame::new(SYNC_COB_ID, &[1])
    }

    fn position() -> CanFrame {
        CanFrame::new(0x190, &[0x37, 0x12, 0, 0, 0, 0, 0, 0])
    }

    fn command(word: u8) -> CanFrame {
        CanFrame::new(0x210, &[word, 0, 0, 0])
    }

    /// One controller and one drive for so many cycles, delayed as a machine may delay them.
    fn run(cycles: u32, delay: impl Fn(u32) -> Duration) -> Vec<(Duration, CanFrame)> {
        let mut frames = vec![(Duration::ZERO, position())];
        let mut latest = Duration::ZERO;
        for cycle in 0..cycles {
            latest = latest.max((cycle + 1) * PERIOD + delay(cycle));
            frames.push((latest, sync()));
            frames.push((latest + 130 * MICRO, position()));
            frames.push((latest + 260 * MICRO, command(15)));
            if cycle % 20 == 0 {
                frames.push((latest + 300 * MICRO, CanFrame::new(0x701, &[5])));
            }
        }
        frames
    }

    fn found_in(
        mut frames: Vec<(Duration, CanFrame)>,
        added: &str,
        external: &External,
    ) -> Vec<SecondMaster> {
        let scenario = scenario(added);
        let mut watch = MasterWatch::new(&scenario, Database::shipped(), external).unwrap();
        frames.sort_by_key(|(time, _)| *time);
        for (time, frame) in &frames {
            watch.on_frame(*time, frame);
        }
        watch.found()
    }

    fn found(frames: Vec<(Duration, CanFrame)>) -> Vec<SecondMaster> {
        found_in(frames, "", &External::default())
    }

    #[test]
    fn one_master_is_no_second_one_however_late_the_machine_is() {
        assert_eq!(found(run(1500, |_| Duration::ZERO)), []);
        // A cycle late, a stall of 90 ms, and one of which nothing comes before its end.
        let late = |cycle| {
            if cycle % 7 == 3 {
                990 * MICRO
            } else {
                Duration::ZERO
            }
        };
        assert_eq!(found(run(1500, late)), []);
        let stalled = |cycle: u32| match cycle {
            500..590 => (590 - cycle) * PERIOD,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(1500, stalled)), []);
        let stood_still = |cycle: u32| match cycle {
            200..1000 => (1000 - cycle) * PERIOD,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(1500, stood_still)), []);
        // A clock that is as late as it can be.
        let latest = |cycle: u32| match cycle {
            1400.. => Duration::MAX - 2000 * PERIOD,
            _ => Duration::ZERO,
        };
        let _ = found(run(1500, latest));
        // Another stall before all has come that the first one held up.
        let twice = |cycle: u32| match cycle {
            500..600 => (700 - cycle) * PERIOD,
            600..850 => (850 - cycle) * PERIOD,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(1500, twice)), []);
        // Late by most of a period for long, and then in time again.
        let busy = |cycle: u32| match cycle {
            500..900 => 950 * MICRO,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(1500, busy)), []);
    }

    /// It has a queue of SYNCs for longer than a backlog is remembered, and then answers all of them at once.
    #[test]
    fn a_slow_drive_that_catches_up_is_no_second_master() {
        let mut frames = run(1500, |_| Duration::ZERO);
        for (time, frame) in &mut frames {
            let is_slow = (500 * PERIOD..900 * PERIOD).contains(time);
            if is_slow && frame.standard_id() == Some(0x190) {
                *time = (*time + 5 * PERIOD).min(900 * PERIOD + 200 * MICRO);
            }
        }
        assert_eq!(found(frames.clone()), []);
        // What nobody asked for is still found.
        let from = 1200 * PERIOD + 400 * MICRO;
        frames.extend((0..10).map(|number| (from + number * PERIOD, position())));
        let found = found(frames);
        let [master] = &found[..] else {
            panic!("{found:?}")
        };
        assert!((9..=10).contains(&master.frames), "{master}");
    }

    const RESTART: &str = "[[fault.node.restart]]\nat_seconds = 0.97\nnode = \"controller\"\n";

    /// The boot-up, the heartbeat of a new state, and one when its time has come.
    #[test]
    fn a_controller_that_boots_is_no_second_master() {
        let begins = 12 * PERIOD;
        let heartbeat = |at: Duration, state| (at, CanFrame::new(0x701, &[state]));
        let mut frames = run(1500, |_| Duration::ZERO);
        frames.retain(|(_, frame)| frame.standard_id() != Some(0x701));
        for (time, _) in &mut frames {
            *time += begins;
        }
        let boot = [heartbeat(Duration::ZERO, 0), heartbeat(5 * PERIOD, 5)];
        frames.extend(boot);
        frames.extend((1..40).map(|number| heartbeat(20 * number * PERIOD, 5)));
        // Stopped between two of them, and started anew.
        frames.extend([heartbeat(790 * PERIOD, 4)]);
        frames.extend((40..50).map(|number| heartbeat(20 * number * PERIOD, 4)));
        frames.extend([heartbeat(986 * PERIOD, 0), heartbeat(987 * PERIOD, 0x7F)]);
        frames.extend([heartbeat(991 * PERIOD, 5)]);
        frames.extend((0..20).map(|number| heartbeat((1006 + 20 * number) * PERIOD, 5)));
        let external = External::default();
        assert_eq!(found_in(frames.clone(), RESTART, &external), []);
        // Which nobody ordered.
        let found = found(frames);
        let said = found.iter().map(ToString::to_string).collect::<Vec<_>>();
        let boot_up = "0x701 (heartbeats of the controller, one every 20 ms), 1 frame too many from 0.973 s on";
        assert_eq!(said, [boot_up]);
    }

    /// Its clock has forgotten when it was not late.
    #[test]
    fn a_node_that_is_no_longer_slow_is_no_second_master() {
        let slow = |cycle| match cycle {
            500..700 => 2500 * MICRO,
            _ => Duration::ZERO,
        };
        let scripted = "[[fault.node.slow_cycle]]\nfrom_seconds = 0.5\nuntil_seconds = 0.7\n\
            node = \"controller\"\ndelay_milliseconds = 2.5\n";
        let external = External::default();
        assert_eq!(found_in(run(1500, slow), scripted, &external), []);
        assert!(
            !found(run(1500, slow)).is_empty(),
            "more often than one sends"
        );
    }

    #[test]
    fn each_boot_up_of_a_second_master_is_noticed() {
        let boot_up = CanFrame::new(0x701, &[0]);
        let boot_ups = (0..10).map(|number| ((600 + 20 * number) * PERIOD, boot_up));
        let frames = run(1500, |_| Duration::ZERO).into_iter().chain(boot_ups);
        let external = External::default();
        for (faults, first_seconds, frames_max) in [("", 0.599, 10), (RESTART, 0.619, 9)] {
            let found = found_in(frames.clone().collect(), faults, &external);
            let [master] = &found[..] else {
                panic!("{found:?}")
            };
            assert_eq!(
                (master.first_seconds, master.frames),
                (first_seconds, frames_max)
            );
        }
    }

    #[test]
    fn of_a_recording_whose_time_runs_backwards_nothing_is_said() {
        let frames = run(1500, |_| Duration::ZERO);
        let scenario = scenario("");
        let external = External::default();
        let mut watch = MasterWatch::new(&scenario, Database::shipped(), &external).unwrap();
        for (time, frame) in frames.iter().rev() {
            watch.on_frame(*time, frame);
        }
        assert_eq!(watch.found(), []);
    }

    #[test]
    fn each_frame_of_a_second_master_is_noticed_within_two_cycles() {
        let heartbeat = CanFrame::new(0x701, &[0x7F]);
        let from = 600 * PERIOD + 400 * MICRO;
        for (frame, period, name) in [
            (sync(), PERIOD, "0x080 (SYNC, one every 1 ms)"),
            (position(), PERIOD, "0x190 (positions of the drive"),
            (command(15), PERIOD, "0x210 (commands to the drive"),
            (
                heartbeat,
                20 * PERIOD,
                "0x701 (heartbeats of the controller",
            ),
        ] {
            let foreign = (0..10).map(|number| (from + number * period, frame));
            let mut frames = run(1500, |_| Duration::ZERO);
            frames.extend(foreign);
            let found = found(frames);
            let [master] = &found[..] else {
                panic!("{found:?}")
            };
            assert!(master.to_string().starts_with(name), "{master}");
            let noticed = master.first_seconds + 1e-3 - from.as_secs_f64();
            let limit = 2.0 * period.as_secs_f64();
            assert!(noticed <= limit, "{noticed} s after the first frame");
            assert!((9..=11).contains(&master.frames), "{master}");
        }
    }

    #[test]
    fn a_reset_that_nobody_gave_is_found_and_the_end_of_a_run_is_not() {
        let at = 700 * PERIOD;
        let with = |added: &[(Duration, CanFrame)]| {
            found([run(1500, |_| Duration::ZERO), added.to_vec()].concat())
        };
        let reset = NmtCommand::ResetNode.frame(canopen::NodeId::new(0x10));
        let said = with(&[(at, reset)])[0].to_string();
        assert_eq!(
            said,
            "0x000 (NMT ResetNode to node 16), 1 frame too many from 0.699 s on"
        );
        // As our controller does with a node that comes up late, and canrig with a drive beyond its limits.
        let boot_up = (at - PERIOD, CanFrame::new(0x711, &[0]));
        assert_eq!(with(&[boot_up, (at, reset)]), []);
        let stop = NmtCommand::Stop.frame(canopen::NodeId::new(0x10));
        assert_eq!(with(&[(at, command(2)), (at + MICRO, stop)]), []);
        // After which the cycles go on, so nobody of the run gave it.
        let said = with(&[(at / 2, stop)])[0].to_string();
        assert!(
            said.starts_with("0x000 (NMT Stop to node 16), 1 frame"),
            "{said}"
        );
        // A run in which the controller is started anew: it was over before.
        let boot_up = CanFrame::new(0x701, &[0]);
        let mut frames = run(1500, |_| Duration::ZERO);
        frames.retain(|(time, _)| !(300 * PERIOD..970 * PERIOD).contains(time));
        frames.extend([(300 * PERIOD, stop), (971 * PERIOD, boot_up)]);
        let without_boot_up = frames.split_last().unwrap().1.to_vec();
        assert_eq!(found_in(frames, RESTART, &External::default()), []);
        assert_eq!(
            found_in(without_boot_up.clone(), RESTART, &External::default()),
            []
        );
        assert_eq!(found(without_boot_up).len(), 1);
        // Its boot-up may be lost, then it resets the drive before anybody has come up.
        let reset_late = [run(1500, |_| Duration::ZERO), vec![(972 * PERIOD, reset)]].concat();
        assert_eq!(found(reset_late.clone()).len(), 1);
        assert_eq!(found_in(reset_late, RESTART, &External::default()), []);
        // Within a second, and not in that of its end.
        for (cycles, count) in [(1400, 0), (1401, 1)] {
            let stopped = (400 * PERIOD, stop);
            let frames = [run(cycles, |_| Duration::ZERO), vec![stopped]].concat();
            assert_eq!(found(frames).len(), count, "{cycles} cycles");
        }
    }

    #[test]
    fn what_the_scenario_or_a_foreign_controller_does_is_expected() {
        let doubled = || {
            // Without the position that no SYNC asks for.
            let run = |delay| run(1500, |_| delay).split_off(1);
            [run(Duration::ZERO), run(400 * MICRO)].concat()
        };
        // The drive answers each SYNC, whoever sends it.
        let ids = found(doubled()).into_iter().map(|found| found.what);
        let ids: Vec<String> = ids.map(|what| what[..5].to_owned()).collect();
        assert_eq!(ids, ["0x080", "0x701"]);
        let babble = "[[fault.bus.babble]]\nfrom_seconds = 1.0\nidentifier = 128\n";
        assert_eq!(found_in(doubled(), babble, &External::default()), []);
        let external = External::new(&[ExternalNode::Controller]).unwrap();
        let found = found_in(doubled(), "", &external);
        assert_eq!(found.len(), 1);
        assert!(found[0].what.starts_with("0x080"), "{found:?}");
    }
}
