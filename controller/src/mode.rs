//! Move and hold: the two modes of the sliding-mode law, and the switch between them.
//!
//! In a move the law is fast, and its observer trusts the position more than the model, since a plant that differs from
//! the model does so in motion. In a hold both would only respond to the steps of the position sensor: a limit cycle
//! with a busy current. There the observer trusts the model, and the law becomes calm.
//!
//! The reference rests while its velocity is `|v| ≤ q / 0.1 s`, with a step `q` of the sensor. With `ρ′ = 1 / 0.2 s`
//! and `κ′ = 1 / T` two shares then rise from 0 to 1. The rest `ρ` takes the observer's drifts to their values for a
//! hold, the calmness `κ` does the same with `λ`. Both are 0 while the reference moves. Let `e` be the measured
//! distance from the reference, averaged over 4 ms. The calmness also falls back to 0
//!
//! - while the load is far away, `|e| > 10 q`, and
//! - when it leaves a calm law: `κ = 1`, and `|e| > n q`.
//!
//! Between these limits a law on its way to calmness is not roused again: a plant that rings under a fast law comes to
//! rest under a calm one.
//!
//! A law that rings backs off. The sliding variable `s` swings when it turns back by more than `9/10 φ`. Each swing
//! adds 1/10 to the ringing, which decays slowly. Two swings after each turn of the reference are free, because the
//! turn itself causes them if the plant cannot follow it. No swing counts for 0.3 s after a jump of the sensor in a
//! calm hold, which no current can cause. The ringing beyond the swings of a sound move is the caution `β` from
//! 0 to 1. With it `λ` is `λm^(1 − β) λβ^β` at most, also in a move. The observer returns to its drifts of a move, since the
//! model that it trusts in a hold is not the plant. Law and observer assume a wire that is `2^β` times as lively as the
//! model's. Moves are launched with the `1 + β / 2`-th part of the jerk.
//!
//! A setting is `p = pm^(1 − κ) ph^κ` between its value `pm` in a move and `ph` in a hold; the observer's settings have
//! `ρ` in place of `κ`.

use scenario::controller::SlidingMode as Config;

/// Time over which distances from the reference are averaged.
const WINDOW_SECONDS: f64 = 0.004;

/// Time for one step of the sensor from which a reference counts as resting.
const REST_SECONDS: f64 = 0.1;

/// Time until the observer trusts the model.
const TRUSTING_SECONDS: f64 = 0.2;

/// Distance of the load, in steps of the sensor, beyond which the law stays awake.
const FAR_SENSOR_STEPS: f64 = 10.0;

/// Smallest return of the sliding variable in a swing, relative to the boundary layer.
const SWING_SHARE: f64 = 0.9;

/// Swings that a turn of the reference causes.
const SWINGS_OF_A_TURN: u8 = 2;

/// Contribution of a swing to the ringing, and the time in which the ringing fades from 1. The time is longer than that
/// between two moves, so a move benefits from the caution of the previous one.
const RINGING_PER_SWING: f64 = 0.1;
const RINGING_SECONDS: f64 = 12.0;

/// Time after a jump of the sensor, in a calm hold, for which swings are attributed to it.
const DEAF_SECONDS: f64 = 0.3;

/// Ringing without caution: that of a launch and a landing.
const RINGING_OF_A_MOVE: f64 = 0.4;

/// Liveliness of the wire relative to the model at full caution.
const CAUTIOUS_LIVELINESS: f64 = 2.0;

/// `λβ`, bandwidth at full caution in 1/s.
const CAUTIOUS_BANDWIDTH: f64 = 20.0;

/// Settings that depend on the mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// `λ` in 1/s.
    pub bandwidth: f64,
    /// Standard deviation that the martensite fraction gains in one second beyond the model.
    pub fraction_drift: f64,
    /// Standard deviation that the unknown heating gains in one second, in K/s.
    pub heating_drift: f64,
    /// Whether the observer trusts the model: `ρ` is 1.
    pub trusts_model: bool,
    /// `β`: the caution, from 0 to 1.
    pub caution: f64,
    /// Rate of the wire's transformation with temperature, relative to the model.
    pub liveliness: f64,
}

/// Geometric interpolation from a value at share 0 to one at share 1: equal factors for equal shares.
#[derive(Clone, Copy, Debug)]
struct Between {
    first: f64,
    last: f64,
    /// Logarithms to base 2.
    log2_first: f64,
    log2_ratio: f64,
}

