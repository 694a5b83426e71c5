//! `canrig check`: checks scenario and rig files, without playing them.

use std::path::{Path, PathBuf};

use clap::Args;
use scenario::rig::nodes::Rig;

use crate::console::{print, print_diagnostic, print_text, start_error};
use crate::exit::Exit;
use crate::play::ValueArgs;
use crate::scenarios::{read, rig_text, scenario_files};
use plan::bus_budget::{BusBudget, Pace};
use plan::{Shared, check_rig};
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
#[must_use]
pub fn check(args: &CheckArgs) -> Exit {
    let paths = match scenario_files(&args.scenarios, |_| true) {
        Ok(paths) => paths,
        Err(error) => return start_error(&error),
    };
    let mut worst = Exit::Pass;
    for path in paths {
        match checked(&path, &args.values) {
            Ok(Valid { name, notes, bus }) => {
                print(&format!("{}: valid ({name})", path.display()));
                notes
                    .iter()
                    .for_each(|note| print(&format!("note: {note}")));
                bus.iter().for_each(|bus| print_text(&arithmetic(bus)));
            }
            Err(error) => {
                print_diagnostic(error);
                worst = worst.max(Exit::CannotStart);
            }
        }
    }
    worst
}

/// Valid scenario or rig file.
struct Valid {
    name: String,
    /// Remarks on a rig file: allowed entries that may be mistakes.
    notes: Vec<String>,
    /// Traffic of a rig file's nodes.
    bus: Option<BusBudget>,
}

fn checked(path: &Path, values: &ValueArgs) -> miette::Result<Valid> {
    let text = rig_text(path).unwrap_or_default();
    if Rig::is_meant(&text) {
        let (rig, bus) = check_rig(&text, &path.display().to_string(), catalogue())?;
        let name = format!("rig: {}", rig.name);
        return Ok(Valid {
            name,
            notes: rig.notes(),
            bus: Some(bus),
        });
    }
    let plan = read(path, values)?;
    let Shared { run, sweep, .. } = &plan.shared;
    let name = &run.name;
    let name = match sweep {
        Some(sweep) => format!("{name}, {} runs in a sweep", sweep.runs()),
        None => name.clone(),
    };
    Ok(Valid {
        name,
        notes: Vec::new(),
        bus: None,
    })
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
