//! Departures: the times at which a node left its duties altogether, and why. A controller gives up, a drive trips, boots again
//! or is stopped. Each has the explanation of what it follows from, found by what the nodes themselves said and did; only one
//! that follows from nothing is the node's own.

use std::cell::OnceCell;

use canopen::cia402::State;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::{NmtCommand, NmtState};
use dbc::Database;
use plan::{ControlLoop, message_of};
use recording::conduct::{Act, NodeAct};
use recording::losses::{HEARTBEATS_MAX, LostHeartbeat};
use recording::reasons::{Reason, Reasons};
use recording::timeline::Timeline;
use scenario::expect::Emergency;
use scenario::node::{Node, NodeIndex};

use super::breaches::{Duty, missed_cycles};
use super::hits::LoopHits;

/// Emergencies by which a drive reports that it lost a service (CiA 301, 7.2.7).
const LOST_HEARTBEAT: u16 = 0x8130;
const LOST_SYNC: u16 = 0x8100;
const LOST_COMMAND: u16 = 0x8250;
/// Emergencies of the CAN controller: events, which stop nobody by themselves.
const OF_THE_BUS: [u16; 3] = [0x8110, 0x8120, BUS_OFF];
/// Emergency of a node that was off the bus.
const BUS_OFF: u16 = 0x8140;
/// Longest time from the last frame that a node lost while it was off the bus to the emergency in which it says so: the recovery
/// takes 128 times 11 recessive bits, and frames of others come between them.
const OFF_SECONDS: f64 = 0.1;
/// Largest index of the objects for communication.
const COMMUNICATION: std::ops::Range<u16> = 0x1000..0x2000;

/// Causes in the controller's emergency: see docs/reference/emergencies.md.
mod reason {
    pub(super) const NO_POSITION: u8 = 1;
    pub(super) const IMPLAUSIBLE: std::ops::RangeInclusive<u8> = 2..=4;
    pub(super) const OF_DRIVE: std::ops::RangeInclusive<u8> = 5..=7;
    pub(super) const ORDERED_ABOUT: u8 = 8;
    pub(super) const NO_BRING_UP: u8 = 9;
    pub(super) const RIG_LIMIT: u8 = 10;
}

/// Explanation of a departure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Root {
    /// A fault of the scenario, or a stop that the scenario expects.
    Fault,
    /// Something in another loop, whose verdict names it.
    Elsewhere,
    /// A duty that a node of this loop did not do.
    Own(Duty),
    /// No explanation that the recording shows.
    Unknown,
}

/// Departure of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Departure {
    pub(crate) at_seconds: f64,
    pub(crate) node: NodeIndex,
    pub(crate) root: Root,
    /// Scenario time at which the node did its duties again although it was ordered to stop; infinite if it did not.
    until_seconds: f64,
}

/// All departures that a loop sees, in the order of time.
#[derive(Debug, Default)]
pub(crate) struct Departures {
    all: Vec<Departure>,
    /// Times at which the loop's drive was enabled again.
    returns: Vec<f64>,
}

impl Departures {
    pub(super) fn new(
        timeline: &Timeline,
        (database, control_loop): (&Database, &ControlLoop),
        hits: &LoopHits<'_>,
        reasons: &Reasons,
        judged_until: f64,
    ) -> Self {
        let mut finder = Finder {
            timeline,
            database,
            control_loop,
            controller: control_loop.controller_index(),
            drive: control_loop.drive_index(),
            hits,
            found: Self::default(),
            last_position_seconds: OnceCell::new(),
        };
        let mut acts = timeline.conduct.to_vec();
        acts.extend(reasons.iter().filter_map(|reason| finder.emergency(reason)));
        acts.sort_by(|one, other| one.at_seconds.total_cmp(&other.at_seconds));
        for act in acts.iter().filter(|act| act.at_seconds < judged_until) {
            finder.on_act(act);
        }
        finder.found
    }

