//! Extended Kalman filter on the nominal model: temperature, fraction and unknown heating from the position.
//!
//! The observer is not told whether the wire remembers the turns of its temperature. The memory `μ` is the share of a
//! wire that does, with the slope `sr` of its branch, beside one of Eq. (2), with `sf`: `dξ/dT = (1 − μ) sf + μ sr`. It is a
//! sixth quantity of the filter, which knows it as little as any share, 0.5 ± 0.5, and learns it in moves. In a hold the
//! position is one of few steps of the sensor, whose errors are no noise; there the filter only takes its doubt into
//! account (Schmidt's filter).
//!
//! The filter predicts to the instant at which the command of this cycle acts, which accounts for the one cycle of
//! delay. On the stop the position contains no information on the fraction, so the model runs alone until the load
//! lifts.

use core::ops::{Add, Mul};

use nalgebra::{SMatrix, SVector};
use scenario::controller::Observer as Config;

use crate::mode::Settings;
use crate::nominal_model::{
    Branch, NominalModel, SLOPE_PER_KELVIN_MIN, Slope, State as ModelState, Warming,
};
use crate::turns::Turns;

const STATES: usize = 6;
const POSITION: usize = 0;
const VELOCITY: usize = 1;
const FRACTION: usize = 2;
const TEMPERATURE: usize = 3;
const HEATING: usize = 4;
const MEMORY: usize = 5;

/// Standard deviation of the sensor in its steps: quantisation (0.29), and the same amount again for noise and because
/// quantisation is not white noise. A dead zone, or the likelihood of an interval, would model a step exactly, but is
/// no better. In a hold the position sways by 0.05 mm at 24 Hz with this deviation, and by 0.13 mm at 10 Hz with a dead
/// zone; the interval only makes the current busier.
const SENSOR_DEVIATION_STEPS: f64 = 0.5;

/// Distance of positions from zero, in sensor steps, that shows that the load has left the stop.
const LIFTED_STEPS: f64 = 2.0;

/// Number of such positions in a row; noise of one sensor step alone causes this once in 10¹¹ cycles.
const LIFTED_SAMPLES: u32 = 5;

/// Standard deviation of the velocity when a lift-off is detected, in m/s.
const VELOCITY_DEVIATION_AT_LIFT_OFF: f64 = 0.05;

/// Largest speed of a load at rest, in m/s.
const SPEED_AT_REST_MAX: f64 = 0.05;

/// Deviation of a load at rest from its course, in sensor steps from one cycle to the next, that proves a jump of the
/// sensor. Noise of half a sensor step alone causes this once in half a minute.
const JUMP_STEPS: f64 = 3.5;

/// Distance of a load at rest from its expected position beyond which the sensor reads, or has read, another place: in
/// sensor steps, plus the way at the wire's greatest speed in m/s.
const ELSEWHERE_STEPS: f64 = 5.0;
const ELSEWHERE_METRES_PER_SECOND: f64 = 0.5;

/// Page's cumulative sum of the distances of a load in a hold from its expected positions, in sensor steps: the part of each
/// distance that does not count, and the sum on one side that proves another weight. Full memory raises that sum by the third
/// number: behind a turn a wire that remembers hardly transforms, and heat on a guess throws its load.
const WEIGHT_FREE_STEPS: f64 = 0.35;
const WEIGHT_STEPS: f64 = 5.0;
const WEIGHT_STEPS_BY_MEMORY: f64 = 12.0;

/// Standard deviation of the acceleration by another weight in m/s², and the time for which it acts until it is noticed.
const WEIGHT_ACCELERATION_DEVIATION: f64 = 2.0;
const WEIGHT_SECONDS: f64 = 0.01;

/// Standard deviations of fraction and velocity, in m/s, beyond this course.
const WEIGHT_FRACTION_DEVIATION: f64 = 0.015;
const WEIGHT_VELOCITY_DEVIATION: f64 = 0.01;

/// Standard deviation of the unknown heating at the start in K/s.
const HEATING_DEVIATION_AT_START: f64 = 1.0;

/// Memory at the start, and its standard deviation.
const MEMORY_AT_START: f64 = 0.5;
const MEMORY_DEVIATION_AT_START: f64 = 0.5;

/// Largest slope of a wire that remembers its turns relative to that of Eq. (2).
const RELATIVE_SLOPE_MAX: f64 = 4.0;

