//! A program of the tests: plays an FMU alone, without a bench. They compare its output with that of other programs.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use dbc::{Port, Ports};
use fmu::export::Role;
use fmu::table::{Wiring, wiring};
use fmu::{Archive, Configuration, FmuError, StartValue};
use platform::clock::Clock;
use platform::keeper;
use runner::console::{failed, print};
use runner::exit::{Exit, Failure};
use scenario::plant::Fmu;
use worlds::fmu_worker::{self, RemoteFmu};

/// Plays an FMU, and prints its outputs as CSV
#[derive(Debug, Parser)]
struct PlayArgs {
    /// A file with one table [plant.NAME.fmu]
    #[arg(required_unless_present = "plant")]
    table: Option<PathBuf>,
    /// The emulator's own plant in its place, by the name of its FMU
    #[arg(long, conflicts_with = "table")]
    plant: Option<String>,
    /// A parameter of that plant
    #[arg(long, value_name = "NAME=VALUE", requires = "plant")]
    start: Vec<String>,
    /// Time between two rows
    #[arg(long, default_value_t = 1.0)]
    step_milliseconds: f64,
    /// Number of rows after that at time 0
    #[arg(long, default_value_t = 1000)]
    steps: u32,
    /// A table of inputs, by the names of their ports: a row for each step, the last for all further ones
    #[arg(long)]
    inputs: Option<PathBuf>,
    /// Print how long a step took, in place of the values
    #[arg(long)]
    cost: bool,
}

/// Returns the failure of a file of the command line.
fn of_file(path: &Path, reason: impl Display) -> Failure {
    Exit::CannotStart.because(format!("{}: {reason}", path.display()))
}

/// Returns the failure of an FMU, before or during its play.
fn of_fmu(error: FmuError) -> Failure {
    if error.fault.is_of_run() {
        Exit::VerdictFailed.because(error)
    } else {
        Exit::CannotStart.because(error)
    }
}

fn main() -> ExitCode {
    // The worker that alone loads the FMU, and its keeper, are this program, too, as those of a bench are canrig.
    let is_hidden = |word| word == fmu_worker::SUBCOMMAND || word == keeper::SUBCOMMAND;
    if std::env::args_os().nth(1).is_some_and(is_hidden) {
        return canrig::Bench::new().main();
    }
    play(&PlayArgs::parse()).into()
}

fn play(args: &PlayArgs) -> Exit {
    let played = match (&args.table, &args.plant) {
        (Some(table), _) => fmu_played(args, table),
        (None, plant) => plant_played(args, plant.as_deref().unwrap_or_default()),
    };
    match played {
        Ok(()) => Exit::Pass,
        Err(failure) => failed(failure),
    }
}

/// Plays the plant that an FMU is made of, without FMI.
fn plant_played(args: &PlayArgs, name: &str) -> Result<(), Failure> {
    let refused = |reason: &str| Exit::Usage.because(format!("{name}: {reason}"));
    let shipped = fmu_plants::shipped();
    let mut plants = shipped.iter();
    let exported = plants
        .find(|exported| exported.name() == name)
        .ok_or_else(|| refused("is no plant that ships"))?;
    let model = exported.model().map_err(|reason| refused(&reason))?;
    let variables = model.variables;
    let parameters = variables.iter().filter_map(|variable| {
        let given = args.start.iter().find_map(|word| {
            let value = word.strip_prefix(&variable.name)?.strip_prefix('=')?;
            value.parse().ok()
        });
        match (variable.role.start()?, given) {
            (StartValue::Number(_), Some(given)) => Some(StartValue::Number(given)),
            (usual, _) => Some(usual),
        }
    });
    let parameters = Vec::from_iter(parameters);
    let mut plant = exported
        .start(&parameters)
        .map_err(|reason| refused(&reason))?;
    let ports = |is_wanted: fn(&Role) -> bool| {
        let wanted = variables
            .iter()
            .filter(move |variable| is_wanted(&variable.role));
        let endless = [f64::NEG_INFINITY, f64::INFINITY];
        wanted.map(move |variable| Port::output(&variable.name, endless))
    };
    let wiring = Wiring {
        configuration: Configuration::default(),
        ports: Ports {
            inputs: ports(|role| matches!(role, Role::Input(_))).collect(),
            outputs: ports(|role| *role == Role::Output).collect(),
        },
    };
    let outputs = plant.outputs();
    let step_seconds = args.step_milliseconds / 1e3;
    steps(args, &wiring, &outputs, |_, inputs, outputs| {
        plant.step(step_seconds, inputs);
        outputs.copy_from_slice(&plant.outputs());
        Ok(())
    })
}

