//! `canrig export`: a recording in another program's format.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::console::{print_bytes, print_error};
use crate::exit::Exit;
use crate::output::write;
use crate::recorded::{Recorded, RecordedError, refuse};
use dbc::scenario_clock::ScenarioClock;
use exports::{asc, blf, mf4, parquet};
use report::csv;
use worlds::catalogue::catalogue;

/// Arguments of `export`.
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// A run folder, or a log of `candump -L` with its scenario.toml beside it
    #[arg(value_name = "RUN")]
    pub recording: PathBuf,
    /// The format
    #[arg(long, short, value_enum)]
    pub format: Format,
    /// The file to write, in place of standard output
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// A format for other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One row for each cycle, one column for each signal, as in signals.csv
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

/// Writes the recording.
#[must_use]
pub fn export(args: &ExportArgs) -> Exit {
    let (recorded, bytes) = match converted(args) {
        Ok(converted) => converted,
        Err(error) => return refuse(error),
    };
    for remark in recorded.log.remarks() {
        print_error(&format!("canrig: {remark}; the other frames are written"));
    }
    match &args.output {
        Some(place) => write(place, &bytes).err().unwrap_or(Exit::Pass),
        None => {
            print_bytes(&bytes);
            Exit::Pass
        }
    }
}

fn converted(args: &ExportArgs) -> Result<(Recorded, Vec<u8>), RecordedError> {
    let recorded = Recorded::load(&args.recording, None, catalogue())?;
    let frames = &recorded.log.frames;
    let bytes = match args.format {
        Format::Csv => csv_table(&recorded)?,
        Format::Asc => asc::to_asc(frames).into_bytes(),
        Format::Blf => blf::to_blf(frames),
        Format::Mf4 => measurement(&recorded)?,
        Format::Parquet => parquet::to_parquet(&recorded.timeline()?)?,
    };
    Ok((recorded, bytes))
}

fn csv_table(recorded: &Recorded) -> Result<Vec<u8>, RecordedError> {
    let timeline = recorded.timeline()?;
    let mut table = Vec::new();
    csv::write(&mut table, &timeline).expect("memory takes all that is written");
    Ok(table)
}

fn measurement(recorded: &Recorded) -> Result<Vec<u8>, RecordedError> {
    let timeline = recorded.timeline()?;
    let mut clock = ScenarioClock::new(&recorded.setup.database)?;
    for stamped in &recorded.log.frames {
        if clock.on_frame(stamped.time, &stamped.frame) {
            break;
        }
    }
    Ok(mf4::to_mf4(&timeline, clock.zero().unwrap_or_default()))
}
