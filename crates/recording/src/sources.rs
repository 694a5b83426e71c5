//! Second sources of a frame: foreign senders of frames that a node of canrig sends too.
//!
//! On a bus all frames look alike, so the frames of an identifier are counted: each of canrig's nodes reports at its end how many
//! it sent. If a node does not report, since it was killed or the recording is foreign, the count is compared with the time: a
//! sender that is late catches up, and never sends more than one frame in a period. A SYNC with a counter shows by itself that it
//! is not the next one.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::path::Path;
use std::time::Duration;

use can::{CanFrame, STANDARD_IDS};
use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID};
use canopen::sdo::{DEFAULT_REQUEST_ID as SDO_REQUESTS, DEFAULT_RESPONSE_ID as SDO_RESPONSES};
use canopen::{NmtState, emcy};
use dbc::scenario_clock::SYNC_COB_ID;
use dbc::{Database, names};
use plan::{ControlLoop, message_of};
use scenario::fault::{Fault, Faults, Group};
use scenario::node::{Node, NodeIndex};

use crate::run_folder::{file, read_rows};

const HEADER: &str = "node,identifier,frames";
/// Largest file that is read.
const BYTES_MAX: u64 = 1 << 20;

/// Client's command that begins to write an object.
const SDO_DOWNLOAD: u8 = 1;
const SDO_ABORT: u8 = 0x80;
const NMT_START: u8 = 1;
const NMT_STOP: u8 = 2;
/// Time after NMT Stop at which the run of its sender is over.
const STOP_TIME: Duration = Duration::from_secs(1);
/// Place of an identifier that is not watched.
const UNWATCHED: u8 = u8::MAX;
/// Number of heartbeats of new states, in addition to the periodic ones.
const BOOTS_MAX: u64 = 10;
/// Number of periods in which a clock gains less than one on another.
const CLOCK_PERIODS: u64 = 100;
/// Largest surplus of frames over periods that proves no second sender.
const SURPLUS_MIN: u64 = 2;
/// Kinds of frames; the one that answers each SYNC is the position.
const POSITION: &str = "position";
const COMMAND: &str = "command";
const SYNC: &str = "sync";
const HEARTBEAT: &str = "heartbeat";
const NMT: &str = "nmt";
const SDO: &str = "sdo";

/// Frames of an identifier that a node of canrig's sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SentFrames {
    pub node: String,
    pub identifier: u16,
    pub frames: u64,
}

/// Frames that canrig's nodes sent in a run; empty if none reports any.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sent(pub Vec<SentFrames>);

impl Sent {
    /// Returns the number of frames of an identifier; `None` if no node reports it.
    fn of(&self, identifier: u16) -> Option<u64> {
        let reports = self.0.iter().filter(|sent| sent.identifier == identifier);
        reports.map(|sent| sent.frames).reduce(u64::saturating_add)
    }

    /// Returns the text of `sent.csv`.
    pub fn to_csv(&self) -> String {
        let row = |sent: &SentFrames| {
            format!("{},0x{:03X},{}\n", sent.node, sent.identifier, sent.frames)
        };
        let rows: String = self.0.iter().map(row).collect();
        format!("{HEADER}\n{rows}")
    }

    /// Reads `sent.csv` of a run folder; empty without the file.
    ///
    /// # Errors
    /// If the file cannot be read, or is not of that form.
    pub fn read(folder: &Path) -> io::Result<Self> {
        read_rows(folder, file::SENT, BYTES_MAX, HEADER, sent_frames).map(Self)
    }
}

/// Returns the frames in a row of the file.
fn sent_frames([node, identifier, frames]: [&str; 3]) -> Option<SentFrames> {
    Some(SentFrames {
        node: node.to_owned(),
        identifier: u16::from_str_radix(identifier.strip_prefix("0x")?, 16).ok()?,
        frames: frames.parse().ok()?,
    })
}

/// Frames from a foreign sender.
#[derive(Clone, Debug, PartialEq)]
pub struct SecondSource {
    /// Identifier of the frames.
    pub identifier: u16,
    /// Description for the user.
    pub what: String,
    /// Kind of frame: `sync`, `position`, `command`, `heartbeat`, `emergency`, `nmt` or `sdo`.
    pub duty: &'static str,
    /// Scenario time of the first frame out of turn.
    pub first_seconds: f64,
    pub frames: u64,
    /// Whether only their rate shows them.
    is_by_rate: bool,
}

