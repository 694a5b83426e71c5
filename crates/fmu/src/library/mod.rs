//! An FMU's shared library: its C functions behind a safe trait. The only `unsafe` code outside `platform`.
//!
//! Rust cannot check that foreign functions comply with FMI, so only a worker process loads them.
#![expect(unsafe_code, reason = "an FMU's functions are C")]

pub(crate) mod law;
mod loaded;
mod log;
mod python;
mod three;
mod two;

use std::ffi::{CStr, CString, c_int};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use crate::archive::{library_in, resources_in};
use crate::description::{Description, Kind, Version};
use crate::error::Fault;

/// Status that a function returned, by its number in FMI.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) struct Status(pub(crate) c_int);

impl Status {
    pub(crate) const DISCARD: Self = Self(2);
    pub(crate) const ERROR: Self = Self(3);
    pub(crate) const FATAL: Self = Self(4);

    /// Returns whether the function succeeded, with or without a warning.
    pub(crate) fn is_good(self) -> bool {
        matches!(self.0, 0 | 1)
    }

    /// Returns a text that follows the subject of a sentence.
    pub(crate) fn outcome(self) -> String {
        let outcome = match self.0 {
            0 => "succeeded",
            1 => "warned",
            2 => "refused (discard)",
            3 => "failed (error)",
            4 => "failed for good (fatal)",
            5 => "returned before it was done (pending), which was not allowed",
            other => return format!("returned {other}, which is not a status of FMI"),
        };
        outcome.to_owned()
    }
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stepped {
    pub(crate) status: Status,
    /// Time that was reached.
    pub(crate) reached_seconds: f64,
    pub(crate) needs_events: bool,
    pub(crate) is_terminated: bool,
}

/// Requests of the discrete states after an update.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Updated {
    pub(crate) again: bool,
    pub(crate) is_terminated: bool,
    pub(crate) next_event_seconds: Option<f64>,
}

// Functions that take no values, by their names without the prefix of the version.
pub(crate) const EXIT_INITIALIZATION: &str = "ExitInitializationMode";
pub(crate) const ENTER_EVENT_MODE: &str = "EnterEventMode";
pub(crate) const ENTER_STEP_MODE: &str = "EnterStepMode";
pub(crate) const TERMINATE: &str = "Terminate";

/// One instance of an FMU for co-simulation. Functions of events are called only if [`crate::description::CoSimulation::has_event_mode`].
pub(crate) trait Slave {
    /// Sets a number; `value` is within the range of its kind.
    fn set_number(&mut self, kind: Kind, reference: u32, value: f64) -> Status;
    fn number(&mut self, kind: Kind, reference: u32) -> (Status, f64);
    fn set_text(&mut self, reference: u32, text: &CStr) -> Status;
    fn enter_initialization(&mut self, start_seconds: f64, tolerance: Option<f64>) -> Status;
    fn step(&mut self, from_seconds: f64, duration_seconds: f64) -> Stepped;
    fn update_discrete(&mut self) -> (Status, Updated);
    /// Calls one of the functions that take no values, such as [`TERMINATE`].
    fn call(&mut self, function: &'static str) -> Status;
    /// Returns the messages since the last call.
    fn log(&mut self) -> String;
    /// Marks the instance as lost. After a fatal failure no function may be called.
    fn forsake(&mut self);
}

/// Loads the library in the folder of an unpacked FMU, and makes an instance.
pub(crate) fn instantiate(
    folder: &Path,
    description: &Description,
    name: &CStr,
) -> Result<Box<dyn Slave>, Fault> {
    let co_simulation = description.served()?;
    let library = open(&library_in(folder, description)?)?;
    let token = text(&description.token)?;
    let resources = text(&resources_in(folder, description.version))?;
    let instance = match description.version {
        Version::Two => two::instance(library, name, &token, &resources)?,
        Version::Three => {
            let has_events = co_simulation.has_event_mode;
            three::instance(library, name, &token, &resources, has_events)?
        }
    };
    Ok(Box::new(instance))
}

/// Returns a text for C.
pub(crate) fn text(text: &str) -> Result<CString, Fault> {
    CString::new(text).map_err(|_| Fault::Invalid(format!("{text:?} has a NUL in it")))
}

/// Opens a library. All symbols are resolved at once, so a missing one is found before motion begins.
fn open(path: &Path) -> Result<Library, Fault> {
    // SAFETY: a library may run any code when it is loaded, so only a worker process loads one.
    let opened = |path: &Path| unsafe { Library::open(Some(path), RTLD_NOW | RTLD_LOCAL) };
    let reason = match opened(path) {
        Ok(library) => return Ok(library),
        Err(error) => other_machine(path).unwrap_or_else(|| reason(&error)),
    };
    let Some(symbol) = python::missing_symbol(&reason) else {
        return Err(Fault::library(reason));
    };
    python::open(symbol)?;
    opened(path).map_err(|error| Fault::library(self::reason(&error)))
}

/// Returns the reason if a library is for another machine; the system's loader reports only that the file is missing.
fn other_machine(path: &Path) -> Option<String> {
    let (library, here) = (machine(path)?, machine(Path::new("/proc/self/exe"))?);
    let name = |machine| match machine {
        3 => "x86 of 32 bits".to_owned(),
        40 => "ARM of 32 bits".to_owned(),
        62 => "x86-64".to_owned(),
        183 => "aarch64".to_owned(),
        243 => "RISC-V".to_owned(),
        other => format!("the machine {other} of ELF"),
    };
    (library != here).then(|| format!("it is for {}, and this is {}", name(library), name(here)))
}

/// Returns the machine of an ELF file, by its number there: `e_machine`, two bytes after 18.
fn machine(path: &Path) -> Option<u16> {
    let mut header = [0; 20];
    File::open(path).ok()?.read_exact(&mut header).ok()?;
    let number = u16::from_ne_bytes([header[18], header[19]]);
    header.starts_with(b"\x7fELF").then_some(number)
}

/// Returns the message of the system's loader.
fn reason(error: &libloading::Error) -> String {
    match error {
        libloading::Error::DlOpen { source } => source.to_string(),
        other => other.to_string(),
    }
}

/// Looks up a function of a library.
///
/// # Safety
/// `F` is the type that FMI gives the function of this name, and the function is not called after the library is
/// closed.
unsafe fn function<F: Copy>(library: &Library, name: &str) -> Result<F, Fault> {
    // SAFETY: by the caller.
    let symbol = unsafe { library.get::<F>(name.as_bytes()) };
    let symbol = symbol.map_err(|_| {
        let reason = format!("its library has no function `{name}`, which it must have");
        Fault::Invalid(reason)
    })?;
    Ok(*symbol)
}

/// Converts to an integer of any type; `value` is whole and within its range.
fn whole<T: TryFrom<i64> + Default>(value: f64) -> T {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "whole and within the range, by `Kind::whole_range`"
    )]
    let value = value as i64;
    T::try_from(value).unwrap_or_default()
}

#[cfg(test)]
mod tests;
