//! State of a CAN interface as the kernel reports it (netlink): error state, bit rate and error counters.

use std::io;

use socketcan::CanInterface;
use socketcan::nl::CanCtrlMode;
/// Error state of a CAN controller, by the kernel's names.
pub use socketcan::nl::CanState;

/// CAN interface. A value that its driver does not report is `None`; a vcan reports only whether it is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Link {
    /// Whether the interface is up.
    pub is_up: bool,
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
    let details = CanInterface::open(name)
        .and_then(|interface| interface.details())
        .map_err(io::Error::other)?;
    let can = details.can;
    let has = |mode| can.ctrl_mode.is_some_and(|modes| modes.has_mode(mode));
    Ok(Link {
        is_up: details.is_up,
        // A controller that was never configured has 0.
        bit_rate: can
            .bit_timing
            .map(|timing| timing.bitrate)
            .filter(|rate| *rate != 0),
        state: can.state,
        errors: can
            .berr_counter
            .map(|counter| [counter.txerr, counter.rxerr]),
        is_listen_only: has(CanCtrlMode::ListenOnly),
        is_loopback: has(CanCtrlMode::Loopback),
    })
}
