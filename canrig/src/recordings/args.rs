//! The command line of what is done with recordings.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::compare::GivenTolerance;
use crate::viewer::ViewerArgs;

/// Arguments of `report`.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// Run folders
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Where to write: the page of a single run, or the page that compares several
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// Arguments of `replay`.
#[derive(Args, Debug)]
pub struct ReplayArgs {
    /// A run folder, or a log of `candump -L`
    #[arg(value_name = "RUN|LOG")]
    pub recording: PathBuf,
    /// For a run folder: take the limits ([expect]) of this scenario. For a log: the scenario that was played
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Print the verdict as JSON, as verdict.json has it
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    #[expect(
        missing_docs,
        reason = "clap shows the doc comment of a flattened field as help"
    )]
    pub viewer: ViewerArgs,
    /// How fast the viewer shows it: 1 as it was, 0.1 in slow motion, inf at once
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    pub speed: f64,
}

/// Arguments of `compare`.
#[derive(Args, Debug)]
pub struct CompareArgs {
    /// A run folder, or a log beside its scenario.toml
    pub a: PathBuf,
    /// Another one
    pub b: PathBuf,
    /// How far a signal, a metric, or all signals of a unit may differ: `position_millimetres=0.5`, `degC=2`, `A=0.1`;
    /// `inf` for not judged. Without it: 0.25 mm, 1 degC, 0.02 for fractions and states; currents, velocities and the
    /// parts of the law are shown only, since they swing
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    pub tolerance: Vec<GivenTolerance>,
    /// How much earlier or later a value may come
    #[arg(long, value_name = "MILLISECONDS", default_value_t = 5.0, value_parser = milliseconds)]
    pub time_tolerance: f64,
    /// Write a page with plots of what differs
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the comparison as JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `coverage`.
#[derive(Args, Debug)]
pub struct CoverageArgs {
    /// Run folders; of several runs of one scenario the worst counts
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// A CSV file with the column `id`, and `text` if you like: requirements that no run tests are shown too
    #[arg(long, value_name = "FILE")]
    pub requirements: Option<PathBuf>,
    /// Write the matrix as a page
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the matrix as JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `export`.
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// A run folder, or a log beside its scenario.toml
    #[arg(value_name = "RUN")]
    pub recording: PathBuf,
    /// The format
    #[arg(long, short, value_enum)]
    pub format: Format,
    /// Where to write, instead of to standard output
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// A format for other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One row a cycle, signals as columns, as signals.csv
    Csv,
    /// The frames as Vector's ASCII log (CANalyzer, python-can, SavvyCAN)
    Asc,
    /// The frames as Vector's binary log (CANalyzer, python-can)
    Blf,
    /// The signals as ASAM MDF 4.10 (asammdf, CANape)
    Mf4,
    /// The signals as Apache Parquet (pandas, Polars, DuckDB)
    Parquet,
}

/// A factor on time.
fn speed(text: &str) -> Result<f64, String> {
    let factor: f64 = text.parse().map_err(|_| "a number is expected, or inf")?;
    if factor >= 1e-3 {
        Ok(factor)
    } else {
        Err("0.001 is the slowest".to_owned())
    }
}

/// A time from 0 to 10 s.
fn milliseconds(text: &str) -> Result<f64, String> {
    let value: f64 = text
        .parse()
        .map_err(|_| "a number of milliseconds is expected")?;
    if (0.0..=10_000.0).contains(&value) {
        Ok(value)
    } else {
        Err("0 to 10000 ms are possible".to_owned())
    }
}
