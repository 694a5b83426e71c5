//! `canrig new scenario`: writes a scenario with a step for a rig, and limits around what a play of
//! it measures.

use std::path::{Path, PathBuf};

use ::scenario::Beside;
use ::scenario::metrics::{Form, METRICS, Metric, Subject};
use ::scenario::rig::shipped;
use campaigns::campaign::Campaign;
use clap::Args;
use dbc::{Quantities, conversion};
use judge::verdict::{Outcome, Verdict};
use plan::{ControlLoop, Plan};
use report::terminal::significant;
use runner::exit::{Exit, Failure};
use runner::output::write_new;
use worlds::catalogue::catalogue;

use super::require_name;

/// Largest rig file that is read.
const RIG_BYTES_MAX: u64 = plan::FILE_BYTES_MAX;
/// Places of hold and step in the range of the sensor.
const HOLD: f64 = 0.25;
const STEP: f64 = 0.5;
/// Proportional gain, as a part of the amplifier's range over that of the sensor, and the other
/// gains as multiples of it. These are the ratios of the gains that canrig's PID has by itself,
/// which were tuned for the shape-memory-alloy wire.
const PROPORTIONAL: f64 = 1.37;
const INTEGRAL_PER_SECOND: f64 = 1.66;
const DERIVATIVE_SECONDS: f64 = 0.157;
/// Part of a measured value by which its limits lie below and above it.
const MARGIN: f64 = 0.2;
/// Metric of the bus that is limited; others of bus and cycles depend on the machine in real time.
const BUS_LOAD: &str = "bus_load_percent";

/// The scenario to write.
#[derive(Args, Debug)]
pub(crate) struct ScenarioArgs {
    /// Name of the scenario and of its file: small letters, digits and underscores
    pub name: String,
    /// The rig: a rig file, beside which the scenario is written, or the name of one that ships
    #[arg(long, value_name = "RIG")]
    pub rig: PathBuf,
}

/// Rig for which a scenario is written.
struct Rig {
    /// Value of the scenario's key.
    key: String,
    /// Folder of the scenario.
    folder: PathBuf,
    plan: Plan,
}

/// Writes the file, and returns the next steps for the user.
pub(super) fn written(args: &ScenarioArgs) -> Result<String, Failure> {
    let name = &args.name;
    require_name(name, "scenario")?;
    let rig = Rig::load(&args.rig)?;
    let path = rig.folder.join(format!("{name}.toml"));
    let place = path.display();
    if path.symlink_metadata().is_ok() {
        return Err(Exit::Usage.because(format!(
            "{place} is there already; nothing is overwritten, so choose another name"
        )));
    }
    let begin = rig.without_limits(name)?;
    let plan = Plan::parse_beside(&Beside::new(&path), begin.clone(), catalogue())?;
    let is_emulated = |one: &ControlLoop| one.drive().is_ours();
    let (limits, told) = match plan.loops.iter().find(|one| !is_emulated(one)) {
        Some(one) => {
            let drive = &one.drive().name;
            let text = format!(
                "# No limits: the drive `{drive}` is not emulated, so nothing was measured. Limit what the first run shows.\n\
                 [expect]\n"
            );
            let told = format!(
                "without limits, since the drive `{drive}` is not emulated. Look at gains and set-points before current flows:\n  \
                 canrig check {place}\n  canrig run {place} --bus can0 --dry-run"
            );
            (text, told)
        }
        None => {
            let verdict = measure(plan.clone())?;
            let told = format!(
                "with limits around what a play measured. Play it:\n  canrig simulate {place}"
            );
            (limits(&plan, &verdict), told)
        }
    };
    let text = begin + &limits;
    Plan::parse_beside(&Beside::new(&path), text.clone(), catalogue())?;
    write_new(&path, &text)?;
    Ok(format!("{place} is a step on the rig {}, {told}", rig.key))
}

