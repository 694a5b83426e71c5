//! Turns of the temperature, and the slope of a wire that remembers them.
//!
//! A wire of Eq. (2) with continuous turns (PAPER E2) forgets each turn. One that remembers them hardly transforms until
//! its temperature has passed the last one. The slope is that of Preisach's model, whose Everett function follows from
//! the first cooling curves of Eq. (2). In the first heating both wires are the same.

use super::{Branch, NominalModel, Slope, State};

/// Number of turns that are remembered. A turn beyond them is not: the branch runs back along itself.
const TURNS_MAX: usize = 16;

/// Turns of the temperature that it has not passed since, the oldest first. Those from heating to cooling come first and then
/// alternate with the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Turns {
    celsius: [f64; TURNS_MAX],
    count: usize,
}

/// Effect of the last turn on the slopes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LastTurn {
    /// From cooling to heating: the martensite on the first cooling curve there; 1 before any turn.
    Lowest(f64),
    /// From heating to cooling: the austenite on the first heating curve there, relative to that on the first cooling
    /// curve.
    Highest(f64),
}

impl Default for LastTurn {
    /// Returns the effect of the start, from which the wire heats for the first time.
    fn default() -> Self {
        Self::Lowest(1.0)
    }
}

/// Memory of a wire.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    /// Share of its slope that is that of a wire that remembers its turns, from 0 to 1.
    pub share: f64,
    /// Effect of the last turn.
    pub last_turn: LastTurn,
}

impl Turns {
    /// Branch since the last turn.
    fn branch(&self) -> Branch {
        if self.count.is_multiple_of(2) {
            Branch::Heating
        } else {
            Branch::Cooling
        }
    }

    /// Follows the temperature on a branch. Returns whether the last turn is another one.
    fn follow(&mut self, temperature_celsius: f64, branch: Branch) -> bool {
        let before = self.count;
        self.forget(temperature_celsius);
        if branch != self.branch() {
            if let Some(turn) = self.celsius.get_mut(self.count) {
                *turn = temperature_celsius;
                self.count += 1;
            } else {
                self.count -= 1;
            }
            self.forget(temperature_celsius);
        }
        self.count != before
    }

    /// Forgets the loops that the temperature has closed.
    fn forget(&mut self, temperature_celsius: f64) {
        while let Some(pair) = self.count.checked_sub(2) {
            let passed = match self.branch() {
                Branch::Heating => temperature_celsius >= self.celsius[pair],
                Branch::Cooling => temperature_celsius <= self.celsius[pair],
            };
            if !passed {
                return;
            }
            self.count = pair;
        }
    }
}

impl NominalModel {
    /// Follows the turns of a state that warms at a rate in K/s.
    pub(crate) fn follow(&self, turns: &mut Turns, state: &mut State, kelvins_per_second: f64) {
        let branch = Self::branch(kelvins_per_second);
        if !turns.follow(state.temperature_celsius, branch) {
            return;
        }
        let last = turns.count.checked_sub(1).map(|last| turns.celsius[last]);
        state.memory.last_turn = last.map_or_else(LastTurn::default, |celsius| match branch {
            Branch::Heating => LastTurn::Lowest(self.martensite(Branch::Cooling, celsius)),
            Branch::Cooling => LastTurn::Highest(self.austenite_since(celsius)),
        });
    }

    /// Returns the slope of Preisach's model with the branch's own martensite share at this temperature.
    #[inline]
    pub(super) fn remembering_slope(
        &self,
        temperature_celsius: f64,
        branch: Branch,
        martensite: f64,
        last_turn: LastTurn,
    ) -> Slope {
        match branch {
            Branch::Heating => {
                let cooling_martensite = self.martensite(Branch::Cooling, temperature_celsius);
                let at_turn = match last_turn {
                    LastTurn::Lowest(martensite) => martensite.max(cooling_martensite),
                    LastTurn::Highest(_) => cooling_martensite,
                };
                self.heating_since(at_turn, 1.0 - martensite, cooling_martensite)
            }
            Branch::Cooling => {
                let share = match last_turn {
                    LastTurn::Highest(share) => share,
                    LastTurn::Lowest(_) => self.austenite_since(temperature_celsius),
                };
                let a = self.cooling_steepness;
                let per_kelvin = -a * share * martensite * (1.0 - martensite);
                Slope {
                    per_kelvin,
                    by_fraction: 0.0,
                    by_temperature: per_kelvin * a * (2.0 * martensite - 1.0),
                }
            }
        }
    }