/// Writes a text such as `0x210 (commands to the drive), 20 frames that canrig's nodes did not send, from 1.234 s on`.
impl fmt::Display for SecondSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (identifier, what, frames) = (self.identifier, &self.what, self.frames);
        let noun = if frames == 1 { "frame" } else { "frames" };
        let how = if self.is_by_rate {
            "too many by their rate"
        } else {
            "that canrig's nodes did not send"
        };
        write!(
            formatter,
            "0x{identifier:03X} ({what}), {frames} {noun} {how}"
        )?;
        write!(formatter, ", from {:.3} s on", self.first_seconds)
    }
}

/// Frames of the identifiers that canrig's nodes may send.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    /// Counted frames by identifier.
    watched: Vec<(u16, Watched)>,
    /// Frames that no node of the run sends, in any number.
    unexpected: BTreeMap<(&'static str, u16, String), SecondSource>,
    /// Whether time ran backwards by more than a clock is ever stepped in a run; then neither rates nor sequences prove anything.
    pub(crate) is_order_lost: bool,
    /// Whether a fault of a node changes the rate of its frames.
    is_rate_changed: bool,
    /// Whether such a fault happens to the controller, so that one SYNC may overtake another.
    is_sync_shifted: bool,
    /// Whether a fault of the scenario changes, doubles or adds frames on the bus, so that contents do not identify a sender.
    is_bus_faulty: bool,
}

#[derive(Clone, Debug, Default)]
struct Watched {
    what: String,
    duty: &'static str,
    /// Time between two frames of one sender.
    period: Option<Duration>,
    half_period: Option<Duration>,
    /// Whether it answers a SYNC, as a position or a command.
    is_answer: bool,
    /// Whether a node of canrig is the sender.
    is_ours: bool,
    /// Identifier of the frame that the same node always sends.
    reporter: Option<u16>,
    recorded: u64,
    latest: Option<Duration>,
    /// Times of the first and the last frame in the scenario, and their number.
    in_scenario: Option<(Duration, Duration, u64)>,
    /// Scenario time of the first frame that came in less than half of the period.
    soon: Option<Duration>,
}

impl Watched {
    #[inline]
    fn on_frame(&mut self, time: Duration, scenario_time: Option<Duration>, is_start: bool) {
        self.recorded += 1;
        let latest = self.latest.replace(time);
        let since = latest.map(|latest| time.saturating_sub(latest));
        let Some(now) = scenario_time else { return };
        let (_, last, count) = self.in_scenario.get_or_insert((now, now, 0));
        (*last, *count) = (now, *count + 1);
        let is_soon = match (self.half_period, since) {
            (Some(half), Some(since)) => since < half,
            (half, _) => half.is_none(),
        };
        // The run itself starts nodes.
        if is_soon && !is_start && self.soon.is_none() {
            self.soon = Some(now);
        }
    }

    /// Returns the time of the first frame out of turn, or of the first frame; of starts by NMT
    /// that of the last.
    fn first_seconds(&self) -> f64 {
        let first = self.in_scenario.map(|(first, last, _)| match self.duty {
            NMT => last,
            _ => first,
        });
        self.soon.or(first).unwrap_or_default().as_secs_f64()
    }

    /// Returns the surplus of frames over one in each period, and over one for each SYNC from any sender if they answer it.
    fn too_many_by_rate(&self, syncs: u64, positions: u64) -> u64 {
        let (Some(period), Some((first, last, count))) = (self.period, self.in_scenario) else {
            return 0;
        };
        let periods = last.saturating_sub(first).as_nanos() / period.as_nanos().max(1);
        let due = u64::try_from(periods).unwrap_or(u64::MAX).saturating_add(1);
        let due = match self.duty {
            POSITION => due.max(syncs),
            COMMAND => due.max(positions),
            _ => due,
        };
        let surplus = count.saturating_sub(due);
        let new_states = if self.duty == HEARTBEAT { BOOTS_MAX } else { 0 };
        if surplus > SURPLUS_MIN + new_states + due / CLOCK_PERIODS {
            surplus
        } else {
            0
        }
    }
}

impl Sources {
    /// Returns the number of SYNCs whose counter does not go on, and the time of the first.
    pub fn sync_steps_back(&self) -> Option<(u64, f64)> {
        let mut unexpected = self.unexpected.values();
        let back = unexpected.find(|one| one.duty == SYNC)?;
        Some((back.frames, back.first_seconds))
    }

