//! The plants and laws that a bench knows, and what each pair of them puts on the bus.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use dbc::names::{
    self, CURRENT, POSITION, RPDO1, TARGET_CURRENT, TERMS_MAX, TPDO1, TPDO2, TPDO3, TRUE_POSITION,
    TRUE_POSITION_IN, message,
};
use dbc::{Composer, Database, LawTerm, Message, PlantSignal, PositionUnit, Range};
use scenario::node::{LoopNodes, Node};
use scenario::plant::SMA_ACTUATOR;
use scenario::port::{Port, Ports, Unit};
use scenario::wiring::IoOutput;
use scenario::{Objection, Scenario};

use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;
use crate::swept_fmu;

/// Columns of each drive, besides the signals of its plant.
const COLUMNS_OF_DRIVE: [&str; 4] = [POSITION, CURRENT, TARGET_CURRENT, TRUE_POSITION];

/// Why a scenario's plant, or its law, makes no sense.
type FindObjection = fn(&Scenario) -> Option<Objection>;

/// The ports of a scenario's plant; none for a plant that nobody knows here, or that cannot be made.
type FindPorts = fn(&Scenario) -> Option<Ports>;

/// The terms that a scenario's law publishes; none for a law that nobody knows here.
type FindTerms = fn(&Scenario) -> Vec<LawTerm>;

/// The plants and laws that scenarios may choose.
///
/// It knows them by what they put on the bus, not by their code: who plays them hands in the rest.
pub struct Catalogue {
    /// Plants of one axis, of which a drive always publishes the same.
    plants: Vec<(String, Vec<PlantSignal>)>,
    plant_objection: FindObjection,
    find_ports: FindPorts,
    law_objection: FindObjection,
    /// `None` where all laws are taken to publish what the shipped DBC has.
    find_terms: Option<FindTerms>,
    /// The frames of single loops, as far as they were asked for.
    frames: Mutex<Vec<Arc<Frames>>>,
}

/// What a loop puts on the bus, by its plant, its law and its io node.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Published {
    /// The signals of its plant that its drive publishes.
    pub(crate) signals: Vec<PlantSignal>,
    /// The terms of its law; `None` for those of the shipped DBC.
    pub(crate) terms: Option<Vec<LawTerm>>,
    /// The outputs of its io node besides fan and load.
    pub(crate) outputs: Vec<IoOutput>,
    /// The unit of its positions.
    pub(crate) unit: Unit,
}

