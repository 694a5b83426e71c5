//! Any frames at any times as the recording of a run: decoded and judged, and the verdict survives being written.
#![no_main]

use std::sync::LazyLock;
use std::time::Duration;

use canrig_fuzz::steps;
use judge::{Circumstances, judge};
use judge::verdict::Verdict;
use libfuzzer_sys::fuzz_target;
use recording::log::Stamped;
use recording::timeline;
use plan::Plan;
use scenario::Trial;
use worlds::catalogue::catalogue;

static PLAN: LazyLock<Plan> = LazyLock::new(|| {
    let text = include_str!("../../scenarios/fan.toml");
    let no_table = |_: &str| Err(std::io::ErrorKind::NotFound.into());
    let scenario = Trial::parse(text, "fan.toml", no_table).expect("the scenario is valid");
    Plan::new(scenario, catalogue())
});

fuzz_target!(|bytes: &[u8]| {
    let mut now = Duration::ZERO;
    let frames: Vec<Stamped> = steps(bytes)
        .map(|step| {
            now += step.pause;
            Stamped::new(now, step.frame)
        })
        .collect();
    let timelines = timeline::decode(&frames.into(), &PLAN).expect("the rig's own database");
    let verdict = judge(&PLAN, &timelines, &Circumstances::default());
    let read = Verdict::from_json(&verdict.to_json()).expect("our own verdict is valid");
    assert_eq!(read.to_json(), verdict.to_json());
});
