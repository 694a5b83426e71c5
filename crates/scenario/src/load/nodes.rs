//! Reads rig files, and checks what the schema cannot express: how nodes are wired, and whether they fit.

mod amplifiers;
mod names;
mod sensors;
mod served;

use std::collections::{BTreeMap, BTreeSet};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::kind;
use super::{Reading, build, check_custom, without_problems};
use crate::check::{self, Check};
use crate::custom::Section;
use crate::document::Document;
use crate::error::{Problem, ScenarioError, Source};
use crate::node::Profile;
use crate::rig::nodes::{LOOPS_MAX, NODES_MAX, Rig};
use crate::rig::{RealDrive, object_address};
use crate::schema;
use crate::table;
use crate::{meant_or_known, nearest};
use canopen::cia402;
use dbc::names::is_name;

/// Kind of the file in messages.
pub(super) const KIND: &str = "rig file";
/// Tables of names, each with its largest number of entries.
const TABLES: [(&str, usize); 3] = [
    ("plant", NODES_MAX),
    ("node", NODES_MAX),
    ("loop", LOOPS_MAX),
];
/// Keys that only an external drive has.
const EXTERNAL_KEYS: [&str; 8] = [
    "eds",
    "mode_of_operation",
    "command",
    "position",
    "current",
    "limits",
    "timeouts",
    "preflight",
];
const CURRENT_PORT: &str = "current_amperes";
const POSITION_PORT: &str = "position_metres";

impl Rig {
    /// Checks whether a text is meant as a rig file.
    pub fn is_meant(text: &str) -> bool {
        let document = Document::parse(Source::new("", text), text);
        document.is_ok_and(|document| kind::is_rig(&document))
    }

    /// Parses a rig file; `file_name` names it in errors.
    ///
    /// # Errors
    /// All problems of the text.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, ScenarioError> {
        let rig = Self::from_tree(&Self::document(text, file_name)?, Reading::ToPlay);
        rig.map_err(|problems| fail(file_name, problems))
    }

    /// Returns the tree of a rig file, in which each node has its defaults.
    pub(super) fn document<'text>(
        text: &'text str,
        file_name: &str,
    ) -> Result<Document<'text>, ScenarioError> {
        let fail = |problems| fail(file_name, problems);
        let mut document = Document::parse(Source::new(file_name, text), text).map_err(fail)?;
        if let Some(problem) = no_rig(&document).or_else(|| too_many(&document)) {
            return Err(fail(vec![problem]));
        }
        document.rewrite(spread_defaults);
        Ok(document)
    }

    /// Makes the rig of a tree in which each node has its defaults.
    pub(super) fn from_tree(
        document: &Document<'_>,
        reading: Reading,
    ) -> Result<Self, Vec<Problem>> {
        let schema = reading.schema(&schema::RIG);
        let (mut rig, mut problems) = build::<Self>(document, "the rig file", &schema)?;
        let played = rig
            .plant
            .iter_mut()
            .filter(|_| reading != Reading::Recorded);
        for (name, plant) in played {
            let (path, table) = (format!("plant.{name}"), &mut plant.custom);
            check_custom(document, Section::Plant, &path, table, &mut problems);
        }
        for node in rig.node.values_mut() {
            node.external |= node.kind == Profile::Drive && node.limits.is_some();
        }
        problems.extend(Check::new(document, &rig, Vec::new()).of_rig());
        rig.add_led_drives();
        rig.assign_identifiers();
        without_problems(problems, rig)
    }
}

/// Makes the error of a rig file. Problems of one place and label are one problem, even if their messages differ: these
/// name the node, and each drive that takes a wrong default has the problem.
pub(super) fn fail(file_name: &str, mut problems: Vec<Problem>) -> ScenarioError {
    let mut said = BTreeSet::new();
    problems.retain(|problem| said.insert(problem.place_and_label()));
    ScenarioError::new(KIND, file_name, problems)
}

/// Refuses another kind of file.
fn no_rig(document: &Document<'_>) -> Option<Problem> {
    if kind::is_scenario(document) {
        let problem = document.problem("name", "this is a scenario, not a rig file", "a scenario");
        return Some(problem.with_help("a rig file has [plant], [node] and [loop]"));
    }
    kind::drive_without_node(document)
}

