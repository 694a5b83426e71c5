//! Several loops that are played at once, each with its setup.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;
use std::sync::Arc;

use dbc::Database;
use dbc::loops::LoopPlace;
use dbc::signals::TRUTH_MESSAGES;
use scenario::fault::FaultWindow;
use scenario::loops::{Loops, OneLoop};
use scenario::rig::nodes::Rig;
use scenario::{Objection, Scenario, ScenarioError, Texts, read_text};

use crate::FILE_BYTES_MAX;
use crate::bus_budget::BusBudget;
use crate::catalogue::Catalogue;
use crate::external::{External, ExternalNode, no_such_node};
use crate::named_nodes::names_by_id;
use crate::ports;
use crate::rig_file::LoadedRig;
use crate::setup::{LoopName, NodeNames, Setup};

/// Reads and checks a scenario file of schema 2 with its rig file: a setup for each loop, in the order of their names. Each knows
/// the frames of the whole bus, and its own as those of a rig with one drive.
///
/// # Errors
/// A file cannot be read or is not valid.
pub fn load(path: &Path, catalogue: &Catalogue) -> Result<Vec<Setup>, ScenarioError> {
    let objections = |scenario: &Scenario| catalogue.objections(scenario);
    let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
    let (loops, texts) = Loops::load(path, objections, object)?;
    Ok(with_texts(loops, path, &texts, catalogue))
}

/// As [`load`], with signals in the scenario that nobody sends: whoever looks for the right name has a wrong one in the file.
///
/// # Errors
/// As [`load`] for everything else.
pub fn load_with_any_signals(
    path: &Path,
    catalogue: &Catalogue,
) -> Result<Vec<Setup>, ScenarioError> {
    let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
    let (loops, texts) = Loops::load(path, |_| Vec::new(), object)?;
    Ok(with_texts(loops, path, &texts, catalogue))
}

/// As [`load`], for a scenario of one loop or of several.
///
/// # Errors
/// As [`load`].
pub fn load_any(path: &Path, catalogue: &Catalogue) -> Result<Vec<Setup>, ScenarioError> {
    let text = read_text(path, FILE_BYTES_MAX).unwrap_or_default();
    match Loops::is_meant(&text) {
        true => parse_beside(path, text, catalogue),
        false => Setup::load(path, catalogue).map(|setup| vec![setup]),
    }
}

/// As [`load`], for a text that is at hand; the files that it names lie beside `path`.
///
/// # Errors
/// As [`load`].
pub fn parse_beside(
    path: &Path,
    text: String,
    catalogue: &Catalogue,
) -> Result<Vec<Setup>, ScenarioError> {
    let objections = |scenario: &Scenario| catalogue.objections(scenario);
    let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
    let (loops, texts) = Loops::parse_beside(path, text, objections, object)?;
    Ok(with_texts(loops, path, &texts, catalogue))
}

/// As [`parse_beside`], for files that `read_file` gives by their names.
///
/// # Errors
/// As [`load`].
pub fn parse(
    path: &Path,
    text: String,
    read_file: impl FnMut(&str) -> io::Result<String>,
    catalogue: &Catalogue,
) -> Result<Vec<Setup>, ScenarioError> {
    let objections = |scenario: &Scenario| catalogue.objections(scenario);
    let object = |loops: &Loops<Scenario>| objection(loops, catalogue);
    let (loops, texts) = Loops::parse(path, text, read_file, objections, object)?;
    Ok(with_texts(loops, path, &texts, catalogue))
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
    // What was objected to was refused before.
    let setups = setups(loops.clone(), catalogue).unwrap_or_default();
    let budget = BusBudget::new(&loops.rig, &setups);
    Ok((loops.rig, budget))
}

