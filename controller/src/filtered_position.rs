//! The position as the PID laws see it: the latest one that was measured, and a filter behind it for the derivative.

/// Positions are taken to lie within this, in metres or in the loop's own unit, so that results stay finite; beyond any rig.
const POSITION_MAX: f64 = 1e6;

/// In metres, or in the loop's own unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FilteredPosition {
    latest: f64,
    filtered: f64,
    started: bool,
}

impl FilteredPosition {
    /// Takes a measurement; the one before stays where it is no number.
    pub(crate) fn measure(&mut self, position: f64) {
        if position.is_finite() {
            self.latest = position.clamp(-POSITION_MAX, POSITION_MAX);
        }
        if !self.started {
            self.filtered = self.latest;
            self.started = true;
        }
    }

    pub(crate) fn latest(&self) -> f64 {
        self.latest
    }

    /// First-order filter of the position; gives how fast the filtered position moves, which of a ramp is its slope.
    pub(crate) fn velocity(&mut self, pole_radians_per_second: f64, period_seconds: f64) -> f64 {
        let share = 1.0 - libm::exp(-pole_radians_per_second * period_seconds);
        let step = share * (self.latest - self.filtered);
        self.filtered += step;
        step / period_seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_velocity_of_a_ramp_is_its_slope() {
        for (periods, period_seconds) in [(5000, 1e-4), (500, 1e-3), (50, 1e-2)] {
            let mut position = FilteredPosition::default();
            let mut velocity = 0.0;
            for period in 0..periods {
                position.latest = 0.1 * f64::from(period) * period_seconds;
                velocity = position.velocity(100.0, period_seconds);
            }
            assert!(
                (velocity - 0.1).abs() < 1e-9,
                "{period_seconds}: {velocity}"
            );
        }
    }
}
