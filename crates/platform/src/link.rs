//! State of a network interface as the kernel reports it (netlink): of one for CAN its error state, bit rate and error counters.

use std::ffi::CString;
use std::io;

use crate::netlink::{ask, attribute, push_attribute, word};
use crate::seat::bytes_at;

/// Length of a link's description before its attributes (`struct ifinfomsg`), and the places of its hardware type, in
/// bytes, and of its flags, in words.
const DESCRIPTION_BYTES: usize = 16;
const TYPE_AT: usize = 2;
const FLAGS_WORD: usize = 2;
/// Hardware type of CAN interfaces (`linux/if_arp.h`).
const ARPHRD_CAN: u16 = 280;
/// Attributes of `IFLA_LINKINFO`, and of a CAN interface in it (linux/can/netlink.h).
pub(crate) const INFO_KIND: u16 = 1;
const INFO_DATA: u16 = 2;
const BIT_TIMING: u16 = 1;
const STATE: u16 = 4;
const CONTROL_MODE: u16 = 5;
const ERROR_COUNTERS: u16 = 8;
const LOOPBACK: u32 = 0x01;
const LISTEN_ONLY: u32 = 0x02;
/// Kinds of CAN interfaces without a wire: every node on them runs on this machine.
const VIRTUAL_KINDS: [&[u8]; 2] = [b"vcan\0", b"vxcan\0"];

/// Error state of a CAN controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanState {
    /// Less than 96 errors.
    ErrorActive,
    /// Less than 128 errors.
    ErrorWarning,
    /// Less than 256 errors.
    ErrorPassive,
    /// 256 errors or more: it is off the bus.
    BusOff,
    /// Not started, or in a state that this program does not know.
    Stopped,
}

/// Network interface. A value that its driver does not report is `None`; a vcan reports only whether it is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Link {
    /// Whether the interface is for CAN.
    pub is_can: bool,
    /// Whether the interface is up.
    pub is_up: bool,
    /// Whether the interface has no wire (vcan, vxcan), so that all its nodes run on this machine.
    pub is_virtual: bool,
    /// Bits per second.
    pub bit_rate: Option<u32>,
    /// The controller's error state.
    pub state: Option<CanState>,
    /// Transmit and receive error counters (ISO 11898-1).
    pub errors: Option<[u16; 2]>,
    /// Whether the controller hears the bus, but neither acknowledges nor sends.
    pub is_listen_only: bool,
    /// Whether the controller hears only its own frames.
    pub is_loopback: bool,
}

/// Asks the kernel about an interface of this process's network namespace.
///
/// # Errors
/// If there is no such interface, or the kernel does not answer.
pub fn link(name: &str) -> io::Result<Link> {
    let mut request = vec![0; DESCRIPTION_BYTES];
    let name = CString::new(name)?;
    push_attribute(&mut request, libc::IFLA_IFNAME, name.as_bytes_with_nul());
    Ok(read(&ask(libc::RTM_GETLINK, 1, &request)?)) // NLM_F_REQUEST
}

