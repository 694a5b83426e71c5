//! The nodes that a rig has besides its drive.

use canopen::nmt::NodeId;

/// Node-ID of the controller.
pub(crate) const CONTROLLER: NodeId = NodeId::new(0x01).expect("1 is a node id");
/// Node-ID of the disturbance module, unless a rig file gives it another.
pub(crate) const DISTURBANCE: NodeId = NodeId::new(0x11).expect("17 is a node id");
