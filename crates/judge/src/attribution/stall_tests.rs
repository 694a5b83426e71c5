//! Outcomes of runs with stalls.

use std::time::Duration;

use can::CanFrame;
use plan::Plan;
use recording::latency::Host;
use recording::log::Stamped;
use recording::stalls::Who;
use recording::timeline::decode;

use super::tests::{Cycle, Held, frames, setup};
use crate::circumstances::Circumstances;
use crate::decision::judge;
use crate::verdict::{Outcome, Verdict};

const CYCLES: usize = 200;
/// Stall of 1 % of the run, far from the cycles that are missed below.
const STALL: Held = Held {
    from: 1500,
    length: 20,
    who: Who::Machine,
};

fn verdict(cycles: &[Cycle], plan: &Plan, held: &[Held], on_this_machine: &[&str]) -> Verdict {
    let timelines = decode(&answered(&frames(cycles)).into(), plan).unwrap();
    let circumstances = Circumstances {
        host: Host {
            stalls: held.iter().map(|held| held.stall()).collect(),
            on_this_machine: on_this_machine.iter().map(ToString::to_string).collect(),
            ..Host::default()
        },
        ..Circumstances::default()
    };
    judge(plan, &timelines, &circumstances)
}

/// Returns the frames with a command after each position.
fn answered(frames: &[Stamped]) -> Vec<Stamped> {
    let command = |position: &Stamped| {
        let time = position.time + Duration::from_micros(100);
        Stamped::new(time, CanFrame::new(0x210, &[0x0F, 0, 0, 0]))
    };
    let each = frames.iter().flat_map(|stamped| {
        let is_position = stamped.frame.standard_id() == Some(0x190);
        [Some(*stamped), is_position.then(|| command(stamped))]
    });
    each.flatten().collect()
}

/// Returns cycles of which each tenth lacks a frame, but the last ones.
fn scattered(missing: Cycle) -> Vec<Cycle> {
    let mut cycles = vec![Cycle::Served; CYCLES];
    for cycle in (20..120).step_by(10) {
        cycles[cycle] = missing;
    }
    cycles
}

/// Nobody watches the process of such a node, which stands still with the machine. On a wire it has a machine of its own.
#[test]
fn scattered_breaches_of_a_node_of_this_machine_are_open_where_stalls_are_not_trusted() {
    for (node, missing) in [
        ("drive", Cycle::WithoutPosition),
        ("controller", Cycle::WithoutSync),
    ] {
        let plan = setup(CYCLES, &[], &[node]);
        let cycles = scattered(missing);
        let outcome = |held: &[Held], on_this_machine: &[&str]| {
            let verdict = verdict(&cycles, &plan, held, on_this_machine);
            let cause = verdict.cause.unwrap();
            (verdict.outcome, cause.node)
        };
        let open = (Outcome::Inconclusive, "host".to_owned());
        let guilty = (Outcome::Fail, node.to_owned());
        assert_eq!(outcome(&[STALL], &[node]), open);
        assert_eq!(outcome(&[STALL], &[]), guilty, "on a wire");
        assert_eq!(outcome(&[], &[node]), guilty, "the machine was quiet");
        // 0.05 % of the run.
        let short = Held { length: 1, ..STALL };
        assert_eq!(outcome(&[short], &[node]), guilty);
    }
}

#[test]
fn a_silence_to_the_end_is_not_open_because_of_stalls_elsewhere() {
    for (node, missing) in [
        ("drive", Cycle::WithoutPosition),
        ("controller", Cycle::WithoutSync),
    ] {
        let plan = setup(CYCLES, &[], &[node]);
        let mut cycles = scattered(missing);
        cycles[190..].fill(missing);
        let verdict = verdict(&cycles, &plan, &[STALL], &[node]);
        assert_eq!(verdict.outcome, Outcome::Fail);
        let cause = verdict.cause.unwrap();
        assert_eq!((cause.node.as_str(), cause.at_seconds), (node, Some(1.9)));
    }
}