type Matrix = SMatrix<f64, STATES, STATES>;
type Vector = SVector<f64, STATES>;

/// Constants of the observer.
#[derive(Clone, Debug)]
pub struct Observer {
    /// Model that the observer predicts with.
    pub model: NominalModel,
    sensor_step_metres: f64,
    temperature_uncertainty: f64,
    velocity_drift: f64,
}

/// State of the observer: the model's state and its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Estimate for the instant at which the next command acts.
    pub model: ModelState,
    /// `μ`: share of a wire that remembers the turns of its temperature, from 0 to 1.
    pub memory: f64,
    turns: Turns,
    /// `sr / sf` in heating and in cooling.
    relative_slopes: [f64; 2],
    covariance: Matrix,
    samples_above_stop: u32,
    /// Distance of the latest position from the expected one.
    innovation_metres: f64,
    /// Sums of the distances above and below the expected positions, in sensor steps.
    aside_steps: [f64; 2],
}

impl State {
    /// Returns how many times as fast as in the model the wire transforms with its temperature, in heating and in cooling.
    pub fn liveliness(&self, settings: &Settings) -> [f64; 2] {
        self.relative_slopes
            .map(|relative| settings.liveliness * (1.0 + self.memory * (relative - 1.0)))
    }
}

impl Observer {
    /// Computes the constants.
    pub fn new(config: &Config, model: NominalModel) -> Self {
        Self {
            model,
            sensor_step_metres: config.sensor_step_millimetres * 1e-3,
            temperature_uncertainty: config.temperature_uncertainty_kelvins,
            velocity_drift: config.velocity_drift_metres_per_second,
        }
    }

    /// Returns the state before any current.
    pub fn start(&self) -> State {
        let model = self.model.start();
        State {
            model,
            memory: MEMORY_AT_START,
            turns: Turns::default(),
            relative_slopes: [1.0; 2],
            covariance: self.branch_doubt(&model, MEMORY_DEVIATION_AT_START),
            samples_above_stop: 0,
            innovation_metres: 0.0,
            aside_steps: [0.0; 2],
        }
    }

    /// Returns whether a position before its correction shows a jump of the sensor, which no current can have caused.
    pub fn sensor_jumps(&self, state: &State, position_metres: f64) -> bool {
        let innovation = position_metres - state.model.position_metres;
        let jump = (innovation - state.innovation_metres).abs();
        is_slow(&state.model) && jump > JUMP_STEPS * self.sensor_step_metres
    }

    /// Returns the covariance of the model's uncertainty: the transformation temperatures' as one of the temperature,
    /// with the fraction along the branch.
    fn branch_doubt(&self, model: &ModelState, memory_deviation: f64) -> Matrix {
        let slope = self.model.slope(model, Branch::Heating).per_kelvin;
        let along_branch =
            Vector::from([0.0, 0.0, slope, 1.0, 0.0, 0.0]) * self.temperature_uncertainty;
        let mut doubt = along_branch * along_branch.transpose();
        doubt[(HEATING, HEATING)] = HEATING_DEVIATION_AT_START * HEATING_DEVIATION_AT_START;
        doubt[(MEMORY, MEMORY)] = memory_deviation * memory_deviation;
        doubt
    }

    /// Corrects with the position sampled now, then predicts to the next cycle under the current that flows until then.
    pub fn step(
        &self,
        state: &mut State,
        settings: &Settings,
        position_metres: f64,
        squared_current: f64,
        seconds: f64,
    ) {
        if position_metres.is_finite() {
            self.correct(
                state,
                settings,
                position_metres.clamp(0.0, self.model.position_metres_max()),
                seconds,
            );
        }
        self.predict(state, settings, squared_current, seconds);
    }

    fn correct(&self, state: &mut State, settings: &Settings, position_metres: f64, seconds: f64) {
        let before = state.innovation_metres;
        state.innovation_metres = position_metres - state.model.position_metres;
        let above = position_metres > LIFTED_STEPS * self.sensor_step_metres;
        let samples = if above {
            state.samples_above_stop.saturating_add(1)
        } else {
            0
        };
        state.samples_above_stop = samples;
        if !self.model.rests_on_stop(&state.model) {
            self.take(state, settings, position_metres, before, seconds);
        } else if samples >= LIFTED_SAMPLES {
            self.lift(state, position_metres);
        }
    }

