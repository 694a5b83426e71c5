//! Experiments on the wire itself: transformation, stress and strain, and identification of its parameters.

use plant_emulator::plants::sma::stress_pascals;
use scenario::events::Window;
use scenario::plant::{Mechanics, Sma, StressStrain};

use super::bases;
use super::experiment::{
    Evaluation, Experiment, Keep, Kept, PlannedRun, Signals, currents, plot_over,
};
use super::families::{repeat_loops, set_noise};
use super::quantity::{Quantity, at_least, at_most, within};
use crate::identify::data::IdentificationData;
use crate::identify::fit::Fit;
use crate::identify::parameter::{self, Parameter};
use crate::identify::residual_test::ResidualTest;
use crate::identify::search;
use crate::identify::start::section_3;
use crate::identify::statistics::FitStatistics;
use report::plot::{Colour, Plot, Shape};

/// Number of minor loops after the first; they close within 1e-3 after about ten (PAPER E2).
const LOOPS_MORE: usize = 24;
/// Largest gap of a loop that counts as closed.
const CLOSED: f64 = 1e-3;

/// Parameters that the paper identifies, with its values as printed.
const IDENTIFIED: [(&str, &str); 6] = [
    ("C", "0.255 W/°C/m"),
    ("h", "7 W/m²°C/m"),
    ("As", "53 °C"),
    ("Af", "93 °C"),
    ("Ms", "66 °C"),
    ("Mf", "34 °C"),
];

/// Returns the experiments of this file, in the order of the paper's figures.
pub(super) fn experiments(is_reduced: bool) -> Vec<Experiment> {
    vec![hysteresis(), martensite(), identification(is_reduced)]
}

fn hysteresis() -> Experiment {
    let mut scenario = bases::hysteresis();
    repeat_loops(&mut scenario, LOOPS_MORE);
    let whole = Keep::Signals(Window::new(0.0, scenario.run.duration_seconds));
    Experiment {
        id: "hysteresis",
        title: "Fig. 5: phase transformation",
        text: "The martensite fraction over the temperature, both as the emulator reports them: the major loop from 0 to 1 A and back, \
               then minor loops. The fraction has no memory of earlier turning points, so a loop is not closed at once, but the loops converge.",
        runs: vec![PlannedRun::new("open loop", scenario, whole)],
        evaluate: |runs| runs.first().and_then(loops).unwrap_or_default(),
    }
}

fn loops(run: &Kept) -> Option<Evaluation> {
    let ramps = &run.scenario.controller.open_loop.as_ref()?.ramp;
    // The first minor loop is the last two ramps of the file.
    let first = ramps.len().checked_sub(2 * (LOOPS_MORE + 1))?;
    let [up, down, ..] = &ramps[first..] else {
        return None;
    };
    let (start, period) = (up.from_seconds, down.until_seconds - up.from_seconds);
    let Signals {
        time_seconds,
        temperature_celsius,
        martensite_fraction,
        ..
    } = &run.signals;
    let first = time_seconds.partition_point(|time| *time < start);
    let per_loop = time_seconds.partition_point(|time| *time < start + period) - first;
    let gaps: Vec<f64> = martensite_fraction[first..]
        .chunks_exact(per_loop.max(1))
        .collect::<Vec<_>>()
        .windows(2)
        .map(|pair| largest_difference(pair[0], pair[1]))
        .collect();
    let closed_after = gaps
        .iter()
        .position(|gap| *gap <= CLOSED)
        .map(|place| (place + 1) as f64);
    let numbers = vec![
        Quantity::derived(
            "gap_of_the_last_loop",
            "minor loops",
            gaps.last().copied().ok_or_else(|| "no loops".to_owned()),
            at_most(CLOSED),
        ),
        Quantity::derived(
            "loops_until_closed_to_0.001",
            "minor loops",
            closed_after.ok_or_else(|| "never closed".to_owned()),
            None,
        ),
    ];
    let mut figure = plot_over(
        "Martensite fraction ξ over temperature",
        "",
        "temperature (°C)",
    );
    let stretches = [
        ("major loop", Colour::Run(0), 0..first),
        ("minor loops", Colour::Run(3), first..time_seconds.len()),
    ];
    for (label, colour, rows) in stretches {
        let x = &temperature_celsius[rows.clone()];
        figure.draw(label, colour, Shape::Path, x, &martensite_fraction[rows]);
    }
    Some(Evaluation {
        numbers,
        figures: vec![figure],
        ..Evaluation::default()
    })
}

