//! Which bus a run uses, and why.

use std::fmt;

use platform::bus::{self, BusAddress};
use platform::probe;

use super::WorldError;
use crate::cli::BusChoice;

/// The bus of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunBus {
    /// A socket in a folder of the user's own, served by canrig.
    Embedded {
        /// Why this one.
        why: &'static str,
    },
    /// A CAN interface of the kernel.
    Interface(String),
}

impl fmt::Display for RunBus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Embedded { why } => write!(formatter, "embedded ({why})"),
            Self::Interface(name) => write!(formatter, "{name} (the kernel's SocketCAN)"),
        }
    }
}

/// Decides on the bus.
///
/// # Errors
/// The bus that was asked for is not to be had.
pub fn choose_bus(choice: &BusChoice, require_kernel: bool) -> Result<RunBus, WorldError> {
    if let BusChoice::Interface(name) = choice {
        // Opened once, so that a missing bus is told before a run is made.
        let address = BusAddress::Interface(name.clone());
        return Ok(bus::open(&address, &[]).map(|_| RunBus::Interface(name.clone()))?);
    }
    let kernel = probe::kernel_can();
    if require_kernel {
        return Err(WorldError::NoKernelCan(match kernel {
            Err(reason) => reason.to_string(),
            Ok(()) => "name the interface: --bus vcan0".to_owned(),
        }));
    }
    let why = match (choice, kernel) {
        (BusChoice::Embedded, _) => "as asked for",
        (_, Ok(())) => "private to this run; --bus vcan0 for the kernel's",
        (_, Err(_)) => "this kernel has no CAN",
    };
    Ok(RunBus::Embedded { why })
}
