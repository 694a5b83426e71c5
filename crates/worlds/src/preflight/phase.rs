//! What the bus shows of a heating session, phase by phase: the load rests, the current rises, the quick stop takes it away.

use std::time::Duration;

use canopen::cia402::State;
use scenario::rig::drive::Feedback;

/// Motion is a displacement beyond the threshold in so many samples in a row, so that a spike is none.
const MOTION_SAMPLES: u32 = 3;

/// Where a session is, with what that phase has shown, and what is left of the phases before it.
#[derive(Debug)]
pub(super) enum Phase {
    /// The load rests without current.
    Rest {
        /// None before the first sample.
        rest: Option<Span>,
    },
    /// The current rises.
    Ramp { rest: Option<Span>, motion: Motion },
    /// The quick stop was sent.
    Stop {
        rest: Option<Span>,
        /// None if the stop came before the ramp.
        motion: Option<Motion>,
        quick_stop: QuickStop,
    },
}

impl Phase {
    /// A session without a sample.
    pub(super) fn new() -> Self {
        Self::Rest { rest: None }
    }

    /// Takes a position at rest.
    pub(super) fn on_rest_sample(&mut self, position: f64) {
        if let Self::Rest { rest } = self {
            *rest = Some(Span::including(*rest, position));
        }
    }

    /// Takes a position under a commanded current; the first one ends the rest.
    pub(super) fn on_ramp_sample(&mut self, position: f64, amperes: f64, threshold: f64) {
        if let Self::Rest { rest } = self {
            let (rest, motion) = (*rest, Motion::default());
            *self = Self::Ramp { rest, motion };
        }
        if let Self::Ramp {
            rest: Some(rest),
            motion,
        } = self
        {
            motion.on_sample(position - rest.middle(), amperes, threshold);
        }
    }

    /// The quick stop was sent; only the first counts.
    pub(super) fn on_quick_stop(&mut self, now: Duration) {
        let motion = match self {
            Self::Rest { .. } => None,
            Self::Ramp { motion, .. } => Some(*motion),
            Self::Stop { .. } => return,
        };
        *self = Self::Stop {
            rest: self.rest(),
            motion,
            quick_stop: QuickStop::new(now),
        };
    }

    /// Whether any sample has come.
    pub(super) fn has_feedback(&self) -> bool {
        let is_stop_seen = self.quick_stop().is_some_and(|stop| stop.last.is_some());
        self.rest().is_some() || self.motion().is_some() || is_stop_seen
    }

    /// Where the load rested; none without a sample.
    pub(super) fn rest(&self) -> Option<Span> {
        match self {
            Self::Rest { rest } | Self::Ramp { rest, .. } | Self::Stop { rest, .. } => *rest,
        }
    }

    /// What the ramp has done to the load; none until the rest is over.
    pub(super) fn motion(&self) -> Option<Motion> {
        match self {
            Self::Rest { .. } => None,
            Self::Ramp { motion, .. } => Some(*motion),
            Self::Stop { motion, .. } => *motion,
        }
    }

    /// What followed the quick stop; none until it was sent.
    pub(super) fn quick_stop(&self) -> Option<&QuickStop> {
        match self {
            Self::Stop { quick_stop, .. } => Some(quick_stop),
            _ => None,
        }
    }
}

/// Lowest and highest position of the load, in the drive's unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Span {
    fn including(span: Option<Self>, position: f64) -> Self {
        let (low, high) = span.map_or((position, position), |span| (span.low, span.high));
        Self {
            low: low.min(position),
            high: high.max(position),
        }
    }

    fn middle(&self) -> f64 {
        (self.low + self.high) / 2.0
    }
}

/// How far the load is from where it rested, in the drive's unit, until it has moved.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    pub(super) displacement: f64,
    /// The command under which the displacement came about.
    pub(super) amperes: f64,
    samples_beyond: u32,
}

impl Motion {
    fn on_sample(&mut self, displacement: f64, amperes: f64, threshold: f64) {
        if self.has_moved() {
            return;
        }
        let is_beyond = displacement.abs() >= threshold;
        *self = Self {
            displacement,
            amperes,
            samples_beyond: if is_beyond {
                self.samples_beyond + 1
            } else {
                0
            },
        };
    }

    pub(super) fn has_moved(&self) -> bool {
        self.samples_beyond >= MOTION_SAMPLES
    }
}

/// What followed the quick stop.
#[derive(Debug)]
pub(super) struct QuickStop {
    sent_at: Duration,
    /// How long after it the drive first showed that no current flows, and that it has left Operation enabled.
    pub(super) without_current_after: Option<Duration>,
    /// The last sample after it.
    pub(super) last: Option<Feedback>,
}

impl QuickStop {
    fn new(sent_at: Duration) -> Self {
        Self {
            sent_at,
            without_current_after: None,
            last: None,
        }
    }

    /// Takes a sample; a current of at most `no_current_amperes` is none.
    pub(super) fn on_sample(
        &mut self,
        now: Duration,
        feedback: &Feedback,
        no_current_amperes: f64,
    ) {
        self.last = Some(*feedback);
        let state = State::from_statusword(feedback.statusword);
        let is_enabled = state == Some(State::OperationEnabled);
        let current = feedback.current_amperes;
        let flows = current.is_some_and(|amperes| amperes.abs() > no_current_amperes);
        if !is_enabled && !flows {
            let after = now.saturating_sub(self.sent_at);
            self.without_current_after.get_or_insert(after);
        }
    }
}

/// Whether the drive obeys NMT stop, in whatever phase it was sent.
#[derive(Clone, Copy, Debug)]
pub(super) enum NmtStop {
    NotSent,
    Sent {
        at: Duration,
    },
    /// A heartbeat has the state Stopped.
    Obeyed {
        after: Duration,
    },
}

impl NmtStop {
    /// It was sent; only the first counts.
    pub(super) fn on_command(&mut self, now: Duration) {
        if let Self::NotSent = self {
            *self = Self::Sent { at: now };
        }
    }

    /// A heartbeat of the drive has the state Stopped.
    pub(super) fn on_stopped_heartbeat(&mut self, now: Duration) {
        if let Self::Sent { at } = *self {
            let after = now.saturating_sub(at);
            *self = Self::Obeyed { after };
        }
    }
}
