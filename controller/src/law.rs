//! What every control law is: a configuration, a state, and a pure step.

use std::fmt;

use dbc::LawTerm;
use scenario::own::Parameters;
use scenario::reference::SetPoint;

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

/// The terms of the shipped laws worth recording; zero where a law has no such term.
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
    /// How far the law backs off since it rings, from 0 to 1 (0x2206).
    pub caution: f64,
    /// Part of `u = i²` that keeps the state on the sliding surface (0x2207).
    pub equivalent_part_square_amperes: f64,
    /// Part of `u = i²` that drives the state to the sliding surface (0x2208).
    pub switching_part_square_amperes: f64,
}

impl Explanation {
    /// The same with positions in another unit.
    pub(crate) fn times(self, factor: f64) -> Self {
        Self {
            reference_position_metres: self.reference_position_metres * factor,
            reference_velocity_metres_per_second: self.reference_velocity_metres_per_second
                * factor,
            estimated_velocity_metres_per_second: self.estimated_velocity_metres_per_second
                * factor,
            ..self
        }
    }
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
/// which the [`Explanation`] or the law's own [`Term`]s are published. An observer is the law's own: its state is a part of
/// `State`.
pub trait ControlLaw: fmt::Debug + Send + 'static {
    /// Its name, and that of its table in a scenario.
    const NAME: &'static str;
    /// Its parameters: what a scenario's table is read into.
    type Config: Parameters;
    /// What it remembers from cycle to cycle. `Copy` owns nothing on the heap.
    type State: Copy + fmt::Debug + Send;

    /// Terms of its own that are worth recording, at most [`LAW_TERMS_MAX`](dbc::LAW_TERMS_MAX), every 10th cycle. A law
    /// with any publishes the reference only of its [`Explanation`]: they take the place of the rest.
    const TERMS: &'static [Term<Self::State>] = &[];

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

/// A term of a law's own: a real number of 32 bits on the bus.
#[derive(Debug)]
pub struct Term<S> {
    /// Its name in recording and report; the unit is its end.
    pub name: &'static str,
    /// The unit; empty for a number without one.
    pub unit: &'static str,
    /// What it is.
    pub comment: &'static str,
    /// Reads it after a step.
    pub value: fn(&S) -> f64,
}

impl<S> Term<S> {
    /// As the bus has it.
    pub(crate) fn described(&self) -> LawTerm {
        LawTerm {
            name: self.name.to_owned(),
            unit: self.unit.to_owned(),
            comment: self.comment.to_owned(),
        }
    }
}

/// A control law of a loop with several drives; as [`ControlLaw`], with a current for each of them.
pub trait LawOfSeveral: fmt::Debug + Send + 'static {
    /// Its name, and that of its table in a scenario.
    const NAME: &'static str;
    /// How many drives it leads.
    const DRIVES: usize;
    /// Its parameters: what a scenario's table is read into.
    type Config: Parameters;
    /// What it remembers from cycle to cycle.
    type State: Copy + fmt::Debug + Send;

    /// As [`ControlLaw::TERMS`].
    const TERMS: &'static [Term<Self::State>] = &[];

    /// Works out the constants.
    fn new(config: &Self::Config) -> Self;

    /// The memory before the first cycle.
    fn start(&self) -> Self::State;

    /// Writes the currents that act from the next cycle on, in the order of the loop's drives, and says why. The measurement is
    /// that of the first drive. Allocates nothing; finite for any measurement.
    fn step(
        &self,
        state: &mut Self::State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
        currents_amperes: &mut [f64],
    ) -> Explanation;
}

/// A law of one drive as one of several.
#[derive(Debug)]
struct Alone<L>(L);

impl<L: ControlLaw> LawOfSeveral for Alone<L> {
    const NAME: &'static str = L::NAME;
    const DRIVES: usize = 1;
    type Config = L::Config;
    type State = L::State;
    const TERMS: &'static [Term<L::State>] = L::TERMS;

    fn new(config: &L::Config) -> Self {
        Self(L::new(config))
    }

    fn start(&self) -> L::State {
        self.0.start()
    }

    #[inline]
    fn step(
        &self,
        state: &mut L::State,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
        currents_amperes: &mut [f64],
    ) -> Explanation {
        let command = (self.0).step(state, measurement, set_point, period_seconds);
        currents_amperes[0] = command.current_amperes;
        command.explanation
    }
}

/// A law with its memory and the currents of its latest step.
#[derive(Debug)]
struct Running<L: LawOfSeveral> {
    law: L,
    state: L::State,
    currents_amperes: Vec<f64>,
}

/// A law with its memory, whichever it is.
trait Step: fmt::Debug + Send {
    fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command;

    /// The current of one more drive that it leads, from 1 on, after the latest step.
    fn further_amperes(&self, place: usize) -> f64;

    fn terms(&self) -> Vec<LawTerm>;

    fn terms_count(&self) -> usize;

    fn term_value(&self, place: usize) -> f64;
}

