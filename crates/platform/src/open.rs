//! Opening a bus by its address: the one place that knows all kinds of buses.

use can::Filter;

use crate::bus::{Bus, BusAddress, BusError};
use crate::embedded_bus::EmbeddedBus;
use crate::private_bus;
use crate::socketcan_bus::SocketCanBus;

/// Opens the bus for one participant, which receives the frames that one of `filters` accepts. A private bus is for a process
/// with a single thread, which enters its namespaces for good.
///
/// # Errors
/// With a message that names the missing part and a remedy.
pub fn open(address: &BusAddress, filters: &[Filter]) -> Result<Box<dyn Bus>, BusError> {
    Ok(match address {
        BusAddress::Interface(name) => Box::new(SocketCanBus::open(name, filters)?),
        BusAddress::Embedded(path) => Box::new(EmbeddedBus::open(path, filters)?),
        BusAddress::Private(process) => {
            private_bus::enter(*process).map_err(|source| BusError::System {
                address: address.clone(),
                action: "enter",
                source,
            })?;
            Box::new(SocketCanBus::open(private_bus::INTERFACE, filters)?)
        }
    })
}
