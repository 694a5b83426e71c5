//! Makes plans of files: scenarios of one loop and of several, rig files, recordings.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;

use dbc::Database;
use dbc::loops::LoopPlace;
use scenario::loops::{Loops, OneLoop};
use scenario::rig::nodes::Rig;
use scenario::{Beside, Objection, Scenario, ScenarioError, Texts, text_of};

use super::{ControlLoop, LoopName, Plan};
use crate::bus_budget::BusBudget;
use crate::catalogue::Catalogue;
use crate::external::External;
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

    /// As [`Plan::load`], with signals in the scenario that nobody sends: whoever looks for the right name has a wrong one in
    /// the file.
    ///
    /// # Errors
    /// As [`Plan::load`] for everything else.
    pub fn load_with_any_signals(
        path: &Path,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let beside = Beside::new(path);
        let read = |name: &str| beside.read(name);
        let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
        let none = |_: &Scenario| Vec::new();
        let (loops, texts) = Loops::parse(&beside, text_of(path)?, read, none, object)?;
        Ok(Self::of_texts(loops, &beside, texts, catalogue))
    }

    /// As [`Plan::load`], for a text that is at hand; the files that it names lie beside it.
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

    /// As [`Plan::parse_beside`], for files that `read_file` gives by their names.
    ///
    /// # Errors
    /// As [`Plan::load`].
    pub fn parse(
        beside: &Beside,
        text: String,
        read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let objections = |scenario: &Scenario| catalogue.objections(scenario);
        let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
        let (loops, texts) = Loops::parse(beside, text, read_file, objections, object)?;
        Ok(Self::of_texts(loops, beside, texts, catalogue))
    }

    /// The plan of a rig file in which nothing is tried.
    ///
    /// # Errors
    /// It is not valid.
    pub fn of_rig(path: &Path, text: &str, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        let object = |loops: &Loops<Scenario>| planned(loops.clone(), catalogue).err();
        let loops = Loops::of_rig(text, &path.display().to_string(), object)?;
        let beside = Beside::new(path);
        Ok(Self::of_texts(loops, &beside, Texts::default(), catalogue))
    }

    /// Reads the scenario of a recording, whose frames mean what the database says. Plants and laws need not be known here.
    /// `external` are the nodes that were somebody else's.
    ///
    /// # Errors
    /// A file cannot be read or is not valid.
    pub fn load_recorded(
        path: &Path,
        database: &Arc<Database>,
        external: &[String],
    ) -> Result<Self, ScenarioError> {
        let recorded = |loops: Loops<Scenario>| {
            named(loops, |scenario| {
                ControlLoop::of_recording(scenario, database)
            })
        };
        let object = |loops: &Loops<Scenario>| recorded(loops.clone()).err();
        let objections = |scenario: &Scenario| recorded_objections(scenario, database);
        let beside = Beside::new(path);
        let text = text_of(path)?;
        let (loops, texts) = Loops::parse_recorded(&beside, text, objections, object)?;
        let plan = recorded(loops).expect("a rig without objections");
        Ok(plan.recorded_external(external).with_texts(&beside, texts))
    }

    /// The plan of another scenario on the same rig, with the same plants and laws: they share what the frames mean.
    ///
    /// # Errors
    /// Everything that is wrong in the text and its files, and a value that an FMU does not take.
    pub fn varied(
        &self,
        text: &str,
        read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let object = |loops: &Loops<Scenario>| {
            let mut scenarios = loops.loops.iter().map(|one| &one.scenario);
            let found = scenarios.find_map(|one| catalogue.fmu_objection(one, &one.wiring.plant));
            // That the file is not there any more is no value's fault.
            found.filter(|objection| objection.path.contains(".fmu.start."))
        };
        // Files that are no text lie beside the scenario that is varied.
        let beside = self.shared.beside.of_case();
        let loops = Loops::parse_case(&beside, text.to_owned(), read_file, object)?;
        let varied = self.loops.iter().zip(loops.loops);
        let varied = varied.map(|(base, one)| base.varied(one.scenario));
        let nodes = self.shared.nodes_of_loops.clone();
        let mut plan = Self::of_loops(varied.collect(), loops.contours, nodes);
        plan.shared.rig = Arc::new(loops.rig);
        Ok(plan)
    }

    /// The plan of loops that were found to be without objections.
    fn of_texts(
        loops: Loops<Scenario>,
        beside: &Beside,
        texts: Texts,
        catalogue: &Catalogue,
    ) -> Self {
        let plan = planned(loops, catalogue);
        plan.expect("a rig without objections")
            .with_texts(beside, texts)
    }
}

/// Checks the text of a rig file on which nothing is tried, and computes what it needs of the bus under the shipped laws.
///
/// # Errors
/// It is not valid, or the frames do not fit between two SYNCs.
pub fn check_rig(
    text: &str,
    name: &str,
    catalogue: &Catalogue,
) -> Result<(Rig, BusBudget), ScenarioError> {
    let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
    let loops = Loops::of_rig(text, name, object)?;
    let plan = planned(loops.clone(), catalogue).expect("a rig without objections");
    let budget = BusBudget::new(&plan);
    Ok((loops.rig, budget))
}

