use std::time::Duration;

use can::CanFrame;
use dbc::Database;
use plan::Plan;
use recording::ending::{EarlyEnd, EndedBy};
use recording::frames::Frames;
use recording::hits::Hits;
use recording::latency::Host;
use recording::log::Stamped;
use recording::stalls::{Stall, What, Who};
use recording::timeline::decode;
use recording::unrecorded::Unrecorded;

use crate::verdict::{Metric, Outcome, Verdict};
use crate::{Circumstances, judge};

const OPERATION_ENABLED: f64 = 39.0;

/// Returns a plan of 4 s with a step from 10 mm to 35 mm at 1 s, and with these additions.
pub(crate) fn step_plan(added: &str) -> Plan {
    testing::plan(&scenario_text(added))
}

fn scenario_text(added: &str) -> String {
    format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"judged\"\nduration_seconds = 4.0\n[controller.sliding_mode]\n{added}\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 35.0\n"
    )
}

/// Returns the frames of a drive with this position by cycle; a cycle without a position has no TPDO1.
pub(crate) fn frames(cycles: u32, position: impl Fn(u32) -> Option<f64>) -> Vec<Stamped> {
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

fn verdict_on(plan: &Plan, frames: &[Stamped], lost: u64) -> Verdict {
    let timelines = decode(&frames.to_vec().into(), plan).unwrap();
    let circumstances = Circumstances {
        unrecorded: Unrecorded {
            frames_lost: lost,
            hits: Some(Hits::new(Vec::new(), plan)),
            ..Unrecorded::default()
        },
        ..Circumstances::default()
    };
    judge(plan, &timelines, &circumstances)
}

fn row<'a>(verdict: &'a Verdict, name: &str) -> &'a Metric {
    let row = verdict.metrics.iter().find(|metric| metric.name == name);
    row.unwrap_or_else(|| panic!("no {name}"))
}

fn value(verdict: &Verdict, name: &str) -> Option<f64> {
    row(verdict, name).value
}

fn check(added: &str, position: impl Fn(f64) -> f64, name: &str, expected: f64) {
    let verdict = verdict_on(
        &step_plan(added),
        &frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3))),
        0,
    );
    let measured = value(&verdict, name).unwrap();
    assert!(
        (measured - expected).abs() < 1e-6,
        "{name}: {measured}, expected {expected}"
    );
}

/// Returns a position of 10 mm before `settled`, and of 35 mm from then on.
fn step_response(settled: f64) -> impl Fn(f64) -> f64 {
    move |time| if time < settled { 10.0 } else { 35.0 }
}

/// The loader refuses such a limit, but a recording may be judged by the limits of another scenario.
#[test]
fn a_limit_is_missed_where_the_scenario_lacks_what_its_metric_needs() {
    let others = step_plan(
        "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 3.0\nconvection_factor = 2.0\n\
         [expect]\nrecovery_time_seconds = { max = 1.0 }\n",
    );
    let mut plan = step_plan("");
    plan.loops.first_mut().unwrap().trial.expect = others.only_loop().unwrap().trial.expect.clone();
    let verdict = verdict_on(&plan, &frames(4000, |_| Some(10.0)), 0);
    let recovery = row(&verdict, "recovery_time_seconds");
    let lacks = Some("the scenario lacks a [[disturbance.…]]");
    assert_eq!(recovery.remark.as_deref(), lacks);
    assert_eq!(recovery.passed, Some(false));
    let verdict = verdict_on(&step_plan(""), &frames(4000, |_| Some(10.0)), 0);
    let mut rows = verdict.metrics.iter();
    assert!(rows.all(|row| row.name != "recovery_time_seconds"));
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
}

/// 35 - 34.778 is more than 0.222 in binary.
#[test]
fn the_edge_of_a_band_is_inside_whatever_its_decimals() {
    let fan = "[[disturbance.fan]]\nfrom_seconds = 2.0\nuntil_seconds = 3.0\nconvection_factor = 2.0\n\
         [expect]\nrecovery_band_millimetres = 0.222\n";
    let recovers = |time: f64| match (time * 1e3).round() {
        2000.0..2500.0 => 30.0,
        2500.0.. => 34.778,
        _ => step_response(1.1)(time),
    };
    check(fan, recovers, "recovery_time_seconds", 0.5);
    // And 13.15 - 13 is more than 5 % of 3.
    let mut small = step_plan("");
    small.loops.first_mut().unwrap().trial.reference.step[0].position = 13.0;
    let settles = |cycle: u32| Some(if cycle < 1100 { 10.0 } else { 13.15 });
    let verdict = verdict_on(&small, &frames(4000, settles), 0);
    assert_eq!(value(&verdict, "settling_time_seconds"), Some(0.1));
}

const HUNTING: &str = "[expect]\nhunting_millimetres = { max = 0.25 }\n";

#[test]
fn hunting_is_how_far_the_mean_position_goes_in_the_last_second() {
    let swinging = |time: f64| match (time * 1e3).round() {
        1500.0..1600.0 => 40.0,
        3200.0..3210.0 => 35.3,
        // The mean over 10 ms is 35.1 mm.
        3500.0 => 36.0,
        3900.0..3910.0 => 34.9,
        _ => 35.0,
    };
    check(HUNTING, swinging, "hunting_millimetres", 0.4);
    // Hunting is not limited, so it is not reported.
    let verdict = verdict_on(&step_plan(""), &frames(4000, |_| Some(10.0)), 0);
    assert!(
        verdict
            .metrics
            .iter()
            .all(|row| row.name != "hunting_millimetres")
    );
}

#[test]
fn a_set_point_that_moves_in_the_last_second_is_no_hunting() {
    let late = format!(
        "{HUNTING}[[reference.ramp]]\nfrom_seconds = 3.0\nuntil_seconds = 3.5\nposition_millimetres = 20.0\n"
    );
    let verdict = verdict_on(&step_plan(&late), &frames(4000, |_| Some(10.0)), 0);
    let reason = row(&verdict, "hunting_millimetres").remark.as_deref();
    assert_eq!(
        reason,
        Some("the set-point stands for 0.500 s; 1 s are needed")
    );
}

/// Returns the plan of 4 s with a chirp of 10 mm from 2 to 8 Hz, and an addition.
fn chirp_plan(added: &str) -> Plan {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"judged\"\nduration_seconds = 4.0\n[controller.sliding_mode]\n{added}\n\
         [[reference.chirp]]\nfrom_seconds = 0.0\nuntil_seconds = 4.0\ncentre_millimetres = 25.0\n\
         amplitude_millimetres = 10.0\nfrom_hertz = 2.0\nuntil_hertz = 8.0\n"
    );
    testing::plan(&text)
}

