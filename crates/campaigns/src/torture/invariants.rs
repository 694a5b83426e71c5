//! Invariants that hold under any faults, checked with the recording alone.

use std::time::Duration;

use can::CanFrame;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::{NmtCommand, NodeId};
use dbc::scenario_clock::SYNC_COB_ID;
use scenario::Trial;

use crate::campaign::CampaignRun;
use judge::verdict::Outcome;
use plan::ControlLoop;
use recording::frames::Frames;
use recording::timeline::Timeline;
use recording::truth::PlantTruth;

/// 1 A, the amplifier's most, settles the paper's wire at 138.44 °C; the message counts hundredths.
const TEMPERATURE_CELSIUS_MAX: f64 = 138.5;
/// The drive waits 50 ms for a SYNC; a period, a frame and the clock's error are added.
const SYNC_SECONDS_MAX: f64 = 0.055;
/// The drive waits 100 ms for the manager's heartbeat.
const HEARTBEAT_SECONDS_MAX: f64 = 0.105;
/// The plant publishes the truth every 10 ms.
const TRUTH_SECONDS_MAX: f64 = 0.025;

/// Longest time from the plant's message to the recording, including the rounding of times.
const MESSAGE_SECONDS_MAX: f64 = 1e-3;

/// Duties that canrig's nodes do under any fault: a breach of one is never the node's own.
const BREACHES: [&str; 6] = ["sync", "position", "command", "heartbeat", "nmt", "lead"];

/// Invariant that a run broke.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BrokenInvariant {
    /// Name of the invariant.
    pub(super) invariant: &'static str,
    /// Description of the observation that breaks it.
    pub(super) text: String,
}

fn violated(invariant: &'static str, text: String) -> Option<BrokenInvariant> {
    Some(BrokenInvariant { invariant, text })
}

/// Returns the first invariant that a run broke.
pub(super) fn violation(played: &CampaignRun<'_>) -> Option<BrokenInvariant> {
    let loops = played.plan.loops.iter().zip(played.timelines);
    let mut broken = loops.filter_map(|(one, timeline)| {
        let BrokenInvariant { invariant, text } = violation_of_loop(one, timeline, played.frames)?;
        let text = match one.loop_name() {
            Some(name) => format!("{name}: {text}"),
            None => text,
        };
        violated(invariant, text)
    });
    verdict_reached(played).or_else(|| broken.next())
}

fn violation_of_loop(
    one: &ControlLoop,
    timeline: &Timeline,
    frames: &Frames,
) -> Option<BrokenInvariant> {
    let trial = &one.trial;
    truth_is_complete(timeline)
        .or_else(|| not_too_hot(trial, timeline))
        .or_else(|| no_current_before_the_start(timeline))
        .or_else(|| {
            let what = ("sync", "SYNC", SYNC_SECONDS_MAX);
            let is_sync = |frame: &CanFrame| frame.standard_id() == Some(SYNC_COB_ID);
            no_current_without(what, is_sync, frames, trial, timeline)
        })
        .or_else(|| {
            let what = ("manager", "heartbeat of the manager", HEARTBEAT_SECONDS_MAX);
            let (manager, drive) = (one.controller().id(), one.drive().id());
            let is_it = |frame: &CanFrame| is_of_manager(frame, manager, drive);
            no_current_without(what, is_it, frames, trial, timeline)
        })
}

fn verdict_reached(played: &CampaignRun<'_>) -> Option<BrokenInvariant> {
    let verdict = played.verdict;
    if let Some(end) = &verdict.ended_early {
        return violated("verdict", end.to_string());
    }
    let breach = verdict.cause.as_ref();
    let breach = breach.filter(|cause| BREACHES.contains(&cause.duty.as_str()));
    let guilty = breach.filter(|cause| {
        let mut nodes = played.plan.rig_nodes();
        nodes.any(|(_, node)| node.name == cause.node)
    });
    if let Some(guilty) = guilty {
        return violated("blame", guilty.description.clone());
    }
    if matches!(verdict.outcome, Outcome::Pass | Outcome::Fail) {
        return None;
    }
    let reason = verdict.reason.clone().unwrap_or_default();
    violated("verdict", format!("{}: {reason}", verdict.outcome.word()))
}

/// Checks that the recording is complete: the plant publishes from its first message to its last. A fault may keep it from the
/// bus from then on.
fn truth_is_complete(timeline: &Timeline) -> Option<BrokenInvariant> {
    let mut times = timeline
        .truth
        .pairs()
        .map(|(one, next)| (one.time_seconds, next.time_seconds));
    let (from, until) = times.find(|(from, until)| until - from > TRUTH_SECONDS_MAX)?;
    violated(
        "truth",
        format!("the plant is silent from {from:.4} s to {until:.4} s"),
    )
}

