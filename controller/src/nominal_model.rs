//! The controller's model of the plant: heat, phase, wire and motion, one function per equation.
//!
//! Eq. (2) with continuous turns (PAPER E2) has no memory beyond temperature and fraction: eliminating `ξm` and `ξA`
//! leaves a slope `dξ/dT` for heating and one for cooling, and the sign of `dT/dt` chooses between them.

use core::f64::consts::PI;

use scenario::controller::NominalModel as Config;

/// Standard gravity in m/s².
const GRAVITY: f64 = 9.80665;

/// Longest step of the integrator in seconds; longer periods are divided.
const INTEGRATOR_STEP_SECONDS: f64 = 1e-3;

/// Largest number of integrator steps in one call; it bounds the work.
const INTEGRATOR_STEPS_MAX: u32 = 64;

/// Steepness of Eq. (2): the argument of the exponential covers this range from start to finish temperature.
const TRANSFORMATION_STEEPNESS: f64 = 6.2;

/// Smallest effect of the fraction on the acceleration in m/s² as a divisor of a jerk; it keeps results finite.
const AUTHORITY_MIN: f64 = 1e-3;

/// Smallest `dξ/dT` in 1/K as a divisor of a rate; it keeps results finite.
pub(crate) const SLOPE_PER_KELVIN_MIN: f64 = 1e-9;

/// Share of a branch's span, from either end, within which Eq. (2) is no longer solved for the temperature.
const SHARE_MIN: f64 = 1e-3;

/// Smallest austenite fraction of the outer loop as a divisor; it keeps results finite.
const AUSTENITE_MIN: f64 = 1e-9;

/// Smallest martensite fraction that set-points may require; below, hardly any stretch is left to work with.
pub(crate) const MARTENSITE_FRACTION_MIN: f64 = 0.2;

/// State of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Position of the load, `x`.
    pub position_metres: f64,
    /// Velocity of the load.
    pub velocity_metres_per_second: f64,
    /// Martensite fraction, `ξ`.
    pub martensite_fraction: f64,
    /// Wire temperature, `T`.
    pub temperature_celsius: f64,
    /// Heating rate from unknown causes, such as a fan.
    pub unknown_heating_kelvins_per_second: f64,
}

/// Derivatives of [`State`] with respect to time; the unknown heating is constant.
#[derive(Clone, Copy, Debug, Default)]
struct Rate {
    position: f64,
    velocity: f64,
    fraction: f64,
    temperature: f64,
}

/// Direction of the phase transformation, chosen by the sign of `dT/dt`.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Branch {
    /// Martensite to austenite.
    Heating,
    /// Austenite to martensite.
    Cooling,
}

/// `dξ/dT` along a branch and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Slope {
    /// `dξ/dT` in 1/K; never positive.
    pub per_kelvin: f64,
    /// Derivative with respect to `ξ`, in 1/K.
    pub by_fraction: f64,
    /// Derivative with respect to `T`, in 1/K².
    pub by_temperature: f64,
}

impl Slope {
    #[inline]
    fn times(self, factor: f64) -> Self {
        Self {
            per_kelvin: factor * self.per_kelvin,
            by_fraction: factor * self.by_fraction,
            by_temperature: factor * self.by_temperature,
        }
    }
}

/// Heating rate of the wire, and the response of the fraction on the branch that it takes.
#[derive(Clone, Copy, Debug)]
pub struct Warming {
    /// `dT/dt`.
    pub kelvins_per_second: f64,
    /// `dξ/dT`.
    pub slope: Slope,
    /// Rate of the transformation with temperature, relative to the model.
    liveliness: f64,
}

impl Warming {
    /// Makes the warming of a wire that transforms `liveliness` times as fast with its temperature as on this slope.
    #[inline]
    pub fn new(kelvins_per_second: f64, slope: Slope, liveliness: f64) -> Self {
        Self {
            kelvins_per_second,
            slope: slope.times(liveliness),
            liveliness,
        }
    }
}

