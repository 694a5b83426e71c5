//! Why there can be no controller.

use canopen::eds;
use canopen::services::InvalidPdo;

use crate::catalogue::LawError;

/// Why a controller cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The scenario selects no law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// An EDS cannot be read.
    #[error("the EDS is wrong: {0}")]
    Eds(#[from] eds::EdsError),
    /// The controller's own PDOs are wrong.
    #[error("the controller's EDS is wrong: {0}")]
    Pdo(#[from] InvalidPdo),
    /// The controller's EDS lacks an object.
    #[error("the controller's EDS has no object 0x{0:04X}")]
    NoObject(u16),
    /// A PDO of the drive is not described.
    #[error("the drive's EDS describes no usable PDO at 0x{0:04X}")]
    DrivePdo(u16),
    /// The drive lacks an object.
    #[error("the drive's EDS has no object 0x{index:04X}:{sub_index:02X}")]
    NoDriveObject {
        /// Its index.
        index: u16,
        /// Its sub-index.
        sub_index: u8,
    },
    /// An object of the drive is of another type.
    #[error("the drive's object 0x{index:04X}:{sub_index:02X} is no integer of 8, 16 or 32 bits")]
    NoInteger {
        /// Its index.
        index: u16,
        /// Its sub-index.
        sub_index: u8,
    },
    /// No object's name.
    #[error("\"{0}\" names no object")]
    Address(String),
    /// No node's number.
    #[error("{0} is no node-ID")]
    NodeId(u8),
    /// More objects than a PDO holds.
    #[error(
        "the objects of the rig file take {bytes} bytes in PDO mapping 0x{mapping:04X} (limit 8)"
    )]
    PdoTooLong {
        /// The mapping's index.
        mapping: u16,
        /// Their bytes.
        bytes: usize,
    },
}
