//! Observations of a heating session on the bus: the load rests, the current rises, the quick stop switches it off.

use std::time::Duration;

use canopen::cia402::State;
use scenario::rig::drive::Feedback;

/// Number of samples in a row beyond the threshold that make a motion, so that a spike makes none.
const MOTION_SAMPLES: u32 = 3;

/// Lowest and highest position of the load, in the drive's unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Span {
    pub(super) fn including(span: Option<Self>, position: f64) -> Self {
        let (low, high) = span.map_or((position, position), |span| (span.low, span.high));
        Self {
            low: low.min(position),
            high: high.max(position),
        }
    }

    pub(super) fn middle(&self) -> f64 {
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
    pub(super) fn on_sample(&mut self, displacement: f64, amperes: f64, threshold: f64) {
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
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct QuickStop {
    pub(super) sent_at: Duration,
    /// Delay until the drive first showed that no current flows, and that it has left Operation enabled.
    pub(super) without_current_after: Option<Duration>,
    /// Latest feedback after the quick stop.
    pub(super) last: Option<Feedback>,
}

impl QuickStop {
    /// Takes a sample; a current of at most `idle_output_max` counts as none.
    pub(super) fn on_sample(&mut self, now: Duration, feedback: &Feedback, idle_output_max: f64) {
        self.last = Some(*feedback);
        let state = State::from_statusword(feedback.statusword);
        let is_enabled = state == Some(State::OperationEnabled);
        let current = feedback.output;
        let flows = current.is_some_and(|amperes| amperes.abs() > idle_output_max);
        if !is_enabled && !flows {
            let after = now.saturating_sub(self.sent_at);
            self.without_current_after.get_or_insert(after);
        }
    }
}
