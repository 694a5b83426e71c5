//! Experiments: runs, and the evaluation of their recordings.

use std::path::Path;

use scenario::Trial;
use scenario::controller::NominalModel;
use scenario::events::Window;
use scenario::expect::Expect;
use scenario::plant::{Kinetics, Sma, StressStrain};

use super::bases;
use super::quantity::{Model, Paper, Quantity};
use crate::identify::data::IdentificationData;
use campaigns::campaign;
use judge::swing;
use judge::verdict::{Metric, Verdict};
use recording::timeline::{Series, Timeline};
use report::plot::{Colour, Plot, Shape};

/// An experiment: data, and the function that evaluates its runs.
pub struct Experiment {
    /// Name of the experiment for other programs.
    pub id: &'static str,
    /// Heading of the experiment.
    pub title: &'static str,
    /// Description of the experiment, and of the paper's statement on it.
    pub text: &'static str,
    /// Runs to play.
    pub runs: Vec<PlannedRun>,
    /// Function that makes numbers and figures of the runs, which come in the same order.
    pub evaluate: fn(&[Kept]) -> Evaluation,
}

/// A run that an experiment needs.
pub struct PlannedRun {
    /// Difference from the other runs of the experiment.
    pub label: String,
    /// Scenario to play.
    pub scenario: Trial,
    /// Data to keep in addition to the verdict.
    pub keep: Keep,
    /// Colour of the run in plots.
    pub colour: Colour,
}

/// Length of each of the last two spans of a run whose swings are compared.
pub(super) const SWING_SECONDS: f64 = 5.0;

/// Data of a run to keep in addition to its verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// No further data.
    Verdict,
    /// The signals in a span of time.
    Signals(Window),
    /// The signals of the whole run, and its positions for identification.
    IdentificationData,
}

/// The data of a played run.
pub struct Kept {
    /// Label as in [`PlannedRun`].
    pub label: String,
    /// Colour as in [`PlannedRun`].
    pub colour: Colour,
    /// Scenario that was played.
    pub scenario: Trial,
    /// Verdict of the run.
    pub verdict: Verdict,
    /// The signals that were kept.
    pub signals: Signals,
    /// Distance between the highest and the lowest short mean of the position in the last two spans of [`SWING_SECONDS`].
    pub swings_millimetres: Option<[f64; 2]>,
    /// Positions for identification, or the reason why there are none.
    pub measurement: Result<IdentificationData, String>,
}

/// Some signals of a run over time.
#[derive(Clone, Debug, Default)]
pub struct Signals {
    /// Scenario time.
    pub time_seconds: Vec<f64>,
    /// The raw set-point.
    pub set_point_millimetres: Vec<f64>,
    /// Position as the drive measures it.
    pub position_millimetres: Vec<f64>,
    /// The current.
    pub current_amperes: Vec<f64>,
    /// True temperature of the wire.
    pub temperature_celsius: Vec<f64>,
    /// True martensite fraction.
    pub martensite_fraction: Vec<f64>,
}

/// Result of an experiment.
#[derive(Default)]
pub struct Evaluation {
    /// Numbers of the experiment.
    pub numbers: Vec<Quantity>,
    /// Plots of the experiment.
    pub figures: Vec<Plot<'static>>,
    /// Tables, for numbers that are compared with each other.
    pub tables: Vec<NumberTable>,
}

/// An experiment with its result.
pub(crate) struct ExperimentResult {
    /// The experiment.
    pub experiment: Experiment,
    /// Numbers and figures.
    pub evaluation: Evaluation,
}

impl ExperimentResult {
    /// Returns whether no target is missed.
    pub(crate) fn holds(&self) -> bool {
        self.evaluation.numbers.iter().all(Quantity::holds)
    }

    /// Returns the quantities that have a value in the paper or a target, for every law and plant.
    pub(crate) fn headline(&self) -> Vec<&Quantity> {
        let numbers = &self.evaluation.numbers;
        let is_compared = |name: &str| {
            let mut named = numbers.iter().filter(|number| number.name() == name);
            named.any(Quantity::is_compared)
        };
        let headline = numbers.iter().filter(|number| is_compared(number.name()));
        headline.collect()
    }
}

/// A table of numbers.
pub struct NumberTable {
    /// Heads of the columns.
    pub header: Vec<&'static str>,
    /// Rows of cells.
    pub rows: Vec<Vec<String>>,
}

/// Laws that are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparedLaw {
    /// The bench's own law, with an observer.
    SlidingMode,
    /// The law as the paper prints it, with errata.
    SlidingModePaper,
    /// PID, tuned by ITAE.
    Pid,
}

impl ComparedLaw {
    /// All laws, the bench's own first.
    pub const ALL: [Self; 3] = [Self::SlidingMode, Self::SlidingModePaper, Self::Pid];