impl Between {
    fn new(first: f64, last: f64) -> Self {
        let [from, to] = [first, last].map(libm::log2);
        // If one of the ends is 0, every value between them is 0.
        let is_positive = first > 0.0 && last > 0.0;
        Self {
            first,
            last,
            log2_first: if is_positive { from } else { f64::NEG_INFINITY },
            log2_ratio: if is_positive { to - from } else { 0.0 },
        }
    }

    fn at(&self, share: f64) -> f64 {
        // Most cycles are at one end and need no power.
        if share <= 0.0 {
            self.first
        } else if share >= 1.0 {
            self.last
        } else {
            libm::exp2(self.log2_first + share * self.log2_ratio)
        }
    }
}

/// The modes and the criteria for a switch.
#[derive(Clone, Copy, Debug)]
pub struct Modes {
    /// Values from a move to a hold.
    bandwidth: Between,
    fraction_drift: Between,
    heating_drift: Between,
    /// Values from no caution to full caution.
    cautious_bandwidth: Between,
    liveliness: Between,
    calming_seconds: f64,
    calm_error_metres_max: f64,
    error_metres_max: f64,
    velocity_at_rest_max: f64,
    swing_min: f64,
}

/// Inputs of the choice of a mode.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    /// Distance from the reference to the measured position; not finite without a position.
    pub error_metres: f64,
    /// Velocity of the reference.
    pub velocity_metres_per_second: f64,
    /// `s` in m/s², from the previous cycle.
    pub sliding_variable: f64,
    /// Whether the position jumped further than a load under any current.
    pub sensor_jumps: bool,
}

/// State of the modes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// `ρ`.
    rest: f64,
    /// `κ`.
    calmness: f64,
    /// Ringing, from 0 to 1 plus that of a move.
    ringing: f64,
    /// Whether `s` falls, and its extreme value since its last turn.
    is_falling: bool,
    extreme: f64,
    /// Last direction of the reference: 1, -1, or 0 for none; and the remaining free swings of its turn.
    direction: f64,
    free_swings: u8,
    /// Remaining time for which swings are attributed to a jump of the sensor.
    deaf_seconds: f64,
    /// `e`.
    error_metres: f64,
}

impl Modes {
    /// Computes the constants.
    pub fn new(config: &Config) -> Self {
        let sensor_step_metres = config.observer.sensor_step_millimetres * 1e-3;
        let (observer, hold) = (&config.observer, &config.hold);
        let bandwidth = config.bandwidth_radians_per_second;
        Self {
            bandwidth: Between::new(bandwidth, hold.bandwidth_radians_per_second),
            fraction_drift: Between::new(observer.fraction_drift, hold.fraction_drift),
            heating_drift: Between::new(
                observer.heating_drift_kelvins_per_second,
                hold.heating_drift_kelvins_per_second,
            ),
            cautious_bandwidth: Between::new(bandwidth, CAUTIOUS_BANDWIDTH),
            liveliness: Between::new(1.0, CAUTIOUS_LIVELINESS),
            calming_seconds: config.hold.calming_seconds,
            calm_error_metres_max: config.hold.error_sensor_steps_max * sensor_step_metres,
            error_metres_max: FAR_SENSOR_STEPS * sensor_step_metres,
            velocity_at_rest_max: sensor_step_metres / REST_SECONDS,
            swing_min: SWING_SHARE * config.boundary_layer_metres_per_second_squared,
        }
    }

    /// Returns the settings for this cycle.
    pub fn step(&self, state: &mut State, course: &Course, seconds: f64) -> Settings {
        if course.error_metres.is_finite() {
            let share = (seconds / WINDOW_SECONDS).min(1.0);
            state.error_metres += (course.error_metres - state.error_metres) * share;
        }
        self.listen(state, course, seconds);
        let is_moving = course.velocity_metres_per_second.abs() > self.velocity_at_rest_max;
        let risen = |share: f64, rise_seconds: f64| (share + seconds / rise_seconds).min(1.0);
        state.rest = if is_moving {
            0.0
        } else {
            risen(state.rest, TRUSTING_SECONDS)
        };
        state.calmness = if is_moving || self.rouses(state) {
            0.0
        } else {
            risen(state.calmness, self.calming_seconds)
        };
        self.settings(state)
    }

