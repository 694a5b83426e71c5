//! `canrig report`: pages made again from run folders.

use clap::Args;
use std::fs;
use std::path::{Path, PathBuf};

use super::recorded::require_run;
use super::{Recorded, RecordedError, refuse};
use crate::console::{complain, say};
use crate::exit::Exit;
use judge::verdict::Verdict;
use recording::run_folder::file;
use recording::timeline::Timeline;
use report::{Run, html, overview};
use worlds::catalogue::catalogue;

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

/// Makes the page of each run, and one of all of them where `--output` says where.
#[must_use]
pub fn report(args: &ReportArgs) -> Exit {
    let mut runs = Vec::new();
    for path in &args.runs {
        match read(path) {
            Ok(run) => runs.push(run),
            Err(error) => return refuse(error),
        }
    }
    let pages = runs.iter().map(|(recorded, timeline, verdict)| {
        let page = Run {
            setup: &recorded.setup,
            frames: &recorded.log.frames,
            timeline,
            verdict,
        };
        let place = match &args.output {
            Some(output) if runs.len() == 1 => output.clone(),
            _ => recorded.path.join(file::REPORT),
        };
        html::to_html(&page).map(|text| (place, text))
    });
    for page in pages {
        let written = match page {
            Ok((place, text)) => write(&place, &text),
            Err(error) => return refuse(error.into()),
        };
        if let Err(exit) = written {
            return exit;
        }
    }
    match &args.output {
        Some(output) if runs.len() > 1 => write(output, &together(&runs, output))
            .err()
            .unwrap_or(Exit::Pass),
        _ => Exit::Pass,
    }
}

fn read(path: &Path) -> Result<(Recorded, Timeline, Verdict), RecordedError> {
    require_run(path)?;
    let recorded = Recorded::load(path, None, catalogue())?;
    let timeline = recorded.timeline()?;
    let verdict = recorded.verdict(&timeline)?;
    Ok((recorded, timeline, verdict))
}

fn together(runs: &[(Recorded, Timeline, Verdict)], output: &Path) -> String {
    let runs: Vec<overview::Run<'_>> = runs
        .iter()
        .map(|(recorded, timeline, verdict)| overview::Run {
            name: folder_name(&recorded.path),
            page: link(output, &recorded.path.join(file::REPORT)),
            timeline,
            verdict,
        })
        .collect();
    overview::to_html(&runs)
}

fn folder_name(path: &Path) -> String {
    let whole = fs::canonicalize(path);
    let name = whole.as_deref().unwrap_or(path).file_name();
    name.map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}

/// The way from one file to another; nothing where there is none.
pub(super) fn link(from: &Path, to: &Path) -> Option<String> {
    let from = match from.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (from, to) = (fs::canonicalize(from).ok()?, fs::canonicalize(to).ok()?);
    let shared = from
        .components()
        .zip(to.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = from.components().skip(shared).map(|_| "..".to_owned());
    let down = to
        .components()
        .skip(shared)
        .map(|part| escaped(&part.as_os_str().to_string_lossy()));
    Some(up.chain(down).collect::<Vec<_>>().join("/"))
}

/// A part of a path in a link: what would be read as something else is written in percent.
fn escaped(part: &str) -> String {
    let escape = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => {
            char::from(byte).to_string()
        }
        other => format!("%{other:02X}"),
    };
    part.bytes().map(escape).collect()
}

/// Writes a page and tells where.
pub(super) fn write(place: &Path, text: &str) -> Result<(), Exit> {
    match fs::write(place, text) {
        Ok(()) => {
            say(&place.display().to_string());
            Ok(())
        }
        Err(error) => {
            complain(&format!(
                "canrig: {} cannot be written: {error}",
                place.display()
            ));
            Err(Exit::BenchFailed)
        }
    }
}