    /// Returns the number of positions beyond one for each SYNC, if they are too many, and the time of the first.
    pub fn positions_too_many(&self) -> Option<(u64, f64)> {
        let position = self.of(POSITION)?;
        let frames = position.too_many_by_rate(self.count(SYNC), 0);
        let is_known = !self.is_rate_changed && !self.is_bus_faulty;
        (frames > 0 && is_known).then(|| (frames, position.first_seconds()))
    }

    /// Returns the first frames of a kind.
    fn of(&self, duty: &str) -> Option<&Watched> {
        let mut watched = self.watched.iter().map(|(_, one)| one);
        watched.find(|one| one.duty == duty)
    }

    /// Returns the number of frames of a kind in the scenario.
    fn count(&self, duty: &str) -> u64 {
        let in_scenario = self.of(duty).and_then(|one| one.in_scenario);
        in_scenario.map_or(0, |(.., count)| count)
    }

    /// Returns the frames of foreign senders, the first ones first.
    pub fn found(&self, sent: &Sent) -> Vec<SecondSource> {
        if self.is_bus_faulty || self.is_order_lost {
            return Vec::new();
        }
        let (syncs, positions) = (self.count(SYNC), self.count(POSITION));
        let counted = self.watched.iter().filter_map(|(identifier, watched)| {
            let frames_sent = sent.of(*identifier);
            // A node that reports, but not these frames, sent none of them.
            let none = watched.reporter.and_then(|id| sent.of(id)).map(|_| 0);
            let (frames, is_by_rate) = match frames_sent.or(none) {
                _ if !watched.is_ours => return None,
                Some(sent) => (watched.recorded.saturating_sub(sent), false),
                None if self.is_rate_changed => return None,
                None => (watched.too_many_by_rate(syncs, positions), true),
            };
            (frames > 0).then(|| SecondSource {
                identifier: *identifier,
                what: watched.what.clone(),
                duty: watched.duty,
                first_seconds: watched.first_seconds(),
                frames,
                is_by_rate,
            })
        });
        let mut found = Vec::from_iter(counted);
        let is_new = |one: &&SecondSource| {
            let mut others = found.iter();
            others.all(|other| other.identifier != one.identifier)
        };
        let unexpected = self.unexpected.values().filter(is_new).cloned();
        found.extend(Vec::from_iter(unexpected));
        found.sort_by(|left, right| left.first_seconds.total_cmp(&right.first_seconds));
        found
    }

    fn add(&mut self, duty: &'static str, identifier: u16, what: impl Into<String>, at: Duration) {
        let what = what.into();
        let unexpected = self.unexpected.entry((duty, identifier, what.clone()));
        let source = unexpected.or_insert_with(|| SecondSource {
            identifier,
            what,
            duty,
            first_seconds: at.as_secs_f64(),
            frames: 0,
            is_by_rate: false,
        });
        source.frames += 1;
    }
}

/// Counter of the frames of a run.
#[derive(Debug)]
pub struct SourceReader {
    /// Place of each identifier among the watched ones.
    places: Box<[u8; STANDARD_IDS]>,
    sources: Sources,
    end: Duration,
    controller_heartbeat: u16,
    controller_emergency: u16,
    /// Whether the controller is canrig's.
    is_ours: bool,
    /// Whether no drive is external; with an external drive the bench itself may stop the nodes.
    is_emulated: bool,
    /// Node-ID of the drive.
    drive: u16,
    /// Node-ID of the controller.
    controller: u8,
    /// Length of the latest SYNC, and its counter.
    sync: Option<(usize, Option<u8>)>,
    /// Number of times that the scenario will still restart the controller.
    boot_ups_left: usize,
    /// Nodes that have come up and are being configured.
    newcomers: BTreeSet<u8>,
    /// Whether the scenario has restarted the controller.
    has_restarted: bool,
    is_stop_scripted: bool,
    /// Time and addressee of NMT Stop before the controller gave up.
    stop: Option<(Duration, u8)>,
    has_given_up: bool,
}

