//! Why the controller went to its safe state: what its EMCY says.

use canopen::emcy::ErrorCode;
use canopen::nmt::NodeId;

/// A cause; its number is in the second of the EMCY's manufacturer bytes, as the DBC's value table has it.
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
    /// The code of CiA 301 that comes nearest.
    pub(crate) fn code(self) -> ErrorCode {
        match self {
            Self::NoPosition => ErrorCode::RPDO_TIMEOUT,
            Self::PositionOutsideTravel | Self::PositionTooFast | Self::PositionFrozen => {
                ErrorCode::SENSOR
            }
            _ => ErrorCode::GENERIC,
        }
    }

    /// The EMCY's manufacturer bytes; the first is for the number of the node concerned, where there may be several.
    pub(crate) fn manufacturer(self, node: Option<NodeId>) -> [u8; 5] {
        [node.map_or(0, NodeId::get), self as u8, 0, 0, 0]
    }
}