/// Refuses a table with more entries than any rig has; then no other problem is reported.
fn too_many(document: &Document<'_>) -> Option<Problem> {
    TABLES.iter().find_map(|(table, max)| {
        let count = document.keys(table).len();
        let message = format!("{count} entries in [{table}]");
        let label = format!("a rig has at most {max}");
        (count > *max).then(|| document.problem(table, message, label))
    })
}

/// Gives each drive the defaults that it does not replace. Copied values keep the place where they were written.
fn spread_defaults(root: &mut DeTable<'_>) {
    let defaults = root
        .get("defaults")
        .and_then(|all| all.get_ref().as_table());
    let drive = defaults.and_then(|all| all.get("drive")?.get_ref().as_table().cloned());
    let nodes = root.get_mut("node").map(Spanned::get_mut);
    let (Some(defaults), Some(DeValue::Table(nodes))) = (drive, nodes) else {
        return;
    };
    for (_, node) in nodes.iter_mut() {
        let kind = |node: &DeTable<'_>| Some(node.get("kind")?.get_ref().as_str()? == "drive");
        if let DeValue::Table(node) = node.get_mut()
            && kind(node) == Some(true)
        {
            fill(node, &defaults);
        }
    }
}

/// Adds missing keys, down to the last table.
pub(super) fn fill<'text>(table: &mut DeTable<'text>, defaults: &DeTable<'text>) {
    for (key, default) in defaults {
        let value = table.get_mut(key.get_ref().as_ref());
        match (value.map(Spanned::get_mut), default.get_ref()) {
            (None, _) => drop(table.insert(key.clone(), default.clone())),
            (Some(DeValue::Table(value)), DeValue::Table(defaults)) => fill(value, defaults),
            (Some(_), _) => {}
        }
    }
}

