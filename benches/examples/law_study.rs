//! Plays the sliding-mode law on many wires that it does not know, without a bus, and prints a line for each kinetics and noise:
//!
//! ```sh
//! cargo run --release --package canrig-benches --example law_study -- --plants 250 step
//! ```
//!
//! A run of 15 s takes milliseconds, so that a change of the law is compared on hundreds of wires within seconds. Its findings
//! are then measured with the program (`benches/compare/unknown_plants`), which differs by the frames' resolution only.
#![allow(
    clippy::print_stdout,
    reason = "a table for the terminal is what it is for"
)]

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use clap::{Parser, Subcommand};
use controller::law::{CommandRange, Cycle, Law, LoopReads};
use controller::laws::sliding_mode::SlidingMode;
use faults::Stream;
use plant_emulator::plant::Inputs;
use plant_emulator::plants::sma::Actuator;
use plant_emulator::sensor::PositionSensor;
use scenario::controller::SlidingMode as Config;
use scenario::plant::{Kinetics, Sma, StressStrain};
use scenario::reference::SetPoint;
use scenario::rig::nodes::Sensor;

const PERIOD_SECONDS: f64 = 1e-3;
/// Time of the step or the disturbance, and a part of a limit cycle of the hold before it.
const AT_SECONDS: f64 = 10.0;
const PHASE_SECONDS: f64 = 0.037;
const AFTER_SECONDS: f64 = 5.0;
/// Peak to peak of the last second above which a wire hunts, and the band around a set-point.
const HUNTING_METRES: f64 = 0.25e-3;
const BAND_METRES: f64 = 1.25e-3;

#[derive(Parser)]
struct Arguments {
    /// Wires to draw.
    #[arg(long, default_value_t = 100)]
    plants: u32,
    /// Number that the drawn wires depend on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Widths of the ranges, relative to those of scenarios/sweeps/plants.toml.
    #[arg(long, default_value_t = 1.0)]
    ranges: f64,
    /// Phases of the limit cycle before the step, for each wire.
    #[arg(long, default_value_t = 1)]
    phases: u32,
    /// Use the full law of Eq. (3) to (5) for the wires.
    #[arg(long)]
    full: bool,
    /// Give each wire to the law as its nominal model.
    #[arg(long)]
    known: bool,
    #[command(subcommand)]
    case: Case,
}

#[derive(Clone, Copy, Subcommand)]
enum Case {
    /// A step from 10 to 35 mm: settling time in s, overshoot in %, wires that hunt.
    Step,
    /// A hold: ripple of the current in A.
    Hold { millimetres: f64 },
    /// A mass that is hung on the load at 25 mm: largest deviation in mm, time until the load is back in s.
    Load { kilograms: f64 },
    /// A convection for 3 s at 35 mm, as a factor: as for a load.
    Fan { factor: f64 },
}

/// A run to play.
struct Job {
    plant: Sma,
    noise_millimetres: f64,
    seed: u64,
    at_seconds: f64,
}

/// Values of a run.
#[derive(Clone, Copy, Default)]
struct Outcome {
    /// Settling time, or time until the load is back.
    seconds: f64,
    /// Overshoot in per cent, deviation in mm, or ripple in A.
    most: f64,
    hunts: bool,
}

/// Draws a wire, uniformly from ranges about the nominal values.
fn drawn(random: &mut Stream, arguments: &Arguments, kinetics: Kinetics) -> Sma {
    let mut plant = Sma {
        kinetics,
        ..Sma::default()
    };
    let mut vary = |value: &mut f64, half: f64| {
        *value += arguments.ranges * half * (2.0 * random.uniform() - 1.0);
    };
    vary(&mut plant.heat.conduction_watts_per_metre_kelvin, 0.0255);
    vary(
        &mut plant.heat.convection_watts_per_square_metre_kelvin,
        2.1,
    );
    vary(&mut plant.heat.resistance_ohms_per_metre, 1.6);
    vary(&mut plant.phase.austenite_start_celsius, 5.0);
    vary(&mut plant.phase.austenite_finish_celsius, 5.0);
    vary(&mut plant.phase.martensite_start_celsius, 5.0);
    vary(&mut plant.phase.martensite_finish_celsius, 5.0);
    vary(&mut plant.mechanics.austenite_modulus_pascals, 15e9);
    vary(&mut plant.mechanics.load_kilograms, 0.004);
    vary(&mut plant.mechanics.damping_newton_seconds_per_metre, 0.25);
    if arguments.full {
        plant.mechanics.stress_strain = StressStrain::Full;
    }
    plant
}

fn law(plant: &Sma, is_known: bool) -> SlidingMode {
    let mut config = Config::default();
    if is_known {
        config.nominal_model = plant.into();
    }
    SlidingMode::new(&config, &[CommandRange::default()])
}