/// The loops of another scenario on the same rig, with the same plants and laws: they share what the frames mean.
///
/// # Errors
/// Everything that is wrong in the text and its files, and a value that an FMU does not take.
pub fn varied(
    base: &[Setup],
    text: &str,
    read_file: impl FnMut(&str) -> io::Result<String>,
    catalogue: &Catalogue,
) -> Result<Vec<Setup>, ScenarioError> {
    let object = |loops: &Loops<Scenario>| {
        let mut scenarios = loops.loops.iter().map(|one| &one.scenario);
        let found = scenarios.find_map(|one| catalogue.fmu_objection(one, &one.wiring.plant));
        // That the file is not there any more is no value's fault.
        found.filter(|objection| objection.path.contains(".fmu.start."))
    };
    // What is no text lies beside the scenario that they vary.
    let path = base.first().map_or(Path::new(""), |base| &base.path);
    let path = path.with_file_name("case");
    let (loops, _) = Loops::parse(&path, text.to_owned(), read_file, |_| Vec::new(), object)?;
    let contours = Arc::new(loops.contours);
    let elsewhere = faults_elsewhere(loops.loops.iter().map(|one| &one.scenario));
    let setups = base.iter().zip(loops.loops).zip(elsewhere);
    let setups = setups.map(|((base, one), elsewhere)| {
        let setup = base.varied(one.scenario, Arc::clone(&contours));
        setup.beside_faults(elsewhere)
    });
    Ok(setups.collect())
}

/// For each loop the faults of the others.
fn faults_elsewhere<'a>(scenarios: impl Iterator<Item = &'a Scenario>) -> Vec<Vec<FaultWindow>> {
    let faults = Vec::from_iter(scenarios.map(|scenario| scenario.fault.windows()));
    let of_others = |own: usize| {
        let others = faults
            .iter()
            .enumerate()
            .filter(move |(other, _)| *other != own);
        others.flat_map(|(_, faults)| faults.iter().cloned())
    };
    (0..faults.len())
        .map(|own| of_others(own).collect())
        .collect()
}

fn with_texts(
    loops: Loops<Scenario>,
    path: &Path,
    texts: &Texts,
    catalogue: &Catalogue,
) -> Vec<Setup> {
    // What was objected to was refused before.
    let setups = setups(loops, catalogue).unwrap_or_default().into_iter();
    let setups = setups.map(|setup| setup.with_texts(path, texts.clone()));
    setups.collect()
}

/// As [`parse`], for the text of a rig file alone, on which nothing is tried.
///
/// # Errors
/// It is not valid.
pub fn of_rig(path: &Path, text: &str, catalogue: &Catalogue) -> Result<Vec<Setup>, ScenarioError> {
    let object = |loops: &Loops<Scenario>| setups(loops.clone(), catalogue).err();
    let loops = Loops::of_rig(text, &path.display().to_string(), object)?;
    Ok(with_texts(loops, path, &Texts::default(), catalogue))
}

/// Reads the loops of a recording, whose frames mean what the database says: that of the first loop. `external` are the nodes
/// that were somebody else's.
///
/// # Errors
/// A file cannot be read or is not valid.
pub fn load_recorded(
    path: &Path,
    database: &Database,
    external: &[String],
) -> Result<Vec<Setup>, ScenarioError> {
    let recorded = |loops: Loops<Scenario>| {
        let first = loops.loops.first().map(|one| one.name.clone());
        let first = first.unwrap_or_default();
        let frames = |name: &str| match name == first {
            true => database.clone(),
            false => database.seen_from(&first, name),
        };
        let names = Vec::from_iter(loops.loops.iter().map(|one| one.name.clone()));
        named(loops, |name, scenario, rig| {
            let frames = frames(name);
            let others = names.iter().map(String::as_str);
            let others = Vec::from_iter(others.filter(|other| *other != name));
            // What the scenario calls a signal is the loop's own, as when it was played.
            let setup = Setup::of_recording(scenario, frames.without(&others));
            let setup = setup.with_database(Arc::new(frames));
            setup.recorded_on(rig.loaded, rig.external)
        })
    };
    let object = |loops: &Loops<Scenario>| recorded(loops.clone()).err();
    let (loops, texts) = Loops::load_recorded(path, |_| Vec::new(), object)?;
    let setups = recorded(loops).unwrap_or_default().into_iter();
    let setups = setups.map(|mut setup| {
        setup.external = external_with(&setup, external).unwrap_or_default();
        setup.with_texts(path, texts.clone())
    });
    Ok(setups.collect())
}

