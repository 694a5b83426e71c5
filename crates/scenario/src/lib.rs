//! Scenario files define a trial and the conditions of a pass; rig files define the drives on which it runs.
//!
//! Input: the text of a scenario or a rig file, the tables that it names, the tables of plants and laws from outside, the objects
//! of a drive's EDS. Output: a [`Scenario`] on its [`rig::nodes::Rig`], or every [`Problem`] with its place in the text; the JSON
//! Schemas of both; the layout of a drive from a rig file ([`rig::drive`]), and the watch over its limits ([`rig::limits`]).
//!
//! A [`Trial`] is the part of a scenario for one loop; the controller gets a [`ControllerView`] of it, without the plant.
//!
//! The crate does not know the signals of the bus (the caller brings an [`Objection`] to an unknown name), the data sheets that
//! ship, the behaviour of a plant, or how a run is played or judged.

mod beside;
mod bus;
mod check;
pub mod chirp;
pub mod contour;
pub mod controller;
mod curve;
pub mod custom;
pub mod disturbance;
mod document;
mod error;
pub mod events;
pub mod expect;
pub mod fault;
mod file;
mod fingerprint;
mod identifiers;
pub mod law_ports;
mod limit;
mod load;
pub mod metrics;
mod nearest;
pub mod node;
mod null;
pub mod overrides;
pub mod plant;
pub mod process_law;
mod profile;
pub mod reference;
pub mod registration;
pub mod rig;
mod run;
mod scenario;
pub mod schema;
mod structure;
pub mod sweep;
mod table;
#[cfg(test)]
mod tests;
mod text;
pub mod timing;
mod trial;
mod view;
mod window;
pub mod wiring;

/// Longest run, and latest time of a scenario: a week, which leaves room for a soak over a weekend.
pub const TIME_SECONDS_MAX: f64 = 604_800.0;

pub use beside::Beside;
pub use bus::{Bus, cycle_start_seconds, nearest_cycle};
pub use error::{Problem, ScenarioError, without_colours};
pub use file::{open_file, read_sheet, read_text, require_file};
pub use fingerprint::{HASH_SUFFIX, file_hash, hash_in, hexadecimal};
pub use identifiers::Identifiers;
pub use load::{Asked, FileKind, Objection, Reading, text_of};
pub use nearest::{meant_or_known, nearest};
pub use node::NodeProgram;
pub use overrides::Override;
pub use run::Run;
pub use scenario::{Scenario, Shared};
pub use trial::Trial;
pub use view::ControllerView;