/// A branch of Eq. (2) with the constants `ξ0` and `k` of Eq. (10).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BranchCurve {
    /// Direction.
    pub branch: Branch,
    /// `ξ0`: `ξm` for heating, `1 − ξA` for cooling.
    pub span: f64,
    /// `k`: 0 for heating, `ξA` for cooling.
    pub floor: f64,
}

/// Martensite fractions of Eq. (2) at a temperature on the outer loop, which a whole heating and a whole cooling take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OuterLoop {
    /// `gh`.
    pub(crate) heating: f64,
    /// `gc`.
    pub(crate) cooling: f64,
}

impl OuterLoop {
    /// Returns `A = (1 − gh) / (1 − gc)`.
    pub(crate) fn ratio(&self) -> f64 {
        (1.0 - self.heating) / (1.0 - self.cooling).max(AUSTENITE_MIN)
    }
}

/// The model at a state and an acceleration: the common part of all jerks and currents there.
#[derive(Clone, Copy, Debug)]
pub struct LocalModel<'a> {
    model: &'a NominalModel,
    state: &'a State,
    /// Jerk of the motion alone, in m/s³.
    mechanical_jerk: f64,
    /// Derivative of the acceleration with respect to `ξ`.
    acceleration_by_fraction: f64,
    /// `dξ/dT` in 1/K on either branch.
    heating_per_kelvin: f64,
    cooling_per_kelvin: f64,
}

impl LocalModel<'_> {
    /// Makes the wire transform by these factors as fast with its temperature, when it is heated and when it cools.
    #[must_use]
    pub fn livelier(self, [heating, cooling]: [f64; 2]) -> Self {
        Self {
            heating_per_kelvin: heating * self.heating_per_kelvin,
            cooling_per_kelvin: cooling * self.cooling_per_kelvin,
            ..self
        }
    }

    /// Returns the rate of the fraction in 1/s for a jerk in m/s³, Eq. (13) solved for `dξ/dt`.
    pub fn fraction_rate(&self, jerk: f64) -> f64 {
        (jerk - self.mechanical_jerk) / self.acceleration_by_fraction.min(-AUTHORITY_MIN)
    }

    /// Returns `u = i²` in A² for a jerk in m/s³: Eq. (13) and (10) solved for `u`, on the branch of the wanted `dξ/dt`
    /// (PAPER E9).
    pub fn squared_current_for_jerk(&self, jerk: f64) -> f64 {
        let fraction_rate = self.fraction_rate(jerk);
        let per_kelvin = self.per_kelvin(NominalModel::branch(-fraction_rate));
        self.model.squared_current(
            self.state,
            fraction_rate / per_kelvin.min(-SLOPE_PER_KELVIN_MIN),
        )
    }

    /// Returns the jerk in m/s³ at `u = i²` in A², Eq. (13).
    pub fn jerk(&self, squared_current: f64) -> f64 {
        let rate = self.model.temperature_rate(self.state, squared_current);
        let per_kelvin = self.per_kelvin(NominalModel::branch(rate));
        self.mechanical_jerk + self.acceleration_by_fraction * per_kelvin * rate
    }

    fn per_kelvin(&self, branch: Branch) -> f64 {
        match branch {
            Branch::Heating => self.heating_per_kelvin,
            Branch::Cooling => self.cooling_per_kelvin,
        }
    }
}

/// The model with its precomputed constants.
#[derive(Clone, Debug)]
pub struct NominalModel {
    heat_capacity: f64,
    resistance: f64,
    loss: f64,
    rest_temperature: f64,
    heating_steepness: f64,
    heating_centre: f64,
    cooling_steepness: f64,
    cooling_centre: f64,
    austenite_stiffness: f64,
    elongation: f64,
    ratio: f64,
    inertia: f64,
    weight: f64,
    damping: f64,
    /// Derivative of the heating rate with respect to temperature in 1/s, Eq. (1).
    temperature_rate_by_temperature: f64,
    /// Denominators and the constant one of the derivatives of Eq. (7).
    acceleration_by_position_denominator: f64,
    acceleration_by_velocity: f64,
    acceleration_by_fraction_denominator: f64,
}