impl SourceReader {
    /// Makes a reader that has seen no frame.
    pub fn new(database: &Database, one: &ControlLoop) -> Self {
        let scenario = &one.trial;
        let is_changing = |fault: &Fault| fault.kind.is_rate_changed;
        let [is_ours, is_emulated] = one.both().map(|node| one.node(node).is_ours());
        let cycle = scenario.run.bus.sync_period();
        let controller = one.controller();
        let id = |service| identifier(database, controller, service);
        // The usual identifiers (CiA 301, 7.3.5).
        let number = u16::from(controller.id());
        let watched = Vec::from_iter(watched((database, one), cycle, is_ours, is_emulated));
        let mut places = Box::new([UNWATCHED; STANDARD_IDS]);
        for (place, (identifier, _)) in (0..).zip(&watched) {
            places[usize::from(*identifier)] = place;
        }
        Self {
            places,
            sources: Sources {
                watched,
                is_rate_changed: scenario.loop_faults().any(is_changing),
                is_sync_shifted: scenario
                    .loop_faults()
                    .any(|fault| is_changing(fault) && fault.is_at(one.controller_index())),
                is_bus_faulty: scenario.run.faults.in_group(Group::Bus).next().is_some(),
                ..Sources::default()
            },
            end: Duration::from_secs_f64(scenario.run.duration_seconds),
            controller_heartbeat: id(names::HEARTBEAT).unwrap_or(ERROR_CONTROL_ID + number),
            controller_emergency: id(names::EMERGENCY).unwrap_or(emcy::DEFAULT_ID + number),
            is_ours,
            is_emulated,
            drive: u16::from(one.drive().id()),
            controller: controller.id(),
            sync: None,
            boot_ups_left: starts_anew(&scenario.run.faults, one.controller_index()),
            newcomers: BTreeSet::new(),
            has_restarted: false,
            is_stop_scripted: scenario.run.faults.of("nmt_stop").next().is_some(),
            stop: None,
            has_given_up: false,
        }
    }

