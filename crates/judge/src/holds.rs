//! Quietness of the loop at the end, with a constant set-point: the ripple of its current, and hunting.

use dbc::names::TARGET;
use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::events::Window;

use crate::disturbances::recovery;
use crate::evidence::{Absence, Evidence, Known, Measurement, checked, mean};

/// Time from the position's arrival in its band to the begin of the hold.
const AFTER_SETTLING_SECONDS: f64 = 1.0;
/// Shortest hold that has a ripple.
const HOLD_SECONDS_MIN: f64 = 2.0;
/// Time before the end over which hunting is measured.
const HUNTING_SECONDS: f64 = 1.0;
/// Length of the stretches whose mean positions show hunting; a mean leaves out the noise of the sensor.
const MEAN_SECONDS: f64 = 0.01;

/// Returns the standard deviation of the commanded current in the last hold.
pub(crate) fn current_ripple(evidence: &Evidence<'_>) -> Measurement {
    let expect = &evidence.trial.expect;
    if expect.of("{command}_ripple_{command_unit}_rms").is_none() {
        return Err(Absence::not_asked());
    }
    let calm = calm(evidence);
    let hold = Window {
        from_seconds: calm.from_seconds + recovery(evidence, calm)? + AFTER_SETTLING_SECONDS,
        ..calm
    };
    let seconds = (hold.until_seconds - hold.from_seconds).max(0.0);
    if seconds < HOLD_SECONDS_MIN - TIME_TOLERANCE_SECONDS {
        return Err(
            format!("the hold lasts {seconds:.3} s; {HOLD_SECONDS_MIN} s are needed").into(),
        );
    }
    evidence.seen(hold).map(drop)?;
    if let Some(silence) = silence_of_commands(evidence, hold) {
        return Err(Absence::unseen(format!("no command {silence}"), silence));
    }
    let currents = || currents_in(evidence, hold);
    if currents().next().is_none() {
        let command = evidence.command_name();
        return Err(format!("no commanded {command} in the hold").into());
    }
    let middle = mean(currents())?;
    let variance = mean(currents().map(|current| (current - middle).powi(2)))?;
    Ok(variance.sqrt().into())
}

/// Returns the distance between the highest and the lowest short mean of the position in the last second.
pub(crate) fn hunting(evidence: &Evidence<'_>) -> Measurement {
    if evidence.trial.expect.of("hunting_{unit}").is_none() {
        return Err(Absence::not_asked());
    }
    let calm = calm(evidence);
    let last = Window {
        from_seconds: calm.until_seconds - HUNTING_SECONDS,
        ..calm
    };
    if last.from_seconds < calm.from_seconds - TIME_TOLERANCE_SECONDS {
        let seconds = calm.until_seconds - calm.from_seconds;
        let reason =
            format!("the set-point stands for {seconds:.3} s; {HUNTING_SECONDS} s are needed");
        return Err(reason.into());
    }
    let samples = evidence
        .seen(last)?
        .map(|sample| (sample.time_seconds, sample.position));
    let swing = swing(&Vec::from_iter(samples), last.from_seconds);
    checked(swing.unwrap_or(f64::NAN)).map(Known::from)
}

/// Returns the distance between the highest and the lowest short mean of positions, each with its time in seconds, from a time on;
/// `None` without a position.
pub fn swing(positions: &[(f64, f64)], from_seconds: f64) -> Option<f64> {
    let part = |(time, _): &(f64, f64)| {
        libm::floor((time - from_seconds + TIME_TOLERANCE_SECONDS) / MEAN_SECONDS)
    };
    let parts = positions.chunk_by(|left, right| part(left) == part(right));
    let means = parts.filter_map(|part| mean(part.iter().map(|(_, position)| *position)).ok());
    let ends = means.map(|mean| [mean, mean]);
    let [lowest, highest] =
        ends.reduce(|[lowest, highest], [mean, _]| [lowest.min(mean), highest.max(mean)])?;
    Some(highest - lowest)
}

/// Returns the window at the end in which the loop only has to hold its position: after the last change of the set-point, and
/// after the last start or end of a disturbance or a fault.
fn calm(evidence: &Evidence<'_>) -> Window {
    let until_seconds = evidence.trial.judged_end_seconds();
    let edges = evidence.trial.edges_seconds().into_iter();
    let judged = edges.filter(|time| *time < until_seconds);
    let changed = evidence.set_point_changes().last().unwrap_or_default();
    Window::new(judged.fold(changed, f64::max), until_seconds)
}

/// Returns the first cycles in a row without a command that are too many, in a window.
fn silence_of_commands(evidence: &Evidence<'_>, window: Window) -> Option<Window> {
    let uncommanded = evidence.timeline.uncommanded.iter();
    let mut begun: Option<(u64, u64)> = None;
    let mut silences = uncommanded.filter_map(|cycle| {
        let (first, _) = begun
            .filter(|(_, last)| last + 1 == cycle)
            .unwrap_or((cycle, cycle));
        begun = Some((first, cycle));
        let silence = Window::new(
            evidence
                .timeline
                .cycle_start_seconds(first)
                .max(window.from_seconds),
            evidence
                .timeline
                .cycle_start_seconds(cycle + 1)
                .min(window.until_seconds),
        );
        evidence
            .is_silence(silence.from_seconds, silence.until_seconds)
            .then_some(silence)
    });
    silences.next()
}

/// Returns the commanded currents in the cycles of a window.
fn currents_in(evidence: &Evidence<'_>, window: Window) -> impl Iterator<Item = f64> {
    let column = evidence.timeline.column(TARGET).into_iter();
    let values = column.flat_map(move |column| evidence.values(&column.values, window));
    values.map(|(_, current)| current)
}
