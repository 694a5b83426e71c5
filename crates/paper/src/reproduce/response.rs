//! Experiments on the response of the closed loop: steps, sines, fan, load, and unreachable set-points.

use scenario::Trial;
use scenario::events::Window;
use scenario::expect::Expect;
use scenario::plant::{Kinetics, PlantModel, Sma};

use super::bases;
use super::experiment::{
    ComparedLaw, Evaluation, Experiment, Keep, Kept, PlannedRun, by_label, currents, plot_over,
    positions, with_runs,
};
use super::families::set_frequency;
use super::quantity::{Paper, Quantity, at_least};
use judge::CUT_OFF_GAIN;
use report::plot::{Colour, Patch, Plot, Shape};

/// Frequencies of the stepped sine. They are dense near the bandwidths.
const FREQUENCIES_HERTZ: [f64; 22] = [
    0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.25, 3.5, 3.75, 4.0,
    4.25, 4.5, 4.75, 5.0,
];
/// Distance of the frequencies that a reduced reproduction plays.
const EVERY_REDUCED: usize = 4;
/// Largest mean distance from the set-point that counts as following it.
const CENTRED_MILLIMETRES: f64 = 1.0;

const STEP_METRICS: [&str; 3] = [
    "settling_time_seconds",
    "overshoot_percent",
    "steady_state_error_millimetres",
];
const DISTURBANCE_METRICS: [&str; 3] = [
    "maximum_deviation_millimetres",
    "recovery_time_seconds",
    "steady_state_error_millimetres",
];

/// Returns the experiments of this file, in the order of the paper's figures.
pub(super) fn experiments(is_reduced: bool) -> Vec<Experiment> {
    vec![
        Experiment {
            id: "step",
            title: "Fig. 11: step of 25 mm from a warm hold",
            text: "10 mm are held for 10 s, then 35 mm are wanted. Settled means within ± 5 % of the step's height for good. The paper does not \
                   say where its step starts; from cold no current up to 1 A lifts the load within 0.23 s. The best that a search over currents with full \
                   knowledge of the plant found is 0.158 s. How fast the paper's own law is hangs on a \
                   filter that the paper does not give (below: the paper's law over its unknown).",
            runs: PlannedRun::with_twin(&bases::step(), Keep::Signals(Window::new(9.9, 11.5))),
            evaluate: |runs| {
                let paper = [
                    ("settling_time_seconds", "0.23 s"),
                    ("overshoot_percent", "0.6 %"),
                ];
                let target = Some(Patch::band((10.23, f64::INFINITY), (33.75, 36.25)));
                steps(runs, &paper, target)
            },
        },
        Experiment {
            id: "step_cold",
            title: "Step of 25 mm from cold",
            text: "Without current until time 0, the wire at its 15 °C, then 25 mm are wanted. Until the load lifts, the position shows \
                   nothing of the wire. The best that a search with full knowledge of the plant found is 0.39 s.",
            runs: PlannedRun::with_twin(&bases::step_cold(), Keep::Signals(Window::new(0.0, 2.0))),
            evaluate: |runs| {
                steps(
                    runs,
                    &[],
                    Some(Patch::band((0.5, f64::INFINITY), (23.75, 26.25))),
                )
            },
        },
        Experiment {
            id: "sine_20s",
            title: "Fig. 12 (a): sine with a period of 20 s",
            text: "25 mm and an amplitude of 1 cm, as in the paper; the error counts over the last three of four periods. The paper: \"despite a small oscillation around the \
                   set-point, the system follows the reference with good accuracy\".",
            runs: PlannedRun::with_twin(&bases::sine_20s(), Keep::Signals(Window::new(65.0, 85.0))),
            evaluate: sine,
        },
        Experiment {
            id: "sine_5s",
            title: "Fig. 12 (b): sine with a period of 5 s",
            text: "As before, with a period of 5 s.",
            runs: PlannedRun::with_twin(&bases::sine_5s(), Keep::Signals(Window::new(25.0, 30.0))),
            evaluate: sine,
        },
        bandwidth(is_reduced),
        Experiment {
            id: "infeasible",
            title: "Recovery from set-points that cannot be followed",
            text: "A sine of 6 Hz and ± 20 mm, then 60 mm, which the stiffened wire cannot reach. Judged is the step to 25 mm after them.",
            runs: PlannedRun::with_twin(
                &bases::infeasible(),
                Keep::Signals(Window::new(4.5, 13.0)),
            ),
            evaluate: |runs| steps(runs, &[], None),
        },
        fan(),
        Experiment {
            id: "load",
            title: "Another load",
            text: "25 mm are held with 40 g; 10 g are added, and taken off again 5 s later. The deviation is the worse of both. The paper's law \
                   deviates less than ours where the weight is taken off, and needs longer to be back.",
            runs: PlannedRun::with_twin(&bases::load(), Keep::Signals(Window::new(9.5, 17.0))),
            evaluate: |runs| courses(runs, &DISTURBANCE_METRICS, &[], None),
        },
    ]
}

