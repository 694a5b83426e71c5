//! Checks each metric of random runs, with missing cycles and stretches of silence, against a second, plain implementation of the
//! definitions in docs/reference/metrics.md.
#![expect(clippy::unwrap_used, reason = "tests fail by panicking")]

mod drawn;
mod plain;

use judge::verdict::Verdict;
use judge::{Circumstances, judge};
use proptest::prelude::*;
use recording::timeline::decode;

use crate::drawn::{Drawn, drawn};
use crate::plain::{Rows, rows};

/// Ends of the names of rows that belong to checks.
const CHECKS: [&str; 4] = [
    "position_millimetres stays",
    "position_millimetres reaches",
    "position_millimetres rate_per_second",
    "there",
];

fn verdict(drawn: &Drawn) -> Verdict {
    let plan = testing::plan(&drawn.text());
    let timelines = decode(&drawn.stamped().into(), &plan).unwrap();
    judge(&plan, &timelines, &Circumstances::default())
}

fn judged(verdict: &Verdict) -> Rows {
    let rows = verdict.metrics.iter().map(|metric| {
        let name = metric.name.as_str();
        let check = CHECKS.iter().find(|check| name.starts_with(**check));
        (check.map_or(name, |check| check).to_owned(), metric.value)
    });
    rows.collect()
}

/// Compares two values; those of the verdict have six decimals.
fn is_same(judged: Option<f64>, plain: Option<f64>) -> bool {
    match (judged, plain) {
        (Some(judged), Some(plain)) => (judged - plain).abs() <= 1e-6 + 1e-9 * plain.abs(),
        (judged, plain) => judged == plain,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases.max(1000), ..ProptestConfig::default() })]

    #[test]
    fn a_metric_is_what_its_definition_says(drawn in drawn()) {
        let verdict = verdict(&drawn);
        let (judged, plain) = (judged(&verdict), rows(&drawn));
        let names = |rows: &Rows| rows.keys().cloned().collect::<Vec<_>>();
        prop_assert_eq!(names(&judged), names(&plain));
        for (name, value) in &judged {
            prop_assert!(is_same(*value, plain[name]), "{}: {:?}, by its definition {:?}", name, value, plain[name]);
        }
        // A row without a value never passes.
        for metric in &verdict.metrics {
            prop_assert!(metric.passed != Some(true) || metric.value.is_some(), "{} passes", metric.name);
        }
    }
}
