//! Experiment on the robustness of the closed loop on plants that the controller does not know.

use scenario::Trial;
use scenario::events::Window;
use scenario::expect::Expect;

use super::bases;
use super::experiment::{
    ComparedLaw, Evaluation, Experiment, Keep, Kept, NumberTable, PlannedRun, by_label, plot_over,
};
use super::quantity::{Quantity, at_most};
use super::response::steps;
use campaigns::distribution::{quantile, staircase};
use report::plot::{Patch, Plot, Shape};

/// Number of plants (PAPER, "Robustness").
const PLANTS: usize = 200;
const PLANTS_REDUCED: usize = 12;
/// Hold before the step, as in the sweep.
const HOLD_SECONDS: f64 = 10.0;
/// Time after the step, in which a law is decided: within it the sliding modes rest, and a PID may still creep.
const DECIDED_SECONDS: f64 = 12.0;
const DECIDED_SECONDS_PID: f64 = 60.0;
/// Largest swing at the end of a loop that does not hunt, and smallest ratio to the swing before it of one that does:
/// a swing that decays is no hunting.
const HUNTING_MILLIMETRES: f64 = 0.25;
const HUNTING_RATIO: f64 = 0.9;
/// Targets of the p95 of settling time in seconds and of overshoot in per cent.
const TARGETS: [f64; 2] = [0.21, 2.5];
/// Number of the worst plants that are named.
const WORST: usize = 3;
/// Label of a PID that is tuned over plants. The shipped one is tuned on a single one.
const TUNED: &str = "pid, tuned over plants";

/// Returns the experiments of this file.
pub(super) fn experiments(is_reduced: bool) -> Vec<Experiment> {
    vec![plants(is_reduced), other_truth()]
}

fn plants(is_reduced: bool) -> Experiment {
    let count = if is_reduced { PLANTS_REDUCED } else { PLANTS };
    let plants = Vec::from_iter(unknown_plants(count));
    let trial = |law: ComparedLaw, plant: &Trial| {
        let decided_seconds = match law {
            ComparedLaw::Pid => DECIDED_SECONDS_PID,
            _ => DECIDED_SECONDS,
        };
        let mut trial = law.plays(plant);
        trial.run_mut().duration_seconds = HOLD_SECONDS + decided_seconds;
        trial
    };
    let mut runs = Vec::new();
    for law in ComparedLaw::ALL {
        let run = |plant| PlannedRun::of_law(law, trial(law, plant), Keep::Verdict);
        runs.extend(plants.iter().map(run));
    }
    let controller = bases::pid_over_plants();
    runs.extend(plants.iter().map(|plant| {
        let mut tuned = trial(ComparedLaw::Pid, plant);
        tuned.controller = controller.clone();
        PlannedRun::new(TUNED, tuned, Keep::Verdict)
    }));
    Experiment {
        id: "robustness",
        title: "Robustness: the step on plants that the controller does not know",
        text: "Independent uniform draws: C ± 10 %, h ± 30 %, each transformation temperature ± 5 °C, K0 ± 20 %, load ± 10 %, c ± 50 %, R ± 5 %. \
               The controller is untouched. Unsettled is what does not come to stay within ± 5 % of the step in 12 s, under a PID in 60 s. A \
               loop hunts if its position swings by more than 0.25 mm in the last 5 s, and by 0.9 of the 5 s before at least: else it comes to \
               rest. The shipped PID is tuned on one plant; the other one over plants (scenarios/sweeps/pid.toml). The paper says in one \
               sentence that its controller is robust.",
        runs,
        evaluate: distributions,
    }
}

/// Returns the first cases of `scenarios/sweeps/plants.toml` without limits: as many plants as are drawn there, without noise.
fn unknown_plants(count: usize) -> impl Iterator<Item = Trial> {
    let cases = bases::plants();
    (1..=count).map(move |number| {
        let plan = cases.case(number).plan().expect("a test makes every plant");
        Trial {
            expect: Expect::default(),
            ..bases::only(&plan).clone()
        }
    })
}

