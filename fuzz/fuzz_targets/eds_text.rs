//! Any text as EDS: read or refused, and a device made of what was read boots.
#![no_main]

use std::time::Duration;

use canopen::{Application, Device, NodeId, eds};
use canrig_fuzz::Journey;
use libfuzzer_sys::fuzz_target;

struct Passive;

impl Application for Passive {}

fuzz_target!(|input: (u8, &str)| {
    let (number, text) = input;
    let Ok(dictionary) = eds::parse(text, number) else {
        return;
    };
    let node_id = NodeId::new(number).expect("other numbers are refused");
    if let Ok(device) = Device::new(node_id, dictionary, Passive) {
        Journey::new(device).pass(Duration::from_millis(5));
    }
});
