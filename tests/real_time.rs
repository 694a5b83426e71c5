//! Tests in real time on busy machines: a virtual machine that is held up for 60 ms loses its drive, as it should, and a
//! law whose processor has other work is late. A failure during that is no proof, and is tried again; a failure on a
//! quiet machine counts.

use std::any::Any;
use std::fs;
use std::ops::{Deref, DerefMut};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::{Child, Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use crate::support::output;

/// Stall that the most patient nodes here hardly notice: a controller gives up its drive after 20 cycles, at least
/// 20 ms.
const STALL: Duration = Duration::from_millis(15);
/// Part of the time in which a process may wait for a processor.
const QUIET: f64 = 0.2;
const ATTEMPTS: u32 = 10;
/// Words of canrig about a run that a busy machine spoiled. It sees stalls that are none of the
/// test's own threads.
const SPOILED: [&str; 2] = ["stalls cover", "too busy for real time"];
/// Time limit that only ends a hang.
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs the body of a test, again if it panics on a busy machine.
pub(crate) fn in_real_time(test: impl Fn()) {
    let attempt = || catch_unwind(AssertUnwindSafe(&test));
    if let Err(panic) = while_time_flows(attempt, |panic| panic_text(&**panic)) {
        resume_unwind(panic);
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or_default()
}

/// Runs `attempt`, again while it fails on a busy machine, or with a text that names stalls. It
/// must not panic.
#[expect(clippy::print_stdout, reason = "shown with a test that fails")]
pub(crate) fn while_time_flows<E>(
    mut attempt: impl FnMut() -> Result<(), E>,
    text: impl Fn(&E) -> &str,
) -> Result<(), E> {
    for _ in 1..ATTEMPTS {
        let (start, waited) = (Instant::now(), waited());
        let (result, stall) = watched(&mut attempt);
        let waited = self::waited().saturating_sub(waited);
        let is_spoiled = |error: &E| SPOILED.iter().any(|spoiled| text(error).contains(spoiled));
        let is_quiet = stall < STALL && waited < start.elapsed().mul_f64(QUIET);
        if result.is_ok() || is_quiet && !result.as_ref().is_err_and(is_spoiled) {
            return result;
        }
        println!("the machine stood still for {stall:?}, processes waited {waited:?}: once more");
    }
    attempt()
}

/// Returns the time for which some process has waited for a processor since the start of the machine, if the kernel counts it.
fn waited() -> Duration {
    let pressure = fs::read_to_string("/proc/pressure/cpu").unwrap_or_default();
    let total = pressure.lines().find(|line| line.starts_with("some"));
    let total = total.and_then(|line| line.rsplit_once("total="));
    let microseconds = total.and_then(|(_, number)| number.parse().ok());
    Duration::from_micros(microseconds.unwrap_or_default())
}

/// Returns the result of `work`, and the longest time for which a processor did not run a thread that only sleeps.
fn watched<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let processors = sched_getaffinity(None).expect("a process may ask for its processors");
    let is_over = &AtomicBool::new(false);
    thread::scope(|scope| {
        let allowed = (0..CpuSet::MAX_CPU).filter(|processor| processors.is_set(*processor));
        let watches: Vec<_> = allowed
            .map(|processor| scope.spawn(move || longest_stall(processor, is_over)))
            .collect();
        let result = work();
        is_over.store(true, Ordering::Relaxed);
        let stalls = watches.into_iter().map(|watch| watch.join());
        let longest = stalls
            .map(|stall| stall.expect("a watch cannot panic"))
            .max();
        (result, longest.unwrap_or_default())
    })
}

fn longest_stall(processor: usize, is_over: &AtomicBool) -> Duration {
    let mut here = CpuSet::new();
    here.set(processor);
    // If this is refused, the thread watches on its own processor.
    let _ = sched_setaffinity(None, &here);
    let mut longest = Duration::ZERO;
    while !is_over.load(Ordering::Relaxed) {
        let before = Instant::now();
        thread::sleep(Duration::from_millis(2));
        longest = longest.max(before.elapsed());
    }
    longest
}

/// Waits until a condition holds.
pub(crate) fn wait_for(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        if start.elapsed() > PATIENCE {
            panic!("waited too long for {what}");
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// Works as [`output`], for a command that may wait for ever: it is ended, with the code 124.
pub(crate) fn soon(command: &mut Command) -> (Option<i32>, String, String) {
    let mut bounded = Command::new("timeout");
    bounded.arg(PATIENCE.as_secs().to_string());
    bounded.arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => bounded.env(name, value),
            None => bounded.env_remove(name),
        };
    }
    output(&mut bounded)
}

/// A process that does not outlive a failing test.
pub(crate) struct Started(Option<Child>);

impl Started {
    pub(crate) fn new(child: Child) -> Self {
        Self(Some(child))
    }

    /// Waits for its own end; returns its output.
    pub(crate) fn ended(mut self) -> Output {
        let child = self.0.take().expect("it is taken out here only");
        child.wait_with_output().expect("a child can be waited for")
    }
}

/// Starts a process that keeps a processor busy.
pub(crate) fn busy() -> Started {
    let mut busy = Command::new("sh");
    Started::new(busy.args(["-c", "while :; do :; done"]).spawn().unwrap())
}

impl Deref for Started {
    type Target = Child;

    fn deref(&self) -> &Child {
        self.0.as_ref().expect("it is taken out at its end only")
    }
}

impl DerefMut for Started {
    fn deref_mut(&mut self) -> &mut Child {
        self.0.as_mut().expect("it is taken out at its end only")
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
