//! Any frames at any times: drive and disturbance module still obey NMT and answer SDO, and a reset drive has no current.
#![no_main]

use canrig_fuzz::{Journey, SCENARIO, expect_alive};
use libfuzzer_sys::fuzz_target;
use plant_emulator::catalogue;
use plant_emulator::plant::CURRENT;

fuzz_target!(|bytes: &[u8]| {
    let mut journey = Journey::new(catalogue::emulator(&SCENARIO).expect("the plant is valid"));
    journey.travel(bytes);
    expect_alive(&mut journey, 0x10, 0x0002_0192);
    assert_eq!(journey.node.inputs()[CURRENT], 0.0);
    expect_alive(&mut journey, 0x11, 0x0108_0191);
});
