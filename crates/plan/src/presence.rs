//! The nodes present on the bus, and the rights of a guest there.

use std::collections::{BTreeMap, BTreeSet};

use can::CanFrame;
use canopen::NmtState;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID};
use dbc::scenario_clock::SYNC_COB_ID;

use crate::data_sheet::DataSheet;

/// Nodes, SYNC and SDO users whose frames were on the bus.
#[derive(Clone, Debug, Default)]
pub struct Presence {
    states: BTreeMap<u8, NmtState>,
    has_sync: bool,
    /// Nodes whose default SDO channel is in use.
    sdo_users: BTreeSet<u8>,
}

impl Presence {
    /// Notes a frame of another participant.
    pub fn on_frame(&mut self, frame: &CanFrame) {
        let Some(id) = frame.standard_id() else {
            return;
        };
        let node_id = (id & 0x7F) as u8;
        match id - u16::from(node_id) {
            SYNC_COB_ID if node_id == 0 => self.has_sync = true,
            ERROR_CONTROL_ID if node_id != 0 => {
                let number = frame.data().first().map(|state| state & 0x7F);
                if let Some(state) = number.and_then(NmtState::from_number) {
                    self.states.insert(node_id, state);
                }
            }
            DEFAULT_REQUEST_ID | DEFAULT_RESPONSE_ID if node_id != 0 => {
                self.sdo_users.insert(node_id);
            }
            _ => {}
        }
    }

    /// Returns the nodes with a heartbeat, each with the state that it reported last.
    pub fn states(&self) -> &BTreeMap<u8, NmtState> {
        &self.states
    }

    /// Returns the sign of a running manager, if there is one; `is_manager` tells whether a node is one.
    pub fn manager(&self, is_manager: impl Fn(u8) -> bool) -> Option<String> {
        let mut heard = self.states.keys();
        if let Some(node_id) = heard.find(|node_id| is_manager(**node_id)) {
            return Some(format!("the heartbeat of the manager, node {node_id}"));
        }
        self.has_sync.then(|| "SYNC".to_owned())
    }

    /// Returns the reason why a guest must not use the default SDO channel of a node. No other node uses a manager's own channel.
    pub fn why_not_default_channel(&self, node_id: u8, sheets: &[DataSheet]) -> Option<String> {
        let reason = if self.sdo_users.contains(&node_id) {
            "others were heard on it".to_owned()
        } else if is_manager(node_id, sheets) {
            return None;
        } else {
            let manager = self.manager(|node_id| is_manager(node_id, sheets))?;
            format!("{manager} was heard")
        };
        Some(format!(
            "the default SDO channel of node {node_id} belongs to the running controller ({reason})"
        ))
    }
}

/// Checks whether a node is a manager, by its data sheet.
pub fn is_manager(node_id: u8, sheets: &[DataSheet]) -> bool {
    let mut sheets = sheets.iter();
    sheets.any(|sheet| sheet.is_manager() && sheet.node_id == node_id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data_sheet::rig_data_sheets;

    fn after(frames: &[(u16, &[u8])]) -> Presence {
        let mut presence = Presence::default();
        for (id, data) in frames {
            presence.on_frame(&CanFrame::new(*id, data));
        }
        presence
    }

    #[test]
    fn a_silent_bus_lets_guests_use_default_channels() {
        let sheets = rig_data_sheets();
        let presence = after(&[(0x710, &[0x7F]), (0x190, &[0; 8])]);
        assert_eq!(presence.states()[&0x10], NmtState::PreOperational);
        assert_eq!(presence.why_not_default_channel(0x10, &sheets), None);
    }

    #[test]
    fn a_running_manager_keeps_guests_away() {
        let sheets = rig_data_sheets();
        for frame in [(0x080, &[1][..]), (0x701, &[5]), (0x080, &[])] {
            let presence = after(&[frame]);
            let reason = presence.why_not_default_channel(0x11, &sheets).unwrap();
            assert!(
                reason.contains("belongs to the running controller"),
                "{reason}"
            );
            assert_eq!(presence.why_not_default_channel(0x01, &sheets), None);
        }
    }

    #[test]
    fn traffic_on_a_channel_keeps_guests_off_that_channel() {
        let presence = after(&[(0x611, &[0x40, 0, 0x10, 0, 0, 0, 0, 0])]);
        assert!(presence.why_not_default_channel(0x11, &[]).is_some());
        assert!(presence.why_not_default_channel(0x12, &[]).is_none());
        // Neither the drive's second channel nor an emergency is a default channel.
        let presence = after(&[(0x690, &[0; 8]), (0x6D0, &[0; 8]), (0x090, &[0; 8])]);
        assert!((1..=127).all(|id| presence.why_not_default_channel(id, &[]).is_none()));
    }
}
