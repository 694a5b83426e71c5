//! Makes plans from files: scenarios of one loop and of several, rig files, recordings.

use std::collections::BTreeSet;
use std::io;
use std::path::Path;
use std::sync::Arc;

use dbc::{Database, Ports};
use scenario::node::NodeIndex;
use scenario::wiring::IoOutput;
use scenario::{Asked, Beside, Objection, Reading, Scenario, ScenarioError, Trial, text_of};

use super::{ControlLoop, Plan};
use crate::bus_budget::BusBudget;
use crate::catalogue::{Catalogue, Frames, Published, output_objection, two_columns};
use crate::loaded_drive::LoadedDrive;
use crate::ports;
use crate::signal_names::SignalNames;

impl Plan {
    /// Reads and checks a scenario file and the files that it names.
    ///
    /// # Errors
    /// A file cannot be read or is not valid.
    pub fn load(path: &Path, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        Self::parse_beside(&Beside::new(path), text_of(path)?, catalogue)
    }

    /// Parses as [`Plan::load`], from a text; the files that it names are in its folder.
    ///
    /// # Errors
    /// As [`Plan::load`].
    pub fn parse_beside(
        beside: &Beside,
        text: String,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        Self::parse(beside, text, |name| beside.read(name), catalogue)
    }

    /// Parses as [`Plan::parse_beside`], with files that `read_file` returns by their names.
    ///
    /// # Errors
    /// As [`Plan::load`].
    pub fn parse(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let asked = Asked {
            objections: Some(&|trial| catalogue.objections(trial)),
            ..Asked::default()
        };
        let scenario = Scenario::parse(beside, text, &mut read_file, &asked)?;
        let plan = planned(&scenario, catalogue)?;
        match plan.unknown_signal() {
            Some(objection) => Err(scenario.objected(objection)),
            None => Ok(plan),
        }
    }

    /// Finds a name of no signal of the bus, or of several, in the expectations of a rig without loops.
    fn unknown_signal(&self) -> Option<Objection> {
        let mut named = self.shared.run.expect.named_signals();
        named.find_map(|(path, name)| {
            let messages = self.database.messages().iter();
            let paths = messages.flat_map(|message| {
                let signals = message.signals.iter();
                signals
                    .map(move |signal| (&signal.name, format!("{}.{}", message.name, signal.name)))
            });
            let is_meant = |(signal, path): &(&String, String)| {
                signal.eq_ignore_ascii_case(name) || path.eq_ignore_ascii_case(name)
            };
            let found = Vec::from_iter(paths.filter(is_meant).map(|(_, path)| path));
            let (message, label) = match found.len() {
                0 => (
                    format!("no signal is called `{name}`"),
                    "not on the bus".to_owned(),
                ),
                1 => return None,
                count => {
                    let message = format!("`{name}` is the name of {count} signals");
                    (message, format!("it may be {}", found.join(", ")))
                }
            };
            Some(Objection::new(path, message, label))
        })
    }

    /// Parses as [`Plan::parse`], but accepts names of unknown signals in the scenario.
    ///
    /// # Errors
    /// As [`Plan::parse`] for everything else.
    pub fn parse_with_any_signals(
        beside: &Beside,
        text: String,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let scenario = Scenario::parse(beside, text, &mut read_file, &Asked::default())?;
        planned(&scenario, catalogue)
    }

    /// Makes the plan of a rig file without a trial.
    ///
    /// # Errors
    /// The rig file is not valid.
    pub fn from_rig(path: &Path, text: &str, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        let scenario = Scenario::from_rig(text, &path.display().to_string())?;
        planned(&scenario, catalogue)
    }

    /// Reads the scenario of a recording, whose frames have the meaning of its database. Plants and laws need not be known here.
    ///
    /// # Errors
    /// A file cannot be read or is not valid.
    pub fn load_recorded(path: &Path, database: &Arc<Database>) -> Result<Self, ScenarioError> {
        let asked = Asked {
            reading: Reading::Recorded,
            objections: Some(&|trial| recorded_objections(trial, database)),
        };
        let beside = Beside::new(path);
        // Hashes come from the recording.
        let read = &mut |name: &str| beside.read_text(name);
        let scenario = Scenario::parse(&beside, text_of(path)?, read, &asked)?;
        let one = |trial| ControlLoop::from_recording(trial, database);
        let plan = named(&scenario, one).map_err(|objection| scenario.objected(objection))?;
        Ok(plan.with_database(database))
    }