/// Returns the set-points before and after the step, and the plant's inputs from a time after the step on.
fn course(case: Case) -> ([f64; 2], impl Fn(f64, f64) -> Inputs) {
    let set_points = match case {
        Case::Step => [0.01, 0.035],
        Case::Hold { millimetres } => [1e-3 * millimetres; 2],
        Case::Load { .. } => [0.025; 2],
        Case::Fan { .. } => [0.035; 2],
    };
    let inputs = move |current_amperes, since: f64| {
        let still = Inputs {
            current_amperes,
            convection_factor: 1.0,
            added_load_kilograms: 0.0,
        };
        match case {
            Case::Load { kilograms } if since >= 0.0 => Inputs {
                added_load_kilograms: kilograms,
                ..still
            },
            Case::Fan { factor } if (0.0..3.0).contains(&since) => Inputs {
                convection_factor: factor,
                ..still
            },
            _ => still,
        }
    };
    (set_points, inputs)
}

fn play(job: &Job, arguments: &Arguments) -> Outcome {
    let ([from, to], inputs) = course(arguments.case);
    let law = law(&job.plant, arguments.known);
    let (mut state, mut plant) = (law.start(), Actuator::new(&job.plant));
    let config = Sensor {
        noise_rms: Some(job.noise_millimetres),
        ..Sensor::default()
    };
    let mut sensor = PositionSensor::new(&config, 1e-3, job.seed);
    let mut writes = vec![0.0; law.ports().outputs.len()];
    let mut outcome = Outcome::default();
    let (mut overshoot, mut deviation) = (f64::NEG_INFINITY, 0.0_f64);
    let (mut last, mut currents) = ([f64::INFINITY, f64::NEG_INFINITY], Vec::new());
    let end = job.at_seconds + AFTER_SECONDS;
    let mut time = 0.0;
    while time < end {
        let counts = sensor.sample(plant.position_metres());
        let position = sensor.position(counts);
        let since = time - job.at_seconds;
        let reads = LoopReads {
            position,
            set_point: SetPoint {
                position: if since >= 0.0 { to } else { from },
                ..SetPoint::default()
            },
        };
        let cycle = Cycle {
            scenario_time_seconds: time,
            period_seconds: PERIOD_SECONDS,
        };
        // The command acts from the next cycle on.
        let current = writes[0];
        law.step(&mut state, &cycle, &reads.values(), &mut writes);
        plant.advance(PERIOD_SECONDS, &inputs(current, since));
        time += PERIOD_SECONDS;
        if since >= 0.0 {
            overshoot = overshoot.max(position - to);
            deviation = deviation.max((position - to).abs());
            if (position - to).abs() > BAND_METRES {
                outcome.seconds = since + PERIOD_SECONDS;
            }
        }
        if time > end - 1.0 {
            last = [last[0].min(position), last[1].max(position)];
            currents.push(writes[0]);
        }
    }
    outcome.hunts = last[1] - last[0] > HUNTING_METRES;
    outcome.most = match arguments.case {
        Case::Step => 100.0 * overshoot / (to - from),
        Case::Hold { .. } => deviation_of(&currents),
        Case::Load { .. } | Case::Fan { .. } => 1e3 * deviation,
    };
    outcome
}

/// Returns the standard deviation.
#[allow(clippy::cast_precision_loss, reason = "a second has a thousand cycles")]
fn deviation_of(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean).powi(2));
    (squares.sum::<f64>() / count).sqrt()
}

fn played(jobs: &[Job], arguments: &Arguments) -> Vec<Outcome> {
    let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let outcome = play(job, arguments);
            outcomes.lock().expect("no thread panicked").push(outcome);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    outcomes.into_inner().expect("no thread panicked")
}

/// Returns median, p95 and the largest three values.
fn spread(outcomes: &[Outcome], value: fn(&Outcome) -> f64) -> String {
    let mut values: Vec<_> = outcomes.iter().map(value).collect();
    values.sort_by(f64::total_cmp);
    let at = |per_cent: usize| values[(values.len() * per_cent / 100).min(values.len() - 1)];
    let largest = values.iter().rev().take(3);
    let shown = [at(50), at(95)].into_iter().chain(largest.copied());
    let texts: Vec<_> = shown.map(|value| format!("{value:.4}")).collect();
    texts.join(", ")
}

fn main() {
    let arguments = Arguments::parse();
    println!(
        "| kinetics | noise (mm) | runs | seconds: p50, p95, worst three | most: the same | hunt |"
    );
    println!("|---|---|---|---|---|---|");
    for kinetics in [Kinetics::Paper, Kinetics::Nested, Kinetics::Preisach] {
        for noise_millimetres in [0.0, 0.03] {
            let mut jobs = Vec::new();
            let mut random = Stream::new(arguments.seed);
            for _ in 0..arguments.plants {
                let plant = drawn(&mut random, &arguments, kinetics);
                let seed = random.bits();
                jobs.extend((0..arguments.phases).map(|phase| Job {
                    plant: plant.clone(),
                    noise_millimetres,
                    seed,
                    at_seconds: AT_SECONDS + PHASE_SECONDS * f64::from(phase),
                }));
            }
            let outcomes = played(&jobs, &arguments);
            let hunting = outcomes.iter().filter(|outcome| outcome.hunts).count();
            println!(
                "| {kinetics:?} | {noise_millimetres} | {} | {} | {} | {hunting} |",
                outcomes.len(),
                spread(&outcomes, |outcome| outcome.seconds),
                spread(&outcomes, |outcome| outcome.most),
            );
        }
    }
}
