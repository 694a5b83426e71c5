//! What holds for the physics under any history of current, fan and load.

use plant_emulator::plant::Inputs;
use plant_emulator::plants::sma::Actuator;
use proptest::prelude::*;
use scenario::plant::{Sma, StressStrain};

fn plant(law: StressStrain) -> Sma {
    let mut plant = Sma::default();
    plant.mechanics.stress_strain = law;
    plant
}

fn inputs() -> impl Strategy<Value = Inputs> {
    (0.0..=1.0_f64, 0.0..30.0, -0.04..0.1).prop_map(
        |(current, convection_factor, load): (f64, f64, f64)| Inputs {
            // Half of the pieces without current or at its limit.
            current_amperes: (2.0 * current - 0.5).clamp(0.0, 1.0),
            convection_factor,
            added_load_kilograms: load,
        },
    )
}

/// Pieces of a few milliseconds to seconds.
fn history() -> impl Strategy<Value = Vec<(f64, Inputs)>> {
    prop::collection::vec((0.0005..2.0, inputs()), 1..30)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn state_stays_within_physical_bounds(history in history(), is_full in any::<bool>()) {
        let plant = plant(if is_full { StressStrain::Full } else { StressStrain::AusteniteOnly });
        let mut actuator = Actuator::new(&plant);
        let coldest = plant.heat.ambient_celsius.min(plant.heat.cooling_element_celsius);
        let mut hottest = plant.heat.ambient_celsius.max(plant.heat.cooling_element_celsius);
        for (duration, inputs) in history {
            hottest = hottest.max(actuator.equilibrium_celsius(&inputs));
            for _ in 0..10 {
                actuator.advance(duration / 10.0, &inputs);
                let temperature = actuator.temperature_celsius();
                prop_assert!(temperature >= coldest && temperature <= hottest, "{temperature} °C");
                let fraction = actuator.martensite_fraction();
                prop_assert!((0.0..=1.0).contains(&fraction), "ξ {fraction}");
                prop_assert!(actuator.tension_newtons() >= 0.0);
                prop_assert!(actuator.position_metres() >= 0.0);
                // An unloaded pulley overshoots the free length by its own momentum only.
                prop_assert!(actuator.position_metres() < 0.12, "{} m", actuator.position_metres());
            }
        }
    }

    #[test]
    fn equal_histories_give_equal_bits(history in history()) {
        let run = || {
            let mut actuator = Actuator::new(&Sma::default());
            for (duration, inputs) in &history {
                actuator.advance(*duration, inputs);
            }
            (actuator.position_metres().to_bits(), actuator.temperature_celsius().to_bits())
        };
        prop_assert_eq!(run(), run());
    }
}

fn current(current_amperes: f64) -> Inputs {
    Inputs {
        current_amperes,
        ..Inputs::default()
    }
}

/// Position after a smooth stretch: heating on one branch, off the stop.
fn smooth_stretch(step_seconds: f64) -> f64 {
    let mut actuator = Actuator::new(&Sma::default());
    actuator.advance(1.5, &current(0.62));
    assert!(actuator.position_metres() > 0.005);
    let mut coarse = actuator.continued_with_step(step_seconds);
    coarse.advance(0.256, &current(0.7));
    coarse.position_metres()
}

#[test]
fn halving_the_step_divides_the_error_by_sixteen() {
    let exact = smooth_stretch(0.000_25);
    let error = |step: f64| (smooth_stretch(step) - exact).abs();
    let ratio = error(0.016) / error(0.008);
    assert!((12.0..22.0).contains(&ratio), "ratio {ratio}");
}

/// PAPER E7: from cold at 1 A the load lifts off after 0.233 s.
#[test]
fn lift_off_from_cold() {
    let mut actuator = Actuator::new(&Sma::default());
    let mut time = 0.0;
    while actuator.position_metres() <= 0.0 && time < 1.0 {
        actuator.advance(0.001, &current(1.0));
        time += 0.001;
    }
    assert!((time - 0.233_f64).abs() < 0.002, "{time} s");
}

/// With the full law the load still comes down (PAPER, assumed values of the full law).
#[test]
fn the_full_law_lifts_and_lowers_the_load() {
    let mut actuator = Actuator::new(&plant(StressStrain::Full));
    actuator.advance(5.0, &current(0.8));
    assert!(actuator.position_metres() > 0.04);
    actuator.advance(10.0, &current(0.0));
    assert_eq!(actuator.position_metres(), 0.0);
}

#[test]
fn durations_that_are_none_do_nothing() {
    let mut actuator = Actuator::new(&Sma::default());
    for duration in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        actuator.advance(duration, &current(1.0));
    }
    assert_eq!(
        actuator.temperature_celsius(),
        Actuator::new(&Sma::default()).temperature_celsius()
    );
}
