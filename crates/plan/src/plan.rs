//! The plan of a run: its loops, and the facts that they share.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use dbc::scenario_clock::ScenarioClock;
use dbc::{Composer, Database, Message, Quantity, Signal, SignalHandle, SignalMissing, names};
use scenario::fault::{Actor, Fault};
use scenario::node::{Node, NodeIndex, Nodes, Player};
use scenario::wiring::{IoOutput, IoWiring, Measured};
use scenario::{NodeProgram, Shared, Trial, meant_or_known};

use crate::catalogue::{
    Catalogue, ColumnMessage, Frames, Published, columns, followed, messages_of, name_in_loop,
    with_outputs,
};
use crate::loaded_drive::LoadedDrive;
use crate::signal_names::SignalNames;

mod load;

/// A run: its nodes, its frames and its loops, and the facts that they share. A single loop is a list of one.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Facts of the whole run.
    pub shared: Shared,
    /// Nodes of the run.
    pub nodes: Nodes,
    /// Loops in the order of their names; none if the rig has none.
    pub loops: Vec<ControlLoop>,
    /// Meaning of all frames on the bus.
    database: Arc<Database>,
    /// Io nodes in the order of their names, each with its outputs; none for a recording.
    io: Vec<(NodeIndex, Vec<IoOutput>)>,
}

/// Loop of a plan.
#[derive(Clone, Debug)]
pub struct ControlLoop {
    /// Trial of the loop.
    pub trial: Trial,
    /// Drive of the loop, if it is a real one.
    pub real_drive: Option<Arc<LoadedDrive>>,
    frames: Arc<Frames>,
}

impl Plan {
    /// Makes the plan of the scenario of a rig with one loop.
    pub fn new(trial: Trial, catalogue: &Catalogue) -> Self {
        let shared = Shared {
            run: Arc::clone(&trial.run),
            ..Shared::default()
        };
        let frames = catalogue.frames(&trial);
        Self {
            shared,
            nodes: trial.wiring.shared.nodes.clone(),
            database: Arc::clone(&frames.database),
            io: frames.published.io.clone(),
            loops: vec![ControlLoop::with_frames(trial, frames)],
        }
    }

    /// Gives the frames another meaning.
    #[must_use]
    pub fn with_database(mut self, database: &Arc<Database>) -> Self {
        self.database = Arc::clone(database);
        self
    }

    /// Makes further nodes external, by name. An external drive publishes no truth.
    ///
    /// # Errors
    /// The run has no such node, or it cannot be external.
    pub fn with_external(self, names: &[String]) -> Result<Self, String> {
        let known = BTreeSet::from_iter(self.rig_nodes().map(|(_, node)| node.name.as_str()));
        if let Some(name) = names.iter().find(|name| !known.contains(name.as_str())) {
            let meant = meant_or_known(name, known);
            return Err(format!("--external {name}: there is no such node; {meant}"));
        }
        let plan = self.recorded_external(names);
        for (io, _) in plan.io_outputs() {
            let drives = Vec::from_iter(plan.loops_with(*io).map(ControlLoop::drive));
            let io = &plan.nodes[*io];
            let acts = |drive: &Node| plan.shared.rig.acts_on(&io.name, &drive.name);
            let own = drives.iter().min_by_key(|drive| (!acts(drive), drive.id()));
            let mut ours = drives.iter().filter(|drive| drive.is_ours());
            let emulated = ours.find(|drive| own == Some(*drive) || acts(drive));
            let mut nodes = [io].into_iter().chain(own.copied());
            let real = nodes.find(|node| node.is_external());
            if let (Some(real), Some(emulated)) = (real, emulated) {
                let (real, emulated) = (&real.name, &emulated.name);
                return Err(format!(
                    "--external {real} needs --external {emulated}: a real node cannot act on an emulated plant"
                ));
            }
        }
        let has_set_points = plan.set_points_every_cycles().is_some();
        load::checked(plan.composed()).map_err(|refused| {
            let (options, help) = (names.join(" --external "), refused.help.unwrap_or_default());
            let (message, label) = (refused.message, refused.label);
            let set_points = if has_set_points {
                "; set-points for the controller are among the frames: set_points_every_cycles = 0 in [bus] leaves them out"
            } else {
                ""
            };
            format!("--external {options}: {message}: {label}; {help}{set_points}")
        })
    }

    /// Composes the frames of its loops again.
    fn composed(self) -> Self {
        let database = Arc::new(compose(&self));
        self.with_database(&database)
    }

