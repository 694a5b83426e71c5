//! The plants and laws that a bench knows, and what each pair of them puts on the bus.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use dbc::{Database, LawTerm, PlantSignal, Range};
use scenario::port::{Port, Ports, Unit};
use scenario::wiring::IoOutput;
use scenario::{Objection, Scenario};

use crate::data_sheet;
use crate::external::{External, ExternalNode};
use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;
use crate::swept_fmu;
use dbc::signals::{COLUMN_MESSAGES, TRUTH_MESSAGES};

/// The reason why a scenario's plant, or its law, makes no sense.
type FindObjection = fn(&Scenario) -> Option<Objection>;

/// The ports of a scenario's plant; `None` for a plant that is not known here, or that cannot be made.
type FindPorts = fn(&Scenario) -> Option<Ports>;

/// The terms that a scenario's law publishes; empty for a law that is not known here.
type FindTerms = fn(&Scenario) -> Vec<LawTerm>;

/// The plants and laws that scenarios may choose.
///
/// It knows them by their ports and terms, not by their code: who plays them hands in the rest.
pub struct Catalogue {
    plant_objection: FindObjection,
    /// `None` where all plants are taken to publish what the shipped DBC has.
    find_ports: Option<FindPorts>,
    law_objection: FindObjection,
    /// `None` where all laws are taken to publish what the shipped DBC has.
    find_terms: Option<FindTerms>,
    /// Frames of plants and laws, as far as they were asked for.
    frames: Mutex<Vec<(Key, Arc<Frames>)>>,
}

/// The properties by which the frames of plants and laws differ.
#[derive(PartialEq)]
struct Key {
    signals: Option<Vec<PlantSignal>>,
    terms: Option<Vec<LawTerm>>,
    outputs: Vec<IoOutput>,
    unit: Unit,
}

impl Catalogue {
    /// The SMA actuator under the sliding-mode law, by the DBC that ships: enough to read its recordings without any plant's code.
    #[must_use]
    pub fn shipped() -> Self {
        Self {
            plant_objection: |_| None,
            find_ports: None,
            law_objection: |_| None,
            find_terms: None,
            frames: Mutex::default(),
        }
    }

    /// Plants, by their ports, and by what says why a scenario's plant makes no physical sense. All laws publish what the shipped DBC
    /// has.
    #[must_use]
    pub fn new(find_ports: FindPorts, plant_objection: FindObjection) -> Self {
        Self {
            find_ports: Some(find_ports),
            plant_objection,
            ..Self::shipped()
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

    /// The frames of a scenario's plant and law.
    #[must_use]
    pub fn frames(&self, scenario: &Scenario) -> Arc<Frames> {
        let key = Key {
            signals: (self.find_ports).map(|_| self.signals(scenario).unwrap_or_default()),
            terms: self.find_terms.map(|find| find(scenario)),
            outputs: self.outputs(scenario),
            unit: scenario.wiring.unit.clone(),
        };
        // What is half done there is still right.
        let mut known = self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, frames)) = known.iter().find(|(other, _)| *other == key) {
            return Arc::clone(frames);
        }
        let frames = Frames::in_unit(key.signals.as_deref(), key.terms.as_deref(), &key.unit);
        let frames = Arc::new(frames.with_outputs(&key.outputs));
        known.push((key, Arc::clone(&frames)));
        frames
    }

    /// The signals that the drive of a scenario publishes of its plant.
    fn signals(&self, scenario: &Scenario) -> Option<Vec<PlantSignal>> {
        let ports = self.ports(scenario)?;
        let recorded = scenario.wiring.recorded(&ports).ok()?;
        let signals = recorded.into_iter().map(|(_, port)| signal_of(port));
        Some(signals.collect())
    }

