//! `canrig check`: checks scenario and rig files, without playing them.

use std::path::{Path, PathBuf};

use clap::Args;
use scenario::rig::nodes::Rig;

use crate::console::{failed, print, print_text};
use crate::exit::{Exit, Failure};
use crate::play::ValueArgs;
use crate::scenarios::{load, rig_text, scenario_files};
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
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Checks the files and prints for each whether it is valid.
pub fn check(args: &CheckArgs) -> Result<Exit, Failure> {
    let mut worst = Exit::Pass;
    for path in scenario_files(&args.scenarios, |_| true)? {
        if let Err(failure) = checked(&path, &args.values) {
            worst = worst.max(failed(failure));
        }
    }
    Ok(worst)
}

/// Checks a file, and prints what there is to say of a valid one.
fn checked(path: &Path, values: &ValueArgs) -> Result<(), Failure> {
    let print_valid = |name: String| print(&format!("{}: valid ({name})", path.display()));
    let text = rig_text(path).unwrap_or_default();
    if Rig::is_meant(&text) {
        let plan = Plan::from_rig(path, &text, catalogue())?;
        print_valid(format!("rig: {}", plan.shared.rig.name));
        print_notes(
            plan.shared
                .rig
                .notes()
                .into_iter()
                .chain(plan.sheet_notes()),
        );
        print_text(&arithmetic(&BusBudget::new(&plan)));
        return Ok(());
    }
    let plan = load(path, values)?;
    let Shared { run, sweep, .. } = &plan.shared;
    print_valid(match sweep {
        Some(sweep) => format!("{}, {} runs in a sweep", run.name, sweep.runs()),
        None => run.name.clone(),
    });
    print_notes(plan.sheet_notes());
    Ok(())
}

fn print_notes(notes: impl IntoIterator<Item = String>) {
    for note in notes {
        print(&format!("note: {note}"));
    }
}

/// Describes the traffic in a cycle, and whether it fits.
fn arithmetic(bus: &BusBudget) -> Text {
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
    let mut text = Text::default();
    text.table(&table);
    text.line(format!(
        "Bits are counted with as many stuff bits as a frame can have.\n\
         {period} ms at {bitrate} kbit/s are {available:.0} bits between two SYNCs. The fullest cycle needs {needed:.0} of them; \
         over many cycles the load is {load:.0} %.\n\
         {shortest}"
    ));
    text
}