impl NominalModel {
    /// Computes the constants.
    pub fn new(config: &Config) -> Self {
        let convection = config.convection_watts_per_square_metre_kelvin
            * config.surface_square_metres_per_metre;
        let conduction = config.conduction_watts_per_metre_kelvin;
        let loss = convection + conduction;
        let elongation = config.recoverable_strain * config.wire_length_metres;
        let radius = config.wire_diameter_metres / 2.0;
        let outer = config.outer_pulley_radius_metres;
        let heat_capacity =
            config.mass_kilograms_per_metre * config.specific_heat_joules_per_kilogram_kelvin;
        let ratio = outer / config.inner_pulley_radius_metres;
        let inertia =
            config.pulley_inertia_kilogram_square_metres / (outer * outer) + config.load_kilograms;
        let damping = config.damping_newton_seconds_per_metre;
        Self {
            heat_capacity,
            resistance: config.resistance_ohms_per_metre,
            loss,
            rest_temperature: (convection * config.ambient_celsius
                + conduction * config.cooling_element_celsius)
                / loss,
            heating_steepness: TRANSFORMATION_STEEPNESS
                / (config.austenite_finish_celsius - config.austenite_start_celsius),
            heating_centre: (config.austenite_start_celsius + config.austenite_finish_celsius)
                / 2.0,
            cooling_steepness: TRANSFORMATION_STEEPNESS
                / (config.martensite_start_celsius - config.martensite_finish_celsius),
            cooling_centre: (config.martensite_start_celsius + config.martensite_finish_celsius)
                / 2.0,
            austenite_stiffness: config.austenite_modulus_pascals * PI * radius * radius
                / (config.wire_length_metres - elongation),
            elongation,
            ratio,
            inertia,
            weight: config.load_kilograms * GRAVITY,
            damping,
            temperature_rate_by_temperature: -loss / heat_capacity,
            acceleration_by_position_denominator: ratio * ratio * inertia,
            acceleration_by_velocity: -damping / inertia,
            acceleration_by_fraction_denominator: ratio * inertia,
        }
    }

    /// Returns the state before any current: cold, martensite, load on the stop.
    pub fn start(&self) -> State {
        State {
            martensite_fraction: self.heating_fraction(self.rest_temperature),
            temperature_celsius: self.rest_temperature,
            ..State::default()
        }
    }

    /// Returns the martensite fraction on the major heating branch, Eq. (2) with `ξm = 1`.
    pub fn heating_fraction(&self, temperature_celsius: f64) -> f64 {
        1.0 / (1.0 + self.exponential(Branch::Heating, temperature_celsius))
    }

    /// Returns the outer loop at a temperature.
    pub(crate) fn outer_loop(&self, temperature_celsius: f64) -> OuterLoop {
        let cooling = self.exponential(Branch::Cooling, temperature_celsius);
        OuterLoop {
            heating: self.heating_fraction(temperature_celsius),
            cooling: 1.0 / (1.0 + cooling),
        }
    }

    /// Returns `aA` and `aM` of Eq. (2) in 1/K.
    pub(crate) fn steepnesses(&self) -> [f64; 2] {
        [self.heating_steepness, self.cooling_steepness]
    }

    /// Returns the heating rate in K/s at `u = i²` in A², Eq. (1).
    #[inline]
    pub fn temperature_rate(&self, state: &State, squared_current: f64) -> f64 {
        (self.resistance * squared_current
            - self.loss * (state.temperature_celsius - self.rest_temperature))
            / self.heat_capacity
            + state.unknown_heating_kelvins_per_second
    }

    /// Returns `u = i²` in A² for a heating rate, Eq. (1) solved for `i²`.
    #[inline]
    pub fn squared_current(&self, state: &State, temperature_rate: f64) -> f64 {
        let unforced = self.temperature_rate(state, 0.0);
        (temperature_rate - unforced) * self.heat_capacity / self.resistance
    }