    /// The latest departure of a node before a time, if its loop has not run again since.
    pub(crate) fn latest(&self, node: NodeIndex, before: f64) -> Option<&Departure> {
        let until = self.all.partition_point(|one| one.at_seconds <= before);
        let mut latest_first = self.all[..until].iter().rev();
        let latest = latest_first.find(|one| one.node == node)?;
        let returns = &self.returns;
        let next = returns.partition_point(|at| *at <= latest.at_seconds);
        let has_returned = returns.get(next).is_some_and(|at| *at < before);
        (!has_returned && latest.until_seconds >= before).then_some(latest)
    }

    /// The first departures that are a node's own.
    pub(crate) fn own(&self) -> impl Iterator<Item = (f64, Duty)> {
        self.all.iter().filter_map(|one| match one.root {
            Root::Own(duty) => Some((one.at_seconds, duty)),
            _ => None,
        })
    }
}

/// The heartbeat of the controller for which a drive that is not canrig's had waited when it fell silent.
pub(super) fn lost_heartbeat_before<'a>(
    timeline: &'a Timeline,
    control_loop: &ControlLoop,
    since: f64,
) -> Option<&'a LostHeartbeat> {
    let real = control_loop.real_drive.as_ref();
    let watch = real.map(|drive| drive.real.timeouts.controller_lost_milliseconds);
    let watch = watch.map(|watch| f64::from(watch) / 1e3);
    let watch = watch.filter(|watch| *watch > 0.0);
    let watch = watch.unwrap_or(super::HEARTBEAT_SECONDS);
    let mut lost = timeline.lost_heartbeats.iter();
    lost.find(|lost| {
        let waited = since - lost.due_seconds;
        lost.node == control_loop.controller_index()
            && lost.back_seconds >= since
            && (watch / 2.0..=2.0 * watch).contains(&waited)
    })
}

/// Finds departures act by act.
struct Finder<'a, 'b> {
    timeline: &'a Timeline,
    database: &'a Database,
    control_loop: &'a ControlLoop,
    controller: NodeIndex,
    drive: NodeIndex,
    hits: &'a LoopHits<'b>,
    found: Departures,
    /// Scenario time of the drive's last position, once it was asked for.
    last_position_seconds: OnceCell<Option<f64>>,
}

