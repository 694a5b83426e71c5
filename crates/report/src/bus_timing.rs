//! Timing of the bus, from the stamps of the recording.

use std::collections::BTreeMap;
use std::time::Duration;

use dbc::SignalMissing;
use plan::Plan;
use recording::frames::Frames;
use recording::latency::{CycleReader, CycleStage};

/// Number of stretches of time in which the load is counted.
const LOAD_STRETCHES: u32 = 200;

/// Duration in the resolution of the recording.
pub(super) type Microseconds = u64;

/// Durations, each with the number of its occurrences.
#[derive(Clone, Debug, Default)]
pub(super) struct Durations(BTreeMap<Microseconds, usize>);

impl Durations {
    fn add(&mut self, duration: Duration) {
        let microseconds = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        *self.0.entry(microseconds).or_default() += 1;
    }

    /// Returns the least, the median, the 99th percentile and the largest; `None` if there are no durations.
    pub(super) fn spread(&self) -> Option<[Microseconds; 4]> {
        let last = self.0.values().sum::<usize>().checked_sub(1)?;
        let at = |percent: usize| {
            let mut up_to = 0;
            let reached = self.0.iter().find(|(_, count)| {
                up_to += **count;
                last * percent / 100 < up_to
            });
            reached.map_or(0, |(duration, _)| *duration)
        };
        Some([0, 50, 99, 100].map(at))
    }
}

/// Timing of one recording, from scenario time 0 to its end.
#[derive(Clone, Debug, Default)]
pub(super) struct BusTiming {
    /// Times between two SYNCs.
    pub(super) cycles: Durations,
    /// For each loop, times from a SYNC to the drive's answer, and to the controller's command that follows from it.
    pub(super) loops: Vec<[Durations; 2]>,
    /// Middle of each stretch in scenario time.
    pub(super) load_seconds: Vec<f64>,
    /// Percentage of each stretch in which a frame was on the bus.
    pub(super) load_percent: Vec<f64>,
}

impl BusTiming {
    /// Reads the stamps of a run.
    ///
    /// # Errors
    /// The database lacks a message of a drive.
    pub(super) fn new(frames: &Frames, plan: &Plan) -> Result<Self, SignalMissing> {
        let readers = plan.loops.iter().map(|one| CycleReader::new(plan, one));
        let mut readers = readers.collect::<Result<Vec<_>, _>>()?;
        let duration = plan.duration();
        let stretch = Duration::from_millis(10).max(duration / LOAD_STRETCHES);
        let mut timing = Self {
            loops: vec![Default::default(); plan.loops.len()],
            ..Self::default()
        };
        let (mut bits, mut sync) = (Vec::new(), None);
        for stamped in frames.iter() {
            let (mut time, mut is_sync) = (None, false);
            for (reader, [answers, commands]) in readers.iter_mut().zip(&mut timing.loops) {
                // All loops have one clock.
                time = reader.on_frame(&stamped);
                let in_scenario = time.filter(|time| *time < duration);
                match in_scenario.and_then(|_| reader.stage(&stamped)) {
                    Some(CycleStage::Sync) => is_sync = true,
                    Some(CycleStage::Position { after_sync }) => answers.add(after_sync),
                    Some(CycleStage::Command { after_sync, .. }) => commands.add(after_sync),
                    None => {}
                }
            }
            let Some(time) = time else { continue };
            if time >= duration {
                break;
            }
            let place = usize::try_from(time.as_nanos() / stretch.as_nanos()).unwrap_or_default();
            bits.resize(bits.len().max(place + 1), 0);
            bits[place] += u64::from(stamped.occupied_bits);
            if is_sync && let Some(before) = sync.replace(time) {
                timing.cycles.add(time.saturating_sub(before));
            }
        }
        // The last stretch may be cut.
        if bits.len() > 1 {
            bits.pop();
        }
        let seconds = stretch.as_secs_f64();
        let bits_per_second = f64::from(plan.shared.run.bus.bitrate_kilobits_per_second) * 1e3;
        for (place, bits) in bits.into_iter().enumerate() {
            timing.load_seconds.push((place as f64 + 0.5) * seconds);
            let percent = 100.0 * bits as f64 / (bits_per_second * seconds);
            timing.load_percent.push(percent);
        }
        Ok(timing)
    }
}

/// Returns a histogram: edges of the bins and decimal logarithms of their counts, as the corners of an area.
pub(super) fn histogram(durations: &Durations) -> (Vec<f64>, Vec<f64>) {
    const BINS: u32 = 60;
    let Some([least, .., most]) = durations.spread() else {
        return (Vec::new(), Vec::new());
    };
    let (least, most) = (least as f64, most as f64);
    // The bins have whole microseconds, as the recording does.
    let width = libm::ceil((most - least + 1.0) / f64::from(BINS)).max(1.0);
    let mut counts = vec![0; BINS as usize];
    for (duration, count) in &durations.0 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "from 0 to the number of bins"
        )]
        let bin = ((*duration as f64 - least) / width + 1e-6) as usize;
        counts[bin.min(BINS as usize - 1)] += count;
    }
    let used = counts
        .iter()
        .rposition(|count| *count > 0)
        .map_or(0, |last| last + 1);
    let mut corners = (vec![least - width / 2.0], vec![FLOOR]);
    for (number, count) in (0..BINS).zip(&counts[..used]) {
        let left = least + (f64::from(number) - 0.5) * width;
        let height = if *count == 0 {
            FLOOR
        } else {
            libm::log10(*count as f64)
        };
        corners.0.extend([left, left + width]);
        corners.1.extend([height, height]);
    }
    let right = corners.0.last().copied().unwrap_or(least);
    corners.0.push(right);
    corners.1.push(FLOOR);
    corners
}

/// Height of an empty bin: below a bin with one entry, whose logarithm is 0.
const FLOOR: f64 = -0.3;

#[cfg(test)]
mod tests {
    use super::*;

    fn durations(microseconds: impl IntoIterator<Item = Microseconds>) -> Durations {
        let mut durations = Durations::default();
        for microseconds in microseconds {
            durations.add(Duration::from_micros(microseconds));
        }
        durations
    }

    #[test]
    fn percentiles_are_ranks() {
        let durations = durations(1..=101);
        assert_eq!(durations.spread(), Some([1, 51, 100, 101]));
        assert_eq!(Durations::default().spread(), None);
    }

    #[test]
    fn a_histogram_counts_everything() {
        let durations = durations([1000, 1000, 1000, 1001, 1240]);
        let (edges, heights) = histogram(&durations);
        assert_eq!(edges.len(), heights.len());
        let total: f64 = heights[1..heights.len() - 1]
            .chunks(2)
            .filter(|bin| bin[0] > FLOOR)
            .map(|bin| libm::pow(10.0, bin[0]))
            .sum();
        assert!((total - 5.0).abs() < 1e-9, "{total}");
        assert!(edges.first().unwrap() < &1000.0 && edges.last().unwrap() > &1240.0);
    }
}
