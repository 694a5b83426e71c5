//! The paper's experiments, with reduced counts. What a browser shows of the page is looked at in `tests/browser`.

use std::fs;

use crate::support::{canrig, only_run, output};

/// Every experiment with the fewest runs, numbers and figures that it must have.
const EXPERIMENTS: [(&str, usize, usize, usize); 17] = [
    ("hysteresis", 1, 4, 1),
    ("martensite", 0, 1, 1),
    ("identification", 2, 12, 3),
    ("step", 3, 8, 2),
    ("step_cold", 3, 8, 2),
    ("sine_20s", 3, 3, 2),
    ("sine_5s", 3, 3, 2),
    ("bandwidth", 12, 9, 3),
    ("infeasible", 3, 6, 2),
    ("fan", 4, 7, 2),
    ("load", 3, 7, 2),
    ("robustness", 20, 6, 4),
    ("other_truth", 4, 10, 2),
    ("cycle_time", 8, 0, 0),
    ("resolution", 8, 0, 0),
    ("noise", 8, 0, 0),
    ("launch", 6, 0, 0),
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
        assert!(section.contains("<tbody>"), "{id}");
    }
    for loads in ["<script", "src=", "url(", "@import", "http://", "https://"] {
        assert!(!page.contains(loads), "{loads}");
    }
    assert!(!page.contains("NaN") && !page.contains("inf\""));
}