    /// Returns the identifiers of the frames that are read.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        let watched = self.sources.watched.iter();
        let counted = watched.map(|(identifier, _)| *identifier);
        let heartbeats = ERROR_CONTROL_ID + 1..ERROR_CONTROL_ID + 0x80;
        let sdo = [SDO_REQUESTS, SDO_RESPONSES].map(|base| base + self.drive);
        let others = [self.controller_emergency].into_iter().chain(sdo);
        counted.chain(others).chain(heartbeats).map(u32::from)
    }

    /// Returns the counts so far.
    pub fn sources(&self) -> &Sources {
        &self.sources
    }

    /// Takes each frame with one of the identifiers, in order, with its time on the recording's clock and in the scenario.
    #[inline]
    pub fn on_frame(&mut self, time: Duration, scenario_time: Option<Duration>, frame: &CanFrame) {
        let Some(identifier) = frame.standard_id() else {
            return;
        };
        let scenario_time = scenario_time.filter(|time| *time < self.end);
        let place = self.places[usize::from(identifier) % STANDARD_IDS];
        if let Some((_, watched)) = self.sources.watched.get_mut(usize::from(place)) {
            // Frames in the controller's name before it booted are the bench's.
            let is_boot_up = identifier == self.controller_heartbeat && frame.data() == [0];
            if is_boot_up && scenario_time.is_none() {
                watched.recorded = 0;
            }
            let is_start = identifier == COMMAND_ID && frame.data().first() == Some(&NMT_START);
            watched.on_frame(time, scenario_time, is_start);
            // Most frames are answers to a SYNC, whose contents do not identify their sender.
            if watched.is_answer {
                return;
            }
        }
        if let Some(now) = scenario_time {
            self.on_contents(now, identifier, frame);
        }
    }

    /// Takes a frame whose contents may identify its sender.
    fn on_contents(&mut self, now: Duration, identifier: u16, frame: &CanFrame) {
        match (identifier, frame.data()) {
            (SYNC_COB_ID, data) => self.on_sync(now, data),
            (COMMAND_ID, &[specifier, node, ..]) if self.is_ours => {
                self.on_nmt(now, specifier, node);
            }
            (identifier, &[state, ..])
                if (ERROR_CONTROL_ID + 1..ERROR_CONTROL_ID + 0x80).contains(&identifier) =>
            {
                self.on_heartbeat(now, identifier, state & 0x7F);
            }
            (identifier, _) if identifier == self.controller_emergency => self.on_emergency(),
            (identifier, &[specifier, ..]) => self.on_sdo(now, identifier, specifier),
            _ => {}
        }
    }

    /// Checks that the counter of a SYNC is the next one. 1 begins anew, and a lost SYNC leaves a gap; a step back or another
    /// length is strange.
    fn on_sync(&mut self, now: Duration, data: &[u8]) {
        let payload = (data.len(), data.first().copied());
        let usual = *self.sync.get_or_insert(payload);
        let counters = usual.1.zip(payload.1);
        let is_back = counters.is_some_and(|(usual, counter)| counter <= usual && counter != 1);
        let is_unexpected = usual.0 != payload.0 || usual != payload && is_back;
        if is_unexpected && !self.sources.is_sync_shifted {
            let what = "SYNC, its counter does not go on";
            self.sources.add(SYNC, SYNC_COB_ID, what, now);
        } else {
            self.sync = Some(payload);
        }
        let is_over = |stop: &mut (Duration, u8)| now > stop.0 + STOP_TIME;
        if let Some((at, node)) = self.stop.take_if(is_over) {
            self.on_foreign_nmt(at, NMT_STOP, node);
        }
    }

    /// Takes an NMT command. Our controller starts and resets nodes when it or another comes up. It ends a run with Stop, as
    /// canrig does.
    fn on_nmt(&mut self, now: Duration, specifier: u8, node: u8) {
        match specifier {
            NMT_STOP if self.is_stop_scripted => {}
            // The run stops its drives one by one.
            NMT_STOP if node == 0 || node == self.controller => {
                self.on_foreign_nmt(now, specifier, node)
            }
            NMT_STOP if self.has_given_up => {}
            NMT_STOP => drop(self.stop.get_or_insert((now, node))),
            _ if self.is_brought_up(node) => {}
            _ => self.on_foreign_nmt(now, specifier, node),
        }
    }

    fn on_foreign_nmt(&mut self, at: Duration, specifier: u8, node: u8) {
        let command = canopen::NmtCommand::from_specifier(specifier)
            .map_or_else(|| format!("{specifier}"), |one| format!("{one:?}"));
        let what = format!("NMT {command} to node {node}");
        self.sources.add(NMT, COMMAND_ID, what, at);
    }

    /// Takes an emergency of the controller. It reports why it gives up before it stops the drives, so an earlier Stop was
    /// foreign.
    fn on_emergency(&mut self) {
        self.has_given_up = true;
        let is_ours = self.is_ours && self.is_emulated;
        if let Some((at, node)) = self.stop.take().filter(|_| is_ours) {
            self.on_foreign_nmt(at, NMT_STOP, node);
        }
    }

    /// Takes a frame that may be an SDO of the drive. The run writes no more objects, unless a node comes up; a read changes
    /// nothing.
    fn on_sdo(&mut self, now: Duration, identifier: u16, specifier: u8) {
        let [requests, responses] = [SDO_REQUESTS, SDO_RESPONSES].map(|base| base + self.drive);
        let what = match specifier {
            _ if identifier == requests && specifier >> 5 == SDO_DOWNLOAD => {
                "SDO, an object is written"
            }
            SDO_ABORT if [requests, responses].contains(&identifier) => {
                "SDO, a transfer is aborted"
            }
            _ => return,
        };
        if !self.is_brought_up(self.drive.to_le_bytes()[0]) {
            self.sources.add(SDO, identifier, what, now);
        }
    }

    /// Whether the manager may configure and start a node now, or all nodes: one that has come up, or any after a restart of the
    /// manager.
    fn is_brought_up(&self, node: u8) -> bool {
        let is_all = node == 0 && !self.newcomers.is_empty();
        is_all || self.newcomers.contains(&node) || self.has_restarted || self.boot_ups_left > 0
    }

    fn on_heartbeat(&mut self, now: Duration, identifier: u16, state: u8) {
        let state = NmtState::from_number(state);
        if identifier != self.controller_heartbeat {
            let [node, _] = (identifier - ERROR_CONTROL_ID).to_le_bytes();
            match state {
                Some(NmtState::Initialising | NmtState::PreOperational) => {
                    self.newcomers.insert(node);
                }
                Some(NmtState::Operational) => drop(self.newcomers.remove(&node)),
                _ => {}
            }
        } else if state == Some(NmtState::Initialising) && self.is_ours {
            if self.boot_ups_left == 0 {
                let what = "boot-up of the controller";
                self.sources.add(HEARTBEAT, identifier, what, now);
                return;
            }
            self.boot_ups_left -= 1;
            self.has_restarted = true;
            self.stop = None;
        }
    }
}

