//! Opening a bus by its address: the one place that knows all kinds of buses.

use can::Filter;

use crate::bus::{Bus, BusAddress, BusError};
use crate::private_bus;
use crate::socket_bus::{SocketBus, open_socket};

/// Opens the bus for one participant, which receives the frames that one of `filters` accepts. A private bus is for a process
/// with a single thread, which enters its namespaces for good.
///
/// # Errors
/// With a message that names the missing part and a remedy.
pub fn open(address: &BusAddress, filters: &[Filter]) -> Result<Box<dyn Bus>, BusError> {
    let on_interface = |name: &str| SocketBus::on_interface(name, open_socket(name)?, filters);
    Ok(Box::new(match address {
        BusAddress::Interface(name) => on_interface(name)?,
        BusAddress::Embedded(path) => SocketBus::on_hub(path, filters)?,
        BusAddress::Private(process) => {
            private_bus::enter(*process)
                .map_err(|source| BusError::system(address, "enter", source))?;
            on_interface(private_bus::INTERFACE)?
        }
    }))
}