    /// Finds swings of the sliding variable. It need not pass 0: a plant that differs from the model may ring to one
    /// side of the surface.
    fn listen(&self, state: &mut State, course: &Course, seconds: f64) {
        state.ringing = (state.ringing - seconds / RINGING_SECONDS).max(0.0);
        // A law that is not calm may ring, on a wire that throws its load or with a noisy sensor.
        state.deaf_seconds = if course.sensor_jumps && state.calmness >= 1.0 {
            DEAF_SECONDS
        } else {
            (state.deaf_seconds - seconds).max(0.0)
        };
        let velocity = course.velocity_metres_per_second;
        if velocity * state.direction < 0.0 {
            state.free_swings = SWINGS_OF_A_TURN;
        }
        if velocity != 0.0 {
            state.direction = velocity.signum();
        }
        let sliding_variable = course.sliding_variable;
        state.extreme = if state.is_falling {
            state.extreme.min(sliding_variable)
        } else {
            state.extreme.max(sliding_variable)
        };
        if (sliding_variable - state.extreme).abs() <= self.swing_min {
            return;
        }
        state.is_falling = !state.is_falling;
        state.extreme = sliding_variable;
        if state.free_swings > 0 {
            state.free_swings -= 1;
        } else if state.deaf_seconds <= 0.0 {
            state.ringing = (state.ringing + RINGING_PER_SWING).min(1.0 + RINGING_OF_A_MOVE);
        }
    }

    /// Returns whether the load is so far away that it wakes the law.
    fn rouses(&self, state: &State) -> bool {
        let error_metres_max = if state.calmness >= 1.0 {
            self.calm_error_metres_max
        } else {
            self.error_metres_max
        };
        state.error_metres.abs() > error_metres_max
    }

