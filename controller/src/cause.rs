//! Cause of the controller's safe state, which its EMCY carries.

use canopen::emcy::ErrorCode;
use canopen::nmt::NodeId;

/// A cause. Its number is the second manufacturer byte of the EMCY, as in the DBC's value table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cause {
    NoPosition = 1,
    PositionOutsideTravel,
    PositionTooFast,
    PositionFrozen,
    DriveNotEnabled,
    DriveEmergency,
    DriveNotOperational,
    OrderedAbout,
    NoBringUp,
    RigLimit,
    LawFailed,
}

impl Cause {
    /// Returns the closest error code of CiA 301.
    pub(crate) fn code(self) -> ErrorCode {
        match self {
            Self::NoPosition => ErrorCode::RPDO_TIMEOUT,
            Self::PositionOutsideTravel | Self::PositionTooFast | Self::PositionFrozen => {
                ErrorCode::SENSOR
            }
            _ => ErrorCode::GENERIC,
        }
    }

    /// Returns the EMCY's manufacturer bytes. The first is the node-ID of the node concerned, or 0.
    pub(crate) fn manufacturer(self, node: Option<NodeId>) -> [u8; 5] {
        [node.map_or(0, NodeId::get), self as u8, 0, 0, 0]
    }
}