/// The loops with further nodes that are somebody else's, by the rig's names. A drive among them is like the emulated one, but
/// publishes no truth.
///
/// # Errors
/// The rig has no such node, or it cannot be external.
pub fn with_external(setups: Vec<Setup>, names: &[String]) -> Result<Vec<Setup>, String> {
    let known = setups.iter().flat_map(|setup| {
        let (controller, drive, disturbance) = setup.node_names();
        [controller, drive].into_iter().chain(disturbance)
    });
    let known = BTreeSet::from_iter(known);
    if let Some(name) = names.iter().find(|name| !known.contains(name.as_str())) {
        return Err(no_such_node(name, &Vec::from_iter(known)));
    }
    let silent = setups.iter().filter_map(|setup| {
        let has_truth = !setup.external.has(ExternalNode::Drive);
        let (_, drive, _) = setup.node_names();
        let is_named = names.iter().any(|name| name == drive);
        (has_truth && is_named).then(|| name_of(setup).to_owned())
    });
    let silent = Vec::from_iter(silent);
    let setups = setups.into_iter().map(|mut setup| {
        setup.external = external_with(&setup, names)?;
        let own = name_of(&setup).to_owned();
        let messages = silent.iter().flat_map(|name| {
            TRUTH_MESSAGES.map(|message| match *name == own {
                true => message.to_owned(),
                false => format!("{name}_{message}"),
            })
        });
        let messages = Vec::from_iter(messages);
        let messages = Vec::from_iter(messages.iter().map(String::as_str));
        let database = Arc::new(setup.database.with_silent(&messages));
        Ok(setup.with_database(database))
    });
    setups.collect()
}

/// The name of a loop; empty for the only one.
fn name_of(setup: &Setup) -> &str {
    setup.loop_name.as_ref().map_or("", |names| &names.name)
}

/// The nodes of a loop that are somebody else's, with those of these names.
fn external_with(setup: &Setup, names: &[String]) -> Result<External, &'static str> {
    let (controller, drive, disturbance) = setup.node_names();
    let nodes = [
        (ExternalNode::Drive, Some(drive)),
        (ExternalNode::Controller, Some(controller)),
        (ExternalNode::Fan, disturbance),
    ];
    let is_named = |name: &str| names.iter().any(|other| other == name);
    let nodes = nodes.into_iter();
    let nodes = nodes.filter(|(_, name)| name.is_some_and(is_named));
    let nodes = nodes.map(|(node, _)| node).chain(setup.external.nodes());
    External::new(&Vec::from_iter(nodes))
}

