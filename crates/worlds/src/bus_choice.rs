//! Choice of the bus of a run.

use std::fmt;
use std::str::FromStr;

use platform::bus::BusAddress;
use platform::private_bus::PrivateBus;
use platform::probe;

use crate::error::WorldError;

/// Bus that the user asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusChoice {
    /// The best bus that this machine permits.
    Auto,
    /// A vcan in a namespace of the run.
    Private,
    /// A socket in a folder of the user, served by canrig.
    Embedded,
    /// A CAN interface of the kernel.
    Interface(String),
}

impl FromStr for BusChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "private" => Ok(Self::Private),
            "embedded" => Ok(Self::Embedded),
            name => match name.parse() {
                Ok(BusAddress::Interface(interface)) => Ok(Self::Interface(interface)),
                Ok(BusAddress::Embedded(_) | BusAddress::Private(_)) => {
                    Err("canrig makes such a bus itself; say `embedded` or `private`".to_owned())
                }
                Err(error) => Err(error.to_string()),
            },
        }
    }
}

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

/// Decides on the bus.
///
/// # Errors
/// If the requested bus is not available.
pub fn choose_bus(choice: &BusChoice, require_kernel: bool) -> Result<RunBus, WorldError> {
    if let BusChoice::Interface(name) = choice {
        // Opened once, so that a missing bus is reported before a run is made.
        let address = BusAddress::Interface(name.clone());
        return Ok(platform::open(&address, &[]).map(|_| RunBus::Interface(name.clone()))?);
    }
    if *choice == BusChoice::Private {
        return Ok(PrivateBus::start().map(|_| RunBus::Private)?);
    }
    let kernel = probe::kernel_can();
    let is_private = *choice == BusChoice::Auto && kernel.is_ok();
    // Made once to see whether it works: some systems grant the namespace and then deny its use.
    if is_private && PrivateBus::start().is_ok() {
        return Ok(RunBus::Private);
    }
    if require_kernel {
        return Err(WorldError::NoKernelCan(match kernel {
            Err(reason) => reason.to_string(),
            Ok(()) => "name the interface: --bus vcan0".to_owned(),
        }));
    }
    let why = match (choice, kernel) {
        (BusChoice::Embedded, _) => "as asked for",
        (_, Ok(())) => "a private CAN bus is not permitted here, see canrig doctor",
        (_, Err(_)) => "this kernel has no CAN",
    };
    Ok(RunBus::Embedded { why })
}
