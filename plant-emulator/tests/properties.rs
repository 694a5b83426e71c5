//! Properties of the physics under any history of current, fan and load.

use plant_emulator::plant::Inputs;
use plant_emulator::plants::sma::Actuator;
use proptest::prelude::*;
use scenario::plant::{Kinetics, Sma, StressStrain};

fn plant(law: StressStrain) -> Sma {
    let mut plant = Sma::default();
    plant.mechanics.stress_strain = law;
    plant
}

fn kinetics() -> impl Strategy<Value = Kinetics> {
    prop::sample::select(vec![Kinetics::Paper, Kinetics::Nested, Kinetics::Preisach])
}

fn inputs() -> impl Strategy<Value = Inputs> {
    (0.0..=1.0_f64, 0.0..30.0, -0.04..0.1).prop_map(
        |(current, convection_factor, load): (f64, f64, f64)| Inputs {
            // Half of the pieces are without current or at its limit.
            current_amperes: (2.0 * current - 0.5).clamp(0.0, 1.0),
            convection_factor,
            added_load_kilograms: load,
        },
    )
}

/// Generates pieces of a few milliseconds to seconds.
fn history() -> impl Strategy<Value = Vec<(f64, Inputs)>> {
    prop::collection::vec((0.0005..2.0, inputs()), 1..30)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn state_stays_within_physical_bounds(
        history in history(),
        is_full in any::<bool>(),
        kinetics in kinetics(),
        latent_heat in prop_oneof![Just(0.0), 0.0..40e3_f64],
    ) {
        let mut plant = plant(if is_full { StressStrain::Full } else { StressStrain::AusteniteOnly });
        plant.kinetics = kinetics;
        plant.heat.latent_heat_joules_per_kilogram = latent_heat;
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
                // An unloaded pulley overshoots the free length only by its own momentum.
                prop_assert!(actuator.position_metres() < 0.12, "{} m", actuator.position_metres());
            }
        }
    }

    /// Above all turns of a history, inner loops leave no trace: the wire is on the first heating branch again.
    #[test]
    fn a_wire_that_remembers_its_turns_comes_back_to_the_first_heating(
        history in history(),
        is_nested in any::<bool>(),
    ) {
        let kinetics = if is_nested { Kinetics::Nested } else { Kinetics::Preisach };
        let mut actuator = Actuator::new(&Sma { kinetics, ..Sma::default() });
        let mut hottest: f64 = 0.0;
        for (duration, inputs) in history {
            actuator.advance(duration, &Inputs { current_amperes: 0.8 * inputs.current_amperes, ..inputs });
            hottest = hottest.max(actuator.temperature_celsius());
        }
        while actuator.temperature_celsius() <= hottest {
            actuator.advance(0.001, &current(1.0));
        }
        let expected = first_heating(actuator.temperature_celsius());
        let found = actuator.martensite_fraction();
        prop_assert!((found - expected).abs() < 1e-6, "{found} {expected}");
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

/// Returns `gA` of Eq. (2).
fn first_heating(celsius: f64) -> f64 {
    1.0 / (1.0 + libm::exp(6.2 / (93.0 - 53.0) * (celsius - 73.0)))
}

/// Minor loops under a current that varies in small steps return to their beginning; the test measures the distance from the
/// first heating.
#[test]
fn minor_loops_close_where_turns_are_remembered() {
    let off_after_loops = |kinetics| {
        let mut actuator = Actuator::new(&Sma {
            kinetics,
            ..Sma::default()
        });
        actuator.advance(5.0, &current(0.6));
        let off = (0..6).map(|_| {
            for piece in 0..20_000 {
                let time = (f64::from(piece) + 0.5) * 1e-4;
                let sine = libm::sin(std::f64::consts::PI * time / 2.0);
                actuator.advance(1e-4, &current(0.6 - 0.1 * sine));
            }
            actuator.advance(6.0, &current(0.6));
            actuator.martensite_fraction() - first_heating(actuator.temperature_celsius())
        });
        Vec::from_iter(off)
    };
    for kinetics in [Kinetics::Nested, Kinetics::Preisach] {
        let off = off_after_loops(kinetics);
        assert!(off.iter().all(|off| off.abs() < 1e-6), "{off:?}");
    }
    let off = off_after_loops(Kinetics::Paper);
    assert!(off.iter().all(|off| off.abs() > 1e-3), "{off:?}");
}

/// Returns the supplied heat, `∫ q dt` with `q` the right side of Eq. (1), the heat in the wire, `m (cp ΔT − L Δξ)`,
/// both in J/m, and the highest temperature.
fn balance(plant: &Sma, currents: &[f64]) -> (f64, f64, f64) {
    const STEP_SECONDS: f64 = 0.000_25;
    let heat = &plant.heat;
    let mut actuator = Actuator::new(plant).continued_with_step(STEP_SECONDS);
    let convection =
        heat.convection_watts_per_square_metre_kelvin * heat.surface_square_metres_per_metre;
    let inflow = |celsius: f64, current: f64| {
        current * current * heat.resistance_ohms_per_metre
            - convection * (celsius - heat.ambient_celsius)
            - heat.conduction_watts_per_metre_kelvin * (celsius - heat.cooling_element_celsius)
    };
    let start = (
        actuator.temperature_celsius(),
        actuator.martensite_fraction(),
    );
    let (mut came_in, mut hottest) = (0.0, start.0);
    for amperes in currents {
        for _ in 0..8000 {
            let before = inflow(actuator.temperature_celsius(), *amperes);
            actuator.advance(STEP_SECONDS, &current(*amperes));
            let after = inflow(actuator.temperature_celsius(), *amperes);
            came_in += 0.5 * STEP_SECONDS * (before + after);
            hottest = hottest.max(actuator.temperature_celsius());
        }
    }
    let sensible =
        heat.specific_heat_joules_per_kilogram_kelvin * (actuator.temperature_celsius() - start.0);
    let latent = heat.latent_heat_joules_per_kilogram * (actuator.martensite_fraction() - start.1);
    let is_in = heat.mass_kilograms_per_metre * (sensible - latent);
    (came_in, is_in, hottest)
}

/// Over a heating, a cooling and inner loops, the wire absorbs and releases exactly its latent heat.
#[test]
fn latent_heat_is_in_the_balance() {
    let courses: [&[f64]; 3] = [
        &[0.7],
        &[0.7, 0.0],
        &[0.62, 0.5, 0.58, 0.52, 0.6, 0.5, 0.65, 0.3],
    ];
    for kinetics in [Kinetics::Paper, Kinetics::Nested, Kinetics::Preisach] {
        for currents in courses {
            let with = |latent_heat| {
                let mut plant = Sma {
                    kinetics,
                    ..Sma::default()
                };
                plant.heat.latent_heat_joules_per_kilogram = latent_heat;
                balance(&plant, currents)
            };
            let (came_in, is_in, hottest) = with(24e3);
            // The wire can hold some 15 J/m in total.
            assert!(
                (came_in - is_in).abs() < 1e-4,
                "{kinetics:?}: {came_in} J/m came in, {is_in} J/m are there"
            );
            assert!(hottest <= with(0.0).2, "latent heat delays");
        }
    }
}

/// A wire with latent heat is slower in both directions.
#[test]
fn latent_heat_slows_the_wire() {
    let lifted_after = |latent_heat| {
        let mut plant = Sma::default();
        plant.heat.latent_heat_joules_per_kilogram = latent_heat;
        let mut actuator = Actuator::new(&plant);
        let mut milliseconds = 0;
        while actuator.position_metres() < 0.02 {
            actuator.advance(0.001, &current(0.8));
            milliseconds += 1;
        }
        milliseconds
    };
    let (without, with) = (lifted_after(0.0), lifted_after(24e3));
    assert!(with > without + 20, "{without} ms, {with} ms");
}

fn current(current_amperes: f64) -> Inputs {
    Inputs {
        current_amperes,
        ..Inputs::default()
    }
}

/// Returns the position after a smooth period: heating on one branch, off the stop.
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
