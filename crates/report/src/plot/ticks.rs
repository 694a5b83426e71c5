//! Round values on an axis, with their labels.

/// Approximate number of ticks on an axis.
const TICKS: f64 = 6.0;
/// Largest number of characters of a label that has room next to another.
const LABEL_CHARACTERS_MAX: usize = 7;

/// Returns round values in a range, with their labels.
pub(super) fn ticks((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let rough = (high - low) / TICKS;
    let exponent = libm::floor(libm::log10(rough));
    let decade = libm::pow(10.0, exponent);
    let factors = [1.0, 2.0, 5.0, 10.0];
    let factor = factors
        .into_iter()
        .find(|factor| factor * decade >= rough * 0.999);
    let step = factor.unwrap_or(10.0) * decade;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to a few digits"
    )]
    let decimals = (-libm::floor(libm::log10(step) + 1e-9)).clamp(0.0, 9.0) as usize;
    let first = libm::ceil(low / step - 1e-9);
    let mut ticks = Vec::new();
    for number in 0..20 {
        let value = (first + f64::from(number)) * step;
        if value > high + step * 1e-9 {
            break;
        }
        // Adding 0 makes -0 a 0.
        let label = label(value + 0.0, step, decimals);
        ticks.push((value, label));
    }
    ticks
}

/// Returns labels that have room next to each other: every second one if they are long.
pub(super) fn apart(ticks: Vec<(f64, String)>) -> Vec<(f64, String)> {
    let is_long = |(_, label): &(f64, String)| label.chars().count() > LABEL_CHARACTERS_MAX;
    let step = if ticks.iter().any(is_long) { 2 } else { 1 };
    ticks.into_iter().step_by(step).collect()
}

/// Writes a label. A power of ten makes a large number short, but not one that differs from the next in its last digits.
fn label(value: f64, step: f64, decimals: usize) -> String {
    if value.abs() >= 1e5 && step >= 1e4 {
        return format!("{value:e}").replace('-', "−");
    }
    format!("{value:.decimals$}").replace('-', "−")
}

/// Returns the powers of ten in a range of logarithms.
pub(super) fn decades((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let powers = (0..12)
        .map(f64::from)
        .filter(|power| (low..=high).contains(power));
    powers
        .map(|power| (power, format!("{}", libm::round(libm::pow(10.0, power)))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(low: f64, high: f64) -> Vec<String> {
        ticks((low, high))
            .into_iter()
            .map(|(_, label)| label)
            .collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(labels(0.0, 12.0), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!(
            labels(-0.6, 0.6),
            ["−0.6", "−0.4", "−0.2", "0.0", "0.2", "0.4", "0.6"]
        );
        assert_eq!(
            labels(9.9, 11.1),
            ["10.0", "10.2", "10.4", "10.6", "10.8", "11.0"]
        );
        assert_eq!(labels(-2e6, 2e6), ["−2e6", "−1e6", "0", "1e6", "2e6"]);
    }

    #[test]
    fn a_second_at_the_end_of_a_week_has_labels_that_differ_and_have_room() {
        let second_ticks = ticks((604_700.0, 604_701.0));
        let labels =
            |ticks: Vec<(f64, String)>| Vec::from_iter(ticks.into_iter().map(|tick| tick.1));
        assert_eq!(
            labels(apart(second_ticks)),
            ["604700.0", "604700.4", "604700.8"]
        );
        let day_ticks = ticks((86_399.0, 86_400.0));
        assert_eq!(apart(day_ticks.clone()), day_ticks);
    }
}