    /// Returns the slope of heating from a turn, with the austenite on the first heating curve and the martensite on the first
    /// cooling curve: that of the Everett function `A (cm − c) / (1 − c)`.
    #[inline]
    fn heating_since(&self, at_turn: f64, austenite: f64, cooling_martensite: f64) -> Slope {
        let (a, b) = (self.heating_steepness, self.cooling_steepness);
        let kept = cooling_martensite * (1.0 - at_turn)
            / (1.0 - cooling_martensite).max(f64::MIN_POSITIVE);
        let (gone, grows) = (at_turn - kept, a * (1.0 - austenite));
        let bends = a * (1.0 - 2.0 * austenite);
        Slope {
            per_kelvin: -austenite * (grows * gone + b * kept),
            by_fraction: 0.0,
            by_temperature: -austenite * (grows * bends * gone + (2.0 * grows - b) * b * kept),
        }
    }

    /// Returns the austenite of a cooling that starts here, relative to that on the first cooling curve: at most 1, where the
    /// branches of heating and cooling are as Eq. (2) means them.
    fn austenite_since(&self, celsius: f64) -> f64 {
        let austenite = 1.0 - self.martensite(Branch::Heating, celsius);
        let cooling_austenite = 1.0 - self.martensite(Branch::Cooling, celsius);
        (austenite / cooling_austenite.max(f64::MIN_POSITIVE)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::controller::NominalModel as Config;

    /// Turns of a test of kinetics, and the fraction at each on a wire that remembers them (Preisach) and on the paper's.
    const TURNS: [(f64, f64, f64); 13] = [
        (75.0, 0.423_115, 0.423_115),
        (55.0, 0.578_539, 0.578_539),
        (65.0, 0.525_686, 0.476_253),
        (55.0, 0.578_539, 0.599_592),
        (65.0, 0.525_686, 0.493_584),
        (55.0, 0.578_539, 0.612_842),
        (75.0, 0.423_115, 0.275_229),
        (90.0, 0.066_920, 0.043_530),
        (40.0, 0.882_453, 0.879_507),
        (60.0, 0.781_764, 0.780_705),
        (50.0, 0.832_108, 0.874_556),
        (60.0, 0.781_764, 0.793_512),
        (100.0, 0.014_994, 0.013_484),
    ];

    /// Largest part of a kelvin in one step of an integration.
    const STEP_KELVINS: f64 = 0.01;

    fn model() -> NominalModel {
        NominalModel::new(&Config::default())
    }

    /// Takes the state to a temperature along the slope of a wire that remembers, or of one that forgets.
    fn follow(
        model: &NominalModel,
        turns: &mut Turns,
        state: &mut State,
        to_celsius: f64,
        remembers: bool,
    ) {
        let way = to_celsius - state.temperature_celsius;
        let steps = (way.abs() / STEP_KELVINS).ceil();
        let step = way / steps;
        let branch = NominalModel::branch(way);
        let mut left = steps;
        while left > 0.0 {
            model.follow(turns, state, way);
            let celsius = state.temperature_celsius + step / 2.0;
            let martensite = model.martensite(branch, celsius);
            let slope = if remembers {
                let last_turn = state.memory.last_turn;
                model.remembering_slope(celsius, branch, martensite, last_turn)
            } else {
                model.forgetting_slope(state.martensite_fraction, branch, martensite)
            };
            // The second order: the slope at the middle of the step.
            let middle = slope.per_kelvin + slope.by_fraction * slope.per_kelvin * step / 2.0;
            state.martensite_fraction += middle * step;
            state.temperature_celsius += step;
            left -= 1.0;
        }
        state.temperature_celsius = to_celsius;
    }

    fn fractions(remembers: bool) -> Vec<f64> {
        let model = model();
        let mut turns = Turns::default();
        let mut state = model.start();
        let targets = TURNS.iter().map(|turn| turn.0);
        let fractions = targets.map(|celsius| {
            follow(&model, &mut turns, &mut state, celsius, remembers);
            state.martensite_fraction
        });
        fractions.collect()
    }

    #[test]
    fn a_wire_that_remembers_closes_its_loops() {
        for (found, (celsius, expected, _)) in fractions(true).iter().zip(TURNS) {
            assert!(
                (found - expected).abs() < 5e-5,
                "{celsius}: {found} {expected}"
            );
        }
    }

    #[test]
    fn a_wire_that_forgets_drifts() {
        for (found, (celsius, _, expected)) in fractions(false).iter().zip(TURNS) {
            assert!(
                (found - expected).abs() < 5e-5,
                "{celsius}: {found} {expected}"
            );
        }
    }

    #[test]
    fn the_slope_lies_between_both_by_the_memorys_share() {
        let model = model();
        let last_turn = LastTurn::Lowest(model.martensite(Branch::Cooling, 55.0));
        let slope = |share| {
            let state = State {
                martensite_fraction: 0.6,
                temperature_celsius: 60.0,
                memory: Memory { share, last_turn },
                ..State::default()
            };
            model.slope(&state, Branch::Heating).per_kelvin
        };
        let martensite = model.martensite(Branch::Heating, 60.0);
        let forgets = model.forgetting_slope(0.6, Branch::Heating, martensite);
        let remembers = model.remembering_slope(60.0, Branch::Heating, martensite, last_turn);
        let (forgets, remembers) = (forgets.per_kelvin, remembers.per_kelvin);
        assert!((remembers - forgets).abs() > 0.1 * forgets.abs());
        assert_eq!(slope(0.0), forgets);
        assert!((slope(1.0) - remembers).abs() < 1e-15);
        assert!((slope(0.25) - 0.75 * forgets - 0.25 * remembers).abs() < 1e-15);
    }

    #[test]
    fn gradients_agree_with_differences() {
        let model = model();
        let turned = [
            LastTurn::Lowest(model.martensite(Branch::Cooling, 50.0)),
            LastTurn::Highest(model.austenite_since(80.0)),
        ];
        for (branch, last_turn) in [Branch::Heating, Branch::Cooling].into_iter().zip(turned) {
            let slope_at = |celsius: f64| {
                let martensite = model.martensite(branch, celsius);
                model.remembering_slope(celsius, branch, martensite, last_turn)
            };
            let difference = (slope_at(60.001).per_kelvin - slope_at(59.999).per_kelvin) / 0.002;
            let found = slope_at(60.0).by_temperature;
            assert!((found - difference).abs() < 1e-8, "{found} {difference}");
        }
    }

    #[test]
    fn passed_turns_are_forgotten_and_a_full_memory_drops_the_newest() {
        let mut turns = Turns::default();
        assert!(!turns.follow(80.0, Branch::Heating));
        for (count, (celsius, branch)) in (1..).zip([
            (80.0, Branch::Cooling),
            (60.0, Branch::Heating),
            (70.0, Branch::Cooling),
            (65.0, Branch::Heating),
        ]) {
            assert!(turns.follow(celsius, branch));
            assert_eq!(turns.count, count);
        }
        assert!(!turns.follow(69.0, Branch::Heating));
        assert!(turns.follow(70.0, Branch::Heating));
        assert_eq!(turns.count, 2);
        assert!(turns.follow(80.0, Branch::Heating));
        assert_eq!(turns.count, 0);
        // Narrower and narrower loops.
        for turn in 0..20_u32 {
            let narrow = f64::from(turn) * 0.1;
            let (celsius, branch) = if turn % 2 == 0 {
                (80.0 - narrow, Branch::Cooling)
            } else {
                (60.0 + narrow, Branch::Heating)
            };
            turns.follow(celsius, branch);
            assert!(turns.count <= TURNS_MAX);
            assert_eq!(turns.branch(), branch);
        }
    }
}