    /// Makes nodes external as [`Plan::with_external`], for a recording.
    #[must_use]
    pub fn recorded_external(mut self, names: &[String]) -> Self {
        self.nodes = self.nodes.changed(|_, node| {
            if names.contains(&node.name) {
                *node = node.clone().played_by(Player::Expected);
            }
        });
        for one in &mut self.loops {
            one.trial.wiring.set_nodes(&self.nodes);
        }
        self
    }

    /// Returns the nodes of the rig with their indices, in the order of their names: all but the bench.
    pub fn rig_nodes(&self) -> impl Iterator<Item = (NodeIndex, &Node)> {
        let all = self.nodes.iter();
        all.filter(|(_, node)| node.profile().is_some())
    }

    /// Returns the nodes of the rig: drives in the order of their loops, then io nodes, and the controller last.
    fn in_order(&self) -> impl Iterator<Item = NodeIndex> {
        let drives = self.loops.iter().map(|one| one.trial.wiring.drive);
        let io = self.rig_nodes().filter(|(_, node)| node.is_io());
        let io = io.map(|(index, _)| index);
        drives.chain(io).chain([self.nodes.manager()])
    }

    /// Returns the loops whose plants are emulated together with one on which an io node acts.
    fn loops_with(&self, io: NodeIndex) -> impl Iterator<Item = &ControlLoop> {
        self.loops.iter().filter(move |one| {
            let trial = &one.trial;
            let is_it = |wired: &&IoWiring| wired.node == io;
            let wired = trial.wiring.shared.io.iter().find(is_it);
            let has_plant = |plant| trial.plants.contains_key(plant);
            wired.is_some_and(|wired| wired.plants().any(has_plant))
        })
    }

    /// Returns the slips in the EDS of each real drive: the first ones, and how many more there are.
    pub fn sheet_notes(&self) -> Vec<String> {
        const SHOWN_MAX: usize = 10;
        let mut shown = Vec::new();
        let mut known = BTreeSet::new();
        let loops = self
            .loops
            .iter()
            .filter(|one| known.insert(one.trial.wiring.drive));
        for (one, drive) in loops.filter_map(|one| Some((one, one.real_drive.as_ref()?))) {
            let name = &one.drive().name;
            let notes = drive.notes.first(SHOWN_MAX).iter();
            shown.extend(notes.map(|note| format!("EDS of `{name}`, {note}")));
            let more = drive.notes.count().saturating_sub(SHOWN_MAX);
            if more > 0 {
                shown.push(format!(
                    "EDS of `{name}`: {more} more slips that do no harm"
                ));
            }
        }
        shown
    }

    /// Returns the io nodes, each with its outputs; none for a recording.
    pub fn io_outputs(&self) -> impl Iterator<Item = &(NodeIndex, Vec<IoOutput>)> {
        self.io.iter()
    }

    /// Returns the io nodes that are on the bus, each with its outputs: real ones, and those that an emulator plays with a drive.
    pub fn io_on_bus(&self) -> impl Iterator<Item = &(NodeIndex, Vec<IoOutput>)> {
        self.io_outputs().filter(|(io, _)| {
            let plays = |one: &ControlLoop| one.drive().is_ours();
            self.nodes[*io].is_external() || self.loops_with(*io).any(plays)
        })
    }

    /// Takes the limits of another plan; `None` if that has other loops.
    #[must_use]
    pub fn with_limits_of(mut self, other: &Self) -> Option<Self> {
        let [ours, others] = [&self, other].map(|plan| plan.loops.iter().map(ControlLoop::name));
        if !ours.eq(others) {
            return None;
        }
        let run = Arc::make_mut(&mut self.shared.run);
        run.expect.clone_from(&other.shared.run.expect);
        for (one, other) in self.loops.iter_mut().zip(&other.loops) {
            one.trial.expect = other.trial.expect.clone();
            one.trial.run = Arc::clone(&self.shared.run);
        }
        self.shared.contours.clone_from(&other.shared.contours);
        Some(self)
    }

    /// Returns the names of the external nodes, each once: drives before the controller and the io nodes.
    pub fn external_names(&self) -> Vec<String> {
        self.names_of(Node::is_external)
    }

    /// Returns the names of some nodes: drives before the controller and the io nodes.
    fn names_of(&self, is_meant: impl Fn(&Node) -> bool) -> Vec<String> {
        let mut nodes = Vec::from_iter(self.in_order().map(|index| &self.nodes[index]));
        nodes.sort_by_key(|node| node.is_io());
        let meant = nodes.into_iter().filter(|node| is_meant(node));
        meant.map(|node| node.name.clone()).collect()
    }

