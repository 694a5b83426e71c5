//! Turns of the wire's temperature, and the transformation of a wire that remembers them.
//!
//! A wire of Eq. (2) forgets each turn. A real one remembers it until its temperature passes the turn, as in Preisach's
//! model with the first cooling curves of Eq. (2) (Hughes and Wen; Gorbet and Morris). With the fractions `gh` and `gc`
//! of the outer loop, and `A = (1 − gh) / (1 − gc)`, its fraction is
//!
//! - `ξ = ξm − A(T) (gc(m) − gc(T))` in a heating from the turn `(m, ξm)`, and
//! - `ξ = ξM + A(M) (gc(T) − gc(M))` in a cooling from the turn `(M, ξM)`.
//!
//! Without a turn `gc(m)` and `A(M)` are 1, which is Eq. (2). Right behind a turn the wire hardly transforms.

use crate::nominal_model::{Branch, NominalModel};

/// Largest number of remembered turns.
const TURNS_MAX: usize = 16;

/// Temperatures of the turns that the wire has not passed since; the last one is on top. They alternate: with an even
/// number of turns the wire is heated, with an odd one it cools.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Turns {
    celsius: [f64; TURNS_MAX],
    count: usize,
}

impl Turns {
    /// Follows the temperature on a branch: remembers a turn, and forgets those that it passes. Without room the last
    /// inner loop is forgotten.
    pub(crate) fn follow(&mut self, temperature_celsius: f64, branch: Branch) {
        if branch != self.branch() {
            if self.count == TURNS_MAX {
                self.count -= 2;
            }
            self.celsius[self.count] = temperature_celsius;
            self.count += 1;
        }
        let is_passed = |turn: f64| match branch {
            Branch::Heating => temperature_celsius >= turn,
            Branch::Cooling => temperature_celsius <= turn,
        };
        // A correction of the estimate may take it back behind the last turn, which then is there.
        if let Some(last) = self.count.checked_sub(1)
            && !is_passed(self.celsius[last])
        {
            self.celsius[last] = temperature_celsius;
        }
        while self.count >= 2 && is_passed(self.celsius[self.count - 2]) {
            self.count -= 2;
        }
    }

    /// Moves the turns with the estimated temperature when it is corrected: its error was the same at the turns.
    pub(crate) fn shift(&mut self, kelvins: f64) {
        for celsius in &mut self.celsius[..self.count] {
            *celsius += kelvins;
        }
    }

    /// Returns `dξ/dT` in 1/K of heating and of cooling at a temperature. The other branch than the present one begins
    /// there.
    pub(crate) fn slopes(&self, model: &NominalModel, temperature_celsius: f64) -> [f64; 2] {
        let here = model.outer_loop(temperature_celsius);
        let last = self.count.checked_sub(1);
        let turn = last.map(|place| model.outer_loop(self.celsius[place]));
        let [heating_steepness, cooling_steepness] = model.steepnesses();
        let cooling_per_kelvin = cooling_steepness * here.cooling * (1.0 - here.cooling);
        let at_turn = -here.ratio() * cooling_per_kelvin;
        match self.branch() {
            Branch::Heating => {
                let way = turn.map_or(1.0, |turn| turn.cooling) - here.cooling;
                let growth = heating_steepness * here.heating - cooling_steepness * here.cooling;
                let heating = at_turn - here.ratio() * growth * way;
                [heating.min(0.0), at_turn]
            }
            Branch::Cooling => {
                let ratio = turn.map_or(1.0, |turn| turn.ratio());
                [at_turn, -ratio * cooling_per_kelvin]
            }
        }
    }

    fn branch(&self) -> Branch {
        if self.count.is_multiple_of(2) {
            Branch::Heating
        } else {
            Branch::Cooling
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::controller::NominalModel as Config;

    fn nominal() -> NominalModel {
        NominalModel::new(&Config::default())
    }

    /// Follows a temperature through turns, without a rate, and returns the fraction at each.
    fn fractions_at(turns: &[f64]) -> Vec<f64> {
        const STEPS: u32 = 2000;
        let model = nominal();
        let (mut memory, start) = (Turns::default(), model.start());
        let (mut temperature, mut fraction) =
            (start.temperature_celsius, start.martensite_fraction);
        let reached = turns.iter().map(|&to| {
            let step = (to - temperature) / f64::from(STEPS);
            let branch = NominalModel::branch(step);
            for _ in 0..STEPS {
                memory.follow(temperature, branch);
                temperature += step / 2.0;
                fraction += step * memory.slopes(&model, temperature)[branch as usize];
                temperature += step / 2.0;
            }
            // Without rounding, so that the turn counts as passed when it is reached again.
            temperature = to;
            fraction
        });
        reached.collect()
    }

    #[test]
    fn fractions_are_those_of_preisachs_model() {
        let turns = [
            75.0, 55.0, 65.0, 55.0, 65.0, 55.0, 75.0, 90.0, 40.0, 60.0, 50.0, 60.0, 100.0,
        ];
        // From an implementation of the function itself, in another language.
        let expected = [
            0.423_115, 0.578_539, 0.525_686, 0.578_539, 0.525_686, 0.578_539, 0.423_115, 0.066_920,
            0.882_453, 0.781_764, 0.832_108, 0.781_764, 0.014_994,
        ];
        for (found, expected) in fractions_at(&turns).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }

    #[test]
    fn a_correction_moves_the_turns_and_changes_no_way_to_them() {
        let mut turns = Turns::default();
        turns.follow(60.0, Branch::Cooling);
        turns.follow(55.0, Branch::Heating);
        turns.shift(1.5);
        turns.follow(61.4, Branch::Heating);
        assert_eq!(turns.count, 2);
        turns.follow(61.5, Branch::Heating);
        assert_eq!(turns.count, 0);
    }

    #[test]
    fn ever_smaller_loops_find_room() {
        let mut turns = Turns::default();
        for turn in 0..100_u32 {
            let width = 10.0 / f64::from(1 + turn);
            turns.follow(60.0 + width, Branch::Cooling);
            turns.follow(60.0 - width, Branch::Heating);
        }
        assert!(turns.count <= TURNS_MAX);
        let [heating, cooling] = turns.slopes(&nominal(), 60.0);
        assert!(heating < 0.0 && cooling < 0.0);
        turns.follow(80.0, Branch::Heating);
        assert_eq!(turns.count, 0);
    }
}
