//! Missing frames and their excuses: runs are simulated, frames are removed from their recordings, and the rest is
//! judged as a run with foreign nodes.

use campaigns::campaign::Campaign;
use judge::verdict::{Outcome, Verdict};
use judge::{Circumstances, judge};
use plan::Plan;
use plan::catalogue::Catalogue;
use recording::hits::{Effect, Hit, Hits};
use recording::log::Stamped;
use recording::timeline::decode;
use recording::unrecorded::Unrecorded;
use worlds::catalogue::catalogue;

use crate::support;

const SYNC: u16 = 0x080;
const POSITION: u16 = 0x190;
const COMMAND: u16 = 0x210;
const CONTROLLER_EMERGENCY: u16 = 0x081;
const CONTROLLER_HEARTBEAT: u16 = 0x701;

/// Faults from 0 to the end; none of them affects a frame.
const NOISE: &str = "[[fault.sensor.noise]]\nfrom_seconds = 0.0\nnoise_millimetres_rms = 0.01\n";
const SLOW: &str = "[[fault.node.slow_cycle]]\nfrom_seconds = 0.0\nnode = \"controller\"\ndelay_milliseconds = 0.1\n";

/// 6 s at 1 kHz.
fn plan(faults: &str, catalogue: &Catalogue) -> Plan {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"missed\"\nseed = 7\nduration_seconds = 6.0\n[controller.sliding_mode]\n\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 20.0\n{faults}"
    );
    testing::plan_beside(&text, &[], catalogue)
}

fn fault(kind: &str, node: &str, from_seconds: f64) -> String {
    format!("[[fault.node.{kind}]]\nfrom_seconds = {from_seconds:.2}\nnode = \"{node}\"\n")
}

/// Returns the frames of a run.
fn played(faults: &str) -> Vec<Stamped> {
    let campaign = Campaign::on_all_cores(false);
    let frames = campaign.play([plan(faults, catalogue())].into_iter(), |played| {
        played.frames.iter().collect::<Vec<Stamped>>()
    });
    frames.unwrap().remove(0).unwrap()
}

/// Returns the frames without some of those with an identifier, chosen by the number of the SYNC before them.
fn without(frames: &[Stamped], ids: &[u16], is_missing: impl Fn(u32) -> bool) -> Vec<Stamped> {
    let mut number = 0;
    let kept = frames.iter().filter(|stamped| {
        let id = stamped.frame.standard_id();
        number += u32::from(id == Some(SYNC));
        !(id.is_some_and(|id| ids.contains(&id)) && is_missing(number))
    });
    kept.copied().collect()
}

/// Judges frames by a scenario with these faults, with a foreign node.
fn judged(frames: &[Stamped], text: &str, external: &str) -> Verdict {
    let plan = plan(text, &Catalogue::shipped()).recorded_external(&[external.to_owned()]);
    let timelines = decode(&frames.to_vec().into(), &plan).unwrap();
    judge(&plan, &timelines, &hit(Vec::new(), &plan))
}

/// Returns the circumstances of a play of the plan in which the faults of the bus hit these frames.
fn hit(on_bus: Vec<Hit>, plan: &Plan) -> Circumstances {
    Circumstances {
        unrecorded: Unrecorded {
            hits: Some(Hits::new(on_bus, plan)),
            ..Unrecorded::default()
        },
        ..Circumstances::default()
    }
}

#[track_caller]
fn fails(verdict: &Verdict, reason: &str) {
    let found = verdict.reason.as_deref().unwrap_or_default();
    assert_eq!(verdict.outcome, Outcome::Fail, "{found}");
    assert!(found.contains(reason), "{found}");
}

#[track_caller]
fn passes(verdict: &Verdict) {
    assert_eq!(verdict.outcome, Outcome::Pass, "{:?}", verdict.reason);
}

const CONTROLLER: &str = "controller";
const DRIVE: &str = "drive";

#[test]
fn noise_excuses_no_controller() {
    passes(&judged(&played(NOISE), NOISE, CONTROLLER));
    let killed = played(&format!("{NOISE}{}", fault("crash", "controller", 3.0)));
    let verdict = judged(&killed, NOISE, CONTROLLER);
    fails(&verdict, "controller: no SYNC in 50.0");
    let lost = verdict.losses.iter();
    let mut lost = lost.filter(|loss| loss.contains("no SYNC from the controller from here on"));
    assert!(lost.next().is_some(), "{:?}", verdict.losses);
    // A deliberate kill of the controller explains it.
    let crash = fault("crash", "controller", 3.0);
    passes(&judged(&killed, &format!("{NOISE}{crash}"), DRIVE));
    let all = [SYNC, POSITION, COMMAND];
    let every_twentieth = without(&played(NOISE), &all, |number| number % 20 == 0);
    fails(
        &judged(&every_twentieth, NOISE, CONTROLLER),
        "controller: no SYNC in 5.00 %",
    );
}

