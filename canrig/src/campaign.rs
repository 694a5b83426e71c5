//! Many scenarios: each in virtual time within this process, several at a time, with nothing on the disk.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use plant_emulator::catalogue;
use scenario::Scenario;

use crate::capture::{Capture, Watch};
use crate::console::Count;
use crate::recording::Stamped;
use crate::run::{self, World};
use crate::timeline::{self, Timeline};
use crate::verdict::Verdict;
use crate::world;
use dbc::scenario_clock::ScenarioClock;

/// How a campaign is played.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    /// Runs at a time; each holds the frames and the timeline of one run in memory.
    pub threads: usize,
    /// Whether a terminal shows a bar.
    pub is_shown: bool,
}

/// One run, lent to whoever takes from it what the campaign is about.
#[derive(Debug)]
pub struct Played<'a> {
    /// Its place in the campaign.
    pub index: usize,
    /// What was played.
    pub scenario: &'a Scenario,
    /// What was on the bus.
    pub frames: &'a [Stamped],
    /// The same, decoded.
    pub timeline: &'a Timeline,
    /// What it came to; "incomplete" where the world broke off.
    pub verdict: &'a Verdict,
}

/// A run that the program itself could not bring to a verdict.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("run {index} ({name}, seed {seed}) failed: {reason}")]
pub struct Fault {
    /// Its place in the campaign.
    pub index: usize,
    /// The scenario's name.
    pub name: String,
    /// The scenario's seed.
    pub seed: u64,
    /// What went wrong: the text of a panic or of an error.
    pub reason: String,
}

/// The user stopped the campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("interrupted by the user")]
pub struct Interrupted;

impl Campaign {
    /// As many runs at a time as there are cores.
    #[must_use]
    pub fn on_all_cores(is_shown: bool) -> Self {
        Self {
            threads: thread::available_parallelism().map_or(1, usize::from),
            is_shown,
        }
    }

    /// Plays the scenarios and takes from each run what `reduce` makes of it; in the order of the scenarios, however many
    /// threads there are. Scenarios are drawn when a thread is free. A run that panics is a fault, and the others go on.
    ///
    /// # Errors
    /// The user stopped it.
    pub fn play<T: Send>(
        &self,
        scenarios: impl Iterator<Item = Scenario> + Send,
        reduce: impl Fn(&Played<'_>) -> T + Sync,
    ) -> Result<Vec<Result<T, Fault>>, Interrupted> {
        let threads = self.threads.max(1);
        let count = Count::new(scenarios.size_hint().1, self.is_shown);
        let (done, queue) = (AtomicUsize::new(0), Mutex::new(scenarios.enumerate()));
        let watches: Vec<Watch> = (0..threads).map(|_| Watch::default()).collect();
        let work = |watch: &Watch| {
            let mut results = Vec::new();
            while !watch.is_interrupted()
                && let Some((index, scenario)) = next(&queue)
            {
                results.push((index, play_one(index, &scenario, watch, &reduce)));
                done.fetch_add(1, Ordering::Relaxed);
            }
            results
        };
        let mut results = world::observed(
            || watches.iter().for_each(Watch::interrupt),
            || count.show(done.load(Ordering::Relaxed)),
            || {
                thread::scope(|scope| {
                    let workers: Vec<_> = watches
                        .iter()
                        .map(|watch| scope.spawn(|| work(watch)))
                        .collect();
                    let results = workers.into_iter().flat_map(|worker| {
                        worker
                            .join()
                            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
                    });
                    results.collect::<Vec<_>>()
                })
            },
        );
        if watches.iter().any(Watch::is_interrupted) {
            return Err(Interrupted);
        }
        results.sort_unstable_by_key(|(index, _)| *index);
        Ok(results.into_iter().map(|(_, result)| result).collect())
    }
}

/// The next of the queue; the lock is released before it is played.
fn next<T>(queue: &Mutex<impl Iterator<Item = T>>) -> Option<T> {
    queue.lock().ok()?.next()
}

fn play_one<T>(
    index: usize,
    scenario: &Scenario,
    watch: &Watch,
    reduce: impl Fn(&Played<'_>) -> T,
) -> Result<T, Fault> {
    let played = catch_unwind(AssertUnwindSafe(|| judged(index, scenario, watch, reduce)));
    let reason = match played {
        Ok(Ok(result)) => return Ok(result),
        Ok(Err(error)) => error.to_string(),
        Err(panic) => format!("it panicked: {}", message(panic.as_ref())),
    };
    Err(Fault {
        index,
        name: scenario.name.clone(),
        seed: scenario.seed,
        reason,
    })
}

fn judged<T>(
    index: usize,
    scenario: &Scenario,
    watch: &Watch,
    reduce: impl Fn(&Played<'_>) -> T,
) -> Result<T, Box<dyn std::error::Error>> {
    let database = catalogue::database(scenario);
    let mut capture = Capture::in_memory(ScenarioClock::new(database)?, watch);
    let ended = world::lockstep::simulate(scenario, database, &mut capture);
    let ended = ended.map(World::in_virtual_time);
    let (frames, frames_lost) = capture.finish()?;
    let timeline = timeline::decode(&frames, scenario, database)?;
    let verdict = run::verdict(&ended, &timeline, scenario, frames_lost);
    Ok(reduce(&Played {
        index,
        scenario,
        frames: &frames,
        timeline: &timeline,
        verdict: &verdict,
    }))
}

/// The text of a panic.
fn message(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seven short runs, the first ones the longest, so that they do not end in order.
    fn scenarios() -> impl Iterator<Item = Scenario> {
        (0..7_u32).map(|number| {
            let (seconds, position) = (0.8 - 0.1 * f64::from(number), number + 1);
            let text = format!(
                "schema = 1\nname = \"run {number}\"\nseed = {number}\nduration_seconds = {seconds}\n[controller.pid]\n\
                 [plant.sensor]\nnoise_millimetres_rms = 0.05\n\
                 [[reference.step]]\nat_seconds = 0.0\nposition_millimetres = {position}\n"
            );
            Scenario::parse(&text, "run.toml", |_| unreachable!("no table")).unwrap()
        })
    }

    fn campaign(threads: usize) -> Campaign {
        Campaign {
            threads,
            is_shown: false,
        }
    }

    #[test]
    fn results_come_in_order_and_do_not_depend_on_the_number_of_threads() {
        let play = |threads| {
            let verdicts = campaign(threads).play(scenarios(), |played| {
                (played.index, played.frames.len(), played.verdict.to_json())
            });
            verdicts.unwrap()
        };
        let alone = play(1);
        assert_eq!(alone, play(3));
        for (place, result) in alone.iter().enumerate() {
            let (index, frames, verdict) = result.as_ref().unwrap();
            assert_eq!(*index, place);
            assert!(
                *frames > 500 && verdict.contains(&format!("\"run {place}\"")),
                "{verdict}"
            );
        }
    }

    #[test]
    fn a_run_that_panics_is_named_and_the_others_go_on() {
        let results = campaign(2).play(scenarios(), |played| {
            assert!(played.index != 2, "the third cannot be reduced");
            played.index
        });
        let results = results.unwrap();
        let fault = results[2].as_ref().unwrap_err();
        let text = "run 2 (run 2, seed 2) failed: it panicked: the third cannot be reduced";
        assert_eq!(fault.to_string(), text);
        assert_eq!(results.iter().flatten().count(), 6);
    }
}
