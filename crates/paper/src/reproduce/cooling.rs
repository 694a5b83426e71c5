//! Experiment on the speed of cooling: a step down, with the thermoelectric element and without it.

use scenario::Trial;
use scenario::events::Window;
use scenario::expect::Expect;
use scenario::plant::{PlantModel, Sma};

use super::bases;
use super::experiment::{
    Evaluation, Experiment, Keep, Kept, NumberTable, PlannedRun, positions, temperatures,
};
use super::quantity::{Quantity, at_least};
use super::response::steps;
use report::plot::Colour;
use report::terminal::significant;

/// Targets of the step down, whose height is 25 mm as well.
const DOWN_SECONDS: f64 = 0.3;
const DOWN_PERCENT: f64 = 0.6;
/// Time for the step down without the thermoelectric element.
const COOLING_SECONDS: f64 = 60.0;
/// Convection of still air in W/(m² K): the paper's value, and usual values for thin wires.
const CONVECTIONS: [f64; 4] = [7.0, 30.0, 70.0, 100.0];
/// Conduction without the element. The controller's model needs one above 0.
const CONDUCTION_WITHOUT: f64 = 1e-6;
/// Smallest ratio of the two durations, with the paper's convection.
const FASTER_TIMES: f64 = 10.0;
const WITH_ELEMENT: &str = "thermoelectric element";
const TIME: &str = "settling_time_seconds";
const DOWN: &str = "time_down_seconds";
const NEVER: &str = "never";
/// Half width of the band about the new place: 5 % of the step's height.
const BAND_MILLIMETRES: f64 = 1.25;
/// Shortest stay in the band at the end of a run that counts as settled; after less, the load may leave it again.
const OPEN_SECONDS: f64 = 20.0;

/// Returns the experiments of this file.
pub(super) fn experiments() -> Vec<Experiment> {
    vec![step_down(), cooling()]
}

/// Returns the step in the other direction.
fn down() -> Trial {
    let mut scenario = bases::step();
    let reference = &mut scenario.reference;
    reference.hold[0].position = 35.0;
    reference.step[0].position = 10.0;
    scenario.expect = Expect::default()
        .with_max("settling_time_seconds", DOWN_SECONDS)
        .with_max("overshoot_percent", DOWN_PERCENT);
    scenario
}

fn step_down() -> Experiment {
    Experiment {
        id: "step_down",
        title: "Step of 25 mm down",
        text: "35 mm are held for 10 s, then 10 mm are wanted. Down no current helps: the wire must cool, and the law can only stop it in time. \
               The best that a search with full knowledge of the plant found is 0.229 s.",
        runs: PlannedRun::with_twin(&down(), Keep::Signals(Window::new(9.9, 11.5))),
        evaluate: |runs| steps(runs, &[], None),
    }
}

fn cooling() -> Experiment {
    let keep = Keep::Signals(Window::new(9.5, 10.0 + COOLING_SECONDS));
    let pairs = CONVECTIONS.into_iter().flat_map(|convection| {
        let with = cooled_by(convection, None);
        let without = cooled_by(convection, Some(CONDUCTION_WITHOUT));
        let label = |how: &str| {
            if convection == CONVECTIONS[0] {
                how.to_owned()
            } else {
                format!("{how}, h = {convection}")
            }
        };
        [
            PlannedRun::new(label(WITH_ELEMENT), with, keep).coloured(Colour::Measured),
            PlannedRun::new(label("air alone"), without, keep).coloured(Colour::Run(3)),
        ]
    });
    Experiment {
        id: "cooling",
        title: "Cooling with and without the thermoelectric element",
        text: "The paper's main claim: a thermoelectric element that cools the wire makes the actuator fast. The same step from 35 to 10 mm, with \
               the element (C = 0.255 W/(m K)) and with air alone (C = 0). The law knows which. How many times longer air takes hangs on its \
               convection h. The paper's 7 W/(m² K) is its own fit of a ramp, which determines h to 72 % only; usual for a thin wire are 30 to \
               100. Down means that the load is first within 5 % of the step about its new place. Without the element it need not stay there: \
               where it has come too low, the law heats, and then waits for the air again.",
        runs: pairs.collect(),
        evaluate: cooled,
    }
}

