//! Several loops on one bus.
#![expect(clippy::unwrap_used, reason = "tests fail by panicking")]

use std::fs;
use std::path::Path;

use can::CanFrame;
use plan::bus_budget::BusBudget;
use plan::{ControlLoop, Plan};
use recording::capture::{Capture, Watch};
use recording::frames::Frames;
use recording::sources::Sent;
use recording::timeline::{Series, Timeline, decode};
use worlds::End;
use worlds::catalogue::catalogue;
use worlds::lockstep::simulate;
use worlds::programs::Hosting;

fn two_axes() -> Plan {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/two_axes.toml");
    Plan::load(&path, catalogue()).unwrap()
}

fn simulated(plan: &Plan) -> Frames {
    let watch = Watch::default();
    let clock = plan.scenario_clock().unwrap();
    let mut capture = Capture::in_memory(clock, &watch);
    assert_eq!(
        simulate(plan, &Hosting::default(), &mut capture).unwrap(),
        End::Completed
    );
    capture.finish(plan).unwrap().0
}

/// Returns the plan of the two axes with more in their scenario.
fn two_axes_with(added: &str) -> Plan {
    let folder = tempfile::tempdir().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let copy = |name: &str, added: &str| {
        let text = fs::read_to_string(data.join(name)).unwrap();
        fs::write(folder.path().join(name), text + added).unwrap();
    };
    copy("two_axes_rig.toml", "");
    copy("two_axes.toml", added);
    Plan::load(&folder.path().join("two_axes.toml"), catalogue()).unwrap()
}

/// Returns the currents after a time.
fn currents_after(timeline: &Timeline, seconds: f64) -> Vec<f64> {
    let samples = timeline
        .time_seconds
        .iter()
        .zip(timeline.current().unwrap());
    let after = samples.filter(|(time, current)| *time > seconds && !current.is_nan());
    after.map(|(_, current)| current).collect()
}

#[test]
fn a_controller_that_loses_one_drive_takes_the_current_from_both() {
    for node in ["x", "y"] {
        let fault = format!("[[fault.node.crash]]\nfrom_seconds = 6.0\nnode = \"{node}\"\n");
        let plan = two_axes_with(&fault);
        let watch = Watch::default();
        let clock = plan.scenario_clock().unwrap();
        let mut capture = Capture::in_memory(clock, &watch);
        // A fault of the scenario is played to its end.
        let end = simulate(&plan, &Hosting::default(), &mut capture).unwrap();
        assert_eq!(end, End::Completed);
        let (frames, _) = capture.finish(&plan).unwrap();
        let timelines = decode(&frames, &plan).unwrap();
        for (timeline, name) in timelines.iter().zip(["x", "y"]) {
            let before = timeline.current().unwrap().get(2500).unwrap();
            assert!(
                before.abs() > 0.01,
                "{name}: {before} A before the crash of {node}"
            );
            let after = currents_after(timeline, 6.3);
            let is_off = after.iter().all(|current| *current == 0.0);
            assert!(is_off, "{name} after the crash of {node}: {after:?}");
        }
    }
}

/// Returns the frames of an identifier from a scenario time on, each with its scenario time.
fn frames_after(plan: &Plan, frames: &Frames, seconds: f64, id: u16) -> Vec<(f64, CanFrame)> {
    let zero = decode(frames, plan).unwrap()[0].zero_seconds.unwrap();
    let with_id = frames
        .iter()
        .filter(|one| one.frame.standard_id() == Some(id));
    let timed = with_id.map(|one| (one.time.as_secs_f64() - zero, one.frame));
    timed.filter(|(time, _)| *time > seconds).collect()
}

