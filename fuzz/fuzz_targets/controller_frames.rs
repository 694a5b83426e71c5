//! Any frames at any times: the controller never panics, and when it is asked to stop it ends.
#![no_main]

use std::time::Duration;

use can::{Node, Progress};
use canrig_fuzz::{Journey, SCENARIO};
use controller::controller_node;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut journey = Journey::new(
        controller_node(&SCENARIO.controller_view()).expect("the controller is valid"),
    );
    journey.travel(bytes);
    journey.node.on_stop(journey.now);
    journey.pass(Duration::from_secs(1));
    assert_ne!(
        journey.node.progress(),
        Progress::Running,
        "it does not stop"
    );
});
