//! `canrig nodes`: lists the nodes on a bus.
//!
//! First the tool listens: heartbeats show nodes and their states, SYNC and heartbeats show whether a manager runs.
//! Without a manager it then calls every node-ID on its default SDO channel, so that nodes without a heartbeat show
//! too. At last it asks each node for its identity. It uses the second SDO channel if the node's data sheet has one and
//! the node answers there, else the default channel. It does not ask on a default channel that belongs to a running
//! controller.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Duration;

use can::CanFrame;
use canopen::NmtState;
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID};
use canopen::sdo_client::{SdoClient, SdoFailure};
use clap::Args;

use super::{NamesArgs, ToolBusArgs, ToolError, client, guest, second_channel, seconds};
use plan::data_sheet::DataSheet;
use plan::presence::{Presence, is_manager};
use report::table::Table;
use runner::console::print;
use runner::exit::{Exit, Failure};
use worlds::guest::Guest;

/// Default time for which the tool listens before it speaks: longer than usual heartbeat periods.
const LISTEN_SECONDS: f64 = 1.0;
/// Pause between two calls; it leaves room for the answers on a slow bus.
const CALL_PERIOD: Duration = Duration::from_millis(2);
/// Longest time to the answer of the last node called.
const CALL_PATIENCE: Duration = Duration::from_millis(500);
const NODE_IDS: std::ops::RangeInclusive<u8> = 1..=127;

const DEVICE_TYPE: (u16, u8) = (0x1000, 0);
const DEVICE_NAME: (u16, u8) = (0x1008, 0);
const IDENTITY: u16 = 0x1018;

/// Answers of a node; `None` for an object that it aborted.
#[derive(Debug)]
struct Identity {
    /// 0x1000
    device_type: Option<u32>,
    /// 0x1018:01 to :04
    identity: [Option<u32>; 4],
    /// 0x1008
    name: Option<String>,
}

/// The roll call of a bus.
#[derive(Debug, Default)]
struct RollCall {
    sheets: Vec<DataSheet>,
    /// Names of the nodes in the user's rig.
    names: BTreeMap<u8, String>,
    /// Time for which it listens first.
    listen: Duration,
    /// Nodes that were heard in that time.
    presence: Presence,
    /// Nodes that answered a call.
    called: BTreeSet<u8>,
    /// Identity of each node by its own answers, or the reason why it is unknown.
    identities: BTreeMap<u8, Result<Identity, String>>,
}

impl RollCall {
    fn play(&mut self, guest: &mut Guest<'_>) -> Result<(), ToolError> {
        let presence = &mut self.presence;
        // Later frames may be answers to this tool itself.
        guest.hear(self.listen, |frame| presence.on_frame(frame))?;
        if self.manager().is_none() {
            self.call_all(guest)?;
        }
        for node_id in self.present() {
            let identity = match self.identity(guest, node_id) {
                Err(error @ (ToolError::Refused(_) | ToolError::Sdo(_))) => Err(error.to_string()),
                identity => Ok(identity?),
            };
            self.identities.insert(node_id, identity);
        }
        Ok(())
    }

    /// Asks all node-IDs for their device type, one after the other, whatever answers.
    fn call_all(&mut self, guest: &mut Guest<'_>) -> Result<(), ToolError> {
        for node_id in NODE_IDS {
            let request = [0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0];
            let identifier = DEFAULT_REQUEST_ID + u16::from(node_id);
            guest.send(&CanFrame::new(identifier, &request))?;
            let is_last = node_id == *NODE_IDS.end();
            let time = if is_last { CALL_PATIENCE } else { CALL_PERIOD };
            guest.hear(time, |frame| self.called.extend(answer_to_call(frame)))?;
        }
        Ok(())
    }

    /// Returns the nodes that were heard or answered.
    fn present(&self) -> BTreeSet<u8> {
        let heard = self.presence.states().keys();
        heard.chain(&self.called).copied().collect()
    }

