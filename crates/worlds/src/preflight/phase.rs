//! Phases of a heating session on the bus: the load rests, the current rises, the quick stop switches it off.

use std::time::Duration;

use canopen::cia402::State;
use scenario::rig::drive::Feedback;

/// Number of samples in a row beyond the threshold that make a motion, so that a spike makes none.
const MOTION_SAMPLES: u32 = 3;

/// Phase of a session, with its observations and the remaining ones of the phases before.
#[derive(Debug)]
pub(super) enum Phase {
    /// The load rests without current.
    Rest {
        /// Span of the positions at rest; `None` before the first sample.
        rest: Option<Span>,
    },
    /// The current rises.
    Ramp { rest: Option<Span>, motion: Motion },
    /// The quick stop was sent.
    Stop {
        rest: Option<Span>,
        /// Motion in the ramp; `None` if the stop came before it.
        motion: Option<Motion>,
        quick_stop: QuickStop,
    },
}

impl Phase {
    /// Makes a session without a sample.
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

    /// Notes a quick stop; only the first counts.
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

    /// Returns whether any sample has come.
    pub(super) fn has_feedback(&self) -> bool {
        let is_stop_seen = self.quick_stop().is_some_and(|stop| stop.last.is_some());
        self.rest().is_some() || self.motion().is_some() || is_stop_seen
    }

    /// Returns the rest position of the load; `None` without a sample.
    pub(super) fn rest(&self) -> Option<Span> {
        match self {
            Self::Rest { rest } | Self::Ramp { rest, .. } | Self::Stop { rest, .. } => *rest,
        }
    }

    /// Returns the effect of the ramp on the load; `None` before the ramp.
    pub(super) fn motion(&self) -> Option<Motion> {
        match self {
            Self::Rest { .. } => None,
            Self::Ramp { motion, .. } => Some(*motion),
            Self::Stop { motion, .. } => *motion,
        }
    }

    /// Returns the observations after the quick stop; `None` before it.
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

/// Displacement of the load from its rest position, in the drive's unit, until it has moved.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    pub(super) displacement: f64,
    /// Command that caused the displacement.
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

/// Observations after the quick stop.
#[derive(Debug)]
pub(super) struct QuickStop {
    sent_at: Duration,
    /// Delay until the drive first showed that no current flows, and that it has left Operation enabled.
    pub(super) without_current_after: Option<Duration>,
    /// Latest feedback after the quick stop.
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

    /// Takes a sample; a current of at most `no_current_amperes` counts as none.
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

/// Reaction of the drive to NMT stop, independent of the phase in which it was sent.
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
    /// Notes NMT stop; only the first counts.
    pub(super) fn on_command(&mut self, now: Duration) {
        if let Self::NotSent = self {
            *self = Self::Sent { at: now };
        }
    }

    /// Notes a heartbeat of the drive with the state Stopped.
    pub(super) fn on_stopped_heartbeat(&mut self, now: Duration) {
        if let Self::Sent { at } = *self {
            let after = now.saturating_sub(at);
            *self = Self::Obeyed { after };
        }
    }
}
