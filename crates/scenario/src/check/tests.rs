//! Tests of `[[expect.signal]]` and `[[expect.sequence]]` in the loader: values, problems, and their places.

use std::io;
use std::path::Path;

use proptest::prelude::*;

use crate::scenario::Scenario;
use crate::{Asked, Beside, Objection, ScenarioError, Trial};

const GOLDEN: &str = "cycle,time_seconds,current_amperes\n0,0.5,1.0\n1,1.0,\n2,1.5,2.0\n";

/// Parses a scenario of 4 s with more tables; `[[expect.signal]]` begins in line 8.
pub(super) fn parse(more: &str) -> Result<Trial, ScenarioError> {
    resolved(more).map(|mut scenario| scenario.loops.remove(0))
}

/// Parses as [`parse`], and returns the whole scenario.
pub(super) fn resolved(more: &str) -> Result<Scenario, ScenarioError> {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 4.0\n[controller.pid]\n[[reference.hold]]\n\
         at_seconds = 0.0\nposition_millimetres = 10.0\n{more}"
    );
    let mut read = |name: &str| match name {
        "golden.csv" => Ok(GOLDEN.to_owned()),
        "locked.csv" => Err(io::Error::other("permission denied")),
        _ => Err(io::ErrorKind::NotFound.into()),
    };
    let beside = Beside::new(Path::new("t.toml"));
    Scenario::parse(&beside, text, &mut read, &Asked::default())
}

/// Checks that there is one problem, its place and its message; its label is in the `Debug` text.
#[track_caller]
pub(super) fn check(more: &str, line: usize, column: usize, message: &str, label: &str) {
    let error = parse(more).expect_err(message);
    let [problem] = error.problems() else {
        panic!("{:?}", error.problems());
    };
    assert_eq!(problem.to_string(), message);
    assert_eq!(problem.line_and_column(), Some((line, column)), "{message}");
    let shown = format!("{problem:?}");
    assert!(shown.contains(label), "expected {label}: {shown}");
}

fn signal(keys: &str) -> String {
    format!("[[expect.signal]]\nname = \"current_amperes\"\n{keys}\n")
}

fn sequence(events: &str) -> String {
    format!("[[expect.sequence]]\nname = \"s\"\nevent = [{events}]\n")
}

/// Returns the help of the only problem.
#[track_caller]
fn help(parsed: Result<Trial, ScenarioError>) -> String {
    let error = parsed.expect_err("it is broken");
    let [problem] = error.problems() else {
        panic!("{:?}", error.problems());
    };
    let help = miette::Diagnostic::help(problem);
    help.map(|help| help.to_string()).unwrap_or_default()
}

