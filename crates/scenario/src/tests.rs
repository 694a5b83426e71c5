//! Tests of the loader as a user meets it: files in, messages out.

use std::fs;
use std::path::{Path, PathBuf};

use miette::{GraphicalReportHandler, GraphicalTheme};
use proptest::prelude::*;

use crate::{ScenarioError, Trial};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios")
}

/// Returns the scenarios that ship, without those of several loops.
fn shipped() -> Vec<PathBuf> {
    let entries = fs::read_dir(folder()).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "toml")
            && ["sma_actuator", "dc_motor", "press"].iter().any(|rig| {
                let text = fs::read_to_string(path).unwrap();
                text.contains(&format!("\nrig = \"{rig}\"\n"))
            })
    });
    files.sort();
    files
}

fn render(error: &ScenarioError) -> String {
    let handler =
        GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor()).with_width(110);
    let mut text = String::new();
    handler.render_report(&mut text, error).unwrap();
    text.lines()
        .map(|line| format!("{}\n", line.trim_end()))
        .collect()
}

fn no_tables(_: &str) -> std::io::Result<String> {
    Err(std::io::Error::other("no such file"))
}

/// Returns the smallest valid scenario, with `more` behind it.
fn with(more: &str) -> String {
    format!("schema = 1\nrig = \"sma_actuator\"\nname = \"test\"\nduration_seconds = 12.0\n{more}")
}

const CLOSED: &str =
    "[controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";

#[track_caller]
fn check(text: &str, expected: &str) {
    let error = Trial::parse(text, "broken.toml", no_tables).expect_err("the scenario is broken");
    let rendered = render(&error);
    assert_eq!(rendered.trim(), expected.trim(), "\n{rendered}");
}

#[test]
fn a_misspelt_key_is_one_problem_with_the_right_name() {
    check(
        &with(CLOSED).replace("position_mil", "postion_mil"),
        "
  × unknown key `postion_millimetres` in [[reference.hold]]
   ╭─[broken.toml:8:1]
 7 │ at_seconds = 0.0
 8 │ postion_millimetres = 10.0
   · ─────────┬─────────
   ·          ╰── did you mean `position_millimetres`?
   ╰────
  help: known here: at_seconds, position_millimetres
",
    );
}

#[test]
fn several_problems_are_reported_together_in_the_order_of_the_file() {
    let text = with(CLOSED).replace("12.0", "0").replace("= 10.0", "= 75");
    check(
        &format!("{text}[expect]\novershoot_percent = {{ min = 2, max = 1 }}\n"),
        "
  × `broken.toml` is not a valid scenario: 3 problems

Error:
  × `duration_seconds` = 0 is out of range
   ╭─[broken.toml:4:20]
 3 │ name = \"test\"
 4 │ duration_seconds = 0
   ·                    ┬
   ·                    ╰── must be above 0, at most 604800
 5 │ [controller.pid]
   ╰────

Error:
  × `reference.hold.position_millimetres` = 75 is out of range
   ╭─[broken.toml:8:24]
 7 │ at_seconds = 0.0
 8 │ position_millimetres = 75
   ·                        ─┬
   ·                         ╰── must be from 0 to 60
 9 │ [expect]
   ╰────

Error:
  × no value meets the limit `overshoot_percent`
    ╭─[broken.toml:10:21]
  9 │ [expect]
 10 │ overshoot_percent = { min = 2, max = 1 }
    ·                     ──────────┬─────────
    ·                               ╰── min 2 is above max 1
    ╰────
",
    );
}