    /// Makes the plan of another scenario with the same plants and laws. The meaning of the frames is shared, unless a value of the
    /// rig has another one.
    ///
    /// # Errors
    /// All problems of the text and its files, a value that an FMU does not take or an output does not have, and a rig whose frames
    /// do not fit on its bus.
    pub fn varied(
        &self,
        text: &str,
        mut read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        // Files that are not text are in the folder of the scenario that is varied.
        let beside = self.shared.beside.for_case();
        let objections = |trial: &Trial| {
            if self.has_frames_of(trial) {
                return Vec::new();
            }
            catalogue.objections(trial)
        };
        let asked = Asked {
            reading: Reading::Case,
            objections: Some(&objections),
        };
        let scenario = Scenario::parse(&beside, text.to_owned(), &mut read_file, &asked)?;
        if let Some(objection) = wrong_start_value(&scenario, catalogue) {
            return Err(scenario.objected(objection));
        }
        let mut trials = scenario.loops.iter();
        // A real drive keeps values of its node.
        let has_real = self.loops.iter().any(|one| one.real_drive.is_some());
        let is_alike = !has_real && scenario.shared.run.bus == self.shared.run.bus;
        if !is_alike || !trials.all(|trial| self.has_frames_of(trial)) {
            return planned(&scenario, catalogue);
        }
        if let Some(objection) = output_objection(self, &scenario.shared.run.disturbance) {
            return Err(scenario.objected(objection));
        }
        let mut plan = Self {
            shared: scenario.shared,
            nodes: scenario.nodes,
            loops: self.loops.clone(),
            database: Arc::clone(&self.database),
            io: self.io.clone(),
        };
        for (one, trial) in plan.loops.iter_mut().zip(scenario.loops) {
            one.trial = trial;
        }
        let are_sent = |plan: &Self| plan.set_points_every_cycles().is_some();
        let is_same = are_sent(&plan) == are_sent(self);
        Ok(if is_same { plan } else { plan.composed() })
    }

    /// Checks whether the frames of a loop have the same meaning in a varied trial of that loop. Plants and laws from outside may
    /// have other ports with each parameter.
    fn has_frames_of(&self, trial: &Trial) -> bool {
        let mut loops = self.loops.iter().map(|one| &one.trial);
        let Some(before) = loops.find(|one| one.wiring == trial.wiring) else {
            return false;
        };
        let [ours, others] = [before, trial].map(|one| one.plants.values().map(|one| &one.custom));
        ours.eq(others) && before.controller.custom == trial.controller.custom
    }
}

/// Makes the plan of a scenario.
///
/// # Errors
/// A problem of the rig: a drive that cannot be led, nodes that send the same frame, a cycle that is too short.
fn planned(scenario: &Scenario, catalogue: &Catalogue) -> Result<Plan, ScenarioError> {
    let plan = match ports::objection(scenario, catalogue) {
        Some(objection) => Err(objection),
        None => composed(scenario, catalogue),
    };
    plan.map_err(|objection| scenario.objected(objection))
}

/// Finds a value that an FMU does not take.
fn wrong_start_value(scenario: &Scenario, catalogue: &Catalogue) -> Option<Objection> {
    let with_fmus = scenario.loops.iter().filter(|one| one.has_fmu());
    let mut plants = with_fmus.flat_map(|one| &one.plants);
    let found = plants.find_map(|(name, plant)| catalogue.objection_to_plant(name, plant, None));
    // A file that no longer exists is not the fault of a value.
    found.filter(|objection| objection.path.contains(".fmu.start."))
}