    /// The ports of a scenario's plant; `None` where they are not known here.
    #[must_use]
    pub fn ports(&self, scenario: &Scenario) -> Option<Ports> {
        (self.find_ports?)(scenario)
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
}

/// Whether a scenario's plant is an FMU in a rig file.
fn is_wired_fmu(scenario: &Scenario) -> bool {
    scenario.plant.fmu.is_some() && !scenario.wiring.input.is_empty()
}

/// Two signals that would be one column: a term of the law called like another signal of its loop, or an output of the plant.
fn two_columns(frames: &Frames, scenario: &Scenario) -> Option<Objection> {
    let name = name_of_two_columns(&frames.database)?;
    let mut terms = frames.law_terms.iter().flatten();
    let (path, owner) = match terms.any(|term| term.name == name) {
        true => (
            format!("controller.{}", scenario.controller.law_name()),
            "a term of this law",
        ),
        false => (
            format!("plant.{}", scenario.plant.name()),
            "an output of this plant",
        ),
    };
    Some(Objection {
        path,
        message: format!("two signals are called `{name}`"),
        label: format!("one is {owner}: give it another name"),
        help: None,
    })
}

/// A name that two columns of `signals.csv` would have.
#[must_use]
pub fn name_of_two_columns(database: &Database) -> Option<&str> {
    let messages = COLUMN_MESSAGES
        .into_iter()
        .filter_map(|name| database.message(name));
    let mut names = messages.flat_map(|message| &message.signals);
    let mut seen = BTreeSet::new();
    let second = names.find(|signal| !seen.insert(&signal.name));
    second.map(|signal| signal.name.as_str())
}

/// What the frames of the bus mean: those of a plant and a law, or those of a recording.
#[derive(Debug)]
pub struct Frames {
    /// The terms of the law; `None` where they are in the database already.
    law_terms: Option<Vec<LawTerm>>,
    /// The unit of the loop; that of a recording is in its frames already.
    unit: Unit,
    /// The outputs of the io node besides fan and load; none of a recording.
    pub(crate) outputs: Vec<IoOutput>,
    /// What the frames mean.
    pub(crate) database: Arc<Database>,
    /// The same beside a drive that is not the emulator: nobody publishes the truth.
    without_truth: OnceLock<Arc<Database>>,
    names: OnceLock<SignalNames>,
}

impl Frames {
    /// The frames of a drive whose positions are in this unit.
    fn in_unit(signals: Option<&[PlantSignal]>, terms: Option<&[LawTerm]>, unit: &Unit) -> Self {
        let of_plant = match signals {
            Some(signals) => Database::with_plant(signals),
            None => Database::shipped().clone(),
        };
        let of_both = match terms {
            Some(terms) => of_plant.with_terms(terms),
            None => of_plant,
        };
        let database = in_unit(&of_both, unit, true);
        Self {
            law_terms: terms.map(<[_]>::to_vec),
            unit: unit.clone(),
            ..Self::from_database(Arc::new(database))
        }
    }

    /// The same with an io node that has these outputs besides fan and load.
    fn with_outputs(self, outputs: &[IoOutput]) -> Self {
        let Some(first) = outputs.first() else {
            return self;
        };
        let signals = outputs.iter().map(|output| PlantSignal {
            name: output.name.clone(),
            unit: output.symbol.clone(),
            comment: output.comment.clone(),
            resolution: 1.0 / output.steps_per_unit,
            range: Range {
                minimum: output.range[0],
                maximum: output.range[1],
            },
        });
        let database = (self.database).with_io_outputs(&Vec::from_iter(signals), first.place);
        Self {
            database: Arc::new(database),
            outputs: outputs.to_vec(),
            ..self
        }
    }

    /// The frames of a database, whoever sent them.
    pub(crate) fn from_database(database: Arc<Database>) -> Self {
        Self {
            law_terms: None,
            unit: Unit::Millimetres,
            outputs: Vec::new(),
            database,
            without_truth: OnceLock::new(),
            names: OnceLock::new(),
        }
    }