#[test]
fn a_syntax_error_underlines_where_the_reading_stopped() {
    check(
        &with("[controller.pid\n"),
        "
  × TOML syntax error
   ╭─[broken.toml:5:15]
 4 │ duration_seconds = 12.0
 5 │ [controller.pid
   ·               ▲
   ·               ╰── unclosed table, expected `]`
   ╰────
",
    );
}

#[test]
fn a_file_that_is_no_toml_is_one_problem() {
    let text = "# A page\n\nIt has words.\nAnd more of them.\n- and a list\n- of two\n";
    let error = Trial::parse(text, "page.md", no_tables).unwrap_err();
    assert_eq!(error.problems().len(), 1, "{:?}", error.problems());
    assert_eq!(error.problems()[0].line_and_column(), Some((3, 4)));
    assert!(render(&error).contains("3 more lines are no TOML"));
}

#[test]
fn a_loop_that_the_rig_lacks_is_one_problem() {
    let hold = "[[reference.hold]]\n";
    let text = with(CLOSED).replace(hold, &format!("{hold}loop = \"z\"\n"));
    let text = format!("{text}[expect]\novershoot_percent = {{ max = 3 }}\n");
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    let problems = Vec::from_iter(error.problems().iter().map(ToString::to_string));
    assert_eq!(problems, ["the rig has no loop `z`"]);
}

#[test]
fn a_length_that_is_none_is_one_problem() {
    let step = "[[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 12.0\n";
    let limit = "[expect]\nsettling_time_seconds = { max = 3 }\n";
    for length in ["0", "-3.0", "nan", "-inf"] {
        let text = with(CLOSED).replace("12.0\n", &format!("{length}\n"));
        let text = format!("{text}{step}{limit}");
        let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
        assert_eq!(
            error.problems().len(),
            1,
            "{length}: {:?}",
            error.problems()
        );
    }
}

#[test]
fn an_array_of_tables_written_as_a_table_says_how_to_write_it() {
    check(
        &with(CLOSED).replace("[[reference.hold]]", "[reference.hold]"),
        "
  × `reference.hold` must be an array of tables
   ╭─[broken.toml:6:1]
 5 │ [controller.pid]
 6 │ [reference.hold]
   · ────────┬───────
   ·         ╰── this is a table
 7 │ at_seconds = 0.0
   ╰────
  help: write it with double brackets: [[reference.hold]]
",
    );
}

#[test]
fn the_problem_of_a_table_points_into_the_table() {
    let text =
        with("[controller.pid]\n[[reference.table]]\nfrom_seconds = 0.0\nfile = \"wave.csv\"\n");
    let table = "time_seconds,position_millimetres\n0.0,10.0\n0.5, high\n";
    let error = Trial::parse(&text, "broken.toml", |_| Ok(table.to_owned())).unwrap_err();
    let expected = "
  × `broken.toml`: the table has no number in column position_millimetres, line 3
   ╭─[wave.csv:3:6]
 2 │ 0.0,10.0
 3 │ 0.5, high
   ·      ──┬─
   ·        ╰── not a finite number
   ╰────
";
    assert_eq!(
        render(&error).trim(),
        expected.trim(),
        "\n{}",
        render(&error)
    );
}

/// A way to break a file: the text, line and column of the underlined place, the message, and the label.
type Broken = (String, usize, usize, &'static str, &'static str);

#[track_caller]
fn check_broken<const N: usize>(cases: [Broken; N]) {
    for (text, line, column, message, label) in cases {
        let error = Trial::parse(&text, "broken.toml", no_tables).expect_err(message);
        let rendered = render(&error);
        let [problem] = error.problems() else {
            panic!("{rendered}");
        };
        assert_eq!(problem.to_string(), message, "{rendered}");
        assert!(
            rendered.contains(&format!("╰── {label}\n")),
            "expected label: {label}\n{rendered}"
        );
        assert_eq!(
            problem.line_and_column(),
            Some((line, column)),
            "{rendered}"
        );
    }
}

#[test]
fn a_key_of_the_wrong_type_or_length_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let change = |from: &str, to: &str| closed.replace(from, to);
    check_broken([
        (
            change("schema = 1", "schema = 2"),
            1,
            10,
            "`schema` = 2 is out of range",
            "must be 1",
        ),
        (
            change("\"test\"", "\"te\\u001Bst\""),
            3,
            8,
            "`name` has a control character in it",
            "one line of plain text",
        ),
        (
            change("schema = 1", "schema = 1.5"),
            1,
            10,
            "`schema` must be an integer",
            "this is a number with a fraction",
        ),
        (
            change("\"test\"", "\"\""),
            3,
            8,
            "`name` has 0 characters",
            "must have 1 to 200",
        ),
        (
            change("duration_seconds = 12.0\n", ""),
            1,
            1,
            "the scenario lacks the key `duration_seconds`",
            "`duration_seconds` is missing",
        ),
    ]);
}

