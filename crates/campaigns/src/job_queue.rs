//! Jobs for several threads, with results in the order of the jobs.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use recording::capture::Watch;

/// Longest time until a thread that waits for an earlier run notices that the user stopped the campaign.
const STOP_PERIOD: Duration = Duration::from_millis(100);

/// Queue from which threads take jobs, and to which they bring results.
pub(crate) struct JobQueue<I, J, R, F, E> {
    state: Mutex<QueueState<I, J, R, F, E>>,
    has_room: Condvar,
    waiting_max: usize,
}

/// Jobs still to be done, and results that wait for their turn.
struct QueueState<I, J, R, F, E> {
    jobs: I,
    /// Number of jobs that threads have taken.
    given: usize,
    /// Number of results that were handed on, in the order of their jobs.
    taken: usize,
    waiting: BTreeMap<usize, (J, R)>,
    on_result: F,
    refusal: Option<E>,
}

impl<I, J, R, F, E> JobQueue<I, J, R, F, E>
where
    I: Iterator<Item = J>,
    F: FnMut(J, R) -> Result<(), E>,
{
    /// Makes a queue that hands results to `on_result` in the order of the jobs. At most `waiting_max` results wait for their
    /// turn.
    pub(crate) fn new(jobs: I, on_result: F, waiting_max: usize) -> Self {
        let state = QueueState {
            jobs,
            given: 0,
            taken: 0,
            waiting: BTreeMap::new(),
            on_result,
            refusal: None,
        };
        Self {
            state: Mutex::new(state),
            has_room: Condvar::new(),
            waiting_max,
        }
    }

    /// Returns the number of results that were handed on.
    pub(crate) fn taken(&self) -> usize {
        self.lock().taken
    }

    /// Returns the reason why a result was refused, if one was.
    pub(crate) fn refusal(&self) -> Option<E> {
        self.lock().refusal.take()
    }

    fn lock(&self) -> MutexGuard<'_, QueueState<I, J, R, F, E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the next job, once the results are not too far ahead of their turn.
    pub(crate) fn next(&self, watch: &Watch) -> Option<(usize, J)> {
        let mut state = self.lock();
        while state.given >= state.taken + self.waiting_max
            && state.refusal.is_none()
            && !watch.is_interrupted()
        {
            let waited = self.has_room.wait_timeout(state, STOP_PERIOD);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        if state.refusal.is_some() || watch.is_interrupted() {
            return None;
        }
        let job = state.jobs.next()?;
        state.given += 1;
        Some((state.given - 1, job))
    }

    /// Takes a result, and hands on all results whose turn has come.
    pub(crate) fn put(&self, place: usize, job: J, done: R) {
        let state = &mut *self.lock();
        state.waiting.insert(place, (job, done));
        while state.refusal.is_none()
            && let Some((job, done)) = state.waiting.remove(&state.taken)
        {
            state.refusal = (state.on_result)(job, done).err();
            state.taken += 1;
        }
        self.has_room.notify_all();
    }
}