impl Catalogue {
    /// The plants of one axis, each by its name with what it says on the bus. `plant_objection` says why a scenario's plant makes no
    /// physical sense, and `find_ports` which ports it has. All laws publish what the shipped DBC has.
    #[must_use]
    pub fn new<'a>(
        plants: impl Iterator<Item = (&'a str, &'a [PlantSignal])>,
        plant_objection: FindObjection,
        find_ports: FindPorts,
    ) -> Self {
        Self {
            plants: plants
                .map(|(name, signals)| (name.to_owned(), signals.to_vec()))
                .collect(),
            plant_objection,
            find_ports,
            law_objection: |_| None,
            find_terms: None,
            frames: Mutex::default(),
        }
    }

    /// The same with laws, by the terms that they publish, and by what says why a scenario's law makes no sense.
    #[must_use]
    pub fn with_laws(self, find_terms: FindTerms, law_objection: FindObjection) -> Self {
        Self {
            find_terms: Some(find_terms),
            law_objection,
            ..self
        }
    }

    /// The SMA actuator under the sliding-mode law, by the DBC that ships: enough to read its recordings without any plant's code.
    #[must_use]
    pub fn shipped() -> Self {
        let messages = Database::shipped().plant_messages("drive");
        let signals = messages.flat_map(|message| &message.signals);
        let own = signals.filter(|signal| !signal.name.starts_with(TRUE_POSITION_IN));
        let wire = own.map(|signal| PlantSignal {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            comment: signal.comment.clone(),
            resolution: signal.coding.factor,
            range: signal.coding.range.unwrap_or(Range {
                minimum: 0.0,
                maximum: 1.0,
            }),
        });
        let wire = Vec::from_iter(wire);
        let plants = [(SMA_ACTUATOR, wire.as_slice())];
        Self::new(plants.into_iter(), |_| None, |_| None)
    }

    /// The frames of a scenario's loop alone on its bus.
    #[must_use]
    pub fn frames(&self, scenario: &Scenario) -> Arc<Frames> {
        let published = Published {
            signals: self.signals(scenario),
            terms: self.find_terms.map(|find| find(scenario)),
            outputs: self.outputs(scenario),
            unit: scenario.wiring.unit.clone(),
        };
        let nodes = &scenario.wiring.nodes;
        let of_loop = scenario.wiring.loop_among_several();
        // A half-done entry is still right.
        let mut known = self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        let is_it = |frames: &&Arc<Frames>| {
            frames.published == published && frames.nodes == *nodes && frames.of_loop == of_loop
        };
        if let Some(frames) = known.iter().find(is_it) {
            return Arc::clone(frames);
        }
        let frames = Arc::new(Frames::new(published, scenario));
        known.push(Arc::clone(&frames));
        frames
    }

    /// What the drive of a scenario publishes of its plant.
    fn signals(&self, scenario: &Scenario) -> Vec<PlantSignal> {
        let wiring = &scenario.wiring;
        let is_plain = wiring.record.is_none()
            && wiring.outputs.is_empty()
            && wiring.unit == Unit::Millimetres;
        let plant = scenario.plant.name();
        let mut plants = self.plants.iter();
        match plants.find(|(name, _)| is_plain && name == plant) {
            Some((_, signals)) => signals.clone(),
            None => self.published(scenario).unwrap_or_default(),
        }
    }

    /// The ports of a scenario's plant; none where nobody knows them here.
    #[must_use]
    pub fn ports(&self, scenario: &Scenario) -> Option<Ports> {
        (self.find_ports)(scenario)
    }

    /// What a drive publishes that does not always publish the same.
    fn published(&self, scenario: &Scenario) -> Option<Vec<PlantSignal>> {
        let ports = self.ports(scenario)?;
        let recorded = scenario.wiring.recorded(&ports).ok()?;
        let signals = recorded.into_iter().map(|(_, port)| signal_of(port));
        Some(signals.collect())
    }

    /// The outputs of the io node of a scenario's plant, besides fan and load.
    fn outputs(&self, scenario: &Scenario) -> Vec<IoOutput> {
        if scenario.wiring.outputs.is_empty() {
            return Vec::new();
        }
        let ports = self.ports(scenario).unwrap_or_default();
        scenario.wiring.io_outputs(&ports)
    }

    /// What is wrong with a disturbance by another output: a value that it cannot have.
    fn output_objection(&self, scenario: &Scenario) -> Option<Objection> {
        let outputs = self.outputs(scenario);
        let mut changes = scenario.disturbance.output.iter().enumerate();
        changes.find_map(|(index, change)| {
            let output = outputs.iter().find(|one| one.name == change.name)?;
            let [min, max] = output.range;
            let (name, symbol) = (&output.name, &output.symbol);
            (!(min..=max).contains(&change.value)).then(|| Objection {
                path: format!("disturbance.output.{index}.value"),
                message: format!("`{name}` cannot be {} {symbol}", change.value),
                label: format!("must be {min} to {max}"),
                help: None,
            })
        })
    }

    /// What only a bench knows to be wrong in a scenario: names of signals, and a plant that makes no physical sense. The
    /// names are collected only where the scenario has some.
    #[must_use]
    pub fn objections(&self, scenario: &Scenario) -> Vec<Objection> {
        let frames = self.frames(scenario);
        let plant = (self.plant_objection)(scenario);
        // What is wrong with an FMU stands in the rig file, and hides its signals.
        if is_wired_fmu(scenario) && plant.is_some() {
            return Vec::new();
        }
        let mut objections = SignalNames::objections(scenario, || frames.names());
        objections.extend(plant);
        objections.extend((self.law_objection)(scenario));
        objections.extend(self.output_objection(scenario));
        objections.extend(two_columns(&frames, scenario));
        objections
    }

    /// What is wrong with the FMU of a rig's plant, at its place in the rig file, or with what a sweep makes of it, at its place in
    /// the scenario.
    pub(crate) fn fmu_objection(&self, scenario: &Scenario, plant: &str) -> Option<Objection> {
        if !is_wired_fmu(scenario) {
            return None;
        }
        let Some(objection) = (self.plant_objection)(scenario) else {
            return swept_fmu::objection(scenario, plant, self.plant_objection);
        };
        let below = objection.path.strip_prefix("plant.");
        let path = format!("plant.{plant}.{}", below.unwrap_or_default());
        Some(Objection { path, ..objection })
    }

    /// Refuses a plant with two signals that would be one column of `signals.csv`.
    ///
    /// # Errors
    /// The first two of them, in words.
    pub fn check(&self) -> Result<(), String> {
        self.plants.iter().try_for_each(|(plant, signals)| {
            let names = signals.iter().map(|signal| signal.name.as_str());
            match twice(names.chain(COLUMNS_OF_DRIVE)) {
                None => Ok(()),
                Some(name) => Err(format!(
                    "with the plant `{plant}` two signals are called `{name}`"
                )),
            }
        })
    }
}

