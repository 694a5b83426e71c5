//! `canrig fmu`: shows the description of an FMU without loading it, and writes the plants of the bench as FMUs.

pub(crate) mod export;

use std::path::{Path, PathBuf};

use clap::Args;
use comfy_table::{ContentArrangement, Table, presets};
use fmu::Archive;
use fmu::description::{Causality, Description, Variable};
use fmu::table::proposed;

use runner::console::print;
use runner::exit::{Exit, Failure};

/// Arguments of `fmu`.
#[derive(Args, Debug)]
pub(crate) struct FmuArgs {
    /// The FMU
    #[arg(required_unless_present = "export")]
    pub file: Option<PathBuf>,
    /// Print the table of a rig file that has it as a plant, with its variables as ports
    #[arg(long, requires = "file")]
    pub rig: bool,
    /// Write a plant as an FMU for this machine: `sma`, `dc_motor`, `sma_pair`, or one of this bench's own
    #[arg(long, value_name = "PLANT", conflicts_with = "file")]
    pub export: Option<String>,
    /// The FMU to write; an existing file is not overwritten [default: PLANT.fmu]
    #[arg(long, short, value_name = "FILE", requires = "export")]
    pub output: Option<PathBuf>,
    /// Its FMI: 2 or 3
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(2..=3), requires = "export")]
    pub fmi: u8,
}

/// Prints the description of an FMU, or writes an FMU.
pub(crate) fn fmu(args: &FmuArgs) -> Result<Exit, Failure> {
    let text = match (&args.export, &args.file) {
        (Some(plant), _) => export::export(plant, args.output.as_deref(), args.fmi)?,
        (None, Some(file)) => shown(file, args.rig)?,
        (None, None) => return Ok(Exit::Usage),
    };
    print(&text);
    Ok(Exit::Pass)
}

fn shown(file: &Path, is_rig: bool) -> Result<String, Failure> {
    let archive = Archive::open(file).map_err(|error| Exit::CannotStart.because(error))?;
    Ok(if is_rig {
        proposed_table(file, &archive.description)
    } else {
        told(&archive)
    })
}

/// Returns the table of a rig file, and the next steps for the user.
fn proposed_table(file: &Path, description: &Description) -> String {
    let name = plant_name(&description.model_name);
    let file = file.display().to_string();
    let table = proposed(&name, &file, description);
    format!(
        "# For a rig file. Leave out the ports and start values that you do not need;\n# the name of a port ends in the unit that it has on the bench.\n{}",
        table.trim_end()
    )
}

/// Returns a name for the plant: the name of the model, in the letters that a table may have.
fn plant_name(model_name: &str) -> String {
    let word = |character: char| match character {
        'a'..='z' | 'A'..='Z' | '0'..='9' => character.to_ascii_lowercase(),
        _ => '_',
    };
    let name = String::from_iter(model_name.chars().take(32).map(word));
    match name.trim_matches(|first: char| !first.is_ascii_lowercase()) {
        "" => "plant".to_owned(),
        name => name.to_owned(),
    }
}

fn told(archive: &Archive) -> String {
    let description = &archive.description;
    let mut text = format!(
        "{}: {}, FMI {}",
        archive.file.display(),
        description.model_name,
        description.version.name()
    );
    let facts = [
        (", version ", &description.model_version),
        (", made by ", &description.tool),
        ("\n", &description.description),
    ];
    for (label, fact) in facts.into_iter().filter(|(_, fact)| !fact.is_empty()) {
        text += label;
        text += fact.trim();
    }
    text += &format!("\nplatforms: {}\n", platforms(archive));
    text += &steps(description);
    for (title, of) in [
        ("inputs", Causality::Input),
        ("outputs", Causality::Output),
        ("parameters", Causality::Parameter),
    ] {
        let is_it = |variable: &&Variable| variable.causality == of;
        text += &listed(title, description.variables.iter().filter(is_it));
    }
    let shown = [Causality::Input, Causality::Output, Causality::Parameter];
    let variables = description.variables.iter();
    let others = variables.filter(|variable| !shown.contains(&variable.causality));
    text += &format!("\nother variables: {}\n", others.count());
    for need in description.not_served() {
        text += &format!("note: {need}\n");
    }
    text.trim_end().to_owned()
}

fn platforms(archive: &Archive) -> String {
    let here = archive.description.version.platform();
    let named = archive.platforms.iter().map(|platform| {
        if platform == here {
            format!("{platform} (this machine)")
        } else {
            platform.clone()
        }
    });
    let mut named = Vec::from_iter(named);
    if !archive.platforms.iter().any(|platform| platform == here) {
        named.push(format!("not {here}, which this machine needs"));
    }
    named.join(", ")
}

fn steps(description: &Description) -> String {
    let Some(co_simulation) = &description.co_simulation else {
        return String::new();
    };
    let length = match (co_simulation.takes_any_step, description.step_seconds) {
        (true, None) => "of any length".to_owned(),
        (true, Some(step)) => format!("of any length; it recommends {step} s"),
        (false, step) => match co_simulation.fixed_step_seconds.or(step) {
            Some(step) => format!("of {step} s only"),
            None => {
                "of one length only, which it does not say: step_milliseconds is needed".to_owned()
            }
        },
    };
    let events = if co_simulation.has_event_mode {
        "; it has events"
    } else {
        ""
    };
    format!("steps: {length}{events}\n")
}

fn listed<'a>(title: &str, variables: impl Iterator<Item = &'a Variable>) -> String {
    let mut table = Table::new();
    table
        .load_style(presets::NOTHING)
        .set_content_arrangement(ContentArrangement::Dynamic);
    let row = |variable: &Variable| {
        let start = variable.start.as_deref();
        [
            format!("  {}", variable.name),
            variable.unit.clone().unwrap_or_default(),
            start.map_or_else(String::new, |start| format!("start {start}")),
            variable.description.clone(),
        ]
    };
    table.add_rows(variables.map(row));
    match table.row_count() {
        0 => format!("\n{title}: none\n"),
        _ => format!("\n{title}\n{}\n", table.trim_fmt()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plant_is_named_after_its_model() {
        assert_eq!(plant_name("Pendulum"), "pendulum");
        assert_eq!(plant_name("Modelica.Blocks.PID"), "modelica_blocks_pid");
        assert_eq!(plant_name("3D"), "d");
        assert_eq!(plant_name("…"), "plant");
    }
}
