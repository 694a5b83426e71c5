//! Messages of the hub to a client other than frames.

/// Encodes a notice: the number of frames that were dropped for this client.
pub(super) fn encode_notice(dropped: u64) -> [u8; 8] {
    dropped.to_ne_bytes()
}

/// Returns the number in a notice; `None` if the packet is none.
pub(crate) fn decode_notice(packet: &[u8]) -> Option<u64> {
    packet.try_into().ok().map(u64::from_ne_bytes)
}
