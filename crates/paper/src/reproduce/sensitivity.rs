//! Experiments on the sensitivity of the closed loop to cycle time, resolution and noise, and the price of a faster launch.

use std::fmt::Display;

use scenario::Trial;
use scenario::controller::SlidingModePaper;
use scenario::expect::Expect;

use super::bases;
use super::experiment::{
    ComparedLaw, Evaluation, Experiment, Keep, Kept, NumberTable, PlannedRun, plot_over,
};
use super::families::{set_noise, set_resolution};
use report::plot::Shape;
use report::terminal::significant;

const CYCLES_MILLISECONDS: [f64; 4] = [0.5, 1.0, 2.0, 5.0];
const RESOLUTIONS_BITS: [u32; 4] = [8, 10, 12, 16];
const NOISES_STEPS: [f64; 4] = [0.0, 0.5, 1.0, 2.0];
const LAUNCH_JERKS: [f64; 4] = [430.0, 250.0, 350.0, 500.0];

/// Column of a table: its head, the index of its run in a row, and the metric.
type TableColumn = (&'static str, usize, &'static str);

/// Scenarios and laws for each setting of the rig, and the columns of the table.
const RIG_BASES: [fn() -> Trial; 2] = [bases::step, bases::sine_5s];
const RIG_LAWS: [ComparedLaw; 2] = [ComparedLaw::SlidingMode, ComparedLaw::Pid];
const RIG_COLUMNS: [TableColumn; 5] = [
    ("settling (s)", 0, "settling_time_seconds"),
    ("overshoot (%)", 0, "overshoot_percent"),
    (
        "error in the hold (mm)",
        0,
        "steady_state_error_millimetres",
    ),
    (
        "RMS error, sine of 5 s (mm)",
        1,
        "tracking_error_millimetres_rms",
    ),
    ("cycles missed (%)", 0, "missed_cycles_percent"),
];

/// Scenarios for each launch, and the columns of the table.
const LAUNCH_BASES: [fn() -> Trial; 3] = [bases::step, bases::step_cold, bases::step_other_truth];
const LAUNCH_COLUMNS: [TableColumn; 6] = [
    ("settling (s)", 0, "settling_time_seconds"),
    ("overshoot (%)", 0, "overshoot_percent"),
    ("from cold: settling (s)", 1, "settling_time_seconds"),
    ("overshoot (%)", 1, "overshoot_percent"),
    ("other wire: settling (s)", 2, "settling_time_seconds"),
    ("overshoot (%)", 2, "overshoot_percent"),
];

/// Poles of the reference filter, which the paper does not give, and of the row of Eq. (14) as it is printed.
const FILTERS: [f64; 6] = [20.0, 24.0, 26.0, 28.0, 30.0, 33.0];
const FILTER_COLUMNS: [TableColumn; 2] = [
    ("settling (s)", 0, "settling_time_seconds"),
    ("overshoot (%)", 0, "overshoot_percent"),
];

/// Returns the experiments of this file.
pub(super) fn experiments(is_reduced: bool) -> Vec<Experiment> {
    let count = if is_reduced { 2 } else { 4 };
    vec![
        Experiment {
            id: "cycle_time",
            title: "Sensitivity to the cycle time",
            text: "The step of Fig. 11 and the sine of Fig. 12 (b) with other times between two SYNCs. The laws know the cycle and nothing \
                   else. At 0.5 ms the frames fill the bus of 1 Mbit/s nearly, and those cycles in which the controller explains itself are missed.",
            runs: on_rigs(&CYCLES_MILLISECONDS[..count], "ms", |scenario, cycle| {
                scenario.run_mut().bus.sync_period_milliseconds = cycle;
            }),
            evaluate: |runs| table(&RIG_COLUMNS, RIG_BASES.len(), runs),
        },
        Experiment {
            id: "resolution",
            title: "Sensitivity to the resolution of the position sensor",
            text: "The same with other converters. The observer knows the resolution, which is in a data sheet.",
            runs: on_rigs(&RESOLUTIONS_BITS[..count], "bit", set_resolution),
            evaluate: |runs| table(&RIG_COLUMNS, RIG_BASES.len(), runs),
        },
        Experiment {
            id: "noise",
            title: "Sensitivity to noise of the position sensor",
            text: "The same with normal noise before the 10-bit conversion, its standard deviation in steps of the converter (59 µm). The laws \
                   do not know of it.",
            runs: on_rigs(&NOISES_STEPS[..count], "steps", set_noise),
            evaluate: |runs| table(&RIG_COLUMNS, RIG_BASES.len(), runs),
        },
        Experiment {
            id: "launch",
            title: "What a faster launch costs",
            text: "The reference of sliding_mode starts a move with a jerk of 430 m/s³ as shipped, in the first row. A slower launch takes more \
                   than 0.20 s on the nominal wire. A faster one asks for more than a wire of another kind than the model can be braked from. \
                   A law that rings launches with as little as two thirds of it.",
            runs: launches(LAUNCH_JERKS.into_iter().take(count)),
            evaluate: |runs| table(&LAUNCH_COLUMNS, LAUNCH_BASES.len(), runs),
        },
        Experiment {
            id: "reference_filter",
            title: "The paper's law over its unknown: the filter of the reference",
            text: "Eq. (14) needs three derivatives of the set-point, and a step has none: something must have shaped it, of which the paper says \
                   nothing. We assume a critically damped filter of third order. With its poles at 20 rad/s, as shipped, it alone needs 0.315 s; \
                   from 24 to 33 rad/s the paper's λ, φ and KSM give 0.21 to 0.27 s, and so its 0.23 s. Its overshoot of 0.6 % comes out with \
                   none of them. The last row is Eq. (14) as it is printed (PAPER E4): it does not settle.",
            runs: filters(FILTERS.into_iter().take(count + 2)),
            evaluate: filter_evaluation,
        },
    ]
}

