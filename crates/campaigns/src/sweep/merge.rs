//! `canrig merge`: puts the parts of a campaign together.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Shard;
use super::cases::Cases;
use super::finish::{Shown, finish};
use super::part::open_folder;
use super::store::{Header, Rows};
use super::sweep_cases::SweepCases;
use crate::torture::cases::TortureCases;
use recording::run_folder::file;
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::play_record::PlayRecord;
use runner::recorded::require_inside;
use runner::run::RUNS;
use runner::scenarios::load_to_play;

/// Arguments of `merge`.
#[derive(Args, Debug)]
pub struct MergeArgs {
    /// The folders that `canrig sweep --shard` or `canrig torture --shard` made
    #[arg(required = true, value_name = "SHARD")]
    pub shards: Vec<PathBuf>,
    /// Folder in which the whole campaign's folder is made
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Print failures only
    #[arg(long, short)]
    pub quiet: bool,
}

/// Runs the command.
pub fn merge(args: &MergeArgs) -> Result<Exit, Failure> {
    let [first, ..] = args.shards.as_slice() else {
        return Ok(Exit::Usage);
    };
    let is_campaign = |path: &&PathBuf| path.join(file::SCENARIO).exists();
    if let Some(other) = args.shards.iter().find(|path| !is_campaign(path)) {
        let (path, name) = (other.display(), file::SCENARIO);
        let reason = format!("`{path}` is not the folder of a sweep (no {name} in it)");
        return Err(Exit::CannotStart.because(reason));
    }
    let scenario = require_inside(first, file::SCENARIO)?;
    let plan = load_to_play(&scenario, &ValueArgs::default())?;
    let cases: Box<dyn Cases> = match TortureCases::read(first, &plan)? {
        Some(torture) => Box::new(torture),
        None => Box::new(SweepCases::new(&plan)?),
    };
    let shown = Shown::unless(args.quiet);
    merge_parts(&args.shards, &*cases, &args.output, shown)
}

