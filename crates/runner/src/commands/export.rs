//! `canrig export`: writes a recording in another program's format.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use crate::console::{WorkBar, print_problem, print_with};
use crate::exit::{Exit, Failure};
use crate::output::write_with;
use crate::recorded::Recorded;
use dbc::{Database, Message, SignalMissing};
use exports::{asc, blf, events, frames, mcap, mf4, parquet};
use recording::run_folder::file;
use recording::timeline::all_events;
use report::csv;
use worlds::catalogue::catalogue;

/// Arguments of `export`.
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// A run folder, or a log of `candump -L` in a folder with its scenario.toml
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

impl Format {
    /// Returns the number of passes over frames or cycles: to read, and to decode or write them.
    fn passes(self) -> u64 {
        match self {
            Self::Events | Self::Asc | Self::Frames => 2,
            Self::Blf | Self::Csv | Self::Parquet => 3,
            Self::Mcap => 4,
            Self::Mf4 => 5,
        }
    }
}

/// Writes the recording.
pub fn export(args: &ExportArgs) -> Result<Exit, Failure> {
    if args.message.is_some() && args.format != Format::Frames {
        return Err(Exit::Usage.because("--message needs --format frames"));
    }
    let _bar = WorkBar::new(args.format.passes(), is_silent(args));
    let recorded = Recorded::load(&args.recording, None, catalogue())?;
    let (frames, database) = (&recorded.log.frames, &**recorded.plan.database());
    // All that may fail on this recording comes before the output.
    let timelines = match args.format {
        Format::Frames | Format::Asc | Format::Blf => Vec::new(),
        _ => recorded.timelines()?,
    };
    let zero = match args.format {
        Format::Frames | Format::Mf4 | Format::Mcap => zero(&recorded)?,
        _ => Duration::ZERO,
    };
    let name = args.message.as_deref();
    let message = name.map(|name| message_of(database, name)).transpose()?;
    for remark in recorded.log.unread.remarks() {
        print_problem(format!("{remark}; the other frames are written"));
    }
    let write = |output: &mut (dyn Write + Send)| match (args.format, message) {
        (Format::Csv, _) => csv::write(output, &timelines),
        (Format::Frames, None) => frames::write_all(output, frames, database, zero),
        (Format::Frames, Some(message)) => frames::write_message(output, frames, zero, message),
        (Format::Events, _) => events::write(output, &all_events(&timelines)),
        (Format::Asc, _) => asc::write(output, frames),
        (Format::Blf, _) => blf::write(output, frames),
        (Format::Mf4, _) => mf4::write(output, &timelines, frames, &database.to_dbc(), zero),
        (Format::Mcap, _) => mcap::write(output, frames, database, &all_events(&timelines), zero),
        (Format::Parquet, _) => {
            parquet::write_signals(output, &timelines).map_err(io::Error::other)
        }
    };
    match &args.output {
        Some(place) => write_with(place, |output| write(output))?,
        None => print_with(write),
    }
    Ok(Exit::Pass)
}

/// Returns whether a bar may be drawn, since the export itself does not go to the terminal.
fn is_silent(args: &ExportArgs) -> bool {
    args.output.is_some() || !io::stdout().is_terminal()
}

/// Returns the message of a name.
fn message_of<'a>(database: &'a Database, name: &str) -> Result<&'a Message, Failure> {
    database.message(name).ok_or_else(|| {
        let names = database.messages().iter();
        let meant = scenario::nearest(name, names.map(|message| message.name.as_str()));
        let hint = meant.map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"));
        let file = file::FRAMES;
        Exit::CannotStart.because(format!(
            "no message `{name}` is in the recording's {file}{hint}"
        ))
    })
}

/// Returns the begin of scenario time on the clock of the frames; 0 on that clock if the scenario never began.
fn zero(recorded: &Recorded) -> Result<Duration, SignalMissing> {
    let mut clock = recorded.plan.scenario_clock()?;
    let mut frames = recorded.log.frames.iter();
    frames.any(|stamped| clock.on_frame(stamped.time, &stamped.frame));
    Ok(clock.zero().unwrap_or_default())
}