    /// Returns the name of its table in a scenario.
    pub fn name(self) -> &'static str {
        match self {
            Self::SlidingMode => "sliding_mode",
            Self::SlidingModePaper => "sliding_mode_paper",
            Self::Pid => "pid",
        }
    }

    /// Returns the label of the same law on a plant that is not its model.
    pub fn on_twin(self) -> String {
        format!("{}, another plant", self.name())
    }

    /// Returns the scenario under this law with its shipped gains. The limits are meant for `sliding_mode`; those of other laws
    /// are only reported.
    pub fn plays(self, base: &Trial) -> Trial {
        let mut scenario = base.clone();
        let shipped = format!("[{}]", self.name());
        scenario.controller = toml::from_str(&shipped).expect("a law that ships");
        if self != Self::SlidingMode {
            scenario.expect = Expect::default();
        }
        scenario
    }

    /// Returns the colour of the law in plots.
    pub fn colour(self) -> Colour {
        match self {
            Self::SlidingMode => Colour::Measured,
            Self::SlidingModePaper => Colour::Run(4),
            Self::Pid => Colour::Run(3),
        }
    }
}

impl PlannedRun {
    /// Makes a run of a scenario, whose name gets the label.
    pub fn new(label: impl Into<String>, mut scenario: Trial, keep: Keep) -> Self {
        let label = label.into();
        scenario.run_mut().name += &format!(", {label}");
        Self {
            label,
            scenario,
            keep,
            colour: Colour::True,
        }
    }

    /// Sets another colour of the run in plots.
    #[must_use]
    pub fn coloured(self, colour: Colour) -> Self {
        Self { colour, ..self }
    }

    /// Makes a run of a scenario under a law.
    pub fn of_law(law: ComparedLaw, scenario: Trial, keep: Keep) -> Self {
        Self::new(law.name(), scenario, keep).coloured(law.colour())
    }

    /// Returns one run for each law.
    pub fn for_laws(base: &Trial, keep: Keep) -> Vec<Self> {
        let run = |law: ComparedLaw| Self::of_law(law, law.plays(base), keep);
        ComparedLaw::ALL.map(run).into()
    }

    /// Returns the runs of [`PlannedRun::for_laws`], and one of `sliding_mode` on another plant, without limits.
    pub fn with_twin(base: &Trial, keep: Keep) -> Vec<Self> {
        let mut runs = Self::for_laws(base, keep);
        let law = ComparedLaw::SlidingMode;
        let mut twin = law.plays(base);
        twin.set_plant(bases::twin());
        twin.expect = Expect::default();
        runs.push(Self::new(law.on_twin(), twin, keep));
        runs
    }

    /// Keeps the data of a recording that the experiment needs.
    pub fn keep(&self, played: &campaign::CampaignRun<'_>) -> Kept {
        let window = match self.keep {
            Keep::Verdict => None,
            Keep::Signals(window) => Some(window),
            Keep::IdentificationData => Some(Window::new(0.0, self.scenario.run.duration_seconds)),
        };
        let measurement = match self.keep {
            Keep::IdentificationData => {
                IdentificationData::from_frames(Path::new(&self.label), played.frames, played.plan)
            }
            _ => Err("nothing was kept of the run".to_owned()),
        };
        let timeline = played.only_timeline();
        let signals = window.zip(timeline);
        Kept {
            label: self.label.clone(),
            colour: self.colour,
            scenario: self.scenario.clone(),
            verdict: played.verdict.clone(),
            signals: signals.map_or_else(Signals::default, Signals::new),
            swings_millimetres: timeline
                .and_then(|one| swings_millimetres(&one.time_seconds, one.position())),
            measurement,
        }
    }
}

impl Signals {
    fn new((window, timeline): (Window, &Timeline)) -> Self {
        let times = &timeline.time_seconds;
        let first = times.partition_point(|time| time < window.from_seconds);
        let end = times.partition_point(|time| time <= window.until_seconds);
        let part = |values: &Series<f64>| Vec::from_iter(values.range(first..end.max(first)));
        let column = |name: &str| {
            timeline
                .column(name)
                .map(|column| part(&column.values))
                .unwrap_or_default()
        };
        Self {
            time_seconds: part(times),
            set_point_millimetres: part(timeline.set_point()),
            position_millimetres: part(timeline.position()),
            current_amperes: timeline.current().map(part).unwrap_or_default(),
            temperature_celsius: column("wire_temperature_celsius"),
            martensite_fraction: column("martensite_fraction"),
        }
    }
}

/// Returns the swings of the span before the last one, and of the last one; `None` if one of them has no position.
fn swings_millimetres(times: &Series<f64>, positions: &Series<f64>) -> Option<[f64; 2]> {
    let end = times.last()?;
    let swing_from = |from: f64| {
        let first = times.partition_point(|time| time <= from);
        let last = times.partition_point(|time| time <= from + SWING_SECONDS);
        let rows = times.range(first..last).zip(positions.range(first..last));
        let seen = rows.filter(|(_, position)| position.is_finite());
        swing(&Vec::from_iter(seen), from)
    };
    Some([
        swing_from(end - 2.0 * SWING_SECONDS)?,
        swing_from(end - SWING_SECONDS)?,
    ])
}