#[test]
fn a_fault_of_the_bus_hits_the_node_that_it_names_once() {
    let plan = two_axes_with(
        "[[fault.bus.delay]]\nfrom_seconds = 1.0\nuntil_seconds = 1.1\nsender = \"y\"\nidentifier = 0x192\ndelay_milliseconds = 0.7\n\
         [[fault.bus.duplicate]]\nfrom_seconds = 1.2\nuntil_seconds = 1.3\nsender = \"controller\"\nidentifier = 0x212\n\
         [[fault.bus.lose]]\nfrom_seconds = 1.5\nreceiver = \"y\"\nidentifier = 0x212\n",
    );
    let frames = simulated(&plan);
    let between = |id, from, until| {
        let mut frames = frames_after(&plan, &frames, from, id);
        frames.retain(|(time, _)| *time < until);
        frames
    };
    let syncs = between(0x080, 0.9, 1.1);
    // Delay of each position after the SYNC before it.
    let lateness = |id| {
        let positions = between(id, 1.0, 1.1).into_iter();
        let after_sync = positions.map(|(time, _)| {
            let before = syncs.iter().rev().find(|(sync, _)| *sync < time);
            1e3 * (time - before.unwrap().0)
        });
        after_sync.fold(0.0, f64::max)
    };
    assert!(lateness(0x190) < 0.7, "{} ms", lateness(0x190));
    assert!(
        (0.7..2.0).contains(&lateness(0x192)),
        "{} ms",
        lateness(0x192)
    );
    let count = |id| between(id, 1.2, 1.3).len();
    assert_eq!((count(0x210), count(0x212)), (50, 100));
    // Without commands the second drive does not move, and the controller switches the current of both
    // off.
    let emergencies = frames_after(&plan, &frames, 1.5, 0x081);
    let (_, first) = emergencies[0];
    assert_eq!(first.data()[3], 0x12, "{emergencies:?}");
    let is_first = frames_after(&plan, &frames, 1.5, 0x090).is_empty();
    assert!(is_first, "the first drive gets its commands");
}

/// An order that is a fault is sent once, to any node.
#[test]
fn the_bench_orders_the_node_that_the_rig_file_names() {
    for (node, number) in [("x", 0x10), ("y", 0x12), ("controller", 1)] {
        let fault = format!("[[fault.node.nmt_stop]]\nat_seconds = 3.0\nnode = \"{node}\"\n");
        let plan = two_axes_with(&fault);
        let frames = simulated(&plan);
        let mut orders = frames_after(&plan, &frames, 2.9, 0);
        orders.retain(|(time, _)| *time < 3.001);
        let [(_, order)] = orders[..] else {
            panic!("{orders:?}")
        };
        assert_eq!(order.data(), [2, number], "{node}");
    }
}

#[test]
fn the_controller_says_which_drive_it_gave_up() {
    for (node, number) in [("x", 0x10), ("y", 0x12)] {
        let fault =
            format!("[[fault.node.lost_heartbeat]]\nfrom_seconds = 3.0\nnode = \"{node}\"\n");
        let plan = two_axes_with(&fault);
        let frames = simulated(&plan);
        for (drive, id) in [("x", 0x710), ("y", 0x712)] {
            let beats = frames_after(&plan, &frames, 3.0, id).len();
            assert_eq!(beats == 0, drive == node, "{beats} heartbeats of {drive}");
        }
        let mut emergencies = frames_after(&plan, &frames, 3.0, 0x081);
        emergencies.retain(|(_, frame)| frame.data()[..2] != [0, 0]);
        let is_named = |(_, frame): &(f64, CanFrame)| frame.data()[3] == number;
        assert!(!emergencies.is_empty());
        assert!(emergencies.iter().all(is_named), "{emergencies:?}");
    }
}

/// Drives of one kind on one bus have different noise.
#[test]
fn each_drive_has_other_noise() {
    let noise = "[[fault.sensor.noise]]\nfrom_seconds = 0.0\nnode = \"NODE\"\nnoise_millimetres_rms = 0.05\n";
    let both = ["x", "y"].map(|node| noise.replace("NODE", node)).concat();
    let plan = two_axes_with(&both);
    let timelines = decode(&simulated(&plan), &plan).unwrap();
    let hold = |timeline: &Timeline| {
        let samples = timeline.time_seconds.iter().zip(timeline.position());
        let hold = samples.filter(|(time, _)| (1.0..1.9).contains(time));
        Vec::from_iter(hold.map(|(_, position)| position - 30.0))
    };
    let [x, y] = [hold(&timelines[0]), hold(&timelines[1])];
    let sum = |left: &[f64], right: &[f64]| -> f64 {
        left.iter()
            .zip(right)
            .map(|(left, right)| left * right)
            .sum()
    };
    let correlation = sum(&x, &y) / (sum(&x, &x) * sum(&y, &y)).sqrt();
    assert!(correlation.abs() < 0.3, "{correlation}");
}