fn largest_difference(left: &[f64], right: &[f64]) -> f64 {
    let pairs = left.iter().zip(right);
    let differences = pairs.map(|(left, right)| (left - right).abs());
    differences.fold(0.0, f64::max)
}

fn martensite() -> Experiment {
    Experiment {
        id: "martensite",
        title: "Fig. 6: mechanical behaviour of the martensite",
        text: "Stress over strain by Eq. (3)–(5), from the emulator's own function; no stress is on the bus, so there is no run. The paper gives \
               no values: EA 75 GPa, EM 28 GPa and a largest elastic strain of 0.25 % are assumed. Eq. (9), the default, leaves the \
               martensite's part out.",
        runs: Vec::new(),
        evaluate: |_| stresses(),
    }
}

fn stresses() -> Evaluation {
    let law = Mechanics {
        stress_strain: StressStrain::Full,
        ..Mechanics::default()
    };
    let strain_max = 4.0 * law.martensite_yield_strain;
    let strains: Vec<f64> = (0..=400_u32)
        .map(|part| strain_max * f64::from(part) / 400.0)
        .collect();
    let percent: Vec<f64> = strains.iter().map(|strain| 100.0 * strain).collect();
    let mut figure = plot_over("Stress over strain", "MPa", "strain (%)");
    for (number, (fraction, label)) in [
        (1.0, "ξ = 1, Eq. (4)"),
        (0.5, "ξ = 0.5, Eq. (5)"),
        (0.0, "ξ = 0, Eq. (3)"),
    ]
    .into_iter()
    .enumerate()
    {
        let stress: Vec<f64> = strains
            .iter()
            .map(|strain| stress_pascals(&law, fraction, *strain) / 1e6)
            .collect();
        figure.draw(label, Colour::Run(number), Shape::Line, &percent, &stress);
    }
    Evaluation {
        figures: vec![figure],
        ..Evaluation::default()
    }
}

fn identification(is_reduced: bool) -> Experiment {
    let excitation = bases::identify_excitation();
    let mut runs = vec![
        PlannedRun::new("ramp", bases::ramp(), Keep::IdentificationData).coloured(Colour::Measured),
        PlannedRun::new(RICH, excitation.clone(), Keep::IdentificationData),
    ];
    if !is_reduced {
        let mut noisy = excitation;
        set_noise(&mut noisy, 1.0);
        runs.push(PlannedRun::new(NOISY, noisy, Keep::IdentificationData));
    }
    Experiment {
        id: "identification",
        title: "Fig. 9 and 10: current ramp and identification",
        text: "Six parameters by sequential quadratic programming from the a-priori values of the paper's Sec. 3, as canrig identify does. The \
               recordings are made with the paper's identified values, so these must come out: C and the temperatures within 1 %, h \
               within 5 %, with noise of one step of the sensor 8 %. The paper identifies from the ramp alone. That leaves h open, as its \
               standard error shows, so a staircase and a fan follow the ramp here. What comes of the ramp alone stands below: the fit is as good, and \
               the values are not the plant's. excess_of_the_residual is the largest of the residual's sizes, single or averaged, by what the sensor \
               alone leaves at most: above 1 the model would not explain the data.",
        runs,
        evaluate: identified,
    }
}

const RICH: &str = "ramp, staircase, fan";
const NOISY: &str = "the same with noise";

fn identified(runs: &[Kept]) -> Evaluation {
    let mut evaluation = Evaluation::default();
    let Some((ramp, rich)) = runs.split_first() else {
        return evaluation;
    };
    evaluation
        .figures
        .push(currents("Fig. 9 (a): current", &runs[..1]));
    for run in rich {
        match search(run) {
            Err(reason) => evaluation.numbers.push(not_found(run, reason)),
            Ok(statistics) => {
                evaluation.numbers.extend(found(&run.label, &statistics));
                if run.label == RICH {
                    let values = statistics.values();
                    evaluation.figures.extend(fits(ramp, run, &values));
                }
            }
        }
    }
    match search(ramp) {
        Err(reason) => evaluation.numbers.push(not_found(ramp, reason)),
        Ok(statistics) => evaluation.numbers.extend(found_in_ramp(&statistics)),
    }
    evaluation
}

