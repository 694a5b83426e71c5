//! How fast it goes down: a step, with the thermoelectric element and without it.

use scenario::Trial;
use scenario::expect::Expect;
use scenario::plant::{PlantModel, Sma};

use super::bases;
use super::experiment::{Evaluation, Experiment, Figure, Keep, Kept, PlannedRun, span};
use super::quantity::{Quantity, at_least};
use super::response::steps;
use report::plot::Colour;

/// Targets of the step down: its height, too, is 25 mm.
const DOWN_SECONDS: f64 = 0.3;
const DOWN_PERCENT: f64 = 0.6;
/// What is shown of a step down without the thermoelectric element.
const COOLING_SECONDS: f64 = 20.0;
/// Its conduction there. The controller's model needs one above 0.
const CONDUCTION_WITHOUT: f64 = 1e-6;
/// The element must make the step so many times faster at least.
const FASTER_TIMES: f64 = 10.0;
const WITH_ELEMENT: &str = "thermoelectric element";

/// The experiments of this file.
pub(super) fn experiments() -> Vec<Experiment> {
    vec![step_down(), cooling()]
}

/// As the step, the other way.
fn down() -> Trial {
    let mut scenario = bases::step();
    scenario.run_mut().name = "25 mm down from a warm hold".to_owned();
    let reference = &mut scenario.reference;
    reference.hold[0].position_millimetres = 35.0;
    reference.step[0].position_millimetres = 10.0;
    scenario.expect = Expect::default()
        .with_max("settling_time_seconds", DOWN_SECONDS)
        .with_max("overshoot_percent", DOWN_PERCENT);
    scenario
}

fn step_down() -> Experiment {
    Experiment {
        id: "step_down",
        title: "Step of 25 mm down",
        text: "35 mm are held for 10 s, then 10 mm are wanted. Down no current helps: the wire must cool, and the law can only stop it in time.",
        runs: PlannedRun::with_twin(&down(), Keep::Signals(span(9.9, 11.5))),
        evaluate: |runs| steps(runs, &[], None),
    }
}

fn cooling() -> Experiment {
    let keep = Keep::Signals(span(9.5, 10.0 + COOLING_SECONDS));
    let mut with = down();
    with.run_mut().duration_seconds = 10.0 + COOLING_SECONDS;
    let mut air_alone = Sma::default();
    air_alone.heat.conduction_watts_per_metre_kelvin = CONDUCTION_WITHOUT;
    let mut without = Trial {
        expect: Expect::default(),
        plant: PlantModel::of_sma(air_alone),
        ..with.clone()
    };
    without.run_mut().name = "25 mm down without the thermoelectric element".to_owned();
    if let Some(law) = &mut without.controller.sliding_mode {
        law.nominal_model.conduction_watts_per_metre_kelvin = CONDUCTION_WITHOUT;
    }
    Experiment {
        id: "cooling",
        title: "Cooling with and without the thermoelectric element",
        text: "The paper's main claim: a thermoelectric element that cools the wire makes the actuator fast. The same step from 35 to 10 mm, with \
               the element (C = 0.255 W/(m K)) and with air alone (C = 0). The law knows which. Air takes tens of times \
               longer, and where the load has come too low it is slow to correct.",
        runs: vec![
            PlannedRun::new(WITH_ELEMENT, with, keep),
            PlannedRun::new("air alone", without, keep),
        ],
        evaluate: cooled,
    }
}

fn cooled(runs: &[Kept]) -> Evaluation {
    let colours = [Colour::Measured, Colour::Run(3)];
    let coloured: Vec<(&Kept, Colour)> = runs.iter().zip(colours).collect();
    let time = "settling_time_seconds";
    let mut numbers: Vec<Quantity> = runs
        .iter()
        .flat_map(|run| run.numbers(&[time], &[]))
        .collect();
    if let [with, without] = runs {
        let ratio = with.metric(time).zip(without.metric(time));
        let ratio = ratio.map(|(with, without)| without / with);
        numbers.push(Quantity::derived(
            "settling_times_without_by_with",
            "both",
            ratio.ok_or_else(|| "one never settled".to_owned()),
            at_least(FASTER_TIMES),
        ));
    }
    Evaluation {
        numbers,
        figures: vec![
            Figure::positions("Position", &coloured),
            Figure::temperatures("Wire temperature", &coloured),
        ],
        ..Evaluation::default()
    }
}