    /// Returns the derivative of the heating rate with respect to temperature in 1/s, Eq. (1).
    #[inline]
    pub fn temperature_rate_by_temperature(&self) -> f64 {
        self.temperature_rate_by_temperature
    }

    /// Returns the branch of a heating rate.
    #[inline]
    pub fn branch(temperature_rate: f64) -> Branch {
        if temperature_rate < 0.0 {
            Branch::Cooling
        } else {
            Branch::Heating
        }
    }

    /// Returns `dξ/dT` on a branch through the present state, Eq. (10) without the branch constants of PAPER E2.
    ///
    /// Heating: `ξ = ξm / (1 + E)` with `E = exp(aA (T − bA))` has `dξ/dT = −aA ξ E / (1 + E)`.
    /// Cooling: `ξ = (1 − ξA) / (1 + e) + ξA` with `e = exp(aM (T − bM))` has `dξ/dT = −aM (1 − ξ) / (1 + e)`.
    #[inline]
    pub fn slope(&self, state: &State, branch: Branch) -> Slope {
        let fraction = state.martensite_fraction;
        let (a, _) = self.transformation(branch);
        let martensite = 1.0 / (1.0 + self.exponential(branch, state.temperature_celsius));
        let austenite = 1.0 - martensite;
        match branch {
            Branch::Heating => Slope {
                per_kelvin: -a * fraction * austenite,
                by_fraction: -a * austenite,
                by_temperature: -a * a * fraction * austenite * martensite,
            },
            Branch::Cooling => Slope {
                per_kelvin: -a * (1.0 - fraction) * martensite,
                by_fraction: a * martensite,
                by_temperature: a * a * (1.0 - fraction) * austenite * martensite,
            },
        }
    }

    /// Returns the warming at `u = i²` in A² of a wire that transforms `liveliness` times as fast with its temperature,
    /// Eq. (1) and (10).
    #[inline]
    pub fn warming(&self, state: &State, squared_current: f64, liveliness: f64) -> Warming {
        let kelvins_per_second = self.temperature_rate(state, squared_current);
        let slope = self.slope(state, Self::branch(kelvins_per_second));
        Warming::new(kelvins_per_second, slope, liveliness)
    }

    /// Returns the curve of Eq. (2) that leaves the present state on a branch with a continuous fraction (PAPER E2).
    pub fn curve_through(&self, state: &State, branch: Branch) -> BranchCurve {
        let exponential = self.exponential(branch, state.temperature_celsius);
        let fraction = state.martensite_fraction;
        let floor = match branch {
            Branch::Heating => 0.0,
            Branch::Cooling => (fraction * (1.0 + exponential) - 1.0) / exponential,
        };
        let span = match branch {
            Branch::Heating => fraction * (1.0 + exponential),
            Branch::Cooling => 1.0 - floor,
        };
        BranchCurve {
            branch,
            span,
            floor,
        }
    }

    /// Returns the temperature of a fraction on a curve, Eq. (2) solved for `T` as in the bracket of Eq. (10).
    pub fn temperature_on(&self, curve: &BranchCurve, martensite_fraction: f64) -> f64 {
        let share =
            ((martensite_fraction - curve.floor) / curve.span).clamp(SHARE_MIN, 1.0 - SHARE_MIN);
        let (steepness, centre) = self.transformation(curve.branch);
        libm::log(1.0 / share - 1.0) / steepness + centre
    }

    /// Returns `exp(a (T − b))` of Eq. (2).
    fn exponential(&self, branch: Branch, temperature_celsius: f64) -> f64 {
        let (steepness, centre) = self.transformation(branch);
        libm::exp(steepness * (temperature_celsius - centre))
    }

