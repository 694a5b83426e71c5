//! The kernel's layout of frames and filters (`linux/can.h`), native byte order.

use can::{CanFrame, Filter};

use crate::seat::bytes_at;

/// Bytes of `struct can_frame`.
pub(crate) const FRAME_BYTES: usize = 16;
/// Bytes of `struct can_filter`.
pub(crate) const FILTER_BYTES: usize = 8;

/// Encodes a frame as `struct can_frame`: identifier with flags, length, three bytes of padding, data.
pub(crate) fn encode_frame(frame: &CanFrame) -> [u8; FRAME_BYTES] {
    let mut bytes = [0; FRAME_BYTES];
    bytes[..4].copy_from_slice(&frame.raw_id().to_ne_bytes());
    bytes[4] = frame.length();
    bytes[8..].copy_from_slice(&frame.buffer());
    bytes
}

/// Decodes a `struct can_frame`; `None` if the bytes are not a frame.
pub(crate) fn decode_frame(bytes: &[u8]) -> Option<CanFrame> {
    let bytes: &[u8; FRAME_BYTES] = bytes.try_into().ok()?;
    let id = u32::from_ne_bytes(bytes_at(bytes, 0));
    CanFrame::from_raw(id, bytes[4], bytes_at(bytes, 8))
}

/// Encodes filters as an array of `struct can_filter`.
pub(crate) fn encode_filters(filters: &[Filter]) -> Vec<u8> {
    filters
        .iter()
        .flat_map(|filter| [filter.id.to_ne_bytes(), filter.mask.to_ne_bytes()])
        .flatten()
        .collect()
}

/// Decodes an array of `struct can_filter`; `None` if the length is no multiple of 8.
pub(crate) fn decode_filters(bytes: &[u8]) -> Option<Vec<Filter>> {
    let (filters, rest) = bytes.as_chunks::<FILTER_BYTES>();
    rest.is_empty().then(|| {
        filters
            .iter()
            .map(|filter| Filter {
                id: u32::from_ne_bytes(bytes_at(filter, 0)),
                mask: u32::from_ne_bytes(bytes_at(filter, 4)),
            })
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_the_kernels_layout() {
        let frame = CanFrame::new(0x190, &[1, 2, 3]);
        let bytes = encode_frame(&frame);
        assert_eq!(bytes[..4], 0x190_u32.to_ne_bytes());
        assert_eq!(bytes[4..], [3, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0]);
        assert_eq!(decode_frame(&bytes), Some(frame));
    }

    #[test]
    fn what_is_no_frame_is_refused() {
        let mut bytes = encode_frame(&CanFrame::new(1, &[]));
        assert_eq!(decode_frame(&bytes[..15]), None);
        assert_eq!(decode_frame(&[0; 72]), None);
        bytes[4] = 9;
        assert_eq!(decode_frame(&bytes), None);
    }

    #[test]
    fn filters_come_back() {
        let filters = [Filter::ALL, Filter::exact(0x190)];
        let bytes = encode_filters(&filters);
        assert_eq!(bytes.len(), 16);
        assert_eq!(decode_filters(&bytes).unwrap(), filters);
        assert_eq!(decode_filters(&bytes[..9]), None);
    }
}
