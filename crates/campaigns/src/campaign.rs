//! Many scenarios: each in virtual time within this process, several at a time, with nothing on the disk.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use scenario::Scenario;

use dbc::scenario_clock::ScenarioClock;
use judge::verdict::Verdict;
use recording::capture::{Capture, Watch};
use recording::log::Stamped;
use recording::timeline::{self, Timeline};
use rig::setup::Setup;
use runner::console::RunsBar;
use runner::observer::observed;
use runner::run;
use worlds::catalogue::catalogue;
use worlds::{Played, lockstep};

/// Results that may wait for an earlier one to end, by thread: so much is held in memory, however many runs there are.
const WAITING_MAX: usize = 32;
/// How soon a thread that waits for an earlier run sees that the user stopped it.
const STOP_PERIOD: Duration = Duration::from_millis(100);

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
pub struct CampaignRun<'a> {
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
pub struct FailedRun {
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

/// Why a campaign ended before its last run.
#[derive(Debug, PartialEq, Eq)]
pub enum Stopped<E> {
    /// The user stopped it.
    Interrupted,
    /// A result could not be taken.
    Refused(E),
}

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
        reduce: impl Fn(&CampaignRun<'_>) -> T + Sync,
    ) -> Result<Vec<Result<T, FailedRun>>, Interrupted> {
        let count = RunsBar::new(scenarios.size_hint().1, self.is_shown);
        let mut results = Vec::new();
        let work = |(index, scenario): &(usize, Scenario), watch: &Watch| {
            play_one(*index, scenario.clone(), watch, &reduce).map_err(|error| error.to_string())
        };
        let take = |(index, scenario): (usize, Scenario), result: Result<T, String>| {
            results.push(result.map_err(|reason| FailedRun {
                index,
                name: scenario.name,
                seed: scenario.seed,
                reason,
            }));
            Ok::<(), std::convert::Infallible>(())
        };
        match self.each(scenarios.enumerate(), &count, work, take) {
            Ok(()) => Ok(results),
            Err(Stopped::Interrupted) => Err(Interrupted),
        }
    }

    /// Does `work` for each job, several at a time, and hands the results to `take` in the order of the jobs as soon as it
    /// is their turn. What `work` panics with is its result. Holds as many results as some threads are ahead of the
    /// slowest, within a bound, whatever the number of jobs.
    ///
    /// # Errors
    /// The user stopped it, or `take` refused a result; later results are then not taken.
    pub fn each<J: Send, T: Send, E: Send>(
        &self,
        jobs: impl Iterator<Item = J> + Send,
        count: &RunsBar,
        work: impl Fn(&J, &Watch) -> Result<T, String> + Sync,
        take: impl FnMut(J, Result<T, String>) -> Result<(), E> + Send,
    ) -> Result<(), Stopped<E>> {
        let threads = self.threads.max(1);
        let watches: Vec<Watch> = (0..threads).map(|_| Watch::default()).collect();
        let queue = JobQueue {
            state: Mutex::new(QueueState::new(jobs, take)),
            has_taken: Condvar::new(),
            waiting_max: WAITING_MAX * threads,
        };
        let serve = |watch: &Watch| {
            while let Some((place, job)) = queue.next(watch) {
                let done = catch_unwind(AssertUnwindSafe(|| work(&job, watch)));
                let done = done.unwrap_or_else(|panic| Err(message(panic.as_ref())));
                // A run that was interrupted came to nothing.
                if watch.is_interrupted() {
                    break;
                }
                queue.put(place, job, done);
            }
        };
        observed(
            || watches.iter().for_each(Watch::interrupt),
            || count.show(queue.lock().taken),
            || {
                thread::scope(|scope| {
                    for watch in &watches {
                        scope.spawn(|| serve(watch));
                    }
                });
            },
        );
        let refusal = queue.lock().refusal.take();
        match refusal {
            Some(refusal) => Err(Stopped::Refused(refusal)),
            None if watches.iter().any(Watch::is_interrupted) => Err(Stopped::Interrupted),
            None => Ok(()),
        }
    }
}

/// Where threads get jobs and bring results.
struct JobQueue<I, J, T, F, E> {
    state: Mutex<QueueState<I, J, T, F, E>>,
    has_taken: Condvar,
    waiting_max: usize,
}

