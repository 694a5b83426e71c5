//! A plant for the tests of the laws: a nominal model, seen through the rig's position sensor, one cycle late.

use scenario::controller::{Controller, NominalModel as ModelConfig, SlidingMode};
use scenario::reference::SetPoint;
use scenario::wiring::Wiring;

use crate::catalogue::law;
use crate::law::{Cycle, LoopReads};
use crate::mode::Settings;
use crate::nominal_model::NominalModel;
use crate::process_law::Window;

/// Cycle of the rig.
pub(crate) const PERIOD_SECONDS: f64 = 1e-3;

/// One cycle of a law that ignores the time.
pub(crate) const CYCLE: Cycle = Cycle {
    scenario_time_seconds: 0.0,
    period_seconds: PERIOD_SECONDS,
};

/// One step of the rig's 10-bit converter over 60 mm.
pub(crate) const SENSOR_STEP_METRES: f64 = 0.06 / 1024.0;

/// Returns a position as the rig's sensor measures it.
pub(crate) fn sampled(position_metres: f64) -> f64 {
    libm::round(position_metres / SENSOR_STEP_METRES) * SENSOR_STEP_METRES
}

/// Returns the settings of a sound move.
pub(crate) fn in_move() -> Settings {
    let config = SlidingMode::default();
    Settings {
        bandwidth: config.bandwidth_radians_per_second,
        fraction_drift: config.observer.fraction_drift,
        heating_drift: config.observer.heating_drift_kelvins_per_second,
        trusts_model: false,
        caution: 0.0,
        liveliness: 1.0,
    }
}

/// Returns the settings of a calm hold.
pub(crate) fn in_hold() -> Settings {
    let hold = SlidingMode::default().hold;
    Settings {
        bandwidth: hold.bandwidth_radians_per_second,
        fraction_drift: hold.fraction_drift,
        heating_drift: hold.heating_drift_kelvins_per_second,
        trusts_model: true,
        ..in_move()
    }
}

/// Returns a set-point without derivatives.
pub(crate) fn hold(position: f64) -> SetPoint {
    SetPoint {
        position,
        ..SetPoint::default()
    }
}

/// A recorded cycle.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) time_seconds: f64,
    pub(crate) position_metres: f64,
    pub(crate) temperature_celsius: f64,
    /// Outputs of the law, by name.
    writes: Vec<(String, f64)>,
}

impl Row {
    pub(crate) fn term(&self, name: &str) -> f64 {
        let mut writes = self.writes.iter();
        writes.find(|(output, _)| output == name).unwrap().1
    }

    pub(crate) fn command(&self) -> f64 {
        self.term("command")
    }
}

/// Runs a law on a plant with these parameters.
pub(crate) fn run(
    controller: &Controller,
    plant: &ModelConfig,
    seconds: f64,
    set_point: impl Fn(f64) -> SetPoint,
) -> Vec<Row> {
    let mut law = law(controller, &Wiring::default()).unwrap();
    let plant = NominalModel::new(plant);
    let mut state = plant.start();
    let mut writes = vec![0.0; law.ports().outputs.len()];
    let mut current = 0.0;
    let mut rows = Vec::new();
    let mut time_seconds = 0.0;
    while time_seconds < seconds {
        let reads = LoopReads {
            position: sampled(state.position_metres),
            set_point: set_point(time_seconds),
        };
        let cycle = Cycle {
            scenario_time_seconds: time_seconds,
            ..CYCLE
        };
        law.step(&cycle, &Window::default(), &reads.values(), &mut writes);
        let outputs = law.ports().outputs.iter();
        rows.push(Row {
            time_seconds,
            position_metres: reads.position,
            temperature_celsius: state.temperature_celsius,
            writes: outputs
                .zip(&writes)
                .map(|(port, value)| (port.name.clone(), *value))
                .collect(),
        });
        state = plant.advance(&state, current * current, PERIOD_SECONDS);
        current = writes[0];
        time_seconds += PERIOD_SECONDS;
    }
    rows
}

/// Returns the settling time into ±5 % and the overshoot in percent of a step.
pub(crate) fn settling_and_overshoot(rows: &[Row], at: f64, from: f64, to: f64) -> (f64, f64) {
    let height = to - from;
    let after = || rows.iter().filter(|row| row.time_seconds >= at);
    let outside = after().filter(|row| (row.position_metres - to).abs() > 0.05 * height.abs());
    let settling = outside.fold(0.0, |_, row| row.time_seconds + PERIOD_SECONDS - at);
    let overshoot = after().fold(0.0, |most: f64, row| {
        most.max((row.position_metres - to) / height)
    });
    (settling, 100.0 * overshoot)
}