impl Rig {
    /// Reads a rig file, or one that ships.
    fn load(path: &Path) -> Result<Self, Failure> {
        let by_name = path.to_str().filter(|_| !path.exists());
        let (key, folder, text) = match by_name.and_then(|name| Some((name, shipped::text(name)?)))
        {
            Some((name, text)) => (name.to_owned(), PathBuf::new(), text.to_owned()),
            None => {
                let text = ::scenario::read_text(path, RIG_BYTES_MAX).map_err(|error| {
                    let names = shipped::names().join(", ");
                    Exit::CannotStart.because(format!(
                        "the rig `{}` cannot be read: {error}; name a rig file, or one that ships: {names}",
                        path.display()
                    ))
                })?;
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let folder = path.parent().unwrap_or(Path::new(""));
                (name.into_owned(), folder.to_owned(), text)
            }
        };
        let plan = Plan::from_rig(path, &text, catalogue())?;
        Ok(Self { key, folder, plan })
    }

    /// Returns the loops with a law of their own.
    fn led(&self) -> impl Iterator<Item = &ControlLoop> {
        let loops = self.plan.loops.iter();
        loops.filter(|one| one.trial.wiring.led_by.is_none())
    }

    /// Returns the scenario without its limits.
    fn without_limits(&self, name: &str) -> Result<String, Failure> {
        let mut text = format!(
            "# A step on the rig {rig}. `canrig check` says what is wrong with a change.\n\
             schema = 1\nrig = {rig:?}\nname = {name:?}\nduration_seconds = 4.0\n",
            rig = self.key
        );
        let is_led_by_law = |one: &&ControlLoop| one.controller().is_ours();
        let mut comment = "\n# The gains follow from the ranges of sensor and amplifier alone: tune them, or name another law.\n";
        for one in self.led().filter(is_led_by_law) {
            text += comment;
            text += &law(one)?;
            comment = "\n";
        }
        let mut comment = "\n# The set-point, in the unit of the rig's sensor: a hold from the start, and the step.\n";
        for one in self.led() {
            text += comment;
            text += &reference(one);
            comment = "\n";
        }
        Ok(text + "\n")
    }
}

/// Returns the table of a loop's law.
fn law(one: &ControlLoop) -> Result<String, Failure> {
    let law = match one.trial.wiring.drives_commanded() {
        1 => "pid",
        2 => "pid_pair",
        drives => {
            let (name, most) = (one.name(), "canrig's own laws lead two drives at most");
            return Err(Exit::CannotStart.because(format!(
                "the loop `{name}` has {drives} drives, and {most}: write the scenario by hand, with a law of your own"
            )));
        }
    };
    let quantities = &one.trial.wiring.quantities;
    let (low, high) = range(one);
    // Laws read a position in metres where the sensor has millimetres.
    let law_units = conversion(
        quantities.feedback.unit.word(),
        quantities.feedback.unit.law_word(),
    )
    .unwrap_or(1.0);
    let amplifier = one.trial.amplifier.range();
    let gain = PROPORTIONAL * (amplifier.max - amplifier.min) / ((high - low) * law_units);
    let gains = [
        ("proportional_{gain}", gain),
        ("integral_{gain}_second", gain * INTEGRAL_PER_SECOND),
        ("derivative_{gain_seconds}", gain * DERIVATIVE_SECONDS),
    ];
    let lines = gains.map(|(key, gain)| format!("{} = {}\n", quantities.name(key), rounded(gain)));
    let heading = match one.loop_name() {
        Some(name) => format!("[controller.{name}.{law}]\n"),
        None => format!("[controller.{law}]\n"),
    };
    Ok(heading + &lines.concat())
}

/// Returns hold and step of a loop.
fn reference(one: &ControlLoop) -> String {
    let key = one.trial.wiring.quantities.name("{signal}_{unit}");
    let (low, high) = range(one);
    let named = one.loop_name().map(|name| format!("loop = {name:?}\n"));
    let named = named.unwrap_or_default();
    let entry = |kind: &str, at_seconds: f64, place: f64| {
        let value = rounded(low + place * (high - low));
        format!("[[reference.{kind}]]\n{named}at_seconds = {at_seconds:?}\n{key} = {value}\n")
    };
    entry("hold", 0.0, HOLD) + "\n" + &entry("step", 2.0, STEP)
}

