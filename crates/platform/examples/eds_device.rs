//! A CANopen device with the objects of an EDS and no application, until its standard input ends:
//! `cargo run --release -p platform --example eds_device -- vcan0 0x20 device.eds`.

use std::error::Error;

use can::Node;
use canopen::{Application, Device, NodeId, eds};
use platform::stop::StopSignal;

/// Application that leaves every object to its readers and writers.
struct Passive;

impl Application for Passive {}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, node_id, path] = arguments.as_slice() else {
        return Err("usage: eds_device BUS NODE-ID EDS".into());
    };
    let node_id = match node_id.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16)?,
        None => node_id.parse()?,
    };
    let node_id = NodeId::new(node_id).ok_or("a node-ID is 1 to 127")?;
    let dictionary = eds::parse(&std::fs::read_to_string(path)?, node_id.get())?;
    let mut device = Device::new(node_id, dictionary, Passive)?;
    let mut bus = platform::open(&address.parse()?, &device.filters())?;
    let stop = StopSignal::from_parent()?;
    platform::real_time::run(&mut device, &mut *bus, &stop)?;
    Ok(())
}
