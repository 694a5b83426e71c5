//! `canrig identify`: makes a folder with plant, scenario, report and pictures from recordings.

use clap::Args;
use std::path::{Path, PathBuf};

use dbc::Database;
use scenario::controller::NominalModel;
use scenario::plant::Sma;
use serde::Serialize;
use toml::Table;

use super::data::IdentificationData;
use super::fit::Fit;
use super::parameter;
use super::picture;
use super::played::{PLANT, text_on_shipped_rig};
use super::report;
use super::search::{self, Solution};
use super::start;
use super::statistics::FitStatistics;
use recording::run_folder::{RunFolder, file};
use runner::console::{Bar, print};
use runner::exit::{Exit, Failure};
use runner::run::RUNS;

/// Largest number of recordings in one identification.
const RECORDINGS_MAX: usize = 100;

/// Names of the files that only identification writes.
mod name {
    /// The identified plant, as in a scenario: `[plant.wire]`.
    pub(super) const PLANT: &str = "plant.toml";
    /// The same plant as the model of a control law.
    pub(super) const NOMINAL_MODEL: &str = "nominal_model.toml";
    /// The report as text.
    pub(super) const REPORT: &str = "report.md";
    /// All results as numbers.
    pub(super) const NUMBERS: &str = "identification.json";
}

/// Head of the model's file: the law with this model.
const CALIBRATED_LAW: &str = "\
# The sliding-mode law with this model, in a scenario beside this file. It knows its plant, so it may be launched with more jerk:
#
# [controller.sliding_mode]
# nominal_model_file = \"nominal_model.toml\"
# reference_launch_jerk_metres_per_second_cubed = 500.0

";

/// Arguments of `identify`.
#[derive(Args, Debug)]
pub struct IdentifyArgs {
    /// Run folders, or logs of `candump -L`; all of one plant
    #[arg(required = true, value_name = "RUN")]
    pub recordings: Vec<PathBuf>,
    /// The parameters to identify: the paper's letters or the keys of the plant in a scenario, separated by commas
    #[arg(long, value_name = "LIST", default_value = "C,h,As,Af,Ms,Mf")]
    pub parameters: String,
    /// The start values: `section3` (the paper's a-priori values), `nominal`, or a file with a table [plant.NAME]
    #[arg(long, value_name = "START", default_value = "section3")]
    pub start: PathBuf,
    /// The values of the other parameters: `nominal`, `scenario` (the recording's plant), or a file with a table [plant.NAME]
    #[arg(long, value_name = "PLANT", default_value = "nominal")]
    pub known: PathBuf,
    /// The scenario that was played, for logs without a `scenario.toml` beside them; it gives cycle time and sensor. A run folder
    /// has its own
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// The DBC of the recordings, if it is not that of canrig's built-in drive and controller
    #[arg(long, value_name = "FILE")]
    pub dbc: Option<PathBuf>,
    /// Folder in which the result's folder is made
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Print failures only
    #[arg(long, short)]
    pub quiet: bool,
}

/// Executes the command.
pub fn identify(args: &IdentifyArgs) -> Result<Exit, Failure> {
    let parameters =
        parameter::parse_list(&args.parameters).map_err(|error| Exit::Usage.because(error))?;
    let start = start::plant(&args.start).map_err(|error| Exit::Usage.because(error))?;
    let measurements = load(args)?;
    let (known, notes) = known(args, &measurements)?;
    let fit = Fit::new(&measurements, parameters, known);
    let activity = Bar::spinner(!args.quiet);
    let progress = |iteration: u64, metres_rms: f64| {
        activity.say(&format!(
            "iteration {iteration}, residual {:.3} mm RMS",
            1e3 * metres_rms
        ));
    };
    let found = search::search(&fit, &fit.values_in(&start), &progress);
    drop(activity);
    let found = found?;
    let folder =
        write(args, &fit, &found, &notes).map_err(|error| Exit::BenchFailed.because(error))?;
    let exit = exit(&fit, &found);
    if !args.quiet || exit != Exit::Pass {
        print(&report::summary(&fit, &found));
        print(&format!(
            "plant       {}\nreport      {}\nplay it     canrig run {}",
            folder.join(name::PLANT).display(),
            folder.join(name::REPORT).display(),
            folder.join(file::SCENARIO).display()
        ));
    }
    Ok(exit)
}