    /// Returns the nodes that canrig does not play, in the order in which they come to their seats.
    pub fn external_nodes(&self) -> impl Iterator<Item = NodeIndex> {
        let nodes = self.in_order();
        nodes.filter(|index| self.nodes[*index].is_external())
    }

    /// Returns the nodes that are programs, each once: drives before their io nodes, the controller last.
    pub fn programs(&self) -> Vec<(&Node, &NodeProgram)> {
        let nodes = self.in_order().map(|index| &self.nodes[index]);
        nodes
            .filter_map(|node| Some((node, node.program()?)))
            .collect()
    }

    /// Returns the names of the external nodes that are expected on the bus.
    pub fn expected_names(&self) -> Vec<String> {
        self.names_of(|node| node.player == Player::Expected)
    }

    /// Names the leader of the loops: the law, the command of a program, or `external`.
    pub fn leader(&self) -> String {
        let controller = self.controller();
        match controller.program() {
            Some(program) => program.command.join(" "),
            None if controller.is_external() => "external".to_owned(),
            None => {
                let laws = self.loops.iter().map(|one| &one.trial.controller);
                listed(laws.map(|controller| controller.law_name()))
            }
        }
    }

    /// Refuses a rig without a loop, whose nodes nobody can play yet.
    ///
    /// # Errors
    /// The rig has no loop.
    pub fn require_loop(&self) -> Result<(), String> {
        if self.loops.is_empty() {
            let rig = &self.shared.rig.name;
            return Err(format!(
                "the rig `{rig}` has no loop, and canrig plays only rigs with a loop: add a drive and [loop.NAME] to it"
            ));
        }
        Ok(())
    }

    /// Refuses a fault of the scenario that would happen to an external node.
    ///
    /// # Errors
    /// A fault of an external node; the error names both.
    pub fn admits_faults(&self) -> Result<(), String> {
        for one in &self.loops {
            let faults = one.trial.loop_faults();
            // The others happen on the bus, and reach any node.
            let of_nodes = [Actor::Node, Actor::Process];
            let mut happening = faults.filter(|fault| of_nodes.contains(&fault.kind.actor));
            // Only the emulated drive has the wire and mechanics that could fail.
            let node = |fault: &Fault| match fault.node {
                Some(node) => &self.nodes[node],
                None => one.drive(),
            };
            // The check of the scenario has refused faults that cannot happen to a program.
            let is_foreign = |node: &Node| node.player == Player::Expected;
            if let Some(fault) = happening.find(|fault| is_foreign(node(fault))) {
                return Err(format!(
                    "{} cannot be played: the {} is external, so nothing fails there on purpose",
                    fault.kind.heading(),
                    node(fault).name
                ));
            }
        }
        Ok(())
    }

    /// Returns the meaning of all frames on the bus, as a run folder stores it.
    pub fn database(&self) -> &Arc<Database> {
        &self.database
    }

    /// Returns the controller, which leads all loops.
    pub fn controller(&self) -> &Node {
        &self.nodes[self.nodes.manager()]
    }

    /// Returns the loop of a rig with one loop.
    pub fn only_loop(&self) -> Option<&ControlLoop> {
        match &self.loops[..] {
            [only] => Some(only),
            _ => None,
        }
    }

    /// Returns the number of cycles from one sending of the set-points to the next; `None` if the bench does not send them.
    pub fn set_points_every_cycles(&self) -> Option<u8> {
        let planned = self.shared.run.bus.set_points_every_cycles;
        let every = planned.unwrap_or_else(|| self.controller().is_external().into());
        Some(every).filter(|every| *every > 0)
    }

    /// Returns a clock of scenario time that has not begun.
    ///
    /// # Errors
    /// The database has no statusword of a drive.
    pub fn scenario_clock(&self) -> Result<ScenarioClock, SignalMissing> {
        let drives = self.loops.iter().map(|one| one.drive().name.as_str());
        ScenarioClock::new(&self.database, drives)
    }

    /// Returns the length of the run.
    pub fn duration(&self) -> Duration {
        Duration::from_secs_f64(self.shared.run.duration_seconds)
    }

    /// Returns the time between two SYNCs.
    pub fn sync_period(&self) -> Duration {
        self.shared.run.bus.sync_period()
    }

    /// Checks whether the scenario has faults.
    pub fn has_faults(&self) -> bool {
        !self.shared.run.faults.is_empty()
    }
}

/// Returns a message of a node.
///
/// # Errors
/// The database has no such message.
pub fn message_of<'a>(
    database: &'a Database,
    node: &Node,
    service: &str,
) -> Result<&'a Message, SignalMissing> {
    let name = names::message(&node.name, service);
    let message = database.message(&name);
    message.ok_or_else(|| SignalMissing::new(&name))
}