/// Returns the frames of a position that follows the chirp with this gain, 30° late and 1 mm high.
fn follows_the_chirp(gain: impl Fn(f64) -> f64) -> Vec<Stamped> {
    let plan = chirp_plan("");
    let chirp = plan.only_loop().unwrap().trial.reference.chirp[0].clone();
    frames(4000, |cycle| {
        let phase = chirp.phase_at(f64::from(cycle) / 1e3);
        let late = phase.radians() - 30_f64.to_radians();
        Some(26.0 + 10.0 * gain(phase.hertz()) * libm::sin(late))
    })
}

#[test]
fn a_chirp_shows_gain_phase_and_offset_over_frequency() {
    let frames = follows_the_chirp(|_| 0.9);
    let plan = chirp_plan("");
    let timelines = decode(&frames.into(), &plan).unwrap();
    let [points] =
        &crate::frequency_responses(plan.database(), &timelines[0], plan.only_loop().unwrap())[..]
    else {
        panic!("one chirp")
    };
    // The first of the 20 turns is not judged.
    assert_eq!(points.len(), 19);
    // After n turns the frequency is √(2² + 2 · 1.5 n).
    assert!((points[0].hertz - 8.5_f64.sqrt()).abs() < 1e-9);
    for point in points {
        assert!((point.gain - 0.9).abs() < 1e-3, "{point:?}");
        assert!((point.phase_degrees + 30.0).abs() < 0.1, "{point:?}");
        assert!((point.offset - 1.0).abs() < 5e-3, "{point:?}");
    }
}

#[test]
fn the_bandwidth_is_the_last_frequency_before_the_gain_falls() {
    let bandwidth = |frames: &[Stamped]| {
        let verdict = verdict_on(
            &chirp_plan("[expect]\nbandwidth_hertz = { min = 4.0 }\n"),
            frames,
            0,
        );
        let row = row(&verdict, "bandwidth_hertz");
        (row.value, row.passed, row.remark.clone())
    };
    // The gain recovers above 7 Hz, which no longer counts.
    let frames = follows_the_chirp(|hertz| {
        if (5.0..7.0).contains(&hertz) {
            0.6
        } else {
            0.9
        }
    });
    let (value, passed, _) = bandwidth(&frames);
    // The turn from the sixth on ends at 5 Hz: the middle of the one before is after 6.5 turns.
    assert_eq!(value, Some((23.5_f64.sqrt() * 1e6).round() / 1e6));
    assert_eq!(passed, Some(true));
    let (value, passed, remark) = bandwidth(&follows_the_chirp(|_| 0.6));
    assert_eq!((value, passed), (None, Some(false)));
    let reason = "the gain is below 0.708 from the lowest frequency on";
    assert_eq!(remark.as_deref(), Some(reason));
    let gap = follows_the_chirp(|_| 0.9)
        .into_iter()
        .filter(|stamped| !(2000..2100).contains(&stamped.time.as_millis()))
        .collect::<Vec<_>>();
    let (value, passed, remark) = bandwidth(&gap);
    assert_eq!((value, passed), (None, Some(false)));
    assert!(remark.unwrap().contains("silent"));
}

/// Returns frames as [`frames`] does, with a command in each cycle.
fn commanded(position: impl Fn(f64) -> f64, current: impl Fn(u32) -> f64) -> Vec<Stamped> {
    let database = Database::shipped();
    let target = database
        .signal("drive_rpdo1.target_current_amperes")
        .unwrap();
    let mut all = frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3)));
    for cycle in 0..4000 {
        let mut message = database.builder("drive_rpdo1").unwrap();
        message.set(&target, current(cycle));
        let time = Duration::from_millis(u64::from(cycle) + 1) + Duration::from_micros(400);
        all.push(Stamped::new(time, message.frame()));
    }
    all.sort_by_key(|stamped| stamped.time);
    all
}

const RIPPLE: &str = "[expect]\ncurrent_ripple_amperes_rms = { max = 0.02 }\n";

#[test]
fn ripple_is_the_standard_deviation_of_the_command_in_the_last_hold() {
    let current = |cycle| match cycle {
        ..2000 => 1.0,
        cycle if cycle % 2 == 0 => 0.57,
        _ => 0.59,
    };
    let verdict = verdict_on(
        &step_plan(RIPPLE),
        &commanded(step_response(1.0), current),
        0,
    );
    let ripple = value(&verdict, "current_ripple_amperes_rms").unwrap();
    assert!((ripple - 0.01).abs() < 1e-4, "{ripple}");
    let late = verdict_on(
        &step_plan(RIPPLE),
        &commanded(step_response(1.3), current),
        0,
    );
    let reason = row(&late, "current_ripple_amperes_rms").remark.as_deref();
    assert_eq!(reason, Some("the hold lasts 1.700 s; 2 s are needed"));
}

#[test]
fn a_disturbance_ends_the_hold_before_it() {
    let load = format!("{RIPPLE}[[disturbance.load]]\nat_seconds = 2.0\nadded_grams = 1.0\n");
    let frames = commanded(step_response(1.0), |_| 0.5);
    let verdict = verdict_on(&step_plan(&load), &frames, 0);
    let reason = row(&verdict, "current_ripple_amperes_rms")
        .remark
        .as_deref();
    assert_eq!(reason, Some("the hold lasts 1.000 s; 2 s are needed"));
}

/// The row exists without a limit, too, since a reader who misses a row takes its metric for met.
#[test]
fn a_step_that_never_settles_has_a_row() {
    let never = verdict_on(&step_plan(""), &frames(4000, |_| Some(10.0)), 0);
    let reason = row(&never, "settling_time_seconds").remark.as_deref();
    assert_eq!(reason, Some("never settled"));
    assert_eq!(never.outcome, Outcome::Pass, "nothing is demanded");
}

#[test]
fn a_stay_lasts_for_a_tenth_of_a_second_at_least() {
    let limit = "[expect]\nsettling_time_seconds = { max = 3.0 }";
    let judged = |settled: f64| {
        let position = step_response(settled);
        let frames = frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3)));
        verdict_on(&step_plan(limit), &frames, 0)
    };
    let late = judged(3.95);
    let reason = "the window ends 0.05 s after the position entered the band; 0.1 s are needed";
    assert_eq!(
        row(&late, "settling_time_seconds").remark.as_deref(),
        Some(reason)
    );
    assert_eq!(late.outcome, Outcome::Fail);
    assert_eq!(value(&judged(3.9), "settling_time_seconds"), Some(2.9));
}

/// Returns frames of 4 s in which the controller dies; the plant reports itself to the end.
fn dying_frames(cycles: u32) -> Vec<Stamped> {
    let position = step_response(1.1);
    let mut frames = frames(cycles, |cycle| Some(position(f64::from(cycle) / 1e3)));
    let start = frames.last().unwrap().time;
    let end = Duration::from_millis(4002);
    let heartbeats = (1..)
        .map(|number| start + number * Duration::from_millis(20))
        .take_while(|time| *time < end);
    let alive = CanFrame::new(0x710, &[5]);
    frames.extend(heartbeats.map(|time| Stamped::new(time, alive)));
    frames
}

