//! The position for the PID laws: the latest measurement, and a filter of it for the derivative.

/// Limit of the position, in metres or in the loop's own unit; it keeps results finite and is beyond any rig.
const POSITION_MAX: f64 = 1e6;

/// Measured and filtered position, in metres or in the loop's own unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FilteredPosition {
    latest: f64,
    filtered: f64,
    started: bool,
}

impl FilteredPosition {
    /// Takes a measurement. If it is no number, the previous one stays.
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

    /// Filters the position to first order, and returns the velocity of the filtered position. For a ramp it is the
    /// slope.
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
