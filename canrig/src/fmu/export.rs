//! `canrig fmu --export`: writes plants as FMUs.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use fmu::description::Version;
use fmu::export::{Exported, write_fmu};

use recording::run_folder::write_new;
use runner::exit::{Exit, Failure};
use runner::output::unwritten;

/// Shared library with the plants that ship.
const SHIPPED_LIBRARY: &[u8] = shared_library::shared_library!(canrig_plants);

/// Constructor of the model of a custom plant.
pub(crate) type OwnModel = fn() -> Box<dyn Exported>;

static OWN: OnceLock<Vec<OwnModel>> = OnceLock::new();

/// Keeps the custom plants of the bench.
pub(crate) fn register(models: Vec<OwnModel>) {
    let _ = OWN.set(models);
}

/// Writes the FMU of a plant, and returns its path with the facts.
pub(super) fn export(plant: &str, output: Option<&Path>, fmi: u8) -> Result<String, Failure> {
    let version = match fmi {
        2 => Version::Two,
        _ => Version::Three,
    };
    let shipped = fmu_plants::shipped();
    let custom = Vec::from_iter(OWN.get().into_iter().flatten().map(|custom| custom()));
    let find = |models| named(models, plant);
    let (exported, library) = match (find(&custom), find(&shipped)) {
        (Some(custom), _) => (custom, Cow::Owned(library_of_program()?)),
        (None, Some(_)) if SHIPPED_LIBRARY.is_empty() => {
            return Err(Exit::CannotStart.because(
                "this program was built for a system without shared libraries, so it has none for an FMU",
            ));
        }
        (None, Some(shipped)) => (shipped, Cow::Borrowed(SHIPPED_LIBRARY)),
        (None, None) => {
            let known = shipped.iter().chain(&custom);
            let names = known.map(|exported| exported.name());
            let known = Vec::from_iter(names).join(", ");
            return Err(Exit::Usage.because(format!(
                "there is no plant `{plant}` to export; there are: {known}"
            )));
        }
    };
    let model = exported.model().map_err(|reason| {
        let text = "cannot be made from its defaults";
        Exit::CannotStart.because(format!("the plant `{plant}` {text}: {reason}"))
    })?;
    let path = output.map_or_else(|| PathBuf::from(format!("{plant}.fmu")), Path::to_owned);
    let write = |file: &mut BufWriter<File>| write_fmu(file, &model, version, &library);
    write_new(&path, write).map_err(|error| unwritten(&path, &error))?;
    let (version, count) = (version.name(), model.variables.len());
    Ok(format!(
        "{}: {plant}, FMI {version}, {count} variables",
        path.display()
    ))
}

/// Finds the model with this name.
fn named<'a>(models: &'a [Box<dyn Exported>], name: &str) -> Option<&'a dyn Exported> {
    let mut models = models.iter().map(|exported| &**exported);
    models.find(|exported| exported.name() == name)
}

/// Reads the library of the program's own crate, which Cargo builds next to it.
fn library_of_program() -> Result<Vec<u8>, Failure> {
    let program = std::env::current_exe().and_then(|program| program.canonicalize());
    let program = program.unwrap_or_default();
    let stem = program.file_stem().unwrap_or_default().to_string_lossy();
    let name = format!("lib{}.so", stem.replace('-', "_"));
    let folder = program.parent().unwrap_or(Path::new(""));
    let path = folder.join(&name);
    if !path.is_file() {
        let place = folder.display();
        let advice = "let the crate's Cargo.toml have crate-type = [\"lib\", \"cdylib\"] below [lib], and name its plants in fmu_plants::export!";
        let reason = format!("the shared library {name} is not in {place}; {advice}");
        return Err(Exit::CannotStart.because(reason));
    }
    fs::read(&path).map_err(|error| {
        Exit::BenchFailed.because(format!("{} cannot be read: {error}", path.display()))
    })
}