fn fmu_played(args: &PlayArgs, path: &Path) -> Result<(), Failure> {
    let (name, table) = plant_table(path)?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let archive = Archive::open(&folder.join(&table.file)).map_err(of_fmu)?;
    let wiring = wiring(&table, &name, &archive.description).map_err(|misfit| {
        of_fmu(FmuError {
            file: archive.file.clone(),
            fault: misfit.fault,
        })
    })?;
    let unpacked = archive.unpack().map_err(of_fmu)?;
    let mut at_start = vec![0.0; wiring.ports.outputs.len()];
    let mut remote =
        RemoteFmu::load(&unpacked, &wiring.configuration, &mut at_start).map_err(of_fmu)?;
    steps(args, &wiring, &at_start, |to_seconds, inputs, outputs| {
        let advanced = remote.advance(to_seconds, inputs, outputs);
        advanced.map_err(of_fmu)
    })
}

/// Steps the plant, and prints its outputs or the duration of a step.
fn steps(
    args: &PlayArgs,
    wiring: &Wiring,
    at_start: &[f64],
    mut advance: impl FnMut(f64, &[f64], &mut [f64]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let rows = match &args.inputs {
        Some(path) => input_rows(path, wiring)?,
        None => Vec::new(),
    };
    let mut outputs = at_start.to_owned();
    let mut inputs = vec![0.0; wiring.ports.inputs.len()];
    if !args.cost {
        let ports = wiring.ports.outputs.iter();
        let names = ports.map(|port| port.name.as_str());
        print(&Vec::from_iter(std::iter::once("time_seconds").chain(names)).join(","));
        print(&row(0.0, at_start));
    }
    let clock = Clock::start();
    for step in 1..=args.steps {
        let index = (step - 1) as usize;
        if let Some(row) = rows.get(index).or(rows.last()) {
            inputs.clone_from(row);
        }
        let to_seconds = f64::from(step) * args.step_milliseconds / 1e3;
        advance(to_seconds, &inputs, &mut outputs)?;
        if !args.cost {
            print(&row(to_seconds, &outputs));
        }
    }
    if args.cost {
        let passed = clock.now().as_secs_f64() * 1e6;
        let microseconds = passed / f64::from(args.steps.max(1));
        print(&format!("{microseconds:.2} microseconds a step"));
    }
    Ok(())
}

/// Reads the only table of a file; returns it with the name of its plant.
fn plant_table(path: &Path) -> Result<(String, Fmu), Failure> {
    type File = BTreeMap<String, BTreeMap<String, BTreeMap<String, Fmu>>>;
    let refused = |reason: String| of_file(path, reason);
    let text = fs::read_to_string(path).map_err(|error| refused(error.to_string()))?;
    let file: File = toml::from_str(&text).map_err(|error| refused(error.to_string()))?;
    let plants = file.into_iter().filter(|(key, _)| key == "plant");
    let mut plants = plants.flat_map(|(_, plants)| plants);
    let plant = plants
        .next()
        .and_then(|(name, mut kinds)| Some((name, kinds.remove("fmu")?)));
    plant.ok_or_else(|| refused("it has no table [plant.NAME.fmu]".to_owned()))
}

/// Reads the inputs of each step, in the order of the configuration.
fn input_rows(path: &Path, wiring: &Wiring) -> Result<Vec<Vec<f64>>, Failure> {
    let refused = |reason: String| of_file(path, reason);
    let text = fs::read_to_string(path).map_err(|error| refused(error.to_string()))?;
    let mut lines = text.lines();
    let names = Vec::from_iter(lines.next().unwrap_or_default().split(','));
    let columns = wiring.ports.inputs.iter().map(|port| {
        let column = names.iter().position(|name| *name == port.name);
        column.ok_or_else(|| refused(format!("it has no column {}", port.name)))
    });
    let columns = columns.collect::<Result<Vec<_>, Failure>>()?;
    let row = |line: &str| {
        let cells = Vec::from_iter(line.split(','));
        let values = columns.iter().map(|column| {
            let cell = cells.get(*column).copied().unwrap_or_default();
            cell.parse()
                .map_err(|_| refused(format!("`{cell}` is no number")))
        });
        values.collect::<Result<Vec<_>, Failure>>()
    };
    lines.map(row).collect()
}

fn row(time_seconds: f64, outputs: &[f64]) -> String {
    let cells = std::iter::once(time_seconds).chain(outputs.iter().copied());
    Vec::from_iter(cells.map(|value| value.to_string())).join(",")
}