/// Evaluates steps, with plots of position and current.
pub(super) fn steps(runs: &[Kept], paper: &Paper, target: Option<Patch>) -> Evaluation {
    courses(runs, &STEP_METRICS, paper, target)
}

/// Evaluates these metrics, with plots of position and current.
fn courses(runs: &[Kept], metrics: &[&str], paper: &Paper, target: Option<Patch>) -> Evaluation {
    let mut position = positions("Position", runs);
    position.patches.extend(target);
    Evaluation {
        numbers: numbers(runs, metrics, paper),
        figures: vec![position, currents("Current", runs)],
        ..Evaluation::default()
    }
}

fn sine(runs: &[Kept]) -> Evaluation {
    let paper = [("tracking_error_millimetres_rms", "\"good accuracy\"")];
    let plot = Plot::over_time("Error: position − set-point", "mm");
    let error = with_runs(plot, runs, |signals| {
        let positions = signals.position_millimetres.iter();
        let pairs = positions.zip(&signals.set_point_millimetres);
        pairs.map(|(position, wanted)| position - wanted).collect()
    });
    Evaluation {
        numbers: numbers(runs, &["tracking_error_millimetres_rms"], &paper),
        figures: vec![positions("Position, the last period", runs), error],
        ..Evaluation::default()
    }
}

fn bandwidth(is_reduced: bool) -> Experiment {
    let base = bases::bandwidth();
    let every = if is_reduced { EVERY_REDUCED } else { 1 };
    let sweep = |law: ComparedLaw| {
        // Frequencies are chosen from the highest on, so that few of them still show the fall of the gain.
        let first = (FREQUENCIES_HERTZ.len() - 1) % every;
        let frequencies = FREQUENCIES_HERTZ.into_iter().skip(first).step_by(every);
        let base = law.plays(&base);
        frequencies.map(move |hertz| {
            let mut scenario = base.clone();
            set_frequency(&mut scenario, hertz);
            // The limits of the file apply to its own frequency.
            scenario.expect = Expect::default();
            PlannedRun::of_law(law, scenario, Keep::Verdict)
        })
    };
    let twin = bases::twin();
    let on_twin = sweep(ComparedLaw::SlidingMode).map(|mut run| {
        run.scenario.set_plant(twin.clone());
        PlannedRun {
            label: ComparedLaw::SlidingMode.on_twin(),
            colour: Colour::True,
            ..run
        }
    });
    Experiment {
        id: "bandwidth",
        title: "Bandwidth: stepped sine of ± 10 mm",
        text: "A warm run of ten periods for each frequency, the last three count. Gain and phase compare the fundamental of the measured \
               position with that of the raw set-point, by least squares. The bandwidth is the last frequency before the gain \
               first falls below 0.708. Near its end the load cannot fall fast enough and hangs above the set-point, so the mean offset counts \
               too; with the mean kept, a search with full knowledge of the plant reaches 3.7 Hz. The paper gives its cut-off frequencies without the amplitude.",
        runs: ComparedLaw::ALL
            .into_iter()
            .flat_map(sweep)
            .chain(on_twin)
            .collect(),
        evaluate: responses,
    }
}

const GAIN: &str = "sine_gain";
const OFFSET: &str = "sine_offset_millimetres";

/// The frequency response under one law: its runs, from the lowest frequency on.
struct Response<'a>(&'a [Kept]);

