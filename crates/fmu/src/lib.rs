//! FMUs: plants from a modelling tool, by FMI 2.0 and 3.0, co-simulation.
//!
//! An FMU is a zip file with a `modelDescription.xml` and shared libraries, and a stranger's program. What it says of itself is
//! read by [`Description`] from an [`Archive`], which runs nothing of it. Its library is loaded by an [`Instance`], and that only in a
//! worker process ([`worker::serve`]); who plays it has a [`worker::Remote`]. So a crash, a hang or an exit of an FMU costs one run.
//!
//! Comes in: the file, the table of a rig file, which [`table::wiring`] fits to it, and a [`worker::Channel`] to a worker, which somebody else started. Goes out:
//! the values of its ports, step by step, or a [`FmuError`] that names file and variable.
//!
//! The other way round, [`export`] makes FMUs of plants: their description, and the C functions of FMI round them.
//!
//! A [`LawLibrary`] is a control law in a shared library, which only a worker loads, too.
//!
//! It does not know: buses, nodes, how a process is started, what time it is. Only here, beside `platform`, code is `unsafe`:
//! an FMU's functions are C.

pub mod archive;
pub mod description;
mod error;
pub mod export;
mod folder;
mod instance;
mod library;
pub mod table;
pub mod unit;
pub mod worker;

pub use archive::{Archive, Unpacked};
pub use description::Description;
pub use error::{Fault, FmuError};
pub use instance::{Configuration, Instance, StartValue};
pub use library::law::{LawLibrary, LawSetup};