fn distributions(runs: &[Kept]) -> Evaluation {
    let mut evaluation = Evaluation::default();
    let mut rows = Vec::new();
    for kept in by_label(runs) {
        let label = &kept[0].label;
        let sorted = |name: &str| {
            let mut values: Vec<f64> = kept
                .iter()
                .map(|run| run.metric(name).unwrap_or(f64::INFINITY))
                .collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let times = sorted("settling_time_seconds");
        let peaks = sorted("overshoot_percent");
        let count =
            |is_one: fn(&Kept) -> bool| kept.iter().filter(|run| is_one(run)).count() as f64;
        let of = format!("{label}, {} plants", kept.len());
        let limit = |max| at_most(max).filter(|_| label == ComparedLaw::SlidingMode.name());
        let [time_max, peak_max] = TARGETS;
        let unsettled = count(|run| run.metric("settling_time_seconds").is_none());
        let hunting = count(hunts);
        evaluation.numbers.extend(
            [
                Quantity::derived(
                    "settling_time_seconds_p95",
                    &*of,
                    p95(&times),
                    limit(time_max),
                ),
                Quantity::derived("overshoot_percent_p95", &*of, p95(&peaks), limit(peak_max)),
                Quantity::derived("unsettled_plants", &*of, Ok(unsettled), limit(0.0)),
                Quantity::derived("hunting_plants", &*of, Ok(hunting), limit(0.0)),
            ]
            .map(|number| number.with_model(kept[0].model())),
        );
        rows.push(
            [label.clone()]
                .into_iter()
                .chain(spread(&times, 3))
                .chain(spread(&peaks, 1))
                .collect(),
        );
        if label != TUNED {
            evaluation.figures.extend([
                distribution(&kept[0], "settling time (s)", &times, time_max),
                distribution(&kept[0], "overshoot (%)", &peaks, peak_max),
            ]);
        }
    }
    let header = [
        "law",
        "settling time (s), p50",
        "p95",
        "the worst three",
        "overshoot (%), p50",
        "p95",
        "the worst three",
    ];
    evaluation.tables.push(NumberTable {
        header: header.to_vec(),
        rows,
    });
    evaluation
}

/// Returns the median, the p95 and the worst of sorted values.
fn spread(sorted: &[f64], decimals: usize) -> [String; 3] {
    let text = |value: f64| {
        if value.is_finite() {
            format!("{value:.decimals$}")
        } else {
            "never".to_owned()
        }
    };
    let of = |percent| quantile(sorted, percent).map_or_else(String::new, text);
    let largest = sorted.iter().rev().take(WORST);
    let worst = Vec::from_iter(largest.map(|value| text(*value)));
    [of(50), of(95), worst.join(", ")]
}

/// Returns whether a run hunts. A run whose swings were not seen counts as hunting.
fn hunts(run: &Kept) -> bool {
    run.swings_millimetres.is_none_or(is_lasting)
}

fn is_lasting([before, last]: [f64; 2]) -> bool {
    last > HUNTING_MILLIMETRES && last >= HUNTING_RATIO * before
}

/// Makes a plot of the per cent of the plants up to each value. The laws differ too much for one plot.
fn distribution(
    of: &Kept,
    quantity: &'static str,
    sorted: &[f64],
    target_max: f64,
) -> Plot<'static> {
    let title = format!("{}: plants up to a value", of.label);
    let mut figure = plot_over(&title, "%", quantity);
    let (x, y) = staircase(sorted);
    figure.draw(quantity, of.colour, Shape::Line, &x, &y);
    figure.patches.push(Patch::band(
        (f64::NEG_INFINITY, target_max),
        (95.0, f64::INFINITY),
    ));
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
    let keep = Keep::Signals(Window::new(9.9, 12.0));
    let mut runs = PlannedRun::for_laws(&bases::step_other_truth(), keep);
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
        evaluate: |runs| steps(runs, &[], None),
    }
}

#[cfg(test)]
mod tests {
    use scenario::plant::Sma;

    use super::*;

    #[test]
    fn the_plants_differ_from_the_nominal_one_within_their_ranges_and_have_no_noise() {
        let nominal = bases::step();
        let sensor = |Trial { sensor, .. }: &Trial| {
            let resolution = (sensor.resolution_bits(), sensor.position_increment);
            (sensor.range(), resolution, sensor.noise_rms())
        };
        assert!(unknown_plants(PLANTS).all(|trial| sensor(&trial) == sensor(&nominal)));
        let nominal = nominal.plant().actuator().unwrap();
        let plants = || unknown_plants(PLANTS).map(|trial| trial.plant().actuator().unwrap());
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
    fn a_swing_that_decays_is_no_hunting() {
        assert!(is_lasting([0.3, 0.28]));
        assert!(!is_lasting([0.4, 0.3]));
        assert!(!is_lasting([0.2, 0.2]));
    }

    #[test]
    fn the_pid_over_plants_is_another_one_than_the_shipped() {
        let tuned = bases::pid_over_plants().pid.unwrap();
        assert_ne!(tuned, scenario::controller::Pid::default());
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