/// Returns the exit code. A model that does not explain the data fails, even if a second optimiser finds the same
/// values.
fn exit(fit: &Fit<'_>, found: &Solution) -> Exit {
    if !found.statistics.explains() {
        Exit::VerdictFailed
    } else if found.is_confirmed(fit) {
        Exit::Pass
    } else {
        Exit::Inconclusive
    }
}

fn load(args: &IdentifyArgs) -> Result<Vec<IdentificationData>, Failure> {
    let database = args.dbc.as_deref().map(read_database).transpose()?;
    if args.recordings.len() > RECORDINGS_MAX {
        return Err(Exit::Usage.because(format!(
            "{} recordings are given (limit {RECORDINGS_MAX})",
            args.recordings.len()
        )));
    }
    let measurements = args
        .recordings
        .iter()
        .map(|path| IdentificationData::load(path, args.scenario.as_deref(), database.as_ref()));
    measurements
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| Exit::CannotStart.because(error))
}

fn read_database(path: &Path) -> Result<Database, Failure> {
    let fault =
        |reason: String| Exit::Usage.because(format!("{} is no DBC: {reason}", path.display()));
    let text = scenario::read_text(path, plan::FILE_BYTES_MAX)
        .map_err(|error| fault(error.to_string()))?;
    Database::parse(&text).map_err(|error| fault(error.to_string()))
}

/// Returns the plant with the known parameters, and remarks on it.
fn known(
    args: &IdentifyArgs,
    measurements: &[IdentificationData],
) -> Result<(Sma, Vec<String>), Failure> {
    let scenario = measurements
        .first()
        .and_then(|measurement| measurement.control_loop.trial.plant().actuator())
        .unwrap_or_default();
    let remark = differences(&scenario);
    let (plant, from) = match args.known.to_str() {
        Some("nominal") => (Sma::default(), "to be nominal".to_owned()),
        Some("scenario") => (
            scenario,
            "from the scenario of the first recording".to_owned(),
        ),
        _ => {
            let read = start::read_plant(&args.known);
            let from = format!("from `{}`", args.known.display());
            (read.map_err(|error| Exit::Usage.because(error))?, from)
        }
    };
    let mut notes = vec![format!(
        "All other parameters of the plant are taken {from}."
    )];
    if args.known == Path::new("nominal") {
        notes.extend(remark);
    }
    Ok((plant, notes))
}

/// Returns a note if the scenario's plant is not nominal. The difference may be knowledge about the rig, or the truth
/// that identification must not use.
fn differences(plant: &Sma) -> Option<String> {
    let [given, nominal] = [plant, &Sma::default()]
        .map(|plant| Table::try_from(plant).expect("a plant is written in scenarios"));
    let mut names = Vec::new();
    for (section, value) in &given {
        let nominal = &nominal[section];
        match value.as_table() {
            Some(keys) => {
                let differing = keys.iter().filter(|(key, value)| nominal[*key] != **value);
                names.extend(differing.map(|(key, _)| format!("{section}.{key}")));
            }
            None if value != nominal => names.push(section.clone()),
            None => {}
        }
    }
    (!names.is_empty()).then(|| {
        format!(
            "The scenario's plant is not nominal in {}. This was not used; `--known scenario` uses it.",
            names.join(", ")
        )
    })
}

/// Results for other programs.
#[derive(Serialize)]
struct IdentificationNumbers<'a> {
    schema: u32,
    version: &'static str,
    parameters: Vec<&'static str>,
    start: &'a [f64],
    values: Vec<f64>,
    second_optimiser: Option<&'a [f64]>,
    iterations: u64,
    is_confirmed: bool,
    explains: bool,
    misfit: f64,
    statistics: &'a FitStatistics,
}