#[test]
fn a_number_or_a_key_that_is_wrong_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let change = |from: &str, to: &str| closed.replace(from, to);
    check_broken([
        (
            change("= 10.0", "= \"10\""),
            8,
            24,
            "`reference.hold.position_millimetres` must be a number",
            "this is a string",
        ),
        (
            change("= 10.0", "= nan"),
            8,
            24,
            "`reference.hold.position_millimetres` must be finite",
            "not a finite number",
        ),
        (
            change("= 10.0", "= -inf"),
            8,
            24,
            "`reference.hold.position_millimetres` must be finite",
            "not a finite number",
        ),
        (
            change("= 10.0", "= 1e999"),
            8,
            24,
            "`reference.hold.position_millimetres` must be finite",
            "not a finite number",
        ),
        (
            change("= 10.0", "= 99999999999999999999"),
            8,
            24,
            "`reference.hold.position_millimetres` is too large",
            "does not fit a number",
        ),
        (
            change("position_millimetres = 10.0\n", ""),
            6,
            1,
            "[[reference.hold]] lacks the key `position_millimetres`",
            "`position_millimetres` is missing",
        ),
        (
            change("[controller.pid]", "[controler.pid]\n[controller.pid]"),
            5,
            2,
            "unknown key `controler` in the scenario",
            "did you mean `controller`?",
        ),
    ]);
}

#[test]
fn a_law_or_a_set_point_that_is_wrong_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let change = |from: &str, to: &str| closed.replace(from, to);
    let more = |text: &str| format!("{closed}{text}");
    let step = "[[reference.step]]\nat_seconds = 5.0\nposition_millimetres = 20.0\n";
    check_broken([
        (
            change("[controller.pid]", "[controller]"),
            5,
            2,
            "no control law",
            "name the law: [controller.sliding_mode], [controller.pid]",
        ),
        (
            change(
                "[controller.pid]",
                "[controller.pid]\n[controller.open_loop]",
            ),
            6,
            13,
            "more than one control law",
            "the second law",
        ),
        (
            with("[controller.pid]\n"),
            5,
            13,
            "the closed loop `pid` has no set-point",
            "needs one to follow",
        ),
        (
            more(&format!("{step}{step}")),
            13,
            14,
            "times of [[reference.step]] are out of order",
            "must be after 5 s, where the one before starts",
        ),
        (
            more(&step.replace("5.0", "0")),
            10,
            14,
            "two pieces of [reference] start at 0 s",
            "a hold starts at the same time",
        ),
        (
            more(&step.replace("5.0", "12.0")),
            10,
            14,
            "[[reference.step]] starts after the end of the run",
            "the run ends at 12 s",
        ),
    ]);
}

