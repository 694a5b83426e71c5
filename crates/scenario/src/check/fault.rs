//! Checks what the schema cannot say about faults.

use crate::document::Document;
use crate::error::Problem;
use crate::scenario::Scenario;

/// COB-ID of `plant_truth`, by which the run is judged.
const TRUTH_COB_ID: u16 = 0x6B0;

/// Faults that begin within the run and end after they begin.
pub(super) fn check(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let mut problems = Vec::new();
    let duration_seconds = scenario.duration_seconds;
    for window in scenario.fault.windows() {
        let path = window.place.path();
        let table = format!("[[fault.{}.{}]]", window.place.group, window.place.kind);
        let Some(from_seconds) = window.from_seconds else {
            continue;
        };
        if from_seconds >= duration_seconds {
            let is_instant = window.until_seconds == window.from_seconds;
            let key = if is_instant && document.has(&format!("{path}.at_seconds")) {
                "at_seconds"
            } else {
                "from_seconds"
            };
            let message = format!("{table} starts after the end of the run");
            let label = format!("the run ends at {duration_seconds} s");
            problems.push(document.problem(&format!("{path}.{key}"), message, label));
        }
        let until_path = format!("{path}.until_seconds");
        if window.until_seconds.is_some_and(|end| end <= from_seconds) && document.has(&until_path)
        {
            let message = format!("{table} ends before it begins");
            let label = format!("must be after {from_seconds} s");
            problems.push(document.problem(&until_path, message, label));
        }
    }
    let babble = scenario
        .fault
        .bus
        .babble
        .iter()
        .map(|fault| fault.identifier);
    let load = scenario.fault.bus.load.iter().map(|fault| fault.identifier);
    for (kind, index, identifier) in (babble.enumerate().map(|(index, id)| ("babble", index, id)))
        .chain(load.enumerate().map(|(index, id)| ("load", index, id)))
    {
        if identifier == TRUTH_COB_ID {
            let path = format!("fault.bus.{kind}.{index}.identifier");
            let message = "no foreign node may forge what the plant says of itself";
            problems.push(document.problem(&path, message, "0x6B0 is `plant_truth`"));
        }
    }
    for (index, fault) in scenario.fault.plant.ageing.iter().enumerate() {
        if fault.until_seconds.is_none() {
            let path = format!("fault.plant.ageing.{index}");
            let message = "ageing needs an end, at which its factors are reached";
            problems.push(document.problem(&path, message, "`until_seconds` is missing"));
        }
    }
    problems
}
