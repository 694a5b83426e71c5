//! Any requests to a device with an object of any length: afterwards it answers a read, at the latest after its time-out.
#![no_main]

use std::time::Duration;

use can::CanFrame;
use canopen::{Application, Device, NodeId, eds};
use canrig_fuzz::{Journey, expect_alive};
use libfuzzer_sys::fuzz_target;

const EDS: &str = include_str!("../../tests/oracle/store.eds");
const ID: NodeId = NodeId::new(0x20).expect("32 is a node-ID");

struct Passive;

impl Application for Passive {}

fuzz_target!(|bytes: &[u8]| {
    let dictionary = eds::parse(EDS, ID.get()).expect("the EDS is valid");
    let device = Device::new(ID, dictionary, Passive).expect("it has no PDO");
    let mut journey = Journey::new(device);
    for payload in bytes.chunks(8).take(2000) {
        // The object of any length and the heartbeat's time are the interesting ones.
        let mut request = [0; 8];
        request[..payload.len()].copy_from_slice(payload);
        journey.deliver(&CanFrame::new(0x620, &request));
    }
    journey.pass(Duration::from_secs(2));
    let read = CanFrame::new(0x620, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    let answer = CanFrame::new(0x5A0, &[0x43, 0, 0x10, 0, 0, 0, 0, 0]);
    assert!(
        journey.deliver(&read).contains(&answer),
        "no answer after the time-out"
    );
    expect_alive(&mut journey, ID.get(), 0);
});