    /// Corrects with a position. One that a load at rest cannot have is ignored, unless the next one confirms it.
    fn take(
        &self,
        state: &mut State,
        settings: &Settings,
        position_metres: f64,
        before: f64,
        seconds: f64,
    ) {
        let innovation = state.innovation_metres;
        let nearest =
            ELSEWHERE_STEPS * self.sensor_step_metres + ELSEWHERE_METRES_PER_SECOND * seconds;
        if !is_slow(&state.model) || innovation.abs() <= nearest {
            self.weigh(state, settings);
            self.update(state, settings, innovation);
        } else if innovation * before > nearest * nearest {
            self.relocate(state, position_metres);
        }
    }

    /// Doubts fraction and velocity if a load in a hold leaves its place: its weight has changed, which to the filter is
    /// another fraction, Eq. (12), by which the load has accelerated. Weight is no heat, so that the temperature does not
    /// follow.
    fn weigh(&self, state: &mut State, settings: &Settings) {
        let steps = state.innovation_metres / self.sensor_step_metres;
        let is_in_hold = settings.trusts_model && is_slow(&state.model);
        for (sum, distance) in state.aside_steps.iter_mut().zip([steps, -steps]) {
            let next = (*sum + distance - WEIGHT_FREE_STEPS).max(0.0);
            *sum = if is_in_hold { next } else { 0.0 };
        }
        let proof = WEIGHT_STEPS + WEIGHT_STEPS_BY_MEMORY * state.memory;
        if state.aside_steps.iter().all(|sum| *sum <= proof) {
            return;
        }
        state.aside_steps = [0.0; 2];
        let covariance = &mut state.covariance;
        for component in [TEMPERATURE, HEATING, MEMORY] {
            let variance = covariance[(component, component)];
            covariance.fill_row(component, 0.0);
            covariance.fill_column(component, 0.0);
            covariance[(component, component)] = variance;
        }
        let forgetting = (1.0 - 2.0 * state.memory).max(0.0);
        let acceleration = forgetting * WEIGHT_ACCELERATION_DEVIATION;
        let velocity = acceleration * WEIGHT_SECONDS;
        let position = 0.5 * velocity * WEIGHT_SECONDS;
        let (_, _, by_fraction) = self.model.acceleration_gradient(&state.model);
        // A wire without stretch moves no load.
        let fraction = (acceleration / by_fraction).max(-1.0);
        let course = Vector::from([position, velocity, fraction, 0.0, 0.0, 0.0]);
        *covariance += course * course.transpose();
        covariance[(FRACTION, FRACTION)] += WEIGHT_FRACTION_DEVIATION * WEIGHT_FRACTION_DEVIATION;
        covariance[(VELOCITY, VELOCITY)] += WEIGHT_VELOCITY_DEVIATION * WEIGHT_VELOCITY_DEVIATION;
    }

    /// Moves the estimate to a load that is elsewhere without motion. The load rests there by its fraction, Eq. (12);
    /// velocity, temperature and heating are unchanged. The filter would interpret the displacement as motion.
    fn relocate(&self, state: &mut State, position_metres: f64) {
        let holding = |position| self.model.holding_fraction(position);
        let model = &mut state.model;
        let change = holding(position_metres) - holding(model.position_metres);
        model.martensite_fraction = (model.martensite_fraction + change).clamp(0.0, 1.0);
        model.position_metres = position_metres;
        state.innovation_metres = 0.0;
    }

    fn sensor_deviation(&self) -> f64 {
        self.sensor_step_metres * SENSOR_DEVIATION_STEPS
    }

    /// Moves the estimate of a resting model to a load that has lifted: the fraction follows from the position by
    /// Eq. (12), the temperature along the heating branch.
    fn lift(&self, state: &mut State, position_metres: f64) {
        let curve = self.model.curve_through(&state.model, Branch::Heating);
        let martensite_fraction = self.model.holding_fraction(position_metres).clamp(0.0, 1.0);
        state.model = ModelState {
            position_metres,
            velocity_metres_per_second: 0.0,
            martensite_fraction,
            temperature_celsius: self.model.temperature_on(&curve, martensite_fraction),
            unknown_heating_kelvins_per_second: 0.0,
        };
        let memory_deviation = libm::sqrt(state.covariance[(MEMORY, MEMORY)]);
        state.covariance = self.branch_doubt(&state.model, memory_deviation);
        let position_doubt = self.sensor_deviation();
        state.covariance[(POSITION, POSITION)] = position_doubt * position_doubt;
        state.covariance[(VELOCITY, VELOCITY)] =
            VELOCITY_DEVIATION_AT_LIFT_OFF * VELOCITY_DEVIATION_AT_LIFT_OFF;
    }