/// Joins names in a row, each once.
pub fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    each_once(names).join(", ")
}

/// Returns things in their order, each once.
pub fn each_once<T: PartialEq>(things: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut once = Vec::new();
    for thing in things {
        if !once.contains(&thing) {
            once.push(thing);
        }
    }
    once
}

/// Returns the database of a plan's bus.
fn compose(plan: &Plan) -> Database {
    let (controller, loops) = (plan.controller(), &plan.loops);
    let composer = Composer::new(&controller.name, controller.id());
    let composer = loops.iter().fold(composer, |composer, one| {
        let (real, wiring) = (one.real_drive.as_deref(), &one.trial.wiring);
        let published = &one.frames.published;
        published.compose(composer, wiring, real, Node::is_ours)
    });
    let composer = with_outputs(composer, &plan.nodes, plan.io_outputs());
    let are_sent = plan.set_points_every_cycles().is_some();
    let followers = loops.iter().filter(|one| are_sent && one.has_set_point());
    let composer = followers.fold(composer, |composer, one| {
        let wiring = &one.trial.wiring;
        let quantities = &wiring.quantities;
        let symbol = quantities.feedback.unit.symbol();
        composer.with_set_point(
            one.name(),
            wiring.identifiers.set_point,
            &quantities.name(names::SET_POINT),
            [symbol, &format!("{symbol}/s")],
        )
    });
    composer.finish()
}

/// Returns the beginning of the names of a loop's signals and metrics, by the loop's name.
pub fn loop_prefix(loop_name: &str) -> String {
    match loop_name {
        "" => String::new(),
        name => format!("{name}."),
    }
}

impl ControlLoop {
    fn with_frames(trial: Trial, frames: Frames) -> Self {
        Self {
            trial,
            real_drive: None,
            frames: Arc::new(frames),
        }
    }

    /// Makes a loop of a recording with this database.
    fn from_recording(trial: Trial, database: &Arc<Database>) -> Self {
        let frames = Frames::new(Published::default(), Arc::clone(database), &trial.wiring);
        Self::with_frames(trial, frames)
    }

    /// Returns the controller, which leads all loops.
    pub fn controller(&self) -> &Node {
        self.trial.wiring.controller()
    }

    /// Returns the drive of the loop.
    pub fn drive(&self) -> &Node {
        self.trial.wiring.drive()
    }

    /// Returns a node of the run.
    pub fn node(&self, index: NodeIndex) -> &Node {
        self.trial.wiring.node(index)
    }

    /// Returns the index of the controller.
    pub fn controller_index(&self) -> NodeIndex {
        self.trial.wiring.shared.nodes.manager()
    }

    /// Returns the index of the drive of the loop.
    pub fn drive_index(&self) -> NodeIndex {
        self.trial.wiring.drive
    }

    /// Returns the indices of controller and drive, in this order.
    pub fn both(&self) -> [NodeIndex; 2] {
        [self.controller_index(), self.drive_index()]
    }

    /// Returns the faults of the whole run: those of other loops may take the current from this one, too.
    pub fn faults(&self) -> impl Iterator<Item = &Fault> {
        self.trial.run.faults.iter()
    }

    /// Returns the name of one of several loops; empty for the only one.
    pub fn name(&self) -> &str {
        self.trial.wiring.loop_among_several()
    }

    /// Returns the name of one of several loops; `None` for the only one.
    pub fn loop_name(&self) -> Option<&str> {
        Some(self.name()).filter(|name| !name.is_empty())
    }

    /// Returns the beginning of the names of its signals and metrics: empty for an only loop.
    pub fn prefix(&self) -> String {
        loop_prefix(self.name())
    }

    /// Checks whether it gets a set-point of its own.
    pub fn has_set_point(&self) -> bool {
        self.trial.wiring.led_by.is_none() && !self.trial.reference.is_empty()
    }

