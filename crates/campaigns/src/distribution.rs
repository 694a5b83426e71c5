//! Distributions of the values of many runs, from the sorted values.

/// Returns the least value that `percent` per cent of the sorted ones do not exceed; `None` if there are no values.
pub fn quantile(sorted: &[f64], percent: usize) -> Option<f64> {
    let rank = (percent * sorted.len()).div_ceil(100).max(1);
    sorted.get(rank - 1).copied()
}

/// Returns the percentage of values up to each of them, as a staircase that rises at each value.
pub fn staircase(sorted: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let count = sorted.len().max(1);
    let percent = |number: usize| 100.0 * number as f64 / count as f64;
    let x = sorted.iter().flat_map(|value| [*value; 2]);
    let y = (0..sorted.len()).flat_map(|number| [percent(number), percent(number + 1)]);
    (x.collect(), y.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_p95_is_the_190th_of_200() {
        let values: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!(quantile(&values, 95), Some(190.0));
        assert_eq!(quantile(&values, 50), Some(100.0));
        assert_eq!(quantile(&values, 0), Some(1.0));
        assert_eq!(quantile(&values, 100), Some(200.0));
        assert_eq!(quantile(&[], 95), None);
    }

    #[test]
    fn the_stairs_go_from_0_to_100() {
        let (x, y) = staircase(&[1.0, 3.0]);
        assert_eq!(x, [1.0, 1.0, 3.0, 3.0]);
        assert_eq!(y, [0.0, 50.0, 50.0, 100.0]);
    }
}