    /// Corrects the state by the distance of the position from the expected one.
    fn update(&self, state: &mut State, settings: &Settings, innovation: f64) {
        let column: Vector = state.covariance.column(POSITION).into();
        let deviation = self.sensor_deviation();
        let gain = column / (column[POSITION] + deviation * deviation);
        let memory_variance = state.covariance[(MEMORY, MEMORY)];
        state.covariance -= gain * column.transpose();
        let change = gain * innovation;
        let model = &mut state.model;
        model.position_metres = (model.position_metres + change[POSITION]).max(0.0);
        model.velocity_metres_per_second += change[VELOCITY];
        model.martensite_fraction = (model.martensite_fraction + change[FRACTION]).clamp(0.0, 1.0);
        model.temperature_celsius += change[TEMPERATURE];
        model.unknown_heating_kelvins_per_second += change[HEATING];
        state.turns.shift(change[TEMPERATURE]);
        if settings.trusts_model {
            state.covariance[(MEMORY, MEMORY)] = memory_variance;
        } else {
            state.memory = (state.memory + change[MEMORY]).clamp(0.0, 1.0);
        }
    }

    fn predict(&self, state: &mut State, settings: &Settings, squared_current: f64, seconds: f64) {
        let rate = self.model.temperature_rate(&state.model, squared_current);
        let branch = NominalModel::branch(rate);
        state.turns.follow(state.model.temperature_celsius, branch);
        let place = branch as usize;
        let forgetting = self.model.slope(&state.model, branch);
        let warming = Warming::new(rate, forgetting, state.liveliness(settings)[place]);
        // Of the two slopes only that of Eq. (2) depends on the fraction.
        let slope = Slope {
            by_fraction: settings.liveliness * (1.0 - state.memory) * forgetting.by_fraction,
            ..warming.slope
        };
        let by_memory = settings.liveliness
            * (state.relative_slopes[place] - 1.0)
            * forgetting.per_kelvin
            * rate;
        let transition = self.transition(&state.model, rate, &slope, by_memory, seconds);
        state.model = self
            .model
            .advance_from(&state.model, &warming, squared_current, seconds);
        state.relative_slopes = self.relative_slopes(state);
        state.covariance = transition.carry(&state.covariance);
        // On the stop the filter learns nothing, so the covariance does not grow either.
        if !self.model.rests_on_stop(&state.model) {
            let drifts = [
                (VELOCITY, self.velocity_drift),
                (FRACTION, settings.fraction_drift),
                (HEATING, settings.heating_drift),
            ];
            for (component, drift) in drifts {
                state.covariance[(component, component)] += drift * drift * seconds;
            }
        }
    }

    /// Returns `sr / sf` in heating and in cooling.
    fn relative_slopes(&self, state: &State) -> [f64; 2] {
        let model = &state.model;
        let remembering = state.turns.slopes(&self.model, model.temperature_celsius);
        [Branch::Heating, Branch::Cooling].map(|branch| {
            let forgetting = self.model.slope(model, branch).per_kelvin;
            let relative = remembering[branch as usize] / forgetting.min(-SLOPE_PER_KELVIN_MIN);
            relative.min(RELATIVE_SLOPE_MAX)
        })
    }

