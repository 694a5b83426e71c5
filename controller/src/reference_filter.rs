//! Critically damped third-order filter that derives derivatives from a bare set-point (PAPER E5).
//!
//! Its poles follow the move. They are slow at the start, so that the plant can follow, and faster towards the end,
//! where less braking is left. The launch never needs more than the model can do at full or at no current, and less if
//! the plant lags behind.

use scenario::reference::SetPoint;

/// Time in which the memory of a move fades.
const MEMORY_SECONDS: f64 = 0.5;

/// Time over which lags are averaged.
const LAG_SECONDS: f64 = 0.005;

/// Excesses over 1 of the divisors of the launch's jerk at full caution, and for a wire that remembers its turns.
const EXCESS_OF_CAUTION: f64 = 0.5;
const EXCESS_OF_MEMORY: f64 = 0.5;

/// Shortest move that counts, in metres.
const MOVE_METRES_MIN: f64 = 1e-6;

/// Ratio of two cubes that guarantees the order of their roots in spite of rounding.
const CERTAINTY: f64 = 1.0 + 1e-9;

/// A point of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Position.
    pub position_metres: f64,
    /// Velocity.
    pub velocity_metres_per_second: f64,
    /// Acceleration.
    pub acceleration_metres_per_second_squared: f64,
}

impl Point {
    /// Returns the point after a time at constant jerk.
    pub fn moved(&self, jerk: f64, seconds: f64) -> Self {
        let acceleration = self.acceleration_metres_per_second_squared;
        let velocity = self.velocity_metres_per_second;
        Self {
            position_metres: self.position_metres
                + (velocity + (acceleration + jerk * seconds / 3.0) * seconds / 2.0) * seconds,
            velocity_metres_per_second: velocity + (acceleration + jerk * seconds / 2.0) * seconds,
            acceleration_metres_per_second_squared: acceleration + jerk * seconds,
        }
    }
}

/// The filter `p³ / (s + p)³`.
#[derive(Clone, Copy, Debug)]
pub struct CriticallyDamped {
    /// `p`; the three poles lie at `-p`.
    pub poles_radians_per_second: f64,
}

impl CriticallyDamped {
    /// Returns `x⃛d = p³ (r − xd) − 3 p² x′d − 3 p x″d`.
    pub fn jerk(&self, point: &Point, target: f64) -> f64 {
        let p = self.poles_radians_per_second;
        p * p * p * (target - point.position_metres)
            - 3.0 * p * p * point.velocity_metres_per_second
            - 3.0 * p * point.acceleration_metres_per_second_squared
    }

    /// Returns the exact solution at a constant target: the error is `(a + b t + c t²) exp(−p t)`.
    pub fn advance(&self, point: &Point, target: f64, seconds: f64) -> Point {
        let p = self.poles_radians_per_second;
        let decay = libm::exp(-p * seconds);
        let a = point.position_metres - target;
        let b = point.velocity_metres_per_second + p * a;
        let c = (point.acceleration_metres_per_second_squared + 2.0 * p * b - p * p * a) / 2.0;
        let value = a + (b + c * seconds) * seconds;
        let slope = b + 2.0 * c * seconds;
        Point {
            position_metres: target + value * decay,
            velocity_metres_per_second: (slope - p * value) * decay,
            acceleration_metres_per_second_squared: (2.0 * c - 2.0 * p * slope + p * p * value)
                * decay,
        }
    }
}

/// Range of jerks that the plant can follow, in m/s³.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JerkRange {
    /// Smallest jerk.
    pub min: f64,
    /// Largest jerk.
    pub max: f64,
}

impl JerkRange {
    /// Any jerk.
    pub const UNLIMITED: Self = Self {
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
    };

    fn limit(&self, jerk: f64) -> f64 {
        jerk.max(self.min).min(self.max)
    }
}

