//! Watch for host stalls. On each processor a thread that only sleeps shows when the processor is
//! stopped, as those of a virtual machine are while their host runs something else. The kernel's
//! count of the time for which a thread waited for a processor shows the other stalls. A process
//! whose own threads compete for a processor waits for itself, which is no stall.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::io::pread;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use crate::clock::{monotonic, sleep};
use crate::scheduling::{NODE_PRIORITY, request_fifo};

/// Shortest and longest period of the watch, which otherwise equals the threshold.
const TICKS: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(10)];
/// Period of the search for new threads, and time over which the use of a processor is counted.
const SEARCH_PERIOD: Duration = Duration::from_millis(100);
/// Share of a processor from which on a process that uses it waits for itself, if its busiest
/// thread uses less than that.
const COMPETING: f64 = 0.95;
/// Largest number of processors that are watched; a larger machine has some to spare.
const PROCESSORS_MAX: usize = 16;
/// Largest number of stalls that are kept: a busy machine has as many in a day, and their evaluation needs 300 bytes for each.
const STALLS_MAX: usize = 250_000;

/// Stretch of time in which a thread was held up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeenStall<T> {
    /// Owner of the thread; `None` if the machine or one of its processors was stopped.
    pub who: Option<T>,
    /// Time on the monotonic clock of the system at which it was last seen running.
    pub from: Duration,
    /// Time at which it was seen running again.
    pub until: Duration,
}

/// Request to watch the threads of a process, and those of its descendants if all threads are
/// meant.
struct Order<T> {
    who: T,
    process: u32,
    /// Name of the threads; `None` for all.
    thread: Option<&'static str>,
}

/// Watch over this machine, until it is stopped or dropped.
#[derive(Debug)]
pub struct StallWatch<T> {
    orders: Sender<Order<T>>,
    threads: Vec<JoinHandle<Vec<SeenStall<T>>>>,
    is_over: Arc<AtomicBool>,
}

impl<T: Copy + PartialEq + Send + 'static> StallWatch<T> {
    /// Starts to note all stalls longer than this.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(longer_than: Duration) -> std::io::Result<Self> {
        let (orders, received) = channel();
        let is_over = Arc::new(AtomicBool::new(false));
        let is_watch_over = Arc::clone(&is_over);
        let thread = std::thread::Builder::new()
            .name("stall-watch".into())
            .spawn(move || watch(longer_than, &received, &is_watch_over))?;
        let mut started = Self {
            orders,
            threads: vec![thread],
            is_over,
        };
        for processor in processors() {
            let is_over = Arc::clone(&started.is_over);
            let thread = std::thread::Builder::new()
                .name("processor-watch".into())
                .spawn(move || watch_processor(processor, longer_than, &is_over))?;
            started.threads.push(thread);
        }
        Ok(started)
    }

    /// Watches the threads of a process from now on: all, with those of its descendants, or those
    /// of one name.
    pub fn watch(&self, who: T, process: u32, thread: Option<&'static str>) {
        // A watch that has ended takes no more orders.
        let _ = self.orders.send(Order {
            who,
            process,
            thread,
        });
    }

    /// Stops the watch; returns the stalls in the order of their ends.
    pub fn stop(mut self) -> Vec<SeenStall<T>> {
        let threads = std::mem::take(&mut self.threads);
        // The threads end.
        drop(self);
        merged(threads.into_iter().flat_map(|thread| {
            thread
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        }))
    }
}