/// Returns the range of a loop's set-points: that of its sensor, within the limits of a real drive.
fn range(one: &ControlLoop) -> (f64, f64) {
    let feedback = &one.trial.wiring.feedback;
    let default_max =
        60.0 * conversion("millimetres", feedback.quantity.unit.word()).unwrap_or(1.0);
    let (low, high) = (feedback.min, feedback.max.unwrap_or(default_max));
    match &one.real_drive {
        Some(drive) => (
            low.max(drive.real.limits.min),
            high.min(drive.real.limits.max),
        ),
        None => (low, high),
    }
}

/// Plays the scenario once, in virtual time and without files.
fn measure(plan: Plan) -> Result<Verdict, Failure> {
    let campaign = Campaign {
        threads: 1,
        is_shown: false,
    };
    let played = campaign.play([plan].into_iter(), |run| run.verdict.clone());
    let mut played = played.map_err(|interrupted| Exit::Interrupted.because(interrupted))?;
    played.remove(0)
}

/// Returns the tables of limits.
fn limits(plan: &Plan, verdict: &Verdict) -> String {
    let mut text = "# Measured values ± 20 %, from a play in lock-step. Keep what your requirements demand, with their numbers.\n".to_owned();
    if verdict.outcome != Outcome::Pass {
        let reason = verdict.reason.as_deref().unwrap_or("it did not pass");
        text += &format!(
            "# The play: {}.\n",
            reason.lines().collect::<Vec<_>>().join(" ")
        );
    }
    let of_bus = |metric: &&Metric| metric.subject == Subject::Bus && metric.name == BUS_LOAD;
    let of_loop = |metric: &&Metric| {
        let subjects = [Subject::Position, Subject::Current, Subject::Plant];
        subjects.contains(&metric.subject) && metric.form == Form::TwoSided
    };
    let rows = |quantities: &Quantities, prefix: &str, wanted: &dyn Fn(&&Metric) -> bool| {
        let rows = METRICS.iter().filter(wanted);
        let rows = rows.filter_map(|metric| row(quantities, prefix, metric, verdict));
        Vec::from_iter(rows).concat()
    };
    text += "[expect]\n";
    text += &rows(&Quantities::default(), "", &of_bus);
    let loops = plan.loops.iter();
    for one in loops.filter(|one| one.trial.wiring.led_by.is_none()) {
        if let Some(name) = one.loop_name() {
            text += &format!("\n[expect.{name}]\n");
        }
        let quantities = &one.trial.wiring.quantities;
        text += &rows(quantities, &one.prefix(), &of_loop);
    }
    text
}

/// Returns the limit of a metric with what it measures, or the reason why there is none; `None` if
/// the verdict does not have it.
fn row(
    quantities: &Quantities,
    prefix: &str,
    metric: &Metric,
    verdict: &Verdict,
) -> Option<String> {
    let [name, text] = [metric.name, metric.text].map(|pattern| quantities.name(pattern));
    let full_name = format!("{prefix}{name}");
    let measured = verdict.metrics.iter().find(|row| row.name == full_name)?;
    Some(match (measured.value, &measured.remark) {
        (Some(value), _) if value.is_finite() && value != 0.0 => {
            let margin = MARGIN * value.abs();
            let (min, max) = (rounded(value - margin), rounded(value + margin));
            let value = significant(value);
            format!("# {text} Measured: {value}.\n{name} = {{ min = {min}, max = {max} }}\n")
        }
        (Some(_), _) => {
            format!("# {text} Measured: 0, which has no ± 20 %.\n# {name} = {{ max = … }}\n")
        }
        (None, remark) => {
            let why = remark.as_deref().unwrap_or("no value");
            format!("# {text} Measured: {why}.\n# {name} = {{ max = … }}\n")
        }
    })
}

