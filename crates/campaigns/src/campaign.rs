//! Plays many scenarios: each in virtual time within this process, several at a time, without files.

use std::any::Any;
use std::error::Error;
use std::io;
use std::iter;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::sync::{Mutex, PoisonError};
use std::thread;

use scenario::Trial;

use judge::verdict::Verdict;
use plan::Plan;
use recording::capture::{Capture, Watch};
use recording::frames::Frames;
use recording::timeline::{self, Timeline};
use runner::console::Bar;
use runner::exit::{Exit, Failure};
use runner::observer::observed;
use runner::run;
use worlds::catalogue::catalogue;
use worlds::programs::Hosting;
use worlds::{Played, lockstep};

/// Largest number of results per thread that wait for an earlier one. It bounds the memory, however many runs there are.
const WAITING_MAX: usize = 32;

/// How a campaign is played.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    /// Runs at a time; each holds the frames and the timeline of one run in memory.
    pub threads: usize,
    /// Whether a terminal shows a bar.
    pub is_shown: bool,
}

/// Run of a campaign, lent to the function that reduces it.
#[derive(Debug)]
pub struct CampaignRun<'a> {
    /// Place of the run in the campaign.
    pub index: usize,
    /// Plan that was played.
    pub plan: &'a Plan,
    /// Frames of the run, as they were on the bus.
    pub frames: &'a Frames,
    /// The same frames, decoded for each loop.
    pub timelines: &'a [Timeline],
    /// Verdict of the run; "incomplete" if the world broke off.
    pub verdict: &'a Verdict,
}

