//! Comparison with the reference trajectories, made by an independent event-located integrator, at the shipped step
//! size.

use plant_emulator::plant::Inputs;
use plant_emulator::plants::sma::Actuator;
use scenario::plant::Sma;

/// Time between two rows.
const ROW_SECONDS: f64 = 0.01;

/// Length of the pieces with constant inputs that take the place of varying ones. The temperature turns between two of them, so
/// they are shorter than a step.
const PIECE_SECONDS: f64 = 1e-4;

/// Margin of the shipped step size to the required 20 µm, 0.01 °C and 1e-4.
const MARGIN: f64 = 100.0;

/// Largest deviations over all rows.
#[derive(Debug, Default)]
struct Deviation {
    position_metres: f64,
    temperature_celsius: f64,
    martensite_fraction: f64,
}

/// Runs `profile(start of the row's interval, time)`; the first argument selects the stretch, so that jumps lie on edges. The
/// inputs are constant for at most `piece_seconds`.
fn deviation(file: &str, piece_seconds: f64, profile: impl Fn(f64, f64) -> Inputs) -> Deviation {
    let path = format!("{}/tests/data/{file}", env!("CARGO_MANIFEST_DIR"));
    let mut reader = csv::Reader::from_path(path).expect("the copied file");
    let mut actuator = Actuator::new(&Sma::default());
    let mut largest = Deviation::default();
    let mut rows = 0;
    let mut start = 0.0;
    for row in reader.deserialize() {
        let [time, _, temperature, fraction, position, _]: [f64; 6] =
            row.expect("six numbers in a row");
        let pieces = ((time - start) / piece_seconds).round();
        let length = (time - start) / pieces;
        let mut piece = 0.0;
        while piece < pieces {
            actuator.advance(length, &profile(start, start + (piece + 0.5) * length));
            piece += 1.0;
        }
        start = time;
        rows += 1;
        let widen = |largest: &mut f64, found: f64, expected: f64| {
            *largest = largest.max((found - expected).abs());
        };
        widen(
            &mut largest.position_metres,
            actuator.position_metres(),
            position,
        );
        widen(
            &mut largest.temperature_celsius,
            actuator.temperature_celsius(),
            temperature,
        );
        widen(
            &mut largest.martensite_fraction,
            actuator.martensite_fraction(),
            fraction,
        );
    }
    assert!(rows > 1000, "{file} has {rows} rows of {ROW_SECONDS} s");
    largest
}

fn check(file: &str, piece_seconds: f64, profile: impl Fn(f64, f64) -> Inputs) {
    let largest = deviation(file, piece_seconds, profile);
    assert!(
        largest.position_metres < 20e-6 / MARGIN,
        "{file}: {largest:?}"
    );
    assert!(
        largest.temperature_celsius < 0.01 / MARGIN,
        "{file}: {largest:?}"
    );
    assert!(
        largest.martensite_fraction < 1e-4 / MARGIN,
        "{file}: {largest:?}"
    );
}

fn current(current_amperes: f64) -> Inputs {
    Inputs {
        current_amperes,
        ..Inputs::default()
    }
}

/// Returns whether the interval that starts at `start` lies after `edge`.
fn after(start: f64, edge: f64) -> bool {
    start > edge - 0.5 * ROW_SECONDS
}

#[test]
fn heat_cool() {
    check("heat_cool.csv", ROW_SECONDS, |start, _| {
        current(if after(start, 1.0) && !after(start, 5.0) {
            0.62
        } else {
            0.0
        })
    });
}

#[test]
fn current_ramp() {
    check("current_ramp.csv", PIECE_SECONDS, |start, time| {
        current(if after(start, 20.0) {
            0.8 * (40.0 - time) / 20.0
        } else {
            0.8 * time / 20.0
        })
    });
}

#[test]
fn minor_loops() {
    check("minor_loops.csv", PIECE_SECONDS, |start, time| {
        let angle = std::f64::consts::TAU * 0.4 * (time - 1.0);
        current(if after(start, 1.0) {
            0.56 + 0.08 * libm::sin(angle)
        } else {
            0.0
        })
    });
}

#[test]
fn fan_pulse() {
    check("fan_pulse.csv", ROW_SECONDS, |start, _| Inputs {
        current_amperes: if after(start, 1.0) { 0.60 } else { 0.0 },
        convection_factor: if after(start, 8.0) && !after(start, 11.0) {
            5.0
        } else {
            1.0
        },
        ..Inputs::default()
    });
}
