//! The plants and laws that a bench knows, and the frames of each pair of them.

use std::borrow::Borrow;
use std::collections::BTreeSet;
use std::sync::{Arc, OnceLock};

use dbc::names::{
    self, OUTPUT, PLANT_OUTPUT, POSITION, RPDO1, SDO2_ANSWER, SDO2_REQUEST, TARGET, TPDO1, TPDO2,
    TPDO3, TRUE_POSITION, TRUTH, message,
};
use dbc::{
    Coding, Composer, Database, Kind, Message, Port, Ports, Quantities, Quantity, Range, Signal,
    local_name,
};
use scenario::disturbance::Disturbance;
use scenario::node::{Node, NodeIndex, Nodes, Profile};
use scenario::plant::PlantModel;
use scenario::rig::nodes::{Amplifier, kind_of_output};
use scenario::sweep::Sweep;
use scenario::wiring::{IoOutput, IoWiring, Measured, Wiring};
use scenario::{Identifiers, Objection, Trial};

use crate::loaded_drive::LoadedDrive;
use crate::plan::Plan;
use crate::signal_names::SignalNames;
use crate::swept_fmu;

/// Signals whose names and units follow from the quantities of a loop, each with the service of its message.
const SIGNALS_OF_LOOP: [(&str, &str); 5] = [
    (TPDO1, POSITION),
    (TPDO1, OUTPUT),
    (RPDO1, TARGET),
    (TPDO2, TRUE_POSITION),
    (TRUTH, PLANT_OUTPUT),
];
/// Count of an output of the shipped drive, whose rated current is 1 A, and the mention of that current in the comments.
const OUTPUT_FACTOR: f64 = 0.001;
const RATED: &str = "of 1 A";

/// Finds the reason why a plant makes no sense.
pub type FindPlantObjection = fn(&PlantModel) -> Option<Objection>;

/// The plants and laws that scenarios may choose.
///
/// The catalogue knows them by their ports and terms, not by their code: the crates that play them hand in the rest.
pub struct Catalogue {
    /// Finds the ports of a plant, or nothing for a plant that is not known here or cannot be made; `None` if all plants publish
    /// the signals of the shipped DBC.
    pub find_ports: Option<fn(&PlantModel) -> Option<Ports>>,
    /// Finds the reason why a plant makes no physical sense.
    pub plant_objection: FindPlantObjection,
    /// Finds the terms that a scenario's law publishes; empty for a law that is not known here.
    pub find_terms: fn(&Trial) -> Vec<Signal>,
    /// Finds the reason why a scenario's law makes no sense.
    pub law_objection: fn(&Trial) -> Option<Objection>,
}

/// The part of a loop's frames that depends on its plant, its law and its io nodes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Published {
    /// Signals of its plant that its drive publishes.
    pub(crate) signals: Vec<Signal>,
    /// Terms of its law.
    pub(crate) terms: Vec<Signal>,
    /// Io nodes that act on the plants which are emulated with its drive, each with its outputs.
    pub(crate) io: Vec<(NodeIndex, Vec<IoOutput>)>,
}

impl Catalogue {
    /// Makes a catalogue of the SMA actuator under the sliding-mode law, by the shipped DBC: enough to read recordings without
    /// any plant's code.
    pub fn shipped() -> Self {
        Self {
            find_ports: None,
            plant_objection: |_| None,
            find_terms: |_| terms_of_sliding_mode(),
            law_objection: |_| None,
        }
    }