    /// What the frames mean on a rig, or where these nodes are somebody else's.
    pub(crate) fn database_with(
        &self,
        rig: Option<&LoadedRig>,
        external: &External,
    ) -> Arc<Database> {
        if let Some(rig) = rig {
            let database = match &self.law_terms {
                Some(terms) => &rig.database.with_terms(terms),
                None => &*rig.database,
            };
            let database = in_unit(database, &self.unit, false);
            return Arc::new(database.with_silent_of(&self.database, &TRUTH_MESSAGES));
        }
        if !external.has(ExternalNode::Drive) {
            return Arc::clone(&self.database);
        }
        let silent = || Arc::new(self.database.with_silent(&TRUTH_MESSAGES));
        Arc::clone(self.without_truth.get_or_init(silent))
    }

    /// All names of all signals.
    pub(crate) fn names(&self) -> &SignalNames {
        let make = || SignalNames::new(&self.database, &data_sheet::rig_data_sheets());
        self.names.get_or_init(make)
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

/// The same frames with positions in another unit.
fn in_unit(database: &Database, unit: &Unit, is_emulated: bool) -> Database {
    match unit {
        Unit::Millimetres => database.clone(),
        unit => {
            let resolution = is_emulated.then(|| 1.0 / unit.counts());
            database.with_position_unit(unit.symbol(), resolution, |name| unit.rename(name))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::Kind;

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

    /// A plant whose drive publishes one signal.
    fn plant_with(signal: &str) -> Ports {
        Ports {
            inputs: vec![Port::input("current_amperes", [0.0, 1.0])],
            outputs: ["position_metres", signal]
                .map(|name| Port::output(name, [0.0, 1.0]))
                .into(),
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
        let catalogue = Catalogue::new(|_| Some(plant_with("spring_force_newtons")), |_| None);
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
    fn on_a_rig_the_plant_s_signals_keep_their_names_and_never_have_a_value() {
        let rig = LoadedRig::from_text(
            "schema = 1\nname = \"bench\"\n[limits]\ncurrent_amperes = 0.9\n\
             position_millimetres = { min = -1.0, max = 45.0 }\nspeed_millimetres_per_second = 400.0\n",
        );
        let signals = [signal("a"), signal("b"), signal("c")];
        let frames = Frames::in_unit(Some(&signals), Some(&[sum()]), &Unit::Millimetres);
        let database = frames.database_with(Some(&rig.unwrap()), &External::default());
        let names = SignalNames::new(&database, &data_sheet::rig_data_sheets());
        assert_eq!(names.find("c"), Ok("drive_tpdo3.c"));
        assert_eq!(names.find("sum"), Ok("controller_tpdo1.sum"));
        assert!(names.find("wire_temperature_celsius").is_err());
        let messages = |database: &Database| {
            let names = database.messages().iter().map(|message| &message.name);
            names.cloned().collect::<BTreeSet<_>>()
        };
        assert_eq!(messages(&database), messages(&frames.database));
        for id in [0x290, 0x390, 0x6B0] {
            let frame = canopen::CanFrame::new(id, &[0; 8]);
            assert_eq!(database.message_of(&frame), None, "{id:#x}");
        }
    }

    #[test]
    fn two_signals_of_one_name_are_refused_with_their_owner() {
        let plants = Catalogue::new(|_| Some(plant_with("position_millimetres")), |_| None);
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let said = |catalogue: &Catalogue| {
            let objections = catalogue.objections(&scenario).into_iter();
            Vec::from_iter(objections.map(|one| format!("{}: {}", one.path, one.message)))
        };
        let plants = plants.with_laws(|_| Vec::new(), |_| None);
        let twice = "plant.sma_actuator: two signals are called `position_millimetres`";
        assert_eq!(said(&plants), [twice]);
        let laws = Catalogue::new(|_| Some(plant_with("sum")), |_| None);
        let laws = laws.with_laws(|_| vec![sum()], |_| None);
        let twice = "controller.open_loop: two signals are called `sum`";
        assert_eq!(said(&laws), [twice]);
    }
}