/// What is wrong with a rig: a drive that cannot be led, nodes that send the same, a cycle that is too short.
fn objection(loops: &Loops<Scenario>, catalogue: &Catalogue) -> Option<Objection> {
    if let Some(objection) = ports::objection(loops, catalogue) {
        return Some(objection);
    }
    match setups(loops.clone(), catalogue) {
        Ok(setups) => does_not_fit(&BusBudget::new(&loops.rig, &setups)),
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

fn setups(loops: Loops<Scenario>, catalogue: &Catalogue) -> Result<Vec<Setup>, Objection> {
    let alone = named(loops, |_, scenario, rig| {
        let setup = Setup::new(scenario, catalogue);
        let OwnRig { loaded, external } = rig;
        setup.on(loaded, external)
    })?;
    let alone = alone.into_iter().map(|setup| {
        let place = place_in_shipped(&setup);
        let database = Arc::new(setup.database.at(&place));
        setup.with_database(database)
    });
    let setups = with_each_other(&Vec::from_iter(alone));
    let twice = setups
        .first()
        .map(|first| first.database.refuse_duplicates());
    match twice {
        Some(Err(error)) => Err(Objection {
            path: "node".to_owned(),
            message: "two nodes of this rig send under one identifier".to_owned(),
            label: error.to_string(),
            help: Some(
                "give one of them another node-ID or, in its EDS, another COB-ID".to_owned(),
            ),
        }),
        _ => Ok(setups),
    }
}

/// Where the frames of a loop are to be moved to: those of a drive with a rig of its own are where that says.
fn place_in_shipped(setup: &Setup) -> LoopPlace {
    let (place, shipped) = (setup.place, LoopPlace::SHIPPED);
    match setup.rig {
        None => place,
        Some(_) => LoopPlace {
            drive_node_id: shipped.drive_node_id,
            disturbance_node_id: place.disturbance_node_id.and(shipped.disturbance_node_id),
            ..place
        },
    }
}

/// What a rig file says of one loop's nodes that are somebody else's.
struct OwnRig {
    loaded: Option<Arc<LoadedRig>>,
    external: External,
}

impl OwnRig {
    fn new<T>(loops: &Loops<T>, name: &str) -> Result<Self, Objection> {
        let drive = loops.rig.drive_of_loop(name);
        let Some(file) = loops.rig.rig_file_of(drive) else {
            return Ok(Self {
                loaded: None,
                external: External::default(),
            });
        };
        let external = External::default().with_drive();
        let has_fan = loops.rig.io_of(drive).is_some_and(|(_, io)| io.external);
        let loaded = LoadedRig::of_node(Path::new(drive), file, loops.sheets.get(drive));
        Ok(Self {
            loaded: Some(Arc::new(loaded.map_err(|error| Objection {
                path: format!("node.{drive}"),
                message: format!("the drive `{drive}` cannot be led"),
                label: error.to_string(),
                help: None,
            })?)),
            external: match has_fan {
                true => external.with_fan(),
                false => external,
            },
        })
    }
}

/// Makes a setup of each loop, which then has its name and its place.
fn named(
    loops: Loops<Scenario>,
    make: impl Fn(&str, Scenario, OwnRig) -> Setup,
) -> Result<Vec<Setup>, Objection> {
    let rigs = loops.loops.iter();
    let rigs = rigs.map(|one| OwnRig::new(&loops, &one.name));
    let rigs = rigs.collect::<Result<Vec<_>, _>>()?;
    let Loops {
        rig,
        loops,
        contours,
        ..
    } = loops;
    let contours = Arc::new(contours);
    let is_only = loops.len() == 1;
    let elsewhere = faults_elsewhere(loops.iter().map(|one| &one.scenario));
    let node_names = |name: &str| {
        let (controller, _) = rig.controller().unzip();
        let drive = rig.drive_of_loop(name).to_owned();
        NodeNames {
            controller: controller.unwrap_or_default().to_owned(),
            disturbance: rig.io_of(&drive).map(|(name, _)| name.to_owned()),
            drive,
        }
    };
    let several = loops.iter().filter(|_| !is_only);
    let nodes_of_loops = several.map(|one| (one.name.clone(), node_names(&one.name)));
    let nodes_of_loops = Arc::new(BTreeMap::from_iter(nodes_of_loops));
    let setups = (0..).zip(loops).zip(rigs).map(|((number, one), own_rig)| {
        let OneLoop {
            name,
            place,
            scenario,
        } = one;
        let place = LoopPlace {
            number,
            drive_node_id: place.drive,
            disturbance_node_id: place.io,
            truth_every_cycles: place.truth_every_cycles,
        };
        let elsewhere = elsewhere[usize::from(number)].clone();
        let setup = make(&name, scenario, own_rig).beside_faults(elsewhere);
        let nodes = (node_names(&name), Arc::clone(&nodes_of_loops));
        let names = LoopName {
            plant: rig.plant_of_loop(&name).to_owned(),
            name,
        };
        let names = (!is_only).then_some(names);
        setup.of_loop(names, nodes, place, Arc::clone(&contours))
    });
    Ok(setups.collect())
}

/// Gives each loop the frames of the others.
fn with_each_other(alone: &[Setup]) -> Vec<Setup> {
    let whole = |own: &Setup| {
        let others = alone.iter().filter(|other| other.place != own.place);
        let bus = others.fold(Database::clone(&own.database), |bus, other| {
            let name = other.loop_name.as_ref().map_or("", |names| &names.name);
            bus.beside(name, &other.database)
        });
        bus.with_nodes(names_by_id(alone))
    };
    let loops = alone
        .iter()
        .map(|own| own.clone().with_database(Arc::new(whole(own))));
    loops.collect()
}

#[cfg(test)]
mod tests;
