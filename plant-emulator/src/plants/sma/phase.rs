//! Phase transformation with hysteresis.

use scenario::plant::{self, Kinetics};

use super::curve::{Curve, Point, Sigmoid, Whole};
use super::turns::{TURNS_MAX, Turn, Turns};

/// Branch of the hysteresis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Branch {
    /// The wire warms: martensite becomes austenite.
    Heating,
    /// The wire cools: austenite becomes martensite.
    Cooling,
}

/// The transformation with its memory of turns, which determines the present curve.
#[derive(Clone, Debug)]
pub(super) struct Transformation {
    kinetics: Kinetics,
    heating: Sigmoid,
    cooling: Sigmoid,
    branch: Branch,
    turns: Turns,
    curve: Curve,
    /// Temperature of the next remembered turn that the wire passes; infinite if there is none.
    next_turn_celsius: f64,
    /// Whether the wire follows the last curve back, after a turn that did not fit into the memory.
    runs_back: bool,
    turns_not_remembered: u16,
}

impl Transformation {
    /// Makes a wire of martensite only, on the heating branch with `ξm = 1`.
    pub(super) fn new(config: &plant::Phase, kinetics: Kinetics) -> Self {
        let heating = Sigmoid::new(
            config.austenite_start_celsius,
            config.austenite_finish_celsius,
        );
        Self {
            kinetics,
            heating,
            cooling: Sigmoid::new(
                config.martensite_start_celsius,
                config.martensite_finish_celsius,
            ),
            branch: Branch::Heating,
            turns: Turns::none(),
            curve: Curve::Whole(Whole {
                sigmoid: heating,
                origin: 0.0,
                amplitude: 1.0,
            }),
            next_turn_celsius: f64::INFINITY,
            runs_back: false,
            turns_not_remembered: 0,
        }
    }

    /// Returns the number of turns that did not fit into the memory.
    pub(super) fn turns_not_remembered(&self) -> u16 {
        self.turns_not_remembered
    }

    /// Returns `ξ` and `dξ/dT` on the present branch; beyond a remembered turn, on the branch that continues there.
    pub(super) fn at(&self, temperature_celsius: f64) -> Point {
        if self.is_passed(temperature_celsius) {
            self.behind_turns(temperature_celsius)
        } else {
            self.curve.at(temperature_celsius)
        }
    }

    /// Returns the curve of Eq. (2), if the wire passes no remembered turn on it.
    #[inline]
    pub(super) fn endless(&self) -> Option<&Whole> {
        match &self.curve {
            Curve::Whole(whole) if self.next_turn_celsius.is_infinite() => Some(whole),
            _ => None,
        }
    }

    /// Returns `ξ` on the present branch.
    #[inline]
    pub(super) fn martensite_fraction(&self, temperature_celsius: f64) -> f64 {
        match self.endless() {
            Some(curve) => curve.martensite_fraction(temperature_celsius),
            None => self.at(temperature_celsius).martensite_fraction,
        }
    }

    /// Returns `dξ/dT`, which only a wire with latent heat needs.
    #[cold]
    pub(super) fn fraction_per_kelvin(&self, temperature_celsius: f64) -> f64 {
        self.at(temperature_celsius).fraction_per_kelvin
    }

    #[cold]
    fn behind_turns(&self, temperature_celsius: f64) -> Point {
        let mut further = self.clone();
        further.forget_passed(temperature_celsius);
        further.curve.at(temperature_celsius)
    }

    /// Takes the branch for the sign of `dT/dt`; zero keeps it. The curves of both branches pass through the point of a turn
    /// (PAPER E2). Returns whether there was a turn.
    #[inline]
    pub(super) fn follow(&mut self, rate_kelvin_per_second: f64, temperature_celsius: f64) -> bool {
        let branch = if rate_kelvin_per_second > 0.0 {
            Branch::Heating
        } else if rate_kelvin_per_second < 0.0 {
            Branch::Cooling
        } else {
            return false;
        };
        self.forget_passed(temperature_celsius);
        if branch == self.branch {
            return false;
        }
        self.turn(branch, temperature_celsius);
        true
    }

    #[cold]
    fn turn(&mut self, branch: Branch, temperature_celsius: f64) {
        let turn = Turn {
            temperature_celsius,
            martensite_fraction: self.at(temperature_celsius).martensite_fraction,
        };
        self.branch = branch;
        self.remember(turn);
        self.forget_passed(temperature_celsius);
    }