#[test]
fn a_piece_of_the_set_point_that_is_wrong_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let more = |text: &str| format!("{closed}{text}");
    check_broken([
        (
            more(
                "[[reference.ramp]]\nfrom_seconds = 3\nuntil_seconds = 3\nposition_millimetres = 1\n",
            ),
            11,
            17,
            "[[reference.ramp]] ends before it begins",
            "must be after 3 s",
        ),
        (
            more(
                "[[reference.sine]]\nfrom_seconds = 3\ncentre_millimetres = 55\namplitude_millimetres = 10\nperiod_seconds = 1\n",
            ),
            12,
            25,
            "the sine leaves the travel of 0 to 60 mm",
            "goes from 45 to 65 mm",
        ),
        (
            more(
                "[[reference.chirp]]\nfrom_seconds = 3\nuntil_seconds = 4\ncentre_millimetres = 55\namplitude_millimetres = 10\n\
                 from_hertz = 1\nuntil_hertz = 2\n",
            ),
            13,
            25,
            "the chirp leaves the travel of 0 to 60 mm",
            "goes from 45 to 65 mm",
        ),
        (
            more(
                "[[reference.chirp]]\nfrom_seconds = 3\nuntil_seconds = 4\ncentre_millimetres = 25\namplitude_millimetres = 10\n\
                 from_hertz = 1\nuntil_hertz = 1\n",
            ),
            15,
            15,
            "the frequency of the chirp does not move",
            "the same as from_hertz; [[reference.sine]] has one frequency",
        ),
        (
            with("[[controller.open_loop.table]]\nfrom_seconds = 0\nfile = \"/x.csv\"\n"),
            7,
            8,
            "a table must lie in the scenario's folder",
            "no absolute path, no `..`",
        ),
        (
            more("[[reference.table]]\nfrom_seconds = 3\nfile = \"../x.csv\"\n"),
            11,
            8,
            "a table must lie in the scenario's folder",
            "no absolute path, no `..`",
        ),
        (
            more("[[reference.table]]\nfrom_seconds = 3\nfile = \"x.csv\"\n"),
            11,
            8,
            "the CSV file x.csv cannot be read",
            "no such file",
        ),
        (
            with("[[controller.open_loop.step]]\nat_seconds = 1\ncurrent_amperes = 1.5\n"),
            7,
            19,
            "`controller.open_loop.step.current_amperes` = 1.5 is out of range",
            "must be from 0 to 1",
        ),
    ]);
}

#[test]
fn a_limit_or_a_bus_that_is_wrong_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let more = |text: &str| format!("{closed}{text}");
    check_broken([
        (
            more("[expect]\ncurrent_amperes_rms = {}\n"),
            10,
            23,
            "the limit `current_amperes_rms` is empty",
            "give min, max or both",
        ),
        (
            more("[expect]\ncurrent_amperes_rms = { min = 1.0, max = 0.5 }\n"),
            10,
            23,
            "no value meets the limit `current_amperes_rms`",
            "min 1 is above max 0.5",
        ),
        (
            more("[expect]\nsettling_time_seconds = { max = 0.5 }\n"),
            10,
            25,
            "`settling_time_seconds` cannot be judged",
            "needs a [[reference.step]]",
        ),
        (
            more("[expect]\nrecovery_time_seconds = { max = 0.5 }\n"),
            10,
            25,
            "`recovery_time_seconds` cannot be judged",
            "needs a [[disturbance.…]]",
        ),
        (
            more("[bus]\nbitrate_kilobits_per_second = 300\n"),
            10,
            31,
            "`bus.bitrate_kilobits_per_second` = 300 is out of range",
            "must be one of: 10, 20, 50, 125, 250, 500, 800, 1000",
        ),
        (
            more("[bus]\nsync_period_milliseconds = 0.25\n"),
            10,
            28,
            "`bus.sync_period_milliseconds` = 0.25 is out of range",
            "must be a multiple of 0.1",
        ),
    ]);
}