impl Response<'_> {
    fn hertz(&self) -> Vec<f64> {
        self.0.iter().filter_map(hertz).collect()
    }

    fn values(&self, metric: &str) -> Vec<f64> {
        let values = self.0.iter().map(|run| run.metric(metric));
        values.map(|value| value.unwrap_or(f64::NAN)).collect()
    }

    fn numbers(&self) -> [Quantity; 3] {
        let first = &self.0[0];
        let of = first.label.as_str();
        let (hertz, offsets) = (self.hertz(), self.values(OFFSET));
        // The index of the last frequency before the gain first falls below the cut-off.
        let by_gain = last_before(&self.values(GAIN), |gain| gain >= CUT_OFF_GAIN);
        let is_centred = |offset: f64| offset.abs() <= CENTRED_MILLIMETRES;
        let centred = by_gain.min(last_before(&offsets, is_centred));
        let value = |values: &[f64], place: Option<usize>| {
            let value = place.and_then(|place| values.get(place).copied());
            value.ok_or_else(|| "below the lowest frequency".to_owned())
        };
        let bandwidth = Quantity::derived("bandwidth_hertz", of, value(&hertz, by_gain), None);
        let [ours, pid] = [ComparedLaw::SlidingMode, ComparedLaw::Pid].map(ComparedLaw::name);
        // A sine that hangs above its set-point is not followed, whatever its gain.
        [
            match of {
                of if of == ours => bandwidth.beside("0.69 Hz"),
                of if of == pid => bandwidth.beside("0.37 Hz"),
                _ => bandwidth,
            },
            Quantity::derived(
                "offset_at_the_bandwidth_millimetres",
                of,
                value(&offsets, by_gain),
                None,
            ),
            Quantity::derived(
                "bandwidth_hertz_with_an_offset_within_1_millimetre",
                of,
                value(&hertz, centred),
                at_least(3.0).filter(|_| of == ours),
            ),
        ]
        .map(|number| number.with_model(first.model()))
    }
}

fn responses(runs: &[Kept]) -> Evaluation {
    let responses = Vec::from_iter(by_label(runs).map(Response));
    let figure = |title, unit, metric| {
        let mut figure = plot_over(title, unit, "frequency (Hz)");
        for response in responses.iter().rev() {
            let (x, y) = (response.hertz(), response.values(metric));
            let first = &response.0[0];
            figure.draw(&*first.label, first.colour, Shape::Line, &x, &y);
        }
        figure
    };
    let mut gain = figure("Gain", "", GAIN);
    let ends = [
        FREQUENCIES_HERTZ[0],
        FREQUENCIES_HERTZ[FREQUENCIES_HERTZ.len() - 1],
    ];
    gain.draw(
        "−3 dB",
        Colour::Wanted,
        Shape::Dashed,
        &ends,
        &[CUT_OFF_GAIN; 2],
    );
    Evaluation {
        numbers: responses.iter().flat_map(Response::numbers).collect(),
        figures: vec![
            gain,
            figure("Phase", "°", "sine_phase_degrees"),
            figure("Mean offset from the set-point", "mm", OFFSET),
        ],
        ..Evaluation::default()
    }
}

fn hertz(run: &Kept) -> Option<f64> {
    let sine = run.scenario.reference.sine.last()?;
    // The frequency was a short decimal before it became a period.
    Some(libm::round(1e6 / sine.period_seconds) / 1e6)
}

/// Returns the index before the first value that is not good.
fn last_before(values: &[f64], is_good: impl Fn(f64) -> bool) -> Option<usize> {
    let good = values.iter().take_while(|value| is_good(**value));
    good.count().checked_sub(1)
}

/// Times relative to the start of a disturbance between which it is shown.
const AROUND_SECONDS: (f64, f64) = (-1.0, 6.0);

/// The runs without feedback, by the kinetics of the wire.
const OPEN_LOOP: [(&str, Kinetics, Colour); 3] = [
    ("open loop", Kinetics::Paper, Colour::Run(1)),
    ("open loop, nested", Kinetics::Nested, Colour::Run(2)),
    ("open loop, Preisach", Kinetics::Preisach, Colour::Run(3)),
];

fn fan() -> Experiment {
    let (closed, open) = (bases::fan(), bases::fan_open_loop());
    let window = |scenario: &Trial| {
        let start = start(scenario);
        Keep::Signals(Window::new(
            start + AROUND_SECONDS.0,
            start + AROUND_SECONDS.1,
        ))
    };
    let mut runs = PlannedRun::with_twin(&closed, window(&closed));
    runs.extend(OPEN_LOOP.map(|(label, kinetics, colour)| {
        let mut trial = open.clone();
        if kinetics != Kinetics::default() {
            trial.set_plant(PlantModel::from_sma(Sma {
                kinetics,
                ..Sma::default()
            }));
            trial.expect = Expect::default();
        }
        PlannedRun::new(label, trial, window(&open)).coloured(colour)
    }));
    Experiment {
        id: "fan",
        title: "Fig. 13: a fan blows at the wire",
        text: "35 mm are held; for 3 s the convection is five times as strong. (a) In closed loop, and (b) under the constant current that \
               holds 35 mm without the fan. The deviation counts until 3 s after the fan is off. Without feedback the load comes back from the \
               fan to where it was only if the wire remembers its turns: with the paper's kinetics it stays higher for good.",
        runs,
        evaluate: |runs| {
            let (closed, open) = runs.split_at(runs.len().saturating_sub(OPEN_LOOP.len()));
            let paper = [("maximum_deviation_millimetres", "plot")];
            let mut numbers = numbers(closed, &DISTURBANCE_METRICS, &paper);
            let open_numbers = open
                .iter()
                .flat_map(|run| run.numbers(&DISTURBANCE_METRICS[..1], &paper));
            numbers.extend(open_numbers);
            Evaluation {
                numbers,
                figures: vec![
                    disturbed("(a) Position in closed loop", closed),
                    disturbed("(b) Position without feedback", open),
                ],
                ..Evaluation::default()
            }
        },
    }
}

