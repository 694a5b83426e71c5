//! Events held against `[[expect.sequence]]`: each after the one before, soon enough.

use recording::traces::SignalSample;
use scenario::events::Window;
use scenario::expect::{Emergency, Expected, Limit, Sequence};

use crate::evidence::{Absence, Evidence, Observation, TIME_TOLERANCE_SECONDS, samples_in};
use crate::metric::{Metric, rounded};
use crate::signals::nearest;

/// A row for each event of each sequence.
pub(crate) fn metrics(evidence: &Evidence<'_>) -> Vec<Metric> {
    let sequences = evidence.scenario.expect.sequence.iter();
    sequences
        .flat_map(|sequence| of_sequence(evidence, sequence))
        .collect()
}

fn of_sequence(evidence: &Evidence<'_>, sequence: &Sequence) -> Vec<Metric> {
    let window = sequence.window(evidence.scenario.duration_seconds);
    let mut before: Result<f64, String> = Ok(window.from_seconds);
    let mut metrics = Vec::new();
    for (place, event) in sequence.event.iter().enumerate() {
        let observation = match &before {
            Ok(since) => {
                let rest = Window {
                    from_seconds: *since,
                    ..window
                };
                // What came twice in one event's words must come twice on the bus.
                let again = place.checked_sub(1).map(|last| &sequence.event[last]) == Some(event);
                next(evidence, event, rest, again)
            }
            Err(missing) => {
                let reason = format!("{missing} did not come before");
                Observation::none(Absence::unseen(reason, window))
            }
        };
        let longest = event
            .within_milliseconds
            .unwrap_or_else(|| rounded(1e3 * (window.until_seconds - window.from_seconds)));
        let limit = Limit {
            min: None,
            max: Some(longest),
        };
        before = match (observation.at_seconds, before) {
            (Some(at), Ok(_)) => Ok(at),
            (None, Ok(_)) => Err(event.to_string()),
            (_, missing) => missing,
        };
        metrics.push(observation.metric(evidence, sequence.row_name(place), Some(limit)));
    }
    metrics
}

/// The next coming of an event in a stretch of time, in milliseconds from its start.
fn next(evidence: &Evidence<'_>, event: &Expected, rest: Window, again: bool) -> Observation {
    if evidence.timeline.zero_seconds.is_none() {
        return Observation::none("the scenario never began");
    }
    let earliest = match again {
        true => rest.from_seconds + TIME_TOLERANCE_SECONDS,
        false => rest.from_seconds - TIME_TOLERANCE_SECONDS,
    };
    let is_next = |time: f64| time >= earliest && time < rest.until_seconds;
    let mut samples: &[SignalSample] = &[];
    let found = match event {
        Expected {
            emcy: Some(text), ..
        } => Ok(emergency(evidence, text, is_next)),
        Expected {
            text: Some(text), ..
        } => Ok(event_with(evidence, text, is_next)),
        Expected {
            signal: Some(name), ..
        } => evidence.trace(name).map(|trace| {
            samples = samples_in(&trace.samples, rest);
            stay(samples, trace.silence_seconds_max, event, rest, is_next)
        }),
        _ => Err(Observation::none("nothing is expected")),
    };
    match found {
        Ok(Some(at_seconds)) => {
            let since = (at_seconds - rest.from_seconds).max(0.0);
            Observation::at(Ok(1e3 * since), at_seconds)
        }
        Ok(None) => {
            let nearest = nearest_words(samples, event);
            let reason = format!("did not come after {:.3} s{nearest}", rest.from_seconds);
            Observation::none(Absence::unseen(reason, rest))
        }
        Err(observation) => observation,
    }
}

fn emergency(evidence: &Evidence<'_>, text: &str, is_next: impl Fn(f64) -> bool) -> Option<f64> {
    let wanted: Emergency = text.parse().ok()?;
    let emergencies = evidence.timeline.emergencies.iter();
    let mut times = emergencies
        .filter(|one| one.emergency == wanted)
        .map(|one| one.time_seconds);
    times.find(|time| is_next(*time))
}

fn event_with(evidence: &Evidence<'_>, part: &str, is_next: impl Fn(f64) -> bool) -> Option<f64> {
    let events = evidence.timeline.events.iter();
    let mut times = events
        .filter(|event| event.text.contains(part))
        .map(|event| event.time_seconds);
    times.find(|time| is_next(*time))
}

