//! What the frames of the bus mean with the plant and the law of a scenario, and by which names their signals go.

use std::collections::BTreeSet;
use std::sync::{LazyLock, OnceLock};

use controller::catalogue::own_laws;
use dbc::{Database, LawTerm, PlantSignal, Signal};
use plant_emulator::catalogue::{Kind, TRUTH_MESSAGES, kinds};
use scenario::Scenario;

use crate::signal_names::SignalNames;
use crate::signals::COLUMN_MESSAGES;
use crate::tools::data_sheet;

/// The frames with one plant and one law, made when they are asked for.
pub struct Frames {
    plant: &'static Kind,
    /// None for the shipped laws, which share their frames.
    law: Option<&'static str>,
    terms: &'static [LawTerm],
    database: OnceLock<Database>,
    without_truth: OnceLock<Database>,
    names: OnceLock<SignalNames>,
}

impl Frames {
    /// Those of a scenario's plant and law.
    ///
    /// # Panics
    /// Never: the loader refuses plants and laws that are not there.
    #[must_use]
    pub fn of(scenario: &Scenario) -> &'static Self {
        let plant = scenario.plant.name();
        let law = scenario.controller.own.as_ref().map(|own| own.name());
        let mut all = Self::all().iter();
        all.find(|frames| frames.plant.name() == plant && frames.law == law)
            .expect("every pair of a plant and a law has frames")
    }

    /// Those of every pair of a plant and a law.
    fn all() -> &'static [Self] {
        static ALL: LazyLock<Vec<Frames>> = LazyLock::new(|| {
            let own = own_laws().map(|(name, terms)| (Some(name), terms));
            let laws = Vec::from_iter([(None, &[][..])].into_iter().chain(own));
            let with_plant = |plant| {
                let frames = laws.iter().map(move |(law, terms)| Frames {
                    plant,
                    law: *law,
                    terms,
                    database: OnceLock::new(),
                    without_truth: OnceLock::new(),
                    names: OnceLock::new(),
                });
                frames.collect::<Vec<_>>()
            };
            kinds().flat_map(with_plant).collect()
        });
        &ALL
    }

    /// What the frames mean.
    #[must_use]
    pub fn database(&self) -> &Database {
        self.database
            .get_or_init(|| Database::with_plant(self.plant.signals()).with_law(self.terms))
    }

    /// The same beside a drive that is not the emulator: nobody tells the truth.
    #[must_use]
    pub fn without_truth(&self) -> &Database {
        self.without_truth
            .get_or_init(|| self.database().with_silent(&TRUTH_MESSAGES))
    }

    /// All names of all signals.
    #[must_use]
    pub fn names(&self) -> &SignalNames {
        self.names
            .get_or_init(|| SignalNames::new(self.database(), &data_sheet::of_the_rig()))
    }

    /// The plant's own signals.
    #[must_use]
    pub fn plant_signals(&self) -> &'static [PlantSignal] {
        self.plant.signals()
    }

    /// The terms of a law of its own; none for the shipped ones.
    #[must_use]
    pub fn law_terms(&self) -> &'static [LawTerm] {
        self.terms
    }

    /// The first two signals of a pair of plant and law that would be one in `signals.csv`.
    ///
    /// # Errors
    /// Which, in words.
    pub fn check_all() -> Result<(), String> {
        Self::all().iter().try_for_each(|frames| {
            let mut seen = BTreeSet::new();
            match frames.columns().find(|signal| !seen.insert(&signal.name)) {
                None => Ok(()),
                Some(signal) => Err(format!(
                    "with the plant `{}` and the law `{}` two signals are called `{}`",
                    frames.plant.name(),
                    frames.law.unwrap_or("sliding_mode"),
                    signal.name
                )),
            }
        })
    }

    fn columns(&self) -> impl Iterator<Item = &Signal> {
        let database = self.database();
        let messages = COLUMN_MESSAGES.into_iter();
        messages
            .filter_map(|name| database.message(name))
            .flat_map(|message| &message.signals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_of_the_shipped_plants_and_laws_has_a_name_of_its_own() {
        assert_eq!(Frames::check_all(), Ok(()));
    }

    #[test]
    fn a_plant_s_frames_are_its_own() {
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let parse = |plant: &str| {
            let text = format!("{text}{plant}");
            Scenario::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap()
        };
        let actuator = Frames::of(&parse(""));
        assert_eq!(actuator.database(), Database::shipped());
        let motor = Frames::of(&parse("[plant.dc_motor]\n"));
        assert!(motor.names().find("spring_force_newtons").is_ok());
        assert!(motor.names().find("martensite_fraction").is_err());
        assert!(motor.law_terms().is_empty());
    }
}
