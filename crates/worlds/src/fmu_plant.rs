//! Plants that are FMUs: `[plant.NAME.fmu]` of a rig file.
//!
//! The ports of an FMU follow from its description alone. Its code is loaded only for a run, in a worker process of its own
//! ([`crate::fmu_worker`]), so that a crash, a hang or an exit costs only that run.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, SystemTime};

use fmu::Fault;
use fmu::table::{self, Misfit, wiring};
use fmu::{Archive, FmuError, Unpacked};
use plant_emulator::plant::{InvalidPlant, Plant, Ports};
use scenario::Objection;
use scenario::plant::{FMU, Fmu};

use crate::fmu_worker::RemoteFmu;

/// Number of FMUs whose descriptions are kept.
const KEPT_MAX: usize = 16;

/// Returns the objection to the table of an FMU, or to the FMU.
pub(crate) fn objection(fmu: &Fmu) -> Option<Objection> {
    let Misfit { place, fault } = fmu_wiring(fmu).err()?;
    let path = format!("plant.{FMU}.{place}");
    Some(objection_to(&fmu.file, path, format!("plant: {fault}")))
}

/// Returns the objection to an FMU that cannot be a plant or a law, at this path of the scenario.
pub(crate) fn objection_to(file: &str, path: String, role: String) -> Objection {
    let name = Path::new(file).file_name().unwrap_or_default();
    let message = format!("{} cannot be this {role}", name.to_string_lossy());
    Objection::new(path, message, "by what the FMU says of itself")
        .with_help(format!("`canrig fmu {file}` lists what it has and needs"))
}

/// Opens the FMU of a table, which may have to run here; returns it with the ports that the table makes of its variables.
fn wired(fmu: &Fmu, must_run: bool) -> Result<(Arc<Opened>, table::Wiring), Misfit> {
    let in_file = |fault| Misfit {
        place: "file".to_owned(),
        fault,
    };
    let opened = Opened::find(Path::new(&fmu.file)).map_err(|error| in_file(error.fault))?;
    if must_run {
        opened.archive.runs_here().map_err(in_file)?;
    }
    // The name that the FMU may use in its messages.
    let name = Path::new(&fmu.file).file_stem().unwrap_or_default();
    let wiring = wiring(fmu, &name.to_string_lossy(), &opened.archive.description)?;
    Ok((opened, wiring))
}

/// As [`wired`], for a plant.
fn wired_plant(fmu: &Fmu) -> Result<(Arc<Opened>, table::Wiring), InvalidPlant> {
    wired(fmu, false).map_err(|Misfit { fault, .. }| {
        let file = PathBuf::from(&fmu.file);
        InvalidPlant::Other(FmuError { file, fault }.to_string())
    })
}

/// Plant that an FMU in a worker process computes.
#[derive(Debug)]
pub(crate) struct FmuPlant {
    ports: Ports,
    /// The FMU in its worker, or its failure, with which the worker is gone.
    remote: Result<RemoteFmu, String>,
    /// Files that the worker has open.
    _unpacked: Arc<Unpacked>,
    /// Time in whole nanoseconds, as the drive counts it, so that no sum drifts.
    time: Duration,
    outputs: Vec<f64>,
}

impl Plant for FmuPlant {
    type Config = Fmu;

    fn name() -> &'static str {
        FMU
    }

    fn new(fmu: &Fmu) -> Result<Self, InvalidPlant> {
        let (opened, wiring) = wired_plant(fmu)?;
        let cannot = |error: FmuError| match error.fault {
            Fault::File { place, source } => InvalidPlant::Machine {
                what: format!("{}: {place}", error.file.display()),
                source,
            },
            _ => InvalidPlant::Other(error.to_string()),
        };
        let unpacked = opened.unpacked().map_err(cannot)?;
        let mut outputs = vec![0.0; wiring.ports.outputs.len()];
        let remote =
            RemoteFmu::load(&unpacked, &wiring.configuration, &mut outputs).map_err(cannot)?;
        Ok(Self {
            remote: Ok(remote),
            _unpacked: unpacked,
            time: Duration::ZERO,
            outputs,
            ports: wiring.ports,
        })
    }

    fn ports_by(fmu: &Fmu) -> Result<Ports, InvalidPlant> {
        wired_plant(fmu).map(|(_, wiring)| wiring.ports)
    }

    fn ports(&self) -> Ports {
        self.ports.clone()
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        let Ok(remote) = &mut self.remote else {
            return;
        };
        self.time += Duration::try_from_secs_f64(duration_seconds).unwrap_or_default();
        let to_seconds = self.time.as_secs_f64();
        if let Err(error) = remote.advance(to_seconds, inputs, &mut self.outputs) {
            self.remote = Err(error.to_string());
        }
    }

    fn read(&self, outputs: &mut [f64]) {
        outputs.copy_from_slice(&self.outputs);
    }

    fn failure(&self) -> Option<&str> {
        self.remote.as_ref().err().map(String::as_str)
    }
}

/// Unpacks the files of an FMU.
///
/// # Errors
/// If it cannot be unpacked.
pub(crate) fn unpacked(file: &str) -> Result<Arc<Unpacked>, String> {
    let opened = Opened::find(Path::new(file));
    let unpacked = opened.and_then(|opened| opened.unpacked());
    unpacked.map_err(|error| error.to_string())
}

/// Wires an FMU by its table.
///
/// # Errors
/// If it cannot be read, does not run here, or does not fit the table.
pub(crate) fn fmu_wiring(fmu: &Fmu) -> Result<table::Wiring, Misfit> {
    wired(fmu, true).map(|(_, wiring)| wiring)
}

/// FMU whose description was read. The cases of a sweep share it, and its files while one of them runs.
struct Opened {
    archive: Archive,
    unpacked: Mutex<Weak<Unpacked>>,
}

/// Key that identifies an unchanged file: its path, its length and the time of its last change.
#[derive(Clone, PartialEq)]
struct Key(PathBuf, u64, Option<SystemTime>);

impl Opened {
    fn find(file: &Path) -> Result<Arc<Self>, FmuError> {
        static KEPT: Mutex<Vec<(Key, Arc<Opened>)>> = Mutex::new(Vec::new());
        let metadata = file.metadata().ok();
        let length = metadata.as_ref().map_or(0, |metadata| metadata.len());
        let changed = metadata.and_then(|metadata| metadata.modified().ok());
        let key = Key(file.to_owned(), length, changed);
        // An interrupted change leaves the list valid.
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, opened)) = kept.iter().find(|(other, _)| *other == key) {
            return Ok(Arc::clone(opened));
        }
        let opened = Arc::new(Self {
            archive: Archive::open(file)?,
            unpacked: Mutex::default(),
        });
        if kept.len() == KEPT_MAX {
            kept.remove(0);
        }
        kept.push((key, Arc::clone(&opened)));
        Ok(opened)
    }

    fn unpacked(&self) -> Result<Arc<Unpacked>, FmuError> {
        let mut kept = self.unpacked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(unpacked) = kept.upgrade() {
            return Ok(unpacked);
        }
        let unpacked = Arc::new(self.archive.unpack()?);
        *kept = Arc::downgrade(&unpacked);
        Ok(unpacked)
    }
}
