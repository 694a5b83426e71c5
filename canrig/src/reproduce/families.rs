//! Many scenarios of one: other frequencies, plants, cycle times, sensors.

use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;
use scenario::controller::CurrentRamp;
use scenario::plant::{Plant, Sensor};

/// Seed of the perturbed plants.
const PLANTS_SEED: u64 = 200;
/// Least periods of a sine (PAPER, "Definitions").
const PERIODS_MIN: f64 = 10.0;

/// The last sine of the scenario at another frequency, for ten periods.
#[must_use]
pub fn at_frequency(base: &Scenario, hertz: f64) -> Scenario {
    let mut scenario = base.clone();
    scenario.name = format!("sine of {hertz} Hz");
    if let Some(sine) = scenario.reference.sine.last_mut() {
        sine.period_seconds = 1.0 / hertz;
        scenario.duration_seconds = sine.from_seconds + PERIODS_MIN / hertz;
    }
    scenario
}

/// The scenario on plants that the controller does not know: independent uniform draws about the scenario's own plant
/// (PAPER, "Robustness").
pub fn on_perturbed_plants(base: Scenario, count: usize) -> impl Iterator<Item = Scenario> {
    let mut generator = Pcg64Mcg::seed_from_u64(PLANTS_SEED);
    (1..=count).map(move |number| {
        let mut scenario = base.clone();
        scenario.name += &format!(", plant {number}");
        perturb(&mut scenario.plant, || uniform(&mut generator));
        scenario
    })
}

/// C ±10 %, h ±30 %, each transformation temperature ±5 °C, K0 ±20 %, load ±10 %, c ±50 %, R ±5 %. `draw` is uniform
/// between −1 and 1.
fn perturb(plant: &mut Plant, mut draw: impl FnMut() -> f64) {
    let (heat, phase, mechanics) = (&mut plant.heat, &mut plant.phase, &mut plant.mechanics);
    let parts = [
        (&mut heat.conduction_watts_per_metre_kelvin, 0.1),
        (&mut heat.convection_watts_per_square_metre_kelvin, 0.3),
        // K0 is proportional to EA, Eq. (9).
        (&mut mechanics.austenite_modulus_pascals, 0.2),
        (&mut mechanics.load_kilograms, 0.1),
        (&mut mechanics.damping_newton_seconds_per_metre, 0.5),
        (&mut heat.resistance_ohms_per_metre, 0.05),
    ];
    for (value, part) in parts {
        *value *= 1.0 + part * draw();
    }
    let temperatures = [
        &mut phase.austenite_start_celsius,
        &mut phase.austenite_finish_celsius,
        &mut phase.martensite_start_celsius,
        &mut phase.martensite_finish_celsius,
    ];
    for temperature in temperatures {
        *temperature += 5.0 * draw();
    }
}

/// Uniform between −1 and 1, in steps of 2⁻⁵².
fn uniform(generator: &mut Pcg64Mcg) -> f64 {
    const SCALE: f64 = 1.0 / (1_u64 << 52) as f64;
    (generator.next_u64() >> 11) as f64 * SCALE - 1.0
}

/// The scenario with another time between two SYNCs.
#[must_use]
pub fn with_cycle(base: &Scenario, milliseconds: f64) -> Scenario {
    let mut scenario = base.clone();
    scenario.name += &format!(", cycle of {milliseconds} ms");
    scenario.bus.sync_period_milliseconds = milliseconds;
    scenario
}

/// The scenario with another converter at the position sensor. Its resolution is in the sensor's data sheet, so the
/// observer is told it too.
#[must_use]
pub fn with_resolution(base: &Scenario, bits: u32) -> Scenario {
    let mut scenario = base.clone();
    scenario.name += &format!(", {bits} bit");
    let sensor = &mut scenario.plant.sensor;
    sensor.resolution_bits = bits;
    let step = sensor_step_millimetres(sensor);
    if let Some(law) = &mut scenario.controller.sliding_mode {
        law.observer.sensor_step_millimetres = step;
    }
    scenario
}