const CRASH: &str = "[[fault.node.crash]]\nfrom_seconds = 0.99\nnode = \"controller\"\n";
const LIMITS: &str = "[expect]\nsettling_time_seconds = { max = 0.2 }\novershoot_percent = { max = 5.0 }\n\
    tracking_error_millimetres_rms = { max = 25.0 }\nposition_millimetres_max = { max = 36.0 }\n\
    current_amperes_rms = { max = 1.0 }\nmissed_cycles_percent = { max = 1.0 }\n\
    sync_interval_milliseconds_max = { max = 2.0 }\n";

/// Returns the names of the rows with a limit and a certain result.
fn names(verdict: &Verdict, passed: Option<bool>) -> Vec<&str> {
    let rows = verdict
        .metrics
        .iter()
        .filter(|row| row.limit.is_some() && row.passed == passed);
    rows.map(|row| row.name.as_str()).collect()
}

#[test]
fn what_a_silent_node_kept_from_being_seen_fails() {
    let dead = verdict_on(
        &step_plan(&format!("{CRASH}{LIMITS}")),
        &dying_frames(990),
        0,
    );
    assert_eq!(dead.outcome, Outcome::Fail);
    assert_eq!(names(&dead, Some(true)), [] as [&str; 0]);
    assert_eq!(names(&dead, Some(false)).len(), 7);
    let reason = |name| row(&dead, name).remark.clone().unwrap();
    assert_eq!(
        reason("overshoot_percent"),
        "no position from 1.000 to 4.000 s"
    );
    let silent = "silent from 0.989 to 4.000 s";
    assert_eq!(reason("tracking_error_millimetres_rms"), silent);
    let no_sync = "no SYNC from 0.990 to 4.000 s";
    // Cycles 990 to 3999 are missed.
    assert_eq!(value(&dead, "missed_cycles_percent"), Some(75.25));
    assert_eq!(reason("sync_interval_milliseconds_max"), no_sync);
}

#[test]
fn what_is_judged_may_end_before_the_scenario_does() {
    // The limit admits 21 missed cycles of 1500, which are 1.4 %.
    let limits = LIMITS.replace("percent = { max = 1.0 }", "percent = { max = 2.0 }");
    let ends = format!("{CRASH}{limits}judged_until_seconds = 1.5\n");
    let dead = verdict_on(&step_plan(&ends), &dying_frames(1500), 0);
    assert_eq!(dead.outcome, Outcome::Pass, "{:?}", dead.metrics);
    assert_eq!(value(&dead, "settling_time_seconds"), Some(0.1));
    assert_eq!(value(&dead, "missed_cycles_percent"), Some(0.0));
    // A stretch of 0.02 s without a position is no silence, one of 0.021 s is.
    let passes = |cycles| verdict_on(&step_plan(&ends), &dying_frames(cycles), 0).outcome;
    assert_eq!(passes(1481), Outcome::Pass);
    assert_eq!(passes(1479), Outcome::Fail);
}

#[test]
fn what_the_bench_kept_from_being_seen_is_not_judged() {
    let plan = step_plan(&format!("{CRASH}{LIMITS}"));
    let cut = dying_frames(990);
    let cut = &cut[..cut.len() / 2];
    let timelines = decode(&cut.to_vec().into(), &plan).unwrap();
    let verdict = judge(&plan, &timelines, &Circumstances::default());
    assert_eq!(names(&verdict, Some(true)), [] as [&str; 0]);
    assert_eq!(names(&verdict, None).len(), 7);
    assert_eq!(verdict.outcome, Outcome::Incomplete);
    let circumstances = Circumstances {
        ended_early: Some(EarlyEnd::without_node(EndedBy::Bench, "the bus went down")),
        ..Circumstances::default()
    };
    let broken = judge(&plan, &timelines, &circumstances);
    assert_eq!(names(&broken, Some(true)), [] as [&str; 0]);
    assert!(value(&broken, "missed_cycles_percent").is_some());
}

#[test]
fn a_limit_on_faults_is_not_met_by_a_recording_without_them() {
    let mut plan = step_plan("");
    let frames = frames(4000, |_| Some(35.0));
    let limits = "safe_state = true\ncurrent_zero_within_milliseconds = 60.0\n\
                  recovers_within_seconds = 1.0\nemcy = [\"drive 0x8130\"]\n";
    let with_fault = step_plan(&format!("{CRASH}[expect]\n{limits}"));
    plan.loops.first_mut().unwrap().trial.expect =
        with_fault.only_loop().unwrap().trial.expect.clone();
    let timelines = decode(&frames.into(), &plan).unwrap();
    let verdict = judge(&plan, &timelines, &Circumstances::default());
    assert_eq!(names(&verdict, Some(true)), [] as [&str; 0]);
    let unseen = ["current_zero_within_milliseconds", "safe_state"];
    assert_eq!(names(&verdict, None), unseen);
    let missed = ["recovers_within_seconds", "emcy"];
    assert_eq!(names(&verdict, Some(false)), missed);
}