    fn remember(&mut self, turn: Turn) {
        if !self.kinetics.remembers_turns() {
            self.turns.forget(TURNS_MAX);
        }
        if !self.runs_back && self.turns.remember(turn) {
            self.curve = self.curve();
        } else {
            self.runs_back = !self.runs_back;
            self.turns_not_remembered = self.turns_not_remembered.saturating_add(1);
        }
        self.next_turn_celsius = self.next_turn_celsius();
    }

    /// Forgets the turns that `T` passes. Each is forgotten together with the later one, which ended the loop that
    /// closes there.
    #[inline]
    fn forget_passed(&mut self, temperature_celsius: f64) {
        while self.is_passed(temperature_celsius) {
            self.forget_last();
        }
    }

    #[cold]
    fn forget_last(&mut self) {
        self.turns.forget(self.turns_of_curve());
        self.runs_back = false;
        self.curve = self.curve();
        self.next_turn_celsius = self.next_turn_celsius();
    }

    #[inline]
    fn is_passed(&self, temperature_celsius: f64) -> bool {
        match self.branch {
            Branch::Heating => temperature_celsius >= self.next_turn_celsius,
            Branch::Cooling => temperature_celsius <= self.next_turn_celsius,
        }
    }

    /// Returns the number of turns to forget at the end of the curve: the two at its ends, or on the way back the one
    /// that it came from.
    fn turns_of_curve(&self) -> usize {
        if self.runs_back { 1 } else { 2 }
    }

    fn next_turn_celsius(&self) -> f64 {
        let next = self.turns.all().iter().nth_back(self.turns_of_curve() - 1);
        let never = match self.branch {
            Branch::Heating => f64::INFINITY,
            Branch::Cooling => f64::NEG_INFINITY,
        };
        next.map_or(never, |turn| turn.temperature_celsius)
    }

    /// Returns the curve of the branch since the last turn. Kinetics differ only here. The first heating and every
    /// first cooling are those of Eq. (2).
    fn curve(&self) -> Curve {
        match (self.kinetics, self.turns.all()) {
            (Kinetics::Paper, turns) | (_, turns @ ([] | [_])) => self.whole(turns.last()),
            (Kinetics::Nested, [.., before, last]) => self.scaled(last, before),
            (Kinetics::Preisach, [.., last]) => self.everett(last),
        }
    }

    fn sigmoid(&self) -> Sigmoid {
        match self.branch {
            Branch::Heating => self.heating,
            Branch::Cooling => self.cooling,
        }
    }

    /// Returns a curve of Eq. (2) whose amplitude takes it through a turn at `(Tr, ξr)` (PAPER E2).
    ///
    /// Heating: `ξ = ξm / (1 + exp(aA (T − bA)))` with `ξm = ξr (1 + exp(aA (Tr − bA)))`; the first time `ξm = 1`.
    /// Cooling, with the slope of Eq. (10) (PAPER E1): `ξ = (1 − ξA) / (1 + 1/e) + ξA` with `e = exp(−aM (T − bM))`, written as
    /// `1 − ξ = (1 − ξA) / (1 + e)`, which loses no digits in the cold, with `1 − ξA = (1 − ξr) (1 + exp(−aM (Tr − bM)))`.
    fn whole(&self, turn: Option<&Turn>) -> Curve {
        let sigmoid = self.sigmoid();
        let origin = match self.branch {
            Branch::Heating => 0.0,
            Branch::Cooling => 1.0,
        };
        let amplitude = turn.map_or(1.0, |turn| {
            (turn.martensite_fraction - origin) * sigmoid.denominator(turn.temperature_celsius)
        });
        Curve::Whole(Whole {
            sigmoid,
            origin,
            amplitude,
        })
    }

    /// Returns the branch `g` of Eq. (2), scaled from the last turn `(T₁, ξ₁)` to the one before, `(T₂, ξ₂)`:
    /// `ξ = ξ₁ + (ξ₂ − ξ₁) (g(T₁) − g(T)) / (g(T₁) − g(T₂))`, where `g(T₁) − g(T) = (e − e₁) / (D D₁)`.
    fn scaled(&self, last: &Turn, before: &Turn) -> Curve {
        let sigmoid = self.sigmoid();
        let at_last = sigmoid.exponential(last.temperature_celsius);
        let at_before = sigmoid.exponential(before.temperature_celsius);
        // A branch that is flat between the turns cannot be scaled.
        let amplitude = if at_before > at_last {
            (before.martensite_fraction - last.martensite_fraction) * (1.0 + at_before)
                / (at_before - at_last)
        } else {
            0.0
        };
        Curve::Part {
            sigmoid,
            origin: last.martensite_fraction,
            exponential_at_turn: at_last,
            amplitude,
        }
    }

