//! Checks that the drive of a loop is off after a run that broke off, by its own latest reports.

use canopen::cia402::State;
use dbc::names::{self, OUTPUT};
use plan::message_of;
use recording::drive_reports::watch;
use recording::ending::{EarlyEnd, EndedBy};
use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::events::Window;
use scenario::expect::Limit;

use crate::evidence::Evidence;
use crate::metric::Metric;
use crate::reactions::state;

/// Row of the verdict: 1 if the drive is off.
pub(crate) const DRIVE_OFF: &str = "drive_off";
const OFF: Option<Limit> = Some(Limit {
    min: Some(1.0),
    max: None,
});
/// Largest current of a drive that is off, in steps of its object: 0x6078 has thousandths of the rated current.
const CURRENT_STEPS_MAX: f64 = 20.0;

/// Returns the row of a run that broke off; `None` if no current could flow yet, or the user ended the run.
pub(crate) fn drive_off(evidence: &Evidence<'_>, end: &EarlyEnd) -> Option<Metric> {
    let timeline = evidence.timeline;
    if end.by == EndedBy::User || timeline.zero_seconds.is_none() {
        return None;
    }
    let always = Window::new(0.0, f64::INFINITY);
    let latest = |values| evidence.values(values, always).last();
    let words = timeline
        .column(names::STATUSWORD)
        .map(|column| &column.values);
    let reports = &timeline.drive_reports;
    let (state_at, word) = later(words.and_then(latest), reports.statuswords.last())?;
    let sampled = timeline.current().and_then(latest);
    let current = later(sampled, reports.currents_amperes.last());
    let (current_at, flowing) = current.unwrap_or((state_at, 0.0));
    let is_enabled = state(word) == Some(State::OperationEnabled);
    let control_loop = evidence.control_loop;
    let quantities = &control_loop.trial.wiring.quantities;
    let feedback = message_of(evidence.database, control_loop.drive(), names::TPDO1).ok()?;
    let step = feedback
        .signal(&quantities.name(OUTPUT))
        .map_or(0.0, |signal| signal.coding.factor);
    let flows = flowing.abs() > CURRENT_STEPS_MAX * step.abs();
    let on_at = match (is_enabled, flows) {
        (false, false) => return Some(Metric::new(DRIVE_OFF, Ok(1.0), OFF).at(Some(state_at))),
        (true, false) => state_at,
        (false, true) => current_at,
        (true, true) => state_at.max(current_at),
    };

    let drive = &control_loop.drive().name;
    let watch = watch(evidence.control_loop).as_secs_f64();
    let last_cycle = timeline.time_seconds.last();
    let end_seconds = end.at_seconds.or(last_cycle).unwrap_or_default();
    let is_due = |at: f64| at + TIME_TOLERANCE_SECONDS >= end_seconds + watch;
    if is_due(on_at) {
        let late = on_at - end_seconds;
        let enabled = if is_enabled {
            "operation enabled"
        } else {
            "not enabled"
        };
        let remark = format!(
            "{drive}: on {late:.3} s after the run, though its watches take {watch:.3} s ({enabled}, {flowing:.3} {})",
            quantities.output.unit.symbol()
        );
        return Some(Metric::new(DRIVE_OFF, Err(remark), OFF).at(Some(on_at)));
    }
    let remark = if is_due(timeline.last_frame_seconds) {
        format!("{drive}: no report after the run")
    } else {
        format!("{drive}: no report before its watches have passed ({watch:.3} s)")
    };
    Some(Metric::not_judged(DRIVE_OFF, remark, OFF))
}

