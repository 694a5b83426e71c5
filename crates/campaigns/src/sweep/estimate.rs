//! Estimate of a campaign's time, memory and disk, from a probe of some of its runs.

use std::fmt;
use std::time::Duration;

use recording::capture::Watch;
use runner::console::print;
use runner::exit::{Exit, Failure};
use runner::machine::{Stopwatch, memory_bytes_max};

use super::cases::Cases;
use crate::campaign::{Interrupted, interrupted, watched};

/// Largest number of runs in the probe, spread over all cases.
const PROBES_MAX: usize = 24;
/// Time after which the probe ends, with the run that it is playing.
const PROBE: Duration = Duration::from_secs(10);
/// Time of a part: short enough that its loss costs little, long enough to be worth the start of a task.
const PART_SECONDS: f64 = 600.0;
/// Largest number of parts that engines take in one job by default (Slurm's MaxArraySize is 1001 as delivered).
const PARTS_MAX: usize = 1000;
/// Factor by which another machine may be slower (assumed).
const SLOWNESS: f64 = 3.0;
/// Time and memory of a task in addition to its runs (assumed).
const START_MINUTES: f64 = 5.0;
const SPARE_MEBIBYTES: u64 = 64;
/// Step in which memory is requested.
const STEP_MEBIBYTES: u64 = 64;
/// Number of copies of a row on the disk: one in its part, two in the merged store while that is put in order, one in each of two
/// tables.
const COPIES: f64 = 4.0;

/// Estimate for a campaign.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Estimate {
    runs: usize,
    probed: usize,
    seconds_per_run: f64,
    bytes_per_row: f64,
    memory_bytes: u64,
    cores: u16,
}

impl Estimate {
    /// Plays some of the cases, one at a time, and discards the results.
    pub(crate) fn probe(cases: &dyn Cases, cores: u16) -> Result<Self, Failure> {
        let runs = cases.facts().runs;
        let stopwatch = Stopwatch::start();
        let (mut probed, mut bytes) = (0, 0);
        let work = |watch: &Watch| {
            for case in probed_cases(runs) {
                let row = cases.row_of(case, watch)?;
                probed += 1;
                bytes += serde_json::to_string(&row).map_or(0, |text| text.len());
                if stopwatch.elapsed() >= PROBE || watch.is_interrupted() {
                    break;
                }
            }
            Ok(())
        };
        let ended: Result<(), Failure> =
            watched(work).map_err(|Interrupted| interrupted(0, runs))?;
        ended?;
        let (count, bytes) = (probed as f64, bytes as f64);
        Ok(Self {
            runs,
            probed,
            seconds_per_run: stopwatch.elapsed().as_secs_f64() / count,
            // The checksum is included.
            bytes_per_row: bytes / count + 40.0,
            memory_bytes: memory_bytes_max().unwrap_or_default(),
            cores,
        })
    }

    /// Prints the estimate for all runs, and the command that submits them; `submit` has its arguments other than those of tasks.
    pub(crate) fn print(
        cases: &dyn Cases,
        cores: Option<u16>,
        submit: &str,
    ) -> Result<Exit, Failure> {
        let estimate = Self::probe(cases, cores.unwrap_or(1))?;
        let options = estimate.options();
        print(&format!(
            "{estimate}\ncanrig submit {submit} --engine slurm {options}"
        ));
        Ok(Exit::Pass)
    }

    fn seconds(&self) -> f64 {
        let runs = self.runs as f64;
        runs * self.seconds_per_run
    }

    /// Returns the number of parts of which each is worth the start of a task.
    pub(crate) fn parts(&self) -> usize {
        let parts = self.seconds() / (PART_SECONDS * f64::from(self.cores));
        whole(parts).clamp(1, PARTS_MAX.min(self.runs))
    }

    /// Returns the time limit to request for a task.
    fn task_minutes(&self) -> usize {
        let parts = (self.parts() * usize::from(self.cores)) as f64;
        whole(SLOWNESS * self.seconds() / parts / 60.0 + START_MINUTES)
    }

