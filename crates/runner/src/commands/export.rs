//! `canrig export`: a recording in another program's format.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use crate::console::{print_bytes, print_error, usage_error};
use crate::exit::Exit;
use crate::output::write;
use crate::recorded::{Recorded, RecordedError, refuse};
use dbc::SignalMissing;
use dbc::scenario_clock::ScenarioClock;
use exports::{asc, blf, events, frames, mcap, mf4, parquet};
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
    /// For frames: only those of this message, with a column for each of its signals
    #[arg(long, value_name = "NAME")]
    pub message: Option<String>,
    /// The file to write, in place of standard output
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// A format for other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One row for each cycle, one column for each signal, as in signals.csv
    Csv,
    /// One row for each frame with its message, sender and bytes, as CSV
    Frames,
    /// One row for each event, such as a state, an emergency or a fault that the scenario injects, as CSV
    Events,
    /// The frames as Vector's ASCII log (CANalyzer, python-can, SavvyCAN)
    Asc,
    /// The frames as Vector's binary log (CANalyzer, python-can)
    Blf,
    /// Signals and frames as ASAM MDF 4.10 (asammdf, CANape)
    Mf4,
    /// Frames, their signals and events as messages of ROS 2 (Foxglove, PlotJuggler, Rerun)
    Mcap,
    /// The signals as Apache Parquet (pandas, Polars, DuckDB)
    Parquet,
}

/// Writes the recording.
#[must_use]
pub fn export(args: &ExportArgs) -> Exit {
    if args.message.is_some() && args.format != Format::Frames {
        return usage_error("--message needs --format frames");
    }
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
        Format::Frames => frame_table(&recorded, args.message.as_deref())?,
        Format::Events => {
            events::to_csv(&recorded.timeline()?).expect("memory takes all that is written")
        }
        Format::Asc => asc::to_asc(frames).into_bytes(),
        Format::Blf => blf::to_blf(frames),
        Format::Mf4 => measurement(&recorded)?,
        Format::Mcap => messages(&recorded)?,
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

fn frame_table(recorded: &Recorded, message: Option<&str>) -> Result<Vec<u8>, RecordedError> {
    let (frames, database) = (&recorded.log.frames, &recorded.setup.database);
    let zero = zero(recorded)?;
    let mut table = Vec::new();
    let written = match message {
        None => frames::write_all(&mut table, frames, database, zero),
        Some(name) => {
            let message = database.message(name);
            let message = message.ok_or_else(|| RecordedError::no_message(name, database))?;
            frames::write_message(&mut table, frames, database, zero, message)
        }
    };
    written.expect("memory takes all that is written");
    Ok(table)
}

fn measurement(recorded: &Recorded) -> Result<Vec<u8>, RecordedError> {
    let frames = &recorded.log.frames;
    Ok(mf4::to_mf4(&recorded.timeline()?, frames, zero(recorded)?))
}

fn messages(recorded: &Recorded) -> Result<Vec<u8>, RecordedError> {
    let (frames, database) = (&recorded.log.frames, &recorded.setup.database);
    let events = recorded.timeline()?.events;
    let zero = zero(recorded)?;
    Ok(mcap::to_mcap(frames, database, &events, zero)?)
}

/// When scenario time began, on the clock of the frames; their own time 0 if it never did.
fn zero(recorded: &Recorded) -> Result<Duration, SignalMissing> {
    let mut clock = ScenarioClock::new(&recorded.setup.database)?;
    let mut frames = recorded.log.frames.iter();
    frames.any(|stamped| clock.on_frame(stamped.time, &stamped.frame));
    Ok(clock.zero().unwrap_or_default())
}
