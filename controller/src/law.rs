//! What every control law is: a configuration, a state, and a pure step.

use std::fmt;

use scenario::controller::Controller;
use scenario::reference::SetPoint;

use crate::open_loop::OpenLoop;
use crate::pid::Pid;
use crate::sliding_mode::SlidingMode;
use crate::sliding_mode_paper::SlidingModePaper;

/// Largest current in A; commands lie between 0, or what a law's table says, and this.
pub const CURRENT_AMPERES_MAX: f64 = 1.0;

/// Largest `u = i²` in A².
pub const SQUARED_CURRENT_MAX: f64 = CURRENT_AMPERES_MAX * CURRENT_AMPERES_MAX;

/// What the controller knows of the plant in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measurement {
    /// Time since the start of the scenario.
    pub scenario_time_seconds: f64,
    /// Position as sampled by the drive; not finite when this cycle brought none.
    pub position_metres: f64,
}

/// What a law commands, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Current for the next cycle, at most [`CURRENT_AMPERES_MAX`], in whole thousandths.
    pub current_amperes: f64,
    /// The terms behind it.
    pub explanation: Explanation,
}

/// The terms of a law worth recording; zero where a law has no such term.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Explanation {
    /// Filtered reference position (0x2200).
    pub reference_position_metres: f64,
    /// Filtered reference velocity (0x2201).
    pub reference_velocity_metres_per_second: f64,
    /// Estimated wire temperature (0x2202).
    pub estimated_temperature_celsius: f64,
    /// Estimated martensite fraction (0x2203).
    pub estimated_martensite_fraction: f64,
    /// Estimated velocity (0x2204).
    pub estimated_velocity_metres_per_second: f64,
    /// Sliding variable `s` (0x2205).
    pub sliding_variable_metres_per_second_squared: f64,
    /// Where the command or the load is limited (0x2206).
    pub saturation: Saturation,
    /// Part of `u = i²` that keeps the state on the sliding surface (0x2207).
    pub equivalent_part_square_amperes: f64,
    /// Part of `u = i²` that drives the state to the sliding surface (0x2208).
    pub switching_part_square_amperes: f64,
}

/// Limits reached in a cycle.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub struct Saturation {
    /// The law asked for more than the largest current.
    pub at_upper_limit: bool,
    /// The law asked for less than the smallest current.
    pub at_lower_limit: bool,
    /// The load rests on the stop.
    pub on_stop: bool,
}

impl Saturation {
    /// As in object 0x2206: bit 0 upper limit, bit 1 lower limit, bit 2 on the stop.
    #[must_use]
    pub fn bits(self) -> u8 {
        u8::from(self.at_upper_limit)
            | u8::from(self.at_lower_limit) << 1
            | u8::from(self.on_stop) << 2
    }
}

/// A control law: a table of the scenario in, constants in `self`, memory in `State`, a command out.
///
/// The controller node owns the rest: the drive, SYNC, set-point, missing and implausible positions, and the objects in
/// which the [`Explanation`] is told. An observer is the law's own: its state is a part of `State`.
pub trait ControlLaw: fmt::Debug + Send + 'static {
    /// Its table in the scenario.
    type Config;
    /// What it remembers from cycle to cycle. `Copy` owns nothing on the heap.
    type State: Copy + fmt::Debug + Send;

    /// Works out the constants.
    fn new(config: &Self::Config) -> Self;

    /// The memory before the first cycle.
    fn start(&self) -> Self::State;

    /// Computes the command that acts from the next cycle on. Allocates nothing; finite for any measurement.
    fn step(
        &self,
        state: &mut Self::State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command;
}

/// A law with its memory.
#[derive(Debug)]
struct Running<L: ControlLaw> {
    law: L,
    state: L::State,
}

/// A law with its memory, whichever it is.
trait Step: fmt::Debug + Send {
    fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command;
}

impl<L: ControlLaw> Step for Running<L> {
    fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        self.law
            .step(&mut self.state, measurement, set_point, period_seconds)
    }
}

/// What the controller node runs.
#[derive(Debug)]
pub struct Law(Box<dyn Step>);

/// Why a `[controller]` table selects no law.
#[derive(Clone, Copy, Debug, Eq, PartialEq, thiserror::Error)]
pub enum LawError {
    /// No table or several.
    #[error("the [controller] table must hold exactly one law, found {0}")]
    NotExactlyOne(usize),
}

impl Law {
    /// A law with these constants, before its first cycle.
    #[must_use]
    pub fn of<L: ControlLaw>(config: &L::Config) -> Self {
        let law = L::new(config);
        let state = law.start();
        Self(Box::new(Running { law, state }))
    }