/// Returns step and sine under each law, for each setting of the rig.
fn on_rigs<T: Copy + Display>(
    settings: &[T],
    unit: &str,
    set: fn(&mut Trial, T),
) -> Vec<PlannedRun> {
    let mut runs = Vec::new();
    for setting in settings {
        for law in RIG_LAWS {
            for base in RIG_BASES {
                let mut scenario = law.plays(&base());
                set(&mut scenario, *setting);
                let label = format!("{setting} {unit}, {}", law.name());
                runs.push(reported(label, scenario));
            }
        }
    }
    runs
}

fn launches(jerks: impl Iterator<Item = f64>) -> Vec<PlannedRun> {
    let launch = |jerk: f64| {
        LAUNCH_BASES.map(|base| {
            let mut scenario = base();
            if let Some(law) = &mut scenario.controller.sliding_mode {
                law.reference_launch_jerk_metres_per_second_cubed = jerk;
            }
            reported(format!("{jerk} m/s³"), scenario)
        })
    };
    jerks.flat_map(launch).collect()
}

/// Returns the step under the paper's law with each filter, and as printed.
fn filters(poles: impl Iterator<Item = f64>) -> Vec<PlannedRun> {
    let step = |label: String, change: &dyn Fn(&mut SlidingModePaper)| {
        let mut trial = ComparedLaw::SlidingModePaper.plays(&bases::step());
        if let Some(law) = &mut trial.controller.sliding_mode_paper {
            change(law);
        }
        reported(label, trial)
    };
    let with_filter = poles.map(|poles| {
        step(format!("{poles} rad/s"), &|law| {
            law.reference_filter_radians_per_second = poles;
        })
    });
    let printed = step("as printed".to_owned(), &|law| law.as_printed = true);
    with_filter.chain([printed]).collect()
}

fn filter_evaluation(runs: &[Kept]) -> Evaluation {
    let filtered = runs.iter().filter_map(|run| {
        let law = run.scenario.controller.sliding_mode_paper.as_ref()?;
        (!law.as_printed).then_some((law.reference_filter_radians_per_second, run))
    });
    let filtered = Vec::from_iter(filtered);
    let figure = |title: &str, unit, metric: &str| {
        let point = |(poles, run): &(f64, &Kept)| Some((*poles, run.metric(metric)?));
        let (x, y): (Vec<f64>, Vec<f64>) = filtered.iter().filter_map(point).unzip();
        let mut figure = plot_over(title, unit, "poles of the reference filter (rad/s)");
        let colour = ComparedLaw::SlidingModePaper.colour();
        figure.draw(metric, colour, Shape::Line, &x, &y);
        figure
    };
    Evaluation {
        figures: vec![
            figure("Settling time", "s", "settling_time_seconds"),
            figure("Overshoot", "%", "overshoot_percent"),
        ],
        ..table(&FILTER_COLUMNS, 1, runs)
    }
}

/// Returns a run without limits: those of the files apply to their own settings.
fn reported(label: String, scenario: Trial) -> PlannedRun {
    let expect = Expect::default();
    PlannedRun::new(label, Trial { expect, ..scenario }, Keep::Verdict)
}

/// Returns a table with one row for each setting; the runs of a row follow each other.
fn table(columns: &'static [TableColumn], runs_per_row: usize, runs: &[Kept]) -> Evaluation {
    let header = std::iter::once("setting").chain(columns.iter().map(|(head, ..)| *head));
    let rows = runs.chunks(runs_per_row).map(|row| {
        let cells = columns.iter().map(|(_, place, metric)| {
            let value = row.get(*place).and_then(|run| run.metric(metric));
            value.map_or_else(|| "–".to_owned(), significant)
        });
        let label = row.first().map(|run| run.label.clone());
        label.into_iter().chain(cells).collect()
    });
    let table = NumberTable {
        header: header.collect(),
        rows: rows.collect(),
    };
    Evaluation {
        tables: vec![table],
        ..Evaluation::default()
    }
}
