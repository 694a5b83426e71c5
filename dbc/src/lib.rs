//! The meaning of the bytes on the bus: the DBC database and the EDS files of the rig.
//!
//! Input: frames, the text of a DBC or EDS file, the signals of a plant or the terms of a law. Output: the values of signals by
//! their names, frames with values in them, the objects of a data sheet, scenario time.
//!
//! [`SMA_ACTUATOR`] lays out every frame on the bus; [`DRIVE_EDS`], [`DISTURBANCE_EDS`] and [`CONTROLLER_EDS`] lay out the
//! objects behind them, and a test checks that they agree. Recorder, judge and tools read frames through [`Database`];
//! [`Composer`] makes the database of a rig; [`names`] has the names that the bench itself uses.
//! [`Port`]s are those of plants and laws, a [`Quantity`] is what a sensor measures or an amplifier gives, in a [`Unit`].
//!
//! The crate does not know scenarios, plants and laws beyond their signals and ports, recordings, or the sender of a frame and its reason.
//!
//! ```
//! use can::CanFrame;
//! use dbc::Database;
//!
//! let database = Database::shipped();
//! let position = database.signal("drive_tpdo1.position_millimetres").unwrap();
//! let frame = CanFrame::new(0x190, &[0x37, 0x12, 0x10, 0x27, 0, 0, 0, 2]);
//! assert_eq!(position.decode(&frame), Some(10.0));
//! ```
#![warn(missing_docs)]

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::{LazyLock, Mutex, PoisonError};

use canopen::ObjectDictionary;
use canopen::eds::{self, EdsError};

pub mod coding;
pub mod command_range;
mod compose;
pub mod data_sheets;
pub mod database;
pub mod error;
mod law;
pub mod loops;
pub mod names;
pub mod node_objects;
mod notation;
mod parse;
mod port;
mod quantity;
pub mod scenario_clock;
mod unit;
mod write;

pub use coding::{ByteOrder, Coding, Kind, Range};
pub use command_range::CommandRange;
pub use compose::Composer;
pub use data_sheets::{CONTROLLER_EDS, DISTURBANCE_EDS, DRIVE_EDS};
pub use database::{Database, Message, MessageBuilder, Signal, SignalHandle};
pub use error::{DbcError, SignalMissing};
pub use law::{TermObject, first_term, layout};
pub use port::{Port, Ports, Width, local_name, plant_of_port, steps_for};
pub use quantity::{Quantities, Quantity, UNIT, is_gain, is_pattern, is_same_gain};
pub use unit::{Unit, conversion, known_units, singular, symbol_of, unit_in};

/// The frames of the rig (`sma_actuator.dbc`).
pub const SMA_ACTUATOR: &str = include_str!("../sma_actuator.dbc");
/// Dictionaries of the shipped data sheets, each read once for a node-ID.
static SHIPPED: Mutex<BTreeMap<(usize, u8), ObjectDictionary>> = Mutex::new(BTreeMap::new());

/// Returns the objects of a data sheet for a node, as [`eds::parse`] reads them.
///
/// # Errors
/// As [`eds::parse`].
pub fn dictionary(text: &str, node_id: u8) -> Result<ObjectDictionary, EdsError> {
    let parse = || eds::parse(text, node_id);
    let sheets = [CONTROLLER_EDS, DRIVE_EDS, DISTURBANCE_EDS];
    let Some(place) = sheets.iter().position(|sheet| *sheet == text) else {
        return parse();
    };
    let mut shipped = SHIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    match shipped.entry((place, node_id)) {
        Entry::Occupied(known) => Ok(known.get().clone()),
        Entry::Vacant(unknown) => Ok(unknown.insert(parse()?).clone()),
    }
}

impl Database {
    /// Returns the frames of the rig: [`SMA_ACTUATOR`] as the build script read it, so that no run parses the text.
    ///
    /// # Panics
    /// Never: a test checks the texts that are compiled in.
    pub fn shipped() -> &'static Self {
        static DATABASE: LazyLock<Database> = LazyLock::new(|| {
            let read = include_bytes!(concat!(env!("OUT_DIR"), "/sma_actuator.postcard"));
            postcard::from_bytes(read).expect("written by the build script from this type")
        });
        &DATABASE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_build_script_left_is_what_the_text_says() {
        assert_eq!(
            Database::parse(SMA_ACTUATOR).as_ref(),
            Ok(Database::shipped())
        );
    }

    #[test]
    fn a_data_sheet_is_read_for_another_node_too() {
        let dictionary = dictionary(DRIVE_EDS, 0x20).unwrap();
        assert_eq!(dictionary.unsigned(0x1200, 1), Some(0x620));
    }
}
