//! `canrig check`: checks scenario and rig files, without playing them.

use std::path::{Path, PathBuf};

use clap::Args;
use scenario::rig::nodes::Rig;
use serde::Serialize;

use crate::console::{failed, print, print_text};
use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::scenarios::{is_left_by_a_play, kind_of, load, rig_text, scenario_files};
use plan::bus_budget::{BusBudget, Pace};
use plan::{Plan, Shared};
use report::table::{Cell, Table, Text};
use worlds::catalogue::catalogue;

/// Arguments of `check`.
#[derive(Args, Debug)]
pub struct CheckArgs {
    /// Scenario or rig files, or folders of them
    #[arg(required = true, value_name = "FILE")]
    pub scenarios: Vec<PathBuf>,
    /// Print the files with their kinds and problems as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// File that was checked.
#[derive(Debug, Serialize)]
struct CheckedFile {
    path: String,
    /// `scenario`, `sweep`, `rig`, or `other` for a file that is none of these by its text.
    kind: &'static str,
    /// Whether it lies in the folder of a run or of a campaign, which wrote it.
    is_left_by_a_play: bool,
    /// First line of what is wrong; `None` for a valid file.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

/// Checks the files and prints for each whether it is valid.
pub fn check(args: &CheckArgs) -> Result<Exit, Failure> {
    let mut worst = Exit::Pass;
    let mut files = Vec::new();
    for path in scenario_files(&args.scenarios, |_| true)? {
        let checked = check_file(&path, &args.values);
        if args.json {
            let failure = checked.err();
            worst = worst.max(failure.as_ref().map_or(Exit::Pass, |failure| failure.exit));
            files.push(CheckedFile {
                path: path.to_string_lossy().into_owned(),
                kind: kind_of(&path).word(),
                is_left_by_a_play: is_left_by_a_play(&path),
                problem: failure.map(|failure| failure.reason),
            });
            continue;
        }
        match checked {
            Ok(text) => print_text(&text),
            Err(failure) => worst = worst.max(failed(failure)),
        }
    }
    if args.json {
        print(&serde_json::to_string_pretty(&files).expect("plain data"));
    }
    Ok(worst)
}

/// Checks a file; returns what there is to say of a valid one.
fn check_file(path: &Path, values: &ValueArgs) -> Result<Text, Failure> {
    let mut said = Text::default();
    let valid = |name: String| format!("{}: valid ({name})", path.display());
    let text = rig_text(path).unwrap_or_default();
    if Rig::is_meant(&text) {
        let plan = Plan::from_rig(path, &text, catalogue())?;
        said.line(valid(format!("rig: {}", plan.shared.rig.name)));
        let notes = plan.shared.rig.notes().into_iter();
        add_notes(&mut said, notes.chain(plan.sheet_notes()));
        describe_traffic(&BusBudget::new(&plan), &mut said);
        return Ok(said);
    }
    let plan = load(path, values)?;
    let Shared { run, sweep, .. } = &plan.shared;
    said.line(valid(match sweep {
        Some(sweep) => format!("{}, {} runs in a sweep", run.name, sweep.runs()),
        None => run.name.clone(),
    }));
    add_notes(&mut said, plan.sheet_notes());
    Ok(said)
}

fn add_notes(text: &mut Text, notes: impl IntoIterator<Item = String>) {
    for note in notes {
        text.line(format!("note: {note}"));
    }
}

/// Describes the traffic in a cycle, and whether it fits.
fn describe_traffic(bus: &BusBudget, text: &mut Text) {
    let mut table = Table::new(["node", "sends", "bits", "comes in"]);
    for share in &bus.shares {
        let comes = match share.pace {
            Pace::Cycles { every: 1, .. } => "every cycle".to_owned(),
            Pace::Cycles { every, .. } => format!("one cycle in {every}"),
            Pace::Milliseconds(period) => format!("every {period} ms, in gaps"),
        };
        table.add([
            Cell::new(&share.node),
            Cell::new(&share.what),
            Cell::number(format!("{:.0}", share.bits)),
            Cell::new(comes),
        ]);
    }
    let (period, bitrate) = (bus.period_milliseconds, bus.bitrate_kilobits_per_second);
    let (available, load) = (bus.available_bits(), bus.load_percent());
    let needed = bus.needed_bits();
    let shortest = bus
        .period_milliseconds_min()
        .map_or_else(String::new, |period| {
            format!("The shortest sync_period_milliseconds that fits is {period:.1}.\n")
        });
    text.table(&table);
    text.line(format!(
        "Bits are counted with as many stuff bits as a frame can have.\n\
         {period} ms at {bitrate} kbit/s are {available:.0} bits between two SYNCs. The fullest cycle needs {needed:.0} of them; \
         over many cycles the load is {load:.0} %.\n\
         {shortest}"
    ));
}
