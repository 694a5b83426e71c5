//! Errors of the construction of a controller.

use canopen::eds;
use canopen::services::InvalidPdo;
use scenario::rig::drive::DriveError;

/// Reason why a controller cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The parameters do not fit the law.
    #[error("controller: {0}")]
    Parameters(#[from] toml::de::Error),
    /// A law reads or writes a signal that the rig lacks.
    #[error(transparent)]
    Port(#[from] scenario::law_ports::WrongPort),
    /// An EDS cannot be read.
    #[error("the EDS is wrong: {0}")]
    Eds(#[from] eds::EdsError),
    /// The controller's own PDOs are wrong.
    #[error("the controller's EDS is wrong: {0}")]
    Pdo(#[from] InvalidPdo),
    /// The drive is not suitable.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// Another reason, as text.
    #[error("{0}")]
    Other(String),
}
