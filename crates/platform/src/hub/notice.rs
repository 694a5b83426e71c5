//! What the hub says to a client besides frames.

/// A notice: how many frames were dropped for this client.
pub(super) fn encode_notice(dropped: u64) -> [u8; 8] {
    dropped.to_ne_bytes()
}

/// The number in a notice; `None` when the packet is none.
pub(crate) fn decode_notice(packet: &[u8]) -> Option<u64> {
    packet.try_into().ok().map(u64::from_ne_bytes)
}
