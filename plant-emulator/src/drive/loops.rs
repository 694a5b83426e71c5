//! The position and velocity loops.
//!
//! In: the demand, the measured position and velocity, gains and limits. Out: a torque in permille of the rated torque. The
//! cascade in [`super::motion`] calls them once a step; they do not know modes.

use super::demand::Demand;

/// Gains of both loops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gains {
    pub(super) position_per_second: f64,
    /// Permille of the rated torque for one increment per second.
    pub(super) velocity: f64,
    /// Integral time of the velocity loop; 0 for none.
    pub(super) integral_seconds: f64,
}

impl Gains {
    /// Returns the velocity that corrects a position, with the demand's velocity as feed-forward.
    pub(super) fn velocity_command(&self, demand: &Demand, actual: f64) -> f64 {
        self.position_per_second * (demand.position - actual) + demand.velocity
    }
}

/// The velocity loop, a PI controller.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VelocityLoop {
    integral: f64,
}

impl VelocityLoop {
    /// Returns the torque within the limits. The integral stops where it would push further into a limit.
    pub(super) fn step(
        &mut self,
        error: f64,
        offset: f64,
        [min, max]: [f64; 2],
        gains: &Gains,
        seconds: f64,
    ) -> (f64, bool) {
        let proportional = gains.velocity * error;
        let growth = if gains.integral_seconds > 0.0 {
            proportional * seconds / gains.integral_seconds
        } else {
            0.0
        };
        let wanted = proportional + self.integral + growth + offset;
        let torque = wanted.clamp(min, max);
        if torque == wanted || (wanted - torque) * growth < 0.0 {
            self.integral += growth;
        }
        (torque, torque != wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Increments per second² that a permille of torque makes.
    const PLANT: f64 = 10_000.0;
    /// Crossover frequency of the velocity loop, rad/s.
    const CROSSOVER: f64 = 100.0;
    const STEP: f64 = 1e-5;
    const FREE: [f64; 2] = [-1e9, 1e9];

    fn gains(position_per_second: f64, integral_seconds: f64) -> Gains {
        Gains {
            position_per_second,
            velocity: CROSSOVER / PLANT,
            integral_seconds,
        }
    }

    /// Returns the velocities of a step to 1000 increments per second.
    fn velocity_step(gains: &Gains, limits: [f64; 2], load: f64) -> Vec<f64> {
        let (mut control, mut velocity) = (VelocityLoop::default(), 0.0);
        let steps = 0..100_000;
        let step = |_| {
            let error = 1000.0 - velocity;
            let (torque, _) = control.step(error, 0.0, limits, gains, STEP);
            velocity += (torque - load) * PLANT * STEP;
            velocity
        };
        steps.map(step).collect()
    }

    /// 13.5 % at 4/ωv: a double pole at ωv/2 and a zero at ωv/4, 1 + e⁻².
    #[test]
    fn a_velocity_step_overshoots_as_its_poles_say() {
        let velocities = velocity_step(&gains(0.0, 4.0 / CROSSOVER), FREE, 0.0);
        let highest = velocities.iter().copied().fold(0.0, f64::max);
        let expected = 1000.0 * (1.0 + libm::exp(-2.0));
        assert!((highest - expected).abs() < 1.0, "{highest}");
        let place = velocities.iter().position(|one| *one == highest).unwrap();
        let seconds = f64::from(u32::try_from(place).unwrap()) * STEP;
        assert!(
            (seconds - 4.0 / CROSSOVER).abs() < 0.02 / CROSSOVER,
            "{seconds}"
        );
        let last = velocities.last().unwrap();
        assert!((last - 1000.0).abs() < 1e-6, "{last}");
    }

    /// The integral takes over a constant load: no error is left.
    #[test]
    fn a_constant_load_leaves_no_error() {
        let with = velocity_step(&gains(0.0, 4.0 / CROSSOVER), FREE, 3.0);
        assert!((with.last().unwrap() - 1000.0).abs() < 1e-6);
        let without = velocity_step(&gains(0.0, 0.0), FREE, 3.0);
        let expected = 1000.0 - 3.0 * PLANT / CROSSOVER;
        assert!((without.last().unwrap() - expected).abs() < 1e-6);
    }

    #[test]
    fn the_integral_does_not_wind_up_in_a_limit() {
        let limits = [-2.0, 2.0];
        let velocities = velocity_step(&gains(0.0, 4.0 / CROSSOVER), limits, 0.0);
        let highest = velocities.iter().copied().fold(0.0, f64::max);
        assert!(
            highest < 1000.0 * (1.0 + libm::exp(-2.0)) + 1.0,
            "{highest}"
        );
        assert!((velocities.last().unwrap() - 1000.0).abs() < 1e-6);
    }

    /// Kv = ωv/4: no overshoot; Kv = ωv/2: e^−π, 4.3 %.
    #[test]
    fn a_position_step_overshoots_as_its_gain_says() {
        for (divisor, expected) in [(4.0, 0.0), (2.0, libm::exp(-std::f64::consts::PI))] {
            let gains = gains(CROSSOVER / divisor, 0.0);
            let demand = Demand {
                position: 1000.0,
                velocity: 0.0,
            };
            let (mut control, mut actual) = (VelocityLoop::default(), Demand::default());
            let mut highest = 0.0_f64;
            for _ in 0..100_000 {
                let command = gains.velocity_command(&demand, actual.position);
                let error = command - actual.velocity;
                let (torque, _) = control.step(error, 0.0, FREE, &gains, STEP);
                actual.velocity += torque * PLANT * STEP;
                actual.position += actual.velocity * STEP;
                highest = highest.max(actual.position);
            }
            let overshoot = (highest - 1000.0) / 1000.0;
            assert!(
                (overshoot - expected).abs() < 1e-3,
                "{divisor}: {overshoot}"
            );
        }
    }

    /// v/Kv + v/ωv·0: without feed-forward the error in a ramp is v/Kv, with it 0.
    #[test]
    fn feed_forward_takes_the_error_out_of_a_ramp() {
        let gains = gains(CROSSOVER / 4.0, 4.0 / CROSSOVER);
        for (feed_forward, expected) in [(0.0, 500.0 * 4.0 / CROSSOVER), (500.0, 0.0)] {
            let (mut control, mut actual) = (VelocityLoop::default(), Demand::default());
            let mut position = 0.0;
            for _ in 0..200_000 {
                position += 500.0 * STEP;
                let demand = Demand {
                    position,
                    velocity: feed_forward,
                };
                let command = gains.velocity_command(&demand, actual.position);
                let error = command - actual.velocity;
                let (torque, _) = control.step(error, 0.0, FREE, &gains, STEP);
                actual.velocity += torque * PLANT * STEP;
                actual.position += actual.velocity * STEP;
            }
            let error = position - actual.position;
            assert!((error - expected).abs() < 0.02, "{error}");
        }
    }
}
