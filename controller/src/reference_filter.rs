//! Critically damped third-order filter that gives a bare set-point its derivatives (PAPER E5).

use scenario::reference::SetPoint;

/// The filter; its three poles lie at `-poles_radians_per_second`.
#[derive(Clone, Debug)]
pub struct ReferenceFilter {
    /// `p`, poles of `p³ / (s + p)³`.
    pub poles_radians_per_second: f64,
    /// Set-points are limited to 0 and this position.
    pub position_metres_max: f64,
}

/// A point of the reference trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Reference position.
    pub position_metres: f64,
    /// Reference velocity.
    pub velocity_metres_per_second: f64,
    /// Reference acceleration.
    pub acceleration_metres_per_second_squared: f64,
}

/// The reference for this cycle: a trajectory point and the jerk that leads on from it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Position, velocity and acceleration.
    pub state: State,
    /// Reference jerk.
    pub jerk_metres_per_second_cubed: f64,
}

impl ReferenceFilter {
    /// Moves the reference on by one period and gives it with its jerk. A set-point with exact derivatives bypasses the
    /// filter and is only brought to the end of the period.
    pub fn step(&self, state: &mut State, set_point: &SetPoint, seconds: f64) -> Reference {
        if set_point.has_exact_derivatives {
            return bypass(state, set_point, seconds);
        }
        let target = set_point
            .position_metres
            .clamp(0.0, self.position_metres_max);
        *state = self.advance(state, target, seconds);
        Reference {
            state: *state,
            jerk_metres_per_second_cubed: self.jerk(state, target),
        }
    }

    /// `x⃛d = p³ (r − xd) − 3 p² x′d − 3 p x″d`.
    fn jerk(&self, state: &State, target: f64) -> f64 {
        let p = self.poles_radians_per_second;
        p * p * p * (target - state.position_metres)
            - 3.0 * p * p * state.velocity_metres_per_second
            - 3.0 * p * state.acceleration_metres_per_second_squared
    }

    /// Exact solution at a constant target: the error is `(a + b t + c t²) exp(−p t)`.
    pub(crate) fn advance(&self, state: &State, target: f64, seconds: f64) -> State {
        let p = self.poles_radians_per_second;
        let decay = libm::exp(-p * seconds);
        let a = state.position_metres - target;
        let b = state.velocity_metres_per_second + p * a;
        let c = (state.acceleration_metres_per_second_squared + 2.0 * p * b - p * p * a) / 2.0;
        let value = a + (b + c * seconds) * seconds;
        let slope = b + 2.0 * c * seconds;
        State {
            position_metres: target + value * decay,
            velocity_metres_per_second: (slope - p * value) * decay,
            acceleration_metres_per_second_squared: (2.0 * c - 2.0 * p * slope + p * p * value)
                * decay,
        }
    }
}

fn bypass(state: &mut State, set_point: &SetPoint, seconds: f64) -> Reference {
    let jerk = set_point.jerk_metres_per_second_cubed;
    let acceleration = set_point.acceleration_metres_per_second_squared;
    let velocity = set_point.velocity_metres_per_second;
    *state = State {
        position_metres: set_point.position_metres
            + (velocity + (acceleration + jerk * seconds / 3.0) * seconds / 2.0) * seconds,
        velocity_metres_per_second: velocity + (acceleration + jerk * seconds / 2.0) * seconds,
        acceleration_metres_per_second_squared: acceleration + jerk * seconds,
    };
    Reference {
        state: *state,
        jerk_metres_per_second_cubed: jerk,
    }
}
