//! Choice of the bus of a run.

use std::fmt;

use platform::bus::BusAddress;
use platform::private_bus::PrivateBus;
use platform::probe;

use crate::error::WorldError;

/// Bus of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunBus {
    /// A socket in a folder of the user, served by canrig.
    Embedded {
        /// Reason for this choice.
        why: &'static str,
    },
    /// A CAN interface of the kernel.
    Interface(String),
    /// A vcan in namespaces that only this run sees.
    Private,
}

impl fmt::Display for RunBus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Embedded { why } => write!(formatter, "embedded ({why})"),
            Self::Private => formatter.write_str("private (a vcan that only this run sees)"),
            Self::Interface(name) => write!(formatter, "{name} (the kernel's SocketCAN)"),
        }
    }
}

/// Bus that the user asks for; `None` for the best one that this machine permits.
pub type BusChoice = Option<RunBus>;

/// Parses the bus that the user asks for.
///
/// # Errors
/// If the text names none.
pub fn parse_bus(text: &str) -> Result<BusChoice, String> {
    let why = "as asked for";
    match text {
        "auto" => Ok(None),
        "private" => Ok(Some(RunBus::Private)),
        "embedded" => Ok(Some(RunBus::Embedded { why })),
        name => match name.parse()? {
            BusAddress::Interface(interface) => Ok(Some(RunBus::Interface(interface))),
            BusAddress::Embedded(_) | BusAddress::Private(_) => {
                Err("canrig makes such a bus itself; say `embedded` or `private`".to_owned())
            }
        },
    }
}

/// Decides on the bus.
///
/// # Errors
/// If the requested bus is not available.
pub fn choose_bus(choice: &BusChoice, require_kernel: bool) -> Result<RunBus, WorldError> {
    // Opened or made once, so that a missing bus is reported before a run is made.
    match choice {
        Some(RunBus::Interface(name)) => {
            platform::open(&BusAddress::Interface(name.clone()), &[])?;
        }
        Some(RunBus::Private) => drop(PrivateBus::start().map_err(WorldError::Private)?),
        Some(RunBus::Embedded { .. }) | None => {}
    }
    let kernel = probe::kernel_can();
    match choice {
        Some(RunBus::Embedded { .. }) if require_kernel => {}
        Some(bus) => return Ok(bus.clone()),
        // Some systems grant the namespace and then deny its use.
        None if kernel.is_ok() && PrivateBus::start().is_ok() => return Ok(RunBus::Private),
        None => {}
    }
    if require_kernel {
        return Err(WorldError::NoKernelCan(match kernel {
            Err(reason) => reason.to_string(),
            Ok(()) => "name the interface: --bus vcan0".to_owned(),
        }));
    }
    let why = match kernel {
        Ok(()) => "a private CAN bus is not permitted here, see canrig doctor",
        Err(_) => "this kernel has no CAN",
    };
    Ok(RunBus::Embedded { why })
}
