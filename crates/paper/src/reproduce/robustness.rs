//! Robustness of the closed loop on plants that the controller does not know.

use scenario::Trial;
use scenario::expect::Expect;

use super::bases;
use super::experiment::{
    ComparedLaw, Effort, Evaluation, Experiment, Figure, Keep, Kept, PlannedRun, span,
};
use super::quantity::{Quantity, at_most};
use campaigns::distribution::{quantile, staircase};

/// Number of plants (PAPER, "Robustness").
const PLANTS: usize = 200;
const PLANTS_REDUCED: usize = 12;
/// Longest settling time of a stable step.
const UNSTABLE_SECONDS: f64 = 1.0;
/// Largest motion in the last second of a stable loop.
const HUNTING_MILLIMETRES: f64 = 0.25;
/// Targets of the p95 of settling time in seconds and of overshoot in per cent.
const TARGETS: [f64; 2] = [0.21, 2.5];
/// Laws that are compared.
const LAWS: [ComparedLaw; 3] = ComparedLaw::ALL;

/// Returns the experiments of this file.
pub(super) fn experiments(effort: Effort) -> Vec<Experiment> {
    vec![plants(effort), other_truth()]
}

fn plants(effort: Effort) -> Experiment {
    let count = match effort {
        Effort::Full => PLANTS,
        Effort::Reduced => PLANTS_REDUCED,
    };
    let expect = Expect::default()
        .with_max("settling_time_seconds", UNSTABLE_SECONDS)
        .with_max("hunting_millimetres", HUNTING_MILLIMETRES);
    let plants: Vec<Trial> = unknown_plants(count)
        .map(|plant| Trial {
            expect: expect.clone(),
            ..plant
        })
        .collect();
    let of_law = |law: ComparedLaw| {
        let played = plants.iter().map(move |plant| law.plays(plant));
        played.map(move |scenario| PlannedRun::new(law.name(), scenario, Keep::Verdict))
    };
    Experiment {
        id: "robustness",
        title: "Robustness: the step on plants that the controller does not know",
        text: "Independent uniform draws: C ± 10 %, h ± 30 %, each transformation temperature ± 5 °C, K0 ± 20 %, load ± 10 %, c ± 50 %, R ± 5 %. \
               The controller is untouched. Unstable is what has not settled within 1 s, or hunts: its \
               position goes by more than 0.25 mm in the last second. The paper says in one sentence that its \
               controller is robust.",
        runs: LAWS.into_iter().flat_map(of_law).collect(),
        evaluate: distributions,
    }
}

/// Returns the first cases of `scenarios/sweeps/plants.toml`: as many plants as are drawn there, without noise.
fn unknown_plants(count: usize) -> impl Iterator<Item = Trial> {
    let cases = bases::plants();
    (1..=count).map(move |number| {
        let plan = cases.case(number).plan();
        let plan = plan.expect("a test makes every plant");
        bases::only(&plan).clone()
    })
}

