//! The plants and laws that a bench knows, and what each pair of them puts on the bus.

use std::collections::BTreeSet;
use std::sync::{Arc, OnceLock};

use dbc::{Database, LawTerm, PlantSignal, Signal};
use scenario::plant::SMA_ACTUATOR;
use scenario::{Objection, Scenario};

use crate::data_sheet;
use crate::external::{External, ExternalNode};
use crate::signal_names::SignalNames;
use dbc::signals::{COLUMN_MESSAGES, TRUTH_MESSAGES};

/// The plants and laws that scenarios may choose.
///
/// It knows them by what they put on the bus, not by their code: who plays them hands in the rest.
pub struct Catalogue {
    frames: Vec<Arc<Frames>>,
    plant_objection: fn(&Scenario) -> Option<Objection>,
}

impl Catalogue {
    /// The plants and the laws from outside, each by its name with what it says on the bus; the shipped laws share their
    /// frames. `plant_objection` says why a scenario's plant makes no physical sense.
    #[must_use]
    pub fn new<'a>(
        plants: impl Iterator<Item = (&'a str, &'a [PlantSignal])>,
        own_laws: impl Iterator<Item = (&'a str, &'a [LawTerm])>,
        plant_objection: fn(&Scenario) -> Option<Objection>,
    ) -> Self {
        let shipped = (None, &[][..]);
        let own = own_laws.map(|(name, terms)| (Some(name), terms));
        let laws = Vec::from_iter([shipped].into_iter().chain(own));
        let frames = plants.flat_map(|(plant, signals)| {
            let pairs = laws
                .iter()
                .map(move |(law, terms)| Arc::new(Frames::new(plant, signals, *law, terms)));
            pairs.collect::<Vec<_>>()
        });
        Self {
            frames: frames.collect(),
            plant_objection,
        }
    }

    /// The SMA actuator under the shipped laws, by the DBC that ships: enough to read its recordings without any plant's code.
    #[must_use]
    pub fn shipped() -> Self {
        let frames = Frames {
            plant: SMA_ACTUATOR.to_owned(),
            law: None,
            law_terms: Vec::new(),
            database: Arc::new(Database::shipped().clone()),
            without_truth: OnceLock::new(),
            names: OnceLock::new(),
        };
        Self {
            frames: vec![Arc::new(frames)],
            plant_objection: |_| None,
        }
    }

    /// What a scenario's plant and law put on the bus.
    ///
    /// # Panics
    /// Never: the loader refuses plants and laws that are not there.
    #[must_use]
    pub fn frames(&self, scenario: &Scenario) -> &Arc<Frames> {
        let plant = scenario.plant.name();
        let law = scenario.controller.own.as_ref().map(|own| own.name());
        let mut all = self.frames.iter();
        all.find(|frames| frames.plant == plant && frames.law.as_deref() == law)
            .expect("every pair of a plant and a law has frames")
    }

    /// What only a bench knows to be wrong in a scenario: names of signals, and a plant that makes no physical sense. The
    /// names are collected only where the scenario has some.
    #[must_use]
    pub fn objections(&self, scenario: &Scenario) -> Vec<Objection> {
        let names = || self.frames(scenario).names();
        let mut objections = SignalNames::objections(scenario, names);
        objections.extend((self.plant_objection)(scenario));
        objections
    }

    /// Refuses a pair of a plant and a law with two signals that would be one column of `signals.csv`.
    ///
    /// # Errors
    /// The first two of them, in words.
    pub fn check(&self) -> Result<(), String> {
        self.frames.iter().try_for_each(|frames| frames.check())
    }
}

/// What one plant and one law put on the bus.
#[derive(Debug)]
pub struct Frames {
    plant: String,
    /// None for the shipped laws, which share their frames.
    law: Option<String>,
    /// The terms of a law from outside; none for the shipped ones.
    pub(crate) law_terms: Vec<LawTerm>,
    /// What the frames mean.
    pub(crate) database: Arc<Database>,
    /// The same beside a drive that is not the emulator: nobody publishes the truth.
    without_truth: OnceLock<Arc<Database>>,
    names: OnceLock<SignalNames>,
}

impl Frames {
    fn new(plant: &str, signals: &[PlantSignal], law: Option<&str>, terms: &[LawTerm]) -> Self {
        Self {
            plant: plant.to_owned(),
            law: law.map(str::to_owned),
            law_terms: terms.to_vec(),
            database: Arc::new(Database::with_plant(signals).with_law(terms)),
            without_truth: OnceLock::new(),
            names: OnceLock::new(),
        }
    }

    /// What the frames mean where these nodes are somebody else's.
    pub(crate) fn database_with(&self, external: &External) -> Arc<Database> {
        if !external.has(ExternalNode::Drive) {
            return Arc::clone(&self.database);
        }
        let silent = || Arc::new(self.database.with_silent(&TRUTH_MESSAGES));
        Arc::clone(self.without_truth.get_or_init(silent))
    }

    /// All names of all signals.
    pub(crate) fn names(&self) -> &SignalNames {
        let make = || SignalNames::new(&self.database, &data_sheet::of_the_rig());
        self.names.get_or_init(make)
    }

    fn check(&self) -> Result<(), String> {
        let mut seen = BTreeSet::new();
        match self.columns().find(|signal| !seen.insert(&signal.name)) {
            None => Ok(()),
            Some(signal) => Err(format!(
                "with the plant `{}` and the law `{}` two signals are called `{}`",
                self.plant,
                self.law.as_deref().unwrap_or("sliding_mode"),
                signal.name
            )),
        }
    }

    fn columns(&self) -> impl Iterator<Item = &Signal> {
        let messages = COLUMN_MESSAGES.into_iter();
        messages
            .filter_map(|name| self.database.message(name))
            .flat_map(|message| &message.signals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::Range;

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

    #[test]
    fn the_pairs_of_plants_and_laws_have_frames_of_their_own() {
        let motor = [signal("spring_force_newtons")];
        let plants = [("sma_actuator", &[][..]), ("dc_motor", &motor[..])];
        let term = LawTerm {
            name: "sum".to_owned(),
            unit: String::new(),
            comment: String::new(),
        };
        let terms = [term];
        let laws = [("mine", &terms[..])];
        let catalogue = Catalogue::new(plants.into_iter(), laws.into_iter(), |_| None);
        assert_eq!(catalogue.frames.len(), 4);
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n[plant.dc_motor]\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let frames = catalogue.frames(&scenario);
        assert!(frames.names().find("spring_force_newtons").is_ok());
        assert!(frames.names().find("sum").is_err());
        assert!(frames.law_terms.is_empty());
    }

    #[test]
    fn two_signals_of_one_name_are_refused() {
        let double = [signal("position_millimetres")];
        let plants = [("mine", &double[..])];
        let catalogue = Catalogue::new(plants.into_iter(), [].into_iter(), |_| None);
        let refused = "with the plant `mine` and the law `sliding_mode` two signals are called `position_millimetres`";
        assert_eq!(catalogue.check(), Err(refused.to_owned()));
    }
}
