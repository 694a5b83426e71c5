//! `canrig signals`: lists the signals of a scenario, a recording, or canrig's built-in drive and controller, by the names that
//! `[expect]` takes.

use std::path::{Path, PathBuf};

use clap::Args;
use dbc::{Database, Message, Signal};
use serde::Serialize;

use crate::console::{print, print_text};
use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::recorded::{read_played, require_run};
use crate::scenarios::{Use, load_for};
use plan::{ControlLoop, Plan};
use report::table::{Table, Text};
use worlds::catalogue::catalogue;

/// Least limit that is shown with a power of ten.
const DIGITS_SHOWN_BELOW: f64 = 1e15;
/// Largest number of named values that are shown for a signal. Others show their range only; `--json` has all names.
const LABELS_SHOWN_MAX: usize = 4;

/// Arguments of `signals`.
#[derive(Args, Debug)]
pub struct SignalsArgs {
    /// A run folder or a scenario; without it the signals of the controller and drive that ship
    #[arg(value_name = "RUN|SCENARIO")]
    pub source: Option<PathBuf>,
    /// List only signals with this text in their name, unit, sender, message or loop; of several each must be there
    #[arg(long, short, value_name = "TEXT")]
    pub filter: Vec<String>,
    /// Print the signals as JSON, with all named values
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Signal in the list.
#[derive(Debug, Serialize)]
struct ListedSignal<'a> {
    /// Loop in whose `[[expect.LOOP.signal]]` the name may be; `None` if there is one loop, or if all have the signal.
    #[serde(rename = "loop", skip_serializing_if = "Option::is_none")]
    loop_name: Option<&'a str>,
    /// Unique name of the signal: `message.signal`.
    path: String,
    signal: String,
    unit: &'a str,
    /// Node that sends the signal.
    #[serde(skip_serializing_if = "Option::is_none")]
    sender: Option<&'a str>,
    message: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    minimum: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    maximum: Option<f64>,
    /// Named values, each with its name.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    values: Vec<(f64, &'a str)>,
}

impl<'a> ListedSignal<'a> {
    fn of(
        database: &Database,
        one: Option<&'a ControlLoop>,
        message: &'a Message,
        signal: &'a Signal,
    ) -> Self {
        let coding = &signal.coding;
        let physical = |raw: i64| raw as f64 * coding.factor + coding.offset;
        let labels = signal.labels.iter();
        Self {
            loop_name: one.map(ControlLoop::name),
            path: format!("{}.{}", message.name, signal.name),
            signal: match one {
                Some(one) => one.name_of(database, message, signal),
                None => signal.name.clone(),
            },
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

    /// Returns whether one of the signal's names contains a text, ignoring case.
    fn has(&self, text: &str) -> bool {
        let texts = [
            self.path.as_str(),
            &self.signal,
            self.unit,
            self.sender.unwrap_or_default(),
            self.loop_name.unwrap_or_default(),
        ];
        let text = text.to_lowercase();
        texts.iter().any(|one| one.to_lowercase().contains(&text))
    }

    /// Returns the smallest and the largest value, or the few values that the signal has, with their names.
    fn range(&self) -> String {
        if (1..=LABELS_SHOWN_MAX).contains(&self.values.len()) {
            let named = |(value, label): &(f64, &str)| format!("{value} {label}");
            return Vec::from_iter(self.values.iter().map(named)).join(", ");
        }
        match (self.minimum, self.maximum) {
            (Some(minimum), Some(maximum)) => {
                format!("{} … {}", limit_text(minimum), limit_text(maximum))
            }
            _ => "–".to_owned(),
        }
    }
}

/// Writes a limit. The range of floating-point numbers has ends with 39 digits, of which some suffice.
fn limit_text(limit: f64) -> String {
    if limit.abs() < DIGITS_SHOWN_BELOW {
        limit.to_string()
    } else {
        format!("{limit:.3e}")
    }
}

/// Lists the signals.
pub fn signals(args: &SignalsArgs) -> Result<Exit, Failure> {
    let plan = args
        .source
        .as_deref()
        .map(|source| load_plan(source, &args.values));
    let plan = plan.transpose()?;
    let database = plan
        .as_ref()
        .map_or(Database::shipped(), |plan| plan.database());
    let loops = plan.as_ref().map_or(&[][..], |plan| &plan.loops);
    let mut signals = listed(database, loops);
    signals.retain(|signal| args.filter.iter().all(|text| signal.has(text)));
    if args.json {
        print(&serde_json::to_string_pretty(&signals).expect("plain data"));
    } else {
        print_text(&table(&signals));
    }
    Ok(Exit::Pass)
}

/// Returns the plan of a run folder or of a scenario.
fn load_plan(source: &Path, values: &ValueArgs) -> Result<Plan, Failure> {
    if source.is_dir() {
        require_run(source)?;
        if !values.is_empty() {
            let reason = "a run folder has its values and its program: leave out --set, --rig and `-- PROGRAM`";
            return Err(Exit::Usage.because(reason));
        }
        return Ok(read_played(source, catalogue())?.0);
    }
    let wanted = Use {
        takes_any_signal: true,
        ..Use::default()
    };
    load_for(source, values, &wanted)
}

/// Returns every signal in a frame, in the order of the identifiers, loop by loop; the signals that belong to no single loop come
/// first.
fn listed<'a>(database: &'a Database, loops: &'a [ControlLoop]) -> Vec<ListedSignal<'a>> {
    let several = if loops.len() > 1 { loops } else { &[] };
    let places = [None].into_iter().chain(several.iter().map(Some));
    let signals = places.flat_map(|place| {
        let is_here = move |(message, signal): &(&Message, &Signal)| {
            let is_of = |one: &ControlLoop| one.owns(database, &message.name, &signal.name);
            place.map_or_else(|| !several.iter().any(is_of), is_of)
        };
        let messages = database.messages().iter();
        let sent = messages
            .flat_map(|message| message.signals.iter().map(move |signal| (message, signal)))
            .filter(is_here);
        let followed = place.into_iter().flat_map(|one| one.followed(database));
        sent.chain(followed)
            .map(move |(message, signal)| ListedSignal::of(database, place, message, signal))
    });
    signals.collect()
}

fn table(signals: &[ListedSignal<'_>]) -> Text {
    let has_loops = signals.iter().any(|signal| signal.loop_name.is_some());
    let columns = ["signal", "unit", "sender", "message", "range"];
    let first = has_loops.then_some("loop");
    let mut table = Table::new(first.into_iter().chain(columns));
    for signal in signals {
        let range = signal.range();
        let sender = signal.sender.unwrap_or("–");
        let cells = [
            signal.signal.as_str(),
            signal.unit,
            sender,
            signal.message,
            &range,
        ];
        let loop_name = has_loops.then(|| signal.loop_name.unwrap_or("all"));
        table.add(loop_name.into_iter().chain(cells));
    }
    let place = if has_loops {
        "[[expect.LOOP.signal]]"
    } else {
        "[[expect.signal]]"
    };
    let mut text = Text::default();
    text.table(&table);
    text.line(format!(
        "{} signals. In {place} write the name of one as `signal`, or as `message.signal` where several messages have it.",
        signals.len()
    ));
    text
}
