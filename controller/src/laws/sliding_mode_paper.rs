//! Sliding mode as in the paper: Eq. (12) to (14) with PAPER E3 to E5 and E9; derivatives by filtering the position.

use scenario::controller::SlidingModePaper as Config;

use super::sliding_mode::{Surface, command, terms};
use crate::law::{CommandRange, Cycle, Law, LoopReads, Ports, one_loop};
use crate::nominal_model::{
    Branch, BranchCurve, MARTENSITE_FRACTION_MIN, NominalModel, State as ModelState,
};
use crate::reference_filter::{self, CriticallyDamped, JerkRange, Point, ReferenceFilter};

/// The law's constants.
#[derive(Clone, Debug)]
pub struct SlidingModePaper {
    surface: Surface,
    model: NominalModel,
    reference_filter: ReferenceFilter,
    derivative_filter: CriticallyDamped,
    is_as_printed: bool,
    current: CommandRange,
}

/// State of the law.
#[derive(Clone, Copy, Debug)]
pub struct State {
    reference: reference_filter::State,
    filtered: Point,
    curve: BranchCurve,
}

impl SlidingModePaper {
    /// Returns the model's state from the filtered position: the fraction by Eq. (12), the temperature by the present
    /// branch.
    fn estimate(&self, state: &State) -> ModelState {
        let position = state.filtered.position_metres;
        let martensite_fraction = self
            .model
            .holding_fraction(position)
            .clamp(MARTENSITE_FRACTION_MIN, 1.0);
        ModelState {
            position_metres: position,
            velocity_metres_per_second: state.filtered.velocity_metres_per_second,
            martensite_fraction,
            temperature_celsius: self.model.temperature_on(&state.curve, martensite_fraction),
            unknown_heating_kelvins_per_second: 0.0,
        }
    }
}

impl Law for SlidingModePaper {
    const NAME: &'static str = "sliding_mode_paper";
    type Config = Config;
    type State = State;

    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        let model = NominalModel::new(&config.nominal_model);
        let position_metres_max = model.set_point_metres_max();
        Self {
            surface: Surface {
                bandwidth: config.bandwidth_radians_per_second,
                boundary_layer: config.boundary_layer_metres_per_second_squared,
                switching_gain: config.switching_gain_metres_per_second_cubed,
            },
            reference_filter: ReferenceFilter::fixed(
                config.reference_filter_radians_per_second,
                position_metres_max,
            ),
            derivative_filter: CriticallyDamped {
                poles_radians_per_second: config.derivative_filter_radians_per_second,
            },
            is_as_printed: config.as_printed,
            model,
            current: commands[0],
        }
    }

    fn ports(&self) -> Ports {
        one_loop::<Self>(terms())
    }

    fn objection(&self) -> Option<(&'static str, String)> {
        self.model.objection()
    }

    fn start(&self) -> State {
        State {
            reference: reference_filter::State::default(),
            filtered: Point::default(),
            curve: self
                .model
                .curve_through(&self.model.start(), Branch::Heating),
        }
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let LoopReads {
            position: position_metres,
            set_point,
        } = LoopReads::of(reads);
        let period_seconds = cycle.period_seconds;
        if position_metres.is_finite() {
            state.filtered = self.derivative_filter.advance(
                &state.filtered,
                position_metres.clamp(0.0, self.model.position_metres_max()),
                period_seconds,
            );
        }
        let estimate = self.estimate(state);
        let acceleration = state.filtered.acceleration_metres_per_second_squared;
        let reference = self.reference_filter.step(
            &mut state.reference,
            &set_point,
            &JerkRange::UNLIMITED,
            period_seconds,
        );
        let wanted = self.surface.wanted_jerk(&state.filtered, &reference);
        let jerk = wanted.equivalent + wanted.switching;
        let local = self.model.at(&estimate, acceleration);
        let branch = NominalModel::branch(-local.fraction_rate(jerk));
        if branch != state.curve.branch {
            state.curve = self.model.curve_through(&estimate, branch);
        }
        let [equivalent, all] = if self.is_as_printed {
            let wanted_acceleration = self.surface.as_printed(&state.filtered, &reference);
            let equivalent = local.squared_current_for_jerk(wanted_acceleration);
            [equivalent, equivalent + wanted.switching]
        } else {
            [wanted.equivalent, jerk].map(|jerk| local.squared_current_for_jerk(jerk))
        };
        let command = command(
            &self.current,
            &estimate,
            &reference,
            &wanted,
            equivalent,
            all,
        );
        writes.copy_from_slice(&command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig::{hold, run, settling_and_overshoot};
    use scenario::controller::{Controller, NominalModel as ModelConfig};

    #[test]
    fn step_settles_slower_than_with_the_observer() {
        let controller = Controller {
            sliding_mode_paper: Some(Config::default()),
            ..Controller::default()
        };
        let rows = run(&controller, &ModelConfig::default(), 8.0, |time| {
            hold(if time < 5.0 { 0.01 } else { 0.035 })
        });
        let (settling, overshoot) = settling_and_overshoot(&rows, 5.0, 0.01, 0.035);
        assert!((0.25..0.5).contains(&settling), "{settling}");
        assert!(overshoot < 5.0, "{overshoot}");
    }

    /// Test of the erratum PAPER E4.
    #[test]
    fn the_law_as_printed_never_settles() {
        let controller = Controller {
            sliding_mode_paper: Some(Config {
                as_printed: true,
                ..Config::default()
            }),
            ..Controller::default()
        };
        let rows = run(&controller, &ModelConfig::default(), 8.0, |_| hold(0.02));
        let last = rows.iter().filter(|row| row.time_seconds > 7.0);
        let positions = last.map(|row| row.position_metres);
        let (least, most) = positions.fold((f64::INFINITY, 0.0), |(least, most), position| {
            (f64::min(least, position), f64::max(most, position))
        });
        assert!(
            most - least > 1e-3 || (most - 0.02).abs() > 5e-3,
            "{least} {most}"
        );
    }
}