    /// Returns `a` and `b` of Eq. (10).
    fn transformation(&self, branch: Branch) -> (f64, f64) {
        match branch {
            Branch::Heating => (self.heating_steepness, self.heating_centre),
            Branch::Cooling => (self.cooling_steepness, self.cooling_centre),
        }
    }

    /// Returns the stiffness of the wire in N/m, Eq. (9).
    #[inline]
    pub fn stiffness(&self, martensite_fraction: f64) -> f64 {
        self.austenite_stiffness * (1.0 - martensite_fraction)
    }

    /// Returns the acceleration in m/s² without the stop, Eq. (7); a wire does not push (PAPER E6).
    #[inline]
    pub fn acceleration(&self, state: &State) -> f64 {
        let stretch = self.elongation - state.position_metres / self.ratio;
        let tension = (self.stiffness(state.martensite_fraction) * stretch).max(0.0);
        (tension / self.ratio - self.weight - self.damping * state.velocity_metres_per_second)
            / self.inertia
    }

    /// Returns the derivatives of the acceleration with respect to position, velocity and fraction, Eq. (7).
    #[inline]
    pub fn acceleration_gradient(&self, state: &State) -> (f64, f64, f64) {
        let stretch = (self.elongation - state.position_metres / self.ratio).max(0.0);
        let stiffness = self.stiffness(state.martensite_fraction);
        (
            -stiffness / self.acceleration_by_position_denominator,
            self.acceleration_by_velocity,
            -self.austenite_stiffness * stretch / self.acceleration_by_fraction_denominator,
        )
    }

    /// Returns the model at a state with an acceleration in m/s².
    #[inline]
    pub fn at<'a>(&'a self, state: &'a State, acceleration: f64) -> LocalModel<'a> {
        let (by_position, by_velocity, by_fraction) = self.acceleration_gradient(state);
        LocalModel {
            model: self,
            state,
            mechanical_jerk: by_position * state.velocity_metres_per_second
                + by_velocity * acceleration,
            acceleration_by_fraction: by_fraction,
            heating_per_kelvin: self.slope(state, Branch::Heating).per_kelvin,
            cooling_per_kelvin: self.slope(state, Branch::Cooling).per_kelvin,
        }
    }

    /// Returns the fraction at which the wire just holds the load at rest, Eq. (12).
    pub fn holding_fraction(&self, position_metres: f64) -> f64 {
        let stretch = self.elongation - position_metres / self.ratio;
        1.0 - self.weight * self.ratio / (self.austenite_stiffness * stretch.max(f64::MIN_POSITIVE))
    }

    /// Returns the position at which the wire just holds the load at rest, Eq. (12) solved for `x`.
    pub fn holding_position(&self, martensite_fraction: f64) -> f64 {
        let stretch = self.weight * self.ratio / self.stiffness(martensite_fraction);
        (self.elongation - stretch) * self.ratio
    }

    /// Returns the position at which the wire has no stretch left.
    pub fn position_metres_max(&self) -> f64 {
        (self.elongation * self.ratio).max(0.0)
    }

    /// Returns the highest position that set-points may require: the load's rest position with the smallest martensite
    /// fraction. It is 0 for a wire that is too soft to lift its load.
    pub fn set_point_metres_max(&self) -> f64 {
        self.holding_position(MARTENSITE_FRACTION_MIN).max(0.0)
    }

    /// Returns the error of the parameter `nominal_model` if the wire cannot lift its load.
    pub(crate) fn objection(&self) -> Option<(&'static str, String)> {
        let reason = "a wire as soft or a load as heavy as here is lifted nowhere";
        let lifts = self.set_point_metres_max() > 0.0;
        (!lifts).then(|| ("nominal_model", reason.to_owned()))
    }

    /// Returns whether the load rests on the stop at `x = 0` and the wire cannot lift it (PAPER E6).
    #[inline]
    pub fn rests_on_stop(&self, state: &State) -> bool {
        state.position_metres <= 0.0
            && state.velocity_metres_per_second <= 0.0
            && self.acceleration(state) <= 0.0
    }

