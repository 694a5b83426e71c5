//! Any frames at any times: drive and disturbance module still obey NMT and answer SDO, and a reset drive has no current.
#![no_main]

use canrig_fuzz::{Journey, SCENARIO, expect_alive};
use libfuzzer_sys::fuzz_target;
use plant_emulator::PlantEmulator;
use plant_emulator::plant::CURRENT;
use plant_emulator::plants::sma::Actuator;

fuzz_target!(|bytes: &[u8]| {
    let mut journey = Journey::new(PlantEmulator::new::<Actuator>(&SCENARIO, &scenario::plant::Sma::default()).expect("the plant is valid"));
    journey.travel(bytes);
    expect_alive(&mut journey, 0x10, 0x0002_0192);
    assert_eq!(journey.node.inputs()[CURRENT], 0.0);
    expect_alive(&mut journey, 0x11, 0x0108_0191);
});
