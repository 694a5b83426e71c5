//! `canrig signals`: what a scenario, a recording or canrig's built-in drive and controller put on the bus, by the names that `[expect]` takes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use dbc::{Database, Message, Signal};
use scenario::loops::Loops;
use scenario::{Scenario, ScenarioError, read_text};
use serde::Serialize;

use crate::console::print;
use crate::exit::Exit;
use crate::recorded::{RecordedError, read_played, refuse, require_run};
use report::terminal;
use rig::FILE_BYTES_MAX;
use rig::setup::Setup;
use worlds::catalogue::catalogue;

/// Limits from here on are shown with a power of ten.
const DIGITS_SHOWN_BELOW: f64 = 1e15;
/// Signals with more named values than this show their range only; `--json` has all names.
const LABELS_SHOWN_MAX: usize = 4;

/// Arguments of `signals`.
#[derive(Args, Debug)]
pub struct SignalsArgs {
    /// A run folder (the signals in its frames.dbc) or a scenario (those of its plant and control law); without it the
    /// signals of canrig's built-in drive and controller
    #[arg(value_name = "RUN|SCENARIO")]
    pub source: Option<PathBuf>,
    /// Print the signals as JSON, with all named values
    #[arg(long)]
    pub json: bool,
}

/// One signal as it is listed.
#[derive(Debug, Serialize)]
struct ListedSignal<'a> {
    /// The name that no other signal has: `message.signal`.
    path: String,
    signal: &'a str,
    unit: &'a str,
    /// The node.
    #[serde(skip_serializing_if = "Option::is_none")]
    sender: Option<&'a str>,
    message: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    minimum: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    maximum: Option<f64>,
    /// Values that have a name, each with its name.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    values: Vec<(f64, &'a str)>,
}

impl<'a> ListedSignal<'a> {
    fn of(message: &'a Message, signal: &'a Signal) -> Self {
        let coding = &signal.coding;
        let physical = |raw: i64| raw as f64 * coding.factor + coding.offset;
        let labels = signal.labels.iter();
        Self {
            path: format!("{}.{}", message.name, signal.name),
            signal: &signal.name,
            unit: &signal.unit,
            sender: message.sender.as_deref(),
            message: &message.name,
            minimum: coding.range.map(|range| range.minimum),
            maximum: coding.range.map(|range| range.maximum),
            values: labels
                .map(|(raw, label)| (physical(*raw), label.as_str()))
                .collect(),
        }
    }

    /// From the smallest value to the largest, or the few values that it has, with their names.
    fn range(&self) -> String {
        if (1..=LABELS_SHOWN_MAX).contains(&self.values.len()) {
            let values: Vec<String> = self
                .values
                .iter()
                .map(|(value, label)| format!("{value} {label}"))
                .collect();
            return values.join(", ");
        }
        match (self.minimum, self.maximum) {
            (Some(minimum), Some(maximum)) => {
                format!("{} … {}", in_words(minimum), in_words(maximum))
            }
            _ => "–".to_owned(),
        }
    }
}

/// The ends of a floating-point number's range have 39 digits, of which nobody needs more than some.
fn in_words(limit: f64) -> String {
    match limit.abs() < DIGITS_SHOWN_BELOW {
        true => limit.to_string(),
        false => format!("{limit:.3e}"),
    }
}

/// Lists the signals.
#[must_use]
pub fn signals(args: &SignalsArgs) -> Exit {
    let database = match &args.source {
        None => Ok(Arc::new(Database::shipped().clone())),
        Some(source) => database_of(source),
    };
    match database {
        Err(error) => refuse(error),
        Ok(database) => {
            let signals = listed(&database);
            print(&match args.json {
                true => serde_json::to_string_pretty(&signals).expect("plain data"),
                false => table(&signals),
            });
            Exit::Pass
        }
    }
}

/// What the frames of a run folder or of a scenario mean. The signals that a scenario names need not be there: whoever
/// looks for the right name has a wrong one in the file.
fn database_of(source: &Path) -> Result<Arc<Database>, RecordedError> {
    if source.is_dir() {
        require_run(source)?;
        let (setups, _) = read_played(source, catalogue())?;
        return Ok(Arc::clone(&setups[0].database));
    }
    let of_scenario = || -> Result<_, ScenarioError> {
        let text = read_text(source, FILE_BYTES_MAX).unwrap_or_default();
        match Loops::is_meant(&text) {
            true => Ok(rig::loops::load(source, catalogue())?.swap_remove(0)),
            false => Ok(Setup::new(Scenario::load(source)?, catalogue())),
        }
    };
    let setup = of_scenario().map_err(|error| RecordedError::Scenario(Box::new(error)))?;
    Ok(setup.database)
}

/// Every signal that a frame carries, in the order of the identifiers.
fn listed(database: &Database) -> Vec<ListedSignal<'_>> {
    let audible = database
        .messages()
        .iter()
        .filter(|message| !message.is_silent());
    let signals = audible.flat_map(|message| {
        let signals = message.signals.iter();
        signals.map(move |signal| ListedSignal::of(message, signal))
    });
    signals.collect()
}

fn table(signals: &[ListedSignal<'_>]) -> String {
    let mut table = terminal::empty_table(["signal", "unit", "sender", "message", "range"]);
    for signal in signals {
        table.add_row([
            signal.signal,
            signal.unit,
            signal.sender.unwrap_or("–"),
            signal.message,
            &signal.range(),
        ]);
    }
    format!(
        "{table}\n{} signals. In [[expect.signal]] write the name of one as `signal`, or as `message.signal` where several \
         messages have it.",
        signals.len()
    )
}
