//! `canrig export`: a recording in another program's format.

use std::io::{self, Write};

use super::args::{ExportArgs, Format};
use super::{Recorded, RecordedError, refuse};
use crate::console::complain;
use crate::exit::Exit;
use crate::report::{asc, blf, csv, mf4, parquet};
use dbc::scenario_clock::ScenarioClock;

/// Writes the recording.
#[must_use]
pub fn export(args: &ExportArgs) -> Exit {
    let (recorded, bytes) = match converted(args) {
        Ok(converted) => converted,
        Err(error) => return refuse(error),
    };
    if let Some(broken) = &recorded.log.broken {
        complain(&format!(
            "canrig: the log breaks off ({broken}); what is before that is written"
        ));
    }
    let Some(place) = &args.output else {
        // A reader that has gone needs no more.
        let _ = io::stdout().write_all(&bytes);
        return Exit::Pass;
    };
    match std::fs::write(place, bytes) {
        Ok(()) => Exit::Pass,
        Err(error) => {
            complain(&format!(
                "canrig: {} cannot be written: {error}",
                place.display()
            ));
            Exit::BenchFailed
        }
    }
}

fn converted(args: &ExportArgs) -> Result<(Recorded, Vec<u8>), RecordedError> {
    let recorded = Recorded::load(&args.recording, None)?;
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
    let mut clock = ScenarioClock::new(recorded.database())?;
    for stamped in &recorded.log.frames {
        if clock.on_frame(stamped.time, &stamped.frame) {
            break;
        }
    }
    Ok(mf4::to_mf4(&timeline, clock.zero().unwrap_or_default()))
}