/// Refuses a rig whose cycle is too short for its frames.
fn refuse_short_cycle(budget: &BusBudget) -> Result<(), Objection> {
    if budget.fits() {
        return Ok(());
    }
    let way_out = match budget.period_milliseconds_min() {
        Some(period) => format!(
            "write sync_period_milliseconds = {period:.1} into [bus], or publish the truth less often (truth_every_cycles), or the set-points (set_points_every_cycles)"
        ),
        None => "no period would do: raise bitrate_kilobits_per_second in [bus]".to_owned(),
    };
    let load = budget.load_percent();
    let label = if load > 100.0 {
        format!("they need {budget}, and {load:.0} % of the bus over many cycles")
    } else {
        format!("they need {budget}")
    };
    let message = "the frames of this rig do not fit between two SYNCs";
    let objection = Objection::new("bus.sync_period_milliseconds", message, label);
    let fullest = budget.fullest_cycle();
    Err(objection.with_help(format!("{way_out}; bits in the fullest cycle: {fullest}")))
}

/// Makes the plan of the loops of a rig, each with the frames of the whole bus, which must fit there.
fn composed(scenario: &Scenario, catalogue: &Catalogue) -> Result<Plan, Objection> {
    let alone = |trial: Trial| {
        let frames = catalogue.frames(&trial);
        ControlLoop::with_frames(trial, frames)
    };
    let mut plan = named(scenario, alone)?;
    plan.io = io_outputs(scenario, catalogue);
    let mut loops = plan.loops.iter();
    let objection = loops.find_map(|one| two_columns(&one.frames));
    match objection.or_else(|| output_objection(&plan, &plan.shared.run.disturbance)) {
        Some(objection) => Err(objection),
        None => checked(plan.composed()),
    }
}

/// Returns the io nodes of a rig, each with its outputs on the ports of its plants.
fn io_outputs(scenario: &Scenario, catalogue: &Catalogue) -> Vec<(NodeIndex, Vec<IoOutput>)> {
    let io = scenario.wiring.io.iter().map(|io| {
        let plants = BTreeSet::from_iter(io.plants());
        let plants = scenario.plants().filter(|(name, _)| plants.contains(name));
        let ports = plants.map(|(name, plant)| Some((name, catalogue.plant_ports(&plant)?)));
        let ports = ports.collect::<Option<Vec<_>>>().map(Ports::joined);
        (io.node, io.outputs(&ports.unwrap_or_default()))
    });
    io.collect()
}

/// Refuses a plan of which two messages have one name or one identifier, or whose frames do not fit on its bus.
pub(super) fn checked(plan: Plan) -> Result<Plan, Objection> {
    plan.database().refuse_duplicates().map_err(|error| {
        let message = "two messages of this rig have one name or one identifier";
        let help = "name a node or a loop differently, or give one of the nodes another node-ID or, in its EDS, another COB-ID";
        Objection::new("node", message, error.to_string()).with_help(help)
    })?;
    refuse_short_cycle(&BusBudget::new(&plan))?;
    Ok(plan)
}

/// Finds names of signals in a scenario that its recording does not have. An external drive has no truth.
fn recorded_objections(trial: &Trial, database: &Arc<Database>) -> Vec<Objection> {
    let wiring = &trial.wiring;
    let drive = &wiring.drive().name;
    if database.plant_messages(drive).next().is_none() {
        return Vec::new();
    }
    let frames = Frames::new(Published::default(), Arc::clone(database), wiring);
    SignalNames::objections(trial, &frames)
}

/// Makes the plan of loops that `make` makes, each with its real drive.
fn named(scenario: &Scenario, make: impl Fn(Trial) -> ControlLoop) -> Result<Plan, Objection> {
    let rig = &scenario.shared.rig;
    let loops = scenario.loops.iter().map(|trial| {
        let drive = &trial.wiring.drive().name;
        let load = |real| LoadedDrive::new(real, scenario.sheets.get(drive)).map(Arc::new);
        let real_drive = rig.real_drive(drive).map(load).transpose();
        Ok(ControlLoop {
            real_drive: real_drive.map_err(|error| {
                let message = format!("the drive `{drive}` cannot be led");
                Objection::new(format!("node.{drive}"), message, error.to_string())
            })?,
            ..make(trial.clone())
        })
    });
    Ok(Plan {
        shared: scenario.shared.clone(),
        nodes: scenario.nodes.clone(),
        loops: loops.collect::<Result<_, _>>()?,
        database: Arc::default(),
        io: Vec::new(),
    })
}

#[cfg(test)]
mod tests;
