//! Tests of `[sweep]` in the loader.

use crate::check::tests::{check, parse, resolved};

fn swept(entry: &str) -> String {
    format!("[sweep]\n{entry}\n")
}

#[test]
fn the_keys_of_a_sweep_are_numbers_of_the_scenario() {
    check(
        &swept("[[sweep.list]]\nkey = \"plant.wire.mechanics.lod_kilograms\"\nvalues = [1.0]"),
        11,
        29,
        "`plant.wire.mechanics.lod_kilograms` is no number of this scenario",
        "did you mean `plant.wire.mechanics.load_kilograms`?",
    );
    // The cases: a path that is forgotten, an entry that does not exist, another law, a key that is no number.
    for (key, column, label) in [
        (
            "load_kilograms",
            8,
            "did you mean `plant.wire.mechanics.load_kilograms`?",
        ),
        (
            "reference.hold[1].position_millimetres",
            23,
            "did you mean `reference.hold[0].position_millimetres`?",
        ),
        ("controller.sliding_mode.boundary_layer", 19, ""),
        ("name", 8, ""),
        ("expect.signal[0].from_seconds", 15, ""),
        ("", 8, ""),
    ] {
        let message = match key {
            "" => "`sweep.list.key` has 0 characters".to_owned(),
            key => format!("`{key}` is no number of this scenario"),
        };
        let entry = format!("[[sweep.list]]\nkey = \"{key}\"\nvalues = [1.0]");
        let error = parse(&swept(&entry)).unwrap_err();
        let problem = &error.problems()[0];
        assert_eq!(problem.to_string(), message);
        let place = if key.is_empty() { 7 } else { column };
        assert_eq!(problem.line_and_column(), Some((11, place)), "{key}");
        assert!(format!("{problem:?}").contains(label), "{problem:?}");
    }
}

#[test]
fn a_sweep_that_cannot_be_read_hides_no_other_problem() {
    let late = "[[reference.step]]\nat_seconds = 9.0\nposition_millimetres = 5.0\n";
    let error = parse(&(late.to_owned() + &swept("draws = true"))).unwrap_err();
    let problems = error.problems().iter().map(ToString::to_string);
    assert_eq!(
        Vec::from_iter(problems),
        [
            "[[reference.step]] starts after the end of the run",
            "`sweep.draws` must be an integer",
        ]
    );
}

#[test]
fn a_key_of_another_plant_is_refused_with_the_nearest_of_this_one() {
    let swept =
        |key: &str| format!("[sweep]\n[[sweep.list]]\nkey = \"{key}\"\nvalues = [0.3, 0.4]\n");
    check(
        &swept("plant.motor.load_kilograms"),
        11,
        14,
        "`plant.motor.load_kilograms` is no number of this scenario",
        "did you mean `plant.wire.mechanics.load_kilograms`?",
    );
    assert!(parse(&swept("plant.wire.mechanics.load_kilograms")).is_ok());
    assert!(parse(&swept("node.drive.sensor.noise_rms")).is_ok());
}

const NOISE: &str = "key = \"node.drive.sensor.noise_rms\"";
const BITS: &str = "key = \"node.drive.sensor.resolution_bits\"";
const BITRATE: &str = "key = \"bus.bitrate_kilobits_per_second\"";

/// Checks entries of a sweep: the line and column of the underlined place, and parts of the message.
#[track_caller]
fn check_entries<const N: usize>(cases: [(String, usize, usize, &str); N]) {
    for (entry, line, column, message) in cases {
        let error = parse(&swept(&entry)).expect_err(&entry);
        let problem = &error.problems()[0];
        assert_eq!(
            problem.line_and_column(),
            Some((line, column)),
            "{entry}: {problem:?}"
        );
        assert!(
            format!("{problem:?}").contains(message),
            "{entry}: {problem:?}"
        );
    }
}