/// Whether a scenario's plant is an FMU in a rig file.
fn is_wired_fmu(scenario: &Scenario) -> bool {
    scenario.plant.fmu.is_some() && !scenario.wiring.input.is_empty()
}

/// A term of a law that is called like another column of its loop.
fn two_columns(frames: &Frames, scenario: &Scenario) -> Option<Objection> {
    let name = name_of_two_columns(&frames.database, &frames.nodes, &frames.of_loop)?;
    Some(Objection {
        path: format!("controller.{}", scenario.controller.law_name()),
        message: format!("two signals are called `{name}`"),
        label: "one is a term of this law: give it another name".to_owned(),
        help: None,
    })
}

/// A name that two columns of a loop would have.
#[must_use]
pub fn name_of_two_columns<'a>(
    database: &'a Database,
    nodes: &LoopNodes,
    loop_name: &str,
) -> Option<&'a str> {
    let messages = column_messages(database, nodes, loop_name);
    let signals = messages.flat_map(|message| &message.signals);
    twice(signals.map(|signal| signal.name.as_str()))
}

fn twice<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let mut seen = BTreeSet::new();
    names.find(|name| !seen.insert(*name))
}

/// The messages of a loop whose signals become columns, in their order.
pub fn column_messages<'a>(
    database: &'a Database,
    nodes: &LoopNodes,
    loop_name: &str,
) -> impl Iterator<Item = &'a Message> + use<'a> {
    let of_drive = [TPDO1, RPDO1, TPDO2, TPDO3].map(|service| message(&nodes.drive.name, service));
    let controller = &nodes.controller.name;
    let of_law = (0..TERMS_MAX).map(|place| names::terms(controller, loop_name, place));
    let of_io = nodes.io.iter().map(|io| message(&io.name, RPDO1));
    let all = Vec::from_iter(of_drive.into_iter().chain(of_law).chain(of_io));
    all.into_iter().filter_map(|name| database.message(&name))
}

/// The frames of a loop that is alone on its bus.
#[derive(Debug)]
pub struct Frames {
    pub(crate) published: Published,
    nodes: LoopNodes,
    of_loop: String,
    pub(crate) database: Arc<Database>,
    names: OnceLock<SignalNames>,
}

impl Frames {
    fn new(published: Published, scenario: &Scenario) -> Self {
        let nodes = &scenario.wiring.nodes;
        let of_loop = scenario.wiring.loop_among_several();
        let composer = Composer::new(&nodes.controller.name, nodes.controller.id);
        let composer = published.compose(composer, nodes, (of_loop, 0), Player::Emulator);
        let frames = Self::of_recording(Arc::new(composer.finish()), nodes, of_loop);
        Self {
            published,
            ..frames
        }
    }

    /// The frames of a loop of a recording with this database.
    pub(crate) fn of_recording(database: Arc<Database>, nodes: &LoopNodes, of_loop: &str) -> Self {
        Self {
            published: Published::default(),
            nodes: nodes.clone(),
            of_loop: of_loop.to_owned(),
            database,
            names: OnceLock::new(),
        }
    }

    /// All names of all signals.
    pub(crate) fn names(&self) -> &SignalNames {
        let make = || SignalNames::new(&self.database, &self.nodes, &self.of_loop);
        self.names.get_or_init(make)
    }
}

/// The player of the drive of a loop.
#[derive(Clone, Copy)]
pub(crate) enum Player<'a> {
    /// The emulator, which publishes the truth about its plant.
    Emulator,
    /// Somebody else, with a drive like the emulated one.
    External,
    /// Somebody else, with a drive of this rig.
    OnRig(&'a LoadedRig),
}

impl Published {
    /// Adds the frames of the drive, the io node and the law of a loop.
    pub(crate) fn compose(
        &self,
        composer: Composer,
        nodes: &LoopNodes,
        of_loop: (&str, u8),
        player: Player<'_>,
    ) -> Composer {
        let rename = |name: &str| self.unit.rename(name);
        let is_emulated = matches!(player, Player::Emulator);
        let unit = PositionUnit {
            symbol: self.unit.symbol(),
            resolution: (!matches!(player, Player::OnRig(_))).then(|| 1.0 / self.unit.counts()),
            rename: &rename,
        };
        let unit = (self.unit != Unit::Millimetres).then_some(&unit);
        let drive = (nodes.drive.name.as_str(), nodes.drive.id);
        let signals = is_emulated.then_some(self.signals.as_slice());
        let composer = match player {
            Player::OnRig(rig) => rig.with_drive(composer, drive, unit),
            _ => composer.with_drive(drive, signals, None, unit),
        };
        let composer = match &nodes.io {
            Some(io) if !composer.has_node(io.id) => self.with_io(composer, io),
            _ => composer,
        };
        composer.with_terms(of_loop, self.terms.as_deref(), unit)
    }