#[test]
fn a_plant_or_a_disturbance_that_is_wrong_has_its_place_and_its_words() {
    let closed = with(CLOSED);
    let more = |text: &str| format!("{closed}{text}");
    check_broken([
        (
            more("[plant.wire.mechanics]\nstress_strain = \"ful\"\n"),
            10,
            17,
            "`plant.wire.mechanics.stress_strain` cannot be \"ful\"",
            "must be one of: austenite_only, full",
        ),
        (
            more("[plant.wire.phase]\naustenite_finish_celsius = 50.0\n"),
            10,
            28,
            "`austenite_finish_celsius` must be above `austenite_start_celsius`",
            "must be above 53",
        ),
        (
            more(
                "[plant.wire]\nkinetics = \"preisach\"\n[plant.wire.heat]\nambient_celsius = 34.5\n",
            ),
            12,
            19,
            "`ambient_celsius` must not be above `martensite_finish_celsius`",
            "must be at most 34",
        ),
        (
            more("[plant.wire]\nkinetics = \"nested\"\nheat = { cooling_element_celsius = 35 }\n"),
            11,
            36,
            "`cooling_element_celsius` must not be above `martensite_finish_celsius`",
            "must be at most 34",
        ),
        (
            more("[plant.wire]\nkinetics = \"neste\"\n"),
            10,
            12,
            "`plant.wire.kinetics` cannot be \"neste\"",
            "must be one of: paper, nested, preisach",
        ),
        (
            more("[plant.wire]\nheat = 3\n"),
            10,
            8,
            "`plant.wire.heat` must be a table",
            "this is an integer",
        ),
        (
            more(
                "[[disturbance.fan]]\nfrom_seconds = 1\nuntil_seconds = 3\nconvection_factor = 5\n[[disturbance.fan]]\nfrom_seconds = 2\nuntil_seconds = 4\nconvection_factor = 5\n",
            ),
            14,
            16,
            "two fans blow at a time",
            "the one before blows until 3 s",
        ),
        (
            more(
                "[[disturbance.fan]]\nfrom_seconds = 1\nuntil_seconds = 2\nconvection_factor = 5\n[[disturbance.fan]]\nnode = \"drive\"\nfrom_seconds = 2\nuntil_seconds = 4\nconvection_factor = 5\n",
            ),
            13,
            1,
            "no io node has a fan at this plant",
            "its outputs have no `convection_factor`",
        ),
        (
            more("[[disturbance.load]]\nat_seconds = 1\nadded_grams = -40\n"),
            11,
            15,
            "nothing is left of the load",
            "must leave something of 40 g",
        ),
    ]);
}

#[test]
fn a_wire_without_a_memory_may_be_warm_and_no_controller_knows_which_has_one() {
    let wire = |text: &str| {
        let text = format!("{}[plant.wire]\n{text}", with(CLOSED));
        let trial = Trial::parse(&text, "wire.toml", no_tables)
            .unwrap_or_else(|error| panic!("{}", render(&error)));
        assert!(trial.plant().actuator().is_some());
        trial.controller_view()
    };
    let paper = wire("heat = { ambient_celsius = 60.0, cooling_element_celsius = 60.0 }\n");
    for kinetics in ["paper", "nested", "preisach"] {
        assert_eq!(wire(&format!("kinetics = \"{kinetics}\"\n")), paper);
    }
}

#[test]
fn every_problem_of_a_table_has_its_line() {
    let header = "time_seconds,position_millimetres\n";
    let cases = [
        ("", 1, 1, "the table has the wrong header, line 1"),
        ("t,x\n0,1\n", 1, 1, "the table has the wrong header, line 1"),
        ("HEAD", 1, 1, "the table has no rows, line 1"),
        (
            "HEAD0,1\n1,2,3\n",
            3,
            1,
            "the table has a row with the wrong number of columns, line 3",
        ),
        (
            "HEAD0,1\n1,\n",
            3,
            3,
            "the table has no number in column position_millimetres, line 3",
        ),
        (
            "HEAD0,1\nNaN,2\n",
            3,
            1,
            "the table has no number in column time_seconds, line 3",
        ),
        (
            "HEAD0,1\n0,2\n",
            3,
            1,
            "the table has times out of order in column time_seconds, line 3",
        ),
        (
            "HEAD-1,1\n",
            2,
            1,
            "the table has times out of order in column time_seconds, line 2",
        ),
        (
            "HEAD0,60.5\n",
            2,
            3,
            "the table leaves the travel in column position_millimetres, line 2",
        ),
    ];
    for (text, line, column, message) in cases {
        let problem = parse_table(&text.replace("HEAD", header)).unwrap_err();
        assert_eq!(problem.to_string(), message);
        assert_eq!(problem.line_and_column(), Some((line, column)), "{message}");
        assert_eq!(problem.file_name(), "x.csv");
    }
    let rows = parse_table("\u{feff}time_seconds, position_millimetres\r\n0, 1\r\n\r\n2,3.5\r\n");
    assert_eq!(rows.unwrap(), [(0.0, 1.0), (2.0, 3.5)]);
}

