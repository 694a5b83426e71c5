//! `canrig report`: makes pages again from run folders.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::console::{WorkBar, print_problem};
use crate::exit::{Exit, Failure};
use crate::output::{link, renew_page, write_page};
use crate::play_record::PlayRecord;
use crate::recorded::{JudgedRecording, Recorded, opened, require_run, runs_among};
use recording::run_folder::file;
use report::overview::ListedRun;
use report::{Run, html, overview};
use worlds::catalogue::catalogue;

/// Number of passes over the frames: to read, to decode and to judge them, and for the page.
const PASSES: u64 = 4;

/// Arguments of `report`.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// Run folders, or folders with such in them; of several, those of sweeps are left out
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// The file to write: the page of a single run, or one more page that compares several runs
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// Makes the page of each run, and one of all of them at the place of `--output`.
pub fn report(args: &ReportArgs) -> Result<Exit, Failure> {
    let folders = opened(&args.runs);
    let paths = runs_among(&folders);
    let bar = WorkBar::new(PASSES * paths.len() as u64, true);
    let recordings = paths.into_iter().map(read);
    let runs = recordings.collect::<Result<Vec<JudgedRecording>, _>>()?;
    let is_of_one = folders.len() == 1 && folders == args.runs;
    let pages = runs.iter().map(|judged| {
        let recorded = &judged.recorded;
        let played = judged.record.as_ref().map(PlayRecord::place);
        let run = run(judged, played.as_deref());
        let place = match &args.output {
            Some(output) if is_of_one => output.clone(),
            _ => recorded.path.join(file::REPORT),
        };
        let remarks = recorded.log.unread.remarks();
        html::to_html(&run, &remarks).map(|text| (place, text))
    });
    let pages: Vec<_> = pages.collect();
    drop(bar);
    for JudgedRecording { recorded, .. } in &runs {
        for remark in recorded.log.unread.remarks() {
            let path = recorded.path.display();
            print_problem(format!("{path}: {remark}; the page shows the other frames"));
        }
    }
    for page in pages {
        let (place, text) = page?;
        if args.output.as_ref() == Some(&place) {
            write_page(&place, &text)?;
        } else {
            renew_page(&place, &text)?;
        }
    }
    if let Some(output) = args.output.as_ref().filter(|_| !is_of_one) {
        write_page(output, &together(&runs, output))?;
    }
    Ok(Exit::Pass)
}

fn read(path: &Path) -> Result<JudgedRecording, Failure> {
    require_run(path)?;
    let recorded = Recorded::load(path, None, catalogue())?;
    Ok(recorded.judged(Recorded::verdict)?)
}

/// Returns a run for its page, or for one of several; `played` tells of its play.
fn run<'a>(judged: &'a JudgedRecording, played: Option<&'a str>) -> Run<'a> {
    let recorded = &judged.recorded;
    Run {
        plan: &recorded.plan,
        frames: &recorded.log.frames,
        timelines: &judged.timelines,
        verdict: &judged.verdict,
        set: judged.record.as_ref().map_or(&[], |record| &record.set),
        played,
        is_long: recorded.is_long,
    }
}

fn together(runs: &[JudgedRecording], output: &Path) -> String {
    let date = |judged: &JudgedRecording| judged.record.as_ref().map(PlayRecord::date);
    let dates = Vec::from_iter(runs.iter().map(date));
    let listed = runs.iter().zip(&dates).map(|(judged, date)| ListedRun {
        folder: folder_name(&judged.recorded.path),
        page: link(output, &judged.recorded.path.join(file::REPORT)),
        judged: run(judged, date.as_deref()),
    });
    overview::to_html(&Vec::from_iter(listed))
}

fn folder_name(path: &Path) -> String {
    let whole = fs::canonicalize(path);
    let name = whole.as_deref().unwrap_or(path).file_name();
    let shown = name.unwrap_or(path.as_os_str());
    shown.to_string_lossy().into_owned()
}
