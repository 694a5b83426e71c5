//! The files of a judged run.

use std::error::Error;
use std::fmt::Display;
use std::fs;
use std::thread;

use crate::run::Run;
use crate::{csv, html, junit};
use recording::run_folder::{RunFolder, file};

/// Reason why the files of a run are not complete: a file that cannot be written, a signal that the database lacks, or an error of a
/// format's library.
pub type ReportError = Box<dyn Error + Send + Sync>;

/// Returns the error of a report that cannot be made.
fn not_made(folder: &RunFolder, name: &str, reason: impl Display) -> ReportError {
    let path = folder.path().join(name);
    format!("{} cannot be made: {reason}", path.display()).into()
}

/// Writes the files of a judged run, except for the signals of a long one. The recording takes as long as all other files, which
/// are made at the same time. Files with the verdict follow when everything else is there. `verdict.json` comes last, since it
/// marks the folder as complete.
///
/// # Errors
/// A file cannot be made or written.
pub fn write_all(run: &Run<'_>, folder: &RunFolder) -> Result<(), ReportError> {
    let page = thread::scope(|scope| {
        let beside = scope.spawn(|| write_table_and_make_page(run, folder));
        let recorded = write_recording(run, folder);
        let page = beside
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        recorded.map(|()| page)
    })?;
    let junit = junit::to_xml(std::slice::from_ref(run.verdict))
        .map_err(|error| not_made(folder, file::JUNIT, error))?;
    let said = folder
        .write(file::REPORT, page.as_bytes())
        .and_then(|()| folder.write(file::JUNIT, junit.as_bytes()))
        .and_then(|()| folder.write(file::VERDICT, run.verdict.to_json().as_bytes()));
    if said.is_err() {
        // The verdict is "incomplete", and these files may not contradict it. A file that was not written need not be removed.
        for name in [file::REPORT, file::JUNIT] {
            let _ = fs::remove_file(folder.path().join(name));
        }
    }
    Ok(said?)
}

fn write_table_and_make_page(run: &Run<'_>, folder: &RunFolder) -> Result<String, ReportError> {
    if !run.is_long {
        folder.write_with(file::SIGNALS, |output| csv::write(output, run.timelines))?;
    }
    // A run that was just played has all of its frames.
    Ok(html::to_html(run, &[])?)
}

#[cfg(feature = "rerun")]
fn write_recording(run: &Run<'_>, folder: &RunFolder) -> Result<(), ReportError> {
    let path = folder.path().join(file::RERUN);
    crate::rerun::write(&path, run).map_err(|error| not_made(folder, file::RERUN, error))
}

#[cfg(not(feature = "rerun"))]
fn write_recording(_run: &Run<'_>, _folder: &RunFolder) -> Result<(), ReportError> {
    Ok(())
}
