//! Any text as scenario or rig file: refused, or read, and nodes made of it or refused.
#![no_main]

use controller::controller_node;
use libfuzzer_sys::fuzz_target;
use plant_emulator::catalogue;
use scenario::rig::drive::DriveLayout;
use scenario::rig::nodes::Rig;
use scenario::Trial;

const TABLE: &str = "time_seconds,position_millimetres\n0,10\n1,20\n";

fuzz_target!(|text: &str| {
    if let Ok(rig) = Rig::parse(text, "fuzz.toml") {
        for real in rig.node.keys().filter_map(|name| rig.real_drive(name)) {
            if let Ok(dictionary) = dbc::dictionary(dbc::DRIVE_EDS, real.node_id) {
                let _ = DriveLayout::new(dictionary, &real);
            }
        }
    }
    let Ok(scenario) = Trial::parse(text, "fuzz.toml", |_| Ok(TABLE.to_owned())) else {
        return;
    };
    let _ = catalogue::emulator(&scenario);
    let _ = controller_node(&scenario.controller_view());
});