    /// Returns the transition to second order in time: the exponential of the model's Jacobian, from Eq. (1), (7) and
    /// (10).
    fn transition(
        &self,
        state: &ModelState,
        rate: f64,
        slope: &Slope,
        by_memory: f64,
        seconds: f64,
    ) -> Transition {
        let (by_position, by_velocity, by_fraction) = self.model.acceleration_gradient(state);
        let rate_by_temperature = self.model.temperature_rate_by_temperature();
        let by_temperature = slope.by_temperature * rate + slope.per_kelvin * rate_by_temperature;
        // These are the non-zero elements of the Jacobian times the period. The rows of position and temperature also
        // contain the period itself, for the velocity and for the unknown heating.
        let [vx, vv, vf] = [by_position, by_velocity, by_fraction].map(|by| by * seconds);
        let [ff, ft, fh] =
            [slope.by_fraction * rate, by_temperature, slope.per_kelvin].map(|by| by * seconds);
        let tt = rate_by_temperature * seconds;
        let fm = by_memory * seconds;
        let mut transition = Transition {
            position: [
                1.0 + 0.5 * (seconds * vx),
                seconds + 0.5 * (seconds * vv),
                0.5 * (seconds * vf),
            ],
            velocity: [
                vx + 0.5 * (vv * vx),
                1.0 + vv + 0.5 * (vx * seconds + vv * vv),
                vf + 0.5 * (vv * vf + vf * ff),
                0.5 * (vf * ft),
                0.5 * (vf * fh),
                0.5 * (vf * fm),
            ],
            fraction: [
                1.0 + ff + 0.5 * (ff * ff),
                ft + 0.5 * (ff * ft + ft * tt),
                fh + 0.5 * (ff * fh + ft * seconds),
                fm + 0.5 * (ff * fm),
            ],
            temperature: [1.0 + tt + 0.5 * (tt * tt), seconds + 0.5 * (tt * seconds)],
        };
        if self.model.rests_on_stop(state) {
            transition.position.fill(0.0);
            transition.velocity.fill(0.0);
        }
        transition
    }
}

/// Returns whether the load moves as slowly as a resting one.
fn is_slow(model: &ModelState) -> bool {
    model.velocity_metres_per_second.abs() < SPEED_AT_REST_MAX
}

/// A transition matrix `Φ`: the elements of its rows that are not 0, from the diagonal on; the row of the velocity is
/// complete. The unknown heating and the memory are constant.
#[derive(Clone, Copy, Debug)]
struct Transition {
    position: [f64; 3],
    velocity: [f64; 6],
    fraction: [f64; 4],
    temperature: [f64; 2],
}

impl Transition {
    /// Returns `Φ P Φᵀ` of a covariance `P`. It first transforms each column of `P`, then combines the columns of the
    /// result in the same way.
    fn carry(&self, covariance: &Matrix) -> Matrix {
        let [a, b, c, d, e, f] = covariance.data.0;
        let carried = |column| Vector::from(self.apply(column));
        Matrix::from_columns(&self.apply([
            carried(a),
            carried(b),
            carried(c),
            carried(d),
            carried(e),
            carried(f),
        ]))
    }