impl<T> Drop for StallWatch<T> {
    /// Lets its threads end, without waiting for them.
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

/// Merges the stalls of several watches, in the order of their ends.
fn merged<T: Copy + PartialEq>(stalls: impl Iterator<Item = SeenStall<T>>) -> Vec<SeenStall<T>> {
    let mut stalls = Vec::from_iter(stalls);
    stalls.sort_by_key(|stall| stall.from);
    let mut seen = Vec::new();
    for SeenStall { who, from, until } in stalls {
        note(&mut seen, who, from, until);
    }
    seen.sort_by_key(|stall| stall.until);
    seen
}

/// Returns the processors that this thread may run on, one per set.
fn processors() -> Vec<CpuSet> {
    let allowed = sched_getaffinity(None).unwrap_or_default();
    let numbers = (0..CpuSet::MAX_CPU).filter(|number| allowed.is_set(*number));
    let alone = numbers.take(PROCESSORS_MAX).map(|number| {
        let mut processor = CpuSet::new();
        processor.set(number);
        processor
    });
    alone.collect()
}

/// Notes stalls of a processor: a thread that runs only there was late without waiting for another thread.
fn watch_processor<T: Copy + PartialEq>(
    processor: CpuSet,
    longer_than: Duration,
    is_over: &AtomicBool,
) -> Vec<SeenStall<T>> {
    let mut seen = Vec::new();
    // No statement is possible if the system refuses to pin the thread or does not count.
    let pinned = sched_setaffinity(None, &processor);
    let this = Thread::open(0, Path::new("/proc/thread-self"));
    let (Ok(()), Some(mut this)) = (pinned, this) else {
        return seen;
    };
    let _ = request_fifo(NODE_PRIORITY);
    let tick = tick_for(longer_than);
    let mut last = monotonic();
    while !is_over.load(Ordering::Relaxed) {
        sleep(tick);
        let now = monotonic();
        let Some([_, waited]) = this.spent() else {
            break;
        };
        if is_stall(now - last, tick, waited, longer_than) {
            note(&mut seen, None, last, now);
        }
        last = now;
    }
    seen
}

/// Returns whether a thread that slept for a tick was held up by more than the other threads that it waited for.
fn is_stall(elapsed: Duration, tick: Duration, waited: Duration, longer_than: Duration) -> bool {
    elapsed > tick + waited + longer_than
}

fn tick_for(longer_than: Duration) -> Duration {
    let [shortest, longest] = TICKS;
    longer_than.clamp(shortest, longest)
}

fn watch<T: Copy + PartialEq>(
    longer_than: Duration,
    orders: &Receiver<Order<T>>,
    is_over: &AtomicBool,
) -> Vec<SeenStall<T>> {
    // The watch has the priority of the nodes, so that it is held up exactly when they are. If refused, the nodes were refused
    // too.
    let _ = request_fifo(NODE_PRIORITY);
    let tick = tick_for(longer_than);
    let mut watched: Vec<Watched<T>> = Vec::new();
    let mut threads: Vec<Thread> = Vec::new();
    let mut seen = Vec::new();
    let mut last = monotonic();
    let mut searched_at = None;
    while !is_over.load(Ordering::Relaxed) {
        for order in orders.try_iter() {
            watched.push(Watched {
                order,
                is_competing: false,
            });
            searched_at = None;
        }
        if searched_at.is_none_or(|at| last >= at + SEARCH_PERIOD) {
            let elapsed = searched_at.map_or(SEARCH_PERIOD, |at| last - at);
            note_competition(&mut watched, &mut threads, elapsed);
            searched_at = Some(last);
            search(&watched, &mut threads);
        }
        let asleep = monotonic();
        sleep(tick);
        let now = monotonic();
        let is_held_up = |from: Duration, until: Duration| until > from + longer_than;
        if is_held_up(last, asleep) || is_held_up(asleep + tick, now) {
            note(&mut seen, None, last, now);
        }
        threads.retain_mut(|thread| {
            let Some([ran, waited]) = thread.spent() else {
                return false;
            };
            thread.ran_lately += ran;
            let owner = &watched[thread.order];
            if waited > longer_than && !owner.is_competing {
                // The kernel counts a wait when it is over, which was at the last look at the
                // earliest.
                let from = last.saturating_sub(waited);
                note(&mut seen, Some(owner.order.who), from, now);
            }
            true
        });
        last = now;
    }
    seen
}

/// Notes which processes waited for themselves since the last search: their threads used a whole
/// processor, and no thread did so alone.
fn note_competition<T>(watched: &mut [Watched<T>], threads: &mut [Thread], elapsed: Duration) {
    let whole = elapsed.mul_f64(COMPETING);
    for (place, one) in watched.iter_mut().enumerate() {
        let own = threads.iter().filter(|thread| thread.order == place);
        let ran = Vec::from_iter(own.map(|thread| thread.ran_lately));
        let busiest = ran.iter().max().copied().unwrap_or_default();
        one.is_competing = ran.iter().sum::<Duration>() >= whole && busiest < whole;
    }
    for thread in threads {
        thread.ran_lately = Duration::ZERO;
    }
}

/// Adds a stall, or extends the last one of the same owner if they meet.
fn note<T: Copy + PartialEq>(
    seen: &mut Vec<SeenStall<T>>,
    who: Option<T>,
    from: Duration,
    until: Duration,
) {
    let last = seen.iter().rposition(|stall| stall.who == who);
    match last {
        Some(last) if seen[last].until >= from => {
            let stall = &mut seen[last];
            stall.from = stall.from.min(from);
            stall.until = stall.until.max(until);
        }
        _ if seen.len() < STALLS_MAX => seen.push(SeenStall { who, from, until }),
        _ => {}
    }
}

/// Watched process.
struct Watched<T> {
    order: Order<T>,
    /// Whether its threads compete with each other for a processor.
    is_competing: bool,
}

/// Thread with the times for which it has run and waited for a processor.
struct Thread {
    /// Place of the order to watch it.
    order: usize,
    place: PathBuf,
    count: File,
    times: [Duration; 2],
    /// Time for which it ran since the last search.
    ran_lately: Duration,
}

impl Thread {
    /// Opens the counters of a thread; `None` if the system does not count, or the thread has ended.
    fn open(order: usize, place: &Path) -> Option<Self> {
        let count = File::open(place.join("schedstat")).ok()?;
        let times = spent_in_all(&count)?;
        Some(Self {
            order,
            place: place.to_owned(),
            count,
            times,
            ran_lately: Duration::ZERO,
        })
    }

