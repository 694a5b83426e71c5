//! `canrig coverage`: the scenarios that test each requirement, and their outcomes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;

use super::matrix::{Requirement, RequirementTest};
use super::page;
use super::play::{Play, Tested, latest};
use crate::torture::cases::is_torture;
use judge::verdict::Outcome;
use recording::run_folder::file;
use runner::console::{print, print_problem, print_text};
use runner::exit::{Exit, Failure};
use runner::output::{link, write_page};
use runner::recorded::{holds_many_runs, opened};

/// Columns of the list: name and text of a requirement.
const COLUMNS: [&str; 2] = ["id", "text"];

/// Arguments of `coverage`.
#[derive(Args, Debug)]
pub struct CoverageArgs {
    /// Folders of runs and sweeps, or folders of these; the latest play of a scenario counts
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// A CSV file of all requirements, with a column `id` and, if you like, `text`: those that no run tests are shown too
    #[arg(long, value_name = "FILE")]
    pub requirements: Option<PathBuf>,
    /// Write the matrix of requirements and scenarios as a page
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the matrix as JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Shows the matrix. The exit code says whether every requirement was tested and met.
pub fn coverage(args: &CoverageArgs) -> Result<Exit, Failure> {
    // Without each folder there is no matrix, whatever the reason.
    let requirements = gather(args).map_err(|failure| Failure {
        exit: Exit::CannotStart,
        ..failure
    })?;
    if args.json {
        print(&serde_json::to_string_pretty(&requirements).expect("plain data"));
    } else {
        print_text(&page::to_text(&requirements));
    }
    if let Some(output) = &args.output {
        let link_to = |run: &Path| link(output, &run.join(file::REPORT));
        write_page(output, &page::to_html(&requirements, link_to))?;
    }
    Ok(exit(&requirements))
}

/// Returns the exit code. A requirement that failed, broke off or is never tested is not met; if the others are only undecided,
/// the result is inconclusive.
fn exit(requirements: &[Requirement]) -> Exit {
    let exits = requirements.iter().map(|one| match one.outcome() {
        Some(Outcome::Pass) => Exit::Pass,
        Some(Outcome::Inconclusive) => Exit::Inconclusive,
        Some(Outcome::Fail | Outcome::Incomplete) | None => Exit::VerdictFailed,
    });
    exits.max().unwrap_or(Exit::Pass)
}

fn gather(args: &CoverageArgs) -> Result<Vec<Requirement>, Failure> {
    let mut all: BTreeMap<String, Requirement> = BTreeMap::new();
    let is_listed = args.requirements.is_none();
    for (test, plays) in tests(&opened(&args.runs))? {
        let count = plays.len();
        let plays = latest(plays);
        let mut results: BTreeMap<&String, Vec<(&Play, &Tested)>> = BTreeMap::new();
        for play in &plays {
            for (id, tested) in &play.tested {
                let of_play = tested.iter().map(|one| (play, one));
                results.entry(id).or_default().extend(of_play);
            }
        }
        for (id, results) in results {
            let requirement = all
                .entry(id.clone())
                .or_insert_with(|| Requirement::new(id.clone(), is_listed));
            let test = RequirementTest::new(&test, count, &results);
            requirement.tests.push(test);
        }
    }
    for (id, text) in args.requirements.as_deref().map_or(Ok(vec![]), read_list)? {
        let requirement = all
            .entry(id.clone())
            .or_insert_with(|| Requirement::new(id, true));
        (requirement.text, requirement.is_listed) = (text, true);
    }
    Ok(all.into_values().collect())
}

/// Returns the tests in some folders by their names, each with its plays. Folders of torture are reported and left out; if there
/// are no others, they are an error.
fn tests(folders: &[PathBuf]) -> Result<Vec<(String, Vec<Play>)>, Failure> {
    let refused = |folder: &Path| {
        let folder = folder.display();
        Exit::CannotStart.because(format!(
            "{folder} is the folder of torture, which plays without the scenario's limits and tests no requirement"
        ))
    };
    let is_refused = |folder: &&PathBuf| holds_many_runs(folder) && is_torture(folder);
    let (left_out, others): (Vec<_>, Vec<_>) = folders.iter().partition(is_refused);
    if others.is_empty()
        && let Some(folder) = left_out.last()
    {
        return Err(refused(folder));
    }
    for folder in left_out {
        print_problem(format!("{}; it is left out", refused(folder)));
    }
    let mut tests: Vec<(String, Vec<Play>)> = Vec::new();
    for folder in others {
        let play = Play::read(folder)?;
        match tests.iter_mut().find(|(test, _)| *test == play.test) {
            Some((_, plays)) => plays.push(play),
            None => tests.push((play.test.clone(), vec![play])),
        }
    }
    Ok(tests)
}

/// Reads the names and texts of a CSV file.
fn read_list(path: &Path) -> Result<Vec<(String, Option<String>)>, Failure> {
    let wrong = |reason: String| {
        let path = path.display();
        Exit::CannotStart.because(format!("`{path}` is not a list of requirements: {reason}"))
    };
    let text = scenario::read_text(path, plan::FILE_BYTES_MAX)
        .map_err(|error| wrong(error.to_string()))?;
    parse_list(text.trim_start_matches('\u{feff}')).map_err(wrong)
}

fn parse_list(text: &str) -> Result<Vec<(String, Option<String>)>, String> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| error.to_string())?;
    let [id, text] = COLUMNS.map(|name| header.iter().position(|column| column == name));
    let id = id.ok_or("its first line must name the column `id`, and may name `text`")?;
    let mut listed: BTreeMap<String, u64> = BTreeMap::new();
    let mut requirements = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| error.to_string())?;
        let line = record.position().map_or(0, csv::Position::line);
        let name = record.get(id).unwrap_or_default();
        if name.is_empty() {
            return Err(format!("line {line} has no id"));
        }
        if let Some(first) = listed.insert(name.to_owned(), line) {
            return Err(format!("line {line} has {name} again, as line {first}"));
        }
        let text = text.and_then(|place| record.get(place)).map(str::to_owned);
        requirements.push((name.to_owned(), text.filter(|text| !text.is_empty())));
    }
    Ok(requirements)
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;

    /// Adds a test of which each play has an outcome of the row.
    fn add(requirement: &mut Requirement, test: &str, row: &str, outcomes: &[Outcome]) {
        let play = |(place, outcome): (usize, &Outcome)| {
            let play = Play {
                test: test.to_owned(),
                folder: PathBuf::from(format!("run-{place}")),
                version: Some("1".to_owned()),
                at: Some(Timestamp::UNIX_EPOCH),
                sweep_runs: None,
                tested: BTreeMap::new(),
            };
            let tested = Tested {
                row: Some(row.to_owned()),
                limit: String::new(),
                measured: None,
                outcome: *outcome,
                uncovered: None,
                case: None,
            };
            (play, tested)
        };
        let plays = Vec::from_iter(outcomes.iter().enumerate().map(play));
        let results = Vec::from_iter(plays.iter().map(|(play, tested)| (play, tested)));
        let test = RequirementTest::new(test, outcomes.len(), &results);
        requirement.tests.push(test);
    }

    fn requirement(outcomes: &[Outcome]) -> Requirement {
        let mut requirement = Requirement::new("REQ-1".to_owned(), true);
        if !outcomes.is_empty() {
            add(&mut requirement, "step", "overshoot", outcomes);
        }
        requirement
    }

    #[test]
    fn the_worst_of_the_plays_that_count_decides() {
        use Outcome::{Fail, Incomplete, Inconclusive, Pass};
        let both = requirement(&[Pass, Fail, Incomplete]);
        assert_eq!(both.outcome(), Some(Fail));
        let [test] = both.tests.as_slice() else {
            panic!("{both:?}")
        };
        assert_eq!((test.plays, test.run.as_path()), (3, Path::new("run-1")));
        assert_eq!(test.rows, ["overshoot"]);
        assert_eq!(requirement(&[Fail, Pass]).outcome(), Some(Fail));
        let mut two = requirement(&[Fail]);
        add(&mut two, "sine", "gain", &[Pass]);
        assert_eq!((two.tests.len(), two.outcome()), (2, Some(Fail)));
        let exits = [
            (requirement(&[Pass, Pass]), Exit::Pass),
            (requirement(&[Pass, Inconclusive]), Exit::Inconclusive),
            (
                requirement(&[Inconclusive, Incomplete]),
                Exit::VerdictFailed,
            ),
            (requirement(&[]), Exit::VerdictFailed),
        ];
        for (requirement, expected) in exits {
            assert_eq!(exit(&[requirement]), expected);
        }
    }

    #[test]
    fn a_list_has_names_and_perhaps_texts() {
        let listed = parse_list("text,owner,id\n\"stops, soon\",me,REQ-1\n,me, REQ-2 \n").unwrap();
        let expected = [
            ("REQ-1".to_owned(), Some("stops, soon".to_owned())),
            ("REQ-2".to_owned(), None),
        ];
        assert_eq!(listed, expected);
        let wrong = [
            ("name\nREQ-1\n", "must name the column `id`"),
            (
                "id\nREQ-1\nREQ-2\nREQ-1\n",
                "line 4 has REQ-1 again, as line 2",
            ),
            ("id,text\n,what\n", "line 2 has no id"),
            ("id,text\nREQ-1\n", "line: 2"),
        ];
        for (text, reason) in wrong {
            let error = parse_list(text).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
    }
}
