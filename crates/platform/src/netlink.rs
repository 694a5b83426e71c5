//! Requests to the kernel about network interfaces (rtnetlink).

use std::io;

use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socket_with,
};

/// Length of a message's header.
const HEADER_BYTES: usize = 16;
/// Length of the header of an attribute.
const ATTRIBUTE_BYTES: usize = 4;
/// Longest answer that is read; the kernel tells some 2 kB of an interface.
const ANSWER_BYTES_MAX: usize = 1 << 16;
/// Type of an acknowledgement or an error.
const NLMSG_ERROR: u16 = 2;
/// Flags of an attribute's type: nested, and byte order.
const TYPE_FLAGS: u16 = 0xC000;

/// Sends a request and returns the body of the answer; that of an acknowledgement is empty.
///
/// # Errors
/// If the kernel refuses.
pub(crate) fn ask(kind: u16, flags: u16, body: &[u8]) -> io::Result<Vec<u8>> {
    let socket = socket_with(
        AddressFamily::NETLINK,
        SocketType::RAW,
        SocketFlags::CLOEXEC,
        None, // NETLINK_ROUTE is 0
    )?;
    let length = u32::try_from(HEADER_BYTES + body.len()).expect("a short message");
    let mut message = length.to_ne_bytes().to_vec();
    message.extend_from_slice(&kind.to_ne_bytes());
    message.extend_from_slice(&flags.to_ne_bytes());
    message.extend_from_slice(&[0; 8]); // sequence number and port
    message.extend_from_slice(body);
    send(&socket, &message, SendFlags::empty())?;
    let mut answer = vec![0; ANSWER_BYTES_MAX];
    let (_, length) = recv(&socket, &mut answer[..], RecvFlags::empty())?;
    answer.truncate(length);
    let (Some(header), Some(body)) = (answer.get(..HEADER_BYTES), answer.get(HEADER_BYTES..))
    else {
        return Err(io::Error::from_raw_os_error(libc::EPROTO));
    };
    if header[4..6] != NLMSG_ERROR.to_ne_bytes() {
        return Ok(body.to_vec());
    }
    // A negative error number; 0 is an acknowledgement.
    match word(body, 0).map_or(-libc::EPROTO, u32::cast_signed) {
        0 => Ok(Vec::new()),
        error => Err(io::Error::from_raw_os_error(-error)),
    }
}

/// Appends length, type and value, padded to a multiple of four bytes.
pub(crate) fn push_attribute(message: &mut Vec<u8>, kind: u16, value: &[u8]) {
    let length = u16::try_from(ATTRIBUTE_BYTES + value.len()).expect("a short attribute");
    message.extend_from_slice(&length.to_ne_bytes());
    message.extend_from_slice(&kind.to_ne_bytes());
    message.extend_from_slice(value);
    message.resize(message.len().next_multiple_of(4), 0);
}

/// Returns the value of the first attribute of a type.
pub(crate) fn attribute(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let (header, _) = attributes.split_first_chunk::<ATTRIBUTE_BYTES>()?;
        let [length, found] =
            [[header[0], header[1]], [header[2], header[3]]].map(u16::from_ne_bytes);
        let value = attributes.get(ATTRIBUTE_BYTES..length.into())?;
        if found & !TYPE_FLAGS == kind {
            return Some(value);
        }
        attributes = attributes.get(usize::from(length).next_multiple_of(4)..)?;
    }
}

/// Returns the number at a place, counted in words of 32 bits.
pub(crate) fn word(bytes: &[u8], place: usize) -> Option<u32> {
    let word = bytes.get(4 * place..)?.first_chunk()?;
    Some(u32::from_ne_bytes(*word))
}
