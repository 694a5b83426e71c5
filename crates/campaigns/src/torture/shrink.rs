//! Makes a failing scenario as small as possible while it still breaks the same invariant.

use plan::Plan;
use scenario::HASH_SUFFIX;
use toml::{Table, Value};

use super::draw::DrawnFault;
use super::invariants::{BrokenInvariant, violation};
use crate::campaign::{Interrupted, caught, play_one, watched};
use crate::sweep::sweep_cases::case_name;
use runner::exit::{Exit, Failure};
use worlds::catalogue::catalogue;

/// Invariant of a run that the program could not bring to a verdict.
pub(super) const PANIC: &str = "panic";

/// Largest number of plays for shrinking.
const PLAYS_MAX: usize = 400;

/// Scenario as a document, so that the written scenario is the one that was played.
#[derive(Clone, Debug)]
pub(super) struct TortureCase<'a> {
    /// Everything but the faults.
    document: Table,
    faults: Vec<DrawnFault>,
    /// Plan of the base scenario, which has the files of the case.
    base: &'a Plan,
}

impl<'a> TortureCase<'a> {
    /// Returns the base scenario with other faults and a name of its own. Limits and requirements are left out, and so is a
    /// sweep, whose keys may have vanished with the faults.
    ///
    /// # Panics
    /// Never: the base was read from a text.
    pub(super) fn new(base: &'a Plan, faults: Vec<DrawnFault>, seed: u64) -> Self {
        let shared = &base.shared;
        let mut document: Table = shared.text.parse().expect("the loader has read it");
        // The case tests no requirement and is not a play of the scenario itself.
        for key in ["expect", "sweep", "requirements"] {
            document.remove(key);
        }
        let name = case_name(&shared.run.name, "torture");
        document.insert("name".to_owned(), name.into());
        document.insert("fault".to_owned(), Table::new().into());
        let seed = i64::try_from(seed % (1 << 53)).unwrap_or_default();
        document.insert("seed".to_owned(), seed.into());
        Self {
            document,
            faults,
            base,
        }
    }

    /// Returns the scenario's text.
    pub(super) fn text(&self) -> String {
        let mut groups = Table::new();
        for fault in &self.faults {
            let kinds = groups.entry(fault.group).or_insert(Table::new().into());
            if let Value::Table(kinds) = kinds
                && let Value::Array(of_kind) =
                    kinds.entry(fault.kind).or_insert(Value::Array(Vec::new()))
            {
                of_kind.push(fault.table.clone().into());
            }
        }
        let mut document = self.document.clone();
        document.insert("fault".to_owned(), groups.into());
        document.to_string()
    }

    /// Returns the plan of the scenario.
    ///
    /// # Errors
    /// Error of the loader; tables in other files are not read.
    pub(super) fn plan(&self) -> Result<Plan, String> {
        let shared = &self.base.shared;
        let rig = self.document.get("rig").and_then(Value::as_str);
        let read_file = |name: &str| {
            let text = "torture cannot play a scenario with tables in files; write its set-points and currents as holds, steps and ramps";
            let is_table = rig != Some(name) && !name.ends_with(HASH_SUFFIX);
            let file = shared.tables.get(name).filter(|_| !is_table);
            file.cloned().ok_or_else(|| std::io::Error::other(text))
        };
        let beside = shared.beside.for_case();
        let plan = Plan::parse(&beside, self.text(), read_file, catalogue());
        plan.map_err(|error| format!("{:?}", miette::Report::new(error)))
    }

    /// Returns the invariant that the case breaks; a panic counts as one, a failure of the machine does not.
    ///
    /// # Errors
    /// The user stopped it.
    pub(super) fn violation(&self) -> Result<Option<BrokenInvariant>, Interrupted> {
        let Ok(plan) = self.plan() else {
            return Ok(None);
        };
        let played = watched(|watch| caught(|| play_one(0, &plan, watch, violation)))?;
        let panic = |failure: Failure| BrokenInvariant {
            invariant: PANIC,
            text: failure.reason,
        };
        Ok(match played {
            Ok(broken) => broken,
            Err(failure) if failure.exit == Exit::Internal => Some(panic(failure)),
            Err(_) => None,
        })
    }

