//! FMUs: plants from a modelling tool, by FMI 2.0 and 3.0, co-simulation.
//!
//! An FMU is a zip file with a `modelDescription.xml` and shared libraries; its code is foreign. A [`Description`] is
//! read from an [`Archive`] without running any of it. An [`Instance`] loads the library, only in a worker process,
//! which the caller starts. So a crash, a hang or an exit of an FMU costs one run.
//!
//! Inputs are the file and the table of a rig file, which [`table::wiring`] fits to it. Outputs are the values of its
//! ports, step by step, or a [`Fault`] that names the variable.
//!
//! In the other direction, [`export`] makes FMUs of plants: their description, and the C functions of FMI around them.
//!
//! A [`LawLibrary`] is a control law in a shared library, which only a worker loads, too.
//!
//! The crate does not know buses, nodes, the start of processes or the time. Besides `platform`, it is the only crate
//! with `unsafe` code: an FMU's functions are C.

pub mod archive;
pub mod description;
mod error;
pub mod export;
mod folder;
mod instance;
mod library;
pub mod table;
pub mod unit;

pub use archive::{Archive, Unpacked};
pub use description::Description;
pub use error::{Fault, FmuError, said};
pub use instance::{Configuration, Instance, PortVariable, StartValue};
pub use library::law::LawLibrary;
