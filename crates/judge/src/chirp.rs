//! Gain, phase and offset of the position against the set-point over the frequency of each chirp.

use dbc::Database;
use plan::ControlLoop;
use recording::timeline::Timeline;
use scenario::events::{JudgedChirp, Window};

use crate::circumstances::Circumstances;
use crate::evidence::{Absence, Evidence, Known, Measurement, MetricValue};
use crate::harmonic::Harmonic;
use crate::sine::phase_between;

/// Largest number of points of one chirp.
const POINTS_MAX: f64 = 100.0;
/// Gain at which the bandwidth ends: −3 dB.
pub const CUT_OFF_GAIN: f64 = 0.708;
/// Part of the amplitude within which the mean counts as that of the set-point.
const OFFSET_OF_AMPLITUDE: f64 = 0.1;

/// Response of the loop to one chirp, from the lowest frequency on.
pub type FrequencyResponse = Vec<FrequencyPoint>;

/// Response of the loop about one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrequencyPoint {
    /// Frequency in the middle of the turns that count.
    pub hertz: f64,
    /// Amplitude of the position divided by that of the set-point.
    pub gain: f64,
    /// Phase of the position minus that of the set-point, from −270 to 90.
    pub phase_degrees: f64,
    /// Mean of the position minus that of the set-point.
    pub offset: f64,
}

/// Returns the response to each chirp of the scenario. Points at which the drive was silent are missing.
pub fn frequency_responses(
    database: &Database,
    timeline: &Timeline,
    control_loop: &ControlLoop,
) -> Vec<FrequencyResponse> {
    let circumstances = Circumstances::default();
    let evidence = Evidence::new(database, timeline, control_loop, &circumstances);
    let chirps = control_loop.trial.judged_chirps();
    chirps
        .iter()
        .map(|chirp| response(&evidence, chirp).flatten().collect())
        .map(sorted)
        .collect()
}

/// Returns the last frequency before the gain first falls below the cut-off; for several chirps the lowest.
pub(crate) fn bandwidth(evidence: &Evidence<'_>) -> Measurement {
    lowest(evidence, f64::INFINITY)
}

/// Returns the last frequency before the gain first falls below the cut-off, or the mean first leaves that of the set-point.
pub(crate) fn bandwidth_with_mean(evidence: &Evidence<'_>) -> Measurement {
    lowest(evidence, OFFSET_OF_AMPLITUDE)
}

/// Returns the lowest bandwidth of all chirps, in which the mean stays within a part of the amplitude.
fn lowest(evidence: &Evidence<'_>, offset_of_amplitude: f64) -> Measurement {
    let chirps = evidence.trial.judged_chirps();
    let bandwidths = chirps.iter().map(|chirp| {
        let points = response(evidence, chirp).collect::<Result<Vec<_>, _>>()?;
        last_followed(&sorted(points), offset_of_amplitude * chirp.piece.amplitude)
    });
    let lowest = bandwidths.reduce(|left, right| Ok(left?.min(right?)));
    lowest.ok_or_else(Absence::nothing)?.map(Known::from)
}

fn last_followed(points: &[FrequencyPoint], offset_max: f64) -> MetricValue {
    let is_above = |point: &FrequencyPoint| point.gain >= CUT_OFF_GAIN;
    let is_followed = |point: &&FrequencyPoint| is_above(point) && point.offset.abs() <= offset_max;
    let followed = points.iter().take_while(is_followed);
    let last = followed.last().map(|point| point.hertz);
    last.ok_or_else(|| {
        let what = if points.first().is_none_or(|first| !is_above(first)) {
            format!("the gain is below {CUT_OFF_GAIN}")
        } else {
            "the mean is not that of the set-point".to_owned()
        };
        format!("{what} from the lowest frequency on").into()
    })
}

fn sorted(mut points: FrequencyResponse) -> FrequencyResponse {
    points.sort_by(|left, right| left.hertz.total_cmp(&right.hertz));
    points
}

/// Returns the points in the order of time: all whole turns except the first, in parts of equally many.
fn response(
    evidence: &Evidence<'_>,
    chirp: &JudgedChirp,
) -> impl Iterator<Item = Result<FrequencyPoint, Absence>> {
    let turns_each = libm::ceil((chirp.turns - 1.0) / POINTS_MAX);
    let firsts = std::iter::successors(Some(1.0), move |first| Some(first + turns_each));
    firsts
        .take_while(move |first| first + turns_each <= chirp.turns)
        .map(move |first| point(evidence, chirp, first, first + turns_each))
}

fn point(
    evidence: &Evidence<'_>,
    chirp: &JudgedChirp,
    first: f64,
    end: f64,
) -> Result<FrequencyPoint, Absence> {
    let piece = &chirp.piece;
    let at = |turns: f64| piece.from_seconds + piece.seconds_at(turns);
    let window = Window::new(at(first), at(end));
    let samples = evidence.seen(window)?.map(|sample| {
        let phase = piece.phase_at(sample.time_seconds - piece.from_seconds);
        (phase.radians(), sample.position)
    });
    let position = Harmonic::fit_phases(samples)
        .ok_or_else(|| Absence::from("too few positions for a turn of the chirp"))?;
    let middle = piece.seconds_at(0.5 * (first + end));
    Ok(FrequencyPoint {
        hertz: piece.phase_at(middle).hertz(),
        gain: position.amplitude() / piece.amplitude,
        phase_degrees: phase_between(0.0, position.phase_degrees()),
        offset: position.mean - piece.centre,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_ends_a_bandwidth_before_the_gain_does() {
        let point = |hertz, gain, offset| FrequencyPoint {
            hertz,
            gain,
            phase_degrees: 0.0,
            offset,
        };
        let points = [
            point(1.0, 1.0, 0.0),
            point(2.0, 0.9, -1.0),
            point(3.0, 0.8, 1.01),
            point(4.0, 0.8, 0.0),
            point(5.0, 0.7, 0.0),
        ];
        assert_eq!(last_followed(&points, f64::INFINITY), Ok(4.0));
        assert_eq!(last_followed(&points, 1.0), Ok(2.0));
        let why = |points| last_followed(points, 1.0).unwrap_err().reason;
        let mean = "the mean is not that of the set-point from the lowest frequency on";
        assert_eq!(why(&points[2..]), mean);
        let gain = "the gain is below 0.708 from the lowest frequency on";
        assert_eq!(why(&points[4..]), gain);
    }
}
