//! Data sheets as dictionaries of nodes.

use canopen::{NodeId, ObjectDictionary};

use crate::InvalidEmulator;

/// Converts a number to a node-ID.
pub(crate) fn node_id(number: u8) -> Result<NodeId, InvalidEmulator> {
    NodeId::new(number).ok_or_else(|| InvalidEmulator::Other(format!("{number} is no node-ID")))
}

/// Returns the dictionary of a data sheet.
pub(crate) fn dictionary(node_id: NodeId, text: &str) -> Result<ObjectDictionary, InvalidEmulator> {
    let dictionary = dbc::dictionary(text, node_id.get());
    dictionary.map_err(|error| InvalidEmulator::Other(format!("EDS of node {node_id}: {error}")))
}
