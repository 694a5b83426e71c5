//! Any text as an FMU's modelDescription.xml: read or refused; what was read is proposed as a table, which fits it.
#![no_main]

use std::collections::BTreeMap;

use fmu::{Description, PlantTable};
use libfuzzer_sys::fuzz_target;

type Plants = BTreeMap<String, BTreeMap<String, BTreeMap<String, PlantTable>>>;

fuzz_target!(|text: &str| {
    let Ok(description) = Description::parse(text) else {
        return;
    };
    let _ = description.not_served();
    let proposed = PlantTable::proposed("plant", "a.fmu", &description);
    let tables: Plants = toml::from_str(&proposed).expect("what is proposed is TOML");
    // Start values outside their limits are the FMU's own, and are refused.
    let _ = tables["plant"]["plant"]["fmu"].wiring("plant", &description);
});