/// The filter whose poles follow the move.
#[derive(Clone, Debug)]
pub struct ReferenceFilter {
    /// Fastest poles.
    pub poles_radians_per_second_max: f64,
    /// Wanted jerk at the start of a move; infinite for poles that never change.
    pub launch_jerk_metres_per_second_cubed: f64,
    /// Lag in m/s² above which the wanted jerk decreases.
    pub lag_max: f64,
    /// Ratio of the poles at the end of a move to those at its start.
    pub landing_ratio: f64,
    /// Largest set-point; the smallest is 0.
    pub position_metres_max: f64,
}

/// State of the filter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// The reference for this cycle.
    pub point: Point,
    move_metres: f64,
    /// Lag of the plant, in m/s²: now, and the largest of this move.
    lag: f64,
    greatest_lag: f64,
    /// Caution of the law, from 0 to 1.
    pub caution: f64,
    /// Share of a wire that remembers its turns, from 0 to 1.
    pub memory: f64,
}

/// The reference for a cycle: a point and the jerk that continues it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Position, velocity and acceleration.
    pub point: Point,
    /// Reference jerk.
    pub jerk_metres_per_second_cubed: f64,
}

impl Reference {
    /// Returns a point without a jerk.
    pub fn without_jerk(point: Point) -> Self {
        Self {
            point,
            jerk_metres_per_second_cubed: 0.0,
        }
    }
}

impl State {
    /// Updates the lag of the plant in the direction of the move, as its sliding variable in m/s².
    pub fn notice_lag(&mut self, lag: f64, seconds: f64) {
        self.lag += (lag - self.lag) * (seconds / LAG_SECONDS).min(1.0);
        self.greatest_lag = faded(self.greatest_lag, seconds).max(self.lag);
    }
}

impl ReferenceFilter {
    /// Returns a filter with poles that never change.
    pub fn fixed(poles_radians_per_second: f64, position_metres_max: f64) -> Self {
        Self {
            poles_radians_per_second_max: poles_radians_per_second,
            launch_jerk_metres_per_second_cubed: f64::INFINITY,
            lag_max: f64::INFINITY,
            landing_ratio: 1.0,
            position_metres_max,
        }
    }

    /// Returns the reference for this cycle and advances to the next. A set-point with exact derivatives bypasses the
    /// filter and is only advanced by one period.
    pub fn step(
        &self,
        state: &mut State,
        set_point: &SetPoint,
        followable: &JerkRange,
        seconds: f64,
    ) -> Reference {
        if is_exact(set_point) {
            state.point = brought_forward(set_point, seconds);
            return Reference {
                point: state.point,
                jerk_metres_per_second_cubed: set_point.jerk,
            };
        }
        let target = self.target(state, set_point);
        let filter = self.filter(state, target, seconds);
        let wanted = filter.jerk(&state.point, target);
        let reference = Reference {
            point: state.point,
            jerk_metres_per_second_cubed: followable.limit(wanted),
        };
        state.point = if followable.limit(wanted) == wanted {
            filter.advance(&state.point, target, seconds)
        } else {
            state.point.moved(followable.limit(wanted), seconds)
        };
        reference
    }

    /// Returns the target of the filter: the set-point within the limits, or the present position if there is none.
    pub fn target(&self, state: &State, set_point: &SetPoint) -> f64 {
        if set_point.position.is_finite() {
            set_point.position.clamp(0.0, self.position_metres_max)
        } else {
            state.point.position_metres
        }
    }

