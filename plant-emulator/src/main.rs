//! `plant-emulator --bus can0 --scenario S`: the emulator as a process of its own, started by hand or on another
//! machine.
#![expect(
    clippy::print_stderr,
    reason = "a program that is started by hand says how it went"
)]

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use miette::{IntoDiagnostic, Report};
use plant_emulator::catalogue;
use platform::bus::BusAddress;
use platform::stop::StopSignal;
use platform::terminal::printable;
use platform::{real_time, scheduling};
use scenario::{Trial, without_colours};

/// Plays the drive with its plant, and the fan and load module, on a CAN bus until it is stopped (Ctrl-C).
///
/// Exit codes: 0 stopped, 2 usage, 3 scenario invalid, 4 bus or emulator failed.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// CAN interface such as can0, or embedded:/path/to/socket.
    #[arg(long)]
    bus: BusAddress,
    /// Scenario file; its plant is emulated.
    #[arg(long)]
    scenario: PathBuf,
}

const SCENARIO_INVALID: u8 = 3;
const FAILED: u8 = 4;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let outcome = Trial::load(&arguments.scenario)
        .map_err(|error| (SCENARIO_INVALID, Report::new(error)))
        .and_then(|trial| run(&arguments.bus, &trial).map_err(|error| (FAILED, error)));
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err((code, error)) => {
            eprintln!("{}", printable(&without_colours(error.as_ref())));
            ExitCode::from(code)
        }
    }
}

fn run(address: &BusAddress, trial: &Trial) -> miette::Result<()> {
    let mut node = catalogue::emulator(trial).into_diagnostic()?;
    let stop = StopSignal::from_signals().into_diagnostic()?;
    let mut bus = platform::open(address, &node.filters()).into_diagnostic()?;
    let scheduling = scheduling::request();
    scheduling
        .refusals()
        .for_each(|refused| eprintln!("warning: {refused}"));
    let report = real_time::run(&mut *node, bus.as_mut(), &stop).into_diagnostic()?;
    eprintln!("{report}");
    Ok(())
}
