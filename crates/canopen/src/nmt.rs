//! Network management (CiA 301, 7.2.8): states, commands, boot-up, and the frames of a manager.

use std::fmt;

use can::CanFrame;

/// COB-ID of NMT commands.
pub const COMMAND_ID: u16 = 0x000;

/// COB-ID of boot-up messages and heartbeats, without the node-ID.
pub const ERROR_CONTROL_ID: u16 = 0x700;

/// Number of a CANopen node, 1 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(u8);

impl NodeId {
    /// Makes a node-ID; `None` if the number is not in 1 to 127.
    pub const fn new(number: u8) -> Option<Self> {
        match number {
            1..=127 => Some(Self(number)),
            _ => None,
        }
    }

    /// Returns the number.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// Returns the identifier of a default connection: function code plus node-ID.
    pub(crate) fn with(self, function: u16) -> u16 {
        function + u16::from(self.0)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}", self.0)
    }
}

/// The states of a node (CiA 301, figure 48), with their numbers in a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// The node is not up yet; as a heartbeat this is the boot-up message.
    Initialising = 0,
    /// Only NMT and heartbeat work.
    Stopped = 4,
    /// Everything works.
    Operational = 5,
    /// Everything but PDOs works.
    PreOperational = 127,
}

impl NmtState {
    /// Returns the number in a heartbeat.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// Returns the state with this number in a heartbeat.
    pub fn from_number(number: u8) -> Option<Self> {
        let mut states = [
            Self::Initialising,
            Self::Stopped,
            Self::Operational,
            Self::PreOperational,
        ]
        .into_iter();
        states.find(|state| state.number() == number)
    }

    /// Checks whether SDO, SYNC and EMCY work (CiA 301, table 38).
    pub fn allows_sdo(self) -> bool {
        matches!(self, Self::PreOperational | Self::Operational)
    }
}

/// Orders of a manager (CiA 301, 7.2.8.3.1), with their command specifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtCommand {
    /// To Operational.
    Start = 1,
    /// To Stopped.
    Stop = 2,
    /// To Pre-operational.
    EnterPreOperational = 128,
    /// Back to power-on values in the whole dictionary, then boot-up.
    ResetNode = 129,
    /// Back to power-on values in 0x1000 to 0x1FFF, then boot-up.
    ResetCommunication = 130,
}

impl NmtCommand {
    /// Returns the command specifier.
    pub fn specifier(self) -> u8 {
        self as u8
    }

    /// Returns the command with this specifier.
    pub fn from_specifier(specifier: u8) -> Option<Self> {
        let mut commands = [
            Self::Start,
            Self::Stop,
            Self::EnterPreOperational,
            Self::ResetNode,
            Self::ResetCommunication,
        ]
        .into_iter();
        commands.find(|command| command.specifier() == specifier)
    }

    /// Returns the frame with this order for one node, or for all nodes if `target` is `None`.
    pub fn frame(self, target: Option<NodeId>) -> CanFrame {
        CanFrame::new(0, &[self.specifier(), target.map_or(0, NodeId::get)])
    }

    /// Decodes the command in the payload of a frame with identifier 0, if it is for this node or for all.
    pub(crate) fn decode(data: &[u8], node_id: NodeId) -> Option<Self> {
        match *data {
            [specifier, target] if target == 0 || target == node_id.get() => {
                Self::from_specifier(specifier)
            }
            _ => None,
        }
    }

    /// Returns the state to which the command leads; `None` for the resets.
    pub(crate) fn target_state(self) -> Option<NmtState> {
        match self {
            Self::Start => Some(NmtState::Operational),
            Self::Stop => Some(NmtState::Stopped),
            Self::EnterPreOperational => Some(NmtState::PreOperational),
            Self::ResetNode | Self::ResetCommunication => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: NodeId = NodeId::new(1).unwrap();

    #[test]
    fn node_1_and_127_are_valid_and_0_and_128_are_not() {
        assert!(NodeId::new(1).is_some() && NodeId::new(127).is_some());
        assert!(NodeId::new(0).is_none() && NodeId::new(128).is_none());
    }

    #[test]
    fn commands_for_this_node_and_for_all_are_decoded() {
        for command in [
            NmtCommand::Start,
            NmtCommand::Stop,
            NmtCommand::EnterPreOperational,
            NmtCommand::ResetNode,
            NmtCommand::ResetCommunication,
        ] {
            for target in [None, Some(NODE)] {
                assert_eq!(
                    NmtCommand::decode(command.frame(target).data(), NODE),
                    Some(command)
                );
            }
            assert_eq!(
                NmtCommand::decode(command.frame(NodeId::new(2)).data(), NODE),
                None
            );
        }
    }

    #[test]
    fn malformed_commands_are_ignored() {
        for data in [&[][..], &[1], &[1, 1, 0], &[0, 1], &[255, 0]] {
            assert_eq!(NmtCommand::decode(data, NODE), None);
        }
    }
}
