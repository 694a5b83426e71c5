//! `canrig merge`: the parts of a campaign, put together.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Shard;
use super::cases::Cases;
use super::finish::{FinishError, Shown, finish};
use super::part::{open_folder, print_found};
use super::store::{self, Header, Store, StoreError};
use super::sweep_cases::{NoSweep, SweepCases};
use crate::torture::cases::{NoTorture, TortureCases};
use crate::torture::command::shrink_first;
use judge::verdict::Identity;
use plan::Plan;
use recording::run_folder::{RunFolder, WriteError, file, own_file};
use runner::console::print_error;
use runner::exit::Exit;
use runner::identity::{NoIdentity, identity};
use runner::play::ValueArgs;
use runner::play_record::PlayRecord;
use runner::recorded::{RecordedError, refuse};
use runner::run::RUNS;
use runner::scenarios;

/// Missing cases that are named.
const MISSING_SHOWN_MAX: usize = 10;

/// Why parts cannot be put together.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MergeError {
    #[error(transparent)]
    NoSweep(#[from] NoSweep),
    #[error(transparent)]
    NoTorture(#[from] NoTorture),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error(transparent)]
    Finish(#[from] FinishError),
    #[error(transparent)]
    NoIdentity(#[from] NoIdentity),
    #[error(transparent)]
    Record(#[from] RecordedError),
    #[error("a broken invariant cannot be shown by a smaller scenario: {0}")]
    Shrink(String),
    #[error("the scenario in {} is not the one that its rows were played of", path.display())]
    Changed { path: PathBuf },
    #[error("{} is a part of another campaign than {} (other file, tables or version of canrig)", other.display(), first.display())]
    Different { first: PathBuf, other: PathBuf },
    #[error("{} was played by another canrig ({version}, this is {}): play it with the very file of this program, or merge with the one that played it", path.display(), env!("CARGO_PKG_VERSION"))]
    Program { path: PathBuf, version: String },
    #[error("case {case} has different results in two parts: {} and {}", first.display(), other.display())]
    Contradiction {
        case: usize,
        first: PathBuf,
        other: PathBuf,
    },
    #[error(
        "{count} of {runs} cases are missing: {cases}. Name all parts, and play those again that are not done"
    )]
    Missing {
        count: usize,
        runs: usize,
        cases: String,
    },
}

impl MergeError {
    pub(crate) fn exit(&self) -> Exit {
        match self {
            Self::Write(_)
            | Self::Finish(_)
            | Self::NoIdentity(_)
            | Self::Shrink(_)
            | Self::Store(StoreError::Write { .. } | StoreError::Busy { .. }) => Exit::BenchFailed,
            _ => Exit::CannotStart,
        }
    }
}

/// Arguments of `merge`.
#[derive(Args, Debug)]
pub struct MergeArgs {
    /// The folders that `canrig sweep --shard` or `canrig torture --shard` made
    #[arg(required = true, value_name = "SHARD")]
    pub shards: Vec<PathBuf>,
    /// Folder in which the whole campaign's folder is made
    #[arg(long, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Print failures only
    #[arg(long, short)]
    pub quiet: bool,
}

/// Does what the command line says.
#[must_use]
pub fn merge(args: &MergeArgs) -> Exit {
    let [first, ..] = args.shards.as_slice() else {
        return Exit::Usage;
    };
    let is_campaign = |path: &&PathBuf| path.join(file::SCENARIO).exists();
    if let Some(other) = args.shards.iter().find(|path| !is_campaign(path)) {
        let (path, name) = (other.display(), file::SCENARIO);
        print_error(&format!(
            "canrig: {path} is no folder of a sweep: there is no {name} in it"
        ));
        return Exit::CannotStart;
    }
    let scenario = match own_file(first, file::SCENARIO) {
        Ok(scenario) => scenario,
        Err(source) => {
            let path = first.join(file::SCENARIO);
            return refuse(RecordedError::Read { path, source });
        }
    };
    let plan = match scenarios::load(&scenario, &ValueArgs::default()) {
        Ok(plan) => plan,
        Err(exit) => return exit,
    };
    let shown = match args.quiet {
        true => Shown::Failures,
        false => Shown::All,
    };
    let merged = CampaignCases::of_folder(first, &plan)
        .and_then(|cases| merge_parts(&args.shards, &cases, &plan, &args.output, shown));
    merged.unwrap_or_else(|error| {
        print_error(&format!("canrig: {error}"));
        error.exit()
    })
}

/// What a campaign is.
pub(crate) enum CampaignCases {
    /// One run for each combination of values.
    Sweep(Box<SweepCases>),
    /// One run for each mix of faults.
    Torture(Box<TortureCases>),
}

impl CampaignCases {
    /// Torture where the folder says so, else a sweep.
    pub(crate) fn of_folder(folder: &Path, plan: &Plan) -> Result<Self, MergeError> {
        Ok(match TortureCases::of_folder(folder, plan)? {
            Some(torture) => Self::Torture(Box::new(torture)),
            None => Self::Sweep(Box::new(SweepCases::new(plan)?)),
        })
    }

    /// The cases, whatever they are.
    pub(crate) fn cases(&self) -> &dyn Cases {
        match self {
            Self::Sweep(cases) => &**cases,
            Self::Torture(torture) => &**torture,
        }
    }
}

/// Puts the rows of the parts into the folder of the whole campaign, and makes tables and page of them.
pub(crate) fn merge_parts(
    parts: &[PathBuf],
    campaign: &CampaignCases,
    plan: &Plan,
    output: &Path,
    shown: Shown,
) -> Result<Exit, MergeError> {
    let cases = campaign.cases();
    let identity = identity(plan)?;
    check(parts, cases, &identity)?;
    let folder = open_folder(output, plan, cases, Shard::WHOLE)?;
    let header = Header::new(cases, &identity, Shard::WHOLE);
    let (store, found) = Store::open(folder.path(), &header)?;
    print_found(&found, shown != Shown::All);
    let mut store = store.of_copies();
    let before = store.len();
    add_all(parts, cases, &folder, &mut store)?;
    store.finish()?;
    if store.len() > before {
        // Later than any of its parts.
        let known = match PlayRecord::read(folder.path())? {
            None => PlayRecord::read(&parts[0])?,
            known => known,
        };
        let now = PlayRecord::now(&[]);
        let set = known.map_or(now.set, |known| known.set);
        PlayRecord { set, ..now }.write(&folder)?;
    }
    let missing = Shard::WHOLE.cases(cases.runs());
    let mut missing = missing.filter(|case| !store.has(*case)).peekable();
    if missing.peek().is_some() {
        return Err(MergeError::Missing {
            count: cases.runs() - store.len(),
            runs: cases.runs(),
            cases: words(missing),
        });
    }
    drop(missing);
    let _lock = store.into_lock();
    let exit = finish(&folder, plan, cases, shown)?;
    if let CampaignCases::Torture(torture) = campaign {
        shrink_first(folder.path(), torture, output).map_err(MergeError::Shrink)?;
    }
    Ok(exit)
}

/// The parts must be of this campaign and played by this program. One that no machine has ended has no rows yet.
fn check(parts: &[PathBuf], cases: &dyn Cases, identity: &Identity) -> Result<(), MergeError> {
    for path in parts.iter().filter(|path| store::has_rows(path)) {
        let (header, _) = store::read(path)?;
        let path = path.clone();
        if header.identity.program != identity.program {
            return Err(MergeError::Program {
                path,
                version: header.version,
            });
        }
        if (header.sweep.as_str(), &header.identity) != (cases.id(), identity) {
            let first = parts[0].clone();
            return Err(match first == path {
                true => MergeError::Changed { path },
                false => MergeError::Different { first, other: path },
            });
        }
    }
    Ok(())
}

/// Adds the rows of all parts, one part after the other. Parts may have the same row; the same case with another row is refused.
fn add_all(
    parts: &[PathBuf],
    cases: &dyn Cases,
    folder: &RunFolder,
    store: &mut Store,
) -> Result<(), MergeError> {
    // Where the row of a case is from.
    let mut origins: Vec<Option<u32>> = vec![None; cases.runs() + 1];
    for (number, part) in (0..).zip(parts).filter(|(_, part)| store::has_rows(part)) {
        for row in store::read(part)?.1 {
            let row = row?;
            let case = row.case;
            match store.row(case)? {
                Some(known) if known != row => {
                    let first = origins.get(case).copied().flatten();
                    let first = first.and_then(|number: u32| parts.get(number as usize));
                    let first = first.map_or(folder.path(), PathBuf::as_path).to_owned();
                    let other = part.clone();
                    return Err(MergeError::Contradiction { case, first, other });
                }
                Some(_) => {}
                None if (1..=cases.runs()).contains(&case) => {
                    store.append(&row)?;
                    origins[case] = Some(number);
                }
                None => {}
            }
        }
    }
    Ok(())
}

/// The first of the missing cases.
fn words(missing: impl Iterator<Item = usize>) -> String {
    let first: Vec<String> = missing
        .take(MISSING_SHOWN_MAX + 1)
        .map(|case| case.to_string())
        .collect();
    match first.split_at_checked(MISSING_SHOWN_MAX) {
        Some((named, [_, ..])) => named.join(", ") + ", …",
        _ => first.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::sweep::row::{Ended, SweepRow};
    use crate::torture::cases::Draws;
    use runner::console::print;
    use runner::machine::{Stopwatch, memory_bytes_max};
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\n\
        [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15, 25, 35]\n";

    fn header(cases: &SweepCases, shard: Shard) -> Header {
        let identity = Identity {
            program: "p".to_owned(),
            plant: "sma_actuator".to_owned(),
            law: "pid".to_owned(),
            files: BTreeMap::new(),
        };
        Header::new(cases, &identity, shard)
    }

    /// A folder with the rows of a part, which ended for these reasons.
    fn part(cases: &SweepCases, shard: Shard, reasons: [&str; 2]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(folder.path(), &header(cases, shard)).unwrap();
        for (case, reason) in shard.cases(cases.runs()).zip(reasons) {
            let id = &cases.case(case).id;
            let row = SweepRow::without_verdict(case, id, Ended::Invalid, reason.to_owned());
            store.append(&row).unwrap();
        }
        folder
    }

    #[test]
    fn parts_that_contradict_each_other_are_refused() {
        let plan = Plan::parse_beside(
            &Beside::new(Path::new("s.toml")),
            TEXT.to_owned(),
            catalogue(),
        )
        .unwrap();
        let cases = SweepCases::new(&plan).unwrap();
        let half = |number| Shard { number, of: 2 };
        let folders = [
            part(&cases, half(1), ["a", "c"]),
            part(&cases, half(2), ["b", "d"]),
            part(&cases, half(1), ["a", "x"]),
        ];
        let paths = folders.each_ref().map(|folder| folder.path().to_owned());
        let whole = RunFolder::lasting(&paths[0], "whole", "1").unwrap();
        let add = |parts: &[PathBuf]| {
            let header = header(&cases, Shard::WHOLE);
            let (mut store, _) = Store::open(whole.path(), &header).unwrap();
            add_all(parts, &cases, &whole, &mut store).map(|()| {
                let reason = |case| store.row(case).unwrap().unwrap().reason.unwrap();
                (1..=4).map(reason).collect::<String>()
            })
        };
        // Twice the same.
        let same = [&paths[0], &paths[1], &paths[0]].map(Clone::clone);
        assert_eq!(add(&same).unwrap(), "abcd");
        std::fs::remove_file(whole.path().join(store::FILE)).unwrap();
        let error = add(&paths).unwrap_err();
        let [first, _, other] = paths.each_ref().map(|path| path.display());
        let text = format!("case 3 has different results in two parts: {first} and {other}");
        assert_eq!(error.to_string(), text);
        assert_eq!(error.exit(), Exit::CannotStart);
    }

    /// A part whose rows nobody has played.
    fn made_up(
        folder: &Path,
        plan: &Plan,
        cases: &dyn Cases,
        shard: Shard,
        row: &dyn Fn(usize) -> SweepRow,
    ) -> PathBuf {
        let part = open_folder(folder, plan, cases, shard).unwrap();
        let header = Header::new(cases, &identity(plan).unwrap(), shard);
        let (store, _) = Store::open(part.path(), &header).unwrap();
        let mut store = store.of_copies();
        for case in shard.cases(cases.runs()) {
            store.append(&row(case)).unwrap();
        }
        store.finish().unwrap();
        part.path().to_owned()
    }

    /// A metric that follows both keys, and eleven more.
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
        let own = ("position_millimetres_max".to_owned(), value);
        SweepRow {
            case,
            id: "0123456789abcdef".to_owned(),
            seed: Some(0),
            ended: if is_missed { Ended::Fail } else { Ended::Pass },
            reason: None,
            missed: is_missed.then(|| own.0.clone()).into_iter().collect(),
            undecided: Vec::new(),
            metrics: others.chain([own]).collect(),
        }
    }

    /// An invariant that half of the mixes with a certain fault break.
    fn row_of_torture(cases: &TortureCases, case: usize) -> SweepRow {
        let keys = cases.keys();
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

    /// Merges a campaign of a million runs whose rows are made up, prints what it costs, and returns its page.
    fn merged(plan: &Plan, campaign: &CampaignCases, row: &dyn Fn(usize) -> SweepRow) -> String {
        const PARTS: usize = 40;
        let cases = campaign.cases();
        assert_eq!(cases.runs(), RUNS);
        let folder = tempfile::tempdir().unwrap();
        let watch = Stopwatch::start();
        let part = |number| {
            let shard = Shard { number, of: PARTS };
            made_up(folder.path(), plan, cases, shard, row)
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
        merge_parts(&parts, campaign, plan, &output, Shown::All).unwrap();
        let entries = std::fs::read_dir(&output).unwrap();
        let entries = entries.map(|entry| entry.unwrap().path());
        let mut pages = entries.filter(|path| path.join(store::FILE).exists());
        let page = pages.next().unwrap();
        let size = |name: &str| page.join(name).metadata().unwrap().len();
        print(&format!(
            "merged and reported in {:.1} s, VmHWM {} MiB; rows {} MB, page {} kB",
            watch.elapsed().as_secs_f64(),
            mebibytes(),
            size(store::FILE) / 1_000_000,
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
            runs: RUNS,
            seed: 1,
        };
        let cases = TortureCases::new(&plan, draws);
        let campaign = CampaignCases::Torture(Box::new(cases));
        let CampaignCases::Torture(cases) = &campaign else {
            unreachable!("as it was made")
        };
        let page = merged(&plan, &campaign, &|case| row_of_torture(cases, case));
        assert!(page.contains("What drives it") && page.contains("sensor.stuck"));
    }

    /// What planning, merging and the report cost.
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
        let campaign = CampaignCases::Sweep(Box::new(cases));
        let CampaignCases::Sweep(cases) = &campaign else {
            unreachable!("as it was made")
        };
        let page = merged(&plan, &campaign, &|case| row_of_a_sweep(cases, case));
        assert!(page.contains("What drives it") && page.contains("+0.9"));
    }
}
