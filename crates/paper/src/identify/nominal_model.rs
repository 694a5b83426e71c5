//! A plant as the controller's model.

use scenario::controller::NominalModel;
use scenario::plant::Sma;

/// Returns the model with the plant's numbers. Its equations are those of the plant's simpler law of stress and strain.
pub fn nominal_model(plant: &Sma) -> NominalModel {
    let Sma {
        heat,
        phase,
        mechanics,
        ..
    } = plant;
    NominalModel {
        mass_kilograms_per_metre: heat.mass_kilograms_per_metre,
        specific_heat_joules_per_kilogram_kelvin: heat.specific_heat_joules_per_kilogram_kelvin,
        resistance_ohms_per_metre: heat.resistance_ohms_per_metre,
        surface_square_metres_per_metre: heat.surface_square_metres_per_metre,
        convection_watts_per_square_metre_kelvin: heat.convection_watts_per_square_metre_kelvin,
        conduction_watts_per_metre_kelvin: heat.conduction_watts_per_metre_kelvin,
        ambient_celsius: heat.ambient_celsius,
        cooling_element_celsius: heat.cooling_element_celsius,
        austenite_start_celsius: phase.austenite_start_celsius,
        austenite_finish_celsius: phase.austenite_finish_celsius,
        martensite_start_celsius: phase.martensite_start_celsius,
        martensite_finish_celsius: phase.martensite_finish_celsius,
        austenite_modulus_pascals: mechanics.austenite_modulus_pascals,
        wire_diameter_metres: mechanics.wire_diameter_metres,
        wire_length_metres: mechanics.wire_length_metres,
        recoverable_strain: mechanics.recoverable_strain,
        inner_pulley_radius_metres: mechanics.inner_pulley_radius_metres,
        outer_pulley_radius_metres: mechanics.outer_pulley_radius_metres,
        pulley_inertia_kilogram_square_metres: mechanics.pulley_inertia_kilogram_square_metres,
        load_kilograms: mechanics.load_kilograms,
        damping_newton_seconds_per_metre: mechanics.damping_newton_seconds_per_metre,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_plant_gives_the_nominal_model() {
        assert_eq!(nominal_model(&Sma::default()), NominalModel::default());
    }
}