    /// Returns the frames of a scenario's loop alone on its bus.
    pub(crate) fn frames(&self, trial: &Trial) -> Frames {
        let wiring = &trial.wiring;
        let ports = self.ports(trial).unwrap_or_default();
        let recorded = wiring.recorded(&ports).unwrap_or_default().into_iter();
        let signals = recorded.map(|(_, port)| signal_of(port, wiring.recorded_name(port)));
        let io = wiring
            .shared
            .io_on(|plant| trial.plants.contains_key(plant));
        let published = Published {
            signals: match self.find_ports {
                Some(_) => signals.collect(),
                None => wire_signals(),
            },
            terms: (self.find_terms)(trial),
            io: io.map(|io| (io.node, io.outputs(&ports))).collect(),
        };
        let controller = wiring.controller();
        let composer = with_followed(Composer::new(&controller.name, controller.id()), wiring);
        let composer = published.compose(composer, wiring, None, |_| true);
        let mut composer = with_outputs(composer, &wiring.shared.nodes, &published.io);
        // Of io nodes at plants that are emulated elsewhere, the names are known here.
        let is_here = |io: &&IoWiring| published.io.iter().any(|(node, _)| *node == io.node);
        for io in wiring.shared.io.iter().filter(|io| !is_here(io)) {
            let ports = io.outputs.keys().map(|name| Port::input(name, [0.0, 1.0]));
            composer = with_io(composer, wiring.node(io.node), ports);
        }
        Frames::new(published, Arc::new(composer.finish()), wiring)
    }

    /// Returns the ports of the plants that are emulated together in a loop, as `PLANT.PORT`; `None` if they are not known here.
    pub fn ports(&self, trial: &Trial) -> Option<Ports> {
        let plants = trial.plants.iter();
        let ports = plants.map(|(name, plant)| Some((&**name, self.plant_ports(plant)?)));
        Some(Ports::joined(ports.collect::<Option<Vec<_>>>()?))
    }

    /// Returns the ports of a plant; `None` if they are not known here.
    pub(crate) fn plant_ports(&self, plant: &PlantModel) -> Option<Ports> {
        (self.find_ports?)(plant)
    }

    /// Returns the objections that only a bench can make to a scenario: to names of signals, and to a plant without physical
    /// sense. The known names are collected only if the scenario has some.
    pub fn objections(&self, trial: &Trial) -> Vec<Objection> {
        let frames = self.frames(trial);
        let is_wrong_fmu =
            |plant: &PlantModel| plant.fmu.is_some() && (self.plant_objection)(plant).is_some();
        // A wrong FMU is a problem of the rig file, and hides its signals.
        if !trial.wiring.input.is_empty() && trial.plants.values().any(is_wrong_fmu) {
            return Vec::new();
        }
        let law = (self.law_objection)(trial);
        // A wrong law hides its signals, too.
        let mut objections = match law {
            Some(_) => Vec::new(),
            None => SignalNames::objections(trial, &frames),
        };
        objections.extend((self.plant_objection)(trial.plant()));
        objections.extend(law);
        objections.extend(ambiguous_term(&frames, trial));
        objections
    }

    /// Finds a problem of a plant, at its place in the rig file, or a value of a sweep that an FMU does not take, at its place in
    /// the scenario.
    pub(crate) fn objection_to_plant(
        &self,
        name: &str,
        plant: &PlantModel,
        sweep: Option<&Sweep>,
    ) -> Option<Objection> {
        let Some(objection) = (self.plant_objection)(plant) else {
            return swept_fmu::objection(name, plant, sweep?, self.plant_objection);
        };
        let below = objection.path.strip_prefix("plant.");
        let path = format!("plant.{name}.{}", below.unwrap_or_default());
        Some(Objection { path, ..objection })
    }
}

/// Finds a disturbance with a value that its output cannot have.
pub(crate) fn output_objection(plan: &Plan, disturbance: &Disturbance) -> Option<Objection> {
    let io = Vec::from_iter(plan.io_outputs());
    disturbance.changes().iter().find_map(|change| {
        let (_, outputs) = io
            .iter()
            .find(|(io, _)| plan.nodes[*io].name == change.node)?;
        let mut ports = outputs.iter().map(|one| &one.port);
        let port = ports.find(|port| port.name == change.output)?;
        let (value, [min, max]) = (change.value, port.range);
        let is_wrong = value.is_finite() && !(min..=max).contains(&value);
        is_wrong.then(|| {
            let path = format!("{}.value", change.path);
            let message = format!("`{}` cannot be {value} {}", port.name, port.symbol);
            Objection::new(path, message.trim_end(), format!("must be {min} to {max}"))
        })
    })
}