    /// Returns the filter for this cycle. At the start of a move of length `l` its poles are `p₀ = (J / l)^⅓`, so any
    /// move begins with the jerk `J`. Over the remaining distance `d` they rise to `ρ p₀ / √(1 + (ρ² − 1) (d / l)²)`. A
    /// plant that lags behind by more than `φ` differs from the model, and may brake as slowly. From there on `J` is
    /// divided by the ratio of the largest lag to `φ`. Caution, from a law that rings, divides it further, and so does a
    /// wire that remembers its turns, since it brakes less: right behind a turn cooling has little effect.
    fn filter(&self, state: &mut State, target: f64, seconds: f64) -> CriticallyDamped {
        let left = (target - state.point.position_metres).abs();
        let move_metres = faded(state.move_metres, seconds);
        state.move_metres = move_metres.max(left).max(MOVE_METRES_MIN);
        let share = left / state.move_metres;
        let rise = self.landing_ratio * self.landing_ratio - 1.0;
        let slowing = libm::sqrt(1.0 + rise * share * share);
        let lag_excess = (state.greatest_lag / self.lag_max).max(1.0);
        let of_caution = 1.0 + EXCESS_OF_CAUTION * state.caution;
        let of_memory = 1.0 + EXCESS_OF_MEMORY * state.memory * state.memory;
        let excess = lag_excess * of_caution * of_memory;
        let launch_cubed = self.launch_jerk_metres_per_second_cubed / (excess * state.move_metres);
        CriticallyDamped {
            poles_radians_per_second: self.poles(launch_cubed, slowing),
        }
    }

    /// Returns the poles within their limit, from the cube of those at the move's start.
    fn poles(&self, launch_cubed: f64, slowing: f64) -> f64 {
        let max = self.poles_radians_per_second_max;
        let launch_max = max * slowing / self.landing_ratio;
        // Near the target and in a hold the limit applies, and the root is not needed.
        if launch_cubed > CERTAINTY * launch_max * launch_max * launch_max {
            return max;
        }
        (self.landing_ratio * libm::cbrt(launch_cubed) / slowing).min(max)
    }
}

/// Returns the rest of a value that fades.
fn faded(value: f64, seconds: f64) -> f64 {
    value * (1.0 - (seconds / MEMORY_SECONDS).min(1.0))
}

fn is_exact(set_point: &SetPoint) -> bool {
    set_point.has_exact_derivatives
        && set_point.position.is_finite()
        && set_point.velocity.is_finite()
        && set_point.acceleration.is_finite()
        && set_point.jerk.is_finite()
}

