//! The files of a judged run.

use std::thread;

use dbc::SignalMissing;

use crate::run::Run;
use crate::{csv, html, junit};
use recording::run_folder::{RunFolder, WriteError, file};

/// Why the files of a run are not complete.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The database lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// A report cannot be made.
    #[error("{name} cannot be made: {reason}")]
    Made {
        /// Which one.
        name: &'static str,
        /// Why.
        reason: String,
    },
}

impl ReportError {
    fn made(name: &'static str, error: &dyn std::error::Error) -> Self {
        Self::Made {
            name,
            reason: error.to_string(),
        }
    }
}

/// Writes the files of a judged run, but for the signals of a long one. The recording takes as long as all others, so they are made beside it. The verdict
/// comes last, since it says that the folder is complete.
///
/// # Errors
/// A file cannot be made or written.
pub fn write_all(run: &Run<'_>, folder: &RunFolder) -> Result<(), ReportError> {
    thread::scope(|scope| {
        let beside = scope.spawn(|| write_tables_and_page(run, folder));
        let recorded = write_recording(run, folder);
        beside
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        recorded
    })?;
    Ok(folder.write(file::VERDICT, run.verdict.to_json().as_bytes())?)
}

fn write_tables_and_page(run: &Run<'_>, folder: &RunFolder) -> Result<(), ReportError> {
    if !run.is_long {
        folder.write_with(file::SIGNALS, |output| csv::write(output, run.timeline))?;
    }
    let junit = junit::to_xml(std::slice::from_ref(run.verdict))
        .map_err(|error| ReportError::made(file::JUNIT, &error))?;
    folder.write(file::JUNIT, junit.as_bytes())?;
    let page = html::to_html(run)?;
    Ok(folder.write(file::REPORT, page.as_bytes())?)
}

#[cfg(feature = "rerun")]
fn write_recording(run: &Run<'_>, folder: &RunFolder) -> Result<(), ReportError> {
    let path = folder.path().join(file::RERUN);
    crate::rerun::write(&path, run).map_err(|error| ReportError::made(file::RERUN, &error))
}

#[cfg(not(feature = "rerun"))]
fn write_recording(_run: &Run<'_>, _folder: &RunFolder) -> Result<(), ReportError> {
    Ok(())
}