/// Returns the start of the first disturbance.
fn start(scenario: &Trial) -> f64 {
    let windows = scenario.disturbances();
    windows
        .first()
        .map_or(0.0, |disturbance| disturbance.window.from_seconds)
}

/// Makes a plot of the positions over the time since the disturbance began.
fn disturbed(title: &str, runs: &[Kept]) -> Plot<'static> {
    let mut figure = plot_over(title, "mm", "time since the fan started (s)");
    for run in runs.iter().rev() {
        let start = start(&run.scenario);
        let times = run.signals.time_seconds.iter();
        let times = Vec::from_iter(times.map(|time| time - start));
        let positions = &run.signals.position_millimetres;
        figure.draw(&*run.label, run.colour, Shape::Line, times, positions);
    }
    let disturbances = runs.first().map(|run| run.scenario.disturbances());
    if let Some([first, ..]) = disturbances.as_deref() {
        let seconds = first.window.until_seconds - first.window.from_seconds;
        figure.patches.push(Patch::stretch("span", (0.0, seconds)));
    }
    figure
}

/// Returns these metrics of each run; those of `sliding_mode` have the paper's values.
fn numbers(runs: &[Kept], metrics: &[&str], paper: &Paper) -> Vec<Quantity> {
    let run_numbers = |run: &Kept| {
        let paper = if run.label == ComparedLaw::SlidingMode.name() {
            paper
        } else {
            &[]
        };
        run.numbers(metrics, paper)
    };
    runs.iter().flat_map(run_numbers).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::experiment::Signals;
    use judge::verdict::{Metric, Verdict};

    #[test]
    fn the_bandwidth_ends_where_the_gain_first_falls_or_the_mean_leaves() {
        let run = |hertz: f64, gain: f64, offset: f64| {
            let mut verdict = Verdict::incomplete("sine", 1, "");
            let gain = Some(gain).filter(|gain| gain.is_finite());
            let gain = gain.ok_or_else(|| "no sine".to_owned());
            verdict.metrics = vec![
                Metric::new(GAIN, gain, None),
                Metric::new(OFFSET, Ok(offset), None),
            ];
            let mut scenario = bases::bandwidth();
            set_frequency(&mut scenario, hertz);
            Kept {
                label: "pid".to_owned(),
                colour: Colour::Run(3),
                scenario,
                verdict,
                signals: Signals::default(),
                swings_millimetres: None,
                measurement: Err(String::new()),
            }
        };
        let response = |gain: &[f64], offset: &[f64]| {
            let values = [0.5, 1.0, 2.0, 3.0].into_iter().zip(gain).zip(offset);
            let runs = values.map(|((hertz, gain), offset)| run(hertz, *gain, *offset));
            let runs = Vec::from_iter(runs);
            let [gain, _, centred] = Response(&runs).numbers();
            (gain.metric.value, centred.metric.value)
        };
        let centred = [0.0, 0.1, -0.9, 0.0];
        let (half, one, three) = (Some(0.5), Some(1.0), Some(3.0));
        assert_eq!(response(&[1.0, 0.9, 0.7, 0.9], &centred), (one, one));
        assert_eq!(response(&[1.0, 1.1, f64::NAN, 1.0], &centred), (one, one));
        assert_eq!(response(&[1.0, 0.9, 0.8, 0.71], &centred), (three, three));
        assert_eq!(
            response(&[1.0, 0.9, 0.8, 0.71], &[0.0, 2.0, 0.0, 0.0]),
            (three, half)
        );
        assert_eq!(response(&[0.5, 1.0, 1.0, 1.0], &centred), (None, None));
    }
}
