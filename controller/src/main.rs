//! `controller --bus can0 --scenario S`: the controller as a process of its own, started by hand or on another machine.
#![expect(
    clippy::print_stderr,
    reason = "a program that is started by hand says how it went"
)]

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use controller::ControllerNode;
use controller::process_law::no_player;
use miette::IntoDiagnostic;
use platform::bus::BusAddress;
use platform::stop::StopSignal;
use platform::terminal::printable;
use platform::{real_time, scheduling};
use scenario::{Beside, Scenario, text_of, without_colours};

/// Leads the drive on a CAN bus through a scenario until it is stopped (Ctrl-C).
///
/// Exit codes: 0 stopped, 2 usage, 3 scenario or rig invalid, 4 bus or drive failed.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// CAN interface such as can0, or embedded:/path/to/socket.
    #[arg(long)]
    bus: BusAddress,
    /// Scenario file; its plant, disturbances and limits are ignored.
    #[arg(long)]
    scenario: PathBuf,
}

const SCENARIO_INVALID: u8 = 3;
const FAILED: u8 = 4;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let outcome = controller(&arguments)
        .map_err(|error| (SCENARIO_INVALID, error))
        .and_then(|node| run(&arguments.bus, node).map_err(|error| (FAILED, error)));
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err((code, error)) => {
            eprintln!("{}", printable(&without_colours(error.as_ref())));
            ExitCode::from(code)
        }
    }
}

fn controller(arguments: &Arguments) -> miette::Result<ControllerNode> {
    let path = &arguments.scenario;
    let (beside, text) = (Beside::new(path), text_of(path)?);
    let (scenario, _) = Scenario::parse_view(&beside, text, |name| beside.read(name))?;
    let Scenario {
        rig, loops, sheets, ..
    } = scenario;
    let loops = loops.iter().map(|one| {
        let drive = &one.wiring.nodes.drive.name;
        let eds = sheets.get(drive).map_or(dbc::DRIVE_EDS, String::as_str);
        (one.controller_view(), rig.real_drive(drive), eds)
    });
    let loops = Vec::from_iter(loops);
    let loops = loops
        .iter()
        .map(|(view, real, eds)| (view, real.as_ref().map(|real| (real, *eds))));
    ControllerNode::of_loops(loops, &no_player).into_diagnostic()
}

fn run(address: &BusAddress, mut node: ControllerNode) -> miette::Result<()> {
    let stop = StopSignal::from_signals().into_diagnostic()?;
    let mut bus = platform::open(address, &can::Node::filters(&node)).into_diagnostic()?;
    let scheduling = scheduling::request();
    scheduling
        .refusals()
        .for_each(|refused| eprintln!("warning: {refused}"));
    let report = real_time::run(&mut node, bus.as_mut(), &stop).into_diagnostic()?;
    eprintln!("{}; {report}", node.statistics());
    Ok(())
}
