//! What is made of the rows when all of them are there.

use super::cases::Cases;
use super::page;
use super::store::StoreError;
use super::summary::{Failing, Summary};
use super::tables::{self, Tables};
use recording::run_folder::{RunFolder, WriteError, file};
use recording::session::write_tables;
use rig::setup::Setup;
use runner::console::print;
use runner::exit::Exit;

/// Name of the folder with the scenarios of cases that do not pass.
const FAILING: &str = "failing";

/// What the terminal gets of a sweep.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shown {
    All,
    Failures,
    /// Somebody else reads it.
    Nothing,
}

/// Why a sweep has no tables.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FinishError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Makes tables, page and scenarios of a folder's rows, and prints where they are. Whatever was made before is made again.
pub(crate) fn finish(
    folder: &RunFolder,
    setups: &[Setup],
    cases: &dyn Cases,
    shown: Shown,
) -> Result<Exit, FinishError> {
    let summary = Summary::read(cases, setups, folder.path())?;
    let metrics = summary.metrics();
    let tables = Tables {
        cases,
        metrics: &metrics,
        folder: folder.path(),
    };
    folder.write_with(tables::CSV, |output| tables.write_csv(output))?;
    folder.write_with(tables::PARQUET, |output| tables.write_parquet(output))?;
    if !summary.failing.is_empty() {
        write_tables(folder, &setups[0], FAILING)?;
    }
    for failing in &summary.failing {
        let text = format!("{}{}", preamble(cases, failing), cases.text(failing.case));
        folder.write(&place(failing), text.as_bytes())?;
    }
    let page = page::to_html(&summary, place);
    folder.write(file::REPORT, page.as_bytes())?;
    let exit = summary.worst().exit();
    if shown == Shown::All || (shown == Shown::Failures && exit != Exit::Pass) {
        print(&page::to_text(&summary));
        print_files(folder, &summary);
    }
    Ok(exit)
}

/// Where the scenario of a case is.
fn place(failing: &Failing) -> String {
    format!("{FAILING}/case-{}-{}.toml", failing.case, failing.id)
}

/// What a reader of a single case must know.
fn preamble(cases: &dyn Cases, failing: &Failing) -> String {
    let one_line = |text: &str| text.replace(char::is_control, " ");
    format!(
        "# Case {} of the {} \"{}\": {}\n# {}: {}\n\n",
        failing.case,
        cases.kind(),
        one_line(cases.name()),
        failing.values,
        failing.ended.word(),
        one_line(&failing.why),
    )
}

fn print_files(folder: &RunFolder, summary: &Summary) {
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (total, written) = (summary.failing_total(), summary.failing.len());
    if total > 0 {
        let first = match written < total {
            true => format!("the first {written} of {total}"),
            false => format!("all {total}"),
        };
        print(&format!(
            "failing  {} ({first}, for canrig simulate)",
            path(FAILING)
        ));
    }
    print(&format!(
        "table    {} and {}",
        path(tables::CSV),
        tables::PARQUET
    ));
    print(&format!("page     {}", path(file::REPORT)));
}