/// Finds a term of the law that would be one column with the set-point or with another signal of its loop.
fn ambiguous_term(frames: &Frames, trial: &Trial) -> Option<Objection> {
    let name = ambiguous_name(&frames.database, &frames.wiring)?;
    let mut terms = frames.published.terms.iter();
    terms.find(|term| term.name == name)?;
    let path = format!("controller.{}", trial.controller.law_name());
    Some(two_signals(
        path,
        &name,
        "one is a term of this law: give it another name",
    ))
}

/// Finds two signals of the rig that would be one column of a loop: an output of an io node or of a plant, or the signal of a sensor,
/// with the name of the set-point or of another signal.
pub(crate) fn two_columns(frames: &Frames) -> Option<Objection> {
    let (wiring, published) = (&frames.wiring, &frames.published);
    let name = ambiguous_name(&frames.database, wiring)?;
    let drive = &wiring.drive().name;
    // The name of a fan or a load is that of its disturbance.
    let is_free = kind_of_output(&name).is_none();
    let has_it = |io: &&IoWiring| {
        let port = io.outputs.get(&name).filter(|_| is_free);
        port.is_some_and(|port| wiring.has_output(port))
    };
    let mut nodes = wiring.shared.io.iter();
    let is_it = |(_, port): &(usize, &String)| local_name(port) == name || **port == name;
    let recorded = wiring.record.iter().flatten().enumerate();
    let (path, label) = if let Some(io) = nodes.find(has_it) {
        let path = format!("node.{}.outputs.{name}", wiring.node(io.node).name);
        (path, "one is an output of this node: give it another name")
    } else if let Some((place, _)) = recorded.filter(is_it).last() {
        let label = "the loop has a signal of this name already: leave it out";
        (format!("node.{drive}.record.{place}"), label)
    } else if published.signals.iter().any(|signal| signal.name == name) {
        let path = format!("plant.{}", wiring.plant);
        (path, "one is an output of this plant: give it another name")
    } else {
        let path = format!("node.{drive}.sensor.signal");
        (path, "the loop has one already: give this another name")
    };
    Some(two_signals(path, &name, label))
}

fn two_signals(path: String, name: &str, label: &str) -> Objection {
    Objection::new(path, format!("two signals are called `{name}`"), label)
}

/// Returns a name that two columns of a loop would have. The first column is the set-point.
pub fn ambiguous_name(database: &Database, wiring: &Wiring) -> Option<String> {
    let mut seen = BTreeSet::from([wiring.quantities.name(names::SET_POINT)]);
    let signals = columns(database, wiring).flat_map(|message| message.signals);
    let mut names = signals.map(|(name, _)| name);
    names.find(|name| !seen.insert(name.clone()))
}

/// A message with those of its signals that become columns of a loop, each with its name there.
pub struct ColumnMessage<'a> {
    /// Message on the bus.
    pub message: &'a Message,
    /// Whether it brings the values that a drive measures in each cycle.
    pub is_measured: bool,
    /// Whether it brings outputs of a plant, which are cut where its fields end.
    pub is_of_plant: bool,
    /// Whether its signals are terms of the law.
    pub is_term: bool,
    /// Signals by their names in the loop.
    pub signals: Vec<(String, &'a Signal)>,
}

