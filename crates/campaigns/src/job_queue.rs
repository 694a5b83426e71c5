//! Jobs for several threads, whose results are handed on in the order of the jobs.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use recording::capture::Watch;

/// How soon a thread that waits for an earlier run sees that the user stopped it.
const STOP_PERIOD: Duration = Duration::from_millis(100);

/// Where threads get jobs and bring results.
pub(crate) struct JobQueue<I, J, R, F, E> {
    state: Mutex<QueueState<I, J, R, F, E>>,
    has_room: Condvar,
    waiting_max: usize,
}

/// Jobs still to be done, and results whose turn has not come.
struct QueueState<I, J, R, F, E> {
    jobs: I,
    /// Jobs that threads have got.
    given: usize,
    /// Results that were handed on, in the order of their jobs.
    taken: usize,
    waiting: BTreeMap<usize, (J, R)>,
    on_result: F,
    refusal: Option<E>,
}

impl<I, J, R, F, E> QueueState<I, J, R, F, E> {
    fn new(jobs: I, on_result: F) -> Self {
        Self {
            jobs,
            given: 0,
            taken: 0,
            waiting: BTreeMap::new(),
            on_result,
            refusal: None,
        }
    }
}

impl<I, J, R, F, E> JobQueue<I, J, R, F, E>
where
    I: Iterator<Item = J>,
    F: FnMut(J, R) -> Result<(), E>,
{
    /// A queue that hands results to `on_result` in the order of the jobs. At most `waiting_max` results wait for their turn.
    pub(crate) fn new(jobs: I, on_result: F, waiting_max: usize) -> Self {
        Self {
            state: Mutex::new(QueueState::new(jobs, on_result)),
            has_room: Condvar::new(),
            waiting_max,
        }
    }

    /// How many results were handed on.
    pub(crate) fn taken(&self) -> usize {
        self.lock().taken
    }

    /// Why a result was refused, if one was.
    pub(crate) fn refusal(&self) -> Option<E> {
        self.lock().refusal.take()
    }

    fn lock(&self) -> MutexGuard<'_, QueueState<I, J, R, F, E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next job, once the results are not too far ahead of their turn.
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

    /// Hands on a result when its turn comes, and those that waited for it.
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
