use std::collections::BTreeSet;
use std::time::Duration;

use can::CanFrame;
use dbc::Database;
use plan::Plan;
use proptest::prelude::*;
use recording::hits::Hits;
use recording::latency::{Host, NodeReport};
use recording::log::Stamped;
use recording::losses::LostHeartbeat;
use recording::timeline::decode;
use recording::unrecorded::Unrecorded;

use super::*;

mod stalled;

const PERIOD_MICROS: u64 = 10_000;
/// Scenario time 0 on the recording's clock.
const ZERO_MICROS: u64 = 1_700_000_000_000_000;
const OPERATION_ENABLED: f64 = 39.0;

/// Event of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cycle {
    Served,
    WithoutPosition,
    WithoutSync,
}

/// Stall in milliseconds of scenario time, which may begin before time 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    pub(super) from: i64,
    pub(super) length: u32,
    pub(super) who: Who,
}

fn micros(micros: u64) -> Duration {
    Duration::from_micros(micros)
}

impl Held {
    pub(super) fn stall(self) -> Stall {
        let from = micros(ZERO_MICROS.checked_add_signed(1000 * self.from).unwrap());
        let until = from + micros(1000 * u64::from(self.length));
        Stall::new(from, until, self.who, What::Waited)
    }
}

pub(super) fn setup(cycles: usize, faults: &[(u32, u32)], external: &[&str]) -> Plan {
    let seconds = 0.01 * f64::from(u32::try_from(cycles).unwrap());
    let mut text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"m\"\nduration_seconds = {seconds:.2}\n[bus]\nsync_period_milliseconds = 10.0\n[controller.open_loop]\n"
    );
    for (from, until) in faults {
        let [from, until] = [from, until].map(|centis| f64::from(*centis) / 100.0);
        text += &format!(
            "[[fault.node.crash]]\nnode = \"controller\"\nfrom_seconds = {from:.2}\nuntil_seconds = {until:.2}\n"
        );
    }
    let external = external.iter().map(ToString::to_string);
    testing::plan(&text).recorded_external(&Vec::from_iter(external))
}

/// Returns the recording of these cycles, of which the first has its SYNC, and of a frame at the end.
pub(super) fn frames(cycles: &[Cycle]) -> Vec<Stamped> {
    let database = Database::shipped();
    let signal = |path| database.signal(path).unwrap();
    let mut message = database.builder("drive_tpdo1").unwrap();
    message.set(&signal("drive_tpdo1.statusword_state"), OPERATION_ENABLED);
    message.set(&signal("drive_tpdo1.position_millimetres"), 10.0);
    let position = message.frame();
    let mut frames = vec![Stamped::new(micros(ZERO_MICROS - 100), position)];
    for (place, cycle) in (0..).zip(cycles) {
        let begins = ZERO_MICROS + place * PERIOD_MICROS;
        if *cycle != Cycle::WithoutSync {
            frames.push(Stamped::new(micros(begins), CanFrame::new(0x080, &[])));
        }
        if *cycle == Cycle::Served {
            frames.push(Stamped::new(micros(begins + 130), position));
        }
    }
    let end = ZERO_MICROS + cycles.len() as u64 * PERIOD_MICROS + 50;
    frames.push(Stamped::new(micros(end), CanFrame::new(0x710, &[5])));
    frames
}

/// Returns the places of two spans that touch, the first one first.
fn overlapping(spans: &[(i64, i64)]) -> Option<(usize, usize)> {
    let pairs = (0..spans.len()).flat_map(|one| (one + 1..spans.len()).map(move |two| (one, two)));
    let touch = |(one, two): &(usize, usize)| {
        let ((from, until), (begins, ends)) = (spans[*one], spans[*two]);
        begins <= until && from <= ends
    };
    pairs.into_iter().find(touch)
}