impl Kept {
    /// Returns the relation of the law's model to the plant; `None` for laws without a model.
    pub fn model(&self) -> Option<Model> {
        let controller = &self.scenario.controller;
        let model = match &controller.sliding_mode {
            Some(law) => &law.nominal_model,
            None => &controller.sliding_mode_paper.as_ref()?.nominal_model,
        };
        let plant = self.scenario.plant().actuator()?;
        Some(if is_equal(model, &plant) {
            Model::EqualsThePlant
        } else {
            Model::Differs
        })
    }

    /// Returns these metrics of the verdict, with the relation of the law's model to the plant.
    pub fn numbers(&self, metrics: &[&str], paper: &Paper) -> Vec<Quantity> {
        let numbers = Quantity::from_verdict(&self.label, &self.verdict, metrics, paper);
        let with_model = |number: Quantity| number.with_model(self.model());
        numbers.into_iter().map(with_model).collect()
    }

    /// Returns a row of the verdict.
    pub fn row(&self, name: &str) -> Option<&Metric> {
        let mut rows = self.verdict.metrics.iter();
        rows.find(|row| row.name == name)
    }

    /// Returns a metric of the verdict.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.row(name)?.value
    }
}

/// Returns the runs of each label; those of one label follow each other.
pub fn by_label(runs: &[Kept]) -> impl Iterator<Item = &[Kept]> {
    runs.chunk_by(|run, next| run.label == next.label)
}

/// Returns a plot without curves, over another quantity than time.
pub fn plot_over(title: &str, y_unit: &'static str, x_label: &'static str) -> Plot<'static> {
    Plot {
        x_label,
        ..Plot::over_time(title, y_unit)
    }
}

/// Plots the positions of these runs over time, the first on top, and its set-point.
pub fn positions(title: &str, runs: &[Kept]) -> Plot<'static> {
    let mut plot = Plot::over_time(title, "mm");
    if let Some(Kept { signals, .. }) = runs.first() {
        let (times, wanted) = (&signals.time_seconds, &signals.set_point_millimetres);
        plot.draw("set-point", Colour::Wanted, Shape::Dashed, times, wanted);
    }
    with_runs(plot, runs, |signals| signals.position_millimetres.clone())
}

/// Plots the currents of these runs over time, the first on top.
pub fn currents(title: &str, runs: &[Kept]) -> Plot<'static> {
    let plot = Plot::over_time(title, "A");
    with_runs(plot, runs, |signals| signals.current_amperes.clone())
}

/// Plots the temperatures of the wire in these runs over time, the first on top.
pub fn temperatures(title: &str, runs: &[Kept]) -> Plot<'static> {
    let plot = Plot::over_time(title, "°C");
    with_runs(plot, runs, |signals| signals.temperature_celsius.clone())
}

/// Adds a curve over time for each of these runs, the first on top.
pub fn with_runs(
    mut plot: Plot<'static>,
    runs: &[Kept],
    values: fn(&Signals) -> Vec<f64>,
) -> Plot<'static> {
    for run in runs.iter().rev() {
        let (times, values) = (&run.signals.time_seconds, values(&run.signals));
        plot.draw(&*run.label, run.colour, Shape::Line, times, values);
    }
    plot
}

/// Returns whether a model has every number of a plant and its equations.
fn is_equal(model: &NominalModel, plant: &Sma) -> bool {
    plant.kinetics == Kinetics::Paper
        && plant.heat.latent_heat_joules_per_kilogram == 0.0
        && plant.mechanics.stress_strain == StressStrain::AusteniteOnly
        && *model == NominalModel::from(plant)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swings_are_those_of_short_means_in_the_last_two_spans() {
        let times: Vec<f64> = (0..12_000_i32)
            .map(|cycle| f64::from(cycle) * 1e-3)
            .collect();
        let position = |time: &f64| match time {
            0.0..2.0 => 50.0,
            2.0..3.0 => 20.4,
            8.0..9.0 => 20.3,
            // One position is no swing.
            10.0..10.001 => 21.0,
            _ => 20.0,
        };
        let positions: Vec<f64> = times.iter().map(position).collect();
        let [before, last] = swings_millimetres(&times.into(), &positions.into()).unwrap();
        assert!((before - 0.4).abs() < 1e-9, "{before}");
        assert!((last - 0.3).abs() < 1e-9, "{last}");
    }

    #[test]
    fn a_model_equals_its_plant_in_every_number() {
        let model = NominalModel::default();
        assert!(is_equal(&model, &Sma::default()));
        assert!(!is_equal(&model, &bases::twin().actuator().unwrap()));
        let mut plant = Sma::default();
        plant.mechanics.stress_strain = StressStrain::Full;
        assert!(!is_equal(&model, &plant));
        let plant = Sma {
            kinetics: Kinetics::Preisach,
            ..Sma::default()
        };
        assert!(!is_equal(&model, &plant));
        let mut plant = Sma::default();
        plant.heat.latent_heat_joules_per_kilogram = 24e3;
        assert!(!is_equal(&model, &plant));
    }
}