#[test]
fn a_recorded_current_is_one_column_of_many() {
    let text = with("[[controller.open_loop.table]]\nfrom_seconds = 1.0\nfile = \"run.csv\"\n");
    let parse = |table: &'static str| Trial::parse(&text, "x.toml", |_| Ok(table.to_owned()));
    let scenario =
        parse("cycle,time_seconds,current_amperes,note\n0,0,0.5,a\n1,0.1,,b\n2,0.2,0.7,\n")
            .unwrap();
    let current = |time| {
        scenario
            .controller
            .open_loop
            .as_ref()
            .unwrap()
            .profile()
            .at(time)
            .position
    };
    assert_eq!([current(0.9), current(1.0), current(9.0)], [0.0, 0.5, 0.7]);
    assert!((current(1.1) - 0.6).abs() < 1e-12);
    for (table, message) in [
        (
            "time_seconds,position_millimetres\n0,1\n",
            "the table has no column `current_amperes`, line 1",
        ),
        (
            "time_seconds,current_amperes\n0,0.5\n1,-0.1\n",
            "the table leaves the range of the amplifier in column current_amperes, line 3",
        ),
        (
            "time_seconds,current_amperes\n0,much\n",
            "the table has no number in column current_amperes, line 2",
        ),
        (
            "time_seconds,current_amperes\n0,\n",
            "the table has no rows, line 1",
        ),
    ] {
        let error = parse(table).unwrap_err();
        assert_eq!(error.problems()[0].to_string(), message);
    }
    let column = text.replace("file =", "column = \"target_current_amperes\"\nfile =");
    let table = "time_seconds,current_amperes,target_current_amperes\n0,0.1,0.2\n";
    let scenario = Trial::parse(&column, "x.toml", |_| Ok(table.to_owned())).unwrap();
    let open_loop = scenario.controller.open_loop.unwrap();
    assert_eq!(open_loop.profile().at(1.0).position, 0.2);
}

#[test]
fn a_nominal_model_in_a_file_takes_the_place_of_the_table() {
    let text = with(
        "[controller.sliding_mode]\nnominal_model_file = \"model.toml\"\n\
         [controller.sliding_mode.nominal_model]\nload_kilograms = 0.05\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 1.0\n",
    );
    let parse = |file: &str| Trial::parse(&text, "x.toml", |_| Ok(file.to_owned()));
    let model = crate::controller::NominalModel {
        load_kilograms: 0.03,
        ..Default::default()
    };
    let file = model.to_file_text().unwrap();
    let scenario = parse(&file).unwrap();
    assert_eq!(
        scenario
            .controller
            .sliding_mode
            .as_ref()
            .unwrap()
            .nominal_model,
        model
    );
    for (file, message) in [
        (
            "[nominal_model]\nload = 1\n",
            "unknown key `load` in [nominal_model]",
        ),
        (
            "[nominal_model]\nload_kilograms = 0\n",
            "`nominal_model.load_kilograms` = 0 is out of range",
        ),
    ] {
        let error = parse(file).unwrap_err();
        assert_eq!(error.problems()[0].to_string(), message);
        assert_eq!(error.problems()[0].file_name(), "model.toml");
    }
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    assert_eq!(error.problems()[0].line_and_column().unwrap().0, 6);
}