/// Checks the temperature of an SMA actuator; the bound of another plant is unknown.
fn not_too_hot(trial: &Trial, timeline: &Timeline) -> Option<BrokenInvariant> {
    trial.plant().actuator()?;
    let is_hot = |truth: &PlantTruth| truth.peak_temperature_celsius > TEMPERATURE_CELSIUS_MAX;
    let hot = timeline.truth.iter().find(is_hot)?;
    let (celsius, time) = (hot.peak_temperature_celsius, hot.time_seconds);
    violated(
        "temperature",
        format!("the wire has {celsius:.1} °C at {time:.4} s (limit {TEMPERATURE_CELSIUS_MAX} °C)"),
    )
}

/// Checks that no current flows before scenario time 0, when none is commanded; a run that a fault of the boot prevents never
/// reaches that time.
fn no_current_before_the_start(timeline: &Timeline) -> Option<BrokenInvariant> {
    let is_before =
        |truth: &PlantTruth| timeline.zero_seconds.is_none() || truth.time_seconds < 0.0;
    let heated = |truth: &PlantTruth| truth.output != 0.0;
    let truth = timeline.truth.iter().filter(is_before).find(heated)?;
    let (amperes, time) = (truth.output, truth.time_seconds);
    violated(
        "start",
        format!("{amperes:.3} A flow at {time:.4} s, before the start"),
    )
}