fn brought_forward(set_point: &SetPoint, seconds: f64) -> Point {
    let now = Point {
        position_metres: set_point.position,
        velocity_metres_per_second: set_point.velocity,
        acceleration_metres_per_second_squared: set_point.acceleration,
    };
    now.moved(set_point.jerk, seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;

    fn hold(position: f64) -> SetPoint {
        SetPoint {
            position,
            ..SetPoint::default()
        }
    }

    #[test]
    fn fixed_poles_give_the_step_response_of_the_textbook() {
        let filter = ReferenceFilter::fixed(30.0, 0.05);
        let mut state = State::default();
        for cycle in 0..300 {
            let reference = filter.step(&mut state, &hold(0.025), &JerkRange::UNLIMITED, PERIOD);
            let y = 30.0 * f64::from(cycle) * PERIOD;
            let decay = libm::exp(-y);
            let position = 0.025 * (1.0 - decay * (1.0 + y + y * y / 2.0));
            let velocity = 0.025 * decay * y * y / 2.0 * 30.0;
            assert!((reference.point.position_metres - position).abs() < 1e-12);
            assert!((reference.point.velocity_metres_per_second - velocity).abs() < 1e-11);
        }
    }

    #[test]
    fn one_long_period_equals_many_short_ones() {
        let filter = CriticallyDamped {
            poles_radians_per_second: 40.0,
        };
        let start = Point {
            position_metres: 0.01,
            velocity_metres_per_second: -0.1,
            acceleration_metres_per_second_squared: 2.0,
        };
        let long = filter.advance(&start, 0.03, 0.05);
        let short = (0..50).fold(start, |point, _| filter.advance(&point, 0.03, 0.001));
        assert!((long.position_metres - short.position_metres).abs() < 1e-14);
        assert!(
            (long.acceleration_metres_per_second_squared
                - short.acceleration_metres_per_second_squared)
                .abs()
                < 1e-10
        );
    }

    fn moving_filter() -> ReferenceFilter {
        ReferenceFilter {
            poles_radians_per_second_max: 60.0,
            launch_jerk_metres_per_second_cubed: 450.0,
            lag_max: 1.6,
            landing_ratio: 2.5,
            position_metres_max: 0.05,
        }
    }

    #[test]
    fn a_move_of_any_length_asks_for_the_same_jerk_first_and_never_overshoots() {
        let filter = moving_filter();
        for length in [0.005, 0.01, 0.025, 0.045] {
            let mut state = State::default();
            let mut positions = Vec::new();
            for cycle in 0..1000 {
                let reference =
                    filter.step(&mut state, &hold(length), &JerkRange::UNLIMITED, PERIOD);
                if cycle == 0 {
                    assert!((reference.jerk_metres_per_second_cubed - 450.0).abs() < 1e-6);
                }
                positions.push(reference.point.position_metres);
            }
            assert!(
                positions.iter().all(|&position| position < length * 1.001),
                "{length}"
            );
            assert!((positions[999] - length).abs() < 1e-6, "{length}");
        }
    }

    #[test]
    fn the_jerk_stays_within_what_the_plant_can_follow() {
        let filter = moving_filter();
        let followable = JerkRange {
            min: f64::NEG_INFINITY,
            max: 100.0,
        };
        let mut state = State::default();
        let reference = filter.step(&mut state, &hold(0.025), &followable, PERIOD);
        assert_eq!(reference.jerk_metres_per_second_cubed, 100.0);
        assert!((state.point.acceleration_metres_per_second_squared - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_jerk_is_less_where_the_plant_lags_behind() {
        let filter = moving_filter();
        let jerk_after = |lag: f64| {
            let mut state = State::default();
            for _ in 0..100 {
                state.notice_lag(lag, PERIOD);
            }
            let reference = filter.step(&mut state, &hold(0.025), &JerkRange::UNLIMITED, PERIOD);
            reference.jerk_metres_per_second_cubed
        };
        let unhindered = jerk_after(0.0);
        assert!((unhindered - 450.0).abs() < 1e-6);
        assert_eq!(jerk_after(1.5), unhindered);
        assert_eq!(jerk_after(-10.0), unhindered);
        assert!((jerk_after(3.2) - 225.0).abs() < 1e-3);
    }

    #[test]
    fn the_jerk_is_less_where_the_law_backs_off() {
        let mut state = State {
            caution: 1.0,
            ..State::default()
        };
        let reference =
            moving_filter().step(&mut state, &hold(0.025), &JerkRange::UNLIMITED, PERIOD);
        assert!((reference.jerk_metres_per_second_cubed - 300.0).abs() < 1e-6);
    }

    #[test]
    fn a_sine_bypasses_and_comes_one_period_early() {
        let omega = 10.0;
        let sine = |time: f64| SetPoint {
            position: 0.025 + 0.01 * libm::sin(omega * time),
            velocity: 0.01 * omega * libm::cos(omega * time),
            acceleration: -0.01 * omega * omega * libm::sin(omega * time),
            jerk: -0.01 * omega * omega * omega * libm::cos(omega * time),
            has_exact_derivatives: true,
        };
        let mut state = State::default();
        let reference = moving_filter().step(&mut state, &sine(0.3), &JerkRange::UNLIMITED, PERIOD);
        let next = sine(0.3 + PERIOD);
        assert!((reference.point.position_metres - next.position).abs() < 1e-11);
        let velocity = reference.point.velocity_metres_per_second;
        assert!((velocity - next.velocity).abs() < 1e-8);
    }

    #[test]
    fn infeasible_and_meaningless_set_points_are_kept_out() {
        let filter = moving_filter();
        let mut state = State::default();
        state.point.position_metres = 0.02;
        assert_eq!(filter.target(&state, &hold(0.2)), 0.05);
        assert_eq!(filter.target(&state, &hold(-0.2)), 0.0);
        assert_eq!(filter.target(&state, &hold(f64::NAN)), 0.02);
    }
}
