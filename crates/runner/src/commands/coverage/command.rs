//! `canrig coverage`: which requirement is tested by which scenario, and what came of it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;

use super::matrix::Requirement;
use super::page;
use crate::console::{print, print_error};
use crate::exit::Exit;
use crate::output::{link, write_page};
use crate::recorded::{RecordedError, read_played, refuse, require_run, runs_among};
use judge::verdict::{Outcome, Verdict};
use recording::run_folder::file;
use rig::plan::Plan;
use worlds::catalogue::catalogue;

/// Columns of the list: the requirement's name, and what it says.
const COLUMNS: [&str; 2] = ["id", "text"];

/// Why there is no matrix.
#[derive(Debug, thiserror::Error)]
enum CoverageError {
    #[error(transparent)]
    Run(#[from] RecordedError),
    #[error("{} is no list of requirements: {reason}", path.display())]
    List { path: PathBuf, reason: String },
}

/// Arguments of `coverage`.
#[derive(Args, Debug)]
pub struct CoverageArgs {
    /// Run folders; of several runs of one scenario the worst one counts, and of several folders those of sweeps are left out
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

/// Shows the matrix; the exit code says whether every requirement was tested and met.
#[must_use]
pub fn coverage(args: &CoverageArgs) -> Exit {
    let requirements = match gather(args) {
        Ok(requirements) => requirements,
        Err(CoverageError::Run(error)) => return refuse(error),
        Err(error) => {
            print_error(&format!("canrig: {error}"));
            return Exit::CannotStart;
        }
    };
    if args.json {
        print(&serde_json::to_string_pretty(&requirements).expect("plain data"));
    } else {
        print(&page::to_text(&requirements));
    }
    if let Some(output) = &args.output {
        let link_to = |run: &Path| link(output, &run.join(file::REPORT));
        if let Err(exit) = write_page(output, &page::to_html(&requirements, link_to)) {
            return exit;
        }
    }
    exit(&requirements)
}

/// A requirement that failed, broke off or is never tested is not met; what is undecided only is inconclusive.
fn exit(requirements: &[Requirement]) -> Exit {
    let exits = requirements.iter().map(|one| match one.outcome() {
        Some(Outcome::Pass) => Exit::Pass,
        Some(Outcome::Inconclusive) => Exit::Inconclusive,
        Some(Outcome::Fail | Outcome::Incomplete) | None => Exit::VerdictFailed,
    });
    exits.max().unwrap_or(Exit::Pass)
}

fn gather(args: &CoverageArgs) -> Result<Vec<Requirement>, CoverageError> {
    let mut all: BTreeMap<String, Requirement> = BTreeMap::new();
    let is_listed = args.requirements.is_none();
    for folder in runs_among(&args.runs) {
        let (plan, verdict) = read(folder)?;
        for (id, rows) in demanded(&plan) {
            let untimed = untimed(&plan, verdict.as_ref());
            let outcome = |row: &Option<String>| match row {
                Some(row) if untimed.contains(row) => Outcome::Inconclusive,
                row => outcome_of(row.as_deref(), verdict.as_ref()),
            };
            let rows: Vec<_> = rows
                .into_iter()
                .map(|row| (row.clone(), outcome(&row)))
                .collect();
            let requirement = all
                .entry(id.clone())
                .or_insert_with(|| Requirement::new(id, is_listed));
            requirement.add(&plan.shared.name, &rows, folder);
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

/// The plan of a run folder and its verdict; none for a run that was killed.
fn read(folder: &Path) -> Result<(Plan, Option<Verdict>), RecordedError> {
    require_run(folder)?;
    read_played(folder, catalogue())
}

/// Each requirement of a scenario with the rows that test it; none stands for the scenario as a whole.
fn demanded(plan: &Plan) -> BTreeMap<String, Vec<Option<String>>> {
    let mut demanded: BTreeMap<String, Vec<Option<String>>> = BTreeMap::new();
    for id in &plan.shared.requirements {
        demanded.entry(id.clone()).or_default().push(None);
    }
    let of_loops = plan.loops.iter().flat_map(|one| {
        let rows = one.scenario.expect.requirements_of_rows().into_iter();
        rows.map(|(row, ids)| (judge::row_of_loop(one, &row), ids))
    });
    let of_contours = plan.shared.contours.iter().flat_map(|contour| {
        let tested = contour.rows().into_iter();
        let tested = tested.filter(|(_, limit)| limit.is_some());
        tested.map(|(row, _)| (row, contour.requirements.clone()))
    });
    for (row, requirements) in of_loops.chain(of_contours) {
        for id in requirements {
            demanded.entry(id).or_default().push(Some(row.clone()));
        }
    }
    demanded
}

/// The rows on timing that a verdict does not have, since the run was in virtual time.
fn untimed(plan: &Plan, verdict: Option<&Verdict>) -> Vec<String> {
    let is_untimed = verdict.is_some_and(|verdict| {
        let is_decided = matches!(verdict.outcome, Outcome::Pass | Outcome::Fail);
        is_decided && verdict.timing.is_none()
    });
    let rows = plan
        .loops
        .iter()
        .flat_map(|one| one.scenario.expect.timing.rows());
    rows.filter(|_| is_untimed).collect()
}

/// What a verdict says of a row, or of the whole run.
fn outcome_of(row: Option<&str>, verdict: Option<&Verdict>) -> Outcome {
    let Some(verdict) = verdict else {
        return Outcome::Incomplete;
    };
    let (Outcome::Pass | Outcome::Fail, Some(row)) = (verdict.outcome, row) else {
        return verdict.outcome;
    };
    match verdict.metrics.iter().find(|metric| metric.name == row) {
        Some(metric) => match metric.passed {
            Some(true) => Outcome::Pass,
            Some(false) => Outcome::Fail,
            None => Outcome::Inconclusive,
        },
        // The scenario beside the verdict is not the one that was judged.
        None => Outcome::Incomplete,
    }
}

/// Reads the names and texts of a CSV file.
fn read_list(path: &Path) -> Result<Vec<(String, Option<String>)>, CoverageError> {
    let wrong = |reason: String| CoverageError::List {
        path: path.to_owned(),
        reason,
    };
    let text =
        scenario::read_text(path, rig::FILE_BYTES_MAX).map_err(|error| wrong(error.to_string()))?;
    parse_list(text.trim_start_matches('\u{feff}')).map_err(wrong)
}

fn parse_list(text: &str) -> Result<Vec<(String, Option<String>)>, String> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| error.to_string())?;
    let [id, words] = COLUMNS.map(|name| header.iter().position(|column| column == name));
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
        let words = words.and_then(|place| record.get(place)).map(str::to_owned);
        requirements.push((name.to_owned(), words.filter(|words| !words.is_empty())));
    }
    Ok(requirements)
}

#[cfg(test)]
mod tests {
    use super::*;
    use judge::verdict::Metric;
    use scenario::expect::Limit;

