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
use scenario::{Objection, Scenario, ScenarioError, Texts, read_text};

use super::{ControlLoop, LoopName, Plan};
use crate::FILE_BYTES_MAX;
use crate::bus_budget::BusBudget;
use crate::catalogue::Catalogue;
use crate::external::External;
use crate::ports;
use crate::rig_file::LoadedRig;
use crate::signal_names::SignalNames;

/// Whether the text of a scenario is one that names its rig.
#[must_use]
pub fn may_name_rig(text: &str) -> bool {
    Loops::is_meant(text)
}

impl Plan {
    /// Reads and checks a scenario file and the files that it names.
    ///
    /// # Errors
    /// A file cannot be read or is not valid.
    pub fn load(path: &Path, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        match read_text(path, FILE_BYTES_MAX) {
            Ok(text) => Self::parse_beside(path, text, catalogue),
            // The loader says why.
            Err(_) => Scenario::load(path).map(|scenario| Self::new(scenario, catalogue)),
        }
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
        let text = read_text(path, FILE_BYTES_MAX).unwrap_or_default();
        if !may_name_rig(&text) {
            return Scenario::load(path).map(|scenario| Self::new(scenario, catalogue));
        }
        let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
        let (loops, texts) = Loops::load(path, |_| Vec::new(), object)?;
        Ok(Self::of_texts(loops, path, texts, catalogue))
    }

    /// As [`Plan::load`], for a text that is at hand; the files that it names lie beside `path`.
    ///
    /// # Errors
    /// As [`Plan::load`].
    pub fn parse_beside(
        path: &Path,
        text: String,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let objections = |scenario: &Scenario| catalogue.objections(scenario);
        if may_name_rig(&text) {
            let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
            let (loops, texts) = Loops::parse_beside(path, text, objections, object)?;
            return Ok(Self::of_texts(loops, path, texts, catalogue));
        }
        let (scenario, texts) = Scenario::parse_beside(path, text, objections)?;
        Ok(Self::new(scenario, catalogue).with_texts(path, texts))
    }

    /// As [`Plan::parse_beside`], for files that `read_file` gives by their names.
    ///
    /// # Errors
    /// As [`Plan::load`].
    pub fn parse(
        path: &Path,
        text: String,
        read_file: impl FnMut(&str) -> io::Result<String>,
        catalogue: &Catalogue,
    ) -> Result<Self, ScenarioError> {
        let objections = |scenario: &Scenario| catalogue.objections(scenario);
        if may_name_rig(&text) {
            let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
            let (loops, texts) = Loops::parse(path, text, read_file, objections, object)?;
            return Ok(Self::of_texts(loops, path, texts, catalogue));
        }
        let (scenario, texts) = Scenario::parse_with(path, text, read_file, objections)?;
        Ok(Self::new(scenario, catalogue).with_texts(path, texts))
    }

    /// The plan of a rig file in which nothing is tried.
    ///
    /// # Errors
    /// It is not valid.
    pub fn of_rig(path: &Path, text: &str, catalogue: &Catalogue) -> Result<Self, ScenarioError> {
        let object = |loops: &Loops<Scenario>| planned(loops.clone(), catalogue).err();
        let loops = Loops::of_rig(text, &path.display().to_string(), object)?;
        Ok(Self::of_texts(loops, path, Texts::default(), catalogue))
    }

    /// The plan of a rig with a drive of its own, on which nothing is tried.
    #[must_use]
    pub fn of_loaded_rig(rig: LoadedRig) -> Self {
        let text = "schema = 1\nname = \"a rig\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let no_table = |_: &str| Err(io::ErrorKind::NotFound.into());
        let scenario = Scenario::parse(text, "a rig", no_table);
        let scenario = scenario.expect("this scenario is valid");
        let only = ControlLoop::of_recording(scenario, &rig.database);
        Self::of_one(only).recorded_on(&Arc::new(rig))
    }

