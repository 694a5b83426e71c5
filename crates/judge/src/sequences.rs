//! Checks of the events in `[[expect.sequence]]`: each after the one before, and soon enough.

use std::iter;

use recording::events::Event;
use recording::timeline::{Series, TIME_TOLERANCE_SECONDS};
use recording::traces::{SignalSample, SignalTrace};
use scenario::events::Window;
use scenario::expect::{Expected, Sequence, rounded};

use crate::evidence::{Absence, Evidence, Known, Measurement, samples_in};
use crate::metric::Metric;
use crate::signals::nearest;

/// Returns a row for each event of each sequence.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let sequences = evidence.trial.expect.sequence.iter();
    sequences
        .flat_map(|sequence| event_rows(evidence, sequence))
        .collect()
}

fn event_rows(evidence: &Evidence<'_>, sequence: &Sequence) -> Vec<Metric> {
    let duration_seconds = evidence.trial.run.duration_seconds;
    let window = sequence.window(duration_seconds);
    let mut before: Result<f64, String> = Ok(window.from_seconds);
    let mut metrics = Vec::new();
    let rows = sequence.event.iter().zip(sequence.rows(duration_seconds));
    for (place, (event, expected)) in rows.enumerate() {
        let measurement = match &before {
            Ok(since) => {
                let rest = Window {
                    from_seconds: *since,
                    ..window
                };
                // Two equal events in a row must come twice on the bus.
                let again = place.checked_sub(1).map(|last| &sequence.event[last]) == Some(event);
                next(evidence, event, rest, again)
            }
            Err(missing) => {
                let reason = format!("{missing} did not come before");
                Err(Absence::unseen(reason, window))
            }
        };
        let since = *before.as_ref().unwrap_or(&window.from_seconds);
        let came_at = measurement.as_ref().ok().and_then(|known| known.at_seconds);
        let until = came_at.unwrap_or(window.until_seconds);
        before = before.and_then(|_| came_at.ok_or_else(|| event.to_string()));
        let measurement = if evidence.leaves_out(since, until) {
            Err(Absence::left_out())
        } else {
            measurement
        };
        metrics.extend(evidence.row(expected, measurement));
    }
    metrics
}

/// Returns the next occurrence of an event in a stretch of time, in milliseconds from its start.
fn next(evidence: &Evidence<'_>, event: &Expected, rest: Window, again: bool) -> Measurement {
    if evidence.timeline.zero_seconds.is_none() {
        return Err("the scenario never began".into());
    }
    let earliest = if again {
        rest.from_seconds + TIME_TOLERANCE_SECONDS
    } else {
        rest.from_seconds - TIME_TOLERANCE_SECONDS
    };
    let is_next = |time: f64| time >= earliest && time < rest.until_seconds;
    let found = match &event.signal {
        Some(name) => reached(evidence.trace(name)?, event, rest, is_next),
        None => {
            let emergency = event.emcy.as_ref().and_then(|text| text.parse().ok());
            let is_wanted = |one: &Event| match (&emergency, &event.text) {
                (Some(_), _) => one.emergency == emergency,
                (None, Some(text)) => one.text.contains(text.as_str()),
                (None, None) => false,
            };
            let mut events = evidence.timeline.events.iter();
            let found = events.find(|one| is_wanted(one) && is_next(one.time_seconds));
            // Nothing more is known of an event that did not come.
            found.map(|one| one.time_seconds).ok_or_else(String::new)
        }
    };
    let at_seconds = found.map_err(|nearest| {
        let reason = format!("did not come after {:.3} s{nearest}", rest.from_seconds);
        Absence::unseen(reason, rest)
    })?;
    let since = (at_seconds - rest.from_seconds).max(0.0);
    Ok(Known::at(1e3 * since, at_seconds))
}

/// Returns the time at which a signal gets within its limits for long enough, or a text on how near it came.
fn reached(
    trace: &SignalTrace,
    event: &Expected,
    rest: Window,
    is_next: impl Fn(f64) -> bool,
) -> Result<f64, String> {
    let samples = samples_in(&trace.samples, rest);
    let stays = || stays(&samples, trace.silence_seconds_max, event);
    let long = event.for_milliseconds.unwrap_or(0.0) / 1e3;
    let is_reached = |stay: &Stay| stay.lasts_seconds >= long && is_next(stay.begins_seconds);
    match stays().find(is_reached) {
        Some(stay) => Ok(stay.begins_seconds),
        None => Err(nearest_text(&samples, stays(), event)),
    }
}

/// Stay of a signal within its limits from one sample to another, without a silence.
struct Stay {
    begins_seconds: f64,
    lasts_seconds: f64,
}