    /// The one law in a scenario's `[controller]` table, before its first cycle.
    ///
    /// # Errors
    ///
    /// [`LawError::NotExactlyOne`] when the table holds none or several.
    pub fn from_scenario(controller: &Controller) -> Result<Self, LawError> {
        let laws = [
            controller
                .sliding_mode
                .as_ref()
                .map(Self::of::<SlidingMode>),
            (controller.sliding_mode_paper.as_ref()).map(Self::of::<SlidingModePaper>),
            controller.pid.as_ref().map(Self::of::<Pid>),
            controller.open_loop.as_ref().map(Self::of::<OpenLoop>),
        ];
        let mut laws = laws.into_iter().flatten();
        match (laws.next(), laws.count()) {
            (Some(law), 0) => Ok(law),
            (first, others) => Err(LawError::NotExactlyOne(
                usize::from(first.is_some()) + others,
            )),
        }
    }

    /// Computes the command that acts from the next cycle on. Allocates nothing; finite for any measurement.
    pub fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        self.0.step(measurement, set_point, period_seconds)
    }
}

/// A current as the bus carries it: from 0 to the largest and in whole thousandths of an ampere; not a number becomes 0.
#[must_use]
pub fn limited_current(current_amperes: f64) -> f64 {
    limited_current_from(0.0, current_amperes)
}

/// As [`limited_current`], from a smallest current that may be below 0; not a number becomes it.
#[must_use]
pub fn limited_current_from(amperes_min: f64, current_amperes: f64) -> f64 {
    // `clamp` would keep a NaN.
    let limited = current_amperes.max(amperes_min).min(CURRENT_AMPERES_MAX);
    libm::round(limited * 1000.0) / 1000.0
}

/// The current of a wanted `u = i²`, and which limit it met.
#[must_use]
pub fn current_of(squared_current: f64) -> (f64, Saturation) {
    let current = limited_current(libm::sqrt(squared_current.max(0.0)));
    let saturation = Saturation {
        at_upper_limit: squared_current > SQUARED_CURRENT_MAX,
        at_lower_limit: squared_current < 0.0,
        on_stop: false,
    };
    (current, saturation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scenario::controller;

    fn all_laws() -> [Controller; 4] {
        let none = Controller::default();
        [
            Controller {
                sliding_mode: Some(controller::SlidingMode::default()),
                ..none.clone()
            },
            Controller {
                sliding_mode_paper: Some(controller::SlidingModePaper::default()),
                ..none.clone()
            },
            Controller {
                pid: Some(controller::Pid::default()),
                ..none.clone()
            },
            Controller {
                open_loop: Some(controller::OpenLoop::default()),
                ..none
            },
        ]
    }

    #[test]
    fn exactly_one_law_is_selected() {
        let none = Controller::default();
        assert_eq!(
            Law::from_scenario(&none).unwrap_err(),
            LawError::NotExactlyOne(0)
        );
        for one in all_laws() {
            assert!(Law::from_scenario(&one).is_ok());
        }
        let two = Controller {
            pid: Some(controller::Pid::default()),
            open_loop: Some(controller::OpenLoop::default()),
            ..none
        };
        assert_eq!(
            Law::from_scenario(&two).unwrap_err(),
            LawError::NotExactlyOne(2)
        );
    }

    #[test]
    fn current_is_limited_and_in_whole_thousandths() {
        assert_eq!(limited_current(f64::NAN), 0.0);
        assert_eq!(limited_current(-1.0), 0.0);
        assert_eq!(limited_current(f64::INFINITY), 1.0);
        assert_eq!(limited_current(0.56789), 0.568);
    }

    fn is_sound(command: &Command) -> bool {
        let terms = &command.explanation;
        (0.0..=CURRENT_AMPERES_MAX).contains(&command.current_amperes)
            && terms.reference_position_metres.is_finite()
            && terms.estimated_temperature_celsius.is_finite()
            && (0.0..=1.0).contains(&terms.estimated_martensite_fraction)
            && terms.estimated_velocity_metres_per_second.is_finite()
            && terms.sliding_variable_metres_per_second_squared.is_finite()
            && terms.equivalent_part_square_amperes.is_finite()
            && terms.switching_part_square_amperes.is_finite()
    }

    fn any_position() -> impl Strategy<Value = f64> {
        prop_oneof![
            8 => 0.0..0.06_f64,
            1 => any::<f64>(),
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
        ]
    }

    proptest! {
        #[test]
        fn commands_are_sound_for_any_measurement(
            positions in prop::collection::vec(any_position(), 1..300),
            target in -0.1..0.1_f64,
        ) {
            for controller in all_laws() {
                let mut law = Law::from_scenario(&controller).unwrap();
                for (cycle, &position_metres) in positions.iter().enumerate() {
                    let measurement = Measurement {
                        scenario_time_seconds: f64::from(u16::try_from(cycle).unwrap()) * 1e-3,
                        position_metres,
                    };
                    let set_point = SetPoint { position_metres: target, ..SetPoint::default() };
                    let command = law.step(&measurement, &set_point, 1e-3);
                    prop_assert!(is_sound(&command), "{command:?}");
                }
            }
        }
    }
}