#[test]
fn two_axes_draw_a_circle() {
    let loops = two_axes();
    let frames = simulated(&loops);
    let [x, y] = &decode(&frames, &loops).unwrap()[..] else {
        panic!("two loops")
    };
    // One bus, one time.
    assert_eq!(x.zero_seconds, y.zero_seconds);
    assert_eq!(x.time_seconds, y.time_seconds);
    for axis in [x, y] {
        assert_eq!(axis.missed_cycles_percent(), 0.0);
        assert!(axis.events.iter().all(|event| event.emergency.is_none()));
        let found = axis.sources.found(&Sent::default());
        assert_eq!(found, []);
    }
    let radius_errors = x.position().iter().zip(y.position()).zip(&x.time_seconds);
    let errors = radius_errors.filter(|(_, time)| (8.0..20.9).contains(time));
    let worst = errors
        .map(|((x, y), _)| ((x - 30.0).hypot(y - 30.0) - 10.0).abs())
        .fold(0.0, f64::max);
    assert!(worst < 0.3, "{worst} mm");
    assert!(worst > 0.0);
    // The axes are 90° apart, so neither reads the other's frames.
    let apart = x.position().iter().zip(y.position());
    assert!(apart.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max) > 9.0);
}

#[test]
fn a_simulation_of_several_loops_is_repeated_to_the_byte() {
    let loops = two_axes();
    assert!(simulated(&loops).iter().eq(simulated(&loops).iter()));
}

#[test]
fn a_cycle_that_is_too_short_is_refused_with_the_one_that_fits() {
    let folder = tempfile::tempdir().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let read = |name: &str| fs::read_to_string(data.join(name)).unwrap();
    let rig = read("two_axes_rig.toml");
    let plan = Plan::from_rig(Path::new("two_axes_rig.toml"), &rig, catalogue()).unwrap();
    let budget = BusBudget::new(&plan);
    assert!(budget.fits(), "{budget}");
    assert_eq!(budget.shares[0].what, "SYNC");
    let load_at = |period: &str| {
        let rig = read("two_axes_rig.toml").replace("2.0", period);
        fs::write(folder.path().join("two_axes_rig.toml"), rig).unwrap();
        let path = folder.path().join("two_axes.toml");
        fs::write(&path, read("two_axes.toml")).unwrap();
        Plan::load(&path, catalogue())
    };
    let period = budget.period_milliseconds_min().unwrap();
    assert!(load_at(&format!("{period:.1}")).is_ok());
    let error = load_at(&format!("{:.1}", period - 0.1)).unwrap_err();
    let text = scenario::without_colours(&error);
    let proposed = format!("sync_period_milliseconds = {period:.1}");
    assert!(text.contains(&proposed), "{text}");
}

fn shipped(name: &str) -> Plan {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios");
    Plan::load(&folder.join(name), catalogue()).unwrap()
}

#[test]
fn two_drives_turn_one_joint_under_one_law() {
    let plan = shipped("sma_pair_step.toml");
    let names = plan.loops.iter().map(ControlLoop::prefix);
    assert_eq!(Vec::from_iter(names), ["angle.", "extensor."]);
    let timelines = decode(&simulated(&plan), &plan).unwrap();
    let [angle, extensor] = &timelines[..] else {
        panic!("{} timelines", timelines.len())
    };
    // One plant: both sensors see the same angle.
    assert_eq!(angle.position(), extensor.position());
    assert!(angle.column("position_degrees").is_some());
    // 15 degrees to the flexor's side, then 10 to the other.
    let at = |timeline: &Timeline, seconds: f64| {
        let row = timeline.time_seconds.partition_point(|time| time < seconds);
        let value = |values: &Series<f64>| values.get(row).unwrap();
        (
            value(timeline.position()),
            value(timeline.current().unwrap()),
        )
    };
    let (there, back) = (at(angle, 4.9), at(angle, 7.9));
    assert!(
        (there.0 - 15.0).abs() < 1.5 && (back.0 + 10.0).abs() < 1.5,
        "{there:?} {back:?}"
    );
    assert!(there.1 > at(extensor, 4.9).1, "the flexor pulls more");
    assert!(back.1 < at(extensor, 7.9).1, "the extensor pulls more");
}

#[test]
fn a_law_takes_the_current_from_all_its_drives_when_one_is_lost() {
    let plan = shipped("sma_pair_drive_lost.toml");
    let timelines = decode(&simulated(&plan), &plan).unwrap();
    for timeline in &timelines {
        let currents = currents_after(timeline, 3.5);
        assert!(currents.iter().all(|current| *current == 0.0));
    }
}