    /// Returns the smallest case that breaks the same invariant: without faults that it does not need, shorter, with round
    /// numbers.
    ///
    /// # Errors
    /// The user stopped it.
    pub(super) fn shrunk(&self, invariant: &str) -> Result<Self, Interrupted> {
        let mut budget = PLAYS_MAX;
        let mut smallest = self.clone();
        'smaller: loop {
            for candidate in smallest.smaller().into_iter().take(budget) {
                budget -= 1;
                let is_same = |violation: BrokenInvariant| violation.invariant == invariant;
                if candidate.violation()?.is_some_and(is_same) {
                    smallest = candidate;
                    continue 'smaller;
                }
            }
            return Ok(smallest);
        }
    }

    /// Returns cases that are a little smaller, the greatest steps first.
    fn smaller(&self) -> Vec<Self> {
        let places = 0..self.faults.len();
        let without = places.clone().map(|place| {
            let mut smaller = self.clone();
            smaller.faults.remove(place);
            smaller
        });
        let simpler = places.flat_map(|place| self.simpler(place));
        without.chain(self.shorter()).chain(simpler).collect()
    }

    /// Returns cases whose runs end earlier.
    fn shorter(&self) -> Vec<Self> {
        let duration = self.document.get("duration_seconds");
        let Some(duration) = duration.and_then(Value::as_float) else {
            return Vec::new();
        };
        let rounded = [0.5, 0.8, 0.9].map(|factor| libm::ceil(duration * factor * 10.0) / 10.0);
        rounded
            .into_iter()
            .filter(|shorter| *shorter < duration)
            .map(|shorter| {
                let mut smaller = self.clone();
                let document = &mut smaller.document;
                document.insert("duration_seconds".to_owned(), shorter.into());
                smaller
            })
            .collect()
    }

    /// Returns the same case with one parameter of a fault left out or rounded.
    fn simpler(&self, place: usize) -> Vec<Self> {
        let with = |change: &dyn Fn(&mut Table)| {
            let mut smaller = self.clone();
            change(&mut smaller.faults[place].table);
            smaller
        };
        let mut candidates = Vec::new();
        for (key, value) in &self.faults[place].table {
            candidates.push(with(&|fault| {
                fault.remove(key);
            }));
            for rounder in rounder(value) {
                candidates.push(with(&|fault| {
                    fault.insert(key.clone(), rounder.clone());
                }));
            }
        }
        candidates
    }
}

/// Returns numbers with fewer digits; empty if the number has none to lose.
fn rounder(value: &Value) -> Vec<Value> {
    let Some(number) = value.as_float() else {
        return Vec::new();
    };
    let rounded = [1.0, 10.0, 100.0, 1000.0].map(|scale| libm::round(number * scale) / scale);
    let digits = |number: f64| format!("{number}").len();
    let rounder = rounded
        .into_iter()
        .filter(|rounded| digits(*rounded) < digits(number));
    rounder.map(Value::Float).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use scenario::Beside;

    use super::*;

    const BASE: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 3.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[expect]\n\
        position_millimetres_max = { max = 0.0 }\n";

    /// Returns faults of which only the first two break the temperature's limit.
    fn faults() -> Vec<DrawnFault> {
        let fault = |group, kind, table: &str| DrawnFault {
            group,
            kind,
            table: table.parse().unwrap(),
        };
        let ageing = "from_seconds = 0.1234\nuntil_seconds = 0.3217\nresistance_factor = 1.8731\n";
        let load = "from_seconds = 0.5\nidentifier = 0x555\nperiod_milliseconds = 2.0\n";
        vec![
            fault("plant", "ageing", ageing),
            fault(
                "amplifier",
                "stuck_on",
                "from_seconds = 0.2\ncurrent_amperes = 0.9876\n",
            ),
            fault(
                "sensor",
                "noise",
                "from_seconds = 0.5\nnoise_millimetres_rms = 0.01\n",
            ),
            fault("bus", "load", load),
        ]
    }

    fn plan(base: &str) -> Plan {
        let table = "time_seconds,position_millimetres\n0.0,10.0\n1.0,12.0\n";
        let read_file = |_: &str| Ok(table.to_owned());
        let beside = Beside::new(Path::new("t.toml"));
        Plan::parse(&beside, base.to_owned(), read_file, catalogue()).unwrap()
    }

    #[test]
    fn what_is_not_needed_is_left_out_and_the_rest_still_fails() {
        let base = plan(BASE);
        let case = TortureCase::new(&base, faults(), 7);
        assert_eq!(case.violation().unwrap().unwrap().invariant, "temperature");
        let shrunk = case.shrunk("temperature").unwrap();
        assert_eq!(
            shrunk.violation().unwrap().unwrap().invariant,
            "temperature"
        );
        let scenario = &shrunk.plan().unwrap().only_loop().unwrap().trial.clone();
        let kinds: Vec<_> = scenario
            .run
            .faults
            .iter()
            .map(|fault| fault.kind.name)
            .collect();
        assert_eq!(kinds, ["stuck_on", "ageing"], "{}", shrunk.text());
        assert!(scenario.run.duration_seconds < 3.0, "{}", shrunk.text());
        assert!(!shrunk.text().contains("[]"), "{}", shrunk.text());
        // No smaller case fails: the case is a fixed point.
        let again = shrunk.shrunk("temperature").unwrap();
        assert_eq!(again.text(), shrunk.text());
    }

    /// A case with the scenario's name would count as its latest play, and as one that meets its requirements.
    #[test]
    fn a_case_has_a_new_name_and_tests_no_requirement() {
        let base = plan(&BASE.replace("[controller", "requirements = [\"REQ-1\"]\n[controller"));
        let case = TortureCase::new(&base, Vec::new(), 7);
        let scenario = &case.plan().unwrap().only_loop().unwrap().trial.clone();
        assert_eq!(scenario.run.name, "t, torture");
        assert!(scenario.run.requirements.is_empty());
    }

    #[test]
    fn a_scenario_with_tables_in_files_is_refused() {
        let base = plan(&BASE.replace(
            "[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0",
            "[[reference.table]]\nfrom_seconds = 0.0\nfile = \"x.csv\"",
        ));
        let case = TortureCase::new(&base, Vec::new(), 7);
        let reason = case.plan().unwrap_err();
        assert!(
            reason.contains("cannot play a scenario with tables in files"),
            "{reason}"
        );
    }
}