    /// Returns a curve of Preisach's model, by the Everett function of the first cooling curves of Eq. (2):
    /// `F(α, β) = (1 − gA(α)) (gM(β) − gM(α)) / (1 − gM(α))`. Heating from a turn `(m, ξm)`: `ξ = ξm − F(T, m)`; cooling
    /// from `(M, ξM)`: `ξ = ξM + F(M, T)`.
    fn everett(&self, last: &Turn) -> Curve {
        let origin = last.martensite_fraction;
        let exponential_at_turn = self.cooling.exponential(last.temperature_celsius);
        match self.branch {
            Branch::Heating => Curve::TakenBack {
                heating: self.heating,
                cooling: self.cooling,
                origin,
                exponential_at_turn,
            },
            Branch::Cooling => {
                let heated = self.heating.exponential(last.temperature_celsius);
                Curve::Part {
                    sigmoid: self.cooling,
                    origin,
                    exponential_at_turn,
                    amplitude: heated / (1.0 + heated),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::turns::TURNS_MAX;
    use super::*;

    const ALL: [Kinetics; 3] = [Kinetics::Paper, Kinetics::Nested, Kinetics::Preisach];
    const REMEMBERING: [Kinetics; 2] = [Kinetics::Nested, Kinetics::Preisach];
    /// Temperature of a wire without current.
    const START_CELSIUS: f64 = 15.084_735_31;

    /// A wire that follows a sequence of temperatures.
    #[derive(Clone)]
    struct Led {
        phase: Transformation,
        celsius: f64,
    }

    impl Led {
        fn new(kinetics: Kinetics) -> Self {
            Self {
                phase: Transformation::new(&plant::Phase::default(), kinetics),
                celsius: START_CELSIUS,
            }
        }

        /// Moves to a temperature, and returns `ξ`.
        fn to(&mut self, celsius: f64) -> f64 {
            self.phase.follow(celsius - self.celsius, self.celsius);
            self.celsius = celsius;
            self.at(celsius)
        }

        fn at(&self, celsius: f64) -> f64 {
            self.phase.at(celsius).martensite_fraction
        }
    }

    fn transformation() -> Transformation {
        Led::new(Kinetics::Paper).phase
    }

    /// Returns `gA` or `gM` of Eq. (2), written literally.
    fn heating(celsius: f64) -> f64 {
        1.0 / (1.0 + libm::exp(6.2 / (93.0 - 53.0) * (celsius - 73.0)))
    }

    fn cooling(celsius: f64) -> f64 {
        1.0 / (1.0 + libm::exp(6.2 / (66.0 - 34.0) * (celsius - 50.0)))
    }

    /// A plain implementation of the rules: a list of turns, without precomputed values.
    struct Plain {
        kinetics: Kinetics,
        turns: Vec<(f64, f64)>,
        celsius: f64,
        is_heating: bool,
    }

    impl Plain {
        fn fraction(&self, celsius: f64) -> f64 {
            let g = if self.is_heating { heating } else { cooling };
            match self.turns[..] {
                [] => heating(celsius),
                [(turn, fraction)] => {
                    1.0 - (1.0 - fraction) * (1.0 - cooling(celsius)) / (1.0 - cooling(turn))
                }
                [.., (t2, xi2), (t1, xi1)] if self.kinetics == Kinetics::Nested => {
                    xi1 + (xi2 - xi1) * (g(t1) - g(celsius)) / (g(t1) - g(t2))
                }
                [.., (turn, fraction)] => {
                    let everett = |alpha: f64, beta: f64| {
                        (1.0 - heating(alpha)) * (cooling(beta) - cooling(alpha))
                            / (1.0 - cooling(alpha))
                    };
                    if self.is_heating {
                        fraction - everett(celsius, turn)
                    } else {
                        fraction + everett(turn, celsius)
                    }
                }
            }
        }

        fn to(&mut self, celsius: f64) -> f64 {
            if celsius != self.celsius && (celsius > self.celsius) != self.is_heating {
                let turn = (self.celsius, self.fraction(self.celsius));
                self.is_heating = !self.is_heating;
                self.turns.push(turn);
            }
            self.celsius = celsius;
            while self.turns.len() >= 2 {
                let (passed, _) = self.turns[self.turns.len() - 2];
                let is_passed = if self.is_heating {
                    celsius >= passed
                } else {
                    celsius <= passed
                };
                if !is_passed {
                    break;
                }
                self.turns.truncate(self.turns.len() - 2);
            }
            self.fraction(celsius)
        }
    }

    /// The way leads from a cold wire to these temperatures; the fractions have six digits.
    #[test]
    fn turns_lead_to_the_values_of_each_kinetics() {
        let way = [
            75.0, 55.0, 65.0, 55.0, 65.0, 55.0, 75.0, 90.0, 40.0, 60.0, 50.0, 60.0, 100.0,
        ];
        for (kinetics, expected) in [
            (
                Kinetics::Paper,
                ".423115 .578539 .476253 .599592 .493584 .612842 .275229 .043530 .879507 .780705 .874556 .793512 .013484",
            ),
            (
                Kinetics::Nested,
                ".423115 .578539 .528658 .578539 .528658 .578539 .423115 .066920 .882453 .784225 .833339 .784225 .014994",
            ),
            (
                Kinetics::Preisach,
                ".423115 .578539 .525686 .578539 .525686 .578539 .423115 .066920 .882453 .781764 .832108 .781764 .014994",
            ),
        ] {
            let mut wire = Led::new(kinetics);
            let found = way
                .map(|celsius| format!("{:.6}", wire.to(celsius)))
                .each_ref()
                .map(|digits| &digits[1..])
                .join(" ");
            assert_eq!(found, expected, "{kinetics:?}");
        }
    }

    #[test]
    fn the_first_heating_and_every_first_cooling_are_the_paper_s() {
        for kinetics in REMEMBERING {
            for turn in [20.0, 45.0, 60.0, 75.0, 90.0, 130.0] {
                let (mut paper, mut wire) = (Led::new(Kinetics::Paper), Led::new(kinetics));
                for celsius in [turn, turn - 1.0, turn - 10.0, turn - 60.0] {
                    assert_eq!(paper.to(celsius), wire.to(celsius), "{turn} {celsius}");
                }
            }
        }
    }

    #[test]
    fn the_centre_of_the_heating_branch_is_half_martensite() {
        assert!((transformation().at(73.0).martensite_fraction - 0.5).abs() < 1e-15);
    }

    #[test]
    fn cooling_matches_the_paper_with_the_sign_of_equation_10() {
        let mut wire = Led::new(Kinetics::Paper);
        wire.to(80.0);
        wire.to(79.0);
        let fraction = wire.at(80.0);
        // These are ξA from PAPER E2 and ξ from Eq. (2), written literally.
        let exponential = |t: f64| libm::exp(6.2 / (66.0 - 34.0) * (t - 50.0));
        let e = exponential(80.0);
        let xi_a = (fraction * (1.0 + e) - 1.0) / e;
        for temperature in [80.0, 66.0, 50.0, 34.0, 15.0] {
            let expected = (1.0 - xi_a) / (1.0 + exponential(temperature)) + xi_a;
            let found = wire.at(temperature);
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
        assert!(wire.at(15.0) > wire.at(50.0));
    }

    #[test]
    fn turns_are_continuous_and_a_zero_rate_keeps_the_branch() {
        for kinetics in ALL {
            let mut phase = Led::new(kinetics).phase;
            for (rate, temperature) in [(-1.0, 75.0), (1.0, 45.0), (-1.0, 70.0), (1.0, 62.0)] {
                let before = phase.at(temperature).martensite_fraction;
                phase.follow(rate, temperature);
                let after = phase.at(temperature).martensite_fraction;
                assert!((after - before).abs() < 1e-15);
                let branch = phase.branch;
                phase.follow(0.0, temperature);
                assert_eq!(phase.branch, branch);
            }
        }
    }

    /// PAPER E2: loops between two temperatures close to 1e-3 after about ten cycles.
    #[test]
    fn minor_loops_of_the_paper_converge() {
        let mut wire = Led::new(Kinetics::Paper);
        let tops = Vec::from_iter((0..12).map(|_| {
            wire.to(55.0);
            wire.to(75.0)
        }));
        assert!((tops[1] - tops[0]).abs() > 1e-3, "{tops:?}");
        assert!((tops[11] - tops[10]).abs() < 1e-3, "{tops:?}");
    }

    /// Each turn lies between the two before it, until the memory is full. From then on the wire moves back and forth
    /// on one curve, and leaves it at its beginning.
    #[test]
    fn a_turn_that_finds_no_room_leads_back_along_the_same_curve() {
        for kinetics in REMEMBERING {
            let mut wire = Led::new(kinetics);
            let turns = Vec::from_iter((0..TURNS_MAX).map(|turn| {
                let from_middle = 20.0 - 0.25 * turn as f64;
                let sign = if turn % 2 == 0 { 1.0 } else { -1.0 };
                let celsius = 65.0 + sign * from_middle;
                (celsius, wire.to(celsius))
            }));
            wire.to(64.0);
            assert_eq!(wire.phase.turns_not_remembered(), 0);
            let on_the_way = [62.0, 63.0, 64.0].map(|celsius| wire.at(celsius));
            let back = [62.0, 63.0].map(|celsius| wire.clone().to(celsius));
            assert_eq!(back[..], on_the_way[..2]);
            wire.to(62.0);
            wire.to(63.0);
            assert_eq!(wire.phase.turns_not_remembered(), 2);
            assert_eq!(wire.to(64.0), on_the_way[2]);
            wire.to(62.0);
            assert_eq!(wire.phase.turns_not_remembered(), 3);
            // The wire passes the last turn, and each one before it on the way out.
            for (celsius, fraction) in turns.into_iter().rev() {
                let found = wire.to(celsius);
                assert!((found - fraction).abs() < 1e-12, "{found} {fraction}");
            }
            assert_eq!(wire.phase.turns_not_remembered(), 3);
        }
    }

    #[test]
    fn the_slope_is_the_derivative_on_every_curve() {
        for kinetics in ALL {
            let mut wire = Led::new(kinetics);
            for celsius in [80.0, 45.0, 75.0, 50.0, 70.0, 55.0, 96.0, 20.0] {
                let before = wire.celsius;
                wire.to(celsius);
                let middle = 0.5 * (before + celsius);
                let slope = (wire.at(middle + 1e-4) - wire.at(middle - 1e-4)) / 2e-4;
                let found = wire.phase.at(middle).fraction_per_kelvin;
                assert!(found < 0.0);
                assert!((found - slope).abs() < 1e-8, "{kinetics:?} {found} {slope}");
            }
        }
    }

    #[test]
    fn extreme_temperatures_stay_finite() {
        let narrow = plant::Phase {
            austenite_start_celsius: 72.999,
            austenite_finish_celsius: 73.0,
            ..plant::Phase::default()
        };
        for kinetics in ALL {
            let mut wire = Led {
                phase: Transformation::new(&narrow, kinetics),
                celsius: START_CELSIUS,
            };
            for celsius in [1e9, -1e9, 73.0, 20.0, 72.9, 25.0, 72.0, 26.0, 1e9, 20.0] {
                wire.to(celsius);
                for rate in [1.0, -1.0, 1.0] {
                    let point = wire.phase.at(celsius);
                    assert!((0.0..=1.0).contains(&point.martensite_fraction));
                    assert!(point.fraction_per_kelvin.is_finite());
                    assert!(point.fraction_per_kelvin <= 0.0);
                    wire.phase.follow(rate, celsius);
                }
            }
        }
    }

    fn remembering() -> impl Strategy<Value = Kinetics> {
        prop::sample::select(REMEMBERING.to_vec())
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn memory_and_curves_follow_the_rules_as_written(
            kinetics in remembering(),
            way in prop::collection::vec(prop_oneof![10.0..130.0_f64, 40.0..80.0_f64, Just(60.0)], 1..60),
        ) {
            let mut wire = Led::new(kinetics);
            let mut plain = Plain {
                kinetics,
                turns: Vec::new(),
                celsius: START_CELSIUS,
                is_heating: true,
            };
            for celsius in way {
                let (found, expected) = (wire.to(celsius), plain.to(celsius));
                prop_assert!((found - expected).abs() < 1e-10, "{found} {expected}");
                prop_assert!((0.0..=1.0).contains(&found));
                prop_assert_eq!(wire.phase.turns_not_remembered(), 0);
            }
        }

        /// Nested loops: on the way out each turn is passed again.
        #[test]
        fn loops_close(
            kinetics in remembering(),
            shares in prop::collection::vec(0.01..0.99_f64, 2..20),
        ) {
            let mut wire = Led::new(kinetics);
            let (mut low, mut high) = (START_CELSIUS, 110.0);
            let turns = Vec::from_iter(shares.iter().enumerate().map(|(turn, share)| {
                let celsius = low + share * (high - low);
                match turn % 2 {
                    0 => high = celsius,
                    _ => low = celsius,
                }
                (celsius, wire.to(celsius))
            }));
            for (celsius, fraction) in turns.into_iter().rev().skip(1) {
                let found = wire.to(celsius);
                prop_assert!((found - fraction).abs() < 1e-12, "{found} {fraction}");
            }
        }
    }
}