/// The scenario with normal noise at the position sensor, in steps of its converter.
#[must_use]
pub fn with_noise(base: &Scenario, steps: f64) -> Scenario {
    let mut scenario = base.clone();
    scenario.name += &format!(", noise of {steps} steps");
    let sensor = &mut scenario.plant.sensor;
    sensor.noise_millimetres_rms = steps * sensor_step_millimetres(sensor);
    scenario
}

/// The scenario with another jerk at the start of a move of `sliding_mode`.
#[must_use]
pub fn with_launch_jerk(base: &Scenario, jerk_metres_per_second_cubed: f64) -> Scenario {
    let mut scenario = base.clone();
    scenario.name += &format!(", launch with {jerk_metres_per_second_cubed} m/s³");
    if let Some(law) = &mut scenario.controller.sliding_mode {
        law.reference_launch_jerk_metres_per_second_cubed = jerk_metres_per_second_cubed;
    }
    scenario
}

/// One step of a sensor's converter.
fn sensor_step_millimetres(sensor: &Sensor) -> f64 {
    sensor.span_millimetres / f64::from(1_u32 << sensor.resolution_bits)
}

/// The last two ramps of the current, played so many times more.
#[must_use]
pub fn with_loops_repeated(base: &Scenario, times: usize) -> Scenario {
    let mut scenario = base.clone();
    let Some(open_loop) = &mut scenario.controller.open_loop else {
        return scenario;
    };
    let ramps = &mut open_loop.ramp;
    let [.., first, second] = &ramps[..] else {
        return scenario;
    };
    let turns = [first.clone(), second.clone()];
    let period = second.until_seconds - first.from_seconds;
    for number in 1..=times {
        #[expect(clippy::cast_precision_loss, reason = "a few dozen")]
        let later = number as f64 * period;
        ramps.extend(turns.clone().map(|ramp| CurrentRamp {
            from_seconds: ramp.from_seconds + later,
            until_seconds: ramp.until_seconds + later,
            ..ramp
        }));
        scenario.duration_seconds += period;
    }
    scenario
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::bases;

    #[test]
    fn the_frequency_changes_period_and_length() {
        let scenario = at_frequency(&bases::bandwidth(), 0.1);
        assert_eq!(scenario.duration_seconds, 105.0);
        let window = scenario.judged_sine().unwrap();
        assert!(
            (window.from_seconds - 75.0).abs() < 1e-9
                && (window.until_seconds - 105.0).abs() < 1e-9
        );
    }

    #[test]
    fn perturbed_plants_are_the_same_each_time_and_fill_their_ranges() {
        let base = bases::step();
        let plants = || on_perturbed_plants(base.clone(), 200).map(|scenario| scenario.plant);
        assert!(plants().eq(plants()));
        let (low, high) = plants().fold((f64::MAX, f64::MIN), |(low, high), plant| {
            let value = plant.phase.austenite_start_celsius;
            (low.min(value), high.max(value))
        });
        assert!(
            (48.0..48.5).contains(&low) && (57.5..=58.0).contains(&high),
            "{low} {high}"
        );
        let moduli: f64 = plants()
            .map(|plant| plant.mechanics.austenite_modulus_pascals / 75e9)
            .sum();
        assert!((moduli / 200.0 - 1.0).abs() < 0.03);
        assert!(plants().all(|plant| plant.sensor == base.plant.sensor));
    }

    #[test]
    fn loops_follow_each_other() {
        let base = bases::hysteresis();
        let scenario = with_loops_repeated(&base, 3);
        let ramps = &scenario.controller.open_loop.as_ref().unwrap().ramp;
        assert_eq!(ramps.len(), 10);
        assert!(
            ramps[2..]
                .windows(2)
                .all(|pair| pair[0].until_seconds == pair[1].from_seconds)
        );
        assert_eq!(ramps[9].until_seconds, scenario.duration_seconds);
    }

    #[test]
    fn the_observer_is_told_the_resolution() {
        let scenario = with_resolution(&bases::step(), 12);
        let step = scenario
            .controller
            .sliding_mode
            .unwrap()
            .observer
            .sensor_step_millimetres;
        assert_eq!(step, 60.0 / 4096.0);
    }
}
