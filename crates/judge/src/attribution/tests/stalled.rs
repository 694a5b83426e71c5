//! Outcomes of runs with stalls.

use std::time::Duration;

use can::CanFrame;
use plan::Plan;
use recording::latency::Host;
use recording::log::Stamped;
use recording::stalls::{NodeName, Who};
use recording::timeline::decode;

use super::{Cycle, Held, frames, setup};
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
    judged(answered(&frames(cycles)), plan, held, on_this_machine)
}

fn judged(frames: Vec<Stamped>, plan: &Plan, held: &[Held], on_this_machine: &[&str]) -> Verdict {
    let timelines = decode(&frames.into(), plan).unwrap();
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

/// The process of a node that canrig did not start is not watched, and stands still with the machine. On a wire it has a
/// machine of its own.
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

/// Stalls of 5 ms each 30 ms, with a period of 10 ms: the controller ran between them, and sent its
/// SYNC.
#[test]
fn stalls_excuse_no_more_frames_than_were_due_in_them() {
    let plan = setup(CYCLES, &[], &["controller"]);
    let stalls = Vec::from_iter((0..66).map(|number| Held {
        from: 30 * number,
        length: 5,
        who: Who::Machine,
    }));
    let sound = answered(&frames(&[Cycle::Served; CYCLES]));
    for (from, until) in [(1.0, 2.0), (0.5, 1.5)] {
        let is_left_out = |stamped: &&Stamped| {
            let time = stamped.time.as_secs_f64() - 1.7e9;
            stamped.frame.standard_id() == Some(0x210) && (from..until).contains(&time)
        };
        let sent = sound
            .iter()
            .filter(|stamped| !is_left_out(stamped))
            .copied();
        let verdict = judged(sent.collect(), &plan, &stalls, &[]);
        let cause = verdict.cause.unwrap();
        let found = (verdict.outcome, cause.node.as_str(), cause.duty.as_str());
        assert_eq!(found, (Outcome::Fail, "controller", "command"), "{from}");
    }
}

/// A stall of 50 ms explains six frames, not those that follow it.
#[test]
fn what_is_missing_behind_a_stall_is_the_nodes_own() {
    let plan = setup(CYCLES, &[], &["drive"]);
    let held = Held {
        from: 500,
        length: 50,
        who: Who::Machine,
    };
    let missing = |count: usize| {
        let mut cycles = vec![Cycle::Served; CYCLES];
        cycles[50..50 + count].fill(Cycle::WithoutPosition);
        let verdict = verdict(&cycles, &plan, &[held], &[]);
        (verdict.outcome, verdict.cause.map(|cause| cause.node))
    };
    assert_eq!(missing(6), (Outcome::Inconclusive, Some("host".to_owned())));
    // More than 1 % of the cycles.
    assert_eq!(missing(9), (Outcome::Fail, Some("drive".to_owned())));
}

/// The process of a program that plays a drive explains what this drive left out, and nothing of
/// another node.
#[test]
fn a_stall_of_a_nodes_own_process_explains_its_breaches_alone() {
    let plan = setup(CYCLES, &[], &["drive"]);
    let mut cycles = vec![Cycle::Served; CYCLES];
    cycles[50..56].fill(Cycle::WithoutPosition);
    let outcome = |who: Who| {
        let held = Held {
            from: 500,
            length: 60,
            who,
        };
        verdict(&cycles, &plan, &[held], &[]).outcome
    };
    let node = |name| NodeName::new(name).map(Who::Node).unwrap();
    assert_eq!(outcome(node("drive")), Outcome::Inconclusive);
    for other in [node("other"), Who::Controller, Who::PlantEmulator] {
        assert_eq!(outcome(other), Outcome::Fail);
    }
}
