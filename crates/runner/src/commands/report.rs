//! `canrig report`: makes pages again from run folders.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::console::{WorkBar, print_problem};
use crate::exit::{Exit, Failure};
use crate::output::{link, renew_page, write_page};
use crate::play_record::PlayRecord;
use crate::recorded::{Recorded, opened, require_run, runs_among};
use judge::verdict::Verdict;
use recording::run_folder::file;
use recording::timeline::Timeline;
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
    let runs = paths.into_iter().map(read);
    let runs = runs.collect::<Result<Vec<Judged>, _>>()?;
    let is_of_one = folders.len() == 1 && folders == args.runs;
    let pages = runs.iter().map(|judged| {
        let recorded = &judged.recorded;
        let place = match &args.output {
            Some(output) if is_of_one => output.clone(),
            _ => recorded.path.join(file::REPORT),
        };
        let remarks = recorded.log.unread.remarks();
        html::to_html(&judged.run(), &remarks).map(|text| (place, text))
    });
    let pages: Vec<_> = pages.collect();
    drop(bar);
    for Judged { recorded, .. } in &runs {
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

/// A run that was read back.
struct Judged {
    recorded: Recorded,
    timelines: Vec<Timeline>,
    verdict: Verdict,
    /// Record of the play; `None` if it is missing or damaged, which only `coverage` refuses.
    record: Option<PlayRecord>,
    /// Date and host of the play.
    played: Option<String>,
}

impl Judged {
    fn run(&self) -> Run<'_> {
        Run {
            plan: &self.recorded.plan,
            frames: &self.recorded.log.frames,
            timelines: &self.timelines,
            verdict: &self.verdict,
            set: self.record.as_ref().map_or(&[], |record| &record.set),
            played: self.played.as_deref(),
            is_long: self.recorded.is_long,
        }
    }
}

fn read(path: &Path) -> Result<Judged, Failure> {
    require_run(path)?;
    let recorded = Recorded::load(path, None, catalogue())?;
    let timelines = recorded.timelines()?;
    let verdict = recorded.verdict(&timelines)?;
    let record = PlayRecord::read(&recorded.path).ok().flatten();
    Ok(Judged {
        played: record.as_ref().map(PlayRecord::place),
        recorded,
        timelines,
        verdict,
        record,
    })
}

fn together(runs: &[Judged], output: &Path) -> String {
    let listed = runs.iter().map(|judged| overview::ListedRun {
        folder: folder_name(&judged.recorded.path),
        page: link(output, &judged.recorded.path.join(file::REPORT)),
        played: judged.record.as_ref().map(PlayRecord::date),
        judged: judged.run(),
    });
    overview::to_html(&Vec::from_iter(listed))
}

fn folder_name(path: &Path) -> String {
    let whole = fs::canonicalize(path);
    let name = whole.as_deref().unwrap_or(path).file_name();
    let shown = name.unwrap_or(path.as_os_str());
    shown.to_string_lossy().into_owned()
}