    /// Asks a node for its identity, on its second channel if it answers there.
    fn identity(&self, guest: &mut Guest<'_>, node_id: u8) -> Result<Identity, ToolError> {
        let refused = |reason: &str| Err(ToolError::Refused(reason.to_owned()));
        let channel = second_channel(node_id, &self.sheets);
        let is_taken = self
            .presence
            .why_not_default_channel(node_id, &self.sheets)
            .is_some();
        if self.presence.states().get(&node_id) == Some(&NmtState::Stopped) {
            return refused("not asked: a stopped node answers no SDO");
        }
        if channel.is_none() && is_taken {
            return refused("not asked: its only SDO channel is the controller's");
        }
        let mut asked = client(node_id, channel);
        let device_type = match read(guest, &mut asked, DEVICE_TYPE) {
            Err(ToolError::Sdo(_)) if channel.is_some() && is_taken => {
                return refused(
                    "no answer on its second SDO channel; the first is the controller's",
                );
            }
            Err(ToolError::Sdo(_)) if channel.is_some() => {
                asked = client(node_id, None);
                read(guest, &mut asked, DEVICE_TYPE)?
            }
            device_type => device_type?,
        };
        let number = |bytes: Option<Vec<u8>>| Some(u32::from_le_bytes(bytes?.try_into().ok()?));
        let mut identity = [None; 4];
        for (sub_index, part) in (1..).zip(&mut identity) {
            *part = number(read(guest, &mut asked, (IDENTITY, sub_index))?);
        }
        let name = read(guest, &mut asked, DEVICE_NAME)?;
        Ok(Identity {
            device_type: number(device_type),
            identity,
            name: name.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()),
        })
    }

    fn manager(&self) -> Option<String> {
        let is_manager = |node_id| is_manager(node_id, &self.sheets);
        self.presence.manager(is_manager)
    }

    /// Returns the text for a node: `18 (0x12) y`.
    fn node(&self, node_id: u8) -> String {
        let name = self
            .names
            .get(&node_id)
            .map_or_else(String::new, |name| format!(" {name}"));
        format!("{node_id} (0x{node_id:02X}){name}")
    }

    /// Returns the data sheet that matches the node's identity. Without an identity it is the sheet of this node-ID,
    /// with a question mark.
    fn data_sheet(&self, node_id: u8, identity: Option<&Identity>) -> String {
        // Drives of one product differ in their node-IDs only.
        let (with_id, others): (Vec<_>, Vec<_>) = self
            .sheets
            .iter()
            .partition(|sheet| sheet.node_id == node_id);
        let Some(identity) = identity else {
            let expected = with_id.first();
            return expected.map_or_else(String::new, |sheet| format!("{}?", sheet.name));
        };
        let found = match (identity.device_type, identity.identity) {
            (Some(device_type), [Some(vendor), Some(product), ..]) => {
                let identity = [device_type, vendor, product];
                let sheets = with_id.into_iter().chain(others);
                let agreeing = sheets.filter_map(|sheet| {
                    sheet
                        .agreement(identity)
                        .map(|agreement| (agreement, sheet))
                });
                // Of equals the first: a sheet that says more is the better one.
                agreeing
                    .rev()
                    .max_by_key(|(agreement, _)| *agreement)
                    .map(|(_, sheet)| sheet)
            }
            _ => None,
        };
        let Some(sheet) = found else {
            return "none".to_owned();
        };
        let expected = sheet.dictionary.unsigned(IDENTITY, 3);
        match identity.identity[2] {
            revision if revision == expected => sheet.name.clone(),
            Some(revision) => format!("{}, but revision 0x{revision:08X}", sheet.name),
            None => format!("{}, but no revision", sheet.name),
        }
    }
}

/// Returns the node that a frame says its device type of.
fn answer_to_call(frame: &CanFrame) -> Option<u8> {
    let node_id = frame.standard_id()?.checked_sub(DEFAULT_RESPONSE_ID)?;
    let node_id = u8::try_from(node_id).ok()?;
    let is_about_device_type = frame.data().get(1..4) == Some(&[0x00, 0x10, 0x00]);
    (is_about_device_type && NODE_IDS.contains(&node_id)).then_some(node_id)
}

/// Reads an object; `None` if the node aborts it.
fn read(
    guest: &mut Guest<'_>,
    client: &mut SdoClient,
    place: (u16, u8),
) -> Result<Option<Vec<u8>>, ToolError> {
    match guest.transfer(client, place, None, |_| ())? {
        Err(error) if matches!(error.failure, SdoFailure::Aborted(_)) => Ok(None),
        bytes => Ok(Some(bytes?)),
    }
}

/// Arguments of `nodes`.
#[derive(Args, Debug)]
pub(crate) struct NodesArgs {
    #[command(flatten)]
    pub bus: ToolBusArgs,
    /// Further EDS files by which nodes are recognised, in addition to those that ship
    #[arg(long, value_name = "FILE")]
    pub eds: Vec<PathBuf>,
    #[command(flatten)]
    pub names: NamesArgs,
    /// How long to listen for heartbeats before nodes are asked
    #[arg(long, value_name = "SECONDS", default_value_t = LISTEN_SECONDS, value_parser = seconds)]
    pub listen: f64,
}

