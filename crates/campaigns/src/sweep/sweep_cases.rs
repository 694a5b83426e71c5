//! Definition of a sweep's cases. Each follows from the file and its number alone.

use std::collections::BTreeMap;
use std::io;

use faults::Stream;
use scenario::metrics::without_loop;
use scenario::overrides::set;
use scenario::sweep::{Distribution, List, LogUniform, Sweep, Uniform};
use sha2::{Digest, Sha256};
use toml::{Table, Value};

use super::cases::{Cases, Facts};
use super::row::{Ended, SweepRow};
use crate::campaign::play_one;
use plan::Plan;
use recording::capture::Watch;
use report::terminal::as_written;
use runner::exit::{Exit, Failure};
use scenario::hexadecimal;
use worlds::catalogue::catalogue;

/// Longest part of the scenario's name in the name of a case, which may have 200 characters.
const NAME_CHARACTERS_MAX: usize = 180;
/// Length in bytes of the hashes of cases, sweeps and rows. In sweeps of a million cases, two have the same hash by chance once in 30
/// million sweeps.
pub(super) const HASH_BYTES: usize = 8;

/// Sweep: a scenario and the keys that vary in it.
pub struct SweepCases {
    facts: Facts,
    document: Table,
    axes: Vec<List>,
    sweep: Sweep,
    draws: usize,
}

/// Case of a sweep.
pub struct SweepCase<'a> {
    /// Hash of the content: the same scenario has the same hash in every sweep.
    pub id: String,
    /// Scenario as a file of its own.
    pub text: String,
    base: &'a Plan,
}

impl SweepCases {
    /// Returns the sweep of a plan that was read from a file.
    ///
    /// # Errors
    /// The plan has no sweep.
    pub fn new(plan: &Plan) -> Result<Self, Failure> {
        let shared = &plan.shared;
        let Some(sweep) = &shared.sweep else {
            let path = shared.beside.scenario().display();
            return Err(Exit::CannotStart.because(format!(
                "`{path}` has no [sweep] table, so nothing varies; add one, such as [[sweep.list]] with a key and its values"
            )));
        };
        let mut document: Table = shared.text.parse().expect("the loader has read it");
        document.remove("sweep");
        let axes = sweep.axes();
        let listed = axes
            .iter()
            .map(|axis| (axis.key.clone(), values_text(&axis.values)));
        let drawn = sweep
            .distributions()
            .map(|one| (one.key().to_owned(), distribution_text(one)));
        // A limit that varies is another one in each case.
        let is_swept = |row: &str| {
            let mut limits = sweep.keys().filter(|key| key.starts_with("expect."));
            limits.any(|key| key.split('.').any(|part| part == without_loop(row)))
        };
        let mut limits = judge::limits(plan);
        limits.retain(|(row, _)| !is_swept(row));
        let text = format!("{}{}", env!("CARGO_PKG_VERSION"), shared.text);
        Ok(Self {
            facts: Facts {
                kind: "sweep",
                id: id(&text, &shared.tables),
                seed: sweep.seed,
                runs: usize::try_from(sweep.runs()).unwrap_or(usize::MAX),
                // Keys of the grid, then those that are drawn.
                variations: listed.chain(drawn).collect(),
                limits,
                criterion: None,
                files: Vec::new(),
                plan: plan.clone(),
            },
            document,
            axes,
            sweep: sweep.clone(),
            draws: sweep.draws.unwrap_or(1) as usize,
        })
    }

