//! Checks of requirements: each name can be printed, is given once, and belongs to a limit that is given.

use std::collections::BTreeSet;

use super::Check;
use crate::document::Document;
use crate::error::Problem;
use crate::expect::Expect;
use crate::nearest::nearest;
use dbc::Quantities;

/// Longest name of a requirement.
const LENGTH_MAX: usize = 100;

/// Checks the requirements of a loop's metrics, or of the limits on the bus. The second expectations are those of the other, which a
/// misspelt name may mean.
pub(super) fn check(check: &mut Check<'_>, expects: [&Expect; 2], quantities: &Quantities) {
    let [expect, _] = expects;
    if expect.requirements.is_empty() {
        return;
    }
    let given = expects.into_iter().flat_map(|one| {
        let limits = one.limits();
        let metrics = limits.map(|(metric, _)| quantities.name(metric.name));
        metrics.chain(one.timing.rows())
    });
    let given = Vec::from_iter(given);
    for (key, requirements) in &expect.requirements {
        let path = format!("expect.requirements.{key}");
        check.add(undemanded(check.document, &path, key, &given));
        names(check, &path, requirements);
    }
}

/// Refuses a key without a limit, which tests nothing.
fn undemanded(document: &Document<'_>, path: &str, key: &str, given: &[String]) -> Option<Problem> {
    if given.iter().any(|given| given == key) {
        return None;
    }
    let label = match nearest(key, given.iter().map(String::as_str)) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => "has no limit in [expect]".to_owned(),
    };
    let message = format!("`{key}` tests no requirement, since it has no limit");
    let problem = document.key_problem(path, message, label);
    Some(match given {
        [] => problem,
        given => problem.with_help(format!("limits are on: {}", given.join(", "))),
    })
}

/// Checks the names of requirements at a path.
pub(super) fn names(check: &mut Check<'_>, path: &str, requirements: &[String]) {
    let mut seen = BTreeSet::new();
    for (index, name) in requirements.iter().enumerate() {
        let label = if name.trim() != name || name.is_empty() || name.contains(char::is_control) {
            "one line of plain text without blanks at its ends"
        } else if name.chars().count() > LENGTH_MAX {
            "at most 100 characters are admitted"
        } else if !seen.insert(name) {
            "it stands here already"
        } else {
            continue;
        };
        let message = "this is no name of a requirement";
        check.at(&format!("{path}.{index}"), message, label);
    }
}