/// Adds the rows of the parts to those in the folder of the whole campaign, and makes tables and page of all.
pub(crate) fn merge_parts(
    parts: &[PathBuf],
    cases: &dyn Cases,
    output: &Path,
    shown: Shown,
) -> Result<Exit, Failure> {
    let folder = open_folder(output, cases, Shard::WHOLE)?;
    let header = Header::new(cases)?;
    let mut rows = Rows::read(folder.path(), &header, Shard::WHOLE)?;
    rows.require_unwritten()?;
    if !rows.is_whole() {
        rows.print_damaged();
    }
    let mut writer = None;
    for part in parts {
        let found = Rows::read(part, &header, Shard::WHOLE)?;
        found.print_damaged();
        for row in found.iter()? {
            let row = row?;
            if !rows.has(row.case) {
                let writer = match &mut writer {
                    Some(writer) => writer,
                    none => none.insert(rows.writer()?),
                };
                writer.append(&row)?;
            }
        }
        rows.look()?;
    }
    if let Some(writer) = &mut writer {
        writer.sync()?;
        // The record's date is later than those of all parts.
        let known = match PlayRecord::read(folder.path())? {
            None => PlayRecord::read(&parts[0])?,
            known => known,
        };
        let now = PlayRecord::now(&[]);
        let set = known.map_or(now.set, |known| known.set);
        PlayRecord { set, ..now }.write(&folder)?;
    }
    rows.require_all()?;
    let exit = finish(&folder, cases, &rows, shown)?;
    cases.show_more(&rows, output)?;
    Ok(exit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::row::{Ended, SweepRow};
    use crate::sweep::store::Writer;
    use crate::torture::cases::Draws;
    use plan::Plan;
    use runner::console::print;
    use runner::machine::{Stopwatch, memory_bytes_max};
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\n\
        [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15, 25, 35]\n";

    #[test]
    fn the_first_row_counts_where_parts_contradict_each_other() {
        let beside = Beside::new(Path::new("s.toml"));
        let plan = Plan::parse_beside(&beside, TEXT.to_owned(), catalogue()).unwrap();
        let cases = SweepCases::new(&plan).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let part = |name: &str, number, reason: &str| {
            let row = |case| {
                let reason = format!("{reason}{case}");
                SweepRow::without_verdict(case, "id", Ended::Invalid, reason)
            };
            let shard = Shard { number, of: 2 };
            made_up(&folder.path().join(name), &cases, shard, &row)
        };
        let odd = part("a", 1, "a");
        let parts = [odd.clone(), part("b", 2, "b"), odd, part("c", 1, "c")];
        let output = folder.path().join("merged");
        let merge = |parts: &[PathBuf]| merge_parts(parts, &cases, &output, Shown::Events);
        let error = merge(&parts[1..2]).unwrap_err();
        assert_eq!(error.exit, Exit::CannotStart);
        assert!(
            error
                .to_string()
                .starts_with("2 of 4 cases are missing: 1, 3."),
            "{error}"
        );
        assert_eq!(merge(&parts).unwrap(), Exit::CannotStart);
        let whole = std::fs::read_dir(output).unwrap().next().unwrap().unwrap();
        let header = Header::new(&cases).unwrap();
        let rows = Rows::read(&whole.path(), &header, Shard::WHOLE).unwrap();
        let reasons = rows.iter().unwrap().map(|row| row.unwrap().reason.unwrap());
        assert_eq!(Vec::from_iter(reasons), ["a1", "b2", "a3", "b4"]);
    }

    /// Writes a part with made-up rows.
    fn made_up(
        folder: &Path,
        cases: &dyn Cases,
        shard: Shard,
        row: &dyn Fn(usize) -> SweepRow,
    ) -> PathBuf {
        let part = open_folder(folder, cases, shard).unwrap();
        let header = Header::new(cases).unwrap();
        let mut writer = Writer::begin(part.path(), &header).unwrap();
        for case in shard.cases(cases.facts().runs) {
            writer.append(&row(case)).unwrap();
        }
        part.path().to_owned()
    }

    /// Returns a row with a metric that follows both keys, and eleven more.
    fn row_of_a_sweep(cases: &SweepCases, case: usize) -> SweepRow {
        let [hold, load] = cases.values(case)[..] else {
            unreachable!("two keys")
        };
        let value = hold - 300.0 * (load - 0.04);
        let is_missed = value > 30.0;
        let others = (1..12).map(|number| {
            (
                format!("metric_{number}_seconds"),
                value / f64::from(number),
            )
        });
        let position = ("position_millimetres_max".to_owned(), value);
        SweepRow {
            case,
            id: "0123456789abcdef".to_owned(),
            seed: Some(0),
            ended: if is_missed { Ended::Fail } else { Ended::Pass },
            reason: None,
            missed: is_missed.then(|| position.0.clone()).into_iter().collect(),
            undecided: Vec::new(),
            metrics: others.chain([position]).collect(),
        }
    }

    /// Returns a row with an invariant that half of the mixes with a certain fault break.
    fn row_of_torture(cases: &TortureCases, case: usize) -> SweepRow {
        let keys = cases.facts().keys();
        let stuck = keys.iter().position(|key| *key == "sensor.stuck").unwrap();
        let is_broken = cases.values(case)[stuck] > 0.0 && case.is_multiple_of(2);
        SweepRow {
            case,
            id: "0123456789abcdef".to_owned(),
            seed: Some(0),
            ended: if is_broken { Ended::Fail } else { Ended::Pass },
            reason: is_broken.then(|| "made up, as long as such reasons are".to_owned()),
            missed: is_broken
                .then(|| "made_up".to_owned())
                .into_iter()
                .collect(),
            undecided: Vec::new(),
            metrics: Vec::new(),
        }
    }

    const RUNS: usize = 1_000_000;

    /// Merges a campaign of a million runs with made-up rows, prints its time and memory, and returns its page.
    fn merged(cases: &dyn Cases, row: &dyn Fn(usize) -> SweepRow) -> String {
        const PARTS: usize = 40;
        assert_eq!(cases.facts().runs, RUNS);
        let folder = tempfile::tempdir().unwrap();
        let watch = Stopwatch::start();
        let part = |number| {
            let shard = Shard { number, of: PARTS };
            made_up(folder.path(), cases, shard, row)
        };
        let parts: Vec<PathBuf> = (1..=PARTS).map(part).collect();
        let mebibytes = || memory_bytes_max().unwrap_or_default() >> 20;
        print(&format!(
            "made in {:.1} s, VmHWM {} MiB",
            watch.elapsed().as_secs_f64(),
            mebibytes()
        ));
        let watch = Stopwatch::start();
        let output = folder.path().join("merged");
        let _ = merge_parts(&parts, cases, &output, Shown::All).unwrap();
        let entries = std::fs::read_dir(&output)
            .unwrap()
            .map(|entry| entry.unwrap().path());
        let mut pages = entries.filter(|path| path.join(file::ROWS).exists());
        let page = pages.next().unwrap();
        let size = |name: &str| page.join(name).metadata().unwrap().len();
        print(&format!(
            "merged and reported in {:.1} s, VmHWM {} MiB; rows {} MB, page {} kB",
            watch.elapsed().as_secs_f64(),
            mebibytes(),
            size(file::ROWS) / 1_000_000,
            size(file::REPORT) / 1000
        ));
        assert!(mebibytes() < 400);
        assert!(size(file::REPORT) < 2_000_000);
        std::fs::read_to_string(page.join(file::REPORT)).unwrap()
    }

    #[test]
    #[ignore = "takes minutes; prints time and memory"]
    fn a_million_mixes_are_merged_and_reported_in_bounded_memory() {
        let text = TEXT.split("[sweep]").next().unwrap().to_owned();
        let plan =
            Plan::parse_beside(&Beside::new(Path::new("s.toml")), text, catalogue()).unwrap();
        let draws = Draws {
            runs: u32::try_from(RUNS).unwrap(),
            seed: 1,
        };
        let cases = TortureCases::new(&plan, draws);
        let page = merged(&cases, &|case| row_of_torture(&cases, case));
        assert!(page.contains("Sensitivity") && page.contains("sensor.stuck"));
    }

    /// Measures planning, merging and the report.
    #[test]
    #[ignore = "takes minutes; prints time and memory"]
    fn a_million_rows_are_merged_and_reported_in_bounded_memory() {
        let text = TEXT.replace(
            "[sweep]\n",
            "[expect]\nposition_millimetres_max = { max = 30.0 }\n[sweep]\ndraws = 250000\n",
        ) + "[[sweep.uniform]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nfrom = 0.03\nto = 0.05\n";
        let plan =
            Plan::parse_beside(&Beside::new(Path::new("s.toml")), text, catalogue()).unwrap();
        let cases = SweepCases::new(&plan).unwrap();
        let page = merged(&cases, &|case| row_of_a_sweep(&cases, case));
        assert!(page.contains("Sensitivity") && page.contains("+0.9"));
    }
}