/// Writes a number with three digits, as TOML has it.
fn rounded(value: f64) -> String {
    let rounded: f64 = format!("{value:.2e}").parse().unwrap_or(value);
    format!("{rounded:?}")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::new::rig;

    /// Writes a scenario for a rig beside the rig's file, and returns its text and the verdict of a
    /// play.
    fn played(folder: &Path, name: &str, rig: &str) -> (String, Verdict) {
        let args = ScenarioArgs {
            name: name.to_owned(),
            rig: folder.join(rig),
        };
        written(&args).unwrap();
        let path = folder.join(format!("{name}.toml"));
        let plan = Plan::load(&path, catalogue()).unwrap();
        (fs::read_to_string(path).unwrap(), measure(plan).unwrap())
    }

    #[test]
    fn a_scenario_of_each_rig_that_ships_passes_within_its_active_limits() {
        for name in shipped::names() {
            let folder = tempfile::tempdir().unwrap();
            let file = format!("{name}_rig.toml");
            fs::write(folder.path().join(&file), shipped::text(name).unwrap()).unwrap();
            let (text, verdict) = played(folder.path(), "first_step", &file);
            assert_eq!(
                verdict.outcome,
                Outcome::Pass,
                "{name}: {:?}\n{text}",
                verdict.reason
            );
            assert!(!verdict.judged_nothing(), "{text}");
            for line in text.lines().filter(|line| line.contains("{ min = ")) {
                let (key, _) = line.split_once(' ').unwrap();
                let is_limited = |row: &judge::verdict::Metric| {
                    row.name.ends_with(key) && row.passed == Some(true)
                };
                assert!(verdict.metrics.iter().any(is_limited), "{line}");
            }
            let unit = if ["press", "sma_pair"].contains(&name) {
                "degrees"
            } else {
                "millimetres"
            };
            assert!(text.contains(&format!("\nposition_{unit} = ")), "{text}");
            assert_eq!(
                text.matches("[[reference.step]]").count(),
                text.matches("[[reference.hold]]").count()
            );
        }
    }

    #[test]
    fn a_rig_of_two_loops_has_limits_of_each() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("gantry");
        let args = rig::RigArgs {
            name: "gantry".to_owned(),
            path: Some(folder.clone()),
        };
        rig::written(&args).unwrap();
        let (text, verdict) = played(&folder, "two_steps", "gantry.toml");
        assert_eq!(
            verdict.outcome,
            Outcome::Pass,
            "{:?}\n{text}",
            verdict.reason
        );
        for table in [
            "[expect.a]",
            "[expect.b]",
            "[controller.a.pid]",
            "loop = \"b\"",
        ] {
            assert!(text.contains(table), "{text}");
        }
        // A second one of this name is refused.
        let again = ScenarioArgs {
            name: "two_steps".to_owned(),
            rig: folder.join("gantry.toml"),
        };
        let error = written(&again).unwrap_err();
        assert!(error.reason.contains("is there already"), "{error}");
        assert_eq!(error.exit, Exit::Usage);
    }

    #[test]
    fn a_real_drive_has_no_limits_and_what_is_no_rig_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let rig = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/examples/rig.toml");
        fs::copy(rig, folder.path().join("rig.toml")).unwrap();
        let args = |rig: &str| ScenarioArgs {
            name: "careful".to_owned(),
            rig: folder.path().join(rig),
        };
        let said = written(&args("rig.toml")).unwrap();
        assert!(said.contains("--dry-run"), "{said}");
        let text = fs::read_to_string(folder.path().join("careful.toml")).unwrap();
        assert!(text.contains("# No limits: the drive `"), "{text}");
        assert!(!text.contains("max ="), "{text}");
        let error = written(&args("none.toml")).unwrap_err();
        assert!(
            error.reason.contains("or one that ships: dc_motor"),
            "{error}"
        );
    }
}
