//! Turns the rows into tables, page and scenarios when all of them are there.

use std::collections::BTreeSet;
use std::{fs, io};

use super::cases::Cases;
use super::page;
use super::store::Rows;
use super::summary::{FAILING, Failing, Summary};
use super::tables::{self, Tables};
use recording::run_folder::{RunFolder, WriteError, file, file_in};
use recording::session::write_tables;
use runner::console::{print, print_text};
use runner::exit::{Exit, Failure};

/// Output of a sweep on the terminal.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shown {
    All,
    Failures,
    /// Lines of JSON for another program.
    Events,
}

impl Shown {
    /// Returns the output of a command that may be quiet.
    pub(crate) fn unless(is_quiet: bool) -> Self {
        if is_quiet { Self::Failures } else { Self::All }
    }
}

/// Makes tables, page and scenarios of the rows of all cases, and prints their paths. Earlier ones are made again.
pub(crate) fn finish(
    folder: &RunFolder,
    cases: &dyn Cases,
    rows: &Rows,
    shown: Shown,
) -> Result<Exit, Failure> {
    let summary = Summary::read(cases, rows)?;
    let metrics = summary.spreads.iter().map(|spread| spread.name.clone());
    let tables = Tables {
        cases,
        metrics: &Vec::from_iter(metrics),
        rows,
    };
    folder.write_with(tables::CSV, |output| tables.write_csv(output))?;
    folder.write_with(tables::PARQUET, |output| tables.write_parquet(output))?;
    remove_others(folder, &summary.failing)?;
    if !summary.failing.is_empty() {
        write_tables(folder, &cases.facts().plan, FAILING)?;
    }
    for failing in &summary.failing {
        let text = format!("{}{}", preamble(cases, failing), cases.text(failing.case));
        folder.write(&failing.place(), text.as_bytes())?;
    }
    let page = page::to_html(&summary, rows.identity());
    folder.write(file::REPORT, page.as_bytes())?;
    let exit = summary.worst().exit();
    if shown == Shown::All || (shown == Shown::Failures && exit != Exit::Pass) {
        print_text(&page::to_text(&summary));
        print_files(folder, &summary);
    }
    Ok(exit)
}

/// Removes the scenarios of cases that do not fail any more, for example because another canrig played the rows before. Other
/// files are left alone.
fn remove_others(folder: &RunFolder, failing: &[Failing]) -> Result<(), WriteError> {
    let kept: BTreeSet<String> = failing.iter().map(Failing::place).collect();
    let path = folder.path().join(FAILING);
    file_in(folder.path(), FAILING).map_err(WriteError::at(&path))?;
    let entries = match fs::read_dir(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(WriteError::at(&path))?,
    };
    for entry in entries {
        let entry = entry.map_err(WriteError::at(&path))?;
        let file_name = entry.file_name();
        let name = file_name.to_string_lossy();
        if is_case(&name) && !kept.contains(&format!("{FAILING}/{name}")) {
            match fs::remove_file(entry.path()) {
                // Another machine that completes the same part was faster.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                removed => removed.map_err(WriteError::at(&entry.path()))?,
            }
        }
    }
    Ok(())
}

/// Checks whether a file has a name as [`Failing::place`] gives it.
fn is_case(name: &str) -> bool {
    let name = name
        .strip_prefix("case-")
        .and_then(|name| name.strip_suffix(".toml"));
    let parts = name.and_then(|name| name.split_once('-'));
    parts.is_some_and(|(case, id)| {
        let is_id = !id.is_empty() && id.bytes().all(|digit| digit.is_ascii_hexdigit());
        case.parse::<usize>().is_ok() && is_id
    })
}

/// Returns the comment at the top of a failing case's scenario.
fn preamble(cases: &dyn Cases, failing: &Failing) -> String {
    let one_line = |text: &str| text.replace(char::is_control, " ");
    format!(
        "# Case {} of the {} \"{}\": {}\n# {}: {}\n\n",
        failing.case,
        cases.facts().kind,
        one_line(cases.facts().name()),
        cases.values_text(failing.case, |value| value.to_string()),
        failing.ended.word(),
        one_line(&failing.why),
    )
}

fn print_files(folder: &RunFolder, summary: &Summary<'_>) {
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (total, written) = (summary.failing_total(), summary.failing.len());
    if total > 0 {
        let first = if written < total {
            format!("the first {written} of {total}")
        } else {
            format!("all {total}")
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::row::Ended;

    #[test]
    fn failing_cases_of_now_stay_and_files_that_are_not_ours() {
        let parent = tempfile::tempdir().unwrap();
        let folder = RunFolder::lasting(parent.path(), "run", "1").unwrap();
        // The folder does not exist yet.
        remove_others(&folder, &[]).unwrap();
        // Scenarios that cannot be looked through are not removed in silence.
        let file = folder.path().join(FAILING);
        fs::write(&file, b"").unwrap();
        let error = remove_others(&folder, &[]).unwrap_err();
        assert_eq!(error.path, file);
        fs::remove_file(file).unwrap();
        let failing = Failing {
            case: 3,
            id: "0123456789abcdef".to_owned(),
            ended: Ended::Fail,
            why: String::new(),
            values: String::new(),
        };
        let theirs = ["failing/course.csv", "failing/case-notes.toml"];
        let stale = [
            "failing/case-4-0123456789abcdef.toml",
            "failing/case-3-01.toml",
        ];
        for name in theirs.iter().chain(&stale) {
            folder.write(name, b"").unwrap();
        }
        folder.write(&failing.place(), b"").unwrap();
        remove_others(&folder, &[failing]).unwrap();
        let entries = fs::read_dir(folder.path().join(FAILING)).unwrap();
        let mut names = Vec::from_iter(entries.map(|entry| entry.unwrap().file_name()));
        names.sort();
        assert_eq!(
            names,
            [
                "case-3-0123456789abcdef.toml",
                "case-notes.toml",
                "course.csv"
            ]
        );
    }
}