fn write(
    args: &IdentifyArgs,
    fit: &Fit<'_>,
    found: &Solution,
    notes: &[String],
) -> Result<PathBuf, Box<dyn std::error::Error>> {
    let first = fit.measurements.first().ok_or("no recording")?;
    let run = &first.control_loop.trial.run;
    let plant = fit.plant(&found.statistics.values());
    let arguments = format!(
        "{:?}",
        (&args.recordings, &args.parameters, &args.start, &args.known)
    );
    let folder = RunFolder::create(
        &args.output,
        &format!("identify {}", run.name),
        run.seed,
        &arguments,
    )?;
    folder.write(name::REPORT, b"incomplete: the identification has not ended; if no process works on it any more, it broke off\n")?;
    folder.write(name::PLANT, plant.to_file_text(PLANT)?.as_bytes())?;
    let model = CALIBRATED_LAW.to_owned() + &NominalModel::from(&plant).to_file_text()?;
    folder.write(name::NOMINAL_MODEL, model.as_bytes())?;
    let scenario = text_on_shipped_rig(&first.text, &first.control_loop, &plant)?;
    folder.write(file::SCENARIO, scenario.as_bytes())?;
    for (table, text) in &first.tables {
        folder.write(table, text.as_bytes())?;
    }
    let numbers = serde_json::to_vec_pretty(&numbers(fit, found))?;
    folder.write(name::NUMBERS, &numbers)?;
    let pictures = write_pictures(&folder, fit, found)?;
    let report = report::markdown(fit, found, notes) + &pictures;
    folder.write(name::REPORT, report.as_bytes())?;
    Ok(folder.path().to_owned())
}

fn numbers<'a>(fit: &Fit<'_>, found: &'a Solution) -> IdentificationNumbers<'a> {
    IdentificationNumbers {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        parameters: fit.symbols(),
        start: &found.start,
        values: found.statistics.values(),
        second_optimiser: found
            .check
            .as_ref()
            .map(|check| check.optimum.values.as_slice()),
        iterations: found.descent.optimum.iterations,
        is_confirmed: found.is_confirmed(fit),
        explains: found.statistics.explains(),
        misfit: found.statistics.misfit(),
        statistics: &found.statistics,
    }
}

/// Writes one picture per recording; returns the part of the report that shows them.
fn write_pictures(
    folder: &RunFolder,
    fit: &Fit<'_>,
    found: &Solution,
) -> Result<String, Box<dyn std::error::Error>> {
    let expected =
        |values: &[f64]| fit.expected_metres(&fit.simulated_metres(values).unwrap_or_default());
    let (start, fitted) = (expected(&found.start), expected(&found.statistics.values()));
    let mut text = String::from("\n## Fit\n\n");
    let parts = fit.parts(&start).zip(fit.parts(&fitted));
    for (number, ((measurement, start), (_, fitted))) in (1..).zip(parts) {
        let name = format!("fit-{number}.svg");
        let picture = picture::to_svg(measurement, start, fitted);
        folder.write(&name, picture.as_bytes())?;
        text += &format!("![measured and found position]({name})\n");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::plant::{Kinetics, StressStrain};

    #[test]
    fn a_plant_that_is_not_nominal_is_named() {
        let mut plant = Sma::default();
        assert_eq!(differences(&plant), None);
        plant.mechanics.load_kilograms = 0.05;
        plant.mechanics.stress_strain = StressStrain::Full;
        let note = differences(&plant).unwrap();
        assert!(
            note.contains("in mechanics.load_kilograms, mechanics.stress_strain."),
            "{note}"
        );
        let plant = Sma {
            kinetics: Kinetics::Nested,
            ..Sma::default()
        };
        let note = differences(&plant).unwrap();
        assert!(note.contains("in kinetics."), "{note}");
    }
}
