//! Values that a sweep gives to variables of an FMU: the FMU decides which ones are admitted, and no schema knows it.

use scenario::sweep::{Distribution, Sweep};
use scenario::{Objection, Trial};

/// Finds the first value of a sweep that the FMU of a loop's plant does not take. `objection` finds the problem of such an FMU.
/// Draws of normal distributions have no ends, so only their means are checked.
pub(crate) fn objection(
    trial: &Trial,
    sweep: &Sweep,
    objection: impl Fn(&Trial) -> Option<Objection>,
) -> Option<Objection> {
    trial.plant.fmu.as_ref()?;
    let start = format!("plant.{}.start.", trial.wiring.plant);
    values(sweep).into_iter().find_map(|(key, value)| {
        let variable = key.strip_prefix(&start)?;
        let mut tried = trial.clone();
        let fmu = tried.plant.fmu.as_mut()?;
        fmu.start.insert(variable.to_owned(), value.into());
        let path = format!("sweep.{key}");
        objection(&tried).map(|found| Objection { path, ..found })
    })
}

/// Returns the values that decide whether all values of a sweep are admitted, each with its key. A variable takes the numbers of a
/// range, or the whole ones of them; so these are the lowest value, the highest, and one that is not whole.
fn values(sweep: &Sweep) -> Vec<(String, f64)> {
    let mut all = Vec::new();
    for axis in sweep.axes() {
        let values = axis.values.iter().copied();
        let lowest = values.clone().min_by(f64::total_cmp);
        let highest = values.clone().max_by(f64::total_cmp);
        let telling = [lowest, highest, values.clone().find(is_broken)];
        let telling = telling.into_iter().flatten();
        all.extend(telling.map(|value| (axis.key.clone(), value)));
    }
    for (key, distribution) in sweep.distributions() {
        let telling = match distribution {
            Distribution::Uniform { from, to } | Distribution::LogUniform { from, to } => {
                vec![from, to, broken_between(from, to)]
            }
            Distribution::Normal { mean, .. } if is_broken(&mean) => vec![mean],
            // Nearly every draw is fractional, whatever the mean is.
            Distribution::Normal { mean, .. } => vec![mean, mean.next_down()],
        };
        all.extend(telling.into_iter().map(|value| (key.to_owned(), value)));
    }
    all
}

/// Checks whether a number is fractional.
fn is_broken(value: &f64) -> bool {
    value.fract() != 0.0
}

/// Returns a fractional number between two others, which are not neighbouring floats.
fn broken_between(from: f64, to: f64) -> f64 {
    let middle = from + (to - from) / 2.0;
    if is_broken(&middle) {
        middle
    } else {
        (middle - 0.5).max(from + (middle - from) / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::sweep::{List, Normal, Range, Spacing, Uniform};

    /// Returns the values of a sweep that are checked, without their places.
    fn looked_at(sweep: &Sweep) -> Vec<f64> {
        let values = values(sweep).into_iter();
        values.map(|(_, value)| value).collect()
    }

    fn range(count: u32) -> Sweep {
        let range = Range {
            key: "k".to_owned(),
            from: 1.0,
            to: 4.0,
            count: Some(count),
            step: None,
            spacing: Spacing::Linear,
        };
        Sweep {
            range: vec![range],
            ..Sweep::default()
        }
    }

    #[test]
    fn few_values_stand_for_all_of_a_sweep() {
        let key = || "k".to_owned();
        let values = vec![2.0, 9.0, 3.5, 1.0, 2.5];
        let list = Sweep {
            list: vec![List { key: key(), values }],
            ..Sweep::default()
        };
        assert_eq!(looked_at(&list), [1.0, 9.0, 3.5]);
        assert_eq!(looked_at(&range(4)), [1.0, 4.0]);
        assert_eq!(looked_at(&range(3)), [1.0, 4.0, 2.5]);
        let normal = Normal {
            key: key(),
            mean: 3.0,
            standard_deviation: 1.0,
        };
        let normal = Sweep {
            normal: vec![normal],
            ..Sweep::default()
        };
        assert_eq!(looked_at(&normal), [3.0, 3.0_f64.next_down()]);
        for [from, to] in [[1.0, 4.0], [1.0, 5.0], [1.0, 2.0], [0.0, 1e6], [0.8, 1.2]] {
            let key = key();
            let drawn = Sweep {
                uniform: vec![Uniform { key, from, to }],
                ..Sweep::default()
            };
            let seen = looked_at(&drawn);
            assert_eq!(seen[..2], [from, to]);
            let between = seen[2];
            assert!(
                is_broken(&between) && from < between && between < to,
                "{seen:?}"
            );
        }
    }
}