#[test]
fn files_and_tables_are_read_within_bounds() {
    let folder = std::env::temp_dir().join(format!("canrig-scenario-{}", std::process::id()));
    let inside = folder.join("inside");
    fs::create_dir_all(&inside).unwrap();
    let path = inside.join("s.toml");
    let text =
        with("[controller.pid]\n[[reference.table]]\nfrom_seconds = 0.0\nfile = \"wave.csv\"\n");
    fs::write(&path, &text).unwrap();
    fs::write(
        inside.join("wave.csv"),
        "time_seconds,position_millimetres\n0,1\n2,3\n",
    )
    .unwrap();
    let scenario = Trial::load(&path).unwrap();
    assert_eq!(scenario.reference.trajectory().at(1.0).position, 2.0);

    fs::write(
        folder.join("secret.csv"),
        "time_seconds,position_millimetres\n0,1\n",
    )
    .unwrap();
    fs::remove_file(inside.join("wave.csv")).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.join("secret.csv"), inside.join("wave.csv")).unwrap();
        let error = Trial::load(&path).unwrap_err();
        assert!(
            render(&error).contains("it lies outside the scenario's folder"),
            "{}",
            render(&error)
        );
    }

    fs::write(&path, "#".repeat((1 << 20) + 1)).unwrap();
    let error = Trial::load(&path).unwrap_err();
    assert_eq!(
        error.problems()[0].to_string(),
        "it is longer than 1048576 bytes"
    );
    fs::write(&path, [0xFF, 0xFE]).unwrap();
    assert!(
        Trial::load(&path).unwrap_err().problems()[0]
            .to_string()
            .contains("UTF-8")
    );
    assert!(Trial::load(&folder).is_err());
    let error = Trial::load(&folder.join("missing.toml")).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("missing.toml` cannot be read: there is no such file"),
        "{error}"
    );
    assert_eq!(error.problems()[0].to_string(), "there is no such file");
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_table_that_stands_twice_is_one_problem_that_names_both_places() {
    let pid = "[controller.pid]\nset_point_weight = 0.4\nproportional_amperes_per_metre = 20.0\n";
    let text = with(&format!("{pid}\n# Again.\n{pid}\n[plant]\n[bus]\n"));
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    let [problem] = error.problems() else {
        panic!("{:?}", error.problems());
    };
    assert_eq!(problem.to_string(), "[controller.pid] stands twice");
    assert_eq!(problem.line_and_column(), Some((10, 13)));
    let rendered = render(&error);
    for label in ["here for the first time", "for the second time"] {
        assert!(rendered.contains(label), "{rendered}");
    }
    // A key outside such a table is a separate problem.
    let text = with("[bus]\nx = 1\n[bus]\nx = 1\n[plant]\na = 1\na = 2\n");
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    let problems: Vec<_> = error.problems().iter().map(ToString::to_string).collect();
    assert_eq!(problems, ["[bus] stands twice", "TOML syntax error"]);
}

#[test]
fn two_laws_are_one_problem_that_names_both() {
    let text = with("[controller.pid]\n[controller.open_loop]\n");
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    assert_eq!(error.problems().len(), 1);
    let rendered = render(&error);
    for label in ["the first law", "the second law"] {
        assert!(rendered.contains(label), "{rendered}");
    }
}

#[test]
fn more_problems_than_fit_are_counted() {
    let text = with(CLOSED) + &"[[reference.step]]\nx = 1\n".repeat(100);
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    assert_eq!(error.problems().len(), 50);
    assert_eq!(
        error.to_string(),
        "`x.toml` is not a valid scenario: 300 problems, the first 50 of them"
    );
    let text = with(CLOSED) + &"[[reference.step]]\n".repeat(10_001);
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    assert_eq!(
        error.problems()[0].to_string(),
        "`reference.step` has 10001 entries"
    );
}