/// Returns the messages of a loop whose signals become columns, in their order. If the loop follows another drive, the position
/// of that drive has the loop's name, and the signals that its drive measures are named after its drive. Outputs of
/// several io nodes are named after these.
pub fn columns<'a>(
    database: &'a Database,
    wiring: &'a Wiring,
) -> impl Iterator<Item = ColumnMessage<'a>> {
    let (drive, followed_drive) = (wiring.drive(), wiring.followed_drive());
    let is_feedback = [drive, followed_drive].map(|node| message(&node.name, TPDO1));
    let publishing = [drive, followed_drive].into_iter();
    let of_plant = publishing.flat_map(|node| database.plant_messages(&node.name));
    let of_plant = Vec::from_iter(of_plant.map(|message| message.raw_id));
    let of_node = |node: NodeIndex, service: &str| {
        let message = database.message(&message(&wiring.node(node).name, service))?;
        Some((message, Some(node)))
    };
    let drive_messages = [TPDO1, RPDO1, TPDO2, TPDO3]
        .into_iter()
        .filter_map(move |service| of_node(wiring.drive, service));
    let terms = database.term_messages(&wiring.controller().name, wiring.loop_among_several());
    let terms = Vec::from_iter(terms);
    let law_messages = terms.clone().into_iter().map(|message| (message, None));
    let io_messages = wiring.io_nodes().filter_map(move |io| of_node(io, RPDO1));
    let messages = drive_messages.chain(law_messages).chain(io_messages);
    let columns = messages.map(move |(message, node)| {
        let all = message.signals.iter();
        let signals = all.filter(|signal| wiring.has_signal(node, &signal.name));
        let named = signals.map(|signal| (name_in_loop(signal, node, wiring), signal));
        (message, named.collect())
    });
    let followed = followed(database, wiring)
        .map(|(message, signal)| (message, vec![(signal.name.clone(), signal)]));
    columns
        .chain(followed)
        .map(move |(message, signals)| ColumnMessage {
            is_measured: is_feedback.contains(&message.name),
            is_of_plant: of_plant.contains(&message.raw_id),
            is_term: terms.contains(&message),
            message,
            signals,
        })
}

/// Returns the messages of a node, other than the terms of laws.
pub(crate) fn messages_of<'a>(
    database: &'a Database,
    node: &Node,
) -> impl Iterator<Item = &'a Message> {
    let services = names::SERVICES.into_iter().map(|(service, _)| service);
    let has = |service: &&str| {
        node.profile() != Some(Profile::Manager) || names::CONTROLLER_SERVICES.contains(service)
    };
    let messages = services.filter(has);
    messages.filter_map(|service| database.message(&message(&node.name, service)))
}

/// Returns the signals of another drive that a loop follows: the measured one and the true one.
pub(crate) fn followed<'a>(
    database: &'a Database,
    wiring: &'a Wiring,
) -> impl Iterator<Item = (&'a Message, &'a Signal)> {
    let services = [TPDO1, TPDO2]
        .into_iter()
        .filter(|_| !wiring.follows_itself());
    let messages = services
        .filter_map(|service| database.message(&message(&wiring.followed_drive().name, service)));
    let signals =
        messages.flat_map(|message| message.signals.iter().map(move |one| (message, one)));
    signals.filter(|(_, signal)| is_measured(signal, &wiring.quantities.feedback))
}

/// Returns the name, in a loop, of a signal of one of its nodes.
pub(crate) fn name_in_loop(signal: &Signal, node: Option<NodeIndex>, wiring: &Wiring) -> String {
    match node {
        Some(node) if node == wiring.drive && is_measured(signal, &wiring.sensor.quantity) => {
            wiring.name_in_loop(&signal.name)
        }
        Some(node) if wiring.node(node).is_io() && wiring.io_nodes().count() > 1 => {
            format!("{}.{}", wiring.node(node).name, signal.name)
        }
        _ => signal.name.clone(),
    }
}

/// Checks whether a signal is the measured or the true value of a sensor of this quantity.
fn is_measured(signal: &Signal, by: &Quantity) -> bool {
    let quantities = Quantities {
        feedback: by.clone(),
        ..Quantities::default()
    };
    let mut patterns = [POSITION, TRUE_POSITION].iter();
    patterns.any(|pattern| quantities.name(pattern) == signal.name)
}

/// Frames of a loop that is alone on its bus, or of a recording.
#[derive(Debug)]
pub(crate) struct Frames {
    pub(crate) published: Published,
    wiring: Wiring,
    pub(crate) database: Arc<Database>,
    names: OnceLock<SignalNames>,
}

