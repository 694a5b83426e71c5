//! Tests of the attribution: recordings of misbehaving controllers, drives and masters, and of host stalls, are judged
//! again. `tests/misbehaving` makes them; the expected attributions are in `tests/data/attribution/cases.txt`.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{output, root};

/// Largest size of all recordings together, compressed.
const BYTES_MAX: usize = 300_000;
/// Placeholder in `cases.txt` for a value that is not checked.
const ANY: &str = "*";
/// Placeholder in `cases.txt` for an absent value.
const ABSENT: &str = "-";

/// Outcome, the node that the cause is attributed to, and its duty.
type Attribution = [String; 3];

struct Case {
    name: String,
    expected: Attribution,
}

impl Case {
    /// Parses `NAME OUTCOME NODE DUTY`.
    fn parse(line: &str) -> Self {
        let fields = Vec::from_iter(line.split_whitespace().map(str::to_owned));
        let [name, outcome, node, duty] =
            <[String; 4]>::try_from(fields).unwrap_or_else(|_| panic!("four words: {line}"));
        Self {
            name,
            expected: [outcome, node, duty],
        }
    }

    fn is_met_by(&self, found: &Attribution) -> bool {
        let mut pairs = self.expected.iter().zip(found);
        pairs.all(|(expected, found)| expected == ANY || expected == found)
    }
}

fn cases() -> Vec<Case> {
    let text = fs::read_to_string(root().join("tests/data/attribution/cases.txt")).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(Case::parse).collect()
}

/// Unpacks each recording into its own folder below `folder`; returns their names.
fn unpack(folder: &Path) -> BTreeSet<String> {
    let archive = fs::read(root().join("tests/data/attribution/cases.zst")).unwrap();
    assert!(archive.len() <= BYTES_MAX, "{} bytes", archive.len());
    let text = String::from_utf8(zstd::decode_all(&*archive).unwrap()).unwrap();
    let mut cases = BTreeSet::new();
    for part in text.strip_prefix("==> ").unwrap().split("\n==> ") {
        let (path, file) = part.split_once(" <==\n").unwrap();
        let (case, _) = path.rsplit_once('/').unwrap();
        fs::create_dir_all(folder.join(case)).unwrap();
        fs::write(folder.join(path), format!("{file}\n")).unwrap();
        cases.insert(case.to_owned());
    }
    cases
}

/// Returns the attribution of a recording.
fn found(run: &Path) -> Attribution {
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (code, stdout, stderr) = output(replay.args(["replay", "--json"]).arg(run));
    let verdict: Value = serde_json::from_str(&stdout)
        .unwrap_or_else(|_| panic!("{}: {code:?} {stdout}{stderr}", run.display()));
    let word = |value: &Value| value.as_str().unwrap_or(ABSENT).to_owned();
    let cause = &verdict["cause"];
    [&verdict["outcome"], &cause["node"], &cause["duty"]].map(word)
}

#[test]
#[expect(clippy::print_stdout, reason = "shown with a test that fails")]
fn the_guilty_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let recorded = unpack(folder.path());
    let cases = cases();
    let named = BTreeSet::from_iter(cases.iter().map(|case| case.name.clone()));
    assert_eq!(named, recorded, "cases.txt names all that are in cases.zst");

    println!("case | expected | found");
    let mut differences = Vec::new();
    let mut outcomes = 0;
    for case in &cases {
        let found = found(&folder.path().join(&case.name));
        outcomes += usize::from(found[0] == case.expected[0]);
        let row = format!(
            "{} | {} | {}",
            case.name,
            case.expected.join(" "),
            found.join(" ")
        );
        println!("{row}");
        if !case.is_met_by(&found) {
            differences.push(row);
        }
    }
    println!("{outcomes} of {} outcomes are as expected", cases.len());
    assert!(
        differences.is_empty(),
        "{} of {} cases differ:\n{}",
        differences.len(),
        cases.len(),
        differences.join("\n")
    );
}
