//! Reports of a CAN driver about the bus itself, by the error messages of `linux/can/error.h`. The modelled bus reports in the
//! same form.

use crate::CanFrame;

/// Transmission timed out.
const TRANSMIT_TIMEOUT: u32 = 0x001;
/// Arbitration was lost.
const ARBITRATION_LOST: u32 = 0x002;
/// The state of the CAN controller is in data[1].
pub const CONTROLLER: u32 = 0x004;
/// A violation of the protocol is in data[2].
const PROTOCOL: u32 = 0x008;
/// The transceiver's state is in data[4].
const TRANSCEIVER: u32 = 0x010;
/// A frame was not acknowledged.
const NO_ACKNOWLEDGEMENT: u32 = 0x020;
/// The CAN controller no longer takes part in the bus.
pub const BUS_OFF: u32 = 0x040;
/// An error of the bus, not described further.
const BUS_ERROR: u32 = 0x080;
/// The CAN controller takes part again.
pub const RESTARTED: u32 = 0x100;

/// data[1]: too many errors on reception.
pub const RECEIVE_PASSIVE: u8 = 0x10;
/// data[1]: too many errors on transmission.
pub const TRANSMIT_PASSIVE: u8 = 0x20;
/// data[1]: few errors again.
pub const BACK_TO_ACTIVE: u8 = 0x40;

/// States of the CAN controller by the bits of data[1].
const STATES: [(u8, &str); 5] = [
    (0x01, "receive buffer overflow"),
    (0x02, "transmit buffer overflow"),
    (0x04 | 0x08, "error warning"),
    (RECEIVE_PASSIVE | TRANSMIT_PASSIVE, "error passive"),
    (BACK_TO_ACTIVE, "error active"),
];

/// Errors other than states, by the class.
const ERRORS: [(u32, &str); 5] = [
    (NO_ACKNOWLEDGEMENT, "no acknowledgement"),
    (TRANSMIT_TIMEOUT, "transmission timed out"),
    (TRANSCEIVER, "transceiver fault"),
    (BUS_ERROR, "bus error"),
    (ARBITRATION_LOST, "arbitration lost"),
];

/// Violations of the protocol by the bits of data[2].
const VIOLATIONS: [(u8, &str); 4] = [
    (0x01 | 0x08 | 0x10, "bit error"),
    (0x02, "form error"),
    (0x04, "stuff error"),
    (0x20, "overload"),
];

/// Message of a driver.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMessage {
    /// Node-ID of the node whose CAN controller it is about, on the modelled bus; 0 for the bench's own interface.
    pub node: u8,
    /// Description for the reader: states first, then errors.
    pub text: String,
    /// Whether it reports a recovery, or belongs to a healthy bus.
    pub is_good: bool,
    /// Whether it reports a change of state, which comes once; other errors come with each frame.
    pub is_state: bool,
}

/// Reads an error message; `None` if the frame is an ordinary one.
#[inline]
pub fn read(frame: &CanFrame) -> Option<ErrorMessage> {
    frame.is_error().then(|| describe(frame))
}

fn describe(frame: &CanFrame) -> ErrorMessage {
    let class = frame.raw_id();
    let [_, controller, protocol, _, _, node, ..] = frame.buffer();
    let has = |class_bit: u32| class & class_bit != 0;
    let named_bits = |bits: u8, names: &[(u8, &'static str)]| {
        let set = names.iter().filter(move |(mask, _)| bits & mask != 0);
        set.map(|(_, name)| *name).collect::<Vec<_>>()
    };
    let named_class = |names: &[(u32, &'static str)]| {
        let set = names.iter().filter(|(bit, _)| has(*bit));
        set.map(|(_, name)| *name).collect::<Vec<_>>()
    };
    let mut details = named_class(&[(BUS_OFF, "bus-off"), (RESTARTED, "back from bus-off")]);
    if has(CONTROLLER) {
        details.extend(named_bits(controller, &STATES));
    }
    let is_state = !details.is_empty();
    details.extend(named_class(&ERRORS));
    if has(PROTOCOL) {
        details.extend(named_bits(protocol, &VIOLATIONS));
    }
    let is_good = matches!(
        details.as_slice(),
        ["back from bus-off" | "error active" | "arbitration lost"]
    );
    if details.is_empty() {
        details.push("error without details");
    }
    ErrorMessage {
        node,
        text: details.join(", "),
        is_good,
        is_state,
    }
}

#[cfg(test)]
mod tests {
    use crate::frame::ERROR_FLAG;

    use super::*;

    fn message(class: u32, controller: u8, protocol: u8) -> ErrorMessage {
        let data = [0, controller, protocol, 0, 0, 0, 0, 0];
        read(&CanFrame::from_raw(ERROR_FLAG | class, 8, data).unwrap()).unwrap()
    }

    #[test]
    fn an_ordinary_frame_is_none() {
        assert_eq!(read(&CanFrame::new(0x004, &[0, 0x10])), None);
    }

    #[test]
    fn states_are_reported_as_changes() {
        let off = message(BUS_OFF, 0, 0);
        assert_eq!(
            (off.text.as_str(), off.is_good, off.is_state),
            ("bus-off", false, true)
        );
        let back = message(RESTARTED, 0, 0);
        assert_eq!(
            (back.text.as_str(), back.is_good),
            ("back from bus-off", true)
        );
        let warning = message(CONTROLLER, 0x08, 0);
        assert_eq!(
            (warning.text.as_str(), warning.is_good),
            ("error warning", false)
        );
    }

    #[test]
    fn what_comes_with_each_frame_is_no_state() {
        let alone = message(NO_ACKNOWLEDGEMENT | PROTOCOL | BUS_ERROR, 0, 0x04);
        assert_eq!(alone.text, "no acknowledgement, bus error, stuff error");
        assert!(!alone.is_state && !alone.is_good);
        assert!(message(ARBITRATION_LOST, 0, 0).is_good);
        assert_eq!(message(0, 0, 0).text, "error without details");
    }
}