impl Frames {
    pub(crate) fn new(published: Published, database: Arc<Database>, wiring: &Wiring) -> Self {
        Self {
            published,
            wiring: wiring.clone(),
            database,
            names: OnceLock::new(),
        }
    }

    /// Returns all names of all signals.
    pub(crate) fn names(&self) -> &SignalNames {
        let make = || SignalNames::new(&self.database, &self.wiring, &self.published);
        self.names.get_or_init(make)
    }
}

impl Published {
    /// Adds the frames of the drive and the law of a loop, of which canrig plays the nodes for which `is_ours` holds. A real
    /// drive has frames of its own; an emulated one publishes the truth about its plant. Only canrig's controller publishes the
    /// terms of a law.
    pub(crate) fn compose(
        &self,
        composer: Composer,
        wiring: &Wiring,
        real: Option<&LoadedDrive>,
        is_ours: impl Fn(&Node) -> bool,
    ) -> Composer {
        let Wiring {
            sensor,
            identifiers,
            ..
        } = wiring;
        let drive = wiring.drive();
        let signals = is_ours(drive).then_some(self.signals.as_slice());
        let drive = (drive.name.as_str(), drive.id());
        let composer = match real {
            Some(real) => real.with_drive(composer, drive),
            None => composer.with_drive(drive, signals),
        };
        let scale = Scale {
            quantities: wiring.drive_quantities(),
            measured: sensor,
            amplifier: real.is_none().then_some(&wiring.amplifier),
        };
        let mut composer = scale.put(composer, drive.0);
        let Identifiers {
            second_sdo,
            truth,
            terms,
            ..
        } = *identifiers;
        for (service, identifier) in [
            (SDO2_REQUEST, second_sdo[0]),
            (SDO2_ANSWER, second_sdo[1]),
            (TRUTH, truth),
        ] {
            composer = composer.edited(drive.0, service, |message| {
                message.raw_id = identifier.into();
            });
        }
        let in_rig = (wiring.loop_number(), wiring.loop_among_several());
        if is_ours(wiring.controller()) {
            composer.with_terms(in_rig, terms, &self.terms)
        } else {
            composer
        }
    }
}

/// Adds the frames of io nodes with their outputs.
pub(crate) fn with_outputs<'a>(
    composer: Composer,
    nodes: &Nodes,
    io: impl IntoIterator<Item = &'a (NodeIndex, Vec<IoOutput>)>,
) -> Composer {
    io.into_iter().fold(composer, |composer, (io, outputs)| {
        with_io(
            composer,
            &nodes[*io],
            outputs.iter().map(|output| &output.port),
        )
    })
}

/// Adds the frames of an io node with these ports.
fn with_io(
    composer: Composer,
    io: &Node,
    ports: impl Iterator<Item = impl Borrow<Port>>,
) -> Composer {
    let signals = ports.map(|port| signal_of(port.borrow(), port.borrow().name.clone()));
    composer.with_io((&io.name, io.id()), &Vec::from_iter(signals))
}

/// Adds the frames of the drive that a loop follows if it belongs to another loop: the measured and the true value there.
fn with_followed(composer: Composer, wiring: &Wiring) -> Composer {
    if wiring.follows_itself() {
        return composer;
    }
    let followed = wiring.followed_drive();
    let with_drive = composer.with_drive((&followed.name, followed.id()), Some(&[]));
    let scale = Scale {
        quantities: wiring.quantities.clone(),
        measured: &wiring.feedback,
        amplifier: Some(&Amplifier::default()),
    };
    scale.put(with_drive, &followed.name)
}

/// Quantities of a drive, and how its frames count them.
struct Scale<'a> {
    quantities: Quantities,
    measured: &'a Measured,
    /// Amplifier of an emulated drive; a real drive counts as its rig file says.
    amplifier: Option<&'a Amplifier>,
}