/// Jobs still to be done, and results whose turn has not come.
struct QueueState<I, J, T, F, E> {
    jobs: I,
    given: usize,
    taken: usize,
    waiting: BTreeMap<usize, (J, Result<T, String>)>,
    take: F,
    refusal: Option<E>,
}

impl<I, J, T, F, E> QueueState<I, J, T, F, E> {
    fn new(jobs: I, take: F) -> Self {
        Self {
            jobs,
            given: 0,
            taken: 0,
            waiting: BTreeMap::new(),
            take,
            refusal: None,
        }
    }
}

impl<I, J, T, F, E> JobQueue<I, J, T, F, E>
where
    I: Iterator<Item = J>,
    F: FnMut(J, Result<T, String>) -> Result<(), E>,
{
    fn lock(&self) -> MutexGuard<'_, QueueState<I, J, T, F, E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next job, once the results are not too far ahead of their turn.
    fn next(&self, watch: &Watch) -> Option<(usize, J)> {
        let mut state = self.lock();
        while state.given >= state.taken + self.waiting_max
            && state.refusal.is_none()
            && !watch.is_interrupted()
        {
            let waited = self.has_taken.wait_timeout(state, STOP_PERIOD);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        if state.refusal.is_some() || watch.is_interrupted() {
            return None;
        }
        let job = state.jobs.next()?;
        state.given += 1;
        Some((state.given - 1, job))
    }

    /// Takes a result, and those that waited for it.
    fn put(&self, place: usize, job: J, done: Result<T, String>) {
        let state = &mut *self.lock();
        state.waiting.insert(place, (job, done));
        while state.refusal.is_none()
            && let Some((job, done)) = state.waiting.remove(&state.taken)
        {
            state.refusal = (state.take)(job, done).err();
            state.taken += 1;
        }
        self.has_taken.notify_all();
    }
}

/// Plays a scenario in virtual time and takes from it what `reduce` makes of it.
///
/// # Errors
/// The rig's DBC lacks a signal, or a file could not be written.
pub fn play_one<T>(
    index: usize,
    scenario: Scenario,
    watch: &Watch,
    reduce: impl Fn(&CampaignRun<'_>) -> T,
) -> Result<T, Box<dyn std::error::Error>> {
    let setup = Setup::of(scenario, catalogue());
    let mut capture = Capture::in_memory(ScenarioClock::new(&setup.database)?, watch);
    let ended = lockstep::simulate(&setup, &mut capture).map(Played::in_virtual_time);
    let (frames, frames_lost) = capture.finish()?;
    let timeline = timeline::decode(&frames, &setup)?;
    let verdict = run::verdict(&ended, &timeline, &setup, frames_lost);
    Ok(reduce(&CampaignRun {
        index,
        scenario: &setup.scenario,
        frames: &frames,
        timeline: &timeline,
        verdict: &verdict,
    }))
}

/// The text of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("it panicked: {}", text.unwrap_or("without a message"))
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

    #[test]
    fn results_are_taken_in_order_and_few_wait_for_a_slow_one() {
        let count = RunsBar::new(None, false);
        let is_first_done = (Mutex::new(false), Condvar::new());
        let ahead = std::sync::atomic::AtomicUsize::new(0);
        let work = |job: &usize, _: &Watch| {
            let (is_done, changed) = &is_first_done;
            if *job == 0 {
                // Until the others may not go on any more.
                let is_done = is_done.lock().unwrap();
                drop(changed.wait_while(is_done, |is_done| !*is_done).unwrap());
            } else if ahead.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 2
                == 2 * WAITING_MAX
            {
                *is_done.lock().unwrap() = true;
                changed.notify_all();
            }
            Ok(*job)
        };
        let mut taken = Vec::new();
        let take = |job, result: Result<usize, String>| {
            assert_eq!(result, Ok(job));
            taken.push(job);
            if job == 200 { Err("full") } else { Ok(()) }
        };
        let stopped = campaign(2).each(0..1000, &count, work, take);
        assert_eq!(stopped, Err(Stopped::Refused("full")));
        assert!(taken.into_iter().eq(0..=200));
        let played = ahead.into_inner();
        assert!(played <= 201 + 2 * WAITING_MAX, "{played}");
    }
}