    /// Returns the position that it follows.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn position(&self, database: &Database) -> Result<SignalHandle, SignalMissing> {
        let measured = &self.trial.wiring.quantities.feedback;
        self.measured_by(database, &self.trial.wiring.followed_drive().name, measured)
    }

    /// Returns the position that its own drive measures.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn drive_position(&self, database: &Database) -> Result<SignalHandle, SignalMissing> {
        self.measured_by(
            database,
            &self.drive().name,
            &self.trial.wiring.sensor.quantity,
        )
    }

    /// Returns the position from which its command follows: that of the loop whose law commands its drive.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn commanding_position(&self, database: &Database) -> Result<SignalHandle, SignalMissing> {
        let leader = self.trial.wiring.leader();
        leader.map_or_else(
            || self.position(database),
            |one| self.measured_by(database, &one.followed, &one.quantities.feedback),
        )
    }

    fn measured_by(
        &self,
        database: &Database,
        drive: &str,
        by: &Quantity,
    ) -> Result<SignalHandle, SignalMissing> {
        let message = names::message(drive, names::TPDO1);
        database.signal_of(&message, &by.key())
    }

    /// Returns the signal of the controller's command.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn target(&self, database: &Database) -> Result<SignalHandle, SignalMissing> {
        let command = names::message(&self.drive().name, names::RPDO1);
        let target = self.trial.wiring.quantities.name(names::TARGET);
        database.signal_of(&command, &target)
    }

    /// Returns the messages whose signals become columns, in their order.
    pub fn columns<'a>(
        &'a self,
        database: &'a Database,
    ) -> impl Iterator<Item = ColumnMessage<'a>> {
        columns(database, &self.trial.wiring)
    }

    /// Returns the signals of another drive that it follows: the measured one and the true one.
    pub fn followed<'a>(
        &'a self,
        database: &'a Database,
    ) -> impl Iterator<Item = (&'a Message, &'a Signal)> {
        followed(database, &self.trial.wiring)
    }

    /// Returns the name, in the loop, of a signal of one of its messages.
    pub fn name_of(&self, database: &Database, message: &Message, signal: &Signal) -> String {
        let wiring = &self.trial.wiring;
        let has =
            |node: &NodeIndex| messages_of(database, wiring.node(*node)).any(|one| one == message);
        name_in_loop(signal, wiring.all_nodes().find(has), wiring)
    }

    /// Returns the signals of an emulated plant that its drive publishes, without the true position.
    pub fn plant_signals<'a>(&'a self, database: &'a Database) -> impl Iterator<Item = &'a Signal> {
        let messages = database.plant_messages(&self.drive().name);
        let signals = messages.flat_map(|message| &message.signals);
        let quantities = self.trial.wiring.drive_quantities();
        let measured = quantities.name(names::TRUE_POSITION);
        signals.filter(move |signal| signal.name != measured)
    }

    /// Checks whether a signal of a message belongs to its drive, its io nodes or its law.
    pub fn owns(&self, database: &Database, message: &str, signal: &str) -> bool {
        let wiring = &self.trial.wiring;
        let has = |io: &NodeIndex| wiring.has_signal(Some(*io), signal);
        let io = wiring.io_nodes().filter(has);
        let nodes = [wiring.drive].into_iter().chain(io);
        let messages = nodes.flat_map(|node| messages_of(database, wiring.node(node)));
        let controller = &self.controller().name;
        let terms = database.term_messages(controller, self.name());
        let mut messages = messages.chain(terms);
        names::set_point(self.name()) == message || messages.any(|one| one.name == message)
    }

    /// Returns the number of cycles from one message to the next, which is more than 1 for the truth about a plant alone.
    pub fn every_cycles(&self, database: &Database, message: &str) -> u32 {
        let wiring = &self.trial.wiring;
        let of = |node: &Node, measured: &Measured| {
            let mut messages = database.plant_messages(&node.name);
            let is_its = messages.any(|one| one.name == message);
            measured.truth_every_cycles.filter(|_| is_its)
        };
        let own = of(wiring.drive(), &wiring.sensor);
        own.or_else(|| of(wiring.followed_drive(), &wiring.feedback))
            .unwrap_or(1)
            .into()
    }

    /// Checks whether a signal, as `message.signal`, is one that only an emulated drive publishes.
    pub fn is_truth(&self, path: &str) -> bool {
        let message = path.split('.').next().unwrap_or_default();
        let is_of = |node: &Node| {
            let names = names::PLANT_SERVICES.map(|service| names::message(&node.name, service));
            names.iter().any(|name| name == message)
        };
        is_of(self.drive()) || is_of(self.trial.wiring.followed_drive())
    }

    /// Returns the terms of its law.
    pub fn terms<'a>(&'a self, database: &'a Database) -> impl Iterator<Item = &'a Signal> {
        let controller = &self.controller().name;
        let messages = database.term_messages(controller, self.name());
        messages.flat_map(|message| &message.signals)
    }

    /// Returns the terms that its law publishes, in their order.
    pub(crate) fn published_terms(&self) -> &[Signal] {
        &self.frames.published.terms
    }

    /// Returns the signals of its plant that its drive publishes, in their order.
    pub(crate) fn published_signals(&self) -> &[Signal] {
        &self.frames.published.signals
    }

    /// Returns all names of all signals.
    pub fn names(&self) -> &SignalNames {
        self.frames.names()
    }
}