    /// Draws a number from a key's own stream: it depends on neither the other keys nor the other draws.
    fn draw(&self, distribution: Distribution<'_>, draw: usize) -> f64 {
        let key = distribution.key();
        let mut stream = Stream::named(self.sweep.seed, &format!("sweep.{key}.{draw}"));
        let is_whole = self.sweep.whole_numbers.contains(key);
        let drawn = match distribution {
            Distribution::Uniform(&Uniform { from, to, .. }) if is_whole => {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "the schema's whole numbers are below 2^53"
                )]
                let count = (libm::floor(to) - libm::ceil(from)).max(0.0) as u64 + 1;
                libm::ceil(from) + stream.below(count) as f64
            }
            Distribution::Uniform(Uniform { from, to, .. }) => {
                from + (to - from) * stream.uniform()
            }
            Distribution::LogUniform(&LogUniform { from, to, .. }) => {
                let drawn = from * libm::pow(to / from, stream.uniform());
                drawn.clamp(from, to)
            }
            Distribution::Normal(normal) => {
                normal.mean + normal.standard_deviation * stream.normal()
            }
        };
        if is_whole { libm::round(drawn) } else { drawn }
    }

    /// Returns a case.
    ///
    /// # Panics
    /// Never: the loader has checked the keys.
    pub fn case(&self, number: usize) -> SweepCase<'_> {
        let mut document = self.document.clone();
        for (key, value) in self.facts.keys().into_iter().zip(self.values(number)) {
            set(&mut document, key, self.written(key, value)).expect("a key of the scenario");
        }
        let shared = &self.facts.plan.shared;
        let id = id(&document.to_string(), &shared.tables);
        let name = case_name(&shared.run.name, &format!("case {number}"));
        document.insert("name".to_owned(), name.into());
        SweepCase {
            id,
            text: document.to_string(),
            base: &self.facts.plan,
        }
    }

    /// Writes a value as TOML.
    fn written(&self, key: &str, value: f64) -> Value {
        if !self.sweep.whole_numbers.contains(key) {
            return Value::Float(value);
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "the schema's whole numbers are below 2^53"
        )]
        let whole = value as i64;
        Value::Integer(whole)
    }
}

impl Cases for SweepCases {
    fn facts(&self) -> &Facts {
        &self.facts
    }

    fn values(&self, number: usize) -> Vec<f64> {
        let place = number.saturating_sub(1);
        let (mut point, draw) = (place / self.draws, place % self.draws);
        // The last axis varies fastest.
        let mut values: Vec<f64> = Vec::new();
        for axis in self.axes.iter().rev() {
            values.push(axis.values[point % axis.values.len()]);
            point /= axis.values.len();
        }
        values.reverse();
        let drawn = self.sweep.distributions();
        values.extend(drawn.map(|one| self.draw(one, draw)));
        values
    }

    fn text(&self, number: usize) -> String {
        self.case(number).text
    }

    fn options(&self, number: usize) -> Option<String> {
        let values = self.facts.keys().into_iter().zip(self.values(number));
        Some(String::from_iter(
            values.map(|(key, value)| format!(" --set '{key}={value}'")),
        ))
    }

    fn play(&self, number: usize, watch: &Watch) -> Result<SweepRow, Failure> {
        let case = self.case(number);
        let plan = match case.plan() {
            Ok(plan) => plan,
            Err(reason) => {
                let (id, ended) = (&case.id, Ended::Invalid);
                return Ok(SweepRow::without_verdict(number, id, ended, reason));
            }
        };
        play_one(number, &plan, watch, |played| {
            SweepRow::from_verdict(number, &case.id, played.verdict)
        })
    }

    fn faulty(&self, number: usize, reason: String) -> SweepRow {
        let id = self.case(number).id;
        SweepRow::without_verdict(number, &id, Ended::InternalError, reason)
    }
}

impl SweepCase<'_> {
    /// Returns the plan of the case, which its values may have made invalid.
    ///
    /// # Errors
    /// The first thing that is wrong in the scenario.
    pub fn plan(&self) -> Result<Plan, String> {
        let table = |name: &str| {
            let text = self.base.shared.tables.get(name).cloned();
            text.ok_or_else(|| io::ErrorKind::NotFound.into())
        };
        let plan = self.base.varied(&self.text, table, catalogue());
        plan.map_err(|error| {
            let first = error.problems().first();
            first.map_or_else(|| error.to_string(), ToString::to_string)
        })
    }
}

