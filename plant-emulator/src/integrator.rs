//! The classical Runge-Kutta method of fourth order, and the division of time into its steps.

/// Calls `step` with the length of each of the equal steps into which a duration is divided. They are at most
/// `longest_seconds` long, but for an excess: the share of such a step by which all of them together may be longer.
#[inline]
pub(crate) fn in_equal_steps(
    duration_seconds: f64,
    longest_seconds: f64,
    excess: f64,
    mut step: impl FnMut(f64),
) {
    if !duration_seconds.is_finite() || duration_seconds <= 0.0 {
        return;
    }
    let steps = libm::ceil(duration_seconds / longest_seconds - excess).max(1.0);
    let step_seconds = duration_seconds / steps;
    let mut index = 0.0;
    while index < steps {
        step(step_seconds);
        index += 1.0;
    }
}

/// Takes one step of `duration_seconds` from `state`; `derivative` takes the time since the start of the step and a
/// state.
pub fn runge_kutta_4<const N: usize>(
    state: [f64; N],
    duration_seconds: f64,
    derivative: impl Fn(f64, &[f64; N]) -> [f64; N],
) -> [f64; N] {
    let at_start = derivative(0.0, &state);
    runge_kutta_4_from(state, at_start, duration_seconds, derivative)
}

/// Works as [`runge_kutta_4`], with a derivative at the start that is known already.
#[inline]
pub fn runge_kutta_4_from<const N: usize>(
    state: [f64; N],
    at_start: [f64; N],
    duration_seconds: f64,
    derivative: impl Fn(f64, &[f64; N]) -> [f64; N],
) -> [f64; N] {
    let half = 0.5 * duration_seconds;
    let mut slopes = [at_start; 4];
    let mut slope = at_start;
    // A loop with one call, not three calls, so the derivative is compiled into the loop.
    for (place, seconds) in slopes[1..].iter_mut().zip([half, half, duration_seconds]) {
        slope = derivative(seconds, &along(&state, seconds, &slope));
        *place = slope;
    }
    let [k1, k2, k3, k4] = slopes;
    let mean = std::array::from_fn(|i| (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) / 6.0);
    along(&state, duration_seconds, &mean)
}

/// Returns `state + duration · slope`.
fn along<const N: usize>(state: &[f64; N], duration_seconds: f64, slope: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| state[i] + duration_seconds * slope[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the largest error on one period of an oscillator in `steps` steps.
    fn oscillator_error(steps: u32) -> f64 {
        let duration = std::f64::consts::TAU / f64::from(steps);
        let mut state = [1.0, 0.0];
        for _ in 0..steps {
            state = runge_kutta_4(state, duration, |_, [x, v]| [*v, -x]);
        }
        (state[0] - 1.0).abs().max(state[1].abs())
    }

    #[test]
    fn halving_the_step_divides_the_error_by_sixteen() {
        let ratio = oscillator_error(100) / oscillator_error(200);
        assert!((14.0..18.0).contains(&ratio), "ratio {ratio}");
    }

    #[test]
    fn the_time_inside_the_step_is_used() {
        let [area] = runge_kutta_4([0.0], 2.0, |time, _| [time * time * time]);
        assert!((area - 4.0).abs() < 1e-12, "{area}");
    }
}