#[test]
fn deep_nesting_is_an_error_not_a_stack_overflow() {
    let text = with(&format!("x = {}", "[".repeat(100_000)));
    assert!(Trial::parse(&text, "x.toml", no_tables).is_err());
    let text = with(&format!("{} = 1", vec!["a"; 100_000].join(".")));
    assert!(Trial::parse(&text, "x.toml", no_tables).is_err());
}

#[test]
fn a_place_in_an_endless_line_is_numbered_instead_of_underlined() {
    let text = with(&format!("x = {}", "[".repeat(100_000)));
    let error = Trial::parse(&text, "x.toml", no_tables).unwrap_err();
    let rendered = render(&error);
    assert!(rendered.len() < 5000, "{rendered}");
    assert!(rendered.contains("column 85"), "{rendered}");
    assert!(error.problems()[0].line_and_column().is_some());
}

#[test]
fn all_shipped_scenarios_load_and_name_their_schema() {
    assert!(shipped().len() >= 8);
    for path in shipped() {
        Trial::load(&path).unwrap_or_else(|error| panic!("{}", render(&error)));
        let text = fs::read_to_string(&path).unwrap();
        assert!(
            text.starts_with("#:schema ./schema.json\n"),
            "{}",
            path.display()
        );
    }
}

#[test]
fn all_shipped_rigs_name_their_schema() {
    for name in crate::rig::shipped::names() {
        let text = crate::rig::shipped::text(name).unwrap();
        assert!(text.starts_with("#:schema ../rig_schema.json\n"), "{name}");
    }
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,400}") {
        let _ = Trial::parse(&text, "x.toml", no_tables);
        let _ = parse_table(&text);
    }

    #[test]
    fn a_valid_file_with_a_part_replaced_never_panics(
        file in any::<prop::sample::Index>(),
        at in any::<prop::sample::Index>(),
        length in 0_usize..40,
        by in "([a-z_=. \\n\\[\\]{}\"0-9é-]|nan|inf|-1|1e400|true){0,12}",
    ) {
        let files = shipped();
        let text: Vec<char> = fs::read_to_string(&files[file.index(files.len())]).unwrap().chars().collect();
        let at = at.index(text.len());
        let end = (at + length).min(text.len());
        let text: String = text[..at].iter().copied().chain(by.chars()).chain(text[end..].iter().copied()).collect();
        if let Err(error) = Trial::parse(&text, "x.toml", no_tables) {
            prop_assert!(!error.problems().is_empty());
            prop_assert!(error.problems().iter().all(|problem| problem.line_and_column().is_some()));
            render(&error);
        }
    }

    #[test]
    fn arbitrary_rows_never_panic(rows in "([0-9.,eE+-]|\\n|nan){0,80}") {
        let _ = parse_table(&format!("time_seconds,position_millimetres\n{rows}"));
    }
}

#[test]
fn a_law_in_capital_letters_is_known_by_its_nearest_name() {
    let text = with(CLOSED).replace("[controller.pid]", "[controller.PID]");
    let error = Trial::parse(&text, "broken.toml", no_tables).unwrap_err();
    assert!(
        render(&error).contains("did you mean `pid`?"),
        "{}",
        render(&error)
    );
}

#[test]
fn one_kind_of_file_is_not_taken_for_the_other() {
    let rig = crate::rig::shipped::text("sma_actuator").unwrap();
    let error = Trial::parse(rig, "rig.toml", no_tables).unwrap_err();
    assert_eq!(error.problems().len(), 1, "{}", render(&error));
    assert!(render(&error).contains("this is a rig file, not a scenario"));
    let error = crate::rig::nodes::Rig::parse(&with(CLOSED), "step.toml").unwrap_err();
    assert_eq!(error.problems().len(), 1, "{}", render(&error));
    assert!(render(&error).contains("this is a scenario, not a rig file"));
}

fn parse_table(text: &str) -> Result<Vec<(f64, f64)>, crate::Problem> {
    crate::table::parse("x.csv", text, &crate::wiring::Wiring::default())
}
