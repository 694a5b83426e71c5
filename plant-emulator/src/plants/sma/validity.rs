//! Checks whether plants make physical sense and can be integrated at the shipped step size.

use std::sync::LazyLock;

use scenario::custom::{Minima, WrongParameter};
use scenario::plant::{Heat, Kinetics, Phase, Sma};

use super::heat::HeatBalance;
use super::wire::Mechanics;
use crate::plant::{InvalidPlant, follows, positive, require};

/// Longest integration step. With it the errors against the reference trajectories are a hundredth of their tolerance.
pub const STEP_SECONDS_MAX: f64 = 1e-3;

/// Largest convection factor: that of 0x6411:01, with a margin.
pub const CONVECTION_FACTOR_MAX: f64 = 33.0;

/// Checks all physical parameters of a plant.
///
/// # Errors
/// A parameter makes no sense; the error names the first one.
pub fn check(plant: &Sma) -> Result<(), InvalidPlant> {
    static MINIMA: LazyLock<Minima> = LazyLock::new(Minima::of::<Sma>);
    MINIMA.check(plant)?;
    check_wire(plant.kinetics, &plant.heat, &plant.phase)?;
    let mechanics = &plant.mechanics;
    require(
        "recoverable_strain",
        mechanics.recoverable_strain,
        "below 1",
        |strain| strain < 1.0,
    )?;
    // Without inertia the pulley would move infinitely fast when the load is removed.
    positive(
        "pulley_inertia_kilogram_square_metres",
        mechanics.pulley_inertia_kilogram_square_metres,
    )?;
    let heat = HeatBalance::new(&plant.heat).rate_per_second(CONVECTION_FACTOR_MAX);
    follows("heat", heat, STEP_SECONDS_MAX)?;
    let motion = Mechanics::new(mechanics).fastest_rate_per_second();
    follows("motion", motion, STEP_SECONDS_MAX)
}

/// Checks what the parameters of a wire mean together.
pub(super) fn check_wire(
    kinetics: Kinetics,
    heat: &Heat,
    phase: &Phase,
) -> Result<(), InvalidPlant> {
    // Without any cooling there is no start temperature.
    positive(
        "convection plus conduction",
        heat.convection_watts_per_square_metre_kelvin + heat.conduction_watts_per_metre_kelvin,
    )?;
    if let Some([(hot_name, hot), (cold_name, cold)]) = phase.out_of_order().next() {
        let what = format!("{cold} °C, it must be below {hot_name} of {hot} °C");
        let name = cold_name.to_owned();
        return Err(WrongParameter { name, what }.into());
    }
    if let Some((name, celsius)) = kinetics.too_warm(heat, phase).next() {
        let requirement = "at most martensite_finish_celsius where turns are remembered";
        return require(name, celsius, requirement, |_| false);
    }
    Ok(())
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
