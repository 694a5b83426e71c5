//! The paper's experiments, with reduced counts. `tests/system/test_pages.py` tests the page in a browser.

use std::fs;

use crate::report::elements;
use crate::support::{canrig, only_run, output};

/// Required headlines: the quantity and its run.
const HEADLINES: [(&str, &str); 9] = [
    ("settling_time_seconds", "sliding_mode_paper"),
    ("settling_time_seconds", "sliding_mode, another plant"),
    ("settling_time_seconds", "thermoelectric element"),
    ("times_down_without_by_with", "both"),
    (
        "tracking_error_millimetres_rms",
        "sliding_mode, another plant",
    ),
    ("bandwidth_hertz", "sliding_mode, another plant"),
    (
        "maximum_deviation_millimetres",
        "sliding_mode, another plant",
    ),
    ("settling_time_seconds_p95", "sliding_mode_paper, 12 plants"),
    ("conduction_watts_per_metre_kelvin", "from the ramp alone"),
];

/// Every experiment with its smallest number of runs, numbers and figures.
const EXPERIMENTS: [(&str, usize, usize, usize); 21] = [
    ("hysteresis", 1, 2, 1),
    ("martensite", 0, 0, 1),
    ("identification", 2, 22, 3),
    ("step_down", 4, 8, 2),
    ("cooling", 8, 4, 2),
    ("step", 4, 11, 2),
    ("step_cold", 4, 11, 2),
    ("sine_20s", 4, 4, 2),
    ("sine_5s", 4, 4, 2),
    ("bandwidth", 16, 12, 3),
    ("infeasible", 4, 8, 2),
    ("fan", 7, 11, 2),
    ("load", 4, 9, 2),
    ("ripple", 16, 16, 0),
    ("robustness", 48, 16, 6),
    ("other_truth", 4, 10, 2),
    ("cycle_time", 8, 0, 0),
    ("resolution", 8, 0, 0),
    ("noise", 8, 0, 0),
    ("launch", 6, 0, 0),
    ("reference_filter", 5, 0, 2),
];

#[test]
fn every_experiment_is_played_and_every_target_is_met() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) =
        output(canrig(folder.path(), "reproduce").args(["--reduced", "--json"]));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let reproduction: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(reproduction["passed"], true);
    let found = reproduction["experiments"].as_array().unwrap();
    let ids: Vec<_> = found
        .iter()
        .map(|experiment| experiment["id"].as_str().unwrap())
        .collect();
    assert_eq!(ids, EXPERIMENTS.map(|(id, ..)| id));

    let run = only_run(folder.path());
    assert_eq!(
        fs::read_to_string(run.join("reproduction.json")).unwrap(),
        stdout
    );
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    let sections: Vec<&str> = page.split("<h2 id=").skip(1).collect();
    assert_eq!(sections.len(), EXPERIMENTS.len());
    for ((id, runs, numbers, figures), (experiment, section)) in
        EXPERIMENTS.into_iter().zip(found.iter().zip(sections))
    {
        assert!(section.starts_with(&format!("\"{id}\"")), "{id}");
        assert!(
            experiment["runs"].as_u64().unwrap() >= runs as u64,
            "{experiment}"
        );
        assert!(
            experiment["numbers"].as_array().unwrap().len() >= numbers,
            "{experiment}"
        );
        for number in experiment["numbers"].as_array().unwrap() {
            assert!(number["of"].is_string() && number["metric"]["name"].is_string());
        }
        assert_eq!(section.matches("<svg").count(), figures, "{id}");
        assert!(section.contains("<tbody>") || numbers == 0, "{id}");
    }
    let summary = page.split("<h2 id=").next().unwrap().replace("<wbr>", "");
    for (name, of) in HEADLINES {
        let row = format!("{name}</td><td data-name=\"of\">{of}</td>");
        assert!(summary.contains(&row), "{row}");
    }
    // A law that knows its plant exactly is marked so, and the same law on another plant is marked otherwise.
    let models = |of: &str| {
        let numbers = found
            .iter()
            .flat_map(|one| one["numbers"].as_array().unwrap());
        let same = numbers.filter(|number| number["of"] == of);
        same.map(|number| number["model"].as_str().unwrap_or_default().to_owned())
            .collect::<std::collections::BTreeSet<_>>()
    };
    assert!(models("sliding_mode, another plant").iter().eq(["differs"]));
    assert!(models("pid").iter().eq([""]));
    assert!(models("sliding_mode").contains("equals_the_plant"));
    let shown = elements(&page);
    assert!(!shown.contains("NaN") && !shown.contains("inf\""));
}