/// Checks that no current flows after a message has been missing for longer than the drive waits for it; unless the drive is dead
/// or hangs, or the amplifier does not obey.
fn no_current_without(
    (invariant, what, seconds_max): (&'static str, &str, f64),
    is_it: impl Fn(&CanFrame) -> bool,
    frames: &Frames,
    trial: &Trial,
    timeline: &Timeline,
) -> Option<BrokenInvariant> {
    let zero = Duration::from_secs_f64(timeline.zero_seconds?);
    let found = frames.iter().filter(|stamped| is_it(&stamped.frame));
    let since_zero = found.map(|stamped| stamped.time.as_secs_f64() - zero.as_secs_f64());
    let mut times = since_zero.peekable();
    let mut last: f64 = 0.0;
    for truth in timeline
        .truth
        .iter()
        .filter(|truth| truth.time_seconds > 0.0)
    {
        let time = truth.time_seconds;
        while let Some(next) = times.next_if(|next| *next <= time) {
            last = f64::max(last, next);
        }
        let is_over = time > trial.run.duration_seconds;
        let silent = time - last;
        let heats = truth.output != 0.0;
        if heats && !is_over && silent > seconds_max && !is_excused(trial, time, seconds_max) {
            let (milliseconds, amperes) = (silent * 1e3, truth.output);
            return violated(
                invariant,
                format!(
                    "{amperes:.3} A flow at {time:.4} s, {milliseconds:.1} ms after the last {what} (limit {:.0} ms)",
                    seconds_max * 1e3
                ),
            );
        }
    }
    None
}

/// Returns whether a frame is the manager's heartbeat, or its order to start, after which the drive waits for the heartbeat.
fn is_of_manager(frame: &CanFrame, manager: u8, drive: u8) -> bool {
    let heartbeat = ERROR_CONTROL_ID + u16::from(manager);
    let start = NmtCommand::Start.frame(NodeId::new(drive));
    frame.standard_id() == Some(heartbeat) || *frame == start
}

/// Returns whether a drive cannot act: dead with its current held, hanging or just awake, or with its amplifier stuck on.
fn is_excused(trial: &Trial, time_seconds: f64, seconds_max: f64) -> bool {
    trial.drive_faults().iter().any(|fault| {
        // The message takes time on the bus.
        let over = match fault.kind.name {
            "crash" if fault.says("output", "hold") => MESSAGE_SECONDS_MAX,
            "hang" => seconds_max,
            "stuck_on" => MESSAGE_SECONDS_MAX,
            _ => return false,
        };
        let until = fault.until_seconds.unwrap_or(f64::INFINITY) + over;
        fault
            .from_seconds
            .is_some_and(|from| (from..until).contains(&time_seconds))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::play_one;
    use recording::capture::Watch;
    use recording::log::Stamped;
    use worlds::catalogue::catalogue;

    const BASE: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 0.6\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";

    /// Harmless fault: without any fault the plant publishes no truth.
    const HARMLESS: &str =
        "[[fault.sensor.noise]]\nfrom_seconds = 0.0\nnoise_millimetres_rms = 0.001\n";

    /// Returns the invariant that a run with a changed recording breaks.
    fn broken(change: impl Fn(&mut Vec<Stamped>, &mut Timeline)) -> Option<String> {
        let text = format!("{BASE}{HARMLESS}");
        let plan = testing::plan_beside(&text, &[], catalogue());
        let found = play_one(0, &plan, &Watch::default(), |played| {
            let (mut frames, mut timeline) = (
                Vec::from_iter(played.frames.iter()),
                played.only_timeline().unwrap().clone(),
            );
            assert!(timeline.truth.len() > 50);
            change(&mut frames, &mut timeline);
            violation(&CampaignRun {
                frames: &frames.into(),
                timelines: &[timeline],
                ..*played
            })
        });
        let found = found.unwrap();
        found.map(|broken| format!("{}: {}", broken.invariant, broken.text))
    }

    /// Returns a change that removes frames in the second half of the scenario.
    fn without(is_it: impl Fn(&CanFrame) -> bool) -> impl Fn(&mut Vec<Stamped>, &mut Timeline) {
        move |frames, timeline| {
            let from = Duration::from_secs_f64(timeline.zero_seconds.unwrap() + 0.3);
            frames.retain(|stamped| stamped.time < from || !is_it(&stamped.frame));
        }
    }

    /// Returns a change of the truth at a scenario time.
    fn truth_at(
        seconds: f64,
        change: impl Fn(&mut PlantTruth),
    ) -> impl Fn(&mut Vec<Stamped>, &mut Timeline) {
        move |_, timeline| {
            let mut truth = timeline.truth.to_vec();
            let mut later = truth
                .iter_mut()
                .filter(|truth| truth.time_seconds >= seconds);
            change(later.next().unwrap());
            timeline.truth = truth.into();
        }
    }

    fn is_sync(frame: &CanFrame) -> bool {
        frame.standard_id() == Some(SYNC_COB_ID)
    }

    #[test]
    fn each_invariant_can_be_broken() {
        assert_eq!(broken(|_, _| ()), None);
        let found =
            |change: &dyn Fn(&mut Vec<Stamped>, &mut Timeline)| broken(change).unwrap_or_default();
        let sync = found(&without(is_sync));
        assert!(sync.starts_with("sync: "), "{sync}");
        assert!(
            sync.ends_with(" ms after the last SYNC (limit 55 ms)"),
            "{sync}"
        );
        let manager = found(&without(|frame| is_of_manager(frame, 1, 0x10)));
        assert!(manager.starts_with("manager: "), "{manager}");
        assert!(
            manager.ends_with("heartbeat of the manager (limit 105 ms)"),
            "{manager}"
        );
        let hot = found(&truth_at(0.2, |truth| {
            truth.peak_temperature_celsius = 138.6
        }));
        assert!(
            hot.starts_with("temperature: the wire has 138.6 °C at 0.2"),
            "{hot}"
        );
        let early = found(&truth_at(f64::NEG_INFINITY, |truth| {
            (truth.time_seconds, truth.output) = (-0.001, 0.1);
        }));
        assert_eq!(early, "start: 0.100 A flow at -0.0010 s, before the start");
        let never_begun = found(&|_, timeline| timeline.zero_seconds = None);
        assert!(never_begun.starts_with("start: "), "{never_begun}");
        let silent = found(&|_, timeline| {
            let is_left = |truth: &PlantTruth| !(0.2..0.23).contains(&truth.time_seconds);
            let left = timeline.truth.iter().filter(is_left);
            timeline.truth = left.collect();
        });
        assert!(
            silent.starts_with("truth: the plant is silent from 0.1"),
            "{silent}"
        );
    }

    /// A current that the fault itself keeps up breaks no invariant until the drive has had time to act again.
    #[test]
    fn a_drive_that_cannot_act_is_excused() {
        let window = "from_seconds = 0.3\nuntil_seconds = 0.4\n";
        let is_excused_at = |fault: &str, seconds: [f64; 3]| {
            let text = format!("{BASE}[[fault.{fault}\n{window}");
            let trial = testing::part(&text, "drive");
            seconds.map(|seconds| is_excused(&trial, seconds, 0.05))
        };
        for (fault, over) in [
            ("node.crash]]\nnode = \"drive\"\noutput = \"hold\"", 0.402),
            ("node.hang]]\nnode = \"drive\"", 0.451),
            ("amplifier.stuck_on]]\ncurrent_amperes = 0.2", 0.402),
        ] {
            let found = is_excused_at(fault, [0.299, over - 0.0015, over]);
            assert_eq!(found, [false, true, false], "{fault}");
        }
        for fault in [
            "node.crash]]\nnode = \"drive\"",
            "node.crash]]\nnode = \"controller\"\noutput = \"hold\"",
            "node.hang]]\nnode = \"controller\"",
        ] {
            assert_eq!(
                is_excused_at(fault, [0.3, 0.35, 0.4]),
                [false; 3],
                "{fault}"
            );
        }
    }
}
