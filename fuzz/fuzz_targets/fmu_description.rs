//! Any text as an FMU's modelDescription.xml: read or refused; a description that is read gives a proposed table,
//! which fits it.
#![no_main]

use std::collections::BTreeMap;

use fmu::Description;
use fmu::table::{proposed, wiring};
use libfuzzer_sys::fuzz_target;
use scenario::plant::Fmu;

type Plants = BTreeMap<String, BTreeMap<String, BTreeMap<String, Fmu>>>;

fuzz_target!(|text: &str| {
    let Ok(description) = Description::parse(text) else {
        return;
    };
    let _ = description.not_served();
    let proposed = proposed("plant", "a.fmu", &description);
    let tables: Plants = toml::from_str(&proposed).expect("what is proposed is TOML");
    // Start values outside their limits are the FMU's own, and are refused.
    let _ = wiring(&tables["plant"]["plant"]["fmu"], "plant", &description);
});