    /// Returns the state after a time at constant `u = i²` in A².
    pub fn advance(&self, state: &State, squared_current: f64, seconds: f64) -> State {
        let warming = self.warming(state, squared_current, 1.0);
        self.advance_from(state, &warming, squared_current, seconds)
    }

    /// Works as [`NominalModel::advance`], with the warming in this state already computed.
    pub fn advance_from(
        &self,
        state: &State,
        warming: &Warming,
        squared_current: f64,
        seconds: f64,
    ) -> State {
        let mut steps = 1;
        while steps < INTEGRATOR_STEPS_MAX && f64::from(steps) * INTEGRATOR_STEP_SECONDS < seconds {
            steps += 1;
        }
        let step = seconds / f64::from(steps);
        let first = self.integrate(state, warming, squared_current, step);
        (1..steps).fold(first, |state, _| {
            let warming = self.warming(&state, squared_current, warming.liveliness);
            self.integrate(&state, &warming, squared_current, step)
        })
    }

    /// Takes one step of the classical Runge-Kutta method, then applies the inelastic stop (PAPER E6).
    fn integrate(
        &self,
        state: &State,
        warming: &Warming,
        squared_current: f64,
        step: f64,
    ) -> State {
        let after = |rate: &Rate, seconds| {
            let moved = moved(state, rate, seconds);
            self.rate_of(&moved, squared_current, warming.liveliness)
        };
        let k1 = self.rate(state, warming);
        let k2 = after(&k1, step / 2.0);
        let k3 = after(&k2, step / 2.0);
        let k4 = after(&k3, step);
        let mean = |f: fn(&Rate) -> f64| (f(&k1) + 2.0 * f(&k2) + 2.0 * f(&k3) + f(&k4)) / 6.0;
        let rate = Rate {
            position: mean(|k| k.position),
            velocity: mean(|k| k.velocity),
            fraction: mean(|k| k.fraction),
            temperature: mean(|k| k.temperature),
        };
        stopped(moved(state, &rate, step))
    }

    // A step calls this three times in a row. Inlined, the results stay in registers from one to the next.
    #[inline(always)]
    fn rate_of(&self, state: &State, squared_current: f64, liveliness: f64) -> Rate {
        self.rate(state, &self.warming(state, squared_current, liveliness))
    }

    #[inline(always)]
    fn rate(&self, state: &State, warming: &Warming) -> Rate {
        let temperature = warming.kelvins_per_second;
        let [position, velocity] = if self.rests_on_stop(state) {
            [0.0, 0.0]
        } else {
            [state.velocity_metres_per_second, self.acceleration(state)]
        };
        Rate {
            position,
            velocity,
            fraction: warming.slope.per_kelvin * temperature,
            temperature,
        }
    }
}

fn moved(state: &State, rate: &Rate, seconds: f64) -> State {
    State {
        position_metres: state.position_metres + rate.position * seconds,
        velocity_metres_per_second: state.velocity_metres_per_second + rate.velocity * seconds,
        martensite_fraction: (state.martensite_fraction + rate.fraction * seconds).clamp(0.0, 1.0),
        temperature_celsius: state.temperature_celsius + rate.temperature * seconds,
        ..*state
    }
}