/// Calls every node on a bus, and prints the table of the nodes.
pub(crate) fn nodes(args: &NodesArgs) -> Result<Exit, Failure> {
    let mut sheets = args.names.nodes()?.sheets;
    let name = |sheet: &DataSheet| (sheet.node_id, sheet.node_name.clone());
    // Without a rig file the nodes have no names of their own.
    let named = if args.names.rig.is_some() {
        &sheets[..]
    } else {
        &[]
    };
    let names = named.iter().map(name).collect();
    for path in &args.eds {
        // The sheet is used for its identity only; the node-ID is not known yet.
        let sheet = DataSheet::load(path, 127)?;
        sheets.push(DataSheet {
            node_id: 0,
            ..sheet
        });
    }
    let mut roll_call = RollCall {
        sheets,
        names,
        listen: Duration::from_secs_f64(args.listen),
        ..RollCall::default()
    };
    let mut guest = guest(&args.bus.chosen())?;
    match roll_call.play(&mut guest) {
        Ok(()) | Err(ToolError::Interrupted) => print(&report(&roll_call)),
        Err(error) => return Err(error.into()),
    }
    Ok(Exit::Pass)
}

/// Returns the nodes as a table.
fn report(roll_call: &RollCall) -> String {
    let nodes = roll_call.present();
    if nodes.is_empty() {
        return format!(
            "no node: no heartbeat in {:.1} s{}",
            roll_call.listen.as_secs_f64(),
            match roll_call.manager() {
                Some(manager) => format!(", but {manager}"),
                None => " and no answer to SDO".to_owned(),
            }
        );
    }
    let mut table = Table::new([
        "node",
        "NMT state",
        "device type",
        "identity",
        "name",
        "EDS",
    ]);
    let unasked = Err("not asked: interrupted".to_owned());
    for node_id in &nodes {
        let state = roll_call
            .presence
            .states()
            .get(node_id)
            .map_or("no heartbeat", |state| state_name(*state));
        let identity = roll_call.identities.get(node_id).unwrap_or(&unasked);
        let data_sheet = roll_call.data_sheet(*node_id, identity.as_ref().ok());
        let [device_type, identity, name] = match identity {
            Ok(identity) => [
                identity
                    .device_type
                    .map_or_else(|| "-".to_owned(), device_type),
                identity_text(&identity.identity),
                identity.name.clone().unwrap_or_else(|| "-".to_owned()),
            ],
            Err(reason) => [String::new(), reason.clone(), String::new()],
        };
        let number = roll_call.node(*node_id);
        table.add([
            number,
            state.to_owned(),
            device_type,
            identity,
            name,
            data_sheet,
        ]);
    }
    let mut text = table.to_string();
    let absent = roll_call.names.keys().filter(|id| !nodes.contains(id));
    let absent = Vec::from_iter(absent.map(|id| roll_call.node(*id)));
    if !absent.is_empty() {
        text += &format!("\nnot on the bus: {}", absent.join(", "));
    }
    if let Some(manager) = roll_call.manager() {
        text +=
            &format!("\na controller runs ({manager} was heard): its SDO channels were left alone");
    }
    text
}

/// Returns the usual name of a state.
pub(crate) fn state_name(state: NmtState) -> &'static str {
    match state {
        NmtState::Initialising => "booting",
        NmtState::Stopped => "stopped",
        NmtState::Operational => "operational",
        NmtState::PreOperational => "pre-operational",
    }
}

/// Returns the device type with its profile.
fn device_type(device_type: u32) -> String {
    let profile = match device_type & 0xFFFF {
        0 => "no profile".to_owned(),
        profile => format!("CiA {profile}"),
    };
    format!("0x{device_type:08X} {profile}")
}

fn identity_text(identity: &[Option<u32>; 4]) -> String {
    let labels = ["vendor", "product", "revision", "serial"];
    let numbers: Vec<String> = labels
        .into_iter()
        .zip(identity)
        .filter_map(|(label, number)| number.map(|number| format!("{label} 0x{number:X}")))
        .collect();
    if numbers.is_empty() {
        "-".to_owned()
    } else {
        numbers.join(", ")
    }
}