/// The missed cycles that stalls explain, in whole milliseconds.
fn allowed(cycles: &[Cycle], held: &[Held], external: &[&str]) -> BTreeSet<u32> {
    let is_felt = |held: &&Held, cycle: Cycle| match (held.who, cycle) {
        (Who::Machine | Who::Bus, _) | (Who::Controller, Cycle::WithoutSync) => true,
        (Who::PlantEmulator, Cycle::WithoutSync) => false,
        _ => !external.contains(&"drive"),
    };
    // A stall held something up in half of the milliseconds of the cycle, or its burst came in them.
    let is_covered = |number: u32, cycle: Cycle| {
        let begins = 10 * i64::from(number);
        let is_held = |milli: &i64| {
            let covers =
                |held: &Held| (held.from..held.from + i64::from(held.length) + 20).contains(milli);
            held.iter().filter(|held| is_felt(held, cycle)).any(covers)
        };
        (begins..begins + 10).filter(is_held).count() >= 5
    };
    // Stalls that overlap are one, and explain each missing frame that was due in them once.
    let mut allowed = BTreeSet::new();
    for kind in [Cycle::WithoutSync, Cycle::WithoutPosition] {
        let felt = held.iter().filter(|held| is_felt(held, kind));
        let ends = felt.map(|held| (held.from, held.from + i64::from(held.length)));
        let mut spans = Vec::from_iter(ends);
        while let Some((one, other)) = overlapping(&spans) {
            let (from, until) = spans.swap_remove(other);
            spans[one] = (spans[one].0.min(from), spans[one].1.max(until));
        }
        spans.sort_unstable();
        let mut explained = vec![0; spans.len()];
        for (number, cycle) in (0_u32..).zip(cycles) {
            if *cycle != kind || !is_covered(number, kind) {
                continue;
            }
            let begins = 10 * i64::from(number);
            let may = |place: &usize| {
                let (from, until) = spans[*place];
                let is_near = from <= begins + 10 && begins <= until + 20;
                is_near && explained[*place] < 1 + (until - from) / 10
            };
            if let Some(place) = (0..spans.len()).find(may) {
                explained[place] += 1;
                allowed.insert(number);
            }
        }
    }
    allowed
}

