//! Families of scenarios: one scenario with other frequencies, cycle times, sensors.

use scenario::Trial;
use scenario::controller::CurrentRamp;

use crate::identify::data::sensor_step_millimetres;

/// Smallest number of periods of a sine (PAPER, "Definitions").
const PERIODS_MIN: f64 = 10.0;

/// Changes the last sine of the scenario to another frequency, for ten periods.
pub fn set_frequency(scenario: &mut Trial, hertz: f64) {
    scenario.run_mut().name = format!("sine of {hertz} Hz");
    if let Some(sine) = scenario.reference.sine.last_mut() {
        sine.period_seconds = 1.0 / hertz;
        scenario.run_mut().duration_seconds = sine.from_seconds + PERIODS_MIN / hertz;
    }
}

/// Changes the converter of the position sensor. Its resolution is in the sensor's data sheet, so the observer knows it
/// too.
pub fn set_resolution(scenario: &mut Trial, bits: u32) {
    let sensor = &mut scenario.sensor;
    sensor.resolution_bits = Some(bits);
    let step = sensor_step_millimetres(sensor);
    if let Some(law) = &mut scenario.controller.sliding_mode {
        law.observer.sensor_step_millimetres = step;
    }
}

/// Adds normal noise to the position sensor, in steps of its converter.
pub fn set_noise(scenario: &mut Trial, steps: f64) {
    let sensor = &mut scenario.sensor;
    sensor.noise_rms = Some(steps * sensor_step_millimetres(sensor));
}

/// Appends `times` repetitions of the last two ramps of the current.
pub fn repeat_loops(scenario: &mut Trial, times: usize) {
    let Some(open_loop) = &mut scenario.controller.open_loop else {
        return;
    };
    let ramps = &mut open_loop.ramp;
    let [.., first, second] = &ramps[..] else {
        return;
    };
    let turns = [first.clone(), second.clone()];
    let period = second.until_seconds - first.from_seconds;
    for number in 1..=times {
        let later = number as f64 * period;
        ramps.extend(turns.clone().map(|ramp| CurrentRamp {
            from_seconds: ramp.from_seconds + later,
            until_seconds: ramp.until_seconds + later,
            ..ramp
        }));
    }
    let added_seconds = times as f64 * period;
    scenario.run_mut().duration_seconds += added_seconds;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::bases;

    #[test]
    fn the_frequency_changes_period_and_length() {
        let mut scenario = bases::bandwidth();
        set_frequency(&mut scenario, 0.1);
        assert_eq!(scenario.run.duration_seconds, 105.0);
        let window = scenario.judged_sines()[0].window;
        assert!(
            (window.from_seconds - 75.0).abs() < 1e-9
                && (window.until_seconds - 105.0).abs() < 1e-9
        );
    }

    #[test]
    fn loops_follow_each_other() {
        let mut scenario = bases::hysteresis();
        repeat_loops(&mut scenario, 3);
        let ramps = &scenario.controller.open_loop.as_ref().unwrap().ramp;
        assert_eq!(ramps.len(), 10);
        assert!(
            ramps[2..]
                .windows(2)
                .all(|pair| pair[0].until_seconds == pair[1].from_seconds)
        );
        assert_eq!(ramps[9].until_seconds, scenario.run.duration_seconds);
    }

    #[test]
    fn the_observer_knows_the_resolution() {
        let mut scenario = bases::step();
        set_resolution(&mut scenario, 12);
        let step = scenario
            .controller
            .sliding_mode
            .unwrap()
            .observer
            .sensor_step_millimetres;
        assert_eq!(step, 60.0 / 4096.0);
    }
}