    fn requirement(outcomes: &[Outcome]) -> Requirement {
        let mut requirement = Requirement::new("REQ-1".to_owned(), true);
        for (place, outcome) in outcomes.iter().enumerate() {
            let run = PathBuf::from(format!("run-{place}"));
            let rows = [(Some("overshoot".to_owned()), *outcome)];
            requirement.add("step", &rows, &run);
        }
        requirement
    }

    #[test]
    fn the_worst_of_several_runs_counts() {
        use Outcome::{Fail, Incomplete, Inconclusive, Pass};
        let both = requirement(&[Pass, Fail, Incomplete]);
        assert_eq!(both.outcome(), Some(Fail));
        let [test] = both.tests.as_slice() else {
            panic!("{both:?}")
        };
        assert_eq!((test.runs, test.run.as_path()), (3, Path::new("run-1")));
        assert_eq!(test.rows, ["overshoot"]);
        assert_eq!(requirement(&[Fail, Pass]).outcome(), Some(Fail));
        let mut two = requirement(&[Fail]);
        two.add("sine", &[(None, Pass)], Path::new("run-1"));
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
    fn a_row_has_its_own_outcome_unless_the_run_decides_nothing() {
        let limit = Some(Limit {
            min: None,
            max: Some(1.0),
        });
        let mut verdict = Verdict::incomplete("step", 1, "");
        verdict.metrics = vec![
            Metric::new("met", Ok(0.5), limit),
            Metric::new("missed", Ok(2.0), limit),
            Metric::not_judged("unknown", "nobody publishes it".to_owned(), limit),
        ];
        let of = |outcome, row| {
            let verdict = Verdict {
                outcome,
                ..verdict.clone()
            };
            outcome_of(row, Some(&verdict))
        };
        assert_eq!(of(Outcome::Fail, Some("met")), Outcome::Pass);
        assert_eq!(of(Outcome::Fail, Some("missed")), Outcome::Fail);
        assert_eq!(of(Outcome::Fail, Some("unknown")), Outcome::Inconclusive);
        assert_eq!(of(Outcome::Fail, Some("gone")), Outcome::Incomplete);
        assert_eq!(of(Outcome::Fail, None), Outcome::Fail);
        assert_eq!(of(Outcome::Incomplete, Some("met")), Outcome::Incomplete);
        assert_eq!(outcome_of(Some("met"), None), Outcome::Incomplete);
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
