//! Round values on an axis, with their labels.

/// Ticks on an axis, about.
const TICKS: f64 = 6.0;

/// Round values in a range, with their labels.
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
        ticks.push((value, label(value + 0.0, decimals)));
    }
    ticks
}

fn label(value: f64, decimals: usize) -> String {
    if value.abs() >= 1e5 {
        return format!("{value:e}").replace('-', "−");
    }
    format!("{value:.decimals$}").replace('-', "−")
}

/// Powers of ten in a range of logarithms.
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
}