    /// Reads the scenario of a recording, whose frames mean what the database says. Plants and laws need not be known here.
    /// `external` are the nodes of a scenario with a rig that were somebody else's.
    ///
    /// # Errors
    /// A file cannot be read or is not valid.
    pub fn load_recorded(
        path: &Path,
        database: &Arc<Database>,
        external: &[String],
    ) -> Result<Self, ScenarioError> {
        let text = read_text(path, FILE_BYTES_MAX).unwrap_or_default();
        if may_name_rig(&text) {
            return loops_of_recording(path, database, external);
        }
        let objections = |scenario: &Scenario| recorded_objections(scenario, database);
        let (scenario, texts) = Scenario::load_recorded(path, objections)?;
        let only = ControlLoop::of_recording(scenario, database);
        Ok(Self::of_one(only).with_texts(path, texts))
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
        if !self.names_rig() {
            let scenario = Scenario::parse(text, "case", read_file)?;
            return Ok(Self::new(scenario, catalogue));
        }
        let object = |loops: &Loops<Scenario>| {
            let mut scenarios = loops.loops.iter().map(|one| &one.scenario);
            let found = scenarios.find_map(|one| catalogue.fmu_objection(one, &one.wiring.plant));
            // That the file is not there any more is no value's fault.
            found.filter(|objection| objection.path.contains(".fmu.start."))
        };
        // Files that are no text lie beside the scenario that is varied.
        let path = self.shared.path.with_file_name("case");
        let (loops, _) = Loops::parse(&path, text.to_owned(), read_file, |_| Vec::new(), object)?;
        let varied = self.loops.iter().zip(loops.loops);
        let varied = varied.map(|(base, one)| base.varied(one.scenario));
        let nodes = self.shared.nodes_of_loops.clone();
        Ok(Self::of_loops(varied.collect(), loops.contours, nodes))
    }

    /// The plan of loops that were found to be without objections.
    fn of_texts(loops: Loops<Scenario>, path: &Path, texts: Texts, catalogue: &Catalogue) -> Self {
        let plan = planned(loops, catalogue);
        plan.expect("a rig without objections")
            .with_texts(path, texts)
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
    let budget = BusBudget::new(&loops.rig, &plan);
    Ok((loops.rig, budget))
}

/// Reads the loops of a recording with a rig. The database is as the first loop sees it.
fn loops_of_recording(
    path: &Path,
    database: &Arc<Database>,
    external: &[String],
) -> Result<Plan, ScenarioError> {
    let recorded = |loops: Loops<Scenario>| {
        named(loops, |scenario| {
            ControlLoop::of_recording(scenario, database)
        })
    };
    let object = |loops: &Loops<Scenario>| recorded(loops.clone()).err();
    let objections = |scenario: &Scenario| recorded_objections(scenario, database);
    let (loops, texts) = Loops::load_recorded(path, objections, object)?;
    let plan = recorded(loops).expect("a rig without objections");
    Ok(plan.recorded_external(external).with_texts(path, texts))
}

/// What is wrong with a rig: a drive that cannot be led, nodes that send the same, a cycle that is too short.
fn objection(loops: &Loops<Scenario>, catalogue: &Catalogue) -> Option<Objection> {
    if let Some(objection) = ports::objection(loops, catalogue) {
        return Some(objection);
    }
    match planned(loops.clone(), catalogue) {
        Ok(plan) => does_not_fit(&BusBudget::new(&loops.rig, &plan)),
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

/// The rig of the drive of a loop, where that is external.
fn own_rig<T>(loops: &Loops<T>, name: &str) -> Result<Option<Arc<LoadedRig>>, Objection> {
    let drive = loops.rig.drive_of_loop(name);
    let Some(file) = loops.rig.rig_file_of(drive) else {
        return Ok(None);
    };
    let loaded = LoadedRig::of_node(Path::new(drive), file, loops.sheets.get(drive));
    let loaded = loaded.map_err(|error| Objection {
        path: format!("node.{drive}"),
        message: format!("the drive `{drive}` cannot be led"),
        label: error.to_string(),
        help: None,
    })?;
    Ok(Some(Arc::new(loaded)))
}

/// The plan of loops that `make` makes, each with its name and its place, on the rig of its external drive.
fn named(
    loops: Loops<Scenario>,
    make: impl Fn(Scenario) -> ControlLoop,
) -> Result<Plan, Objection> {
    let rigs = loops.loops.iter();
    let rigs = rigs.map(|one| own_rig(&loops, &one.name));
    let rigs = rigs.collect::<Result<Vec<_>, _>>()?;
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
    let loops = (0..).zip(loops).zip(rigs);
    let loops = loops.map(|((number, one), own_rig)| {
        let OneLoop {
            name,
            place,
            scenario,
        } = one;
        let loop_name = (!is_only).then(|| LoopName {
            plant: rig.plant_of_loop(&name).to_owned(),
            name: name.clone(),
        });
        let one = ControlLoop {
            loop_name,
            external: external.clone(),
            place: LoopPlace {
                number,
                drive_node_id: place.drive,
                disturbance_node_id: place.io,
                truth_every_cycles: place.truth_every_cycles,
            },
            ..make(scenario)
        };
        match own_rig {
            Some(rig) => one.recorded_on(rig),
            None => one,
        }
    });
    let loops = loops.collect();
    let mut plan = Plan::of_loops(loops, contours, nodes_of_loops);
    plan.shared.names_rig = true;
    Ok(plan)
}

#[cfg(test)]
mod tests;