/// Attributes each missed cycle by going through everything for it, in whole milliseconds.
fn slow(
    cycles: &[Cycle],
    held: &[Held],
    faults: &[(u32, u32)],
    external: &[&str],
) -> Vec<(f64, &'static str)> {
    let allowed = allowed(cycles, held, external);
    let is_held = |number: u32| allowed.contains(&number);
    let mut whose: Vec<(f64, &'static str, bool)> = Vec::new();
    // The first cycle without a position of the present silence, and whose doing that is.
    let mut silence: Option<(u32, (&'static str, bool))> = None;
    for (number, cycle) in (0_u32..).zip(cycles) {
        if *cycle == Cycle::Served {
            silence = None;
            continue;
        }
        let (from, until) = (10 * i64::from(number), 10 * i64::from(number) + 10);
        // The controller is dead, so its SYNC is missing.
        let is_by_fault = *cycle == Cycle::WithoutSync
            && faults.iter().any(|(begins, ends)| {
                until >= 10 * i64::from(*begins) && from <= 10 * i64::from(*ends)
            });
        let whose_node = match cycle {
            Cycle::WithoutPosition => "drive",
            _ => "controller",
        };
        let is_ours = !external.contains(&whose_node);
        let first = faults
            .iter()
            .map(|(begins, _)| 10 * i64::from(*begins))
            .min();
        let has_begun = first.is_some_and(|first| first <= until);
        let own = if is_ours && has_begun && external.is_empty() {
            "fault"
        } else if is_ours && !faults.is_empty() {
            "unknown"
        } else {
            "node"
        };
        // A controller gives up when the drive is silent.
        let given_up =
            silence.filter(|(since, _)| *cycle == Cycle::WithoutSync && 10 * (number - since) > 50);
        let (doing, is_by_canrig) = match (is_by_fault, is_held(number), given_up) {
            (true, ..) => ("fault", false),
            (_, true, _) => ("bench", false),
            (.., Some((_, begun))) if begun.0 != "bench" => begun,
            _ => (own, is_ours && own != "fault"),
        };
        if *cycle == Cycle::WithoutPosition {
            silence.get_or_insert((number, (doing, is_by_canrig)));
        }
        whose.push((f64::from(number) / 100.0, doing, is_by_canrig));
    }
    let count = |wanted: fn(&str, bool) -> bool| {
        let is_wanted = |miss: &&(f64, &str, bool)| wanted(miss.1, miss.2);
        whose.iter().filter(is_wanted).count()
    };
    let by_bench = count(|doing, _| doing == "bench");
    let by_canrig = count(|_, is_by_canrig| is_by_canrig);
    let prevails = by_bench > 0 && 4 * by_canrig <= by_bench;
    // A silence to the end is not taken for an unnoticed stall.
    let served = cycles.iter().rposition(|one| *one == Cycle::Served);
    let silent_from = served.map_or(0, |served| served + 1) as f64 / 100.0;
    let settled = whose.into_iter().map(|(at, doing, is_by_canrig)| {
        let is_stall = prevails && is_by_canrig && at < silent_from - 1e-9;
        (at, if is_stall { "bench" } else { doing })
    });
    settled.collect()
}

fn word(cause: Cause) -> &'static str {
    match cause {
        Cause::Host(_) => "bench",
        Cause::Fault => "fault",
        Cause::Node(_) => "node",
        Cause::Unknown(_) => "unknown",
    }
}

fn cycles() -> impl Strategy<Value = Vec<Cycle>> {
    let cycle = prop_oneof![
        4 => Just(Cycle::Served),
        1 => Just(Cycle::WithoutPosition),
        1 => Just(Cycle::WithoutSync),
    ];
    let served = Just(Cycle::Served);
    (served, prop::collection::vec(cycle, 1..90)).prop_map(|(first, mut others)| {
        others.insert(0, first);
        others
    })
}

fn held() -> impl Strategy<Value = Held> {
    let who = prop_oneof![
        Just(Who::Machine),
        Just(Who::Bus),
        Just(Who::Controller),
        Just(Who::PlantEmulator)
    ];
    (-30..900_i64, 1..60_u32, who).prop_map(|(from, length, who)| Held { from, length, who })
}

proptest! {
    #[test]
    fn each_miss_is_whose_doing_a_slow_look_finds(
        cycles in cycles(),
        held in prop::collection::vec(held(), 0..6),
        fault in prop::option::of((5..40_u32, 1..20_u32)),
        external in prop::sample::subsequence(vec!["drive", "controller"], 0..=2),
    ) {
        let faults: Vec<(u32, u32)> = fault.into_iter().map(|(from, length)| (from, from + length)).collect();
        // A fault may not begin after the scenario's end.
        let last = u32::try_from(cycles.len()).unwrap();
        prop_assume!(faults.iter().all(|(_, until)| *until < last));
        let plan = setup(cycles.len(), &faults, &external);
        let timelines = decode(&frames(&cycles).into(), &plan).unwrap();
        let circumstances = Circumstances {
            host: Host { stalls: held.iter().map(|held| held.stall()).collect(), ..Host::default() },
            unrecorded: Unrecorded { hits: Some(Hits::new(Vec::new(), &plan)), ..Unrecorded::default() },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(&timelines[0], (plan.database(), plan.only_loop().unwrap()), &circumstances);
        prop_assert_eq!(attribution.due, cycles.len() as u64);
        let missed = missed_cycles(&timelines[0], attribution.due);
        let found: Vec<_> = attribution.attributed(missed).map(|(breach, cause)| {
            (breach.from_seconds, word(cause))
        }).collect();
        prop_assert_eq!(found, slow(&cycles, &held, &faults, &external));
    }
}

#[test]
fn a_duty_that_is_not_done_has_its_share_and_its_first_time() {
    let mut cycles = vec![Cycle::Served; 100];
    (cycles[7], cycles[9], cycles[50]) = (
        Cycle::WithoutPosition,
        Cycle::WithoutPosition,
        Cycle::WithoutSync,
    );
    let plan = setup(100, &[], &[]);
    let timelines = decode(&frames(&cycles).into(), &plan).unwrap();
    let circumstances = Circumstances::default();
    let attribution = Attribution::new(
        &timelines[0],
        (plan.database(), plan.only_loop().unwrap()),
        &circumstances,
    );
    let too_many = |percent_max, lost| attribution.cycles.too_many(percent_max, lost);
    // Each duty has its own share: that of SYNC is within the limit.
    assert_eq!(too_many(1.0, 0), [(Duty::Position, 2.0, 0.07)]);
    let both = [(Duty::Sync, 1.0, 0.5), (Duty::Position, 2.0, 0.07)];
    assert_eq!(too_many(0.5, 0), both);
    assert_eq!(too_many(2.0, 0), []);
    // One of the two may be a frame that the recorder lost.
    assert_eq!(too_many(1.0, 1), []);
}

/// Plays a run with a stall in 20 of its cycles, in which a node left out some others.
#[test]
fn where_stalls_prevail_frames_that_canrigs_nodes_left_out_prove_nothing() {
    let by_nodes = |left_out: usize, nodes: &[&str]| {
        let mut cycles = vec![Cycle::Served; 100];
        cycles[10..30].fill(Cycle::WithoutSync);
        cycles[60..60 + left_out].fill(Cycle::WithoutSync);
        let plan = setup(100, &[], nodes);
        let timelines = decode(&frames(&cycles).into(), &plan).unwrap();
        let held = Held {
            from: 100,
            length: 200,
            who: Who::Machine,
        };
        let circumstances = Circumstances {
            host: Host {
                stalls: vec![held.stall()],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            &timelines[0],
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        attribution.cycles.too_many(1.0, 0).is_empty()
    };
    assert!(by_nodes(5, &[]));
    assert!(!by_nodes(7, &[]), "more than one of five");
    assert!(by_nodes(5, &["drive"]));
    assert!(!by_nodes(2, &["controller"]));
}

#[test]
fn a_silence_is_the_hosts_only_if_stalls_and_what_they_held_up_cover_half_of_it() {
    let plan = setup(100, &[], &[]);
    let mut timeline = decode(&frames(&[Cycle::Served; 40]).into(), &plan)
        .unwrap()
        .remove(0);
    let explained = |timeline: &Timeline, silence_seconds: f64, held: &[(i64, u32)]| {
        let held = held.iter().map(|(from, length)| Held {
            from: *from,
            length: *length,
            who: Who::Machine,
        });
        let circumstances = Circumstances {
            host: Host {
                stalls: held.map(Held::stall).collect(),
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            timeline,
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        let stretch = attribution.stall(
            plan.only_loop().unwrap().drive_index(),
            0.39,
            0.39 + silence_seconds,
        );
        stretch.map(|stretch| stretch.stall.length())
    };
    let milliseconds = |count| Some(Duration::from_millis(count));
    assert_eq!(explained(&timeline, 0.06, &[(395, 45)]), milliseconds(45));
    assert_eq!(
        explained(&timeline, 2.0, &[(395, 45)]),
        None,
        "a device that is gone"
    );
    assert_eq!(explained(&timeline, 0.06, &[(300, 80)]), None, "before");
    // Overlapping stalls count once.
    assert_eq!(explained(&timeline, 0.1, &[(395, 20), (396, 20)]), None);
    let both = explained(&timeline, 0.1, &[(395, 20), (416, 15)]);
    assert_eq!(both, milliseconds(20));
    // The last position and the controller's error come at once after a stall, or long after it.
    timeline.period_seconds = 0.001;
    assert_eq!(explained(&timeline, 0.001, &[(365, 24)]), milliseconds(24));
    assert_eq!(
        explained(&timeline, 0.02, &[(365, 24)]),
        None,
        "silent since"
    );
}

/// A SYNC that stops is missed to the scenario's end, unless the further course of the run is unknown.
#[test]
fn silence_counts_to_the_end_of_a_run_that_was_to_go_on() {
    let plan = setup(100, &[], &[]);
    let mut silent = vec![Cycle::Served; 40];
    silent.resize(100, Cycle::WithoutSync);
    let percent = |frames: &[Stamped], ended_early| {
        let timelines = decode(&frames.to_vec().into(), &plan).unwrap();
        let circumstances = Circumstances {
            ended_early,
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            &timelines[0],
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        attribution.cycles.percent(true)
    };
    assert_eq!(percent(&frames(&silent), None), 60.0);
    let cut = frames(&silent[..40]);
    assert_eq!(percent(&cut, None), 0.0);
    let end = |by| Some(EarlyEnd::without_node(by, "it ended"));
    assert_eq!(percent(&cut, end(EndedBy::Node)), 60.0);
    assert_eq!(percent(&cut, end(EndedBy::User)), 0.0);
}

/// The run has a stall in missed cycles, and one cycle that the controller left out by itself.
#[test]
fn a_window_is_the_hosts_by_what_is_missed_in_it() {
    let mut cycles = vec![Cycle::Served; 100];
    cycles[10..14].fill(Cycle::WithoutSync);
    cycles[60] = Cycle::WithoutSync;
    let external = ["controller"];
    let plan = setup(100, &[], &external);
    let timelines = decode(&frames(&cycles).into(), &plan).unwrap();
    let held = Held {
        from: 100,
        length: 40,
        who: Who::Machine,
    };
    let circumstances = Circumstances {
        host: Host {
            stalls: vec![held.stall()],
            ..Host::default()
        },
        ..Circumstances::default()
    };
    let attribution = Attribution::new(
        &timelines[0],
        (plan.database(), plan.only_loop().unwrap()),
        &circumstances,
    );
    let is_of_the_host = |from_seconds, until_seconds| {
        attribution.is_of_the_host(Window {
            from_seconds,
            until_seconds,
        })
    };
    assert!(is_of_the_host(0.1, 0.14));
    assert!(is_of_the_host(0.0, 0.6));
    assert!(!is_of_the_host(0.6, 0.61));
    assert!(!is_of_the_host(0.0, 1.0));
    assert!(!is_of_the_host(0.2, 0.5), "nothing is missed");
}

/// The controller was silent from 0.3 to 0.5 s and came back, in real time.
#[test]
fn a_silent_node_that_comes_back_stood_still_only_if_it_is_canrigs() {
    let stood = |nodes: &[&str]| {
        let plan = setup(100, &[], nodes);
        let mut timeline = decode(&frames(&[Cycle::Served; 100]).into(), &plan)
            .unwrap()
            .remove(0);
        timeline.lost_heartbeats = vec![LostHeartbeat {
            node: plan.nodes.manager(),
            due_seconds: 0.3,
            back_seconds: 0.5,
        }];
        let circumstances = Circumstances {
            host: Host {
                controller: Some(NodeReport::default()),
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            &timeline,
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        let stretch = attribution.stood_since(plan.nodes.manager(), 0.35);
        stretch.map(|stretch| (stretch.from_seconds, stretch.until_seconds))
    };
    assert_eq!(stood(&[]), Some((0.3, 0.5)));
    assert_eq!(stood(&["drive"]), Some((0.3, 0.5)));
    assert_eq!(stood(&["controller"]), None);
}

/// The emulator stalls, and the controller gives up.
#[test]
fn what_another_node_leaves_out_behind_a_stall_begins_with_it() {
    let mut cycles = vec![Cycle::Served; 100];
    cycles[40..50].fill(Cycle::WithoutPosition);
    cycles[50..].fill(Cycle::WithoutSync);
    let plan = setup(100, &[], &[]);
    let lasting = |cycles: &[Cycle], who| {
        let timelines = decode(&frames(cycles).into(), &plan).unwrap();
        let held = Held {
            from: 400,
            length: 100,
            who,
        };
        let circumstances = Circumstances {
            host: Host {
                stalls: vec![held.stall()],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            &timelines[0],
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        let stay = attribution.cycles.lasting(100).unwrap();
        (stay.first.cycle, word(stay.cause))
    };
    assert_eq!(lasting(&cycles, Who::PlantEmulator), (50, "node"));
    // All missing frames of a single node are one breach.
    cycles[40..50].fill(Cycle::WithoutSync);
    assert_eq!(lasting(&cycles, Who::Controller), (40, "node"));
}

/// One of canrig's nodes that missed cycles although its loop completed each in time did not run in them.
#[test]
fn a_punctual_node_of_canrigs_stood_still_in_the_cycles_that_it_missed() {
    let too_many = |overruns, late_answers, nodes: &[&str]| {
        let mut cycles = vec![Cycle::Served; 100];
        cycles[40..45].fill(Cycle::WithoutSync);
        let plan = setup(100, &[], nodes);
        let timelines = decode(&frames(&cycles).into(), &plan).unwrap();
        let report = NodeReport {
            ticks: 95,
            overruns,
            late_answers,
            ..NodeReport::default()
        };
        let circumstances = Circumstances {
            host: Host {
                controller: Some(report),
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let attribution = Attribution::new(
            &timelines[0],
            (plan.database(), plan.only_loop().unwrap()),
            &circumstances,
        );
        attribution.cycles.too_many(1.0, 0).len()
    };
    assert_eq!(too_many(0, 0, &[]), 0);
    assert_eq!(too_many(1, 0, &[]), 1);
    // The controller waited for a law.
    assert_eq!(too_many(0, 1, &[]), 1);
    assert_eq!(too_many(0, 0, &["controller"]), 1);
}

#[test]
fn times_touch_at_their_ends() {
    let spans = stalls::Spans::of(vec![(1.0, 2.0), (4.0, 5.0)]);
    let touch = |(from, until)| spans.first_in(from, until).is_some();
    let touched = [(0.5, 1.0), (2.0, 3.0), (3.0, 4.0)].map(touch);
    assert_eq!(touched, [true; 3]);
    let apart = [(0.0, 0.9), (2.1, 3.9), (5.1, 6.0)].map(touch);
    assert_eq!(apart, [false; 3]);
}
