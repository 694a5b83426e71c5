//! Sliding mode on the nominal model, Eq. (13) and (14) with PAPER E3 to E5, fed by the observer.

use scenario::controller::SlidingMode as Config;
use scenario::reference::SetPoint;

use crate::law::{Command, ControlLaw, Explanation, Measurement, current_of};
use crate::nominal_model::{NominalModel, State as ModelState};
use crate::observer::{self, Observer};
use crate::reference_filter::{self, Reference, ReferenceFilter};

/// Least martensite fraction that set-points may ask for; beyond, the transformation has no authority left.
const MARTENSITE_FRACTION_MIN: f64 = 0.2;

/// The law's constants.
#[derive(Clone, Debug)]
pub struct SlidingMode {
    surface: Surface,
    observer: Observer,
    reference_filter: ReferenceFilter,
}

/// The law's memory.
#[derive(Clone, Debug)]
pub struct State {
    observer: observer::State,
    reference: reference_filter::State,
    squared_current: f64,
}

/// The sliding surface and its gains, Eq. (14).
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// `λ` in 1/s.
    pub bandwidth: f64,
    /// `φ` in m/s².
    pub boundary_layer: f64,
    /// `KSM` in m/s³.
    pub switching_gain: f64,
}

/// What the surface asks for.
#[derive(Clone, Copy, Debug, Default)]
pub struct WantedJerk {
    /// `s` in m/s².
    pub sliding_variable: f64,
    /// Jerk that stays on the surface, in m/s³.
    pub equivalent: f64,
    /// Jerk that leads to the surface, in m/s³.
    pub switching: f64,
}

impl Surface {
    /// `s = x̃″ + 2λ x̃′ + λ² x̃`, and `x⃛d − 2λ x̃″ − λ² x̃′ − KSM sat(s/φ)` in its two parts, Eq. (14) with PAPER E4.
    #[must_use]
    pub fn wanted_jerk(
        &self,
        estimate: &ModelState,
        acceleration: f64,
        reference: &Reference,
    ) -> WantedJerk {
        let lambda = self.bandwidth;
        let error = estimate.position_metres - reference.state.position_metres;
        let error_rate =
            estimate.velocity_metres_per_second - reference.state.velocity_metres_per_second;
        let error_acceleration =
            acceleration - reference.state.acceleration_metres_per_second_squared;
        let sliding_variable = error_acceleration + (2.0 * error_rate + lambda * error) * lambda;
        WantedJerk {
            sliding_variable,
            equivalent: reference.jerk_metres_per_second_cubed
                - (2.0 * error_acceleration + lambda * error_rate) * lambda,
            switching: -self.switching_gain
                * (sliding_variable / self.boundary_layer).clamp(-1.0, 1.0),
        }
    }
}

impl SlidingMode {
    /// Works out the constants.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let model = NominalModel::new(&config.nominal_model);
        Self {
            surface: Surface {
                bandwidth: config.bandwidth_radians_per_second,
                boundary_layer: config.boundary_layer_metres_per_second_squared,
                switching_gain: config.switching_gain_metres_per_second_cubed,
            },
            reference_filter: ReferenceFilter {
                poles_radians_per_second: config.reference_filter_radians_per_second,
                position_metres_max: model.holding_position(MARTENSITE_FRACTION_MIN),
            },
            observer: Observer::new(&config.observer, model),
        }
    }
}

impl ControlLaw for SlidingMode {
    type State = State;

    fn start(&self) -> State {
        State {
            observer: self.observer.start(),
            reference: reference_filter::State::default(),
            squared_current: 0.0,
        }
    }

    fn step(
        &self,
        state: &mut State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        let model = &self.observer.model;
        self.observer.step(
            &mut state.observer,
            measurement.position_metres,
            state.squared_current,
            period_seconds,
        );
        let estimate = &state.observer.model;
        let on_stop = model.rests_on_stop(estimate);
        if on_stop {
            state.reference = reference_filter::State::default();
        }
        let reference = self
            .reference_filter
            .step(&mut state.reference, set_point, period_seconds);
        let acceleration = model.acceleration(estimate);
        let wanted = self.surface.wanted_jerk(estimate, acceleration, &reference);
        let part = |jerk| model.squared_current_for_jerk(estimate, acceleration, jerk);
        let squared_current = part(wanted.equivalent + wanted.switching);
        let mut command = command(
            estimate,
            &reference,
            &wanted,
            part(wanted.equivalent),
            squared_current,
        );
        command.explanation.saturation.on_stop = on_stop;
        state.squared_current = command.current_amperes * command.current_amperes;
        command
    }
}

/// The command for a wanted `u = i²`, with its explanation.
pub(crate) fn command(
    estimate: &ModelState,
    reference: &Reference,
    wanted: &WantedJerk,
    equivalent_part: f64,
    squared_current: f64,
) -> Command {
    let (current_amperes, saturation) = current_of(squared_current);
    Command {
        current_amperes,
        explanation: Explanation {
            reference_position_metres: reference.state.position_metres,
            reference_velocity_metres_per_second: reference.state.velocity_metres_per_second,
            estimated_temperature_celsius: estimate.temperature_celsius,
            estimated_martensite_fraction: estimate.martensite_fraction,
            estimated_velocity_metres_per_second: estimate.velocity_metres_per_second,
            sliding_variable_metres_per_second_squared: wanted.sliding_variable,
            saturation,
            equivalent_part_square_amperes: equivalent_part,
            switching_part_square_amperes: squared_current - equivalent_part,
        },
    }
}