#[test]
fn the_values_of_lists_and_ranges_are_those_that_the_key_admits() {
    check_entries([
        (
            format!("[[sweep.list]]\n{NOISE}\nvalues = [0.1, -1.0]"),
            12,
            16,
            "out of range",
        ),
        (
            format!("[[sweep.list]]\n{NOISE}\nvalues = [0.1, 0.1]"),
            12,
            16,
            "0.1 is listed twice",
        ),
        (
            format!("[[sweep.list]]\n{NOISE}\nvalues = []"),
            12,
            10,
            "at least 1 is needed",
        ),
        (
            format!("[[sweep.list]]\n{NOISE}\nvalues = 1"),
            12,
            10,
            "must be an array of numbers",
        ),
        (
            format!("[[sweep.list]]\n{BITS}\nvalues = [8, 9.5]"),
            12,
            14,
            "must be an integer",
        ),
        (
            format!("[[sweep.range]]\n{BITS}\nfrom = 8\nto = 11\ncount = 3"),
            10,
            1,
            "must be an integer",
        ),
        (
            format!("[[sweep.range]]\n{NOISE}\nfrom = 1\nto = 0\ncount = 3"),
            13,
            6,
            "must be above 1",
        ),
        (
            format!("[[sweep.range]]\n{NOISE}\nfrom = 0\nto = 1"),
            10,
            1,
            "either `count` or `step`",
        ),
        (
            format!(
                "[[sweep.range]]\n{NOISE}\nfrom = 0\nto = 1\ncount = 3\nspacing = \"logarithmic\""
            ),
            12,
            8,
            "must be above 0",
        ),
    ]);
}

#[test]
fn the_values_that_are_drawn_are_those_that_the_key_admits() {
    check_entries([
        (
            format!("draws = 3\n[[sweep.uniform]]\n{BITRATE}\nfrom = 10\nto = 1000"),
            12,
            7,
            "use [[sweep.list]]",
        ),
        (
            format!("draws = 3\n[[sweep.uniform]]\n{NOISE}\nfrom = -1\nto = 1"),
            13,
            8,
            "out of range",
        ),
        (
            format!("draws = 3\n[[sweep.normal]]\n{NOISE}\nmean = -1\nstandard_deviation = 1"),
            13,
            8,
            "out of range",
        ),
    ]);
}

#[test]
fn a_sweep_varies_something_and_each_key_once() {
    check_entries([
        (
            format!("[[sweep.uniform]]\n{NOISE}\nfrom = 0\nto = 1"),
            9,
            2,
            "lacks the key `draws`",
        ),
        (
            format!("draws = 3\n[[sweep.list]]\n{NOISE}\nvalues = [1]"),
            9,
            2,
            "nothing is drawn",
        ),
        ("seed = 1".to_owned(), 9, 2, "varies nothing"),
        (
            format!(
                "[[sweep.list]]\n{NOISE}\nvalues = [0.1]\n[[sweep.list]]\n{NOISE}\nvalues = [0.1]"
            ),
            14,
            7,
            "varied twice",
        ),
        (
            format!(
                "draws = 1000000\n[[sweep.uniform]]\n{NOISE}\nfrom = 0\nto = 1\n[[sweep.list]]\nkey = \"seed\"\nvalues = [1, 2]"
            ),
            9,
            2,
            "has 2000000 runs",
        ),
    ]);
}

#[test]
fn a_sweep_knows_which_keys_take_whole_numbers() {
    let entries = "draws = 2\n[[sweep.uniform]]\nkey = \"seed\"\nfrom = 0\nto = 9\n\
        [[sweep.range]]\nkey = \"node.drive.sensor.resolution_bits\"\nfrom = 8\nto = 10\nstep = 1\n\
        [[sweep.list]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nvalues = [0.03, 0.04]";
    let sweep = resolved(&swept(entries)).unwrap().shared.sweep.unwrap();
    assert!(
        sweep
            .whole_numbers
            .iter()
            .eq(["node.drive.sensor.resolution_bits", "seed"])
    );
    assert_eq!(sweep.runs(), 2 * 3 * 2);
}

#[test]
fn a_sweep_without_end_is_refused_at_once() {
    let range = "[[sweep.range]]\nkey = \"seed\"\nfrom = 0\nto = 1e15\nstep = 1e-3\n";
    let error = parse(&swept(&range.repeat(100))).unwrap_err();
    let problem = &error.problems()[0];
    assert!(problem.to_string().contains("runs"), "{problem:?}");
}