#[test]
fn a_run_without_currents_says_so() {
    let mut frames = frames(4000, |_| None);
    frames.remove(0);
    let feedback = CanFrame::new(0x190, &[0x37, 0x02]);
    frames.insert(0, Stamped::new(Duration::ZERO, feedback));
    let verdict = verdict_on(&step_plan(""), &frames, 0);
    let reason = row(&verdict, "current_amperes_rms").remark.as_deref();
    assert_eq!(reason, Some("no current in the recording"));
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
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"sine\"\nduration_seconds = 4.0\n[controller.pid]\n[[reference.sine]]\n\
                from_seconds = 0.0\ncentre_millimetres = 25.0\namplitude_millimetres = 10.0\nperiod_seconds = 0.8\n";
    let sine = testing::plan(text);
    let omega = std::f64::consts::TAU / 0.8;
    let judged = |lag: f64| {
        let position = |cycle| 24.0 + 7.0 * libm::sin(omega * f64::from(cycle) / 1e3 - lag);
        verdict_on(&sine, &frames(4000, |cycle| Some(position(cycle))), 0)
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
fn a_step_without_a_value_is_named_among_several() {
    let second = "[[reference.step]]\nat_seconds = 2.5\nposition_millimetres = 15.0\n";
    let text = format!("{}{second}", scenario_text(""));
    let steps = testing::plan(&text);
    let settles_once = frames(4000, |cycle| Some(if cycle < 1100 { 10.0 } else { 35.0 }));
    let verdict = verdict_on(&steps, &settles_once, 0);
    let reason = row(&verdict, "settling_time_seconds").remark.as_deref();
    assert_eq!(reason, Some("step at 2.5 s: never settled"));
}

#[test]
fn the_limits_of_a_scenario_are_those_of_its_verdict() {
    let limited = step_plan(
        "[expect]\novershoot_percent = { max = 5.0 }\nno_event = [\"bus-off\"]\n\
         [[expect.signal]]\nname = \"position_millimetres\"\nfrom_seconds = 2\n\
         stays = { min = 34.0, max = 36.0 }\nreaches = { min = 35.0 }\n\
         [[expect.sequence]]\nname = \"rise\"\n\
         event = [{ signal = \"position_millimetres\", reaches = { min = 34.0 } }]\n",
    );
    let position = step_response(1.1);
    let cycles = frames(4000, |cycle| Some(position(f64::from(cycle) / 1e3)));
    let rows = verdict_on(&limited, &cycles, 0).metrics.into_iter();
    let judged: Vec<_> = rows
        .filter_map(|row| Some((row.name, row.limit?)))
        .collect();
    let all = limited
        .only_loop()
        .unwrap()
        .trial
        .expected_rows()
        .into_iter();
    let expected = all.filter_map(|row| Some((row.name, row.limit?)));
    assert_eq!(Vec::from_iter(expected), judged);
    assert_eq!(judged.len(), 5);
}

#[test]
fn each_sine_is_judged_and_the_worst_reported() {
    let sine = |from: f64| {
        format!(
            "[[reference.sine]]\nfrom_seconds = {from:?}\ncentre_millimetres = 25.0\n\
             amplitude_millimetres = 10.0\nperiod_seconds = 0.4\n"
        )
    };
    let text = |expect: &str| {
        format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"sines\"\nduration_seconds = 4.0\n[controller.pid]\n{}{}{expect}",
            sine(0.0),
            sine(2.0)
        )
    };
    let omega = std::f64::consts::TAU / 0.4;
    let amplitude = |cycle| if cycle < 2000 { 7.0 } else { 12.0 };
    let position = |cycle| 25.0 + amplitude(cycle) * libm::sin(omega * f64::from(cycle) / 1e3);
    let judged = |expect: &str| {
        let verdict = verdict_on(
            &testing::plan(&text(expect)),
            &frames(4000, |cycle| Some(position(cycle))),
            0,
        );
        let gain = row(&verdict, "sine_gain");
        (
            (1e3 * gain.value.unwrap()).round(),
            gain.at_seconds,
            gain.passed,
        )
    };
    assert_eq!(judged(""), (700.0, Some(0.8), None));
    let limit = "[expect]\nsine_gain = { min = 0.6, max = 1.1 }\n";
    assert_eq!(judged(limit), (1200.0, Some(2.8), Some(false)));
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
    // A module without a heartbeat is absent, so its commands have no effect.
    frames.retain(|stamped| stamped.frame.standard_id() != Some(0x711));
    let judged = |limits: &str| verdict_on(&step_plan(&format!("{fan}{limits}")), &frames, 0);
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
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"open\"\nduration_seconds = 4.0\n[controller.open_loop]\n\
                [[disturbance.fan]]\nfrom_seconds = 1.0\nuntil_seconds = 2.0\nconvection_factor = 5.0\n";
    let open = testing::plan(text);
    let verdict = verdict_on(&open, &frames(4000, |_| Some(10.0)), 0);
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
    let limited = step_plan("[expect]\nsettling_time_seconds = { max = 3.0 }");
    let verdict = verdict_on(&limited, &frames(4000, |_| Some(10.0)), 0);
    assert_eq!(verdict.outcome, Outcome::Fail);
    assert_eq!(verdict.metrics[0].remark.as_deref(), Some("never settled"));
}

#[test]
fn what_comes_after_the_end_is_no_part_of_the_last_cycle() {
    let mut frames = frames(4000, |_| Some(35.0));
    // The scenario begins at 1 ms and ends at 4.001 s. A drive that stops may send anything after that.
    let late = Duration::from_micros(4_001_200);
    frames.push(Stamped::new(late, frames[0].frame));
    let verdict = verdict_on(&step_plan(""), &frames, 0);
    assert_eq!(value(&verdict, "steady_state_error_millimetres"), Some(0.0));
}

#[test]
fn cycles_that_are_missing_at_the_end_are_missed_ones() {
    let mut late = frames(3985, |_| Some(35.0));
    assert_eq!(
        verdict_on(&step_plan(""), &late, 0).outcome,
        Outcome::Incomplete
    );
    // A SYNC after the end shows that the scenario ended: the machine stood still for 15 ms, not the run.
    let after_end = Duration::from_micros(4_001_300);
    late.push(Stamped::new(after_end, CanFrame::new(0x080, &[1])));
    let verdict = verdict_on(&step_plan(""), &late, 0);
    assert_eq!(value(&verdict, "missed_cycles_percent"), Some(0.375));
    assert_eq!(verdict.outcome, Outcome::Pass);
}

#[test]
fn a_bad_recording_decides_nothing() {
    let whole = frames(4000, |cycle| {
        Some(step_response(1.1)(f64::from(cycle) / 1e3))
    });
    let outcome = |frames: &[Stamped], lost| verdict_on(&step_plan(""), frames, lost).outcome;
    assert_eq!(outcome(&whole, 0), Outcome::Pass);
    assert_eq!(outcome(&whole, 1), Outcome::Inconclusive);
    assert_eq!(outcome(&whole[..whole.len() / 2], 0), Outcome::Incomplete);
    assert_eq!(outcome(&[], 0), Outcome::Incomplete);
}

/// Every 50th cycle lacks its position, then its SYNC: 2 % are missed, more than 1 %.
#[test]
fn what_the_nodes_leave_out_fails_the_run_whoever_lost_frames() {
    let whole = frames(4000, |_| Some(35.0));
    let silent = frames(4000, |cycle| (cycle % 50 != 7).then_some(35.0));
    let verdict = verdict_on(&step_plan(""), &silent, 3);
    assert_eq!(verdict.outcome, Outcome::Fail);
    let reason = "drive: no position in 2.00 % of the cycles, first at 0.007 s (limit 1 %)";
    assert_eq!(verdict.reason.as_deref(), Some(reason));
    let outcome = |lost| verdict_on(&step_plan(""), &silent, lost).outcome;
    assert_eq!(outcome(50), Outcome::Inconclusive, "half may be lost ones");
    let is_kept = |stamped: &&Stamped| {
        let is_sync = stamped.frame.standard_id() == Some(0x080);
        !(is_sync && stamped.time.as_millis() % 50 == 7)
    };
    let skipped: Vec<Stamped> = whole.iter().filter(is_kept).copied().collect();
    let verdict = verdict_on(&step_plan(""), &skipped, 0);
    assert_eq!(verdict.outcome, Outcome::Fail);
    let reason = "controller: no SYNC in 2.00 % of the cycles, first at 0.006 s (limit 1 %)";
    assert_eq!(verdict.reason.as_deref(), Some(reason));
    // A scenario that permits as many has its own limit.
    let permits = step_plan("[expect]\nmissed_cycles_percent = { max = 3 }");
    assert_eq!(verdict_on(&permits, &skipped, 0).outcome, Outcome::Pass);
}

/// Adds a command after each position.
fn answer_positions(frames: &mut Vec<Stamped>) {
    let is_position = |one: &&Stamped| one.frame.standard_id() == Some(0x190);
    let answers = frames.iter().filter(is_position).map(|position| {
        let command = CanFrame::new(0x210, &[0x0F, 0, 0, 0]);
        Stamped::new(position.time + Duration::from_micros(270), command)
    });
    frames.extend(Vec::from_iter(answers));
    frames.sort_by_key(|stamped| stamped.time);
}

/// Judges a step to 36 mm, 4 % too far, at 1.2 s, with cycles without a position in a stall of the machine.
fn beside_a_stall(
    added: &str,
    missed: std::ops::Range<u32>,
    stall: (u64, u64),
    position: impl Fn(f64) -> f64,
) -> Verdict {
    let plan = step_plan(added);
    let is_missed = |cycle| missed.contains(&cycle);
    judge_beside_a_stall(&plan, is_missed, stall, position)
}

fn judge_beside_a_stall(
    plan: &Plan,
    is_missed: impl Fn(u32) -> bool,
    stall: (u64, u64),
    position: impl Fn(f64) -> f64,
) -> Verdict {
    let position = |cycle| (!is_missed(cycle)).then(|| position(f64::from(cycle) / 1e3));
    let mut frames = frames(4000, position);
    answer_positions(&mut frames);
    let timelines = decode(&frames.into(), plan).unwrap();
    // The scenario begins at 1 ms.
    let (from, until) = (
        Duration::from_millis(1 + stall.0),
        Duration::from_millis(1 + stall.1),
    );
    let circumstances = Circumstances {
        host: Host {
            stalls: vec![Stall::new(from, until, Who::Machine, What::StoodStill)],
            ..Host::default()
        },
        ..Circumstances::default()
    };
    judge(plan, &timelines, &circumstances)
}

const STEP_LIMIT: &str = "[expect]\novershoot_percent = { max = 1.0 }\n";

fn overshooting(time: f64) -> f64 {
    if (time - 1.2).abs() < 5e-4 {
        36.0
    } else {
        step_response(1.1)(time)
    }
}

#[test]
fn a_limit_is_open_where_a_stall_in_its_window_explains_it() {
    let verdict = beside_a_stall(STEP_LIMIT, 1150..1165, (1150, 1165), overshooting);
    assert_eq!(verdict.outcome, Outcome::Inconclusive);
    let reason = "not judged, since the machine stood still for 15.0 ms at 1.150 s: overshoot_percent; \
        run it again or use --clock lockstep";
    assert_eq!(verdict.reason.as_deref(), Some(reason));
    assert!(verdict.is_spoiled_by_stalls());
    // A limit that is met stays met.
    let met = beside_a_stall(STEP_LIMIT, 1150..1165, (1150, 1165), step_response(1.1));
    assert!(!met.is_spoiled_by_stalls());
    assert_eq!((met.outcome, met.reason), (Outcome::Pass, None));
    // A stall in which no cycle was missed explains no miss.
    let verdict = beside_a_stall(STEP_LIMIT, 0..0, (1150, 1165), overshooting);
    assert_eq!(verdict.outcome, Outcome::Fail);
    assert!(!verdict.is_spoiled_by_stalls());
}

/// The external drive misses a cycle of its own, far from the stall and within the limit; or a
/// limit is on what it does not send.
#[test]
fn what_another_play_might_hide_or_cannot_decide_is_not_spoiled() {
    let judged = |limit: &str, own_miss: Option<u32>| {
        let plan = step_plan(limit);
        let plan = plan.recorded_external(&["drive".to_owned()]);
        let is_missed = |cycle| (1150..1165).contains(&cycle) || Some(cycle) == own_miss;
        let verdict = judge_beside_a_stall(&plan, is_missed, (1150, 1165), overshooting);
        assert_eq!(
            verdict.outcome,
            Outcome::Inconclusive,
            "{:?}",
            verdict.reason
        );
        verdict.is_spoiled_by_stalls()
    };
    assert!(judged(STEP_LIMIT, None));
    assert!(!judged(STEP_LIMIT, Some(2500)));
    let unsent = format!("{STEP_LIMIT}temperature_celsius = {{ max = 100.0 }}\n");
    assert!(!judged(&unsent, None));
}

/// All samples of the check are in the shadow of the stall.
#[test]
fn a_check_of_what_a_stall_moved_is_open() {
    let check = "[[expect.signal]]\nname = \"position_millimetres\"\nfrom_seconds = 1.17\nuntil_seconds = 1.3\n\
        stays = { max = 20.0 }\n";
    let verdict = beside_a_stall(check, 1150..1165, (1150, 1165), step_response(1.1));
    assert_eq!(
        verdict.outcome,
        Outcome::Inconclusive,
        "{:?}",
        verdict.reason
    );
    let verdict = beside_a_stall(check, 0..0, (1150, 1165), step_response(1.1));
    assert_eq!(verdict.outcome, Outcome::Fail);
}

/// The first silence is in the stall, the second is the drive's own.
#[test]
fn a_silence_behind_that_of_a_stall_is_the_nodes() {
    let check = "[[expect.signal]]\nname = \"position_millimetres\"\nstays = { max = 60.0 }\n";
    let plan = step_plan(check);
    let judged = |missed: std::ops::Range<u32>| {
        let is_missed = |cycle| (1150..1190).contains(&cycle) || missed.contains(&cycle);
        let mut frames = frames(4000, |cycle| (!is_missed(cycle)).then_some(35.0));
        answer_positions(&mut frames);
        let timelines = decode(&frames.into(), &plan).unwrap();
        let (from, until) = (Duration::from_millis(1151), Duration::from_millis(1191));
        let circumstances = Circumstances {
            host: Host {
                stalls: vec![Stall::new(from, until, Who::Machine, What::StoodStill)],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        let mut rows = verdict.metrics.into_iter();
        rows.find(|row| row.name.contains("stays")).unwrap()
    };
    let row = judged(0..0);
    assert_eq!(row.passed, None, "{row:?}");
    let row = judged(3500..3530);
    assert_eq!(row.passed, Some(false), "{row:?}");
}

#[test]
fn a_limit_that_was_missed_before_the_first_stall_is_missed() {
    for (missed, stall) in [(1300..1315, (1300, 1315)), (3000..3200, (3000, 3200))] {
        let verdict = beside_a_stall(STEP_LIMIT, missed, stall, overshooting);
        assert_eq!(verdict.outcome, Outcome::Fail, "{:?}", verdict.reason);
    }
    // A step without height has no overshoot, stall or not.
    let flat = "[[reference.step]]\nat_seconds = 0.5\nposition_millimetres = 10.0\n";
    let limit = format!("{STEP_LIMIT}{flat}");
    let verdict = beside_a_stall(&limit, 800..815, (800, 815), step_response(1.1));
    assert_eq!(verdict.outcome, Outcome::Fail, "{:?}", verdict.reason);
    // More than 1 % of the cycles were missed in stalls, and none before them: the result is open.
    let verdict = beside_a_stall(STEP_LIMIT, 3000..3200, (3000, 3200), step_response(1.1));
    assert_eq!(verdict.outcome, Outcome::Inconclusive);
    let reason = verdict.reason.unwrap();
    assert!(reason.contains("too busy for real time"), "{reason}");
    assert!(reason.contains("200.0 ms at 3.000 s"), "{reason}");
    let row = verdict
        .metrics
        .iter()
        .find(|row| row.name == "overshoot_percent");
    assert_eq!(row.unwrap().passed, None);
}

/// The step is hidden by the stall and its shadow: the largest position that is left says nothing of a least one.
#[test]
fn a_largest_value_may_have_been_larger_in_a_stall() {
    let limit =
        |min| format!("[expect]\nposition_millimetres_max = {{ min = {min:.1}, max = 60.0 }}\n");
    let judged = |min, missed, position: fn(f64) -> f64| {
        beside_a_stall(&limit(min), missed, (1050, 1250), position).outcome
    };
    let risen = |time: f64| step_response(1.1)(time);
    assert_eq!(judged(34.9, 1050..1250, risen), Outcome::Inconclusive);
    assert_eq!(judged(34.9, 0..0, |_| 10.0), Outcome::Fail);
    // A short stall moves the loop too little.
    let short = beside_a_stall(&limit(34.9), 1800..1803, (1800, 1804), |_| 10.0);
    assert_eq!(short.outcome, Outcome::Fail);
    // An overshoot until the stall says nothing of a least one, either.
    let overshoot = "[expect]\novershoot_percent = { min = 1.0 }\n";
    let judged =
        |missed| beside_a_stall(overshoot, missed, (1050, 1250), step_response(1.1)).outcome;
    assert_eq!(judged(1050..1250), Outcome::Inconclusive);
    assert_eq!(judged(0..0), Outcome::Fail);
    // It was too high before the stall.
    let verdict = beside_a_stall(
        "[expect]\nposition_millimetres_max = { max = 9.0 }\n",
        1050..1250,
        (1050, 1250),
        risen,
    );
    assert_eq!(verdict.outcome, Outcome::Fail);
}

/// The stall hides the first of two steps from its start. Neither has an overshoot that shows.
#[test]
fn the_worst_step_may_be_one_that_a_stall_hid() {
    let two_steps = "[expect]\novershoot_percent = { min = 2.0 }\n\
        [[reference.step]]\nat_seconds = 0.2\nposition_millimetres = 20.0\n";
    let follows = |time: f64| match time {
        ..0.3 => 10.0,
        ..1.1 => 20.0,
        _ => 35.0,
    };
    let judged = |missed| beside_a_stall(two_steps, missed, (190, 202), follows).outcome;
    assert_eq!(judged(190..202), Outcome::Inconclusive);
    assert_eq!(judged(0..0), Outcome::Fail);
}

/// The run misses 5 %, half of them in a stall. Without the stall it meets a limit of 3 %, and misses one of 2 %.
#[test]
fn missed_cycles_have_their_limit_without_those_of_the_bench() {
    let judged = |max: f64| {
        let limit = format!("[expect]\nmissed_cycles_percent = {{ max = {max:.1} }}\n");
        let plan = step_plan(&limit);
        let is_missed = |cycle| (2000..2100).contains(&cycle) || (3000..3100).contains(&cycle);
        let frames = frames(4000, |cycle| (!is_missed(cycle)).then_some(35.0));
        let timelines = decode(&frames.into(), &plan).unwrap();
        let (from, until) = (Duration::from_millis(2001), Duration::from_millis(2101));
        let circumstances = Circumstances {
            host: Host {
                stalls: vec![Stall::new(from, until, Who::PlantEmulator, What::Waited)],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        assert_eq!(value(&verdict, "missed_cycles_percent"), Some(5.0));
        verdict.outcome
    };
    assert_eq!(judged(2.0), Outcome::Fail);
    assert_eq!(judged(3.0), Outcome::Inconclusive);
}

/// The run has 5 % of its cycles without a command, all of them in a stall or none.
#[test]
fn missed_commands_have_their_limit_without_those_of_the_bench() {
    let limit = "[expect]\nmissed_commands_percent = { max = 3.0 }\n";
    let plan = step_plan(limit);
    let mut frames = commanded(step_response(1.1), |_| 0.5);
    frames.retain(|stamped| {
        let is_command = stamped.frame.standard_id() == Some(0x210);
        !(is_command && (2001..2201).contains(&stamped.time.as_millis()))
    });
    let timelines = decode(&frames.into(), &plan).unwrap();
    let judged = |who| {
        let (from, until) = (Duration::from_millis(2001), Duration::from_millis(2201));
        let circumstances = Circumstances {
            host: Host {
                stalls: vec![Stall::new(from, until, who, What::Waited)],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        assert_eq!(value(&verdict, "missed_commands_percent"), Some(5.0));
        (verdict.outcome, verdict.reason.unwrap())
    };
    let reason = "not judged, since the controller waited for a processor for 200.0 ms at 2.000 s: missed_commands_percent";
    let (outcome, found) = judged(Who::Controller);
    assert_eq!(outcome, Outcome::Inconclusive, "{found}");
    assert!(found.starts_with(reason), "{found}");
    let reason = "controller: no command in 5.00 % of the cycles, first at 2.000 s (limit 3 %)";
    assert_eq!(
        judged(Who::PlantEmulator),
        (Outcome::Fail, reason.to_owned())
    );
}

/// A node is given up in a stall in which no cycle was missed.
#[test]
fn an_end_in_a_stall_proves_nothing() {
    let plan = step_plan("");
    let mut frames = frames(2000, |_| Some(10.0));
    answer_positions(&mut frames);
    let timelines = decode(&frames.into(), &plan).unwrap();
    let judged = |node: &str, stall: (u64, u64)| {
        let [from, until] = [stall.0, stall.1].map(|time| Duration::from_millis(1 + time));
        let circumstances = Circumstances {
            ended_early: Some(EarlyEnd {
                node: Some(node.to_owned()),
                since_seconds: Some(1.9),
                at_seconds: Some(2.0),
                ..EarlyEnd::without_node(EndedBy::Node, "given up")
            }),
            host: Host {
                stalls: vec![Stall::new(from, until, Who::Machine, What::StoodStill)],
                ..Host::default()
            },
            ..Circumstances::default()
        };
        judge(&plan, &timelines, &circumstances).outcome
    };
    // The io node is outside the loop.
    for node in ["drive", "disturbance"] {
        assert_eq!(judged(node, (1900, 2000)), Outcome::Inconclusive);
        assert_eq!(judged(node, (1000, 1100)), Outcome::Fail);
    }
}

/// The controller gives up at the frame that shows it, so SYNC and commands are missing from there
/// on.
#[test]
fn a_drive_beyond_a_limit_of_its_rig_fails_the_run() {
    let judged = |added: &str, external: &[&str]| {
        let external = external.iter().map(ToString::to_string);
        let plan = step_plan(added);
        let plan = plan.recorded_external(&Vec::from_iter(external));
        let mut frames = frames(1500, |_| Some(10.0));
        answer_positions(&mut frames);
        let last = frames.iter().rposition(|one| one.frame.raw_id() == 0x190);
        frames.truncate(last.unwrap() + 1);
        let timelines = decode(&frames.into(), &plan).unwrap();
        let circumstances = Circumstances {
            ended_early: Some(EarlyEnd {
                node: Some("drive".to_owned()),
                at_seconds: Some(1.499_13),
                is_rig_limit: true,
                ..EarlyEnd::without_node(EndedBy::Node, "limit of the rig")
            }),
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        let cause = verdict.cause.unwrap();
        let reason = verdict.reason.unwrap();
        (verdict.outcome, reason, [cause.node, cause.duty])
    };
    let drive = ["drive", "limit"].map(str::to_owned);
    let expected = (Outcome::Fail, "drive: limit of the rig".to_owned(), drive);
    assert_eq!(judged("", &["drive"]), expected);
    let (outcome, reason, cause) = judged("", &["drive", "controller"]);
    assert_eq!((outcome, &cause), (Outcome::Fail, &expected.2));
    assert_eq!(
        reason,
        "drive: limit of the rig; the controller that leads it is under test, too"
    );
    let corrupt = |from: f64| {
        let added = format!(
            "[[fault.bus.corrupt]]\nfrom_seconds = {from:.1}\nsender = \"drive\"\nidentifier = 0x190\nprobability = 1.0\n"
        );
        let (outcome, _, [node, _]) = judged(&added, &["drive"]);
        (outcome, node)
    };
    assert_eq!(corrupt(1.0), (Outcome::Inconclusive, "fault".to_owned()));
    assert_eq!(corrupt(3.0), (Outcome::Fail, "drive".to_owned()));
}

#[test]
fn a_node_that_ends_a_run_fails_it_and_the_bench_and_the_user_do_not() {
    let plan = step_plan("");
    let timelines = decode(&frames(2000, |_| Some(10.0)).into(), &plan).unwrap();
    let judged = |by| {
        let circumstances = Circumstances {
            ended_early: Some(EarlyEnd {
                node: (by == EndedBy::Node).then(|| "controller".to_owned()),
                ..EarlyEnd::without_node(by, "silent since 2.000 s")
            }),
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        assert_eq!(verdict.ended_early, circumstances.ended_early);
        (verdict.outcome, verdict.reason.unwrap())
    };
    let reason = "controller: silent since 2.000 s";
    assert_eq!(judged(EndedBy::Node), (Outcome::Fail, reason.to_owned()));
    for by in [EndedBy::Bench, EndedBy::User] {
        let reason = "silent since 2.000 s".to_owned();
        assert_eq!(judged(by), (Outcome::Incomplete, reason));
    }
}

/// Returns the frames of a good run, with each SYNC a second time.
fn with_foreign_syncs() -> Vec<Stamped> {
    let frames = frames(4000, |_| Some(10.0));
    let is_sync = |stamped: &&Stamped| stamped.frame.standard_id() == Some(0x080);
    let half = Duration::from_micros(500);
    let foreign = frames
        .iter()
        .filter(is_sync)
        .map(|stamped| Stamped::new(stamped.time + half, stamped.frame));
    let mut all: Vec<Stamped> = frames.iter().copied().chain(foreign).collect();
    all.sort_by_key(|stamped| stamped.time);
    all
}

#[test]
fn a_second_master_lets_nothing_pass_and_nothing_fail() {
    let frames = with_foreign_syncs();
    for limits in [
        "[expect]\n",
        "[expect]\nposition_millimetres_max = { max = 1.0 }\n",
    ] {
        let verdict = verdict_on(&step_plan(limits), &frames, 0);
        assert_eq!(verdict.outcome, Outcome::Inconclusive);
        let reason = verdict.reason.unwrap();
        let expected = "a second master: 0x080 (SYNC), ";
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
        verdict_on(&step_plan(""), &frames, 0)
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
    let frames = Frames::from(frames(4000, |_| Some(10.0)));
    let circumstances = Circumstances {
        unrecorded: Unrecorded {
            fd_frames: 7,
            ..Unrecorded::default()
        },
        ..Circumstances::default()
    };
    for (limits, outcome) in [
        ("", Outcome::Pass),
        (
            "[expect]\nbus_load_percent = { max = 90.0 }\n",
            Outcome::Inconclusive,
        ),
    ] {
        let plan = step_plan(limits);
        let timelines = decode(&frames, &plan).unwrap();
        let verdict = judge(&plan, &timelines, &circumstances);
        assert_eq!((verdict.outcome, verdict.fd_frames), (outcome, 7));
        assert!(verdict.losses[0].starts_with("7 CAN FD frames on the bus"));
    }
}

#[test]
fn a_stall_excuses_what_it_moved_and_nothing_later() {
    let limit = "[expect]\nposition_millimetres_max = { max = 36.0 }\n";
    let judged = |length: u32, at_seconds: f64, position: f64| {
        let course = move |time: f64| {
            if (time - at_seconds).abs() < 5e-4 {
                position
            } else {
                step_response(1.1)(time)
            }
        };
        let stall = (1800, 1800 + u64::from(length));
        beside_a_stall(limit, 1800..1800 + length - 1, stall, course).outcome
    };
    // A long stall moves the loop until 0.5 s and 20 times its length after its end, however far.
    assert_eq!(judged(25, 2.8, 60.0), Outcome::Inconclusive);
    assert_eq!(judged(25, 2.9, 37.0), Outcome::Fail);
    assert_eq!(judged(25, 1.7, 37.0), Outcome::Fail);
    // A short stall moves the loop only while it lasts, and by a tenth of the limit.
    assert_eq!(judged(4, 1.803, 39.0), Outcome::Inconclusive);
    assert_eq!(judged(4, 1.803, 40.0), Outcome::Fail);
    assert_eq!(judged(4, 1.9, 39.0), Outcome::Fail);
}

#[test]
fn a_step_that_a_stall_interrupts_takes_that_long_at_least() {
    let judged = |max: f64| {
        let limit = format!("[expect]\nsettling_time_seconds = {{ max = {max:.1} }}\n");
        let late = |time: f64| if time < 2.5 { 10.0 } else { 35.0 };
        beside_a_stall(&limit, 2000..2030, (2000, 2030), late).outcome
    };
    // The position had not settled within 0.9 s, which is proof enough.
    assert_eq!(judged(0.5), Outcome::Fail);
    assert_eq!(judged(1.2), Outcome::Inconclusive);
    assert_eq!(judged(1.6), Outcome::Pass);
}

/// The controller's heartbeat stops at 1 s, the drive goes silent because of it, and the run ends.
#[test]
fn the_earliest_breach_is_the_cause() {
    let mut all = frames(1300, |cycle| (cycle < 1200).then_some(10.0));
    answer_positions(&mut all);
    for beat in 0..100_u64 {
        let time = Duration::from_micros(20_000 * beat + 500);
        if beat < 50 {
            all.push(Stamped::new(time, CanFrame::new(0x701, &[5])));
        }
        all.push(Stamped::new(time, CanFrame::new(0x710, &[5])));
    }
    all.sort_by_key(|stamped| stamped.time);
    let judged = |frames: &[Stamped], stalls: Vec<Stall>| {
        let plan = step_plan("");
        let timelines = decode(&frames.to_vec().into(), &plan).unwrap();
        let circumstances = Circumstances {
            ended_early: Some(EarlyEnd {
                node: Some("drive".to_owned()),
                since_seconds: Some(1.2),
                at_seconds: Some(1.3),
                ..EarlyEnd::without_node(EndedBy::Node, "silent since 1.200 s")
            }),
            host: Host {
                stalls,
                ..Host::default()
            },
            ..Circumstances::default()
        };
        let verdict = judge(&plan, &timelines, &circumstances);
        let cause = verdict.cause.unwrap();
        (
            verdict.outcome,
            verdict.reason.unwrap(),
            cause.node,
            cause.duty,
        )
    };
    let (outcome, reason, node, duty) = judged(&all, Vec::new());
    let expected = "controller: no heartbeat from 1.000 s on; drive: silent since 1.200 s";
    assert_eq!((outcome, reason.as_str()), (Outcome::Fail, expected));
    assert_eq!((node.as_str(), duty.as_str()), ("controller", "heartbeat"));
    // With all heartbeats, the drive is the first.
    let beats = (50..66).map(|beat| Duration::from_micros(20_000 * beat + 500));
    all.extend(beats.map(|time| Stamped::new(time, CanFrame::new(0x701, &[5]))));
    all.sort_by_key(|stamped| stamped.time);
    let (outcome, reason, node, duty) = judged(&all, Vec::new());
    let expected = "drive: silent since 1.200 s";
    assert_eq!((outcome, reason.as_str()), (Outcome::Fail, expected));
    assert_eq!((node.as_str(), duty.as_str()), ("drive", "position"));
    // A stall that covers half of the time explains it; a shorter one does not.
    for (milliseconds, expected) in [(60, Outcome::Inconclusive), (40, Outcome::Fail)] {
        let [from, until] = [1201, 1201 + milliseconds].map(Duration::from_millis);
        let stall = Stall::new(from, until, Who::Machine, What::StoodStill);
        let (outcome, reason, node, _) = judged(&all, vec![stall]);
        assert_eq!(outcome, expected, "{reason}");
        let is_host = outcome == Outcome::Inconclusive;
        assert_eq!(node, if is_host { "host" } else { "drive" });
    }
}

#[test]
fn a_node_without_a_heartbeat_at_the_end_is_named() {
    let mut all = frames(4000, |_| Some(10.0));
    let beats = (0..150_u64).map(|beat| Duration::from_micros(20_000 * beat + 500));
    all.extend(beats.map(|time| Stamped::new(time, CanFrame::new(0x710, &[5]))));
    all.sort_by_key(|stamped| stamped.time);
    let verdict = verdict_on(&step_plan(""), &all, 0);
    assert_eq!(verdict.outcome, Outcome::Fail);
    let reason = "drive: no heartbeat from 3.000 s to the end";
    assert_eq!(verdict.reason.as_deref(), Some(reason));
}

/// The run passes, with a remark that no limit was judged.
#[test]
fn a_run_in_which_nothing_is_limited_judges_nothing() {
    let whole = frames(4000, |_| Some(10.0));
    let judged = |limits: &str| verdict_on(&step_plan(limits), &whole, 0);
    let verdict = judged("");
    assert_eq!(
        (verdict.outcome, verdict.cause.is_none()),
        (Outcome::Pass, true)
    );
    let remark = "nothing was limited, so nothing was judged";
    assert_eq!(verdict.remark().as_deref(), Some(remark));
    let limited = judged("[expect]\nposition_millimetres_max = { max = 36.0 }\n");
    assert!(!limited.judged_nothing());
    assert_eq!(limited.remark(), None);
}

#[test]
fn ripple_needs_commands() {
    let mut frames = commanded(step_response(1.0), |_| 0.5);
    frames.retain(|stamped| {
        let is_command = stamped.frame.standard_id() == Some(0x210);
        !(is_command && (2500..2525).contains(&stamped.time.as_millis()))
    });
    let verdict = verdict_on(&step_plan(RIPPLE), &frames, 0);
    let remark = row(&verdict, "current_ripple_amperes_rms")
        .remark
        .clone()
        .unwrap();
    assert!(
        remark.starts_with("no command from 2.499 to 2.52"),
        "{remark}"
    );
}

/// The position is outside the band from 4 to 5 s after the disturbance.
#[test]
fn a_slow_loop_is_watched_until_something_else_moves_it() {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"slow\"\nduration_seconds = 9.0\n[controller.sliding_mode]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
        [[disturbance.load]]\nat_seconds = 1.0\nadded_grams = 1.0\n";
    let recovery = |added: &str| {
        let text = format!("{text}{added}");
        let slow = testing::plan(&text);
        let frames = frames(9000, |cycle| {
            Some(if (5000..6000).contains(&cycle) {
                11.0
            } else {
                10.0
            })
        });
        value(&verdict_on(&slow, &frames, 0), "recovery_time_seconds")
    };
    assert_eq!(recovery(""), Some(5.0));
    let step = "[[reference.step]]\nat_seconds = 4.5\nposition_millimetres = 10.5\n";
    assert_eq!(recovery(step), Some(0.0));
}

/// A clock that runs 2 % slow for 64 periods has just the error that is allowed.
#[test]
fn a_sync_period_error_that_equals_its_limit_is_met() {
    let plan = step_plan("");
    let plan = plan.recorded_external(&["controller".to_owned()]);
    let outcome = |slow_micros: u32, from: u64| {
        let mut frames = frames(4000, |_| Some(10.0));
        answer_positions(&mut frames);
        for stamped in &mut frames {
            let cycles = stamped.time.as_micros() / 1000;
            let slow = cycles.saturating_sub(u128::from(from)).min(64);
            let slow = u32::try_from(slow).unwrap();
            stamped.time += Duration::from_micros(u64::from(slow * slow_micros));
        }
        let timelines = decode(&frames.into(), &plan).unwrap();
        judge(&plan, &timelines, &Circumstances::default()).outcome
    };
    for from in 100..120 {
        assert_eq!(outcome(20, from), Outcome::Pass, "{from}");
    }
    assert_eq!(outcome(21, 100), Outcome::Fail);
}
