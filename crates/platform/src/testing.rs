//! Small nodes for tests.

use std::collections::VecDeque;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};

/// Node that answers each frame 0x100 with 0x101 and the same data, and sends 0x200 with a counter every `period`.
pub(crate) struct Echo {
    pub(crate) period: Duration,
    pub(crate) deadline: Duration,
    pub(crate) ticks: u32,
    pub(crate) received: u32,
    /// Smallest lateness of a tick: zero if none came before its deadline.
    pub(crate) earliest_tick: Option<Duration>,
    pub(crate) stops_after: Duration,
    pub(crate) stop_at: Option<Duration>,
    pub(crate) progress: Progress,
    queue: VecDeque<CanFrame>,
}

impl Echo {
    pub(crate) fn new(period: Duration) -> Self {
        Self {
            period,
            deadline: Duration::ZERO,
            ticks: 0,
            received: 0,
            earliest_tick: None,
            stops_after: Duration::ZERO,
            stop_at: None,
            progress: Progress::Running,
            queue: VecDeque::with_capacity(64),
        }
    }
}

impl Node for Echo {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::exact(0x100), Filter::exact(0x1FF)]
    }

    fn on_frame(&mut self, _now: Duration, frame: &CanFrame) {
        self.received += 1;
        if frame.standard_id() == Some(0x1FF) {
            self.progress = Progress::Failed("the echo was ordered to fail".into());
            return;
        }
        self.queue.push_back(CanFrame::new(0x101, frame.data()));
    }

    fn on_tick(&mut self, now: Duration) {
        if self.stop_at.is_some_and(|at| now >= at) {
            self.progress = Progress::Stopped;
        }
        let early = self.deadline.saturating_sub(now);
        self.earliest_tick = self.earliest_tick.max(Some(early));
        self.ticks += 1;
        self.deadline += self.period;
        self.queue
            .push_back(CanFrame::new(0x200, &self.ticks.to_le_bytes()));
    }

    fn on_stop(&mut self, now: Duration) {
        self.queue.push_back(CanFrame::new(0x300, &[]));
        self.stop_at = Some(now + self.stops_after);
        if self.stops_after.is_zero() {
            self.progress = Progress::Stopped;
        }
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.queue.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        Some(self.deadline)
    }

    fn progress(&self) -> Progress {
        self.progress.clone()
    }
}