fn distributions(runs: &[Kept]) -> Evaluation {
    let mut evaluation = Evaluation::default();
    for law in LAWS {
        let own: Vec<&Kept> = runs.iter().filter(|run| run.label == law.name()).collect();
        let sorted = |name: &str| {
            let mut values: Vec<f64> = own
                .iter()
                .map(|run| run.metric(name).unwrap_or(f64::INFINITY))
                .collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let times = sorted("settling_time_seconds");
        let peaks = sorted("overshoot_percent");
        #[expect(clippy::cast_precision_loss, reason = "at most some hundred")]
        let count = |is_one: fn(&Kept) -> bool| own.iter().filter(|run| is_one(run)).count() as f64;
        let of = format!("{}, {} plants", law.name(), own.len());
        let limit = |max| at_most(max).filter(|_| law == ComparedLaw::SlidingMode);
        let [time_max, peak_max] = TARGETS;
        evaluation.numbers.extend(
            [
                Quantity::derived(
                    "settling_time_seconds_p95",
                    &*of,
                    p95(&times),
                    limit(time_max),
                ),
                Quantity::derived("overshoot_percent_p95", &*of, p95(&peaks), limit(peak_max)),
                Quantity::derived(
                    "unsettled_plants",
                    &*of,
                    Ok(count(is_unsettled)),
                    limit(0.0),
                ),
                Quantity::derived("hunting_plants", &*of, Ok(count(hunts)), limit(0.0)),
            ]
            .map(|number| number.with_model(own.first().and_then(|run| run.model()))),
        );
        evaluation.figures.extend([
            distribution(law, "settling time (s)", &times, time_max),
            distribution(law, "overshoot (%)", &peaks, peak_max),
        ]);
    }
    evaluation
}

fn is_unsettled(run: &Kept) -> bool {
    let time = run.metric("settling_time_seconds");
    time.is_none_or(|seconds| seconds > UNSTABLE_SECONDS)
}

/// Returns whether a run hunts. A run without the metric counts as hunting.
fn hunts(run: &Kept) -> bool {
    let range = run.metric("hunting_millimetres");
    range.is_none_or(|millimetres| millimetres > HUNTING_MILLIMETRES)
}

/// Makes a plot of the per cent of the plants up to each value. The laws differ too much for one plot.
fn distribution(
    law: ComparedLaw,
    quantity: &'static str,
    sorted: &[f64],
    target_max: f64,
) -> Figure {
    let title = format!("{}: plants up to a value", law.name());
    let mut figure = Figure::new(title, "%", quantity);
    let (x, y) = staircase(sorted);
    figure.line(quantity, law.colour(), &x, &y);
    figure.target = Some(((f64::NEG_INFINITY, target_max), (95.0, f64::INFINITY)));
    figure
}

/// Returns the p95 of the sorted values; infinite ones never settled.
fn p95(sorted: &[f64]) -> Result<f64, String> {
    match quantile(sorted, 95) {
        None => Err("no run".to_owned()),
        Some(value) if value.is_infinite() => Err("more than 5 % never settled".to_owned()),
        Some(value) => Ok(value),
    }
}

fn other_truth() -> Experiment {
    let keep = Keep::Signals(span(9.9, 12.0));
    let mut runs = PlannedRun::for_laws(&bases::step_other_truth(), &ComparedLaw::ALL, keep);
    let nominal = Trial {
        expect: Expect::default(),
        ..bases::step()
    };
    runs.push(PlannedRun::new(
        "sliding_mode on the nominal wire",
        nominal,
        keep,
    ));
    Experiment {
        id: "other_truth",
        title: "The step on another kind of wire",
        text: "The martensite carries load too (the full law, Eq. (3)–(5)), parameters have drifted, the sensor is noisy: the controller's \
               model is not only off in its numbers but of another kind. There is no target; the limits hold what it costs.",
        runs,
        evaluate: |runs| {
            let metrics = [
                "settling_time_seconds",
                "overshoot_percent",
                "steady_state_error_millimetres",
            ];
            let colours = ComparedLaw::ALL
                .map(ComparedLaw::colour)
                .into_iter()
                .chain([report::plot::Colour::True]);
            let coloured: Vec<_> = runs.iter().zip(colours).collect();
            let numbers = runs.iter().flat_map(|run| run.numbers(&metrics, &[]));
            Evaluation {
                numbers: numbers.collect(),
                figures: vec![
                    Figure::positions("Position", &coloured),
                    Figure::currents("Current", &coloured),
                ],
                ..Evaluation::default()
            }
        },
    }
}

#[cfg(test)]
mod tests {
    use scenario::plant::Sma;

    use super::*;

    #[test]
    fn the_plants_differ_from_the_nominal_one_within_their_ranges_and_have_no_noise() {
        let nominal = bases::step();
        assert!(unknown_plants(PLANTS).all(|trial| trial.sensor == nominal.sensor));
        let nominal = nominal.plant.actuator().unwrap();
        let plants = || unknown_plants(PLANTS).map(|trial| trial.plant.actuator().unwrap());
        let share = |low: f64, high: f64, of: &dyn Fn(&Sma) -> f64| {
            let values = || plants().map(|plant| of(&plant) / of(&nominal) - 1.0);
            let mean = values().sum::<f64>() / 200.0;
            assert!((mean.abs() < 0.1 * (high - low)), "{mean}");
            let (least, greatest) = values().fold((0.0, 0.0), |(least, greatest), value| {
                (f64::min(least, value), f64::max(greatest, value))
            });
            let is_near = |value: f64, end: f64| value.abs() <= end.abs() && value / end > 0.9;
            assert!(
                is_near(least, low) && is_near(greatest, high),
                "{least} {greatest}"
            );
        };
        share(-0.1, 0.1, &|plant| {
            plant.heat.conduction_watts_per_metre_kelvin
        });
        share(-0.3, 0.3, &|plant| {
            plant.heat.convection_watts_per_square_metre_kelvin
        });
        share(-0.05, 0.05, &|plant| plant.heat.resistance_ohms_per_metre);
        // K0 is proportional to EA, Eq. (9).
        share(-0.2, 0.2, &|plant| {
            plant.mechanics.austenite_modulus_pascals
        });
        share(-0.1, 0.1, &|plant| plant.mechanics.load_kilograms);
        share(-0.5, 0.5, &|plant| {
            plant.mechanics.damping_newton_seconds_per_metre
        });
        share(-5.0 / 53.0, 5.0 / 53.0, &|plant| {
            plant.phase.austenite_start_celsius
        });
        share(-5.0 / 93.0, 5.0 / 93.0, &|plant| {
            plant.phase.austenite_finish_celsius
        });
        share(-5.0 / 66.0, 5.0 / 66.0, &|plant| {
            plant.phase.martensite_start_celsius
        });
        share(-5.0 / 34.0, 5.0 / 34.0, &|plant| {
            plant.phase.martensite_finish_celsius
        });
    }

    #[test]
    fn a_p95_that_never_settled_is_none() {
        let mut values = vec![0.2; 189];
        assert_eq!(p95(&values), Ok(0.2));
        values.extend([f64::INFINITY; 11]);
        assert!(p95(&values).is_err());
        assert!(p95(&[]).is_err());
    }
}