/// Returns a missed target with the reason.
fn not_found(run: &Kept, reason: String) -> Quantity {
    let of = run.label.as_str();
    Quantity::derived("identification", of, Err(reason), at_least(0.0))
}

fn parameters() -> Vec<&'static Parameter> {
    let symbols = IDENTIFIED.map(|(symbol, _)| symbol);
    parameter::parse_list(&symbols.join(",")).unwrap_or_default()
}

fn fit(measurement: &IdentificationData) -> Fit<'_> {
    Fit::new(
        std::slice::from_ref(measurement),
        parameters(),
        Sma::default(),
    )
}

fn search(run: &Kept) -> Result<FitStatistics, String> {
    let fit = fit(run.measurement.as_ref()?);
    let found = search::search(&fit, &fit.values_in(&section_3()), &|_, _| {});
    Ok(found.map_err(|failure| failure.reason)?.statistics)
}

/// Returns the identified values with the true ones of the recording, and the quality of the fit.
fn found(of: &str, statistics: &FitStatistics) -> Vec<Quantity> {
    let truth = Sma::default();
    let values = statistics.values();
    let numbers = parameters().into_iter().zip(values).zip(IDENTIFIED).map(
        |((parameter, value), (_, paper))| {
            let tolerance = match (parameter.symbol, of) {
                ("h", NOISY) => 0.08,
                ("h", _) => 0.05,
                _ => 0.01,
            };
            let truth = parameter.get(&truth);
            let target = within(truth, tolerance);
            Quantity::derived(parameter.key(), of, Ok(value), target).beside(paper)
        },
    );
    numbers.chain(residuals(of, statistics)).collect()
}

/// Returns the quality of a fit.
fn residuals(of: &str, statistics: &FitStatistics) -> [Quantity; 2] {
    let excesses = statistics.residual_tests.iter().map(ResidualTest::excess);
    let excess = excesses.fold(0.0, f64::max);
    [
        Quantity::derived(
            "residual_millimetres_rms",
            of,
            Ok(1e3 * statistics.residual_metres_rms),
            None,
        ),
        Quantity::derived("excess_of_the_residual", of, Ok(excess), at_most(1.0)),
    ]
}

/// Makes plots of measured and simulated positions.
fn fits(ramp: &Kept, rich: &Kept, values: &[f64]) -> Vec<Plot<'static>> {
    let drawn = [
        ("Fig. 9 (b) and 10: position under the ramp", ramp),
        ("Position under ramp, staircase and fan", rich),
    ];
    let figure = |(title, run): (&str, &Kept)| {
        let measurement = run.measurement.as_ref().ok()?;
        let fit = fit(measurement);
        let millimetres =
            |metres: &[f64]| -> Vec<f64> { metres.iter().map(|metres| metres * 1e3).collect() };
        let simulated = |values: &[f64]| Some(millimetres(&fit.simulated_metres(values)?));
        let start = simulated(&fit.values_in(&section_3()))?;
        let measured = millimetres(&measurement.positions_metres);
        let found = simulated(values)?;
        let times = &measurement.times_seconds;
        let mut figure = Plot::over_time(title, "mm");
        for (label, colour, shape, positions) in [
            ("Sec. 3 values", Colour::Run(3), Shape::Line, start),
            ("measured", Colour::Measured, Shape::Line, measured),
            ("identified", Colour::Estimated, Shape::Dashed, found),
        ] {
            figure.draw(label, colour, shape, times, positions);
        }
        Some(figure)
    };
    drawn.into_iter().filter_map(figure).collect()
}

/// Returns the values from the ramp alone, with their standard errors.
fn found_in_ramp(statistics: &FitStatistics) -> Vec<Quantity> {
    let of = "from the ramp alone";
    let numbers = parameters()
        .into_iter()
        .zip(&statistics.estimates)
        .flat_map(|(parameter, estimate)| {
            let error = 100.0 * estimate.standard_error / estimate.value.abs();
            let error_name = format!("{}, {of}", parameter.symbol);
            [
                Quantity::derived(parameter.key(), of, Ok(estimate.value), None),
                Quantity::derived("standard_error_percent", error_name, Ok(error), None),
            ]
        });
    numbers.chain(residuals(of, statistics)).collect()
}
