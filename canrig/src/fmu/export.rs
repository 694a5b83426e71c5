//! `canrig fmu --export`: writes plants as FMUs.

use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use fmu::description::Version;
use fmu::export::{Exported, write_fmu};

use recording::run_folder::write_new;
use runner::console::ended;
use runner::exit::Exit;

/// Shared library with the plants that ship.
const SHIPPED_LIBRARY: &str = "libcanrig_plants.so";

/// Constructor of the model of a custom plant.
pub(crate) type OwnModel = fn() -> Box<dyn Exported>;

static OWN: OnceLock<Vec<OwnModel>> = OnceLock::new();

/// Keeps the custom plants of the bench.
pub(crate) fn register(models: Vec<OwnModel>) {
    let _ = OWN.set(models);
}

/// Reason why no FMU was written.
#[derive(Debug, thiserror::Error)]
enum ExportError {
    #[error("there is no plant `{name}` to export; there are: {known}")]
    Unknown { name: String, known: String },
    #[error("the plant `{name}` cannot be made from its defaults: {reason}")]
    NoModel { name: String, reason: String },
    #[error("the shared library {name} is not in {places}; {advice}")]
    NoLibrary {
        name: String,
        places: String,
        advice: &'static str,
    },
    #[error("{} cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("`{}` cannot be written: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
}

impl ExportError {
    fn exit(&self) -> Exit {
        match self {
            Self::Unknown { .. } => Exit::Usage,
            Self::NoModel { .. } | Self::NoLibrary { .. } => Exit::CannotStart,
            Self::Read { .. } | Self::Write { .. } => Exit::BenchFailed,
        }
    }
}

/// Writes the FMU of a plant, and prints its path.
pub(super) fn export(plant: &str, output: Option<&Path>, fmi: u8) -> Exit {
    ended(written(plant, output, fmi), ExportError::exit)
}

fn written(plant: &str, output: Option<&Path>, fmi: u8) -> Result<String, ExportError> {
    let version = match fmi {
        2 => Version::Two,
        _ => Version::Three,
    };
    let shipped = fmu_plants::shipped();
    let custom = Vec::from_iter(OWN.get().into_iter().flatten().map(|custom| custom()));
    let find = |models| named(models, plant);
    let (exported, library) = match (find(&custom), find(&shipped)) {
        (Some(custom), _) => (custom, library_of_program()?),
        (None, Some(shipped)) => (shipped, shipped_library()?),
        (None, None) => {
            let known = shipped.iter().chain(&custom);
            let names = known.map(|exported| exported.name());
            return Err(ExportError::Unknown {
                name: plant.to_owned(),
                known: Vec::from_iter(names).join(", "),
            });
        }
    };
    let model = exported.model().map_err(|reason| ExportError::NoModel {
        name: plant.to_owned(),
        reason,
    })?;
    let bytes = fs::read(&library).map_err(|source| ExportError::Read {
        path: library.clone(),
        source,
    })?;
    let path = output.map_or_else(|| PathBuf::from(format!("{plant}.fmu")), Path::to_owned);
    let write = |file: &mut BufWriter<File>| write_fmu(file, &model, version, &bytes);
    write_new(&path, write).map_err(|source| ExportError::Write {
        path: path.clone(),
        source,
    })?;
    let (version, count) = (version.name(), model.variables.len());
    Ok(format!(
        "{}: {plant}, FMI {version}, {count} variables",
        path.display()
    ))
}

/// Finds the model with this name.
pub(super) fn named<'a>(models: &'a [Box<dyn Exported>], name: &str) -> Option<&'a dyn Exported> {
    let mut models = models.iter().map(|exported| &**exported);
    models.find(|exported| exported.name() == name)
}

/// Returns the folder of this program.
fn beside() -> PathBuf {
    let program = std::env::current_exe().and_then(|program| program.canonicalize());
    program
        .ok()
        .and_then(|program| program.parent().map(Path::to_owned))
        .unwrap_or_default()
}

/// Finds the library of the plants that ship. Cargo and the archive put it next to the program; the wheel puts it into
/// its package below the same prefix.
fn shipped_library() -> Result<PathBuf, ExportError> {
    let beside = beside();
    let mut places = vec![beside.clone(), beside.join("../lib")];
    let pythons = fs::read_dir(beside.join("../lib"))
        .into_iter()
        .flatten()
        .flatten();
    places.extend(pythons.map(|python| python.path().join("site-packages/canrig")));
    let advice = "`cargo build --release` makes it, the wheel and the archive of a release have it";
    found(SHIPPED_LIBRARY.to_owned(), &places, advice)
}

/// Finds the library of the program's own crate. Cargo builds both together.
fn library_of_program() -> Result<PathBuf, ExportError> {
    let program = std::env::current_exe().unwrap_or_default();
    let stem = program
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .replace('-', "_");
    let advice = "let the crate's Cargo.toml have crate-type = [\"lib\", \"cdylib\"] below [lib], and name its plants in fmu_plants::export!";
    found(format!("lib{stem}.so"), &[beside()], advice)
}

fn found(name: String, places: &[PathBuf], advice: &'static str) -> Result<PathBuf, ExportError> {
    let mut paths = places.iter().map(|place| place.join(&name));
    let found = paths.find(|path| path.is_file());
    found.ok_or_else(|| ExportError::NoLibrary {
        places: places[0].display().to_string(),
        name: name.clone(),
        advice,
    })
}
