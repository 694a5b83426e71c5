//! Phase of a sine whose frequency moves from one value to another.

use std::f64::consts::TAU;

use crate::reference::Chirp;
use crate::sweep::Spacing;

/// Phase of a swept sine at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweptPhase {
    /// Turns since the start, the begun one as a fraction.
    pub turns: f64,
    /// Derivatives of the phase in radians by time: the angular frequency, its slope, and the slope of that.
    pub(crate) derivatives: [f64; 3],
}

impl SweptPhase {
    /// Returns the phase within one turn, which keeps its accuracy in long runs.
    pub fn radians(&self) -> f64 {
        TAU * (self.turns - libm::floor(self.turns))
    }

    /// Returns the frequency.
    pub fn hertz(&self) -> f64 {
        self.derivatives[0] / TAU
    }
}

impl Chirp {
    /// Returns the phase at a time after the start.
    pub fn phase_at(&self, elapsed_seconds: f64) -> SweptPhase {
        let (from, until) = (self.from_hertz, self.until_hertz);
        if self.spacing == Spacing::Logarithmic {
            let rate = libm::log(until / from) / self.duration_seconds();
            let hertz = from * libm::exp(rate * elapsed_seconds);
            SweptPhase {
                turns: (hertz - from) / rate,
                derivatives: [TAU * hertz, TAU * hertz * rate, TAU * hertz * rate * rate],
            }
        } else {
            let slope = (until - from) / self.duration_seconds();
            let hertz = from + slope * elapsed_seconds;
            SweptPhase {
                turns: 0.5 * (from + hertz) * elapsed_seconds,
                derivatives: [TAU * hertz, TAU * slope, 0.0],
            }
        }
    }

    /// Returns the time after which the sine has made a number of turns.
    pub fn seconds_at(&self, turns: f64) -> f64 {
        let (from, until) = (self.from_hertz, self.until_hertz);
        if self.spacing == Spacing::Logarithmic {
            let rate = libm::log(until / from) / self.duration_seconds();
            libm::log(1.0 + turns * rate / from) / rate
        } else {
            // This is the root of from t + slope t² / 2 = turns that grows with the turns, without a difference of near numbers.
            let slope = (until - from) / self.duration_seconds();
            2.0 * turns / (from + libm::sqrt((from * from + 2.0 * slope * turns).max(0.0)))
        }
    }

    fn duration_seconds(&self) -> f64 {
        self.until_seconds - self.from_seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweeps() -> impl Iterator<Item = Chirp> {
        let ends = [(0.1, 5.0), (5.0, 0.1)];
        let spacings = [Spacing::Linear, Spacing::Logarithmic].into_iter();
        spacings.flat_map(move |spacing| {
            ends.map(|(from_hertz, until_hertz)| Chirp {
                from_seconds: 0.0,
                until_seconds: 40.0,
                centre: 0.0,
                amplitude: 1.0,
                from_hertz,
                until_hertz,
                spacing,
            })
        })
    }

    #[test]
    fn both_ends_are_met_and_the_turns_are_the_area_below_the_frequency() {
        for sweep in sweeps() {
            let end = sweep.phase_at(40.0);
            assert!((sweep.phase_at(0.0).hertz() - sweep.from_hertz).abs() < 1e-12);
            assert!((end.hertz() - sweep.until_hertz).abs() < 1e-12);
            let step = 1e-3;
            let area: f64 = (0..40_000)
                .map(|place| step * sweep.phase_at(step * (f64::from(place) + 0.5)).hertz())
                .sum();
            assert!((area - end.turns).abs() < 1e-4, "{area} {end:?}");
        }
    }

    #[test]
    fn the_time_of_a_turn_is_when_it_is_complete() {
        for sweep in sweeps() {
            for turns in [0.0, 1.0, 17.0, 0.999 * sweep.phase_at(40.0).turns] {
                let found = sweep.phase_at(sweep.seconds_at(turns)).turns;
                assert!((found - turns).abs() < 1e-9, "{found} {turns}");
            }
        }
    }
}