/// Returns the step down in air of this convection; `conduction` replaces the paper's value.
fn cooled_by(convection: f64, conduction: Option<f64>) -> Trial {
    let mut trial = down();
    trial.run_mut().duration_seconds = 10.0 + COOLING_SECONDS;
    let mut wire = Sma::default();
    wire.heat.convection_watts_per_square_metre_kelvin = convection;
    let nominal = wire.heat.conduction_watts_per_metre_kelvin;
    wire.heat.conduction_watts_per_metre_kelvin = conduction.unwrap_or(nominal);
    if let Some(law) = &mut trial.controller.sliding_mode {
        law.nominal_model.convection_watts_per_square_metre_kelvin = convection;
        law.nominal_model.conduction_watts_per_metre_kelvin = conduction.unwrap_or(nominal);
    }
    if conduction.is_some() || convection != CONVECTIONS[0] {
        trial.expect = Expect::default();
    }
    trial.set_plant(PlantModel::from_sma(wire));
    trial
}

fn cooled(runs: &[Kept]) -> Evaluation {
    let [with, without, ..] = runs else {
        return Evaluation::default();
    };
    let down = [with, without].map(|run| {
        let seconds = seconds_down(run).ok_or_else(|| NEVER.to_owned());
        Quantity::derived(DOWN, &*run.label, seconds, None)
    });
    let times = times_longer(with, without).ok_or_else(|| NEVER.to_owned());
    let times = Quantity::derived(
        "times_down_without_by_with",
        "both",
        times,
        at_least(FASTER_TIMES),
    );
    let limited = with.numbers(&[TIME], &[]);
    let rows = CONVECTIONS
        .iter()
        .zip(runs.chunks_exact(2))
        .map(|(convection, pair)| {
            let cell = |value: Option<f64>| value.map_or_else(|| NEVER.to_owned(), significant);
            let down = pair.iter().map(|run| cell(seconds_down(run)));
            let settled = pair.iter().map(settled);
            let times = cell(times_longer(&pair[0], &pair[1]));
            let cells = [significant(*convection)]
                .into_iter()
                .chain(down)
                .chain([times]);
            cells.chain(settled).collect()
        });
    let header = [
        "h (W/(m² K))",
        "down with the element (s)",
        "air alone (s)",
        "times",
        "settled with the element (s)",
        "air alone (s)",
    ];
    Evaluation {
        numbers: limited.into_iter().chain(down).chain([times]).collect(),
        figures: vec![
            positions("Position", &runs[..2]),
            temperatures("Wire temperature", &runs[..2]),
        ],
        tables: vec![NumberTable {
            header: header.to_vec(),
            rows: rows.collect(),
        }],
    }
}

/// Returns the time from the step until the load is first in the band about its new place.
fn seconds_down(run: &Kept) -> Option<f64> {
    let step = run.scenario.reference.step.first()?;
    let signals = &run.signals;
    let times = signals.time_seconds.iter();
    let mut samples = times.zip(&signals.position_millimetres);
    let band = step.position + BAND_MILLIMETRES;
    let (time, _) =
        samples.find(|(time, position)| **time > step.at_seconds && **position <= band)?;
    Some(time - step.at_seconds)
}

/// Returns the settling time. A load that comes back into the band only in the last seconds has not settled.
fn settled(run: &Kept) -> String {
    let is_over = |seconds: &f64| *seconds < COOLING_SECONDS - OPEN_SECONDS;
    let seconds = run.metric(TIME).filter(is_over);
    seconds.map_or_else(|| format!("not within {COOLING_SECONDS} s"), significant)
}

/// Returns the ratio of the second run's time down to the first one's.
fn times_longer(with: &Kept, without: &Kept) -> Option<f64> {
    let times = seconds_down(with).zip(seconds_down(without));
    times.map(|(with, without)| without / with)
}
