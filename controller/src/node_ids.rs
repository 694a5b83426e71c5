//! The nodes that a rig has besides its drive.

use canopen::nmt::NodeId;

/// Node-ID of the controller.
pub(crate) const CONTROLLER: NodeId = NodeId::new(0x01).expect("1 is a node id");