/// Returns the frames that controller and drive send, with whether those are canrig's.
fn watched(
    (database, one): (&Database, &ControlLoop),
    cycle: Duration,
    is_ours: bool,
    is_emulated: bool,
) -> BTreeMap<u16, Watched> {
    let (controller, drive) = (one.controller(), one.drive());
    let position = identifier(database, drive, names::TPDO1);
    let command = identifier(database, drive, names::RPDO1);
    let ours = Watched {
        is_ours,
        reporter: Some(SYNC_COB_ID),
        ..Watched::default()
    };
    let drives = Watched {
        is_ours: is_emulated,
        reporter: position,
        ..Watched::default()
    };
    let mut watched = BTreeMap::new();
    let mut watch =
        |identifier: Option<u16>, duty, what: &str, period: Option<Duration>, sender: &Watched| {
            let frames = Watched {
                what: what.to_owned(),
                duty,
                period,
                half_period: period.map(|period| period / 2),
                is_answer: [POSITION, COMMAND].contains(&duty),
                ..sender.clone()
            };
            watched.extend(identifier.map(|id| (id, frames)));
        };
    let cycle = Some(cycle);
    watch(Some(COMMAND_ID), NMT, "NMT", None, &ours);
    watch(Some(SYNC_COB_ID), SYNC, "SYNC", cycle, &ours);
    watch(command, COMMAND, "commands to the drive", cycle, &ours);
    for (node, sender) in [(controller, &ours), (drive, &drives)] {
        let message = message_of(database, node, names::HEARTBEAT).ok();
        let period = message.map(|message| Duration::from_millis(message.cycle_time_milliseconds));
        let [heartbeat, emergency] =
            [names::HEARTBEAT, names::EMERGENCY].map(|service| identifier(database, node, service));
        let kind = node.word();
        let heartbeats = format!("heartbeats of the {kind}");
        watch(heartbeat, HEARTBEAT, &heartbeats, period, sender);
        let emergencies = format!("emergencies of the {kind}");
        watch(emergency, "emergency", &emergencies, None, sender);
    }
    watch(position, POSITION, "positions of the drive", cycle, &drives);
    watched
}

/// Returns how often a scenario restarts the controller.
fn starts_anew(faults: &Faults, controller: NodeIndex) -> usize {
    let crashes = faults.of("crash");
    let starts = crashes
        .filter(|fault| fault.until_seconds.is_some())
        .chain(faults.of("restart"));
    starts.filter(|fault| fault.is_at(controller)).count()
}

fn identifier(database: &Database, node: &Node, service: &str) -> Option<u16> {
    u16::try_from(message_of(database, node, service).ok()?.raw_id).ok()
}

#[cfg(test)]
mod tests {
    use plan::Plan;

    use super::*;
    use crate::run_folder::parse_rows;

    const PERIOD: Duration = Duration::from_millis(1);
    const MICRO: Duration = Duration::from_micros(1);

    type Frames = Vec<(Duration, CanFrame)>;

    /// Makes 1500 cycles of one controller and one drive, with a counter in the SYNC, and with delays as on a real machine.
    fn run(delay: impl Fn(u32) -> Duration) -> Frames {
        let mut frames = Vec::new();
        let mut latest = Duration::ZERO;
        for cycle in 0..1500_u32 {
            latest = latest.max((cycle + 1) * PERIOD + delay(cycle));
            let counter = u8::try_from(cycle % 240).unwrap() + 1;
            frames.push((latest, CanFrame::new(SYNC_COB_ID, &[counter])));
            frames.push((latest + 130 * MICRO, CanFrame::new(0x190, &[0; 8])));
            frames.push((latest + 260 * MICRO, CanFrame::new(0x210, &[15, 0, 0, 0])));
            if cycle % 20 == 0 {
                frames.push((latest + 300 * MICRO, CanFrame::new(0x701, &[5])));
            }
        }
        frames
    }

    fn on_time() -> Frames {
        run(|_| Duration::ZERO)
    }

    fn read(plan: &Plan, mut frames: Frames) -> Sources {
        let mut reader = SourceReader::new(plan.database(), plan.only_loop().unwrap());
        frames.sort_by_key(|(time, _)| *time);
        for (time, frame) in &frames {
            reader.on_frame(*time, time.checked_sub(PERIOD), frame);
        }
        reader.sources().clone()
    }

