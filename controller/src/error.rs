//! Errors of the construction of a controller.

use canopen::eds;
use canopen::services::InvalidPdo;
use scenario::rig::drive::DriveError;

use crate::catalogue::LawError;

/// Reason why a controller cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The scenario selects no law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A law reads or writes a signal that the rig lacks.
    #[error(transparent)]
    Port(#[from] scenario::law_ports::WrongPort),
    /// An EDS cannot be read.
    #[error("the EDS is wrong: {0}")]
    Eds(#[from] eds::EdsError),
    /// The controller's own PDOs are wrong.
    #[error("the controller's EDS is wrong: {0}")]
    Pdo(#[from] InvalidPdo),
    /// The controller's EDS lacks an object.
    #[error("the controller's EDS has no object 0x{0:04X}")]
    NoObject(u16),
    /// The drive is not suitable.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// A number is no node-ID.
    #[error("{0} is no node-ID")]
    NodeId(u8),
    /// The process of a law cannot be started.
    #[error("{0}")]
    NoPlayer(String),
    /// A loop follows a missing drive.
    #[error("a loop follows the drive with node-ID {0}, which the controller does not lead")]
    NotLed(u8),
}