#[test]
fn a_controller_that_is_a_little_slow_excuses_no_drive() {
    let sound = played(SLOW);
    passes(&judged(&sound, SLOW, DRIVE));
    for kind in ["crash", "hang"] {
        let dead = played(&format!("{SLOW}{}", fault(kind, "drive", 3.0)));
        // The controller gives up, which is not attributed to it.
        fails(&judged(&dead, SLOW, DRIVE), "drive: no position in 50.0");
    }
    let third = without(&sound, &[POSITION], |number| number % 3 == 0);
    fails(&judged(&third, SLOW, DRIVE), "drive: no position in 33.3");
    // A fault of the controller does not excuse the drive, however slow it is.
    let slower = SLOW.replace("0.1", "0.6");
    fails(
        &judged(&third, &slower, DRIVE),
        "drive: no position in 33.3",
    );
}

#[test]
fn a_fault_of_the_bus_excuses_the_answers_to_what_it_hit() {
    let third = without(&played(""), &[POSITION], |number| number % 3 == 0);
    let fault = "[[fault.bus.lose]]\nfrom_seconds = 0.0\nreceiver = \"drive\"\n";
    fails(&judged(&third, fault, DRIVE), "drive: no position in 33.3");
    let plan = plan(fault, &Catalogue::shipped());
    let plan = plan.recorded_external(&[DRIVE.to_owned()]);
    let timelines = decode(&third.clone().into(), &plan).unwrap();
    let timeline = &timelines[0];
    // SYNCs that a receiver did not get: those of all cycles without a position, or later ones.
    let lost = |periods_later: f64, receiver: &str| {
        let rows = timeline.time_seconds.iter();
        let rows = rows.zip(timeline.measured_position());
        let unanswered = rows.filter(|(_, position)| position.is_nan());
        let hits = unanswered.map(|(time, _)| Hit {
            fault: "fault.bus.lose.0".to_owned(),
            effect: Effect::Lost,
            node: Some(receiver.to_owned()),
            identifier: Some(SYNC),
            from_seconds: time + periods_later * timeline.period_seconds,
            until_seconds: time + periods_later * timeline.period_seconds,
            frames: 1,
            amount: 0.0,
        });
        judge(&plan, &timelines, &hit(hits.collect(), &plan))
    };
    passes(&lost(0.0, DRIVE));
    fails(&lost(1.5, DRIVE), "drive: no position in 33.3");
    fails(&lost(0.0, CONTROLLER), "drive: no position in 33.3");
}

/// A controller that gives up because of a fault reports it in an EMCY; without one its silence is unexplained.
#[test]
fn a_controller_that_gives_up_for_a_fault_says_so() {
    let jump = "[[fault.sensor.offset]]\nfrom_seconds = 3.0\noffset_millimetres = 20.0\n";
    let gives_up = played(jump);
    let demanded = format!("{jump}[expect]\nemcy = [\"controller 0x7300\"]\n");
    passes(&judged(&gives_up, &demanded, CONTROLLER));
    let silent = without(&gives_up, &[CONTROLLER_EMERGENCY], |_| true);
    let silent = judged(&silent, &demanded, CONTROLLER);
    assert_eq!(silent.outcome, Outcome::Fail);
    // A controller that nobody asks to stop, and a fault that it cannot notice, are no excuse.
    for faults in [jump, SLOW] {
        fails(
            &judged(&gives_up, faults, CONTROLLER),
            "controller: took the drive out of operation at 3.0",
        );
    }
}

#[test]
fn a_drive_may_stop_when_the_controllers_heartbeat_does() {
    let lost = fault("lost_heartbeat", "controller", 2.0);
    // A drive that is silent from a time on, and no heartbeat of the controller from 2.0 s on.
    let stops = |at_seconds| {
        let frames = played(&fault("crash", "drive", at_seconds));
        without(&frames, &[CONTROLLER_HEARTBEAT], |number| number > 2000)
    };
    passes(&judged(&stops(2.1), &lost, DRIVE));
    fails(
        &judged(&stops(3.0), &lost, DRIVE),
        "drive: no position in 50.0",
    );
}

