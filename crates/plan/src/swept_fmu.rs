//! Values that a sweep gives to variables of an FMU: the FMU decides which ones are admitted, and no schema knows it.

use scenario::Objection;
use scenario::plant::PlantModel;
use scenario::sweep::{LogUniform, Sweep, Uniform};

use crate::catalogue::FindPlantObjection;

/// Value of a sweep, with its place in the scenario and its key.
type Swept<'a> = (String, &'a str, f64);

/// Finds the first value of a sweep that the FMU of a plant does not take. `objection` finds the problem of such an FMU.
/// Draws of normal distributions have no ends, so only their means are checked.
pub(crate) fn objection(
    name: &str,
    plant: &PlantModel,
    sweep: &Sweep,
    objection: FindPlantObjection,
) -> Option<Objection> {
    let start = format!("plant.{name}.start.");
    values(sweep).into_iter().find_map(|(path, key, value)| {
        let variable = key.strip_prefix(&start)?;
        let mut tried = plant.clone();
        let fmu = tried.fmu.as_mut()?;
        fmu.start.insert(variable.to_owned(), value.into());
        objection(&tried).map(|found| Objection { path, ..found })
    })
}

/// Returns the values that decide whether all values of a sweep are admitted. A variable takes the numbers of a range, or the
/// whole ones of them; so these are the lowest value, the highest, and one that is not whole.
fn values(sweep: &Sweep) -> Vec<Swept<'_>> {
    let mut values = Vec::new();
    for (index, list) in sweep.list.iter().enumerate() {
        let places = list.values.iter().enumerate();
        let order = |one: &(usize, &f64), other: &(usize, &f64)| one.1.total_cmp(other.1);
        let ends = [
            places.clone().min_by(order),
            places.clone().max_by(order),
            places.clone().find(|(_, value)| is_broken(value)),
        ];
        values.extend(ends.into_iter().flatten().map(|(place, value)| {
            let path = format!("sweep.list.{index}.values.{place}");
            (path, list.key.as_str(), *value)
        }));
    }
    let mut between = |entry: (&str, usize), key, [from, to]: [f64; 2], broken: Option<f64>| {
        let (kind, index) = entry;
        let path = |place| format!("sweep.{kind}.{index}.{place}");
        let all = [("from", Some(from)), ("to", Some(to)), ("key", broken)];
        let given = all.map(|(place, value)| Some((path(place), key, value?)));
        values.extend(given.into_iter().flatten());
    };
    for (index, one) in sweep.range.iter().enumerate() {
        let broken = one.values().into_iter().find(is_broken);
        between(("range", index), &*one.key, [one.from, one.to], broken);
    }
    for (index, Uniform { key, from, to }) in sweep.uniform.iter().enumerate() {
        let broken = Some(broken_between(*from, *to));
        between(("uniform", index), key, [*from, *to], broken);
    }
    for (index, LogUniform { key, from, to }) in sweep.log_uniform.iter().enumerate() {
        let broken = Some(broken_between(*from, *to));
        between(("log_uniform", index), key, [*from, *to], broken);
    }
    for (index, one) in sweep.normal.iter().enumerate() {
        let path = format!("sweep.normal.{index}");
        values.push((format!("{path}.mean"), one.key.as_str(), one.mean));
        // Nearly every draw is fractional, whatever the mean is.
        let broken = [one.mean, one.mean.next_down()].into_iter().find(is_broken);
        values.extend(broken.map(|value| (format!("{path}.key"), one.key.as_str(), value)));
    }
    values
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
        values.map(|(_, _, value)| value).collect()
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