impl<L: LawOfSeveral> Step for Running<L> {
    fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        let currents = &mut self.currents_amperes;
        let explanation = self.law.step(
            &mut self.state,
            measurement,
            set_point,
            period_seconds,
            currents,
        );
        Command {
            current_amperes: currents.first().copied().unwrap_or_default(),
            explanation,
        }
    }

    fn further_amperes(&self, place: usize) -> f64 {
        let current = self.currents_amperes.get(place);
        current.copied().unwrap_or_default()
    }

    fn terms(&self) -> Vec<LawTerm> {
        L::TERMS.iter().map(Term::described).collect()
    }

    fn terms_count(&self) -> usize {
        L::TERMS.len()
    }

    fn term_value(&self, place: usize) -> f64 {
        (L::TERMS[place].value)(&self.state)
    }
}

/// What the controller node runs.
#[derive(Debug)]
pub struct Law(Box<dyn Step>);

impl Law {
    /// A law with these constants, before its first cycle.
    #[must_use]
    pub fn of<L: ControlLaw>(config: &L::Config) -> Self {
        Self::of_several::<Alone<L>>(config)
    }

    /// As [`Law::of`], for a law that leads several drives.
    #[must_use]
    pub fn of_several<L: LawOfSeveral>(config: &L::Config) -> Self {
        let law = L::new(config);
        Self(Box::new(Running {
            state: law.start(),
            law,
            currents_amperes: vec![0.0; L::DRIVES],
        }))
    }

    /// The current of one more drive that the law leads, after the latest step; `place` counts the loop's drives, the first one is
    /// 0.
    #[must_use]
    pub fn further_amperes(&self, place: usize) -> f64 {
        sound_current(self.0.further_amperes(place))
    }

    /// Its own terms, in their order.
    #[must_use]
    pub fn terms(&self) -> Vec<LawTerm> {
        self.0.terms()
    }

    /// The values of its own terms after the latest step, in their order. Allocates nothing.
    pub fn term_values(&self) -> impl Iterator<Item = f64> {
        (0..self.0.terms_count()).map(|place| self.0.term_value(place))
    }

    /// Computes the command that acts from the next cycle on. Allocates nothing; finite for any measurement.
    pub fn step(
        &mut self,
        measurement: &Measurement,
        set_point: &SetPoint,
        period_seconds: f64,
    ) -> Command {
        let command = self.0.step(measurement, set_point, period_seconds);
        Command {
            current_amperes: sound_current(command.current_amperes),
            ..command
        }
    }
}

/// A law from outside may ask for anything; what is no current at all is none.
pub(crate) fn sound_current(current_amperes: f64) -> f64 {
    if current_amperes.is_nan() {
        return 0.0;
    }
    limited_current_from(-CURRENT_AMPERES_MAX, current_amperes)
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
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a whole number, limited to a few thousands"
    )]
    let thousandths = (limited * 1000.0).round() as i32;
    f64::from(thousandths) / 1000.0
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
    use crate::catalogue::law;
    use proptest::prelude::*;
    use scenario::controller::{self, Controller};

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
    fn current_is_limited_and_in_whole_thousandths() {
        assert_eq!(limited_current(f64::NAN), 0.0);
        assert_eq!(limited_current(-1.0), 0.0);
        assert_eq!(limited_current(f64::INFINITY), 1.0);
        assert_eq!(limited_current(0.56789), 0.568);
    }

    /// Asks for whatever stands as the target, and publishes it.
    #[derive(Debug)]
    struct Wild;

    impl ControlLaw for Wild {
        const NAME: &'static str = "wild";
        type Config = controller::OpenLoop;
        type State = f64;
        const TERMS: &'static [Term<f64>] = &[Term {
            name: "wish_amperes",
            unit: "A",
            comment: "What it asks for.",
            value: |state| *state,
        }];

        fn new(_: &Self::Config) -> Self {
            Self
        }

        fn start(&self) -> f64 {
            0.0
        }

        fn step(&self, state: &mut f64, _: &Measurement, wish: &SetPoint, _: f64) -> Command {
            *state = wish.position_metres;
            Command {
                current_amperes: wish.position_metres,
                ..Command::default()
            }
        }
    }

    #[test]
    fn whatever_a_law_asks_for_a_current_comes_out_and_the_wish_is_published() {
        let mut law = Law::of::<Wild>(&controller::OpenLoop::default());
        assert_eq!(law.terms()[0].name, "wish_amperes");
        let wishes = [0.1234567, 7.0, -7.0, f64::INFINITY, f64::NAN];
        for (wish, current) in wishes.into_iter().zip([0.123, 1.0, -1.0, 1.0, 0.0]) {
            let set_point = SetPoint {
                position_metres: wish,
                ..SetPoint::default()
            };
            let command = law.step(&Measurement::default(), &set_point, 1e-3);
            assert_eq!(command.current_amperes, current);
            let published: Vec<u64> = law.term_values().map(f64::to_bits).collect();
            assert_eq!(published, [wish.to_bits()]);
        }
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
                let mut law = law(&controller).unwrap();
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