impl Check<'_> {
    /// Returns the problems of a rig file.
    fn of_rig(mut self) -> Vec<Problem> {
        let rig = self.rig;
        check::name(&mut self, "name", &rig.name);
        self.names();
        self.plants();
        self.node_ids();
        self.controllers();
        self.nodes();
        self.externals();
        self.amplifiers();
        self.sensors();
        self.ports();
        self.loops();
        // An incomplete rig would cause more problems than it has.
        if self.problems.is_empty() {
            self.outputs_without_room();
            self.idle_plants();
        }
        self.problems
    }

    /// Reports a value that two places have.
    fn twice(&mut self, [first, second]: [&str; 2], message: String, label: &str) {
        let problem = self
            .document
            .problem(second, message, format!("and {label}"));
        let first = self.document.span(first);
        self.add([problem.with_place(first, label)]);
    }

    /// Checks that each plant has one model, that an FMU is a file and has ports to wire, that the transformation temperatures of
    /// wires are in order, and that wires cool to the temperature at which their memory begins.
    fn plants(&mut self) {
        for (name, plant) in &self.rig.plant {
            let path = format!("plant.{name}");
            if self.document.keys(&path).len() != 1 {
                let message = format!("the plant `{name}` needs one model");
                let label = format!(
                    "write one of [{path}.sma], [{path}.dc_motor], [{path}.sma_pair] and [{path}.fmu]"
                );
                self.at_key(&path, message, label);
            }
            if let Some(fmu) = &plant.fmu {
                let path = format!("{path}.fmu");
                let mut lacks = |key: &str, label: &str| {
                    self.at_key(&path, format!("the plant `{name}` lacks `{key}`"), label);
                };
                if fmu.file.is_empty() {
                    lacks("file", "file = \"NAME.fmu\" is missing");
                }
                if fmu.ports.is_empty() {
                    let label = "no variable is a port: `canrig fmu FILE --rig` proposes some";
                    lacks("ports", label);
                }
            }
            let (kinetics, heat, phase) = match (&plant.sma, &plant.sma_pair) {
                (Some(sma), _) => (sma.kinetics, &sma.heat, &sma.phase),
                (None, Some(pair)) => (pair.kinetics, &pair.heat, &pair.phase),
                (None, None) => continue,
            };
            let path = format!("{path}.{}", plant.key());
            check::temperatures(self, &format!("{path}.phase"), phase);
            check::cooling(self, &path, kinetics, heat, phase);
        }
    }

    fn controllers(&mut self) {
        let mut controllers = self.rig.of_kind(Profile::Manager);
        match (controllers.next(), controllers.next()) {
            (Some(_), None) => {}
            (None, _) => {
                let label = "no node has kind = \"controller\"";
                self.at_key("node", "nobody leads the drives", label);
            }
            (Some((first, _)), Some((second, _))) => {
                let (document, path) = (self.document, format!("node.{second}.kind"));
                let problem = document.problem(&path, "a bus has one controller", "a second one");
                let first = document.span(&format!("node.{first}.kind"));
                self.add([problem.with_place(first, "the first one")]);
            }
        }
    }

    /// Checks that each node has the parts that its kind needs, and no others.
    fn nodes(&mut self) {
        for (name, node) in &self.rig.node {
            let parts = [
                ("amplifier", node.amplifier.is_some(), Profile::Drive),
                ("sensor", node.sensor.is_some(), Profile::Drive),
                ("outputs", node.outputs.is_some(), Profile::Io),
            ];
            for (part, is_there, kind) in parts {
                let path = format!("node.{name}");
                if is_there && kind != node.kind {
                    let message = format!("`{name}` can have no {part}");
                    let label = "of another kind of node";
                    self.at_key(&format!("{path}.{part}"), message, label);
                }
                // The plant of an external drive need not be known.
                if !is_there && kind == node.kind && node.is_ours() {
                    let message = format!("`{name}` lacks its {part}");
                    let label = format!("[node.{name}.{part}] is missing");
                    self.at_key(&path, message, label);
                }
            }
        }
    }

    /// Checks external nodes, and the facts that canrig must know of them.
    fn externals(&mut self) {
        for (name, node) in &self.rig.node {
            let path = format!("node.{name}");
            match (!node.is_ours(), node.kind) {
                (false, _) | (true, Profile::Io) => {
                    for key in EXTERNAL_KEYS {
                        let path = format!("{path}.{key}");
                        if self.document.has(&path) {
                            let message = format!("`{name}` can have no {key}");
                            self.at_key(&path, message, "only a drive with `limits` has this");
                        }
                    }
                }
                (true, Profile::Manager) if !node.external => {}
                (true, Profile::Manager) => {
                    let message = "a rig file's controller is canrig's";
                    let path = format!("{path}.external");
                    let problem = self.document.problem(&path, message, "here");
                    self.problems.push(problem.with_help(
                        "to test one of your own, leave this out and play with --external controller, or write program = [\"./controller\"]",
                    ));
                }
                (true, Profile::Drive) => self.external_drive(name),
            }
            if node.kind == Profile::Io {
                self.add(self.io_beside_external(name));
            }
        }
    }

    fn external_drive(&mut self, name: &str) {
        let path = format!("node.{name}");
        let Some(real) = self.rig.real_drive(name) else {
            let message = format!("`{name}` lacks its limits");
            let label = format!("[node.{name}.limits] is missing: an external drive needs them");
            return self.at_key(&path, message, label);
        };
        let RealDrive {
            limits, timeouts, ..
        } = &real;
        let eds = self.rig.node[name].eds.as_ref();
        let mut object = |key: &str, message: &str, label: &str| {
            let path = format!("{path}.{key}");
            self.at(&path, message, label);
        };
        if eds.is_some_and(|eds| !table::is_inside_folder(eds)) {
            let message = "the EDS must lie in the rig file's folder";
            object("eds", message, "no absolute path, no `..`");
        }
        for (key, text, may_be_absent) in [
            ("command.object", &real.command.object, false),
            ("position.object", &real.position.object, false),
            ("current.object", &real.current.object, true),
        ] {
            let is_absent = may_be_absent && text.is_empty();
            if let Err(reason) = object_address(text)
                && !is_absent
            {
                object(key, &format!("\"{text}\" names no object"), reason);
            }
        }
        if real.position.increments_per_unit.abs() < 1e-6 {
            let message = "a position that does not change with the load";
            object("position.increments_per_unit", message, "must not be 0");
        }
        if limits.min >= limits.max {
            let label = format!("min {} is not below max {}", limits.min, limits.max);
            object("limits", "no position is within the limits", &label);
        }
        let period = timeouts.drive_heartbeat_milliseconds;
        if period >= timeouts.drive_lost_milliseconds {
            let message = "the drive is lost between two heartbeats";
            let label = format!("must be above the heartbeat period of {period} ms");
            object("timeouts.drive_lost_milliseconds", message, &label);
        }
        self.unserved_mode(&path, &real);
    }

    /// Refuses modes and objects of positions and speeds: commands are currents, and 0, which a quick stop sends, is no current
    /// there but a place to go to.
    fn unserved_mode(&mut self, path: &str, real: &RealDrive) {
        let remedy = "mode_of_operation = 10, cyclic synchronous torque, with a command such as \"0x6071\" is served today; \
            so is a mode of the maker (negative) whose command is a current";
        let mode = real.mode_of_operation;
        if let Some(name) = cia402::mode_without_torque(mode) {
            let path = format!("{path}.mode_of_operation");
            let message = format!("mode {mode}, {name}, is not served yet");
            let label = "a current would be commanded as a position or a speed";
            let problem = self.document.problem(&path, message, label);
            self.add([problem.with_help(remedy)]);
        }
        let text = &real.command.object;
        if let Ok((index, _)) = object_address(text)
            && let Some(name) = cia402::target_without_torque(index)
        {
            let path = format!("{path}.command.object");
            let message = format!("\"{text}\" is the {name} of a drive, which is not served yet");
            let label = "a current would be commanded as a position or a speed";
            let problem = self.document.problem(&path, message, label);
            self.add([problem.with_help(remedy)]);
        }
    }

    /// Refuses an io node between an emulated and a real plant: a real node cannot act on an emulated plant, nor the other way
    /// round.
    fn io_beside_external(&self, name: &str) -> Option<Problem> {
        let is_ours = |name: &str| self.rig.node[name].is_ours();
        let is_between =
            |drive: &&String| self.rig.acts_on(name, drive) && is_ours(drive) != is_ours(name);
        let drive = self.rig.node.keys().find(is_between)?;
        let (message, label) = if is_ours(drive) {
            (
                format!("`{name}` cannot act on an emulated plant"),
                format!("it is external, and `{drive}` is not"),
            )
        } else {
            (
                format!("`{name}` acts on the plant of `{drive}`, which nobody emulates"),
                format!("`{drive}` is external: `{name}` must be so too, or have no port there"),
            )
        };
        Some(
            self.document
                .key_problem(&format!("node.{name}"), message, label),
        )
    }

    /// Checks that each port exists, and that one node drives it.
    fn ports(&mut self) {
        let mut driven: BTreeMap<&str, String> = BTreeMap::new();
        for (name, node) in &self.rig.node {
            let amplifier = node.amplifier.iter().map(|part| {
                let port = part.port.as_ref();
                ("amplifier.port".to_owned(), port, CURRENT_PORT)
            });
            let sensor = node.sensor.iter().map(|part| {
                let port = part.port.as_ref();
                ("sensor.port".to_owned(), port, POSITION_PORT)
            });
            let outputs = node.outputs.iter().flat_map(|outputs| &outputs.0);
            let outputs =
                outputs.map(|(output, port)| (format!("outputs.{output}"), Some(port), "PORT"));
            for (key, port, wanted) in amplifier.chain(sensor).chain(outputs) {
                let path = format!("node.{name}.{key}");
                let Some(port) = port else {
                    if node.kind == Profile::Drive && node.is_ours() {
                        let message = format!("`{name}` is wired to no plant");
                        let label = format!("`{key}` is missing, as in \"PLANT.{wanted}\"");
                        self.at_key(&path, message, label);
                    }
                    continue;
                };
                self.add(self.port(&path, port, wanted));
                if wanted == POSITION_PORT {
                    continue;
                }
                if let Some(first) = driven.get(port.as_str()) {
                    let message = format!("two nodes drive the port `{port}`");
                    self.twice([first, &path], message, "this one");
                }
                driven.entry(port).or_insert(path);
            }
        }
    }

    /// Checks a port against the ports of its plant, where its model is known.
    fn port(&self, path: &str, port: &str, wanted: &str) -> Option<Problem> {
        let (plant, name) = port.split_once('.').unwrap_or((port, ""));
        if !self.rig.plant.contains_key(plant) {
            let message = format!("there is no plant `{plant}`");
            let label = meant_or_known(plant, self.rig.plant.keys());
            return Some(self.document.problem(path, message, label));
        }
        (!is_name(name)).then(|| {
            let message = format!("`{port}` names no port");
            let label =
                format!("plant and port with a dot between them, as in \"{plant}.{wanted}\"");
            self.document.problem(path, message, label)
        })
    }

    /// Checks that each loop has drives, and each drive one loop.
    fn loops(&mut self) {
        let rig = self.rig;
        let mut led: BTreeMap<&str, String> = BTreeMap::new();
        let mut is_one_in_two = false;
        for (name, one) in &rig.loops {
            let path = format!("loop.{name}.outputs");
            let first_drive = one.first();
            let first_is_led = first_drive.is_some_and(|drive| led.contains_key(drive));
            for (place, drive) in one.drives().enumerate() {
                let path = format!("{path}.{place}");
                self.add(self.output(&path, drive, &one.outputs[place]));
                if let Some(first) = led.get(drive) {
                    let is_same = first.starts_with(&format!("loop.{name}."));
                    let message = if is_same {
                        format!("the drive `{drive}` is twice in the loop `{name}`")
                    } else {
                        format!("the drive `{drive}` is in two loops")
                    };
                    self.twice([first, &path], message, "here");
                    is_one_in_two |= !is_same;
                }
                led.entry(drive).or_insert(path);
            }
            // If the drive is the wrong one, the feedback may be right.
            if !first_is_led {
                self.add(self.feedback(name, &one.feedback, first_drive));
            }
        }
        // The schema has found a loop without a drive, and it is probably the loop that is missing here; so is one with another
        // loop's drive.
        let is_said = is_one_in_two || rig.loops.values().any(|one| one.outputs.is_empty());
        let is_followed = |drive: &str| rig.loops.values().any(|one| one.followed() == drive);
        for (drive, node) in rig.of_kind(Profile::Drive) {
            let is_watched = is_followed(drive) && node.is_ours();
            if !led.contains_key(drive) && !is_watched && !is_said {
                let message = format!("no loop leads the drive `{drive}`");
                let label = format!(
                    "name it in `outputs` of a loop, as in outputs = [\"{}\"]",
                    self.command_of(drive)
                );
                self.at_key(&format!("node.{drive}"), message, label);
            }
        }
    }

    /// Checks the drive that a loop commands, and its signal.
    fn output(&self, path: &str, drive: &str, output: &str) -> Option<Problem> {
        let right = self.command_of(drive);
        let (message, label) = match self.rig.node.get(drive) {
            None => (
                format!("there is no node `{drive}`"),
                meant_or_known(drive, self.rig.node.keys()),
            ),
            Some(node) if node.kind != Profile::Drive => (
                format!("`{drive}` is no drive"),
                "a loop is moved by drives".to_owned(),
            ),
            Some(_) if output == right => return None,
            Some(node) => (
                format!("`{output}` is not a signal that a loop can command"),
                match node.amplifier_port() {
                    Some(port) => format!(
                        "write \"{right}\", because the amplifier of `{drive}` drives `{port}`"
                    ),
                    None => format!("write \"{right}\""),
                },
            ),
        };
        Some(self.document.problem(path, message, label))
    }

    /// Returns the signal of a drive that a loop can follow.
    fn signal_of(&self, drive: &str) -> String {
        self.rig.quantities_of(drive).feedback.name
    }

    /// Returns the signal of a drive that a loop can command.
    fn command_of(&self, drive: &str) -> String {
        format!("{drive}.{}", self.rig.quantities_of(drive).output.name)
    }

    fn feedback(&self, name: &str, feedback: &str, first: Option<&str>) -> Option<Problem> {
        let (node, signal) = feedback.split_once('.').unwrap_or((feedback, ""));
        let path = format!("loop.{name}.feedback");
        // A loop without a drive has been reported already.
        let first = first?;
        let drives = || self.rig.of_kind(Profile::Drive).map(|(name, _)| name);
        if drives().all(|drive| drive != node) {
            let message =
                format!("the loop `{name}` follows `{feedback}`, which no drive measures");
            let label = match nearest(node, drives()) {
                Some(meant) => format!("did you mean \"{meant}.{}\"?", self.signal_of(meant)),
                None => format!("write \"{first}.{}\"", self.signal_of(first)),
            };
            // If the loop also commands this node, that has been reported already.
            let problem = || self.document.problem(&path, message, label);
            return (first != node).then(problem);
        }
        let measured = self.signal_of(node);
        (signal != measured).then(|| {
            let message = format!("a drive has no signal `{signal}` that a loop can follow");
            let label = format!("write \"{node}.{measured}\"");
            self.document.problem(&path, message, label)
        })
    }
}
