//! Checks whether plants make physical sense and can be integrated at the shipped step size.

use scenario::plant::{Heat, Kinetics, Phase, Sma};

use super::heat::HeatBalance;
use super::wire::Mechanics;
use crate::plant::{InvalidPlant, finite, follows, not_negative, positive, require};

/// Longest integration step. With it the errors against the reference trajectories are a hundredth of their tolerance.
pub const STEP_SECONDS_MAX: f64 = 1e-3;

/// Largest convection factor: that of 0x6411:01, with a margin.
pub const CONVECTION_FACTOR_MAX: f64 = 33.0;

/// Checks all physical parameters of a plant.
///
/// # Errors
/// A parameter makes no sense; the error names the first one.
pub fn check(plant: &Sma) -> Result<(), InvalidPlant> {
    check_heat(&plant.heat)?;
    check_phase(&plant.phase)?;
    check_kinetics(plant.kinetics, &plant.heat, &plant.phase)?;
    check_mechanics(&plant.mechanics)?;
    let heat = HeatBalance::new(&plant.heat).rate_per_second(CONVECTION_FACTOR_MAX);
    follows("heat", heat, STEP_SECONDS_MAX)?;
    let motion = Mechanics::new(&plant.mechanics).fastest_rate_per_second();
    follows("motion", motion, STEP_SECONDS_MAX)
}

pub(super) fn check_heat(heat: &Heat) -> Result<(), InvalidPlant> {
    positive("mass_kilograms_per_metre", heat.mass_kilograms_per_metre)?;
    positive(
        "specific_heat_joules_per_kilogram_kelvin",
        heat.specific_heat_joules_per_kilogram_kelvin,
    )?;
    not_negative(
        "latent_heat_joules_per_kilogram",
        heat.latent_heat_joules_per_kilogram,
    )?;
    not_negative("resistance_ohms_per_metre", heat.resistance_ohms_per_metre)?;
    positive(
        "surface_square_metres_per_metre",
        heat.surface_square_metres_per_metre,
    )?;
    not_negative(
        "convection_watts_per_square_metre_kelvin",
        heat.convection_watts_per_square_metre_kelvin,
    )?;
    not_negative(
        "conduction_watts_per_metre_kelvin",
        heat.conduction_watts_per_metre_kelvin,
    )?;
    finite("ambient_celsius", heat.ambient_celsius)?;
    finite("cooling_element_celsius", heat.cooling_element_celsius)?;
    // Without any cooling there is no start temperature.
    positive(
        "convection plus conduction",
        heat.convection_watts_per_square_metre_kelvin + heat.conduction_watts_per_metre_kelvin,
    )
}

pub(super) fn check_phase(phase: &Phase) -> Result<(), InvalidPlant> {
    let branches = [
        (
            "austenite_start_celsius",
            phase.austenite_start_celsius,
            "austenite_finish_celsius",
            phase.austenite_finish_celsius,
        ),
        (
            "martensite_finish_celsius",
            phase.martensite_finish_celsius,
            "martensite_start_celsius",
            phase.martensite_start_celsius,
        ),
    ];
    for (cold_name, cold, hot_name, hot) in branches {
        finite(cold_name, cold)?;
        finite(hot_name, hot)?;
        if cold >= hot {
            let what = format!("{cold} °C, it must be below {hot_name} of {hot} °C");
            return Err(InvalidPlant::Parameter {
                name: cold_name,
                what,
            });
        }
    }
    Ok(())
}

/// Checks that air and cooling element do not keep the wire above `Mf`, since a memory of turns begins with all
/// martensite.
pub(super) fn check_kinetics(
    kinetics: Kinetics,
    heat: &Heat,
    phase: &Phase,
) -> Result<(), InvalidPlant> {
    let is_cold =
        |celsius| !kinetics.remembers_turns() || celsius <= phase.martensite_finish_celsius;
    for (name, celsius) in [
        ("ambient_celsius", heat.ambient_celsius),
        ("cooling_element_celsius", heat.cooling_element_celsius),
    ] {
        let requirement = "at most martensite_finish_celsius where turns are remembered";
        require(name, celsius, requirement, is_cold)?;
    }
    Ok(())
}