impl CampaignRun<'_> {
    /// Returns the signals of the loop, if the plan has only one.
    pub fn only_timeline(&self) -> Option<&Timeline> {
        match self.timelines {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// Returns whether an error is the machine's: the operating system refused something, such as room on the disk. Played again, the
/// run may have a result.
fn is_of_machine(error: &(dyn Error + 'static)) -> bool {
    let mut causes = iter::successors(Some(error), |error| Error::source(*error));
    causes.any(|cause| cause.is::<io::Error>())
}

/// Returns the failure of a run without a result, by the machine (`BenchFailed`) or by the program (`Internal`).
fn no_result(error: impl Error + 'static) -> Failure {
    if is_of_machine(&error) {
        Exit::BenchFailed.because(error)
    } else {
        Exit::Internal.because(error)
    }
}

/// Error of a campaign that the user stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("interrupted by the user")]
pub struct Interrupted;

/// Returns the failure of a campaign that the user stopped.
pub(crate) fn interrupted(done: usize, of: usize) -> Failure {
    Exit::Interrupted.because(format!(
        "interrupted: {done} of {of} runs are done; give the same command again to continue"
    ))
}

impl Campaign {
    /// Returns a campaign with as many runs at a time as there are cores.
    pub fn on_all_cores(is_shown: bool) -> Self {
        Self {
            threads: thread::available_parallelism().map_or(1, usize::from),
            is_shown,
        }
    }

    /// Plays the plans and returns the value of `reduce` for each run, in the order of the plans for any number of threads. Plans
    /// are made when a thread is free. A run that fails or panics has a failure that names it, and the others continue.
    ///
    /// # Errors
    /// The user stopped it.
    pub fn play<T: Send>(
        &self,
        plans: impl Iterator<Item = Plan> + Send,
        reduce: impl Fn(&CampaignRun<'_>) -> T + Sync,
    ) -> Result<Vec<Result<T, Failure>>, Interrupted> {
        let bar = Bar::runs(plans.size_hint().1, 0, self.is_shown);
        let mut results = Vec::new();
        let work = |(index, plan): &(usize, Plan), watch: &Watch| {
            caught(|| play_one(*index, plan, watch, &reduce))
        };
        let on_result = |(index, plan): (usize, Plan), result: Result<T, Failure>| {
            let (name, seed) = (&plan.shared.run.name, plan.shared.run.seed);
            let failed = |Failure { exit, reason, .. }: Failure| {
                exit.because(format!(
                    "run {index} ({name}, seed {seed}) failed: {reason}"
                ))
            };
            results.push(result.map_err(failed));
            Ok(())
        };
        self.each(plans.enumerate(), &bar, work, on_result)??;
        Ok(results)
    }

    /// Does `work` for each job, several at a time, and hands the results to `on_result` in the order of the jobs, each as soon
    /// as its turn comes. Holds at most the results by which some threads are ahead of the slowest one, within a bound, for any
    /// number of jobs. `work` must not panic: a panic is not a result of its job, but ends the campaign. Returns `Interrupted` if
    /// the user stopped it.
    ///
    /// # Errors
    /// `on_result` refused a result; it gets no later ones.
    pub fn each<J: Send, R: Send, E>(
        &self,
        jobs: impl Iterator<Item = J> + Send,
        bar: &Bar,
        work: impl Fn(&J, &Watch) -> R + Sync,
        mut on_result: impl FnMut(J, R) -> Result<(), E>,
    ) -> Result<Result<(), Interrupted>, E> {
        let threads = self.threads.max(1);
        let watches: Vec<Watch> = (0..threads).map(|_| Watch::default()).collect();
        let jobs = Mutex::new(jobs);
        // It is full while the first of the jobs takes long.
        let (announced, in_order) = mpsc::sync_channel::<Receiver<(J, R)>>(WAITING_MAX * threads);
        let serve = |watch: &Watch, announced: SyncSender<_>| {
            while !watch.is_interrupted()
                && let Some((job, done)) = take(&jobs, &announced)
            {
                let result = work(&job, watch);
                // A run that was interrupted has no result.
                if !watch.is_interrupted() {
                    let _ = done.send((job, result));
                }
            }
        };
        let done = AtomicU64::new(bar.done());
        let hand_on = || {
            for result in in_order {
                let Ok((job, result)) = result.recv() else {
                    break;
                };
                on_result(job, result)?;
                done.fetch_add(1, Ordering::Relaxed);
            }
            Ok(())
        };
        observed(
            || watches.iter().for_each(Watch::interrupt),
            || bar.show(done.load(Ordering::Relaxed)),
            || {
                thread::scope(|scope| {
                    for watch in &watches {
                        let announced = announced.clone();
                        scope.spawn(|| serve(watch, announced));
                    }
                    drop(announced);
                    hand_on()
                })
            },
        )?;
        if watches.iter().any(Watch::is_interrupted) {
            return Ok(Err(Interrupted));
        }
        Ok(Ok(()))
    }
}

/// Takes the next job, and announces its result, in the order of the jobs. `None` if no job is left, or no result is wanted.
fn take<J, R>(
    jobs: &Mutex<impl Iterator<Item = J>>,
    announced: &SyncSender<Receiver<(J, R)>>,
) -> Option<(J, Sender<(J, R)>)> {
    let mut jobs = jobs.lock().unwrap_or_else(PoisonError::into_inner);
    let (job, (done, result)) = (jobs.next()?, mpsc::channel());
    announced.send(result).ok()?;
    Some((job, done))
}

/// Does some work, which ends early when its watch is interrupted.
///
/// # Errors
/// The user stopped it.
pub fn watched<T>(work: impl FnOnce(&Watch) -> T) -> Result<T, Interrupted> {
    let watch = Watch::default();
    let done = observed(|| watch.interrupt(), || {}, || work(&watch));
    if watch.is_interrupted() {
        return Err(Interrupted);
    }
    Ok(done)
}

/// Returns the plan of a scenario of one drive.
pub fn one_loop_plan(scenario: Trial) -> Plan {
    Plan::new(scenario, catalogue())
}

/// Plays a plan in virtual time and returns the value of `reduce` for the run.
///
/// # Errors
/// The rig's DBC lacks a signal, or the machine failed: then the run has no result.
pub fn play_one<T>(
    index: usize,
    plan: &Plan,
    watch: &Watch,
    reduce: impl Fn(&CampaignRun<'_>) -> T,
) -> Result<T, Failure> {
    let clock = plan.scenario_clock().map_err(no_result)?;
    let mut capture = Capture::in_memory(clock, watch);
    let ended =
        lockstep::simulate(plan, &Hosting::default(), &mut capture).map(Played::in_virtual_time);
    if let Err(error) = &ended
        && is_of_machine(error)
    {
        return Err(Exit::BenchFailed.because(error));
    }
    let (frames, unrecorded) = capture.finish(plan).map_err(no_result)?;
    let timelines = timeline::decode(&frames, plan).map_err(no_result)?;
    let verdict = run::verdict(&ended, &timelines, plan, &unrecorded);
    Ok(reduce(&CampaignRun {
        index,
        plan,
        frames: &frames,
        timelines: &timelines,
        verdict: &verdict,
    }))
}

/// Does some work; returns a panic as a fault of the program.
pub(crate) fn caught<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(Exit::Internal.because(message(panic.as_ref()))))
}

/// Returns the text of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("it panicked: {}", text.unwrap_or("without a message"))
}

#[cfg(test)]
mod tests {
    use std::sync::{Condvar, Mutex};

    use super::*;

    /// Returns seven short runs, the longest first, so that they do not end in order.
    fn plans() -> impl Iterator<Item = Plan> {
        (0..7_u32).map(|number| {
            let (seconds, position) = (0.8 - 0.1 * f64::from(number), number + 1);
            let text = format!(
                "schema = 1\nrig = \"sma_actuator\"\nname = \"run {number}\"\nseed = {number}\nduration_seconds = {seconds}\n[controller.pid]\n\
                 [node.drive.sensor]\nnoise_rms = 0.05\n\
                 [[reference.step]]\nat_seconds = 0.0\nposition_millimetres = {position}\n"
            );
            testing::plan_beside(&text, &[], catalogue())
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
            let results = campaign(threads).play(plans(), |played| {
                (played.index, played.frames.len(), played.verdict.to_json())
            });
            let verdicts = results.unwrap().into_iter();
            Vec::from_iter(verdicts.map(Result::unwrap))
        };
        let alone = play(1);
        assert_eq!(alone, play(3));
        for (place, (index, frames, verdict)) in alone.iter().enumerate() {
            assert_eq!(*index, place);
            assert!(
                *frames > 500 && verdict.contains(&format!("\"run {place}\"")),
                "{verdict}"
            );
        }
    }

    #[test]
    fn a_run_that_panics_is_named_and_the_others_go_on() {
        let results = campaign(2)
            .play(plans(), |played| {
                assert!(played.index != 2, "the third cannot be reduced");
                played.index
            })
            .unwrap();
        let fault = results[2].as_ref().unwrap_err();
        let text = "run 2 (run 2, seed 2) failed: it panicked: the third cannot be reduced";
        assert_eq!(fault.to_string(), text);
        assert_eq!(fault.exit, Exit::Internal);
        assert_eq!(results.iter().flatten().count(), 6);
    }

    #[test]
    fn what_the_operating_system_refuses_is_the_machines_fault() {
        let path = "bus.log".into();
        let source = io::Error::from(io::ErrorKind::StorageFull);
        let full = recording::run_folder::WriteError { path, source };
        let machine = no_result(full);
        assert_eq!(machine.exit, Exit::BenchFailed);
        assert!(machine.reason.contains("bus.log"), "{machine:?}");
        let fault = no_result("x".parse::<usize>().unwrap_err());
        assert_eq!(fault.exit, Exit::Internal, "{fault:?}");
    }

    #[test]
    fn results_are_taken_in_order_and_few_wait_for_a_slow_one() {
        let bar = Bar::runs(None, 0, false);
        let is_first_done = (Mutex::new(false), Condvar::new());
        let ahead = std::sync::atomic::AtomicUsize::new(0);
        let work = |job: &usize, _: &Watch| {
            let (is_done, changed) = &is_first_done;
            if *job == 0 {
                // The first run waits until the others may not continue.
                let is_done = is_done.lock().unwrap();
                drop(changed.wait_while(is_done, |is_done| !*is_done).unwrap());
            } else if ahead.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 2
                == 2 * WAITING_MAX
            {
                *is_done.lock().unwrap() = true;
                changed.notify_all();
            }
            *job
        };
        let mut taken = Vec::new();
        let on_result = |job, result| {
            assert_eq!(result, job);
            taken.push(job);
            if job == 200 { Err("full") } else { Ok(()) }
        };
        let stopped = campaign(2).each(0..1000, &bar, work, on_result);
        assert_eq!(stopped, Err("full"));
        assert!(taken.into_iter().eq(0..=200));
        let played = ahead.into_inner();
        assert!(played <= 201 + 2 * WAITING_MAX, "{played}");
    }
}
