//! Why there can be no controller.

use canopen::eds;
use canopen::services::InvalidPdo;
use scenario::rig::drive::DriveError;

use crate::catalogue::LawError;

/// Why a controller cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The scenario selects no law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A law reads or writes what the rig has not.
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
    /// The drive cannot be led.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// No node's number.
    #[error("{0} is no node-ID")]
    NodeId(u8),
    /// The process that plays a law cannot be started.
    #[error("{0}")]
    NoPlayer(String),
    /// A loop follows a drive that is not there.
    #[error("a loop follows the drive with node-ID {0}, which the controller does not lead")]
    NotLed(u8),
}