impl<'a> Finder<'a, '_> {
    fn on_act(&mut self, act: &NodeAct) {
        let at = act.at_seconds;
        let node = self.with_id(act.node_id);
        let is_drive = node == Some(self.drive);
        match act.act {
            Act::Emergency { code, about, cause } if node == Some(self.controller) => {
                self.on_report(at, code, about, cause);
            }
            Act::Emergency { code, .. } if is_drive && self.is_ours(self.drive) => {
                self.on_emergency(at, code);
            }
            Act::Power { state, is_asked } if is_drive => self.on_power(at, state, is_asked),
            Act::Heartbeat(state) => self.on_heartbeat(at, node, state),
            Act::Ordered(command) => self.on_order(at, act.node_id, command),
            Act::Written { index } if is_drive && COMMUNICATION.contains(&index) => {
                self.on_written(at);
            }
            _ => {}
        }
    }

    /// The emergency of one of the loop's nodes, which may not have reached the bus.
    fn emergency(&self, reason: &Reason) -> Option<NodeAct> {
        let id = |name: &str| {
            let mut nodes = [self.controller(), self.drive()].into_iter();
            nodes.find(|node| node.name == name).map(Node::id)
        };
        let about = match reason.about.as_str() {
            "" => 0,
            name => id(name).unwrap_or(u8::MAX),
        };
        Some(NodeAct {
            at_seconds: reason.at_seconds,
            node_id: id(&reason.node)?,
            act: Act::Emergency {
                code: reason.code,
                about,
                cause: reason.cause,
            },
        })
    }

    fn controller(&self) -> &'a Node {
        self.control_loop.controller()
    }

    fn drive(&self) -> &'a Node {
        self.control_loop.drive()
    }

    /// Returns the node of the loop with a node-ID.
    fn with_id(&self, id: u8) -> Option<NodeIndex> {
        self.control_loop.trial.wiring.shared.nodes.with_id(id)
    }

    fn is_ours(&self, node: NodeIndex) -> bool {
        self.control_loop.node(node).is_ours()
    }

    fn add(&mut self, at_seconds: f64, node: NodeIndex, root: Root) {
        self.add_until(at_seconds, f64::INFINITY, node, root);
    }

    fn add_until(&mut self, at_seconds: f64, until_seconds: f64, node: NodeIndex, root: Root) {
        // Where the recording does not say what its faults hit, a departure beside one may be due to it.
        let is_unknown =
            matches!(root, Root::Own(_)) && self.hits.may_explain(at_seconds, at_seconds);
        let root = if is_unknown { Root::Unknown } else { root };
        // A node that has left does not leave again, whatever it says afterwards.
        if self.found.latest(node, at_seconds).is_none() {
            let departure = Departure {
                at_seconds,
                node,
                root,
                until_seconds,
            };
            self.found.all.push(departure);
        }
    }

    /// Adds the departure of a node that an NMT command takes from its duties. It ends with the first frame by which the node does
    /// them again: it was started since, or did not obey.
    fn add_ordered(&mut self, at_seconds: f64, node: NodeIndex, root: Root) {
        let frames = match node {
            node if node == self.controller => &self.timeline.syncs_seconds,
            node if node == self.drive => &self.timeline.positions_seconds,
            _ => return self.add(at_seconds, node, root),
        };
        // A frame that was under way still comes.
        let from = at_seconds + 2.0 * self.timeline.period_seconds;
        let next = frames.get(frames.partition_point(|time| time < from));
        self.add_until(at_seconds, next.unwrap_or(f64::INFINITY), node, root);
    }

    fn root_of(&self, node: NodeIndex, at: f64) -> Option<Root> {
        self.found.latest(node, at).map(|one| one.root)
    }

    /// Takes the controller's reason to give up. One of canrig's says what it is; another one may stop for what it watches.
    fn on_report(&mut self, at: f64, code: u16, about: u8, cause: u8) {
        if OF_THE_BUS.contains(&code) {
            return;
        }
        let (controller, drive) = (self.controller, self.drive);
        if !self.is_ours(self.controller) {
            if let Some(root) = self.root_of(drive, at).or_else(|| self.expected_stop(at)) {
                self.add(at, controller, root);
            }
            return;
        }
        let is_elsewhere = about != 0 && about != self.drive().id();
        let root = match cause {
            _ if is_elsewhere => Root::Elsewhere,
            _ if code == LOST_HEARTBEAT => self.root_of_state(at),
            reason::NO_POSITION => self.root_of_silence(at),
            _ if reason::OF_DRIVE.contains(&cause) => self.root_of_state(at),
            _ if reason::IMPLAUSIBLE.contains(&cause) => self.protected(at, controller),
            reason::ORDERED_ABOUT
                if self.hits.changed(self.controller(), f64::NEG_INFINITY, at) =>
            {
                Root::Fault
            }
            reason::ORDERED_ABOUT => Root::Unknown,
            reason::NO_BRING_UP | reason::RIG_LIMIT => self.protected(at, drive),
            _ => Root::Own(Duty::State(controller)),
        };
        self.add(at, controller, root);
    }

    /// A protection that trips is no node's breach if a fault changed what the drive measures; else it is the node's.
    fn protected(&self, at: f64, node: NodeIndex) -> Root {
        let drive = self.drive();
        let hits = self.hits;
        let is_hit = hits.changed(drive, f64::NEG_INFINITY, at)
            || hits.kept_from_running(drive, at, at, at)
            || hits.changed(self.controller(), f64::NEG_INFINITY, at);
        if is_hit {
            Root::Fault
        } else {
            self.root_of(self.drive, at)
                .unwrap_or(Root::Own(Duty::State(node)))
        }
    }

    /// Explains why no position came for longer than the controller tolerates.
    fn root_of_silence(&self, at: f64) -> Root {
        if let Some(root) = self.root_of(self.drive, at) {
            return root;
        }
        let since = at
            - super::SILENT_AT_END
                .1
                .max(25.0 * self.timeline.period_seconds);
        let missed = missed_cycles(self.timeline, self.timeline.cycles_due);
        let lately = missed.filter(|breach| {
            breach.duty == Duty::Position
                && breach.until_seconds > since
                && breach.from_seconds < at
        });
        let lately = Vec::from_iter(lately);
        let first = lately.first().filter(|_| !self.is_ours(self.drive));
        let heartbeat = first.and_then(|first| {
            lost_heartbeat_before(self.timeline, self.control_loop, first.from_seconds)
        });
        if let Some(lost) = heartbeat {
            return self.root_of_heartbeat(self.controller, lost.due_seconds, at);
        }
        self.hits.rewind();
        let is_own = lately
            .iter()
            .any(|breach| !self.hits.took(breach, breach.from_seconds));
        if is_own {
            Root::Own(Duty::Position)
        } else if !lately.is_empty() || self.hits.is_hit_in(Duty::Sync, since, at) {
            // Without its SYNC the drive owes no position.
            Root::Fault
        } else {
            self.missed_by(self.controller(), &[Duty::Position], since, at)
        }
    }

    /// Explains why a drive is not operational, not enabled or not heard, as its controller says.
    fn root_of_state(&self, at: f64) -> Root {
        let drive = self.drive();
        if let Some(root) = self.root_of(self.drive, at) {
            return root;
        }
        let patience = self.heartbeat_patience(drive);
        let mut lost = self.timeline.lost_heartbeats.iter();
        let lost = lost.find(|lost| {
            lost.node == self.drive && lost.due_seconds <= at && lost.back_seconds + patience >= at
        });
        if let Some(lost) = lost {
            return self.root_of_heartbeat(self.drive, lost.due_seconds, at.min(lost.back_seconds));
        }
        let hits = self.hits;
        let since = at - patience;
        if hits.changed(drive, since, at)
            || hits.was_off(drive, since, at)
            || hits.was_off(self.controller(), since, at)
            || hits.kept_from_running(drive, since, at, since)
            || hits.took_heartbeats(drive, since, at, patience)
        {
            return Root::Fault;
        }
        let heartbeat = [Duty::Heartbeat(self.drive)];
        match self.missed_by(self.controller(), &heartbeat, since, at) {
            // What the controller saw of a drive that is not canrig's is the drive's.
            Root::Unknown if !self.is_ours(self.drive) => Root::Own(Duty::State(self.drive)),
            root => root,
        }
    }

    fn root_of_heartbeat(&self, index: NodeIndex, due: f64, until: f64) -> Root {
        let node = self.control_loop.node(index);
        let patience = self.heartbeat_patience(node);
        if self.hits.took_heartbeats(node, due, until, patience) {
            Root::Fault
        } else {
            Root::Own(Duty::Heartbeat(index))
        }
    }

    /// Longest time for which nodes wait for the heartbeat of a node.
    fn heartbeat_patience(&self, node: &Node) -> f64 {
        let message = message_of(self.database, node, dbc::names::HEARTBEAT).ok();
        let period = message.map_or(0, |message| message.cycle_time_milliseconds);
        f64::from(HEARTBEATS_MAX) * period.max(1) as f64 / 1e3
    }

    /// Whether a receiver missed the frames of these duties by a fault.
    fn missed_by(&self, receiver: &Node, duties: &[Duty], from: f64, until: f64) -> Root {
        let identifiers = duties.iter().filter_map(|duty| match duty {
            Duty::Heartbeat(node) => {
                let node = self.control_loop.node(*node);
                Some(ERROR_CONTROL_ID + u16::from(node.id()))
            }
            duty => self.hits.identifier(*duty),
        });
        let identifiers = Vec::from_iter(identifiers);
        if self.hits.missed(receiver, &identifiers, from, until) {
            Root::Fault
        } else {
            Root::Unknown
        }
    }

    /// Takes the reason of one of canrig's drives.
    fn on_emergency(&mut self, at: f64, code: u16) {
        let (drive, controller) = (self.drive(), self.controller());
        if code == BUS_OFF && self.hits.was_off(drive, at - OFF_SECONDS, at) {
            // It waits until it is started again (0x1029, CiA 301).
            self.add(at, self.drive, Root::Fault);
        }
        if OF_THE_BUS.contains(&code) {
            return;
        }
        let owed = match code {
            LOST_HEARTBEAT => Some((
                Duty::Heartbeat(self.controller),
                self.heartbeat_patience(controller),
            )),
            LOST_SYNC => Some((Duty::Sync, 0.05f64.max(3.0 * self.timeline.period_seconds))),
            LOST_COMMAND => Some((Duty::Command, 0.1)),
            _ => None,
        };
        let root = match owed {
            Some((duty, patience)) => self.root_of_loss(at, duty, patience),
            None if self.hits.changed(drive, f64::NEG_INFINITY, at) => Root::Fault,
            None => Root::Own(Duty::State(self.drive)),
        };
        self.add(at, self.drive, root);
    }

    /// Explains why a drive of canrig's lost a service of the controller.
    fn root_of_loss(&self, at: f64, duty: Duty, patience: f64) -> Root {
        let (controller, drive) = (self.controller(), self.drive());
        if let Some(root) = self.root_of(self.controller, at) {
            return root;
        }
        let since = at - patience;
        let hits = self.hits;
        let is_taken = hits.kept_from_running(controller, since, at, since)
            || hits.changed(controller, since, at)
            || match duty {
                Duty::Heartbeat(_) => hits.took_heartbeats(controller, since, at, patience),
                duty => hits.is_hit_in(duty, since, at),
            }
            || self.missed_by(drive, &[duty], since, at) == Root::Fault;
        if is_taken {
            Root::Fault
        } else {
            Root::Own(duty)
        }
    }

    /// Takes a new state of the drive. Only one that leaves Operation enabled is a departure.
    fn on_power(&mut self, at: f64, state: State, is_asked: bool) {
        if state == State::OperationEnabled {
            self.found.returns.push(at);
            return;
        }
        let drive = self.drive();
        // What another state it goes to afterwards does not matter.
        if self.found.latest(self.drive, at).is_some() {
            return;
        }
        let is_fault = matches!(state, State::Fault | State::FaultReactionActive);
        let is_hit =
            self.hits.changed_order(drive, at) || self.hits.kept_from_running(drive, at, at, at);
        if is_hit {
            self.add(at, self.drive, Root::Fault);
        } else if is_asked && !self.is_ours(self.controller) {
            let root = self.expected_stop(at).unwrap_or(Root::Own(Duty::Lead));
            self.add(at, self.controller, root);
            self.add(at, self.drive, root);
        } else if let Some(root) = self.root_of(self.controller, at) {
            self.add(at, self.drive, root);
        } else if (!is_asked || is_fault) && !self.is_ours(self.drive) {
            let root = self
                .watched_by_drive(at)
                .unwrap_or(Root::Own(Duty::State(self.drive)));
            self.add(at, self.drive, root);
        }
        // A drive of canrig's says in an emergency why it leaves the state.
    }

    /// Root of the departure of a drive that is not canrig's, if it may have answered a controller that fell silent before.
    fn watched_by_drive(&self, at: f64) -> Option<Root> {
        let mut lost = self.timeline.lost_heartbeats.iter();
        let lost = lost.find(|lost| {
            lost.node == self.controller && lost.due_seconds < at && lost.back_seconds >= at
        });
        if let Some(lost) = lost {
            return Some(self.root_of_heartbeat(self.controller, lost.due_seconds, at));
        }
        let syncs = &self.timeline.syncs_seconds;
        let heard = syncs.partition_point(|time| time <= at);
        let last = syncs.get(heard.checked_sub(1)?)?;
        let silent = at - last;
        let is_silence = silent > super::silence_seconds_max(self.timeline);
        is_silence.then(|| {
            let is_hit = self.hits.is_hit_in(Duty::Sync, last, at)
                || self
                    .hits
                    .kept_from_running(self.controller(), last, at, last);
            if is_hit {
                Root::Fault
            } else {
                Root::Own(Duty::Sync)
            }
        })
    }

    /// Takes a new state in a heartbeat.
    fn on_heartbeat(&mut self, at: f64, node: Option<NodeIndex>, state: NmtState) {
        let own = node.filter(|node| self.control_loop.both().contains(node));
        let Some(index) = own.filter(|_| state != NmtState::Operational) else {
            return;
        };
        let node = self.control_loop.node(index);
        let has_booted = state == NmtState::Initialising;
        if !has_booted && (node.is_ours() || index == self.controller) {
            return;
        }
        let root = if self.hits.kept_from_running(node, at, at, at)
            || self.hits.changed(node, at - 0.1, at)
        {
            Root::Fault
        } else if node.is_ours() {
            // canrig's nodes boot when they are told to, or by a fault.
            return;
        } else if index == self.drive {
            let root = self.root_of(self.controller, at);
            root.unwrap_or(Root::Own(Duty::State(index)))
        } else {
            Root::Own(Duty::State(index))
        };
        self.add(at, index, root);
    }

    /// Takes an NMT command that takes a node from its duties. That of a fault is a hit; a controller of canrig's gives it when
    /// it has given up.
    fn on_order(&mut self, at: f64, id: u8, command: NmtCommand) {
        if command == NmtCommand::Start {
            return;
        }
        let io = self.control_loop.trial.wiring.io_nodes();
        let obeying = [self.drive].into_iter().chain(io);
        let addressee = self.with_id(id);
        let meant = obeying.filter(|node| id == 0 || addressee == Some(*node));
        let meant = Vec::from_iter(meant);
        if self.hits.commanded(at) {
            for node in meant {
                self.add_ordered(at, node, Root::Fault);
            }
            if addressee == Some(self.controller) {
                self.add_ordered(at, self.controller, Root::Fault);
            }
            return;
        }
        if self.is_ours(self.controller) || meant.is_empty() {
            return;
        }
        let before = self
            .root_of(self.drive, at)
            .or_else(|| self.root_of(self.controller, at));
        let root = before
            .or_else(|| self.expected_stop(at))
            .unwrap_or(Root::Own(Duty::Nmt));
        self.add(at, self.controller, root);
        for node in meant {
            self.add_ordered(at, node, root);
        }
    }

    /// Takes an object for communication that a controller wrote in mid-run: if the drive is silent from then on, that is why.
    fn on_written(&mut self, at: f64) {
        if self.is_ours(self.controller) {
            return;
        }
        let timeline = self.timeline;
        let last = *self.last_position_seconds.get_or_init(|| {
            let rows = timeline.measured_position().iter();
            let rows = rows.zip(timeline.time_seconds.iter());
            let last = rows.filter(|(position, _)| !position.is_nan()).last();
            last.map(|(_, time)| time)
        });
        let is_silent = last.is_none_or(|time| time <= at + timeline.period_seconds);
        if is_silent {
            self.add(at, self.drive, Root::Own(Duty::Lead));
        }
    }

    /// Whether the scenario demands that the controller stops, and a fault has hit something that it receives.
    fn expected_stop(&self, at: f64) -> Option<Root> {
        let controller = self.controller();
        let first = self.hits.first_on_others(controller)?;
        (at >= first && expects_stop(self.control_loop)).then_some(Root::Fault)
    }
}

/// Returns whether the scenario demands or limits how the controller stops.
pub(crate) fn expects_stop(control_loop: &ControlLoop) -> bool {
    let expect = &control_loop.trial.expect;
    let controller = control_loop.controller();
    let is_of_controller = |wanted: Emergency| wanted.node == controller.name;
    let mut demanded = expect.listed("emcy").iter();
    let demands = demanded.any(|text| text.parse().is_ok_and(is_of_controller));
    let mut limits = ["safe_state", "{command}_zero_within_milliseconds"].iter();
    demands || limits.any(|metric| expect.of(metric).is_some())
}