fn check_mechanics(mechanics: &scenario::plant::Mechanics) -> Result<(), InvalidPlant> {
    positive(
        "austenite_modulus_pascals",
        mechanics.austenite_modulus_pascals,
    )?;
    positive(
        "martensite_modulus_pascals",
        mechanics.martensite_modulus_pascals,
    )?;
    not_negative("martensite_yield_strain", mechanics.martensite_yield_strain)?;
    positive("wire_diameter_metres", mechanics.wire_diameter_metres)?;
    positive("wire_length_metres", mechanics.wire_length_metres)?;
    require(
        "recoverable_strain",
        mechanics.recoverable_strain,
        "from 0 to below 1",
        |strain| (0.0..1.0).contains(&strain),
    )?;
    positive(
        "inner_pulley_radius_metres",
        mechanics.inner_pulley_radius_metres,
    )?;
    positive(
        "outer_pulley_radius_metres",
        mechanics.outer_pulley_radius_metres,
    )?;
    // Without inertia the pulley would move infinitely fast when the load is removed.
    positive(
        "pulley_inertia_kilogram_square_metres",
        mechanics.pulley_inertia_kilogram_square_metres,
    )?;
    not_negative("load_kilograms", mechanics.load_kilograms)?;
    not_negative(
        "damping_newton_seconds_per_metre",
        mechanics.damping_newton_seconds_per_metre,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the message for the default plant with one change.
    fn message(change: impl Fn(&mut Sma)) -> String {
        let mut plant = Sma::default();
        change(&mut plant);
        check(&plant).unwrap_err().to_string()
    }

    #[test]
    fn the_default_plant_is_valid() {
        assert!(check(&Sma::default()).is_ok());
    }

    /// Each cooling temperature is set above `Mf` by itself, with each kinetics.
    #[test]
    fn a_memory_of_turns_needs_a_wire_that_cools_to_martensite() {
        for (kinetics, is_refused) in [
            (Kinetics::Paper, false),
            (Kinetics::Nested, true),
            (Kinetics::Preisach, true),
        ] {
            for place in [0, 1] {
                let with = |celsius| {
                    let mut plant = Sma {
                        kinetics,
                        ..Sma::default()
                    };
                    let heat = &mut plant.heat;
                    let places = [&mut heat.ambient_celsius, &mut heat.cooling_element_celsius];
                    *places.into_iter().nth(place).unwrap() = celsius;
                    check(&plant)
                };
                assert!(with(34.0).is_ok());
                assert_eq!(with(34.1).is_err(), is_refused, "{kinetics:?}");
            }
        }
        assert_eq!(
            message(|plant| {
                plant.kinetics = Kinetics::Nested;
                plant.heat.ambient_celsius = 40.0;
            }),
            "ambient_celsius is 40, it must be at most martensite_finish_celsius where turns are remembered"
        );
    }

    #[test]
    fn errors_name_the_value_and_the_limit() {
        assert_eq!(
            message(|plant| plant.heat.mass_kilograms_per_metre = 0.0),
            "mass_kilograms_per_metre is 0, it must be above 0"
        );
        assert_eq!(
            message(|plant| plant.phase.martensite_start_celsius = 30.0),
            "martensite_finish_celsius is 34 °C, it must be below martensite_start_celsius of 30 °C"
        );
        assert_eq!(
            message(|plant| plant.mechanics.load_kilograms = f64::NAN),
            "load_kilograms is NaN, it must be 0 or above"
        );
        assert_eq!(
            message(|plant| plant.mechanics.austenite_modulus_pascals = 1e13),
            "motion changes at up to 1486 1/s, the integrator follows 1000 1/s at most"
        );
        assert!(
            message(|plant| plant.heat.mass_kilograms_per_metre = 1e-9).starts_with("heat changes")
        );
    }
}
