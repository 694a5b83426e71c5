//! `canrig merge`: the parts of a sweep, put together.

use std::iter::Peekable;
use std::path::{Path, PathBuf};

use clap::Args;

use super::Shard;
use super::command::{open_folder, print_found};
use super::finish::{FinishError, Shown, finish};
use super::plan::{PlanError, SweepPlan};
use super::row::SweepRow;
use super::store::{self, Header, Store, StoreError, StoredRows};
use recording::run_folder::{WriteError, file};
use rig::setup::Setup;
use runner::console::print_error;
use runner::exit::Exit;
use runner::identity::{NoIdentity, identity};
use runner::run::RUNS;
use runner::scenarios;

/// Missing cases that are named.
const MISSING_SHOWN_MAX: usize = 10;

/// Why parts cannot be put together.
#[derive(Debug, thiserror::Error)]
enum MergeError {
    #[error(transparent)]
    SweepPlan(#[from] PlanError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error(transparent)]
    Finish(#[from] FinishError),
    #[error(transparent)]
    NoIdentity(#[from] NoIdentity),
    #[error("{} is a part of another sweep than {} (other file, tables or version of canrig)", other.display(), first.display())]
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
        "{count} of {runs} cases are missing: {cases}. Name all parts, and let `canrig sweep` end those that are not done"
    )]
    Missing {
        count: usize,
        runs: usize,
        cases: String,
    },
}

impl MergeError {
    fn exit(&self) -> Exit {
        match self {
            Self::Write(_)
            | Self::Finish(_)
            | Self::NoIdentity(_)
            | Self::Store(StoreError::Write { .. } | StoreError::Busy { .. }) => Exit::BenchFailed,
            _ => Exit::CannotStart,
        }
    }
}

/// A part that is read.
struct Part {
    path: PathBuf,
    rows: Peekable<StoredRows>,
}

/// Arguments of `merge`.
#[derive(Args, Debug)]
pub struct MergeArgs {
    /// The folders that `canrig sweep --shard` made
    #[arg(required = true, value_name = "SHARD")]
    pub shards: Vec<PathBuf>,
    /// Folder in which the whole sweep's folder is made
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
    let is_sweep = |path: &&PathBuf| path.join(file::SCENARIO).exists();
    if let Some(other) = args.shards.iter().find(|path| !is_sweep(path)) {
        let (path, name) = (other.display(), file::SCENARIO);
        print_error(&format!(
            "canrig: {path} is no folder of a sweep: there is no {name} in it"
        ));
        return Exit::CannotStart;
    }
    let setups = match scenarios::load(&first.join(file::SCENARIO), &[]) {
        Ok(setups) => setups,
        Err(exit) => return exit,
    };
    merged(args, &setups).unwrap_or_else(|error| {
        print_error(&format!("canrig: {error}"));
        error.exit()
    })
}

fn merged(args: &MergeArgs, setups: &[Setup]) -> Result<Exit, MergeError> {
    let plan = SweepPlan::new(setups)?;
    let setup = &setups[0];
    let header = Header::new(&plan, &identity(setup)?, Shard::WHOLE);
    let mut parts = open(&args.shards, &header)?;
    let folder = open_folder(&args.output, setup, &plan, Shard::WHOLE)?;
    let (mut store, found) = Store::open(folder.path(), &header)?;
    print_found(&found, args.quiet);
    let mut missing = Vec::new();
    for case in Shard::WHOLE.cases(plan.runs()) {
        let row = row_of_case(&mut parts, case)?;
        match row {
            _ if store.has(case) => {}
            Some(row) => store.append(&row)?,
            None => missing.push(case),
        }
    }
    store.finish()?;
    if !missing.is_empty() {
        return Err(MergeError::Missing {
            count: missing.len(),
            runs: plan.runs(),
            cases: words(&missing),
        });
    }
    let shown = match args.quiet {
        true => Shown::Failures,
        false => Shown::All,
    };
    Ok(finish(&folder, setups, &plan, shown)?)
}

/// Opens the parts, which must be of this sweep and played by this program.
fn open(paths: &[PathBuf], expected: &Header) -> Result<Vec<Part>, MergeError> {
    let open = |path: &PathBuf| {
        let (header, rows) = store::read(path)?;
        let path = path.clone();
        if header.identity.program != expected.identity.program {
            return Err(MergeError::Program {
                path,
                version: header.version,
            });
        }
        if (&header.sweep, &header.identity) != (&expected.sweep, &expected.identity) {
            let first = paths.first().map_or_else(PathBuf::new, PathBuf::clone);
            return Err(MergeError::Different { first, other: path });
        }
        Ok(Part {
            path,
            rows: rows.peekable(),
        })
    };
    paths.iter().map(open).collect()
}

/// The row of a case; none where no part has it. Parts may have the same one.
fn row_of_case(parts: &mut [Part], case: usize) -> Result<Option<SweepRow>, MergeError> {
    let mut found: Option<(&Path, SweepRow)> = None;
    for part in parts {
        // An error must come out, too.
        let is_its_turn =
            |row: &Result<SweepRow, StoreError>| row.as_ref().map_or(true, |row| row.case == case);
        let Some(row) = part.rows.next_if(is_its_turn).transpose()? else {
            continue;
        };
        match &found {
            Some((first, other)) if *other != row => {
                let (first, other) = ((*first).to_owned(), part.path.clone());
                return Err(MergeError::Contradiction { case, first, other });
            }
            Some(_) => {}
            None => found = Some((&part.path, row)),
        }
    }
    Ok(found.map(|(_, row)| row))
}

/// The first of the missing cases.
fn words(missing: &[usize]) -> String {
    let named: Vec<String> = missing
        .iter()
        .take(MISSING_SHOWN_MAX)
        .map(ToString::to_string)
        .collect();
    let more = if missing.len() > MISSING_SHOWN_MAX {
        ", …"
    } else {
        ""
    };
    named.join(", ") + more
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::sweep::row::Ended;
    use judge::verdict::Identity;
    use scenario::Scenario;
    use worlds::catalogue::catalogue;

    const TEXT: &str = "schema = 1\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\n\
        [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15, 25, 35]\n";

    fn header(plan: &SweepPlan, shard: Shard) -> Header {
        let identity = Identity {
            program: "p".to_owned(),
            plant: "sma_actuator".to_owned(),
            law: "pid".to_owned(),
            files: BTreeMap::new(),
        };
        Header::new(plan, &identity, shard)
    }

    /// A folder with the rows of a part, which ended for these reasons.
    fn part(plan: &SweepPlan, shard: Shard, reasons: [&str; 2]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(folder.path(), &header(plan, shard)).unwrap();
        for (case, reason) in shard.cases(plan.runs()).zip(reasons) {
            let id = &plan.case(case).id;
            let row = SweepRow::without_verdict(case, id, Ended::Invalid, reason.to_owned());
            store.append(&row).unwrap();
        }
        folder
    }

    #[test]
    fn parts_that_contradict_each_other_are_refused() {
        let scenario = Scenario::parse(TEXT, "s.toml", |_| unreachable!("no table")).unwrap();
        let setup = Setup::new(scenario, catalogue()).from_file("s.toml", TEXT.to_owned());
        let plan = SweepPlan::new(&[setup]).unwrap();
        let half = |number| Shard { number, of: 2 };
        let folders = [
            part(&plan, half(1), ["a", "c"]),
            part(&plan, half(2), ["b", "d"]),
            part(&plan, half(1), ["a", "x"]),
        ];
        let paths = folders.each_ref().map(|folder| folder.path().to_owned());
        let mut parts = open(&paths, &header(&plan, Shard::WHOLE)).unwrap();
        // Twice the same, then of one part alone.
        for (case, reason) in [(1, "a"), (2, "b")] {
            let row = row_of_case(&mut parts, case).unwrap().unwrap();
            assert_eq!((row.case, row.reason.as_deref()), (case, Some(reason)));
        }
        let error = row_of_case(&mut parts, 3).unwrap_err();
        let [first, _, other] = paths.each_ref().map(|path| path.display());
        let text = format!("case 3 has different results in two parts: {first} and {other}");
        assert_eq!(error.to_string(), text);
        assert_eq!(error.exit(), Exit::CannotStart);
    }
}