fn later(sampled: Option<(f64, f64)>, reported: Option<&(f64, f64)>) -> Option<(f64, f64)> {
    let both = sampled.into_iter().chain(reported.copied());
    both.max_by(|(one, _), (other, _)| one.total_cmp(other))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use can::CanFrame;
    use dbc::Database;
    use recording::log::Stamped;
    use recording::timeline::decode;

    use super::*;
    use crate::verdict::Outcome;
    use crate::{Circumstances, judge};

    /// Returns the end of a run in which the drive was on until the controller died at 0.2 s: the drive's heartbeat until a time,
    /// and then its answers.
    fn frames(until_milliseconds: u64, answers: Option<(u16, i16)>) -> Vec<Stamped> {
        let database = Database::shipped();
        let mut on = database.builder("drive_tpdo1").unwrap();
        for (name, value) in [("statusword_state", 39.0), ("current_amperes", 0.46)] {
            let signal = database.signal(&format!("drive_tpdo1.{name}")).unwrap();
            on.set(&signal, value);
        }
        let at = |milliseconds, frame| Stamped::new(Duration::from_millis(milliseconds), frame);
        let mut frames = vec![at(0, on.frame())];
        for cycle in 1..=200 {
            frames.push(at(cycle, CanFrame::new(0x080, &[1])));
            frames.push(at(cycle, on.frame()));
        }
        let beats = (210..until_milliseconds).step_by(20);
        frames.extend(beats.map(|time| at(time, CanFrame::new(0x710, &[0x7F]))));
        if let Some((statusword, milliamperes)) = answers {
            for (object, value) in [(0x41, statusword), (0x78, milliamperes.cast_unsigned())] {
                let [low, high] = value.to_le_bytes();
                let answer = [0x4B, object, 0x60, 0, low, high, 0, 0];
                frames.push(at(until_milliseconds, CanFrame::new(0x590, &answer)));
            }
        }
        frames
    }

    /// Returns the row and the outcome of a run that ended with these frames.
    fn judged(by: EndedBy, frames: &[Stamped]) -> (Option<bool>, String, Outcome, Option<String>) {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"off\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let plan = testing::plan(text);
        let end = EarlyEnd {
            at_seconds: (by == EndedBy::Node).then_some(0.2),
            node: (by == EndedBy::Node).then(|| "controller".to_owned()),
            ..EarlyEnd::without_node(by, "ended")
        };
        let circumstances = Circumstances {
            ended_early: Some(end),
            ..Circumstances::default()
        };
        let verdict = judge(
            &plan,
            &decode(&frames.to_vec().into(), &plan).unwrap(),
            &circumstances,
        );
        let mut rows = verdict.metrics.into_iter();
        let row = rows.find(|row| row.name == DRIVE_OFF).unwrap();
        let cause = verdict.cause.map(|cause| cause.node);
        (
            row.passed,
            row.remark.unwrap_or_default(),
            verdict.outcome,
            cause,
        )
    }

    #[test]
    fn a_drive_is_off_by_its_report_after_its_watches() {
        let reported = |frames: Vec<Stamped>| {
            let (passed, remark, outcome, cause) = judged(EndedBy::Node, &frames);
            assert_eq!(
                (outcome, cause.as_deref()),
                (Outcome::Fail, Some("controller"))
            );
            (passed, remark)
        };
        let on = |text: &str| {
            let late = "drive: on 0.199 s after the run, though its watches take 0.100 s";
            (Some(false), format!("{late} ({text})"))
        };
        let off = (Some(true), String::new());
        assert_eq!(reported(frames(400, Some((0x0018, 0)))), off);
        assert_eq!(reported(frames(400, Some((0x0018, -20)))), off);
        let enabled = on("operation enabled, 0.000 A");
        assert_eq!(reported(frames(400, Some((0x0237, 0)))), enabled);
        let heated = on("not enabled, -0.460 A");
        assert_eq!(reported(frames(400, Some((0x0018, -460)))), heated);
        let unseen = |text: &str| (None, format!("drive: {text}"));
        let silent = unseen("no report after the run");
        assert_eq!(reported(frames(400, None)), silent);
        let short = unseen("no report before its watches have passed (0.100 s)");
        assert_eq!(reported(frames(230, None)), short);
        // The watches pass 0.1 s after the end at 0.201 s of the recording.
        assert_eq!(reported(frames(300, Some((0x0237, 0)))), short);
        let (passed, _) = reported(frames(301, Some((0x0237, 0))));
        assert_eq!(passed, Some(false));
    }

    #[test]
    fn a_drive_that_is_on_fails_a_run_that_the_bench_ended() {
        let off = judged(EndedBy::Bench, &frames(400, Some((0x0018, 0))));
        assert_eq!(
            (off.0, off.2, off.3),
            (Some(true), Outcome::Incomplete, None)
        );
        let on = judged(EndedBy::Bench, &frames(400, Some((0x0237, 460))));
        let expected = (Some(false), Outcome::Fail, Some("drive".to_owned()));
        assert_eq!((on.0, on.2, on.3), expected);
    }
}