#[test]
fn what_is_no_limit_says_how_a_limit_is_written() {
    let place = "`expect.overshoot_percent` must be a table";
    let more = "[expect]\novershoot_percent = 1.5\n";
    check(more, 10, 21, place, "this is a number with a fraction");
    for (more, part) in [
        (more, "`overshoot_percent = { max = 1.5 }`"),
        (
            "[expect]\nsine_gain = \"0.9\"\n",
            "`{ min = 1.0 }` for at least",
        ),
        (&signal("stays = 3.0"), "`stays = { max = 3.0 }`"),
        (
            "[expect.timing]\nround_trip_microseconds = 500\n",
            "`round_trip_microseconds = { p99 = { max = 500 } }`",
        ),
        (
            "[expect.timing]\nround_trip_microseconds = { p99 = 500 }\n",
            "`p99 = { max = 500 }`",
        ),
        (
            "[expect]\nrecovers_within_seconds = { max = 1.0 }\n",
            "`recovers_within_seconds = 1.0`",
        ),
    ] {
        let help = help(parse(more));
        assert!(help.contains(part), "{more}{help}");
    }
    let bare = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 4.0\nexpect = 2\n[controller.pid]\n\
                [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
    let help = help(Trial::parse(bare, "t.toml", |_| unreachable!("no table")));
    assert!(help.contains("`overshoot_percent = { max = 2 }`"), "{help}");
}

#[test]
fn a_check_demands_something_that_can_be_met() {
    check(
        &signal(""),
        9,
        1,
        "nothing is demanded of `current_amperes`",
        "a demand is missing",
    );
    check(
        &signal("stays = {}"),
        11,
        9,
        "the limit `stays` is empty",
        "give min, max or both",
    );
    check(
        &signal("rate_per_second = { min = 2, max = 1 }"),
        11,
        19,
        "no value meets the limit `rate_per_second`",
        "min 2 is above max 1",
    );
    check(
        &(signal("stays = { min = 0 }") + &signal("stays = { max = 1 }")),
        14,
        9,
        "`stays` of `current_amperes` is demanded twice",
        "in the same window as before",
    );
}

#[test]
fn the_judgement_ends_within_the_run_and_behind_what_it_judges() {
    check(
        "[expect]\njudged_until_seconds = 4.5\n",
        10,
        24,
        "the judgement ends after the run",
        "the run ends at 4 s",
    );
    let step = "[[reference.step]]\nat_seconds = 2.0\nposition_millimetres = 20.0\n";
    let limit = "[expect]\njudged_until_seconds = 2.0\novershoot_percent = { max = 1.0 }\n";
    check(
        &format!("{step}{limit}"),
        14,
        21,
        "`overshoot_percent` cannot be judged",
        "needs a [[reference.step]] before judged_until_seconds = 2",
    );
    let later = limit.replace("2.0", "2.1");
    parse(&format!("{step}{later}")).unwrap();
}

#[test]
fn a_window_lies_within_the_run() {
    check(
        &signal("from_seconds = 4\nstays = { max = 1 }"),
        11,
        16,
        "the window is after the end of the run",
        "the run ends at 4 s",
    );
    check(
        &signal("from_seconds = 2\nuntil_seconds = 2\nstays = { max = 1 }"),
        12,
        17,
        "the window ends before it begins",
        "must be after 2 s",
    );
    check(
        &signal("until_seconds = 4.5\nreaches = { max = 1 }"),
        11,
        17,
        "the window ends after the run",
        "the run ends at 4 s",
    );
    check(
        "[[expect.sequence]]\nname = \"s\"\nfrom_seconds = 9\nevent = [{ text = \"x\" }]\n",
        11,
        16,
        "the window is after the end of the run",
        "the run ends at 4 s",
    );
}

#[test]
fn a_course_is_read_and_covers_its_window() {
    let follows = "follows = { file = \"golden.csv\", tolerance = 0.1 }";
    let scenario = parse(&signal(follows)).unwrap();
    let course = scenario.expect.signal[0].follows.as_ref().unwrap();
    assert_eq!(course.rows, [(0.5, 1.0), (1.5, 2.0)]);
    check(
        &signal(&format!("from_seconds = 0.2\n{follows}")),
        11,
        16,
        "the window begins before the course",
        "the course lasts from 0.5 to 1.5 s",
    );
    check(
        &signal(&format!("until_seconds = 3\n{follows}")),
        11,
        17,
        "the window ends after the course",
        "the course lasts from 0.5 to 1.5 s",
    );
    check(
        &signal(&format!("until_seconds = 0.4\n{follows}")),
        12,
        20,
        "the course lies outside the window",
        "the course lasts from 0.5 to 1.5 s",
    );
    check(
        &signal("follows = { file = \"other.csv\", tolerance = 0.1 }"),
        11,
        20,
        "the CSV file other.csv does not exist",
        "looked for beside the scenario",
    );
    check(
        &signal("follows = { file = \"locked.csv\", tolerance = 0.1 }"),
        11,
        20,
        "the CSV file locked.csv cannot be read",
        "permission denied",
    );
    check(
        &signal("follows = { file = \"../golden.csv\", tolerance = 0.1 }"),
        11,
        20,
        "a table must lie in the scenario's folder",
        "no absolute path, no `..`",
    );
    check(
        &signal("follows = { file = \"golden.csv\", tolerance = -1 }"),
        11,
        46,
        "`expect.signal.follows.tolerance` = -1 is out of range",
        "must be from 0 to 1000000000000",
    );
    let column = "follows = { file = \"golden.csv\", column = \"curent_amperes\", tolerance = 1 }";
    let error = parse(&signal(column)).unwrap_err();
    let [problem] = error.problems() else {
        panic!("{error:?}")
    };
    assert_eq!(problem.file_name(), "golden.csv");
    assert_eq!(
        problem.to_string(),
        "the table has no column `curent_amperes`, line 1"
    );
    assert!(format!("{problem:?}").contains("did you mean `current_amperes`?"));
}

#[test]
fn an_event_of_a_sequence_is_one_thing_and_has_a_time() {
    check(
        &sequence(""),
        11,
        9,
        "`expect.sequence.event` has 0 entries",
        "at least 1 is needed",
    );
    check(
        &sequence("{ within_milliseconds = 5 }"),
        11,
        10,
        "an event of a sequence is one of `emcy`, `text` and `signal`",
        "none is given",
    );
    check(
        &sequence("{ emcy = \"drive 0x8130\", text = \"loss\" }"),
        11,
        10,
        "an event of a sequence is one of `emcy`, `text` and `signal`",
        "more than one is given",
    );
    check(
        &sequence("{ emcy = \"drive 8130\" }"),
        11,
        19,
        "\"drive 8130\" names no emergency",
        "must be node and code",
    );
    check(
        &sequence("{ text = \"lo\\u001Bss\" }"),
        11,
        19,
        "`text` has a control character in it",
        "one line of plain text",
    );
    check(
        &sequence("{ signal = \"current_amperes\" }"),
        11,
        10,
        "a signal alone is no event",
        "`reaches` is missing",
    );
    check(
        &sequence("{ text = \"loss\", for_milliseconds = 3 }"),
        11,
        46,
        "`for_milliseconds` is for events of a signal",
        "`signal` is missing",
    );
    check(
        &sequence("{ text = \"loss\" }, { text = \"back\" }"),
        11,
        29,
        "event 2 of a sequence has no time limit",
        "`within_milliseconds` is missing",
    );
    let twice = sequence("{ text = \"loss\" }");
    check(
        &(twice.clone() + &twice),
        13,
        8,
        "there are two sequences \"s\"",
        "another name is needed",
    );
}

#[test]
fn a_misspelt_key_deep_in_a_sequence_is_underlined() {
    check(
        &sequence("{ text = \"loss\", witin_milliseconds = 3 }"),
        11,
        27,
        "unknown key `witin_milliseconds` in [[expect.sequence.event]]",
        "did you mean `within_milliseconds`?",
    );
}

#[test]
fn an_objection_is_underlined_beside_the_other_problems() {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 0\n[controller.open_loop]\n";
    let text = format!("{text}{}", signal("stays = { max = 1 }"));
    let objections = |scenario: &Trial| {
        let named = scenario.expect.named_signals();
        let objection = |(path, name): (String, &str)| Objection {
            path,
            message: format!("what is {name}?"),
            label: "here".to_owned(),
            help: Some("ask".to_owned()),
        };
        Vec::from_iter(named.map(objection))
    };
    let beside = Beside::new(Path::new("s.toml"));
    let asked = Asked {
        objections: Some(&objections),
        ..Asked::default()
    };
    let loaded = Scenario::parse(&beside, text, &mut |_| unreachable!("no table"), &asked);
    let error = loaded.unwrap_err();
    let found: Vec<_> = error
        .problems()
        .iter()
        .map(|problem| (problem.to_string(), problem.line_and_column().unwrap()))
        .collect();
    let expected = [
        ("`duration_seconds` = 0 is out of range".to_owned(), (4, 20)),
        ("what is current_amperes?".to_owned(), (7, 8)),
    ];
    // That the window is empty follows from the length of the run.
    assert_eq!(found, expected);
}

#[test]
fn requirements_are_of_demands_that_are_made() {
    let limits = "[expect]\ncurrent_amperes_rms = { max = 1 }\n";
    let with_requirement =
        |key: &str, list: &str| format!("{limits}[expect.requirements]\n{key} = {list}\n");
    check(
        &with_requirement("curent_amperes_rms", "[\"REQ-1\"]"),
        12,
        1,
        "`curent_amperes_rms` tests no requirement, since it has no limit",
        "did you mean `current_amperes_rms`?",
    );
    check(
        &with_requirement("safe_state", "[\"REQ-1\"]"),
        12,
        1,
        "`safe_state` tests no requirement, since it has no limit",
        "has no limit in [expect]",
    );
    check(
        &with_requirement("current_amperes_rms", "\"REQ-1\""),
        12,
        23,
        "`expect.requirements.current_amperes_rms` must be an array of strings",
        "this is a string",
    );
    check(
        &signal("stays = { max = 1 }\nrequirements = [\"REQ-1\", \"REQ-2\", \"REQ-1\"]"),
        12,
        35,
        "this is no name of a requirement",
        "it stands here already",
    );
    check(
        &signal("stays = { max = 1 }\nrequirements = [\" REQ-1\"]"),
        12,
        17,
        "this is no name of a requirement",
        "without blanks at its ends",
    );
    let met = with_requirement("current_amperes_rms", "[\"REQ-1\"]")
        + &signal("stays = { max = 1 }\nrequirements = [\"REQ-2\"]");
    let rows = parse(&met).unwrap().expected_rows().into_iter();
    let rows = Vec::from_iter(rows.map(|row| (row.name, row.requirements)));
    let expected = [
        ("current_amperes_rms".to_owned(), vec!["REQ-1".to_owned()]),
        ("current_amperes stays".to_owned(), vec!["REQ-2".to_owned()]),
    ];
    assert_eq!(rows, expected);
}

proptest! {
    #[test]
    fn arbitrary_courses_never_panic(rows in "([0-9.,eE+-]|\\n|nan|time_seconds|a){0,80}") {
        let _ = crate::table::parse_course("x.csv", &rows, ["a", ".a"]);
        let _ = crate::table::parse_command("x.csv", &rows, "a", &dbc::CommandRange::default());
        let _ = crate::table::parse_course("x.csv", &format!("a,time_seconds\n{rows}"), ["a", ".a"]);
    }
}