/// When a signal gets within the limits and stays there for long enough. A stay does not last through a silence.
fn stay(
    samples: &[SignalSample],
    silence_seconds_max: Option<f64>,
    event: &Expected,
    rest: Window,
    is_next: impl Fn(f64) -> bool,
) -> Option<f64> {
    let (wanted, long) = (event.reaches?, event.for_milliseconds.unwrap_or(0.0) / 1e3);
    let is_silence = |seconds: f64| {
        silence_seconds_max.is_some_and(|longest| seconds > longest + TIME_TOLERANCE_SECONDS)
    };
    let (mut since, mut latest) = (None, rest.from_seconds);
    for sample in samples {
        let time = sample.time_seconds;
        let was_silent = is_silence(time - std::mem::replace(&mut latest, time));
        if was_silent || !wanted.admits(sample.value) {
            since = None;
        }
        if !wanted.admits(sample.value) {
            continue;
        }
        let begin = *since.get_or_insert(time);
        if time - begin >= long && is_next(begin) {
            return Some(begin);
        }
    }
    None
}

/// How near a signal came to its limits, and when; where it was within them, for how long.
fn nearest_words(samples: &[SignalSample], event: &Expected) -> String {
    let Some(wanted) = event.reaches else {
        return String::new();
    };
    let mut longest: Option<(f64, f64)> = None;
    for stay in samples.chunk_by(|one, next| wanted.admits(one.value) == wanted.admits(next.value))
    {
        let (from, until) = (stay[0].time_seconds, stay[stay.len() - 1].time_seconds);
        let is_longer = longest.is_none_or(|(_, long)| until - from > long);
        if wanted.admits(stay[0].value) && is_longer {
            longest = Some((from, until - from));
        }
    }
    match (longest, nearest(samples, wanted)) {
        (Some((from, long)), _) => {
            format!(
                "; was so for at most {:.3} ms, from {from:.3} s",
                1e3 * long
            )
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
    use std::time::Duration;

    use canopen::CanFrame;
    use dbc::Database;
    use recording::log::Stamped;
    use recording::timeline::decode;
    use rig::catalogue::Catalogue;
    use rig::setup::Setup;
    use scenario::Scenario;

    use super::*;

    /// A run of 1 s from 0.1 s of the log on: cycles until the drive sends 0x8130 at 0.5 s, then current 0, but for one cycle.
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

    /// Each row as value or remark, then its result.
    #[track_caller]
    fn check(sequence: &str, expected: &[(Result<f64, &str>, bool)]) {
        check_frames(&frames(), sequence, expected);
    }

    #[track_caller]
    fn check_frames(frames: &[Stamped], sequence: &str, expected: &[(Result<f64, &str>, bool)]) {
        let text = format!(
            "schema = 1\nname = \"s\"\nduration_seconds = 1.0\n[controller.open_loop]\n\
             [[expect.sequence]]\nname = \"s\"\n{sequence}\n"
        );
        let scenario = Scenario::parse(&text, "s.toml", |_| unreachable!("no table")).unwrap();
        let setup = Setup::of(scenario, &Catalogue::shipped());
        let timeline = decode(frames, &setup).unwrap();
        let circumstances = crate::Circumstances::default();
        let rows = metrics(&Evidence::new(&timeline, &setup, &circumstances));
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

    /// The current is 0 from 0.521 s on; for 0.2 s of that nothing is heard.
    #[test]
    fn a_stay_does_not_last_through_a_silence() {
        let stay = "event = [{ signal = \"current_amperes\", reaches = { max = 0 }, for_milliseconds = 150 }]";
        let is_silent = |stamped: &Stamped| {
            (Duration::from_millis(700)..Duration::from_millis(900)).contains(&stamped.time)
        };
        let heard: Vec<Stamped> = frames().into_iter().filter(|one| !is_silent(one)).collect();
        check_frames(&frames(), stay, &[(Ok(521.0), true)]);
        let did_not_come = Err("did not come after 0.000 s");
        let longer = stay.replace("150", "250");
        check_frames(&frames(), &longer, &[(Ok(521.0), true)]);
        check_frames(&heard, &longer, &[(did_not_come, false)]);
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
        // One emergency is not two.
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
