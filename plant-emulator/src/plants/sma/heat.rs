//! Heat balance of the wire.

use scenario::plant;

/// Coefficients of the heat balance, Eq. (1); all per metre of wire.
#[derive(Clone, Debug)]
pub(super) struct HeatBalance {
    /// Inverse of the heat capacity, `1 / (m cp)`, m K/J.
    inverse_heat_capacity: f64,
    /// Latent heat over specific heat, `L / cp`, K.
    latent_heat_kelvins: f64,
    /// Resistance `R`, Ω/m.
    resistance: f64,
    /// Convection in still air, `h A`, W/(m K).
    convection: f64,
    /// Conduction to the cooling element, `C`, W/(m K).
    conduction: f64,
    /// Temperature of the air, `Tamb`, °C.
    ambient_celsius: f64,
    /// Temperature of the cooling element, `Tp`, °C.
    cooling_element_celsius: f64,
}

/// Heat input and loss of the wire, per metre.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heating {
    /// Heat of the current, `i² R`, W/m.
    joule: f64,
    /// Convection with the fan, `h A`, W/(m K).
    convection: f64,
}

impl HeatBalance {
    pub(super) fn new(config: &plant::Heat) -> Self {
        Self {
            inverse_heat_capacity: 1.0
                / (config.mass_kilograms_per_metre
                    * config.specific_heat_joules_per_kilogram_kelvin),
            latent_heat_kelvins: config.latent_heat_joules_per_kilogram
                / config.specific_heat_joules_per_kilogram_kelvin,
            resistance: config.resistance_ohms_per_metre,
            convection: config.convection_watts_per_square_metre_kelvin
                * config.surface_square_metres_per_metre,
            conduction: config.conduction_watts_per_metre_kelvin,
            ambient_celsius: config.ambient_celsius,
            cooling_element_celsius: config.cooling_element_celsius,
        }
    }

    /// Returns the heating by a current and a fan, which multiplies `h`.
    #[inline]
    pub(super) fn heating(&self, current_amperes: f64, convection_factor: f64) -> Heating {
        Heating {
            joule: current_amperes * current_amperes * self.resistance,
            convection: convection_factor * self.convection,
        }
    }

    /// Returns `dT/dt` in K/s, Eq. (1): `m cp dT/dt = i² R − h A (T − Tamb) − C (T − Tp)`.
    #[inline]
    pub(super) fn rate_kelvin_per_second(
        &self,
        temperature_celsius: f64,
        heating: &Heating,
    ) -> f64 {
        let convection = heating.convection * (temperature_celsius - self.ambient_celsius);
        let conduction = self.conduction * (temperature_celsius - self.cooling_element_celsius);
        self.inverse_heat_capacity * (heating.joule - convection - conduction)
    }

    /// Returns `dT/dt` in K/s of a wire that transforms by `ξ′ = dξ/dT`, and so absorbs or releases its latent heat:
    /// `m (cp − L ξ′) dT/dt = q` with `q` the right side of Eq. (1). The paper neglects `L`.
    #[inline]
    pub(super) fn transforming_rate_kelvin_per_second(
        &self,
        temperature_celsius: f64,
        heating: &Heating,
        fraction_per_kelvin: impl FnOnce() -> f64,
    ) -> f64 {
        let rate = self.rate_kelvin_per_second(temperature_celsius, heating);
        match self.latent_heat_kelvins {
            0.0 => rate,
            latent => rate / (1.0 - latent * fraction_per_kelvin()),
        }
    }

    /// Returns the inverse of the time constant of Eq. (1): `(h A + C) / (m cp)`.
    pub(super) fn rate_per_second(&self, convection_factor: f64) -> f64 {
        self.inverse_heat_capacity * (convection_factor * self.convection + self.conduction)
    }

    /// Returns the equilibrium temperature of Eq. (1): `T = (i² R + h A Tamb + C Tp) / (h A + C)`.
    pub(super) fn equilibrium_celsius(&self, current_amperes: f64, convection_factor: f64) -> f64 {
        let convection = convection_factor * self.convection;
        (current_amperes * current_amperes * self.resistance
            + convection * self.ambient_celsius
            + self.conduction * self.cooling_element_celsius)
            / (convection + self.conduction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_and_hottest_equilibrium_are_the_papers() {
        let heat = HeatBalance::new(&plant::Heat::default());
        let cold = heat.equilibrium_celsius(0.0, 1.0);
        assert!((cold - 15.084_735_31).abs() < 1e-8, "{cold}");
        let hot = heat.equilibrium_celsius(1.0, 1.0);
        assert!((hot - 138.44).abs() < 0.01, "{hot}");
        let rate = heat.rate_kelvin_per_second(hot, &heat.heating(1.0, 1.0));
        assert!(rate.abs() < 1e-11);
    }

    #[test]
    fn a_fan_cools_a_hot_wire_faster_and_warms_a_cold_one() {
        let heat = HeatBalance::new(&plant::Heat::default());
        let rate = |temperature, factor| {
            heat.rate_kelvin_per_second(temperature, &heat.heating(0.0, factor))
        };
        assert!(rate(80.0, 5.0) < rate(80.0, 1.0));
        assert!(rate(10.0, 5.0) > rate(10.0, 1.0));
    }
}
