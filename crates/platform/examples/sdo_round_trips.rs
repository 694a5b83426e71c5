//! How many SDO uploads of 0x1000 per second one client gets from a node on a bus:
//! `cargo run --release -p platform --example sdo_round_trips -- vcan0 0x10 3`.
#![expect(clippy::print_stdout, reason = "a program that shows a number")]

use std::error::Error;
use std::time::Duration;

use can::Filter;
use canopen::sdo_client::SdoClient;
use platform::bus::Bus;
use platform::clock::Clock;

const DEVICE_TYPE: u16 = 0x1000;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, node_id, seconds] = arguments.as_slice() else {
        return Err("usage: sdo_round_trips BUS NODE-ID SECONDS".into());
    };
    let node_id = match node_id.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16)?,
        None => node_id.parse()?,
    };
    let mut client = SdoClient::new(node_id);
    let mut bus = platform::open(&address.parse()?, &[Filter::exact(client.response_id())])?;
    let end = Duration::from_secs(seconds.parse()?);
    let clock = Clock::start();
    let mut count = 0_u32;
    let mut now = Duration::ZERO;
    while now < end {
        client.start_upload(now, (DEVICE_TYPE, 0))?;
        now = finish(&mut client, &mut *bus, &clock, now)?;
        count += 1;
    }
    println!("{:.0}", f64::from(count) / now.as_secs_f64());
    Ok(())
}

/// Carries a transfer that began at `now` to its end; returns the time of the end.
fn finish(
    client: &mut SdoClient,
    bus: &mut dyn Bus,
    clock: &Clock,
    mut now: Duration,
) -> Result<Duration, Box<dyn Error>> {
    loop {
        while let Some(frame) = client.next_frame() {
            bus.send(&frame)?;
        }
        if let Some(result) = client.take_result() {
            result?;
            return Ok(now);
        }
        let patience = client.next_deadline().unwrap_or_default();
        let frame = bus.receive(patience.saturating_sub(now))?;
        now = clock.now();
        match frame {
            Some(frame) => client.on_frame(now, &frame),
            None => client.on_tick(now),
        }
    }
}
