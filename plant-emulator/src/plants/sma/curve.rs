//! Curves of the martensite fraction over the temperature.

/// Largest argument of an exponential here; it keeps every product of Eq. (2) finite.
const EXPONENT_MAX: f64 = 300.0;

/// One branch of Eq. (2): the phase that vanishes along it is `1 / (1 + exp(slope (T − centre)))` of its value far
/// before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sigmoid {
    /// `aA = 6.2 / (Af − As)` while heating, `−aM = −6.2 / (Ms − Mf)` while cooling (PAPER E1), 1/K.
    slope: f64,
    /// `bA = (As + Af) / 2` or `bM = (Ms + Mf) / 2`, °C.
    centre_celsius: f64,
}

impl Sigmoid {
    pub(super) fn new(start_celsius: f64, finish_celsius: f64) -> Self {
        Self {
            slope: 6.2 / (finish_celsius - start_celsius),
            centre_celsius: 0.5 * (start_celsius + finish_celsius),
        }
    }

    /// Returns `e = exp(slope (T − centre))`.
    #[inline]
    pub(super) fn exponential(&self, temperature_celsius: f64) -> f64 {
        let exponent = self.slope * (temperature_celsius - self.centre_celsius);
        libm::exp(exponent.clamp(-EXPONENT_MAX, EXPONENT_MAX))
    }

    /// Returns `D = 1 + e`.
    #[inline]
    pub(super) fn denominator(&self, temperature_celsius: f64) -> f64 {
        1.0 + self.exponential(temperature_celsius)
    }
}

/// A point of a curve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Martensite fraction `ξ`.
    pub(super) martensite_fraction: f64,
    /// Its slope over the temperature, `ξ′ = dξ/dT`, 1/K; never positive.
    pub(super) fraction_per_kelvin: f64,
}

/// A curve of Eq. (2): `ξ = origin + amplitude / D`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whole {
    pub(super) sigmoid: Sigmoid,
    pub(super) origin: f64,
    pub(super) amplitude: f64,
}

impl Whole {
    /// Returns `ξ`.
    #[inline]
    pub(super) fn martensite_fraction(&self, temperature_celsius: f64) -> f64 {
        let part = self.amplitude / self.sigmoid.denominator(temperature_celsius);
        (self.origin + part).clamp(0.0, 1.0)
    }

    /// Returns `dξ/dT`.
    fn fraction_per_kelvin(&self, temperature_celsius: f64) -> f64 {
        let exponential = self.sigmoid.exponential(temperature_celsius);
        let denominator = 1.0 + exponential;
        let part = self.amplitude / denominator;
        -part * self.sigmoid.slope * (exponential / denominator)
    }
}

/// Curve of `ξ` over `T` since the last turn, with `e` and `D` of a branch at `T`.
#[derive(Clone, Copy, Debug)]
pub(super) enum Curve {
    Whole(Whole),
    /// A curve that leaves a turn `(T₁, ξ₁)`: `ξ = ξ₁ + amplitude (e − e₁) / D`.
    Part {
        sigmoid: Sigmoid,
        origin: f64,
        exponential_at_turn: f64,
        amplitude: f64,
    },
    /// Heating that reverts cooling curves from a turn `(m, ξm)` on: `ξ = ξm − F(T, m)`.
    TakenBack {
        heating: Sigmoid,
        cooling: Sigmoid,
        origin: f64,
        exponential_at_turn: f64,
    },
}

impl Curve {
    #[inline]
    pub(super) fn at(&self, temperature_celsius: f64) -> Point {
        let (fraction, fraction_per_kelvin) = match self {
            Self::Whole(whole) => (
                whole.martensite_fraction(temperature_celsius),
                whole.fraction_per_kelvin(temperature_celsius),
            ),
            Self::Part {
                sigmoid,
                origin,
                exponential_at_turn,
                amplitude,
            } => {
                let exponential = sigmoid.exponential(temperature_celsius);
                let part = amplitude / (1.0 + exponential);
                let at_turn = (1.0 + exponential_at_turn) / (1.0 + exponential);
                (
                    origin + part * (exponential - exponential_at_turn),
                    part * at_turn * sigmoid.slope * exponential,
                )
            }
            Self::TakenBack {
                heating,
                cooling,
                origin,
                exponential_at_turn,
            } => {
                // This is F(T, m) = (1 − gA(T)) (1 − DM(T) / DM(m)), and its derivative.
                let heated = heating.exponential(temperature_celsius);
                let cooled = cooling.exponential(temperature_celsius);
                let austenite = heated / (1.0 + heated);
                let austenite_slope = heating.slope * austenite / (1.0 + heated);
                let share = (exponential_at_turn - cooled) / (1.0 + exponential_at_turn);
                let share_slope = -cooling.slope * cooled / (1.0 + exponential_at_turn);
                (
                    origin - austenite * share,
                    -(austenite_slope * share + austenite * share_slope),
                )
            }
        };
        Point {
            martensite_fraction: fraction.clamp(0.0, 1.0),
            fraction_per_kelvin,
        }
    }
}