/// What is wrong with a rig: a drive that cannot be led, nodes that send the same, a cycle that is too short.
fn objection(loops: &Loops<Scenario>, catalogue: &Catalogue) -> Option<Objection> {
    if let Some(objection) = ports::objection(loops, catalogue) {
        return Some(objection);
    }
    match planned(loops.clone(), catalogue) {
        Ok(plan) => does_not_fit(&BusBudget::new(&plan)),
        Err(objection) => Some(objection),
    }
}

/// A rig whose cycle is too short for its frames.
fn does_not_fit(budget: &BusBudget) -> Option<Objection> {
    if budget.fits() {
        return None;
    }
    let way_out = match budget.period_milliseconds_min() {
        Some(period) => format!(
            "write sync_period_milliseconds = {period:.1} into [bus], or publish the truth less often (truth_every_cycles)"
        ),
        None => "no period would do: raise bitrate_kilobits_per_second in [bus]".to_owned(),
    };
    Some(Objection {
        path: "bus.sync_period_milliseconds".to_owned(),
        message: "the frames of this rig do not fit between two SYNCs".to_owned(),
        label: match budget.load_percent() > 100.0 {
            false => format!("they need {budget}"),
            true => format!(
                "they need {budget}, and {:.0} % of the bus over many cycles",
                budget.load_percent()
            ),
        },
        help: Some(format!(
            "{way_out}; bits in the fullest cycle: {}",
            budget.fullest_cycle()
        )),
    })
}

/// The plan of the loops of a rig, each with the frames of the whole bus.
fn planned(loops: Loops<Scenario>, catalogue: &Catalogue) -> Result<Plan, Objection> {
    let alone = |scenario: Scenario| {
        let frames = catalogue.frames(&scenario);
        ControlLoop::with_frames(scenario, frames)
    };
    let plan = named(loops, alone)?.composed();
    match plan.database().refuse_duplicates() {
        Err(error) => Err(Objection {
            path: "node".to_owned(),
            message: "two nodes of this rig send under one identifier".to_owned(),
            label: error.to_string(),
            help: Some(
                "give one of them another node-ID or, in its EDS, another COB-ID".to_owned(),
            ),
        }),
        Ok(()) => Ok(plan),
    }
}

/// The names of signals in a scenario that its recording does not have. Of an external drive the truth is missing.
fn recorded_objections(scenario: &Scenario, database: &Arc<Database>) -> Vec<Objection> {
    let wiring = &scenario.wiring;
    let drive = &wiring.nodes.drive.name;
    if database.plant_messages(drive).next().is_none() {
        return Vec::new();
    }
    let name = wiring.loop_among_several();
    let names = OnceCell::new();
    let make = || SignalNames::new(database, &wiring.nodes, name);
    SignalNames::objections(scenario, || names.get_or_init(make))
}

/// The drive of a loop, if it is a real one.
fn real_drive<T>(loops: &Loops<T>, name: &str) -> Result<Option<Arc<LoadedDrive>>, Objection> {
    let drive = loops.rig.drive_of_loop(name);
    let Some(real) = loops.rig.real_drive(drive) else {
        return Ok(None);
    };
    let loaded = LoadedDrive::new(real, loops.sheets.get(drive));
    let loaded = loaded.map_err(|error| Objection {
        path: format!("node.{drive}"),
        message: format!("the drive `{drive}` cannot be led"),
        label: error.to_string(),
        help: None,
    })?;
    Ok(Some(Arc::new(loaded)))
}

/// The plan of loops that `make` makes, each with its name, its place and its real drive.
fn named(
    loops: Loops<Scenario>,
    make: impl Fn(Scenario) -> ControlLoop,
) -> Result<Plan, Objection> {
    let drives = loops.loops.iter();
    let drives = drives.map(|one| real_drive(&loops, &one.name));
    let drives = drives.collect::<Result<Vec<_>, _>>()?;
    let Loops {
        rig,
        loops,
        contours,
        ..
    } = loops;
    let is_only = loops.len() == 1;
    let several = loops.iter().filter(|_| !is_only);
    let nodes_of_loops = several.map(|one| (one.name.clone(), one.scenario.wiring.nodes.clone()));
    let nodes_of_loops = BTreeMap::from_iter(nodes_of_loops);
    let mut external = External::default();
    let others = rig.node.values().filter(|node| node.external);
    others.for_each(|node| external.insert(node.node_id));
    let loops = (0..).zip(loops).zip(drives);
    let loops = loops.map(|((number, one), real_drive)| {
        let OneLoop {
            name,
            place,
            scenario,
        } = one;
        let loop_name = (!is_only).then(|| LoopName {
            plant: rig.plant_of_loop(&name).to_owned(),
            name: name.clone(),
        });
        ControlLoop {
            loop_name,
            real_drive,
            external: external.clone(),
            place: LoopPlace {
                number,
                drive_node_id: place.drive,
                disturbance_node_id: place.io,
                truth_every_cycles: place.truth_every_cycles,
            },
            ..make(scenario)
        }
    });
    let loops = loops.collect();
    let mut plan = Plan::of_loops(loops, contours, nodes_of_loops);
    plan.shared.rig = Arc::new(rig);
    Ok(plan)
}

#[cfg(test)]
mod tests;