/// Applies the inelastic stop at `x = 0` (PAPER E6).
fn stopped(state: State) -> State {
    if state.position_metres > 0.0 {
        return state;
    }
    State {
        position_metres: 0.0,
        velocity_metres_per_second: state.velocity_metres_per_second.max(0.0),
        ..state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> NominalModel {
        NominalModel::new(&Config::default())
    }

    fn warm() -> State {
        State {
            position_metres: 0.02,
            velocity_metres_per_second: 0.05,
            martensite_fraction: 0.93,
            temperature_celsius: 54.0,
            unknown_heating_kelvins_per_second: 0.0,
        }
    }

    #[test]
    fn constants_of_the_paper() {
        assert!((model().austenite_stiffness - 16_362.0).abs() < 1.0);
        assert!((model().start().temperature_celsius - 15.0847).abs() < 1e-4);
        assert!((model().position_metres_max() - 0.06).abs() < 1e-12);
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_branch_curves() {
        let model = model();
        for branch in [Branch::Heating, Branch::Cooling] {
            let state = warm();
            let curve = model.curve_through(&state, branch);
            let step = 1e-6;
            let above = model.temperature_on(&curve, state.martensite_fraction + step);
            let below = model.temperature_on(&curve, state.martensite_fraction - step);
            let slope = model.slope(&state, branch).per_kelvin;
            assert!(
                (slope - 2.0 * step / (above - below)).abs() < 1e-6 * slope.abs(),
                "{branch:?}"
            );
            let back = model.temperature_on(&curve, state.martensite_fraction);
            assert!((back - state.temperature_celsius).abs() < 1e-9);
        }
    }

    #[test]
    fn slope_gradients_agree_with_differences() {
        let model = model();
        let step = 1e-6;
        for branch in [Branch::Heating, Branch::Cooling] {
            let slope_at = |fraction: f64, temperature: f64| {
                let state = State {
                    martensite_fraction: warm().martensite_fraction + fraction,
                    temperature_celsius: warm().temperature_celsius + temperature,
                    ..warm()
                };
                model.slope(&state, branch).per_kelvin
            };
            let slope = model.slope(&warm(), branch);
            let by_fraction = (slope_at(step, 0.0) - slope_at(-step, 0.0)) / (2.0 * step);
            let by_temperature = (slope_at(0.0, step) - slope_at(0.0, -step)) / (2.0 * step);
            assert!((slope.by_fraction - by_fraction).abs() < 1e-8);
            assert!((slope.by_temperature - by_temperature).abs() < 1e-8);
        }
    }

    #[test]
    fn heating_from_the_start_stays_on_the_major_branch() {
        let model = model();
        let state = model.advance(&model.start(), 0.4, 2.0 * 64e-3);
        let expected = model.heating_fraction(state.temperature_celsius);
        assert!((state.martensite_fraction - expected).abs() < 1e-9);
    }

    #[test]
    fn jerk_and_current_are_each_others_inverse() {
        let model = model();
        let state = warm();
        let local = model.at(&state, model.acceleration(&state));
        for squared_current in [0.0, 0.2, 0.5, 1.0] {
            let back = local.squared_current_for_jerk(local.jerk(squared_current));
            assert!((back - squared_current).abs() < 1e-9, "{squared_current}");
        }
    }

    #[test]
    fn jerk_is_the_derivative_of_the_acceleration() {
        let model = model();
        let before = warm();
        let after = model.advance(&before, 0.8, 1e-6);
        let difference = (model.acceleration(&after) - model.acceleration(&before)) / 1e-6;
        let jerk = model.at(&before, model.acceleration(&before)).jerk(0.8);
        assert!(
            (jerk - difference).abs() < 1e-3 * jerk.abs(),
            "{jerk} {difference}"
        );
    }

    #[test]
    fn holding_fraction_and_position_agree_and_hold() {
        let model = model();
        let state = State {
            position_metres: 0.03,
            martensite_fraction: model.holding_fraction(0.03),
            ..State::default()
        };
        assert!(model.acceleration(&state).abs() < 1e-9);
        let position = model.holding_position(state.martensite_fraction);
        assert!((position - 0.03).abs() < 1e-12);
    }

    #[test]
    fn the_load_falls_on_the_stop_and_stays() {
        let model = model();
        let mut state = State {
            position_metres: 0.005,
            martensite_fraction: 1.0,
            temperature_celsius: 15.0,
            ..State::default()
        };
        for _ in 0..1000 {
            state = model.advance(&state, 0.0, 1e-3);
            assert!(state.position_metres >= 0.0);
        }
        assert!(model.rests_on_stop(&state));
        assert_eq!(state.velocity_metres_per_second, 0.0);
    }
}