    /// Returns `Φ` times a column of six numbers or of six vectors.
    #[inline]
    fn apply<T>(
        &self,
        [position, velocity, fraction, temperature, heating, memory]: [T; STATES],
    ) -> [T; STATES]
    where
        T: Copy + Mul<f64, Output = T> + Add<Output = T>,
    {
        let [xx, xv, xf] = self.position;
        let [vx, vv, vf, vt, vh, vm] = self.velocity;
        let [ff, ft, fh, fm] = self.fraction;
        let [tt, th] = self.temperature;
        [
            position * xx + velocity * xv + fraction * xf,
            position * vx
                + velocity * vv
                + fraction * vf
                + temperature * vt
                + heating * vh
                + memory * vm,
            fraction * ff + temperature * ft + heating * fh + memory * fm,
            temperature * tt + heating * th,
            heating,
            memory,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{PERIOD_SECONDS, SENSOR_STEP_METRES, in_hold, in_move, sampled};
    use scenario::controller::NominalModel as ModelConfig;

    /// Steps one cycle in a move.
    fn step(observer: &Observer, state: &mut State, position_metres: f64, squared_current: f64) {
        let settings = in_move();
        observer.step(
            state,
            &settings,
            position_metres,
            squared_current,
            PERIOD_SECONDS,
        );
    }

    /// Runs plant and observer under the same current over time; returns plant and estimate at the end.
    fn side_by_side(
        plant: &NominalModel,
        seconds: f64,
        current: impl Fn(f64) -> f64,
    ) -> (ModelState, ModelState) {
        let model = NominalModel::new(&ModelConfig::default());
        let observer = Observer::new(&Config::default(), model);
        let mut state = observer.start();
        let mut truth = plant.start();
        let mut time = 0.0;
        while time < seconds {
            let squared_current = current(time) * current(time);
            let position = sampled(truth.position_metres);
            step(&observer, &mut state, position, squared_current);
            truth = plant.advance(&truth, squared_current, PERIOD_SECONDS);
            time += PERIOD_SECONDS;
        }
        (truth, state.model)
    }

    fn nominal() -> NominalModel {
        NominalModel::new(&ModelConfig::default())
    }

    #[test]
    fn on_the_stop_the_model_runs_alone() {
        let (truth, estimate) = side_by_side(&nominal(), 0.2, |_| 1.0);
        assert_eq!(truth.position_metres, 0.0);
        assert!((truth.temperature_celsius - estimate.temperature_celsius).abs() < 1e-9);
        assert!((truth.martensite_fraction - estimate.martensite_fraction).abs() < 1e-12);
    }

    fn components(state: &ModelState, memory: f64) -> [f64; STATES] {
        [
            state.position_metres,
            state.velocity_metres_per_second,
            state.martensite_fraction,
            state.temperature_celsius,
            state.unknown_heating_kelvins_per_second,
            memory,
        ]
    }

    fn model_state([x, v, fraction, temperature, heating, _]: [f64; STATES]) -> ModelState {
        ModelState {
            position_metres: x,
            velocity_metres_per_second: v,
            martensite_fraction: fraction,
            temperature_celsius: temperature,
            unknown_heating_kelvins_per_second: heating,
        }
    }

    #[test]
    fn the_transition_is_the_derivative_of_a_step_of_the_model() {
        let observer = Observer::new(&Config::default(), nominal());
        let start = [0.02, 0.05, 0.6, 70.0, 0.5, 0.0];
        let relative = 0.3;
        for squared_current in [0.0, 1.0] {
            let warming = |start: [f64; STATES]| {
                let liveliness = 1.0 + start[MEMORY] * (relative - 1.0);
                let state = model_state(start);
                observer.model.warming(&state, squared_current, liveliness)
            };
            let step = |start: [f64; STATES]| {
                let end = observer.model.advance_from(
                    &model_state(start),
                    &warming(start),
                    squared_current,
                    PERIOD_SECONDS,
                );
                Vector::from(components(&end, start[MEMORY]))
            };
            let Warming {
                kelvins_per_second,
                slope,
                ..
            } = warming(start);
            let by_memory = (relative - 1.0) * slope.per_kelvin * kelvins_per_second;
            let transition = observer.transition(
                &model_state(start),
                kelvins_per_second,
                &slope,
                by_memory,
                PERIOD_SECONDS,
            );
            for component in 0..STATES {
                let mut direction = [0.0; STATES];
                direction[component] = 1.0;
                let mut beyond = start;
                beyond[component] += 1e-6;
                let found = Vector::from(transition.apply(direction));
                let expected = (step(beyond) - step(start)) / 1e-6;
                for (found, expected) in found.iter().zip(&expected) {
                    // The remaining error is of the third order in the period.
                    let error = (found - expected).abs();
                    assert!(
                        error < 5e-3 * expected.abs().max(1e-3),
                        "{component} {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_covariance_is_carried_as_by_the_whole_matrix() {
        let transition = Transition {
            position: [1.1, 0.2, -0.3],
            velocity: [-0.4, 0.9, 0.5, 0.1, 0.7, -0.6],
            fraction: [0.8, -0.2, 0.6, 0.4],
            temperature: [0.95, 0.3],
        };
        let columns = Matrix::identity()
            .data
            .0
            .map(|column| Vector::from(transition.apply(column)));
        let whole = Matrix::from_columns(&columns);
        let covariance = Matrix::from_iterator((1..=36_u32).map(|number| f64::from(number % 7)));
        let difference = transition.carry(&covariance) - whole * covariance * whole.transpose();
        assert!(difference.amax() < 1e-13, "{difference}");
    }

    /// Returns the memory that the observer finds on a wire that remembers its turns by this share, in swings.
    fn memory_found(share: f64) -> f64 {
        let model = nominal();
        let observer = Observer::new(&Config::default(), model.clone());
        let mut state = observer.start();
        let mut truth = State {
            memory: share,
            ..observer.start()
        };
        for cycle in 0..4000 {
            let time = PERIOD_SECONDS * f64::from(cycle);
            let current = if time < 1.0 {
                0.62
            } else {
                0.58 + 0.1 * libm::sin(9.0 * time)
            };
            let squared_current = current * current;
            let position = sampled(truth.model.position_metres);
            step(&observer, &mut state, position, squared_current);
            observer.predict(&mut truth, &in_move(), squared_current, PERIOD_SECONDS);
        }
        state.memory
    }

    #[test]
    fn memory_of_the_turns_is_found_in_moves_and_no_other_is() {
        let found = [0.0, 1.0].map(memory_found);
        assert!(found[0] < 0.1, "{found:?}");
        assert!(found[1] > 0.9, "{found:?}");
    }

    #[test]
    fn a_hold_teaches_nothing_of_the_memory() {
        let (observer, mut state, squared_current) = holding();
        let before = state;
        for _ in 0..2000 {
            observer.step(
                &mut state,
                &in_hold(),
                sampled(0.02),
                squared_current,
                PERIOD_SECONDS,
            );
        }
        let variance = |state: &State| state.covariance[(MEMORY, MEMORY)];
        assert_eq!(state.memory, before.memory);
        assert_eq!(variance(&state), variance(&before));
    }

    #[test]
    fn temperature_and_fraction_follow_through_minor_loops() {
        let current = |time: f64| {
            if time < 1.0 {
                0.6
            } else {
                0.56 + 0.08 * libm::sin(3.0 * time)
            }
        };
        let (truth, estimate) = side_by_side(&nominal(), 8.0, current);
        assert!((truth.temperature_celsius - estimate.temperature_celsius).abs() < 0.5);
        assert!((truth.martensite_fraction - estimate.martensite_fraction).abs() < 2e-3);
        assert!((truth.position_metres - estimate.position_metres).abs() < 6e-5);
    }

    #[test]
    fn a_wire_that_transforms_later_is_recognised_once_the_load_lifts() {
        let late = NominalModel::new(&ModelConfig {
            austenite_start_celsius: 57.0,
            austenite_finish_celsius: 97.0,
            ..ModelConfig::default()
        });
        let (truth, estimate) = side_by_side(&late, 1.5, |_| 0.63);
        assert!(truth.position_metres > 0.005);
        assert!((truth.martensite_fraction - estimate.martensite_fraction).abs() < 2e-3);
        assert!((truth.position_metres - estimate.position_metres).abs() < 6e-5);
    }

    #[test]
    fn unknown_cooling_is_found() {
        let windy = NominalModel::new(&ModelConfig {
            convection_watts_per_square_metre_kelvin: 35.0,
            ..ModelConfig::default()
        });
        let (truth, estimate) = side_by_side(&windy, 6.0, |_| 0.62);
        let rate = nominal().temperature_rate(&estimate, 0.62 * 0.62);
        assert!(truth.position_metres > 0.002);
        assert!(estimate.unknown_heating_kelvins_per_second < -2.0);
        // At rest the estimated heat balance is zero.
        assert!(rate.abs() < 0.5, "{rate}");
    }

    #[test]
    fn meaningless_positions_leave_it_finite() {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        let positions = [f64::NAN, f64::INFINITY, -1e300, 1e300, 0.06, 0.0];
        for position in positions.into_iter().cycle().take(3000) {
            step(&observer, &mut state, position, 1.0);
            assert!(state.model.temperature_celsius.is_finite());
            assert!(state.model.position_metres.is_finite());
            assert!((0.0..=1.0).contains(&state.model.martensite_fraction));
        }
    }

    #[test]
    fn noise_on_the_cold_stop_is_no_lift_off() {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        for cycle in 0..1000 {
            let position = if cycle % 5 == 4 { 0.0 } else { 2e-4 };
            step(&observer, &mut state, position, 0.0);
        }
        assert!((state.model.temperature_celsius - 15.0847).abs() < 1e-3);
        assert!(nominal().rests_on_stop(&state.model));
    }

    #[test]
    fn a_load_already_up_at_the_start_is_found() {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        let model = nominal();
        let mut truth = ModelState {
            position_metres: 0.025,
            martensite_fraction: model.holding_fraction(0.025),
            temperature_celsius: 54.0,
            ..ModelState::default()
        };
        let squared_current = model.squared_current(&truth, 0.0);
        for _ in 0..500 {
            step(
                &observer,
                &mut state,
                sampled(truth.position_metres),
                squared_current,
            );
            truth = model.advance(&truth, squared_current, PERIOD_SECONDS);
        }
        assert!((state.model.position_metres - 0.025).abs() < 1e-4);
        assert!((state.model.temperature_celsius - 54.0).abs() < 5.0);
    }

    #[test]
    fn an_estimate_that_rests_far_too_hot_recovers() {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        state.model.temperature_celsius = 131.0;
        state.model.martensite_fraction = 0.97;
        state.covariance = Matrix::zeros();
        for _ in 0..100 {
            step(&observer, &mut state, 0.03, 0.3);
        }
        assert!(!nominal().rests_on_stop(&state.model));
        assert!((state.model.position_metres - 0.03).abs() < 1e-3);
    }

    /// Returns an observer at rest with a load at 20 mm, and the current that holds it there.
    fn holding() -> (Observer, State, f64) {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        state.model = ModelState {
            position_metres: 0.02,
            martensite_fraction: observer.model.holding_fraction(0.02),
            temperature_celsius: 52.0,
            ..ModelState::default()
        };
        let squared_current = observer.model.squared_current(&state.model, 0.0);
        for _ in 0..500 {
            let position = sampled(0.02);
            step(&observer, &mut state, position, squared_current);
        }
        (observer, state, squared_current)
    }

    /// Hangs 10 g on the 40 g of a wire with a memory, in a hold, for some cycles; returns truth and estimate.
    fn with_another_weight(memory: f64, cycles: u32) -> (ModelState, ModelState) {
        let heavier = NominalModel::new(&ModelConfig {
            load_kilograms: 0.05,
            ..ModelConfig::default()
        });
        let (observer, mut state, squared_current) = holding();
        state.memory = memory;
        let settings = in_hold();
        let step = |state: &mut State, position_metres: f64| {
            observer.step(
                state,
                &settings,
                sampled(position_metres),
                squared_current,
                PERIOD_SECONDS,
            );
        };
        for _ in 0..2000 {
            step(&mut state, 0.02);
        }
        let mut truth = state.model;
        for _ in 0..cycles {
            step(&mut state, truth.position_metres);
            truth = heavier.advance(&truth, squared_current, PERIOD_SECONDS);
        }
        (truth, state.model)
    }

    #[test]
    fn another_weight_is_no_heat() {
        let (truth, estimate) = with_another_weight(MEMORY_AT_START, 25);
        let metres = estimate.position_metres - truth.position_metres;
        assert!(metres.abs() < SENSOR_STEP_METRES, "{metres} m");
        let kelvins = estimate.temperature_celsius - truth.temperature_celsius;
        assert!(kelvins.abs() < 0.7, "{kelvins} K");
    }

    #[test]
    fn a_wire_that_forgets_shows_another_weight_within_15_cycles() {
        let (truth, estimate) = with_another_weight(0.0, 15);
        let share = estimate.velocity_metres_per_second / truth.velocity_metres_per_second;
        assert!((0.7..1.3).contains(&share), "{share}");
    }

    #[test]
    fn a_sensor_that_reads_another_place_moves_the_estimate_and_makes_no_motion() {
        let (observer, mut state, squared_current) = holding();
        let before = state.model;
        for _ in 0..5 {
            step(&observer, &mut state, 0.0175, squared_current);
        }
        assert!((state.model.position_metres - 0.0175).abs() < 1e-4);
        assert!(state.model.velocity_metres_per_second.abs() < 0.02);
        let temperatures = [before, state.model].map(|model| model.temperature_celsius);
        assert!(
            (temperatures[0] - temperatures[1]).abs() < 0.5,
            "{temperatures:?}"
        );
    }

    #[test]
    fn only_a_load_at_rest_shows_a_jump_of_the_sensor() {
        let (observer, mut state, _) = holding();
        let at = state.model.position_metres;
        let step = observer.sensor_step_metres;
        assert!(!observer.sensor_jumps(&state, at + 2.0 * step));
        assert!(!observer.sensor_jumps(&state, f64::NAN));
        assert!(observer.sensor_jumps(&state, at - 5.0 * step));
        state.model.velocity_metres_per_second = 0.1;
        assert!(!observer.sensor_jumps(&state, at - 5.0 * step));
    }

    #[test]
    fn waiting_on_the_stop_does_not_raise_the_doubt() {
        let observer = Observer::new(&Config::default(), nominal());
        let mut state = observer.start();
        for _ in 0..100_000 {
            step(&observer, &mut state, 0.0, 0.0);
        }
        let doubt = state.covariance[(TEMPERATURE, TEMPERATURE)];
        assert!(doubt <= 9.0, "{doubt}");
    }
}