/// Returns the hash of a scenario and its tables.
pub(crate) fn id(text: &str, tables: &BTreeMap<String, String>) -> String {
    let tables = tables.iter().flat_map(|(name, table)| [name, table]);
    hash([text].into_iter().chain(tables.map(String::as_str)))
}

/// Returns the hash of some texts.
pub(super) fn hash<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    let mut hasher = Sha256::new();
    for text in texts {
        hasher.update((text.len() as u64).to_le_bytes());
        hasher.update(text);
    }
    hexadecimal(&hasher.finalize()[..HASH_BYTES])
}

/// Returns the name of a case, from the scenario's name.
pub(crate) fn case_name(name: &str, case: &str) -> String {
    let name: String = name.chars().take(NAME_CHARACTERS_MAX).collect();
    format!("{name}, {case}")
}

fn values_text(values: &[f64]) -> String {
    match values {
        [first, _, _, _, .., last] => {
            let [first, last] = [first, last].map(|value| as_written(*value));
            format!("{} values from {first} to {last}", values.len())
        }
        few => {
            let few: Vec<String> = few.iter().map(|value| as_written(*value)).collect();
            few.join(", ")
        }
    }
}

fn distribution_text(distribution: Distribution<'_>) -> String {
    let range = |from, to| format!("from {} to {}", as_written(from), as_written(to));
    match distribution {
        Distribution::Uniform(one) => format!("uniform {}", range(one.from, one.to)),
        Distribution::LogUniform(one) => format!("log-uniform {}", range(one.from, one.to)),
        Distribution::Normal(one) => {
            let [mean, deviation] = [one.mean, one.standard_deviation].map(as_written);
            format!("normal, {mean} ± {deviation}")
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use scenario::Beside;

    use super::*;

    fn cases(sweep: &str) -> SweepCases {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n[[reference.hold]]\n\
             at_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\n{sweep}"
        );
        let plan =
            Plan::parse_beside(&Beside::new(Path::new("s.toml")), text, catalogue()).unwrap();
        SweepCases::new(&plan).unwrap()
    }

    const GRID: &str = "draws = 2\n[[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15]\n\
        [[sweep.range]]\nkey = \"node.drive.sensor.resolution_bits\"\nfrom = 8\nto = 10\nstep = 1\n\
        [[sweep.uniform]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nfrom = 0.03\nto = 0.05\n";

    #[test]
    fn every_point_of_the_grid_meets_the_same_draws() {
        let cases = cases(GRID);
        assert_eq!(cases.facts.runs, 12);
        let all: Vec<Vec<f64>> = (1..=12).map(|number| cases.values(number)).collect();
        let points: Vec<[f64; 2]> = all.iter().step_by(2).map(|one| [one[0], one[1]]).collect();
        let expected = [
            [5., 8.],
            [5., 9.],
            [5., 10.],
            [15., 8.],
            [15., 9.],
            [15., 10.],
        ];
        assert_eq!(points, expected);
        assert!(all.iter().all(|one| (0.03..=0.05).contains(&one[2])));
        assert!(
            all.chunks(2)
                .all(|pair| pair[0][2] == all[0][2] && pair[1][2] == all[1][2])
        );
        assert_ne!(all[0][2], all[1][2]);
    }

    #[test]
    fn a_limit_that_varies_is_none_of_all_cases() {
        let limits = "[expect]\nsteady_state_error_millimetres = { max = 1.0 }\nbus_load_percent = { max = 9.0 }\n\
            [[sweep.list]]\nkey = \"expect.bus_load_percent.max\"\nvalues = [8.0, 9.0]\n";
        let limits = cases(limits).facts.limits;
        let names = Vec::from_iter(limits.iter().map(|(name, _)| name.as_str()));
        assert_eq!(names, ["steady_state_error_millimetres"]);
    }

    #[test]
    fn a_case_is_the_scenario_with_its_values() {
        let cases = cases(GRID);
        let case = cases.case(11);
        let scenario = &case.plan().unwrap().only_loop().unwrap().trial.clone();
        assert_eq!(scenario.run.name, "s, case 11");
        assert_eq!(scenario.reference.hold[0].position, 15.0);
        assert_eq!(scenario.sensor.resolution_bits(), 10);
        assert_eq!(
            scenario.plant().load_kilograms().unwrap(),
            cases.values(11)[2]
        );
        assert!(case.plan().unwrap().shared.sweep.is_none());
        assert!(cases.text(11).contains("name = \"s, case 11\""));
        let ids: BTreeSet<String> = (1..=12).map(|number| cases.case(number).id).collect();
        assert_eq!(ids.len(), 12);
    }

    #[test]
    fn one_more_key_changes_neither_draws_nor_what_a_case_is_called() {
        let more = format!(
            "{GRID}[[sweep.normal]]\nkey = \"plant.wire.heat.ambient_celsius\"\nmean = 20\nstandard_deviation = 2\n"
        );
        let (cases, more) = (cases(GRID), cases(&more));
        assert_eq!(cases.values(4)[..], more.values(4)[..3]);
        assert_ne!(cases.case(4).id, more.case(4).id);
        assert_ne!(cases.facts.id, more.facts.id);
        let twice = ["seed = 0\n", "# the default\n"]
            .map(|line| super::tests::cases(&format!("{line}{GRID}")));
        assert_eq!(twice[0].case(4).id, twice[1].case(4).id);
        assert_eq!(cases.case(4).id, twice[0].case(4).id);
    }

    #[test]
    fn the_seed_decides_what_is_drawn_and_nothing_else() {
        let values = |seed: u64| cases(&format!("seed = {seed}\n{GRID}")).values(4);
        let (one, other) = (values(1), values(2));
        assert_eq!(one, values(1));
        assert_eq!(one[..2], other[..2]);
        assert_ne!(one[2], other[2]);
    }

    #[test]
    fn draws_have_their_distributions() {
        let cases = cases(
            "draws = 4000\n[[sweep.uniform]]\nkey = \"seed\"\nfrom = 1\nto = 4\n\
             [[sweep.log_uniform]]\nkey = \"plant.wire.mechanics.damping_newton_seconds_per_metre\"\nfrom = 0.01\nto = 1\n\
             [[sweep.normal]]\nkey = \"plant.wire.heat.ambient_celsius\"\nmean = 20\nstandard_deviation = 2\n",
        );
        let column = |place: usize| {
            (1..=4000)
                .map(|number| cases.values(number)[place])
                .collect()
        };
        let columns: [Vec<f64>; 3] = [0, 1, 2].map(column);
        let share = |values: &[f64], is_counted: &dyn Fn(f64) -> bool| {
            let counted = values.iter().filter(|value| is_counted(**value)).count();
            counted as f64 / values.len() as f64
        };
        for whole in [1.0, 2.0, 3.0, 4.0] {
            let share = share(&columns[0], &|value| value == whole);
            assert!((share - 0.25).abs() < 0.03, "{whole}: {share}");
        }
        let below = share(&columns[1], &|value| value < 0.1);
        assert!((below - 0.5).abs() < 0.03, "{below}");
        let near = share(&columns[2], &|value| (value - 20.0).abs() < 2.0);
        assert!((near - 0.683).abs() < 0.03, "{near}");
    }

    #[test]
    fn a_draw_that_a_key_does_not_admit_makes_an_invalid_case() {
        let cases = cases(
            "draws = 50\n[[sweep.normal]]\nkey = \"plant.wire.mechanics.load_kilograms\"\nmean = 0.01\nstandard_deviation = 0.01\n",
        );
        let reasons: Vec<String> = (1..=50)
            .filter_map(|number| cases.case(number).plan().err())
            .collect();
        assert!((2..30).contains(&reasons.len()), "{reasons:?}");
        assert!(reasons[0].contains("out of range"), "{}", reasons[0]);
    }
}