impl Scale<'_> {
    /// Puts the quantities into the frames of a drive.
    fn put(&self, composer: Composer, drive: &str) -> Composer {
        let Quantities { feedback, output } = &self.quantities;
        let mut composer = composer.measuring(drive, &feedback.name, &output.name);
        for (service, pattern) in SIGNALS_OF_LOOP {
            composer = composer.edited(drive, service, |message| {
                let is_it = |signal: &&mut Signal| names::pattern(&signal.name) == Some(pattern);
                // A signal of the plant that has such a name comes before.
                if let Some(signal) = message.signals.iter_mut().rev().find(is_it) {
                    self.put_units(signal, pattern);
                }
            });
        }
        composer
    }

    /// Puts the name, the unit and the counts of a quantity into its signal. Outputs of an amplifier count thousandths of the
    /// rated value.
    fn put_units(&self, signal: &mut Signal, pattern: &str) {
        let (quantities, measured) = (&self.quantities, self.measured);
        let coding = &mut signal.coding;
        let unit = match pattern {
            POSITION | TRUE_POSITION => quantities.feedback.unit.symbol(),
            _ => quantities.output.unit.symbol(),
        };
        signal.name = quantities.name(pattern);
        unit.clone_into(&mut signal.unit);
        let is_shipped = *quantities == Quantities::default()
            && measured.counts_per_unit() == quantities.feedback.unit.counts()
            && !measured.is_true_float();
        match (pattern, self.amplifier) {
            (POSITION, Some(_)) if !is_shipped => {
                let factor = 1.0 / measured.counts_per_unit();
                coding.set_factor(factor);
                let [minimum, maximum] = [i32::MIN, i32::MAX].map(|end| f64::from(end) * factor);
                coding.range = Some(Range { minimum, maximum });
            }
            (TRUE_POSITION, _) if measured.is_true_float() => {
                coding.set_factor(1.0);
                (coding.kind, coding.range) = (Kind::Float32, None);
            }
            (OUTPUT | TARGET | PLANT_OUTPUT, Some(amplifier)) => {
                let rated = amplifier.rated();
                let most = amplifier.range().largest().max(rated);
                let (minimum, maximum) = match pattern {
                    OUTPUT => (-32.768 * rated, 32.767 * rated),
                    _ => (-most, most),
                };
                coding.set_factor(OUTPUT_FACTOR * rated);
                coding.range = Some(Range { minimum, maximum });
                let rated = format!("of {rated} {unit}");
                signal.comment = signal.comment.replace(RATED, rated.trim_end());
            }
            _ => {}
        }
    }
}

/// Returns the signals of the wire, which the shipped DBC has.
fn wire_signals() -> Vec<Signal> {
    let messages = Database::shipped().plant_messages("drive");
    let signals = messages.flat_map(|message| &message.signals);
    let others = signals.filter(|signal| names::pattern(&signal.name) != Some(TRUE_POSITION));
    others.cloned().collect()
}

/// Returns the terms of the sliding-mode law, which the shipped DBC has.
pub(crate) fn terms_of_sliding_mode() -> Vec<Signal> {
    let messages = Database::shipped().term_messages("controller", "");
    let terms = messages.flat_map(|message| &message.signals);
    terms.cloned().collect()
}

