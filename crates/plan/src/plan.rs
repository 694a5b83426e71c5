//! The plan of a run: its loops, and the facts that they share.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use dbc::scenario_clock::ScenarioClock;
use dbc::{Composer, Database, Message, Quantity, Signal, SignalHandle, SignalMissing, names};
use scenario::fault::{Actor, Fault, Group};
use scenario::node::{LoopNodes, Node, Part};
use scenario::wiring::{IoOutput, Measured};
use scenario::{NodeProgram, Shared, Trial, meant_or_known};

use crate::catalogue::{
    Catalogue, ColumnMessage, Frames, Published, columns, followed, messages_of, name_in_loop,
    with_outputs,
};
use crate::loaded_drive::LoadedDrive;
use crate::signal_names::SignalNames;

mod load;

/// A run: the loops of a scenario, and the facts that they share. A single loop is a list of one.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Facts of the whole run.
    pub shared: Shared,
    /// Loops in the order of their names; at least one.
    pub loops: Vec<ControlLoop>,
}

/// Loop of a plan. All loops share the meaning of their frames.
#[derive(Clone, Debug)]
pub struct ControlLoop {
    /// Trial of the loop.
    pub trial: Trial,
    /// Nodes of the loop.
    pub nodes: LoopNodes,
    /// Node-IDs of the nodes of the run that canrig does not play: they are expected on the bus, or programs that it starts.
    pub external: BTreeSet<u8>,
    /// Drive of the loop, if it is a real one.
    pub real_drive: Option<Arc<LoadedDrive>>,
    /// Meaning of all frames on the bus.
    pub database: Arc<Database>,
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
        let loops = vec![ControlLoop::with_frames(trial, frames)];
        Self { shared, loops }
    }

    /// Gives the frames another meaning.
    #[must_use]
    pub fn with_database(mut self, database: &Arc<Database>) -> Self {
        for one in &mut self.loops {
            one.database = Arc::clone(database);
        }
        self
    }

    /// Makes further nodes external, by name. An external drive publishes no truth.
    ///
    /// # Errors
    /// The run has no such node, or it cannot be external.
    pub fn with_external(self, names: &[String]) -> Result<Self, String> {
        let known = BTreeSet::from_iter(self.nodes().map(|node| node.name.as_str()));
        if let Some(name) = names.iter().find(|name| !known.contains(name.as_str())) {
            let meant = meant_or_known(name, known);
            return Err(format!("--external {name}: there is no such node; {meant}"));
        }
        let mut plan = self.recorded_external(names);
        plan.shared.programs.retain(|name, _| !names.contains(name));
        for played in plan.io_outputs() {
            let (io, loops) = (&played.0, plan.loops.iter());
            let has_it = |one: &&ControlLoop| one.frames.published.io.contains(played);
            let drives = Vec::from_iter(loops.filter(has_it).map(|one| &one.nodes.drive));
            let acts = |drive: &Node| plan.shared.rig.acts_on(&io.name, &drive.name);
            let own = drives.iter().min_by_key(|drive| (!acts(drive), drive.id));
            let mut ours = drives.iter().filter(|drive| !plan.is_external(drive));
            let emulated = ours.find(|drive| own == Some(*drive) || acts(drive));
            let mut nodes = [io].into_iter().chain(own.copied());
            let real = nodes.find(|node| plan.is_external(node));
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
        let is_named = |node: &&Node| names.contains(&node.name);
        let named = Vec::from_iter(self.nodes().filter(is_named).map(|node| node.id));
        for one in &mut self.loops {
            one.external.extend(&named);
        }
        self
    }

    /// Returns the nodes of all loops, and the io nodes; a controller of several loops comes once for each.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        let of_loops = self.loops.iter().flat_map(|one| one.nodes.both());
        let io = &self.loops[0].trial.wiring.shared.io;
        of_loops.chain(io.iter().map(|io| &io.node))
    }

    /// Returns the slips in the EDS of each real drive: the first ones, and how many more there are.
    pub fn sheet_notes(&self) -> Vec<String> {
        const SHOWN_MAX: usize = 10;
        let mut shown = Vec::new();
        let mut known = BTreeSet::new();
        let loops = self
            .loops
            .iter()
            .filter(|one| known.insert(one.nodes.drive.id));
        for (one, drive) in loops.filter_map(|one| Some((one, one.real_drive.as_ref()?))) {
            let name = &one.nodes.drive.name;
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
    pub fn io_outputs(&self) -> impl Iterator<Item = &(Node, Vec<IoOutput>)> {
        let all = self.loops.iter().flat_map(|one| &one.frames.published.io);
        let mut all = each_once(all);
        all.sort_by_key(|(io, _)| &io.name);
        all.into_iter()
    }

    /// Returns the io nodes that are on the bus, each with its outputs: real ones, and those that an emulator plays with a drive.
    pub fn io_on_bus(&self) -> impl Iterator<Item = &(Node, Vec<IoOutput>)> {
        self.io_outputs().filter(|io| {
            let plays = |one: &ControlLoop| {
                one.is_ours(Part::Drive) && one.frames.published.io.contains(io)
            };
            self.is_external(&io.0) || self.loops.iter().any(plays)
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
        let drives = self.loops.iter().map(|one| &one.nodes.drive);
        let nodes = drives.chain(self.nodes());
        let external = nodes.filter(|node| self.is_external(node));
        each_once(external.map(|node| node.name.clone()))
    }

    /// Returns the nodes that are programs, each once: drives before their io nodes, the controller last.
    pub fn programs(&self) -> Vec<(&Node, &NodeProgram)> {
        let program = |node: &Node| self.shared.programs.get(&node.name);
        let programs = self.nodes().filter_map(|node| Some((node, program(node)?)));
        let mut programs = each_once(programs);
        programs.sort_by_key(|(node, _)| node.part == Part::Controller);
        programs
    }

    /// Returns the names of the external nodes that are expected on the bus.
    pub fn expected_names(&self) -> Vec<String> {
        let mut names = self.external_names();
        names.retain(|name| !self.shared.programs.contains_key(name));
        names
    }

    /// Names the leader of the loops: the law, the command of a program, or `external`.
    pub fn leader(&self) -> String {
        let controller = self.controller();
        match self.shared.programs.get(&controller.name) {
            Some(program) => program.command.join(" "),
            None if self.is_external(controller) => "external".to_owned(),
            None => {
                let laws = self.loops.iter().map(|one| &one.trial.controller);
                listed(laws.map(|controller| controller.law_name()))
            }
        }
    }

    /// Checks whether a node is external.
    pub fn is_external(&self, node: &Node) -> bool {
        self.loops[0].external.contains(&node.id)
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
            // Only the emulated drive has the sensor, amplifier, wire and mechanics that could fail.
            let node = |fault: &Fault| {
                if fault.kind.group == Group::Node && fault.is_at_controller() {
                    &one.nodes.controller
                } else {
                    &one.nodes.drive
                }
            };
            // The check of the scenario has refused faults that cannot happen to a program.
            let is_foreign = |node: &Node| {
                self.is_external(node) && !self.shared.programs.contains_key(&node.name)
            };
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
        &self.loops[0].database
    }

    /// Returns the controller, which leads all loops.
    pub fn controller(&self) -> &Node {
        &self.loops[0].nodes.controller
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
        let every = planned.unwrap_or_else(|| self.is_external(self.controller()).into());
        Some(every).filter(|every| *every > 0)
    }

    /// Returns a clock of scenario time that has not begun.
    ///
    /// # Errors
    /// The database has no statusword of a drive.
    pub fn scenario_clock(&self) -> Result<ScenarioClock, SignalMissing> {
        self.loops[0].scenario_clock()
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
    let composer = Composer::new(&controller.name, controller.id);
    let composer = loops.iter().fold(composer, |composer, one| {
        let (real, wiring) = (one.real_drive.as_deref(), &one.trial.wiring);
        let published = &one.frames.published;
        published.compose(composer, wiring, real, |part| one.is_ours(part))
    });
    let composer = with_outputs(composer, plan.io_outputs());
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
            nodes: trial.wiring.nodes.clone(),
            trial,
            external: BTreeSet::new(),
            real_drive: None,
            database: Arc::clone(&frames.database),
            frames: Arc::new(frames),
        }
    }

    /// Makes a loop of a recording with this database.
    fn from_recording(trial: Trial, database: &Arc<Database>) -> Self {
        let frames = Frames::new(Published::default(), Arc::clone(database), &trial.wiring);
        Self::with_frames(trial, frames)
    }

    /// Checks whether canrig plays the node with a part in the loop; else it is external.
    pub fn is_ours(&self, part: Part) -> bool {
        let node = self.nodes.of(part);
        node.is_none_or(|node| !self.external.contains(&node.id))
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

    /// Returns a clock of scenario time that has not begun: it begins when all drives of the run are enabled.
    ///
    /// # Errors
    /// The database has no statusword of a drive.
    pub fn scenario_clock(&self) -> Result<ScenarioClock, SignalMissing> {
        let loops = self.trial.wiring.shared.loops.iter();
        ScenarioClock::new(&self.database, loops.map(|one| one.drive.as_str()))
    }

    /// Returns a message of one of its nodes.
    ///
    /// # Errors
    /// The database has no such message.
    pub fn message(&self, node: &Node, service: &str) -> Result<&Message, SignalMissing> {
        let name = names::message(&node.name, service);
        let message = self.database.message(&name);
        message.ok_or_else(|| SignalMissing::new(&name))
    }

    /// Checks whether it gets a set-point of its own.
    pub fn has_set_point(&self) -> bool {
        self.trial.wiring.led_by.is_none() && !self.trial.reference.is_empty()
    }

    /// Returns the position that it follows.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn position(&self) -> Result<SignalHandle, SignalMissing> {
        let measured = &self.trial.wiring.quantities.feedback;
        self.measured_by(&self.nodes.followed.name, measured)
    }

    /// Returns the position that its own drive measures.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn drive_position(&self) -> Result<SignalHandle, SignalMissing> {
        self.measured_by(&self.nodes.drive.name, &self.trial.wiring.sensor.quantity)
    }

    /// Returns the position from which its command follows: that of the loop whose law commands its drive.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn commanding_position(&self) -> Result<SignalHandle, SignalMissing> {
        let leader = self.trial.wiring.leader();
        leader.map_or_else(
            || self.position(),
            |one| self.measured_by(&one.followed, &one.quantities.feedback),
        )
    }

    fn measured_by(&self, drive: &str, by: &Quantity) -> Result<SignalHandle, SignalMissing> {
        let message = names::message(drive, names::TPDO1);
        self.database.signal_of(&message, &by.key())
    }

    /// Returns the signal of the controller's command.
    ///
    /// # Errors
    /// The database has no such signal.
    pub fn target(&self) -> Result<SignalHandle, SignalMissing> {
        let command = names::message(&self.nodes.drive.name, names::RPDO1);
        let target = self.trial.wiring.quantities.name(names::TARGET);
        self.database.signal_of(&command, &target)
    }

    /// Returns the messages whose signals become columns, in their order.
    pub fn columns(&self) -> impl Iterator<Item = ColumnMessage<'_>> {
        columns(&self.database, &self.trial.wiring)
    }

    /// Returns the signals of another drive that it follows: the measured one and the true one.
    pub fn followed(&self) -> impl Iterator<Item = (&Message, &Signal)> {
        followed(&self.database, &self.trial.wiring)
    }

    /// Returns the name, in the loop, of a signal of one of its messages.
    pub fn name_of(&self, message: &Message, signal: &Signal) -> String {
        let has = |node: &&Node| messages_of(&self.database, node).any(|one| one == message);
        let wiring = &self.trial.wiring;
        name_in_loop(signal, wiring.all_nodes().find(has), wiring)
    }

    /// Returns the signals of an emulated plant that its drive publishes, without the true position.
    pub fn plant_signals(&self) -> impl Iterator<Item = &Signal> {
        let messages = self.database.plant_messages(&self.nodes.drive.name);
        let signals = messages.flat_map(|message| &message.signals);
        let quantities = self.trial.wiring.drive_quantities();
        let measured = quantities.name(names::TRUE_POSITION);
        signals.filter(move |signal| signal.name != measured)
    }

    /// Checks whether a signal of a message belongs to its drive, its io nodes or its law.
    pub fn owns(&self, message: &str, signal: &str) -> bool {
        let wiring = &self.trial.wiring;
        let has = |io: &&Node| wiring.has_signal(Some(io), signal);
        let io = wiring.io_nodes().filter(has);
        let nodes = [&self.nodes.drive].into_iter().chain(io);
        let messages = nodes.flat_map(|node| messages_of(&self.database, node));
        let controller = &self.nodes.controller.name;
        let terms = self.database.term_messages(controller, self.name());
        let mut messages = messages.chain(terms);
        names::set_point(self.name()) == message || messages.any(|one| one.name == message)
    }

    /// Returns the number of cycles from one message to the next, which is more than 1 for the truth about a plant alone.
    pub fn every_cycles(&self, message: &str) -> u32 {
        let (nodes, wiring) = (&self.nodes, &self.trial.wiring);
        let of = |node: &Node, measured: &Measured| {
            let mut messages = self.database.plant_messages(&node.name);
            let is_its = messages.any(|one| one.name == message);
            measured.truth_every_cycles.filter(|_| is_its)
        };
        let own = of(&nodes.drive, &wiring.sensor);
        own.or_else(|| of(&nodes.followed, &wiring.feedback))
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
        is_of(&self.nodes.drive) || is_of(&self.nodes.followed)
    }

    /// Returns the terms of its law.
    pub fn terms(&self) -> impl Iterator<Item = &Signal> {
        let controller = &self.nodes.controller.name;
        let messages = self.database.term_messages(controller, self.name());
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