#[test]
fn a_node_that_is_silent_at_the_end_fails_the_run() {
    let killed = |at_seconds| played(&fault("crash", "controller", at_seconds));
    let verdict = judged(&killed(5.95), NOISE, CONTROLLER);
    // 50 cycles of 6000 are 0.83 %.
    fails(&verdict, "controller: no SYNC from 5.9");
    // A pause of 0.02 s is no silence.
    passes(&judged(&killed(5.985), NOISE, CONTROLLER));
}

const LIMITS: &str =
    "[expect]\nmissed_cycles_percent = { max = 0.1 }\nno_event = [\"emergency\"]\n";

#[test]
fn commands_that_do_not_come_fail_a_controller_under_test() {
    let sound = played("");
    let row = |verdict: &Verdict| {
        let mut rows = verdict.metrics.iter();
        rows.find(|row| row.name == "missed_commands_percent")
            .cloned()
    };
    let verdict = judged(&sound, LIMITS, CONTROLLER);
    passes(&verdict);
    assert_eq!(row(&verdict).unwrap().value, Some(0.0));
    assert_eq!(row(&judged(&sound, LIMITS, DRIVE)), None, "nobody asks");

    let zero = {
        let plan = plan("", &Catalogue::shipped());
        decode(&sound.clone().into(), &plan).unwrap()[0]
            .zero_seconds
            .unwrap()
    };
    let until = |seconds: f64| {
        let is_kept = |one: &&Stamped| {
            one.frame.standard_id() != Some(COMMAND) || one.time.as_secs_f64() < zero + seconds
        };
        sound.iter().filter(is_kept).copied().collect::<Vec<_>>()
    };
    let silent = until(2.0);
    let verdict = judged(&silent, LIMITS, CONTROLLER);
    fails(&verdict, "controller: no command in 66.6");
    assert_eq!(
        verdict.losses,
        ["2.000 s loss: no command from the controller from here on"]
    );
    // For canrig's own controller it is only reported.
    let canrigs = judged(&silent, LIMITS, DRIVE);
    assert!(row(&canrigs).is_some_and(|row| row.value > Some(66.0) && row.passed.is_none()));
    let limited = format!("{LIMITS}missed_commands_percent = {{ max = 70.0 }}\n");
    fails(
        &judged(&silent, &limited, DRIVE),
        "controller: no command from 2.000 s to the end",
    );
    // Noise excuses none of them.
    fails(
        &judged(&silent, &format!("{NOISE}{LIMITS}"), CONTROLLER),
        "controller: no command",
    );

    let hundredth = without(&sound, &[COMMAND], |number| number % 100 == 50);
    passes(&judged(&hundredth, LIMITS, CONTROLLER));
    let fiftieth = without(&sound, &[COMMAND], |number| number % 50 == 0);
    fails(
        &judged(&fiftieth, LIMITS, CONTROLLER),
        "controller: no command in 2.00 %",
    );
    let limited = format!("{LIMITS}missed_commands_percent = {{ max = 3.0 }}\n");
    passes(&judged(&fiftieth, &limited, CONTROLLER));
}

/// The law of both axes needs both positions.
#[test]
fn no_command_of_several_loops_is_due_where_a_position_is_missing() {
    let path = support::scenario("two_axes_circle.toml");
    let mut plan = Plan::load(&path, &Catalogue::shipped()).unwrap();
    let campaign = Campaign::on_all_cores(false);
    let frames = campaign
        .play([plan.clone()].into_iter(), |played| {
            played.frames.iter().collect::<Vec<Stamped>>()
        })
        .unwrap()
        .remove(0)
        .unwrap();
    plan = plan.recorded_external(&[CONTROLLER.to_owned()]);
    let id = |place: usize, service: &str| {
        let one = &plan.loops[place];
        let message = plan::message_of(plan.database(), one.drive(), service).unwrap();
        u16::try_from(message.raw_id).unwrap()
    };
    let percent = |frames: &[Stamped]| {
        let timelines = decode(&frames.to_vec().into(), &plan).unwrap();
        let verdict = judge(&plan, &timelines, &Circumstances::default());
        let mut rows = verdict.metrics.iter();
        let row = rows.find(|row| row.name == "x.missed_commands_percent");
        row.unwrap().value.unwrap()
    };
    let fiftieth = |number: u32| number.is_multiple_of(50);
    let uncommanded = without(&frames, &[id(0, "rpdo1")], fiftieth);
    let missed = percent(&uncommanded);
    assert!((missed - 2.0).abs() < 0.01, "{missed}");
    let unanswered = without(&uncommanded, &[id(1, "tpdo1")], fiftieth);
    assert_eq!(percent(&unanswered), 0.0);
}
