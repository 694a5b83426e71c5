//! Any text as scenario: refused, or read by bench and controller alike, and nodes made of it or refused.
#![no_main]

use controller::ControllerNode;
use libfuzzer_sys::fuzz_target;
use plant_emulator::PlantEmulator;
use scenario::{ControllerView, Scenario};

const TABLE: &str = "time_seconds,position_millimetres\n0,10\n1,20\n";

fuzz_target!(|text: &str| {
    let Ok(scenario) = Scenario::parse(text, "fuzz.toml", |_| Ok(TABLE.to_owned())) else {
        return;
    };
    let view = ControllerView::parse(text, "fuzz.toml", |_| Ok(TABLE.to_owned()));
    assert_eq!(view.expect("the bench reads it"), scenario.controller_view());
    let _ = PlantEmulator::new(&scenario);
    let _ = ControllerNode::new(&scenario.controller_view());
});
