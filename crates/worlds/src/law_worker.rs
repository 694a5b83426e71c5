//! Process that loads the shared library or the FMU of a law, away from all others: `canrig law-worker`, at a seat like any
//! program.

use std::io;
use std::path::{Path, absolute};

use fmu::table::Misfit;
use fmu::{Configuration, Fault, Instance, LawLibrary};
use platform::program::Seat;
use scenario::Objection;
use scenario::plant::{Fmu, FmuPort};
use scenario::process_law::{FmuLaw, LawSetup, ProcessLaw};

use crate::fmu_plant::{fmu_wiring, objection_to};

/// Hidden subcommand of a worker.
pub(crate) const SUBCOMMAND: &str = "law-worker";
/// Path of this program, as a process knows itself.
const MYSELF: &str = "/proc/self/exe";

/// Returns the command of a worker that loads a law or a plant from these paths. It runs in another folder.
///
/// # Errors
/// If this process's folder does not exist any more.
pub(crate) fn command(subcommand: &str, paths: &[&Path]) -> Result<Vec<String>, String> {
    let mut command = [MYSELF, subcommand].map(str::to_owned).to_vec();
    for path in paths {
        let whole = absolute(path).map_err(|error| format!("{}: {error}", path.display()))?;
        command.push(whole.to_string_lossy().into_owned());
    }
    Ok(command)
}

/// Returns the objection to the FMU of a law, by the FMU's description.
pub(crate) fn objection(law: &FmuLaw) -> Option<Objection> {
    let objection = |place: String, what: String| {
        let path = format!("controller.fmu.{place}");
        objection_to(&law.file, path, format!("law: {what}"))
    };
    let table = fmu_table(&law.file, ProcessLaw::from(law).setup);
    let wiring = match fmu_wiring(&table) {
        Ok(wiring) => wiring,
        Err(Misfit { place, fault }) => {
            return Some(objection(place_in_law(&place, law), fault.to_string()));
        }
    };
    let inputs = &wiring.configuration.inputs;
    let is_input = |name: &String| inputs.iter().any(|input| input.variable.name == *name);
    let mut ports = ports(law);
    let (key, wrong, _) =
        ports.find(|(key, variable, _)| is_input(variable) != (*key == "reads"))?;
    let what = if key == "reads" {
        format!("variable `{wrong}` is no input, so it reads nothing")
    } else {
        format!("variable `{wrong}` is an input, so it writes nothing")
    };
    Some(objection(format!("{key}.{wrong}"), what))
}

/// Returns the ports of a law: the key of the table, the variable and the signal of each.
fn ports(law: &FmuLaw) -> impl Iterator<Item = (&'static str, &String, &String)> {
    let tables = [
        ("reads", &law.reads),
        ("writes", &law.writes),
        ("terms", &law.terms),
    ];
    tables.into_iter().flat_map(|(key, ports)| {
        let named = ports.iter();
        named.map(move |(variable, signal)| (key, variable, signal))
    })
}

/// Converts a place in the table of a plant to the place in the table of the law.
fn place_in_law(place: &str, law: &FmuLaw) -> String {
    if let Some(start) = place.strip_prefix("start.") {
        return format!("parameters.{start}");
    }
    let signal = place
        .strip_prefix("ports.")
        .map(|signal| signal.strip_suffix(".variable").unwrap_or(signal));
    let found = ports(law).find(|(.., port)| Some(port.as_str()) == signal);
    let in_table = found.map(|(key, variable, _)| format!("{key}.{variable}"));
    in_table.unwrap_or_else(|| "file".to_owned())
}

/// Returns the table of a plant that is the same FMU with ports of these names.
fn fmu_table(file: &str, setup: LawSetup) -> Fmu {
    let port = |variable| FmuPort {
        variable,
        ..FmuPort::default()
    };
    let ports = setup.variables.into_iter();
    Fmu {
        file: file.to_owned(),
        start: setup.parameters,
        ports: ports
            .map(|(name, variable)| (name, port(variable)))
            .collect(),
        ..Fmu::default()
    }
}

/// Takes the seat that the environment names, loads a law, and runs it until the request to stop. Call it only in a process of
/// its own: it runs foreign code.
///
/// # Errors
/// If there is no seat, or canrig speaks another protocol.
pub fn serve(file: &Path, folder: Option<&Path>) -> io::Result<()> {
    let mut seat = Seat::join(SUBCOMMAND)?;
    let (welcome, seed) = seat.welcome()?;
    let welcome: LawSetup = serde_json::from_slice(welcome)?;
    let loaded = match folder {
        None => load_library(file, &welcome, seed),
        Some(folder) => load_fmu(file, folder, &welcome),
    };
    let outputs = welcome.writes.len() + welcome.terms.len();
    seat.play(loaded, welcome.reads.len(), outputs)
}

/// Loaded law or plant, a function of time, period, inputs and outputs.
pub(crate) type Loaded = Box<dyn FnMut(f64, f64, &[f64], &mut [f64]) -> Result<(), String>>;

fn load_library(file: &Path, setup: &LawSetup, seed: u64) -> Result<Loaded, String> {
    let mut law = LawLibrary::load(file, setup, seed).map_err(told)?;
    Ok(Box::new(move |time, period, reads, writes| {
        law.step(time, period, reads, writes).map_err(told)
    }))
}

/// Loads an FMU. It takes its inputs at the start of a period, steps to the end of the period, and its outputs there are the
/// commands of this cycle. A missing input keeps its value.
fn load_fmu(file: &Path, folder: &Path, welcome: &LawSetup) -> Result<Loaded, String> {
    let name = file.to_string_lossy();
    let wiring = fmu_wiring(&fmu_table(&name, welcome.clone()))
        .map_err(|misfit| misfit.fault.to_string())?;
    let (ports, configuration) = (&wiring.ports, &wiring.configuration);
    let read_names = welcome.reads.iter();
    let reads = read_names.filter_map(|name| configuration.inputs.get(ports.input(name)?));
    let written_names = welcome.writes.iter().chain(&welcome.terms);
    let written = written_names.filter_map(|name| configuration.outputs.get(ports.output(name)?));
    // In the order of the law's values.
    let configuration = Configuration {
        inputs: reads.cloned().collect(),
        outputs: written.cloned().collect(),
        ..configuration.clone()
    };
    let mut instance = Instance::new(folder, &configuration).map_err(told)?;
    // Until there is a value, an input is 0 in the FMU's unit.
    let inputs = configuration.inputs.iter();
    let mut set = Vec::from_iter(inputs.map(|input| input.conversion.of(0.0)));
    Ok(Box::new(move |time, period, reads, writes| {
        for (set, read) in set.iter_mut().zip(reads) {
            if !read.is_nan() {
                *set = *read;
            }
        }
        instance.advance(time + period, &set).map_err(told)?;
        instance.read(writes).map_err(told)
    }))
}

/// Returns the text of an error for the other end of the seat, which knows the file.
pub(crate) fn told(fault: Fault) -> String {
    fault.to_string()
}