    /// Returns the times for which it ran and waited since the last call; `None` once the thread
    /// has ended.
    fn spent(&mut self) -> Option<[Duration; 2]> {
        let [ran, waited] = spent_in_all(&self.count)?;
        let before = std::mem::replace(&mut self.times, [ran, waited]);
        Some([
            ran.saturating_sub(before[0]),
            waited.saturating_sub(before[1]),
        ])
    }
}

/// Returns the first two numbers of `schedstat`: nanoseconds spent running, and waiting on a run
/// queue.
fn spent_in_all(count: &File) -> Option<[Duration; 2]> {
    let mut bytes = [0; 96];
    let length = pread(count, &mut bytes, 0).ok()?;
    let text = std::str::from_utf8(&bytes[..length]).ok()?;
    let mut numbers = text.split_whitespace();
    let mut next = || Some(Duration::from_nanos(numbers.next()?.parse().ok()?));
    Some([next()?, next()?])
}

/// Adds the threads that are not watched yet.
fn search<T>(watched: &[Watched<T>], threads: &mut Vec<Thread>) {
    for (place, one) in watched.iter().enumerate() {
        let mut processes = vec![one.order.process];
        while let Some(process) = processes.pop() {
            let tasks = fs::read_dir(format!("/proc/{process}/task"));
            for task in tasks.into_iter().flatten().flatten() {
                let task = task.path();
                match one.order.thread {
                    Some(name) if !is_called(&task, name) => continue,
                    Some(_) => {}
                    None => processes.extend(children(&task)),
                }
                if threads.iter().all(|known| known.place != task) {
                    threads.extend(Thread::open(place, &task));
                }
            }
        }
    }
}

/// Returns the processes that a thread has started, where the kernel lists them.
fn children(task: &Path) -> Vec<u32> {
    let listed = fs::read_to_string(task.join("children")).unwrap_or_default();
    let numbers = listed.split_whitespace();
    numbers.filter_map(|number| number.parse().ok()).collect()
}

fn is_called(task: &Path, name: &str) -> bool {
    let said = fs::read_to_string(task.join("comm")).unwrap_or_default();
    said.trim_end() == name
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn stall(who: Option<char>, from: u32, until: u32) -> SeenStall<char> {
        SeenStall {
            who,
            from: from * MS,
            until: until * MS,
        }
    }

    #[test]
    fn stalls_that_touch_are_one_and_kinds_are_kept_apart() {
        let mut seen = Vec::new();
        for (who, from, until) in [(None, 1, 3), (Some('a'), 1, 3), (None, 3, 5), (None, 7, 9)] {
            note(&mut seen, who, from * MS, until * MS);
        }
        let expected = [stall(None, 1, 5), stall(Some('a'), 1, 3), stall(None, 7, 9)];
        assert_eq!(seen, expected);
    }

    #[test]
    fn a_thread_that_waits_for_another_is_no_stall_of_its_processor() {
        let is_stall = |elapsed: u32, waited: u32| is_stall(elapsed * MS, MS, waited * MS, 2 * MS);
        assert!(!is_stall(3, 0) && is_stall(4, 0));
        assert!(!is_stall(8, 5) && is_stall(9, 5));
    }

    #[test]
    fn what_two_processors_did_at_once_is_one_stall() {
        let seen = [
            stall(None, 5, 6),
            stall(Some('a'), 1, 9),
            stall(None, 4, 8),
            stall(None, 1, 2),
        ];
        let expected = [stall(None, 1, 2), stall(None, 4, 8), stall(Some('a'), 1, 9)];
        assert_eq!(merged(seen.into_iter()), expected);
    }

    #[test]
    fn a_thread_that_shares_its_processor_is_seen_to_wait() {
        if spent_in_all(&File::open("/proc/self/schedstat").unwrap()).is_none() {
            return;
        }
        let here = processors()[0];
        let is_over = AtomicBool::new(false);
        let seen = std::thread::scope(|scope| {
            for name in ["rival", "victim"] {
                let busy = || {
                    sched_setaffinity(None, &here).unwrap();
                    while !is_over.load(Ordering::Relaxed) {
                        std::hint::spin_loop();
                    }
                };
                let thread = std::thread::Builder::new().name(name.into());
                thread.spawn_scoped(scope, busy).unwrap();
            }
            let watch = StallWatch::start(MS / 2).unwrap();
            watch.watch('v', std::process::id(), Some("victim"));
            sleep(300 * MS);
            is_over.store(true, Ordering::Relaxed);
            watch.stop()
        });
        assert!(seen.iter().any(|stall| stall.who == Some('v')), "{seen:?}");
    }

    /// Two threads that use one processor between them wait for each other, and one that uses it
    /// alone waits for others.
    #[test]
    fn threads_that_share_a_processor_of_their_own_process_compete() {
        let thread = |ran: u32| Thread {
            order: 0,
            place: PathBuf::new(),
            count: File::open("/dev/null").unwrap(),
            times: [Duration::ZERO; 2],
            ran_lately: ran * MS,
        };
        let is_competing = |ran: &[u32]| {
            let order = Order {
                who: 'p',
                process: 0,
                thread: None,
            };
            let mut watched = [Watched {
                order,
                is_competing: false,
            }];
            let mut threads = Vec::from_iter(ran.iter().map(|ran| thread(*ran)));
            note_competition(&mut watched, &mut threads, 100 * MS);
            assert!(threads.iter().all(|thread| thread.ran_lately.is_zero()));
            watched[0].is_competing
        };
        assert!(is_competing(&[60, 40]) && is_competing(&[70, 70, 70]));
        assert!(!is_competing(&[99, 1]) && !is_competing(&[40, 40]) && !is_competing(&[]));
    }

    #[test]
    fn a_stall_that_began_before_the_last_one_ended_begins_with_the_first() {
        let mut seen = Vec::new();
        for (from, until) in [(5, 6), (2, 7), (9, 10)] {
            note(&mut seen, Some('a'), from * MS, until * MS);
        }
        assert_eq!(seen, [stall(Some('a'), 2, 7), stall(Some('a'), 9, 10)]);
    }

    #[test]
    fn the_threads_of_descendants_are_found() {
        let mut child = std::process::Command::new("sh")
            .args(["-c", "sleep 60 & wait"])
            .spawn()
            .unwrap();
        let watched = [Watched {
            order: Order {
                who: 'd',
                process: child.id(),
                thread: None,
            },
            is_competing: false,
        }];
        let mut threads = Vec::new();
        let own = format!("/proc/{0}/task/{0}", child.id());
        let is_listed = File::open(Path::new(&own).join("children")).is_ok();
        let counts = File::open(Path::new(&own).join("schedstat"));
        let is_counted = counts.is_ok_and(|count| spent_in_all(&count).is_some());
        while is_listed && is_counted && threads.len() < 2 {
            search(&watched, &mut threads);
        }
        let grandchildren = children(Path::new(&own));
        child.kill().unwrap();
        child.wait().unwrap();
        for process in grandchildren {
            let process = rustix::process::Pid::from_raw(process.cast_signed()).unwrap();
            rustix::process::kill_process(process, rustix::process::Signal::KILL).unwrap();
        }
    }

    #[test]
    fn a_thread_is_found_once_and_only_by_its_name() {
        if spent_in_all(&File::open("/proc/self/schedstat").unwrap()).is_none() {
            return;
        }
        let (hold, held) = std::sync::mpsc::channel::<()>();
        let thread = std::thread::Builder::new().name("sought".into());
        let (named, is_named) = std::sync::mpsc::channel();
        let sought = thread.spawn(move || {
            named.send(()).unwrap();
            held.recv().unwrap_err();
        });
        is_named.recv().unwrap();
        let watched = Watched {
            order: Order {
                who: 's',
                process: std::process::id(),
                thread: Some("sought"),
            },
            is_competing: false,
        };
        let mut threads = Vec::new();
        for _ in 0..2 {
            search(std::slice::from_ref(&watched), &mut threads);
            assert_eq!(threads.len(), 1);
        }
        drop(hold);
        sought.unwrap().join().unwrap();
    }
}