    /// Returns the memory to request for a task: the probe's for each core.
    fn task_mebibytes(&self) -> u64 {
        let needed = (self.memory_bytes >> 20) * u64::from(self.cores) + SPARE_MEBIBYTES;
        needed.div_ceil(STEP_MEBIBYTES) * STEP_MEBIBYTES
    }

    /// Returns the options for `canrig submit`.
    fn options(&self) -> String {
        let mut text = format!(
            "--parts {} --task-minutes {} --task-mebibytes {}",
            self.parts(),
            self.task_minutes(),
            self.task_mebibytes()
        );
        if self.cores > 1 {
            text += &format!(" --task-cores {}", self.cores);
        }
        text
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = self.parts();
        write!(
            formatter,
            "{} runs; {} of them were played to see: {:.1} ms each on a core of this machine, {:.0} bytes a row\n\
             parts    {parts}, each of {} runs\n\
             time     {} of one core; at most {} minutes for a part on a machine of a third of this speed (assumed)\n\
             memory   {} MiB for a task; {} MiB were used here\n\
             disk     {}",
            self.runs,
            self.probed,
            1e3 * self.seconds_per_run,
            self.bytes_per_row,
            self.runs.div_ceil(parts),
            time(self.seconds()),
            self.task_minutes(),
            self.task_mebibytes(),
            self.memory_bytes >> 20,
            size(COPIES * self.bytes_per_row * self.runs as f64)
        )
    }
}

/// Returns the cases of a probe, each in the middle of one of as many stretches of equal length.
fn probed_cases(runs: usize) -> impl Iterator<Item = usize> {
    let probes = runs.min(PROBES_MAX);
    (0..probes).map(move |number| (2 * number + 1) * runs / (2 * probes) + 1)
}

/// Rounds up to the next whole number.
fn whole(number: f64) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to far less than usize"
    )]
    let whole = libm::ceil(number.clamp(0.0, 1e12)) as usize;
    whole
}

fn time(seconds: f64) -> String {
    match seconds {
        ..120.0 => format!("{seconds:.0} s"),
        ..7200.0 => format!("{:.0} minutes", seconds / 60.0),
        _ => format!("{:.1} hours", seconds / 3600.0),
    }
}

fn size(bytes: f64) -> String {
    match bytes {
        ..1e6 => format!("{:.0} kB", bytes / 1e3),
        ..1e9 => format!("{:.0} MB", bytes / 1e6),
        _ => format!("{:.1} GB", bytes / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(runs: usize, seconds_per_run: f64, cores: u16) -> Estimate {
        Estimate {
            runs,
            probed: 8,
            seconds_per_run,
            bytes_per_row: 500.0,
            memory_bytes: 30 << 20,
            cores,
        }
    }

    #[test]
    fn parts_take_ten_minutes_as_far_as_an_engine_takes_so_many() {
        // 26 000 s.
        let million = estimate(1_000_000, 0.026, 1);
        assert_eq!(
            million.options(),
            "--parts 44 --task-minutes 35 --task-mebibytes 128"
        );
        let text = million.to_string();
        for expected in [
            "each of 22728 runs",
            "7.2 hours of one core",
            "2.0 GB",
            "26.0 ms each",
        ] {
            assert!(text.contains(expected), "{expected}: {text}");
        }
        assert_eq!(estimate(1_000_000, 0.026, 2).parts(), 22);
        assert_eq!(estimate(1_000_000, 10.0, 1).parts(), 1000);
        assert_eq!(estimate(3, 10_000.0, 1).parts(), 3);
        assert_eq!(estimate(3, 0.001, 1).parts(), 1);
        for (runs, disk) in [(3, "disk     6 kB"), (1000, "disk     2 MB")] {
            let text = estimate(runs, 0.001, 1).to_string();
            assert!(text.ends_with(disk), "{disk}: {text}");
        }
    }

    #[test]
    fn a_probe_is_spread_over_all_cases() {
        assert!(probed_cases(240).eq((6..=236).step_by(10)));
        assert!(probed_cases(3).eq(1..=3));
    }
}