    fn settings(&self, state: &State) -> Settings {
        let caution = (state.ringing - RINGING_OF_A_MOVE).max(0.0);
        let rest = state.rest.min(1.0 - caution);
        let calm = self.bandwidth.at(state.calmness);
        Settings {
            bandwidth: calm.min(self.cautious_bandwidth.at(caution)),
            fraction_drift: self.fraction_drift.at(rest),
            heating_drift: self.heating_drift.at(rest),
            trusts_model: rest >= 1.0,
            caution,
            // The law commands less, and does not treat the effects as a disturbance.
            liveliness: self.liveliness.at(caution),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{in_hold, in_move};

    const PERIOD: f64 = 1e-3;
    const STEP_METRES: f64 = 0.06 / 1024.0;

    fn modes() -> Modes {
        Modes::new(&Config::default())
    }

    fn at_rest(error_metres: f64) -> Course {
        Course {
            error_metres,
            velocity_metres_per_second: 0.0,
            sliding_variable: 0.0,
            sensor_jumps: false,
        }
    }

    fn moving(sliding_variable: f64) -> Course {
        Course {
            error_metres: 0.0,
            velocity_metres_per_second: 0.1,
            sliding_variable,
            sensor_jumps: false,
        }
    }

    /// Returns the state after some cycles at an error, with the reference at rest.
    fn after(modes: &Modes, mut state: State, cycles: usize, error_metres: f64) -> State {
        for _ in 0..cycles {
            modes.step(&mut state, &at_rest(error_metres), PERIOD);
        }
        state
    }

    fn calm(modes: &Modes) -> State {
        after(modes, State::default(), 900, 0.0)
    }

    #[test]
    fn a_hold_grows_calm_and_a_move_ends_it_at_once() {
        let modes = modes();
        let mut state = calm(&modes);
        assert_eq!(modes.settings(&state), in_hold());
        let settings = modes.step(&mut state, &moving(0.0), PERIOD);
        assert_eq!(settings, in_move());
    }

    #[test]
    fn settings_go_from_one_mode_to_the_other_the_observers_first() {
        let modes = modes();
        let mut state = State::default();
        let mut last = in_move().bandwidth;
        for _ in 0..799 {
            let settings = modes.step(&mut state, &at_rest(0.0), PERIOD);
            assert!((in_hold().bandwidth..last).contains(&settings.bandwidth));
            last = settings.bandwidth;
        }
        let early = after(&modes, State::default(), 300, 0.0);
        let settings = modes.settings(&early);
        assert_eq!(settings.fraction_drift, in_hold().fraction_drift);
        assert!(settings.bandwidth > 2.0 * in_hold().bandwidth);
        assert!((Between::new(9.0, 4.0).at(0.5) - 6.0).abs() < 1e-12);
    }

    #[test]
    fn settings_of_zero_stay_numbers() {
        assert_eq!(Between::new(0.0, 5.0).at(0.5), 0.0);
        assert_eq!(Between::new(5.0, 0.0).at(0.5), 0.0);
    }

    #[test]
    fn a_load_that_leaves_a_calm_law_rouses_it_and_steps_of_the_sensor_do_not() {
        let modes = modes();
        assert_eq!(after(&modes, calm(&modes), 100, STEP_METRES).calmness, 1.0);
        // Three steps are detected within some milliseconds, and do not change the observer.
        let roused = after(&modes, calm(&modes), 5, 3.0 * STEP_METRES);
        assert!(roused.calmness < 0.01);
        assert_eq!(roused.rest, 1.0);
    }

    #[test]
    fn only_a_load_far_away_rouses_a_law_that_is_not_calm_yet() {
        let modes = modes();
        let state = after(&modes, State::default(), 400, 0.0);
        let later = after(&modes, state, 100, 4.0 * STEP_METRES);
        assert!((later.calmness - 500.0 / 800.0).abs() < 1e-9, "{later:?}");
        assert_eq!(after(&modes, state, 100, 12.0 * STEP_METRES).calmness, 0.0);
    }

    /// Returns the settings after this many swings of the sliding variable about a centre.
    fn rung(modes: &Modes, state: &mut State, swings: u32, centre: f64) -> Settings {
        for swing in 0..swings {
            let side = if swing % 2 == 0 { 1.0 } else { -1.0 };
            modes.step(state, &moving(centre + side), PERIOD);
        }
        modes.step(state, &moving(centre), PERIOD)
    }

    #[test]
    fn a_law_that_rings_backs_off_also_beside_the_surface_and_later_forgets_it() {
        for centre in [0.0, 4.0] {
            let modes = modes();
            let mut state = calm(&modes);
            let settings = rung(&modes, &mut state, 20, centre);
            assert!(settings.caution > 0.99, "{settings:?}");
            assert!(settings.bandwidth < 1.02 * CAUTIOUS_BANDWIDTH);
            // The observer's settings too, while the reference rests.
            let settings = modes.step(&mut state, &at_rest(0.0), PERIOD);
            assert!(settings.fraction_drift > 0.99 * in_move().fraction_drift);
            for _ in 0..12_001 {
                modes.step(&mut state, &moving(centre), PERIOD);
            }
            assert_eq!(modes.settings(&state), in_move());
        }
    }

    #[test]
    fn swings_of_a_reference_that_turns_are_its_own() {
        let modes = modes();
        let mut state = State::default();
        for cycle in 0..40 {
            let side = if cycle % 2 == 0 { 1.0 } else { -1.0 };
            let course = Course {
                velocity_metres_per_second: 0.1 * side,
                ..moving(side)
            };
            assert_eq!(modes.step(&mut state, &course, PERIOD), in_move());
        }
    }

    #[test]
    fn what_follows_a_jump_of_the_sensor_is_no_ringing() {
        let modes = modes();
        let mut state = calm(&modes);
        let jump = Course {
            sensor_jumps: true,
            ..at_rest(0.0)
        };
        modes.step(&mut state, &jump, PERIOD);
        assert_eq!(rung(&modes, &mut state, 20, 0.0).caution, 0.0);
        let mut state = after(&modes, state, 400, 0.0);
        assert!(rung(&modes, &mut state, 20, 0.0).caution > 0.99);
    }

    #[test]
    fn a_sensor_that_jumps_all_the_time_excuses_no_ringing() {
        let modes = modes();
        let mut state = calm(&modes);
        for swing in 0..400 {
            let course = Course {
                sensor_jumps: true,
                ..moving(if swing % 2 == 0 { 1.0 } else { -1.0 })
            };
            modes.step(&mut state, &course, PERIOD);
        }
        assert!(modes.settings(&state).caution > 0.99);
    }

    #[test]
    fn what_a_move_swings_asks_for_no_caution() {
        let modes = modes();
        let mut state = State::default();
        assert_eq!(rung(&modes, &mut state, 4, 0.0), in_move());
        for _ in 0..100 {
            assert_eq!(modes.step(&mut state, &moving(-2.0), PERIOD).caution, 0.0);
        }
    }

    #[test]
    fn a_position_that_did_not_come_changes_no_error() {
        let modes = modes();
        let state = after(&modes, State::default(), 10, 0.001);
        let later = after(&modes, state, 10, f64::NAN);
        assert_eq!(later.error_metres, state.error_metres);
    }
}
