//! Tools to debug nodes: the nodes on a bus (`nodes`), one object (`sdo`), live traffic (`monitor`).
//!
//! A tool is a guest on the bus. The default SDO channel of a node belongs to the controller while one runs
//! ([`plan::presence`]), so a guest asks on the second channel where the node's data sheet has one.

pub(crate) mod monitor;
pub(crate) mod nodes;
pub(crate) mod sdo;
pub(crate) mod value;

use clap::Args;
use runner::console::print_error;
use std::path::PathBuf;
use std::time::Duration;

use can::Filter;
use canopen::sdo_client::{SdoClient, SdoError};
use platform::bus::{Bus, BusAddress};
use platform::hub;
use platform::stop::StopSignal;

use plan::data_sheet::DataSheet;
use plan::named_nodes::NamedNodes;
use runner::exit::{Exit, Failure};
use runner::named::named_nodes;
use runner::number;
use scenario::TIME_SECONDS_MAX;
use worlds::guest::{Guest, GuestError};

/// Address of the bus that a tool joins; `None` for the embedded bus of the user's only running `canrig run`.
pub(crate) type ToolBus = Option<BusAddress>;

fn tool_bus(text: &str) -> Result<ToolBus, String> {
    match text {
        "embedded" => Ok(None),
        address => address.parse().map(Some),
    }
}

/// The bus that a tool joins.
#[derive(Args, Debug)]
pub(crate) struct ToolBusArgs {
    /// The bus: `embedded` (that of your only run), `embedded:/path` or `private:number` as a run prints it, or an
    /// interface
    #[arg(long, value_name = "BUS", value_parser = tool_bus)]
    pub bus: Option<ToolBus>,
}

impl ToolBusArgs {
    /// Returns the bus: the named one, or that of the only running run.
    fn chosen(&self) -> ToolBus {
        self.bus.clone().flatten()
    }
}

/// Names of the nodes.
#[derive(Args, Debug)]
pub(crate) struct NamesArgs {
    /// Rig file, scenario or run folder with the nodes on the bus, which then have their names here
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
}

impl NamesArgs {
    /// Returns the nodes by name: those of the user's rig, or those of the rig that ships.
    fn nodes(&self) -> Result<NamedNodes, Failure> {
        let Some(path) = &self.rig else {
            return Ok(NamedNodes::shipped());
        };
        named_nodes(path)
    }
}

/// Parses a time from 0 to that of the longest run.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let limits = format!("the time must be from 0 to {TIME_SECONDS_MAX} seconds");
    let expected = "a number of seconds is expected";
    number::parse(text, 0.0..=TIME_SECONDS_MAX, expected, limits)
}

/// Reason why a tool failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ToolError {
    /// An argument or a file is wrong, there is not one run to join, signals cannot be handled, or the bus does not work.
    #[error(transparent)]
    Failed(#[from] Failure),
    /// A transfer failed.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// The tool would disturb a running controller.
    #[error("{0}")]
    Refused(String),
    /// Ctrl-C or SIGTERM came before the end.
    #[error("interrupted")]
    Interrupted,
}

impl From<ToolError> for Failure {
    fn from(error: ToolError) -> Self {
        match error {
            ToolError::Failed(failure) => failure,
            error => Exit::BenchFailed.because(error),
        }
    }
}

impl From<GuestError> for ToolError {
    fn from(error: GuestError) -> Self {
        match error {
            GuestError::Bus(error) => Self::Failed(error.into()),
            GuestError::Interrupted => Self::Interrupted,
        }
    }
}

/// Time within which a node answers a guest.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// Joins a bus as a guest that hears all frames.
fn guest(bus: &ToolBus) -> Result<Guest<'static>, Failure> {
    let stop = stop_signal()?;
    Ok(Guest::new(open(bus, &[Filter::ALL])?, move || {
        stop.is_raised()
    }))
}

/// Handles Ctrl-C and SIGTERM.
fn stop_signal() -> Result<StopSignal, Failure> {
    StopSignal::from_signals()
        .map_err(|error| Exit::BenchFailed.because(format!("signals cannot be handled: {error}")))
}

/// Returns a client of a node: on its default channel, or on another one.
fn client(node_id: u8, channel: Option<(u16, u16)>) -> SdoClient {
    let client = SdoClient::new(node_id).with_timeout(ANSWER_TIME);
    match channel {
        Some((request, response)) => client.with_channel(request, response),
        None => client,
    }
}

/// Returns the second SDO channel of a node, if one of its data sheets has it.
fn second_channel(node_id: u8, sheets: &[DataSheet]) -> Option<(u16, u16)> {
    let mut sheets = sheets.iter().filter(|sheet| sheet.node_id == node_id);
    sheets.find_map(DataSheet::second_channel)
}

/// Returns the address of the bus that the user means.
///
/// # Errors
/// The user named no bus, and not exactly one run is running.
pub(crate) fn address(bus: &ToolBus) -> Result<BusAddress, Failure> {
    if let Some(address) = bus {
        return Ok(address.clone());
    }
    match &hub::running()[..] {
        [] => Err(Exit::BenchFailed.because(
            "no embedded bus of yours is running; start one with: canrig run SCENARIO --bus embedded (or name a CAN interface: --bus vcan0)",
        )),
        [only] => Ok(only.clone()),
        several => {
            let options = several.iter().map(|bus| format!("--bus {bus}"));
            let (count, options) = (several.len(), Vec::from_iter(options).join(", "));
            let text = format!("{count} embedded buses are running; choose one: {options}");
            Err(Exit::BenchFailed.because(text))
        }
    }
}

fn open(bus: &ToolBus, filters: &[Filter]) -> Result<Box<dyn Bus>, Failure> {
    let address = address(bus)?;
    if bus.is_none() {
        print_error(&format!("canrig: on the bus of your run, {address}"));
    }
    Ok(platform::open(&address, filters)?)
}