    /// Returns the found sources, each with its identifier, its time in milliseconds and its number.
    fn found_in(
        frames: Frames,
        faults: &str,
        external: &[&str],
        sent: &Sent,
    ) -> Vec<(String, u64, u64)> {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 2.0\n[controller.open_loop]\n{faults}"
        );
        let external = external.iter().map(ToString::to_string);
        let plan = testing::plan(&text).recorded_external(&Vec::from_iter(external));
        let sources = read(&plan, frames);
        let found = sources.found(sent).into_iter();
        let short = found.map(|one| {
            let text = one.to_string();
            let milliseconds = format!("{:.0}", 1e3 * one.first_seconds);
            (
                text[..5].to_owned(),
                milliseconds.parse().unwrap(),
                one.frames,
            )
        });
        short.collect()
    }

    fn found(frames: Frames) -> Vec<(String, u64, u64)> {
        found_in(frames, "", &[], &Sent::default())
    }

    fn sent(identifier: u16, frames: u64) -> Sent {
        let node = "controller".to_owned();
        Sent(vec![SentFrames {
            node,
            identifier,
            frames,
        }])
    }

    #[test]
    fn one_sender_is_no_second_one_however_late_the_machine_is() {
        assert_eq!(found(on_time()), []);
        let stood_still = |cycle: u32| match cycle {
            200..1000 => (1000 - cycle) * PERIOD,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(stood_still)), []);
        let busy = |cycle: u32| match cycle {
            500..900 => 950 * MICRO,
            _ => Duration::ZERO,
        };
        assert_eq!(found(run(busy)), []);
        // A clock that is as late as possible.
        let latest = |cycle: u32| match cycle {
            1400.. => Duration::MAX - 2000 * PERIOD,
            _ => Duration::ZERO,
        };
        let _ = found(run(latest));
    }

    /// The run starts its nodes by NMT, so a stop is out of turn when it comes.
    #[test]
    fn a_stop_by_nmt_has_its_own_time() {
        let nmt = |at: u32, specifier: u8| {
            let frame = CanFrame::new(COMMAND_ID, &[specifier, 0x11]);
            (at * PERIOD + 500 * MICRO, frame)
        };
        let frames =
            |specifier| [on_time(), vec![nmt(1, NMT_START), nmt(1500, specifier)]].concat();
        for specifier in [NMT_STOP, NMT_START] {
            let found = found_in(frames(specifier), "", &[], &sent(COMMAND_ID, 1));
            assert_eq!(found, [("0x000".to_owned(), 1500, 1)]);
        }
    }

    #[test]
    fn each_frame_that_no_node_sent_is_counted() {
        let foreign = || {
            (
                700 * PERIOD + 500 * MICRO,
                CanFrame::new(0x210, &[15, 0, 0x84, 3]),
            )
        };
        let frames = || [on_time(), vec![foreign()]].concat();
        let counted = |sent: &Sent| found_in(frames(), "", &["drive"], sent);
        assert_eq!(counted(&sent(0x210, 1500)), [("0x210".to_owned(), 700, 1)]);
        assert_eq!(counted(&sent(0x210, 1501)), []);
        assert_eq!(counted(&Sent::default()), [], "one is no rate");
        let source = SecondSource {
            identifier: 0x210,
            what: "commands to the drive".to_owned(),
            duty: "command",
            first_seconds: 0.699,
            frames: 1,
            is_by_rate: false,
        };
        let expected = "0x210 (commands to the drive), 1 frame that canrig's nodes did not send, from 0.699 s on";
        assert_eq!(source.to_string(), expected);
    }

    #[test]
    fn without_a_report_a_rate_is_no_one_senders() {
        let twice_of = |id| {
            let again = |(time, _)| (time + 400 * MICRO, CanFrame::new(id, &[7]));
            let is_it = |(_, frame): &(Duration, CanFrame)| frame.standard_id() == Some(id);
            let foreign = on_time().into_iter().filter(is_it).map(again);
            [on_time(), foreign.collect()].concat()
        };
        // A SYNC is found by its counter, too, and named once.
        for (id, name) in [(0x210, "0x210"), (SYNC_COB_ID, "0x080")] {
            let found = found(twice_of(id));
            let [(identifier, _, frames)] = &found[..] else {
                panic!("{found:?}")
            };
            assert_eq!(
                (identifier.as_str(), frames.abs_diff(1500) < 3),
                (name, true)
            );
        }
        let twice = || twice_of(0x210);
        // An external controller may send at any rate.
        let external = ["controller"];
        assert_eq!(found_in(twice(), "", &external, &Sent::default()), []);
        let slow = "[[fault.node.slow_cycle]]\nnode = \"controller\"\nfrom_seconds = 0.0\ndelay_milliseconds = 5.0\n";
        assert_eq!(found_in(twice(), slow, &[], &Sent::default()), []);
    }

    /// A clock may be 1 % fast, but no more.
    #[test]
    fn a_clock_may_be_a_hundredth_fast() {
        let with = |surplus: u32| {
            let again = |cycle: u32| {
                let time = (100 + 100 * cycle) * PERIOD + 700 * MICRO;
                (time, CanFrame::new(0x190, &[0; 8]))
            };
            let more = Vec::from_iter((0..surplus / 2).flat_map(|cycle| [again(cycle); 2]));
            let found = found([on_time(), more].concat());
            found.into_iter().any(|(id, ..)| id == "0x190")
        };
        assert_eq!([14, 24].map(with), [false, true]);
    }

    #[test]
    fn an_object_that_is_written_during_the_run_is_another_client_s() {
        let with = |specifier: u8| {
            let request = CanFrame::new(0x610, &[specifier, 0x60, 0x60, 0, 10, 0, 0, 0]);
            let found = found([on_time(), vec![(700 * PERIOD, request)]].concat());
            Vec::from_iter(found.into_iter().map(|(id, at, _)| (id, at)))
        };
        let written = [("0x610".to_owned(), 699)];
        assert_eq!(with(0x2F), written);
        assert_eq!(with(0x80), written, "aborted");
        assert_eq!(with(0x40), [], "read");
    }

    #[test]
    fn a_counter_that_does_not_go_on_is_another_senders() {
        let external = ["controller"];
        let with = |foreign: Frames| {
            found_in(
                [on_time(), foreign].concat(),
                "",
                &external,
                &Sent::default(),
            )
        };
        let at = |cycle: u32, data: &[u8]| {
            (
                cycle * PERIOD + 500 * MICRO,
                CanFrame::new(SYNC_COB_ID, data),
            )
        };
        assert_eq!(with(vec![at(300, &[])]), [("0x080".to_owned(), 300, 1)]);
        assert_eq!(with(vec![at(300, &[7])]), [("0x080".to_owned(), 300, 1)]);
        // It sends too fast, and continues its count.
        let fast = |(time, frame): (Duration, CanFrame)| (time / 2, frame);
        let fast = Vec::from_iter(on_time().into_iter().map(fast));
        assert_eq!(found_in(fast, "", &external, &Sent::default()), []);
    }

    #[test]
    fn boot_ups_and_nmt_commands_of_nobody_are_named() {
        let with = |time: u32, id: u16, data: &[u8], faults: &str| {
            let foreign = vec![(time * PERIOD, CanFrame::new(id, data))];
            let found = found_in([on_time(), foreign].concat(), faults, &[], &Sent::default());
            Vec::from_iter(found.into_iter().map(|(id, at, _)| (id, at)))
        };
        let restart = "[[fault.node.restart]]\nat_seconds = 0.97\nnode = \"controller\"\n";
        let named = |id: &str, at| vec![(id.to_owned(), at)];
        assert_eq!(with(971, 0x701, &[0], ""), named("0x701", 970));
        assert_eq!(with(971, 0x701, &[0], restart), []);
        assert_eq!(with(400, 0x000, &[0x81, 0x10], ""), named("0x000", 399));
        // The run continues for more than a second; a Stop within its last second may be canrig's.
        assert_eq!(with(400, 0x000, &[2, 0x10], ""), named("0x000", 399));
        assert_eq!(with(700, 0x000, &[2, 0x10], ""), []);
        // A controller that finds a drive stopped reports it.
        let stop = (700 * PERIOD, CanFrame::new(0x000, &[2, 0x10]));
        let emergency = (
            720 * PERIOD,
            CanFrame::new(0x081, &[0, 0x10, 1, 0, 6, 0, 0, 0]),
        );
        let frames = [on_time(), vec![stop, emergency]].concat();
        assert_eq!(found(frames)[0].1, 699);
    }

    #[test]
    fn what_is_written_is_read() {
        let sent = sent(0x210, 1500);
        assert_eq!(parse_rows(&sent.to_csv(), HEADER, sent_frames), Ok(sent.0));
        for damaged in ["", "node,identifier,frames\ncontroller,210,5\n"] {
            assert!(parse_rows(damaged, HEADER, sent_frames).is_err());
        }
    }
}