    fn with_io(&self, composer: Composer, io: &Node) -> Composer {
        let outputs = self.outputs.iter().map(|output| PlantSignal {
            name: output.name.clone(),
            unit: output.symbol.clone(),
            comment: output.comment.clone(),
            resolution: 1.0 / output.steps_per_unit,
            range: Range {
                minimum: output.range[0],
                maximum: output.range[1],
            },
        });
        let first = self.outputs.first().map_or(0, |output| output.place);
        composer.with_io((&io.name, io.id), &Vec::from_iter(outputs), first)
    }
}

/// A port as the bus has it.
fn signal_of(port: &Port) -> PlantSignal {
    let [minimum, maximum] = port.range;
    PlantSignal {
        name: port.name.clone(),
        unit: port.symbol.clone(),
        comment: port.comment.clone(),
        resolution: 1.0 / port.steps_per_unit,
        range: Range { minimum, maximum },
    }
}

#[cfg(test)]
mod tests {
    use dbc::Kind;

    use super::*;
    use crate::plan::Plan;

    fn signal(name: &str) -> PlantSignal {
        PlantSignal {
            name: name.to_owned(),
            unit: String::new(),
            comment: String::new(),
            resolution: 1.0,
            range: Range {
                minimum: 0.0,
                maximum: 1.0,
            },
        }
    }

    fn sum() -> LawTerm {
        LawTerm {
            name: "sum".to_owned(),
            unit: String::new(),
            comment: String::new(),
            bits: 32,
            kind: Kind::Float32,
            counts_per_unit: 1.0,
            range: Range {
                minimum: -1e9,
                maximum: 1e9,
            },
        }
    }

    #[test]
    fn plants_and_laws_have_frames_of_their_own() {
        let motor = [signal("spring_force_newtons")];
        let plants = [("sma_actuator", &[][..]), ("dc_motor", &motor[..])];
        let catalogue = Catalogue::new(plants.into_iter(), |_| None, |_| None);
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n[plant.dc_motor]\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let frames = catalogue.frames(&scenario);
        assert!(frames.names().find("spring_force_newtons").is_ok());
        assert!(frames.names().find("sum").is_err());
        assert!(
            frames
                .names()
                .find("sliding_variable_metres_per_second_squared")
                .is_ok()
        );
        let catalogue = catalogue.with_laws(|_| vec![sum()], |_| None);
        let frames = catalogue.frames(&scenario);
        assert!(frames.names().find("sum").is_ok());
        assert!(
            frames
                .names()
                .find("sliding_variable_metres_per_second_squared")
                .is_err()
        );
    }

    #[test]
    fn on_a_rig_the_plants_signals_keep_their_names_and_are_on_no_bus() {
        let rig = LoadedRig::from_text(
            "schema = 1\nname = \"bench\"\n[limits]\ncurrent_amperes = 0.9\n\
             position_millimetres = { min = -1.0, max = 45.0 }\nspeed_millimetres_per_second = 400.0\n",
        );
        let signals = [signal("a"), signal("b"), signal("c")];
        let plants = [("dc_motor", &signals[..])].into_iter();
        let catalogue = Catalogue::new(plants, |_| None, |_| None);
        let catalogue = catalogue.with_laws(|_| vec![sum()], |_| None);
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n[plant.dc_motor]\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let plan = Plan::new(scenario, &catalogue).on(&Arc::new(rig.unwrap()));
        let names = plan.loops[0].names();
        assert_eq!(names.find("c"), Ok("drive_tpdo3.c"));
        assert_eq!(names.find("sum"), Ok("controller_tpdo1.sum"));
        assert!(names.find("wire_temperature_celsius").is_err());
        for id in [0x290, 0x390, 0x6B0] {
            let frame = canopen::CanFrame::new(id, &[0; 8]);
            assert_eq!(plan.database().message_of(&frame), None, "{id:#x}");
        }
        assert_eq!(plan.database().plant_messages("drive").count(), 0);
    }

    #[test]
    fn two_signals_of_one_name_are_refused() {
        let double = [signal("position_millimetres")];
        let plants = [("mine", &double[..])];
        let catalogue = Catalogue::new(plants.into_iter(), |_| None, |_| None);
        let refused = "with the plant `mine` two signals are called `position_millimetres`";
        assert_eq!(catalogue.check(), Err(refused.to_owned()));
    }
}
