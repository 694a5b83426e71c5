use std::time::Duration;

use canopen::CanFrame;
use dbc::Database;
use recording::log::Stamped;
use recording::timeline::decode;
use recording::unrecorded::Unrecorded;
use rig::catalogue::Catalogue;
use rig::setup::Setup;
use scenario::Scenario;

use crate::judge;
use crate::verdict::{Outcome, Verdict};

const OPERATION_ENABLED: f64 = 39.0;

/// A scenario of 4 s with a step from 10 mm to 35 mm at 1 s, and whatever is added.
fn scenario(added: &str) -> Scenario {
    let text = format!(
        "schema = 1\nname = \"judged\"\nduration_seconds = 4.0\n[controller.sliding_mode]\n{added}\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n"
    );
    Scenario::parse(&text, "judged.toml", |_| unreachable!("no table")).unwrap()
}

/// What a drive with this position by cycle would leave; a cycle without a position has no TPDO1.
fn frames(cycles: u32, position: impl Fn(u32) -> Option<f64>) -> Vec<Stamped> {
    let database = Database::shipped();
    let signal = |path| database.signal(path).unwrap();
    let feedback = |position: f64| {
        let mut message = database.builder("drive_tpdo1").unwrap();
        message.set(&signal("drive_tpdo1.statusword_state"), OPERATION_ENABLED);
        message.set(&signal("drive_tpdo1.position_millimetres"), position);
        message.set(&signal("drive_tpdo1.current_amperes"), 0.5);
        message.frame()
    };
    let fan = [CanFrame::new(0x711, &[0]), CanFrame::new(0x211, &[0; 8])];
    let mut frames: Vec<Stamped> = [feedback(0.0), fan[0], fan[1]]
        .map(|frame| Stamped::new(Duration::ZERO, frame))
        .into();
    for cycle in 0..cycles {
        let start = Duration::from_millis(u64::from(cycle) + 1);
        frames.push(Stamped::new(start, CanFrame::new(0x080, &[1])));
        if let Some(position) = position(cycle) {
            let time = start + Duration::from_micros(130);
            frames.push(Stamped::new(time, feedback(position)));
        }
    }
    frames
}

fn verdict_of(scenario: &Scenario, frames: &[Stamped], lost: u64) -> Verdict {
    let setup = Setup::of(scenario.clone(), &Catalogue::shipped());
    let timeline = decode(frames, &setup).unwrap();
    let unrecorded = Unrecorded {
        frames_lost: lost,
        ..Unrecorded::default()
    };
    judge(&timeline, &setup, &unrecorded)
}

fn value(verdict: &Verdict, name: &str) -> Option<f64> {
    let metric = verdict.metrics.iter().find(|metric| metric.name == name);
    metric.unwrap_or_else(|| panic!("no {name}")).value
}

fn check(added: &str, position: impl Fn(f64) -> f64, name: &str, expected: f64) {
    let verdict = verdict_of(
        &scenario(added),
        &frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3))),
        0,
    );
    let measured = value(&verdict, name).unwrap();
    assert!(
        (measured - expected).abs() < 1e-6,
        "{name}: {measured}, expected {expected}"
    );
}

/// 10 mm before the step, 35 mm from `settled` on, and 34 mm (inside the band of 1.25 mm) or 30 mm for one sample.
fn step_response(settled: f64) -> impl Fn(f64) -> f64 {
    move |time| if time < settled { 10.0 } else { 35.0 }
}

#[test]
fn settling_counts_from_the_step_to_the_first_sample_of_the_last_stay() {
    check("", step_response(1.1), "settling_time_seconds", 0.1);
    let leaves_again = |time: f64| {
        if (time - 1.5).abs() < 5e-4 {
            30.0
        } else {
            step_response(1.1)(time)
        }
    };
    check("", leaves_again, "settling_time_seconds", 0.501);
    let stays_inside = |time: f64| {
        if (time - 1.5).abs() < 5e-4 {
            34.0
        } else {
            step_response(1.1)(time)
        }
    };
    check("", stays_inside, "settling_time_seconds", 0.1);
    let never = verdict_of(&scenario(""), &frames(4000, |_| Some(10.0)), 0);
    assert!(
        never
            .metrics
            .iter()
            .all(|metric| metric.name != "settling_time_seconds")
    );
}

#[test]
fn overshoot_is_by_the_height_of_the_step() {
    let peak = |time: f64| {
        if (time - 1.2).abs() < 5e-4 {
            36.0
        } else {
            step_response(1.1)(time)
        }
    };
    check("", peak, "overshoot_percent", 4.0);
    check("", step_response(1.1), "overshoot_percent", 0.0);
    check("", peak, "position_millimetres_max", 36.0);
}

#[test]
fn errors_are_means_over_their_windows() {
    let offset = |time: f64| step_response(1.0)(time) + 0.2;
    check("", offset, "steady_state_error_millimetres", 0.2);
    check("", offset, "tracking_error_millimetres_rms", 0.2);
    check("", offset, "current_amperes_rms", 0.5);
}