/// Returns the signal of a port on the bus, under this name.
fn signal_of(port: &Port, name: String) -> Signal {
    let coding = Coding::of_output(port.steps_per_unit, port.range);
    Signal::new(name, &port.symbol, &port.comment, coding)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use scenario::Beside;

    use super::*;
    use crate::plan::Plan;

    /// Returns the ports of a plant whose drive publishes one signal.
    fn plant_with(signal: &str) -> Ports {
        Ports {
            inputs: vec![Port::input("current_amperes", [0.0, 1.0])],
            outputs: ["position_metres", signal]
                .map(|name| Port::output(name, [0.0, 1.0]))
                .into(),
        }
    }

    fn sum() -> Signal {
        let coding = Coding::little_endian(0, 32, Kind::Float32, 1.0, None);
        Signal::new("sum".to_owned(), "", "", coding)
    }

    #[test]
    fn plants_and_laws_have_frames_of_their_own() {
        let catalogue = Catalogue {
            find_ports: Some(|_| Some(plant_with("spring_force_newtons"))),
            ..Catalogue::shipped()
        };
        let text = "schema = 1\nrig = \"dc_motor\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let trial = Trial::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let frames = catalogue.frames(&trial);
        assert!(frames.names().find("spring_force_newtons").is_ok());
        assert!(frames.names().find("sum").is_err());
        assert!(
            frames
                .names()
                .find("sliding_variable_metres_per_second_squared")
                .is_ok()
        );
        assert!(frames.names().find("Reference position").is_ok());
        let catalogue = Catalogue {
            find_terms: |_| vec![sum()],
            ..catalogue
        };
        let frames = catalogue.frames(&trial);
        assert!(frames.names().find("sum").is_ok());
        assert!(
            frames
                .names()
                .find("sliding_variable_metres_per_second_squared")
                .is_err()
        );
        // The object has another meaning than in the data sheet of the shipped law.
        assert!(frames.names().find("Reference position").is_err());
    }

    #[test]
    fn with_a_real_drive_the_plants_signals_keep_their_names_and_are_on_no_bus() {
        const RIG: &str = r#"schema = 1
name = "bench"
[plant.motor.dc_motor]
[node.controller]
kind = "controller"
node_id = 1
[node.drive]
kind = "drive"
node_id = 16
amplifier = { port = "motor.current_amperes" }
sensor = { port = "motor.position_metres" }
limits = { current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }
[loop.position]
feedback = "drive.position"
outputs = ["drive.current"]
"#;
        fn three() -> Ports {
            let mut ports = plant_with("a");
            let more = ["b", "c"].map(|name| Port::output(name, [0.0, 1.0]));
            ports.outputs.extend(more);
            ports
        }
        let catalogue = Catalogue {
            find_ports: Some(|_| Some(three())),
            find_terms: |_| vec![sum()],
            ..Catalogue::shipped()
        };
        let text = "schema = 1\nrig = \"rig.toml\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let beside = Beside::new(Path::new("t.toml"));
        let read = |_: &str| Ok(RIG.to_owned());
        let plan = Plan::parse(&beside, text.to_owned(), read, &catalogue).unwrap();
        let names = plan.only_loop().unwrap().names();
        assert_eq!(names.find("c"), Ok("drive_tpdo3.c"));
        assert_eq!(names.find("sum"), Ok("controller_tpdo1.sum"));
        assert!(names.find("wire_temperature_celsius").is_err());
        for id in [0x290, 0x390, 0x6B0] {
            let frame = can::CanFrame::new(id, &[0; 8]);
            assert_eq!(plan.database().message_of(&frame), None, "{id:#x}");
        }
        assert_eq!(plan.database().plant_messages("drive").count(), 0);
    }

    #[test]
    fn two_signals_of_one_name_are_refused_with_their_owner() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let trial = Trial::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let said = |catalogue: &Catalogue| {
            let mut objections = catalogue.objections(&trial);
            // A law is objected to before the rig.
            if objections.is_empty() {
                objections.extend(two_columns(&catalogue.frames(&trial)));
            }
            let objections = objections.into_iter();
            Vec::from_iter(objections.map(|one| format!("{}: {}", one.path, one.message)))
        };
        let plants = Catalogue {
            find_ports: Some(|_| Some(plant_with("position_millimetres"))),
            find_terms: |_| Vec::new(),
            ..Catalogue::shipped()
        };
        let twice = "plant.wire: two signals are called `position_millimetres`";
        assert_eq!(said(&plants), [twice]);
        let set_points = Catalogue {
            find_ports: Some(|_| Some(plant_with("set_point_millimetres"))),
            ..plants
        };
        let twice = "plant.wire: two signals are called `set_point_millimetres`";
        assert_eq!(said(&set_points), [twice]);
        let laws = Catalogue {
            find_ports: Some(|_| Some(plant_with("sum"))),
            find_terms: |_| vec![sum()],
            ..Catalogue::shipped()
        };
        let twice = "controller.open_loop: two signals are called `sum`";
        assert_eq!(said(&laws), [twice]);
    }
}
