//! What the bytes mean: the DBC database and the EDS files of the rig.
//!
//! [`SMA_ACTUATOR`] lays out every frame on the bus, [`DRIVE_EDS`], [`DISTURBANCE_EDS`] and [`CONTROLLER_EDS`] the
//! objects behind them; a test holds them to each other. Recorder, judge and tools read frames through [`Database`].
//!
//! ```
//! use canopen::CanFrame;
//! use dbc::Database;
//!
//! let database = Database::sma_actuator();
//! let position = database.signal("drive_tpdo1.position_millimetres").unwrap();
//! let frame = CanFrame::new(0x190, &[0x37, 0x12, 0x10, 0x27, 0, 0, 0, 2]);
//! assert_eq!(position.decode(&frame), Some(10.0));
//! ```

use std::sync::LazyLock;

pub mod coding;
pub mod database;
pub mod error;
mod law;
mod parse;
mod plant;
pub mod scenario_clock;

pub use coding::{ByteOrder, Coding, Kind, Range};
pub use database::{
    Database, Decoded, DecodedSignal, Message, MessageBuilder, Signal, SignalHandle,
};
pub use error::{DbcError, SignalMissing};
pub use law::{LAW_TERMS_MAX, LAW_TERMS_OBJECT, LawTerm};
pub use plant::PlantSignal;

/// The frames of the rig (`sma_actuator.dbc`).
pub const SMA_ACTUATOR: &str = include_str!("../sma_actuator.dbc");
/// The drive, node 0x10, CiA 402 (`drive.eds`).
pub const DRIVE_EDS: &str = include_str!("../drive.eds");
/// The disturbance node 0x11, CiA 401 (`disturbance.eds`).
pub const DISTURBANCE_EDS: &str = include_str!("../disturbance.eds");
/// The controller, node 0x01 (`controller.eds`).
pub const CONTROLLER_EDS: &str = include_str!("../controller.eds");

impl Database {
    /// The frames of the rig: [`SMA_ACTUATOR`] as the build script read it, which spares every run its text.
    ///
    /// # Panics
    /// Never: a test takes what is compiled in.
    #[must_use]
    pub fn sma_actuator() -> &'static Self {
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
            Ok(Database::sma_actuator())
        );
    }
}