#[test]
fn a_sine_is_followed_with_gain_phase_and_offset() {
    let text = "schema = 1\nname = \"sine\"\nduration_seconds = 4.0\n[controller.pid]\n[[reference.sine]]\n\
                from_seconds = 0.0\ncentre_millimetres = 25.0\namplitude_millimetres = 10.0\nperiod_seconds = 0.8\n";
    let sine = Scenario::parse(text, "sine.toml", |_| unreachable!("no table")).unwrap();
    let omega = std::f64::consts::TAU / 0.8;
    let judged = |lag: f64| {
        let position = |cycle| 24.0 + 7.0 * libm::sin(omega * f64::from(cycle) / 1e3 - lag);
        verdict_of(&sine, &frames(4000, |cycle| Some(position(cycle))), 0)
    };
    for (lag, degrees) in [(0.5, -28.647_889), (4.0, -229.183_118), (-1.0, 57.295_780)] {
        let verdict = judged(lag);
        let expected = [
            ("sine_gain", 0.7),
            ("sine_phase_degrees", degrees),
            ("sine_offset_millimetres", -1.0),
        ];
        for (name, expected) in expected {
            let measured = value(&verdict, name).unwrap();
            // The position on the bus has steps of 1 µm.
            assert!(
                (measured - expected).abs() < 1e-3,
                "{name}: {measured}, expected {expected}"
            );
        }
    }
}

#[test]
fn a_disturbance_is_watched_until_3_s_after_its_end() {
    let fan =
        "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 2.5\nconvection_factor = 5.0";
    let dip = |time: f64| match time {
        time if (1.99..2.3).contains(&time) => 34.5,
        time => step_response(1.0)(time),
    };
    check(fan, dip, "maximum_deviation_millimetres", 0.5);
    check(fan, dip, "recovery_time_seconds", 0.3);
    let early = |time: f64| if time < 1.9 { 20.0 } else { 35.0 };
    check(fan, early, "maximum_deviation_millimetres", 0.0);
    check(fan, early, "recovery_time_seconds", 0.0);
}

#[test]
fn what_nobody_sends_is_not_judged_and_does_not_pass() {
    let fan =
        "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 2.5\nconvection_factor = 5.0\n";
    let limits =
        "[expect]\nrecovery_time_seconds = { max = 1.0 }\ntemperature_celsius = { max = 90.0 }\n";
    let step = |time: f64| step_response(1.1)(time);
    let mut frames = frames(4000, |cycle| Some(step(f64::from(cycle) / 1e3)));
    // Without the module's heartbeat its commands reach nobody.
    frames.retain(|stamped| stamped.frame.standard_id() != Some(0x711));
    let judged = |limits: &str| verdict_of(&scenario(&format!("{fan}{limits}")), &frames, 0);
    let verdict = judged(limits);
    assert_eq!(verdict.outcome, Outcome::Inconclusive);
    let reason = "not judged: recovery_time_seconds, temperature_celsius";
    assert_eq!(verdict.reason.as_deref(), Some(reason));
    assert_eq!(value(&verdict, "maximum_deviation_millimetres"), None);
    let failing = format!("{limits}settling_time_seconds = {{ max = 0.01 }}\n");
    assert_eq!(judged(&failing).outcome, Outcome::Fail);
    assert_eq!(judged("").outcome, Outcome::Pass, "nothing is demanded");
}

#[test]
fn without_a_set_point_nothing_deviates_or_recovers() {
    let text = "schema = 1\nname = \"open\"\nduration_seconds = 4.0\n[controller.open_loop]\n\
                [[disturbance.fan]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\nconvection_factor = 5.0\n";
    let open = Scenario::parse(text, "open.toml", |_| unreachable!("no table")).unwrap();
    let verdict = verdict_of(&open, &frames(4000, |_| Some(10.0)), 0);
    let judged: Vec<_> = verdict
        .metrics
        .iter()
        .map(|metric| metric.name.as_str())
        .collect();
    assert!(!judged.contains(&"recovery_time_seconds"), "{judged:?}");
    assert!(
        !judged.contains(&"maximum_deviation_millimetres"),
        "{judged:?}"
    );
}

#[test]
fn a_step_that_never_settles_misses_its_limit() {
    let limited = scenario("[expect]\nsettling_time_seconds = { max = 3.0 }");
    let verdict = verdict_of(&limited, &frames(4000, |_| Some(10.0)), 0);
    assert_eq!(verdict.outcome, Outcome::Fail);
    assert_eq!(verdict.metrics[0].remark.as_deref(), Some("never settled"));
}

#[test]
fn what_comes_after_the_end_is_no_part_of_the_last_cycle() {
    let mut frames = frames(4000, |_| Some(35.0));
    // The scenario begins at 1 ms and ends at 4.001 s; then a drive that stops may send anything.
    let late = Duration::from_micros(4_001_200);
    frames.push(Stamped::new(late, frames[0].frame));
    let verdict = verdict_of(&scenario(""), &frames, 0);
    assert_eq!(value(&verdict, "steady_state_error_millimetres"), Some(0.0));
}

