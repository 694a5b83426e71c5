//! The files of a judged run.

use std::thread;

use dbc::SignalMissing;

use judge::verdict::Verdict;

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

/// Writes the files of a judged run of one loop or more, but for the signals of a long one. The recording takes as long as all
/// others, so they are made beside it. The verdict comes last, since it says that the folder is complete.
///
/// # Errors
/// A file cannot be made or written.
pub fn write_all(
    runs: &[Run<'_>],
    verdict: &Verdict,
    folder: &RunFolder,
) -> Result<(), ReportError> {
    thread::scope(|scope| {
        let beside = scope.spawn(|| write_tables_and_page(runs, verdict, folder));
        let recorded = write_recording(runs, verdict, folder);
        beside
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        recorded
    })?;
    Ok(folder.write(file::VERDICT, verdict.to_json().as_bytes())?)
}

fn write_tables_and_page(
    runs: &[Run<'_>],
    verdict: &Verdict,
    folder: &RunFolder,
) -> Result<(), ReportError> {
    if runs.iter().all(|run| !run.is_long) {
        let loops = runs.iter().map(|run| (run.setup.prefix(), run.timeline));
        let loops = Vec::from_iter(loops);
        folder.write_with(file::SIGNALS, |output| csv::write(output, &loops))?;
    }
    let junit = junit::to_xml(std::slice::from_ref(verdict))
        .map_err(|error| ReportError::made(file::JUNIT, &error))?;
    folder.write(file::JUNIT, junit.as_bytes())?;
    let page = html::to_html(runs, verdict)?;
    Ok(folder.write(file::REPORT, page.as_bytes())?)
}

#[cfg(feature = "rerun")]
fn write_recording(
    runs: &[Run<'_>],
    verdict: &Verdict,
    folder: &RunFolder,
) -> Result<(), ReportError> {
    let path = folder.path().join(file::RERUN);
    crate::rerun::write(&path, runs, verdict)
        .map_err(|error| ReportError::made(file::RERUN, &error))
}

#[cfg(not(feature = "rerun"))]
fn write_recording(
    _runs: &[Run<'_>],
    _verdict: &Verdict,
    _folder: &RunFolder,
) -> Result<(), ReportError> {
    Ok(())
}