/// Returns all stays of a signal within the limits of an event, in order.
fn stays<'a>(
    samples: &'a Series<SignalSample>,
    silence_seconds_max: Option<f64>,
    event: &Expected,
) -> impl Iterator<Item = Stay> + use<'a> {
    let is_silence = move |seconds: f64| {
        silence_seconds_max.is_some_and(|longest| seconds > longest + TIME_TOLERANCE_SECONDS)
    };
    let wanted = event.reaches;
    let admits = move |value| wanted.is_some_and(|wanted| wanted.admits(value));
    let mut samples = samples.iter().peekable();
    iter::from_fn(move || {
        let begin = samples.find(|sample| admits(sample.value))?;
        let mut end = begin;
        while let Some(next) = samples
            .next_if(|next| admits(next.value) && !is_silence(next.time_seconds - end.time_seconds))
        {
            end = next;
        }
        Some(Stay {
            begins_seconds: begin.time_seconds,
            lasts_seconds: end.time_seconds - begin.time_seconds,
        })
    })
}

/// Describes how near a signal came to its limits, and when; if it was within them, for how long.
fn nearest_text(
    samples: &Series<SignalSample>,
    stays: impl Iterator<Item = Stay>,
    event: &Expected,
) -> String {
    let Some(wanted) = event.reaches else {
        return String::new();
    };
    // The first of equally long stays is named.
    let longest = stays.reduce(|longest, stay| {
        if stay.lasts_seconds > longest.lasts_seconds {
            stay
        } else {
            longest
        }
    });
    match (longest, nearest(samples, wanted)) {
        (Some(stay), _) => {
            let (from, long) = (stay.begins_seconds, 1e3 * stay.lasts_seconds);
            format!("; was so for at most {long:.3} ms, from {from:.3} s")
        }
        (None, Some(sample)) => {
            let value = rounded(sample.value);
            format!("; the nearest was {value} at {:.3} s", sample.time_seconds)
        }
        (None, None) => "; no sample came".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use can::CanFrame;
    use dbc::Database;
    use plan::Plan;
    use plan::catalogue::Catalogue;
    use recording::log::Stamped;
    use recording::timeline::decode;
    use scenario::Beside;

    use super::*;

    /// Returns a run of 1 s that begins at 0.1 s of the log: cycles until the drive sends 0x8130 at 0.5 s, then current 0 except
    /// in one cycle.
    fn frames() -> Vec<Stamped> {
        let database = Database::shipped();
        let feedback = |current: f64| {
            let mut message = database.builder("drive_tpdo1").unwrap();
            for (name, value) in [("statusword_state", 39.0), ("current_amperes", current)] {
                let signal = database.signal(&format!("drive_tpdo1.{name}")).unwrap();
                message.set(&signal, value);
            }
            message.frame()
        };
        let mut frames = vec![Stamped::new(Duration::ZERO, feedback(0.5))];
        for cycle in 0..1000_u64 {
            let start = Duration::from_millis(100 + cycle);
            frames.push(Stamped::new(start, CanFrame::new(0x080, &[1])));
            let emergency = CanFrame::new(0x090, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0]);
            if cycle == 500 {
                frames.push(Stamped::new(start + Duration::from_micros(50), emergency));
            }
            let current = if cycle < 510 || cycle == 520 {
                0.5
            } else {
                0.0
            };
            let time = start + Duration::from_micros(130);
            frames.push(Stamped::new(time, feedback(current)));
        }
        frames
    }

    /// Checks each row, as value or remark and result.
    #[track_caller]
    fn check(sequence: &str, expected: &[(Result<f64, &str>, bool)]) {
        check_frames(&frames(), sequence, expected);
    }

    #[track_caller]
    fn check_frames(frames: &[Stamped], sequence: &str, expected: &[(Result<f64, &str>, bool)]) {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.open_loop]\n\
             [[expect.sequence]]\nname = \"s\"\n{sequence}\n"
        );
        let beside = Beside::new(Path::new("s.toml"));
        let read = |_: &str| unreachable!("no table");
        let plan = Plan::parse_with_any_signals(&beside, text, read, &Catalogue::shipped());
        let plan = plan.unwrap();
        let timelines = decode(&frames.to_vec().into(), &plan).unwrap();
        let circumstances = crate::Circumstances::default();
        let rows = metrics(&Evidence::new(
            plan.database(),
            &timelines[0],
            plan.only_loop().unwrap(),
            &circumstances,
        ));
        let found: Vec<_> = rows
            .iter()
            .map(|row| {
                let value = row.value.ok_or(row.remark.as_deref().unwrap_or_default());
                (value, row.passed == Some(true))
            })
            .collect();
        assert_eq!(found, expected);
    }

    const EMCY: &str = "{ emcy = \"drive 0x8130\", within_milliseconds = 600 }";

    #[test]
    fn each_event_counts_from_the_one_before() {
        let zero =
            "{ signal = \"current_amperes\", reaches = { max = 0 }, within_milliseconds = 10 }";
        check(
            &format!("event = [{EMCY}, {zero}]"),
            &[(Ok(500.05), true), (Ok(9.95), true)],
        );
        let stays = zero.replace("}, within", "}, for_milliseconds = 50, within");
        check(
            &format!("from_seconds = 0.4\nevent = [{EMCY}, {stays}]"),
            &[(Ok(100.05), true), (Ok(20.95), false)],
        );
    }

    /// The current is 0 from 0.521 s on; from 0.6 to 0.8 s there are no frames.
    #[test]
    fn a_stay_does_not_last_through_a_silence() {
        let stay = "event = [{ signal = \"current_amperes\", reaches = { max = 0 }, for_milliseconds = 150 }]";
        let is_silent = |stamped: &Stamped| {
            (Duration::from_millis(700)..Duration::from_millis(900)).contains(&stamped.time)
        };
        let heard: Vec<Stamped> = frames().into_iter().filter(|one| !is_silent(one)).collect();
        check_frames(&frames(), stay, &[(Ok(521.0), true)]);
        let longer = stay.replace("150", "250");
        check_frames(&frames(), &longer, &[(Ok(521.0), true)]);
        let short = Err("did not come after 0.000 s; was so for at most 199.000 ms, from 0.800 s");
        check_frames(&heard, &longer, &[(short, false)]);
    }

    /// The last SYNC came at 0.599 s.
    #[test]
    fn a_loss_is_when_the_first_missing_frame_was_due() {
        let is_silent = |stamped: &Stamped| stamped.time >= Duration::from_millis(700);
        let heard: Vec<Stamped> = frames().into_iter().filter(|one| !is_silent(one)).collect();
        let again = Stamped::new(Duration::from_millis(900), CanFrame::new(0x080, &[1]));
        let heard = [heard, vec![again]].concat();
        let lost = "from_seconds = 0.6\nevent = [{ text = \"loss: no SYNC\" }]";
        check_frames(&heard, lost, &[(Ok(0.0), true)]);
    }

    #[test]
    fn what_does_not_come_fails_with_all_that_was_to_follow() {
        let other = "{ emcy = \"drive 0x8100\", within_milliseconds = 10 }";
        let missing = Err("did not come after 0.500 s");
        let after = Err("EMCY drive 0x8100 did not come before");
        check(
            &format!("event = [{EMCY}, {other}, {EMCY}]"),
            &[(Ok(500.05), true), (missing, false), (after, false)],
        );
        // A single emergency does not count as two.
        check(
            &format!("event = [{EMCY}, {EMCY}]"),
            &[(Ok(500.05), true), (missing, false)],
        );
        let late = Err("did not come after 0.600 s");
        check(
            &format!("from_seconds = 0.6\nevent = [{EMCY}]"),
            &[(late, false)],
        );
        let text = "{ text = \"emergency heartbeat\" }";
        check(
            &format!("until_seconds = 0.4\nevent = [{text}]"),
            &[(Err("did not come after 0.000 s"), false)],
        );
        check(&format!("event = [{text}]"), &[(Ok(500.05), true)]);
    }

    #[test]
    fn a_signal_that_does_not_get_there_says_how_near_it_came() {
        let signal = |reaches: &str| {
            format!(
                "until_seconds = 0.9\nevent = [{{ signal = \"current_amperes\", reaches = {reaches} }}]"
            )
        };
        let far = Err("did not come after 0.000 s; the nearest was 0.5 at 0.000 s");
        check(&signal("{ min = 0.7 }"), &[(far, false)]);
        let short = Err("did not come after 0.000 s; was so for at most 378.000 ms, from 0.521 s");
        let stays = signal("{ max = 0.1 }, for_milliseconds = 500");
        check(&stays, &[(short, false)]);
    }

    #[test]
    fn a_signal_that_never_was_on_the_bus_never_comes() {
        let truth = "{ signal = \"convection_factor\", reaches = { min = 0 } }";
        let silent = Err("disturbance_rpdo1.convection_factor never was on the bus");
        check(&format!("event = [{truth}]"), &[(silent, false)]);
        let unknown = "{ signal = \"convection\", reaches = { min = 0 } }";
        let missing = Err("no signal is called `convection`");
        check(&format!("event = [{unknown}]"), &[(missing, false)]);
        let truth = "{ signal = \"plant_current_amperes\", reaches = { min = 0 } }";
        let unavailable = Err("not available: only the emulated plant publishes it");
        check(&format!("event = [{truth}]"), &[(unavailable, false)]);
    }
}