#[test]
fn cycles_that_are_missing_at_the_end_are_missed_ones() {
    let mut late = frames(3985, |_| Some(35.0));
    assert_eq!(
        verdict_of(&scenario(""), &late, 0).outcome,
        Outcome::Incomplete
    );
    // A SYNC after the end shows that the scenario ended: the machine stood still for 15 ms, not the run.
    let after_end = Duration::from_micros(4_001_300);
    late.push(Stamped::new(after_end, CanFrame::new(0x080, &[1])));
    let verdict = verdict_of(&scenario(""), &late, 0);
    assert_eq!(value(&verdict, "missed_cycles_percent"), Some(0.375));
    assert_eq!(verdict.outcome, Outcome::Pass);
}

#[test]
fn a_bad_recording_decides_nothing() {
    let whole = frames(4000, |cycle| {
        Some(step_response(1.1)(f64::from(cycle) / 1e3))
    });
    let outcome = |frames: &[Stamped], lost| verdict_of(&scenario(""), frames, lost).outcome;
    assert_eq!(outcome(&whole, 0), Outcome::Pass);
    assert_eq!(outcome(&whole, 1), Outcome::Inconclusive);
    assert_eq!(outcome(&whole[..whole.len() / 2], 0), Outcome::Incomplete);
    assert_eq!(outcome(&[], 0), Outcome::Incomplete);
    // Every 50th cycle without a position, then every 50th without its SYNC: 2 % missed, more than 1 %.
    let silent = frames(4000, |cycle| (cycle % 50 != 7).then_some(35.0));
    assert_eq!(outcome(&silent, 0), Outcome::Inconclusive);
    let is_kept = |stamped: &&Stamped| {
        let is_sync = stamped.frame.standard_id() == Some(0x080);
        !(is_sync && stamped.time.as_millis() % 50 == 7)
    };
    let skipped: Vec<Stamped> = whole.iter().filter(is_kept).copied().collect();
    assert_eq!(outcome(&skipped, 0), Outcome::Inconclusive);
}

/// The frames of a good run, and each SYNC a second time.
fn with_foreign_syncs() -> Vec<Stamped> {
    let frames = frames(4000, |_| Some(10.0));
    let is_sync = |stamped: &&Stamped| stamped.frame.standard_id() == Some(0x080);
    let half = Duration::from_micros(500);
    let foreign = frames.iter().filter(is_sync);
    let foreign = foreign.map(|stamped| Stamped::new(stamped.time + half, stamped.frame));
    let mut all: Vec<Stamped> = frames.iter().copied().chain(foreign).collect();
    all.sort_by_key(|stamped| stamped.time);
    all
}

#[test]
fn a_second_master_lets_nothing_pass_and_nothing_fail() {
    let frames = with_foreign_syncs();
    for limits in [
        "[expect]\n",
        "[expect]\nposition_millimetres = { max = 1.0 }\n",
    ] {
        let verdict = verdict_of(&scenario(limits), &frames, 0);
        assert_eq!(verdict.outcome, Outcome::Inconclusive);
        let reason = verdict.reason.unwrap();
        let expected = "a second master: 0x080 (SYNC, one every 1 ms), ";
        assert!(reason.starts_with(expected), "{reason}");
    }
}

#[test]
fn a_load_that_no_bus_carries_fails_without_a_limit() {
    let filler = CanFrame::new(0x300, &[0x55; 8]);
    let load = |frames_per_cycle: usize| {
        let mut frames = frames(4000, |_| Some(10.0));
        for cycle in 0..4000_u64 {
            let time = Duration::from_micros(1000 * cycle + 1600);
            frames.extend(vec![Stamped::new(time, filler); frames_per_cycle]);
        }
        frames.sort_by_key(|stamped| stamped.time);
        verdict_of(&scenario(""), &frames, 0)
    };
    let full = load(7);
    assert!(value(&full, "bus_load_percent").unwrap() > 90.0);
    assert_eq!(full.outcome, Outcome::Pass);
    let beyond = load(8);
    assert_eq!(beyond.outcome, Outcome::Fail);
    let reason = beyond.reason.unwrap();
    assert!(reason.contains("no bus carries that"), "{reason}");
}

#[test]
fn fd_frames_are_named_and_leave_a_limit_on_the_load_open() {
    let frames = frames(4000, |_| Some(10.0));
    let unrecorded = Unrecorded {
        fd_frames: 7,
        ..Unrecorded::default()
    };
    for (limits, outcome) in [
        ("", Outcome::Pass),
        (
            "[expect]\nbus_load_percent = { max = 90.0 }\n",
            Outcome::Inconclusive,
        ),
    ] {
        let setup = Setup::of(scenario(limits), &Catalogue::shipped());
        let timeline = decode(&frames, &setup).unwrap();
        let verdict = judge(&timeline, &setup, &unrecorded);
        assert_eq!((verdict.outcome, verdict.fd_frames), (outcome, 7));
        assert!(verdict.losses[0].starts_with("7 CAN FD frames on the bus"));
    }
}