/// Reads the kernel's answer.
fn read(answer: &[u8]) -> Link {
    let attributes = answer.get(DESCRIPTION_BYTES..).unwrap_or_default();
    let info = attribute(attributes, libc::IFLA_LINKINFO).unwrap_or_default();
    let of_can = attribute(info, INFO_DATA).unwrap_or_default();
    let number = |kind| word(attribute(of_can, kind)?, 0);
    // A mask comes before the modes.
    let modes = attribute(of_can, CONTROL_MODE).and_then(|modes| word(modes, 1));
    let has = |mode| modes.is_some_and(|modes| modes & mode != 0);
    let counters = |counters: &[u8]| {
        let (counters, _) = counters.as_chunks().0.split_first_chunk()?;
        Some(counters.map(u16::from_ne_bytes))
    };
    Link {
        is_can: u16::from_ne_bytes(bytes_at(answer, TYPE_AT)) == ARPHRD_CAN,
        is_up: word(answer, FLAGS_WORD).is_some_and(|flags| flags & 1 != 0), // IFF_UP
        is_virtual: attribute(info, INFO_KIND).is_some_and(|kind| VIRTUAL_KINDS.contains(&kind)),
        // A controller that was never configured has 0.
        bit_rate: number(BIT_TIMING).filter(|rate| *rate != 0),
        state: number(STATE).map(|state| match state {
            0 => CanState::ErrorActive,
            1 => CanState::ErrorWarning,
            2 => CanState::ErrorPassive,
            3 => CanState::BusOff,
            _ => CanState::Stopped,
        }),
        errors: attribute(of_can, ERROR_COUNTERS).and_then(counters),
        is_listen_only: has(LISTEN_ONLY),
        is_loopback: has(LOOPBACK),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answer about an interface that is up, with these attributes of CAN.
    fn answer(of_can: &[(u16, &[u32])]) -> Vec<u8> {
        answer_of(b"can\0", of_can)
    }

    fn answer_of(kind: &[u8], of_can: &[(u16, &[u32])]) -> Vec<u8> {
        let mut data = Vec::new();
        for (attribute, words) in of_can {
            let value = Vec::from_iter(words.iter().flat_map(|word| word.to_ne_bytes()));
            push_attribute(&mut data, *attribute, &value);
        }
        let mut info = Vec::new();
        push_attribute(&mut info, INFO_KIND, kind);
        push_attribute(&mut info, INFO_DATA, &data);
        let mut answer = vec![0; DESCRIPTION_BYTES];
        answer[TYPE_AT..][..2].copy_from_slice(&ARPHRD_CAN.to_ne_bytes());
        answer[4 * FLAGS_WORD..][..4].copy_from_slice(&1_u32.to_ne_bytes());
        push_attribute(&mut answer, libc::IFLA_IFNAME, b"can0\0");
        push_attribute(&mut answer, libc::IFLA_LINKINFO | 0x8000, &info);
        answer
    }

    #[test]
    fn each_value_of_a_controller_is_read() {
        let counters = u32::from_ne_bytes([128, 0, 3, 0]);
        let told = answer(&[
            (BIT_TIMING, &[500_000, 875]),
            (STATE, &[2]),
            (CONTROL_MODE, &[0, LISTEN_ONLY]),
            (ERROR_COUNTERS, &[counters]),
        ]);
        let expected = Link {
            is_can: true,
            is_up: true,
            is_virtual: false,
            bit_rate: Some(500_000),
            state: Some(CanState::ErrorPassive),
            errors: Some([128_u16.to_le(), 3_u16.to_le()]),
            is_listen_only: true,
            is_loopback: false,
        };
        assert_eq!(read(&told), expected);
    }

    #[test]
    fn an_interface_without_a_wire_is_known_by_its_kind() {
        let is_virtual = |kind: &[u8]| read(&answer_of(kind, &[])).is_virtual;
        assert!(is_virtual(b"vcan\0") && is_virtual(b"vxcan\0"));
        assert!(!is_virtual(b"can\0") && !is_virtual(b"slcan\0") && !is_virtual(b""));
    }

    #[test]
    fn each_state_has_its_number() {
        let states = [
            CanState::ErrorActive,
            CanState::ErrorWarning,
            CanState::ErrorPassive,
            CanState::BusOff,
            CanState::Stopped,
            CanState::Stopped,
        ];
        for (number, state) in (0..).zip(states) {
            assert_eq!(read(&answer(&[(STATE, &[number])])).state, Some(state));
        }
    }

    #[test]
    fn what_is_not_told_or_cut_short_is_not_known() {
        let up = Link {
            is_can: true,
            is_up: true,
            ..Link::default()
        };
        assert_eq!(read(&answer(&[])), up);
        assert_eq!(read(&answer(&[(BIT_TIMING, &[0])])), up);
        let told = answer(&[(BIT_TIMING, &[500_000]), (STATE, &[0])]);
        for length in 0..told.len() {
            let link = read(&told[..length]);
            assert_eq!((link.is_can, link.is_up), (length >= 4, length >= 12));
            assert!(link.bit_rate.is_none() && link.state.is_none());
        }
    }

    #[test]
    fn the_kernel_knows_the_loopback_interface_and_no_other_name() {
        let loopback = link("lo").unwrap();
        assert_eq!((loopback.bit_rate, loopback.state), (None, None));
        assert!(link("no_such_link").is_err());
        assert!(link("0123456789abcdef0").is_err());
    }
}
