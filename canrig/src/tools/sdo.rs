//! `canrig sdo`: reads or writes one object of a node.
//!
//! The tool uses the second SDO channel of the node's data sheet if the node answers there, so it never disturbs a
//! running controller. Else the tool listens. It uses the default channel only if no controller shows: no other client
//! speaks on it, and no SYNC and no manager's heartbeat comes. A write that would take the drive away from a running
//! controller (its controlword, or a mapping of PDOs) needs the same silence, or `--force`.

use std::io::{self, IsTerminal};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

use canopen::cia402::CONTROLWORD;
use canopen::object_dictionary::Entry;
use canopen::sdo_client::SdoFailure;
use clap::{Args, Subcommand};
use dbc::Database;

use super::{NamesArgs, ToolBusArgs, ToolError, address, client, guest, second_channel, value};
use plan::data_sheet::{self, DataSheet};
use plan::presence::{Presence, is_manager};
use runner::console::{print, print_error};
use runner::exit::{Exit, Failure};
use worlds::guest::Guest;

/// Time for which the tool listens before it uses the default channel: longer than usual heartbeat periods.
const LISTEN_TIME: Duration = Duration::from_secs(1);

/// Help on the format of numbers.
const NUMBERS: &str = "\
Numbers:
  Index and sub-index are hexadecimal, with or without 0x: 1017, 1017:00, 0x1018:02. Without a
  sub-index it is 00. Values and node numbers are decimal; with 0x they are hexadecimal.

Example, a heartbeat of node 16 every 50 ms:
  canrig sdo write 16 1017:00 50
  canrig sdo write 0x10 0x1017:00 0x32     means the same";
/// Communication parameters and mappings of all PDOs (CiA 301, 7.5.1).
const PDO_TABLES: RangeInclusive<u16> = 0x1400..=0x1BFF;

/// Object of a node that a guest reads or writes.
#[derive(Debug)]
struct Target {
    node_id: u8,
    place: (u16, u8),
    /// Bytes to write; `None` to read.
    written: Option<Vec<u8>>,
    /// Whether the user accepts a write while a controller may be running.
    is_forced: bool,
    /// Data sheets of the nodes on the bus.
    sheets: Vec<DataSheet>,
}

impl Target {
    fn second_channel(&self) -> Option<(u16, u16)> {
        second_channel(self.node_id, &self.sheets)
    }

    /// Returns whether a write must not happen while a controller runs.
    fn needs_silence(&self) -> bool {
        let (index, _) = self.place;
        let is_guarded = index == CONTROLWORD || PDO_TABLES.contains(&index);
        is_guarded && self.written.is_some() && !self.is_forced
    }

    /// Returns why the default channel is not free.
    fn why_not_default(&self, presence: &Presence) -> Option<String> {
        presence.why_not_default_channel(self.node_id, &self.sheets)
    }

    /// Checks that nobody who was heard is in the way of the request.
    fn may_ask(&self, presence: &Presence) -> Result<(), ToolError> {
        let has_channel =
            self.second_channel().is_some() || self.why_not_default(presence).is_none();
        let manager = presence.manager(|node_id| is_manager(node_id, &self.sheets));
        let (index, sub_index) = self.place;
        match manager.filter(|_| has_channel && self.needs_silence()) {
            None => Ok(()),
            Some(heard) => Err(ToolError::Refused(format!(
                "0x{index:04X}:{sub_index:02X} of node {} was not written: a controller is running ({heard} was heard), \
                 and this object is the controller's while it runs; write it when the controller has ended, or with --force",
                self.node_id
            ))),
        }
    }

    /// Checks that the default channel is free. With a second one, the node does not answer there.
    fn may_ask_on_default(&self, presence: &Presence) -> Result<(), ToolError> {
        let Some(reason) = self.why_not_default(presence) else {
            return Ok(());
        };
        let why_default = match self.second_channel() {
            Some((request, _)) => format!(
                "node {} does not answer on its second SDO channel (0x{request:03X}), and ",
                self.node_id
            ),
            None => String::new(),
        };
        Err(ToolError::Refused(format!(
            "{why_default}{reason}; try again when it has ended"
        )))
    }

    /// Reads or writes the object, and returns the bytes that were read.
    fn transfer(&self, guest: &mut Guest<'_>) -> Result<Vec<u8>, ToolError> {
        let mut presence = Presence::default();
        let channel = self.second_channel();
        if channel.is_none() || self.needs_silence() {
            guest.hear(LISTEN_TIME, |frame| presence.on_frame(frame))?;
            self.may_ask(&presence)?;
        }
        if channel.is_some() {
            match self.ask(guest, channel, &mut presence) {
                // The node has no second channel after all. The guest has listened in the meantime.
                Err(ToolError::Sdo(error)) if matches!(error.failure, SdoFailure::TimedOut(_)) => {}
                result => return result,
            }
        }
        self.may_ask_on_default(&presence)?;
        self.ask(guest, None, &mut presence)
    }

    fn ask(
        &self,
        guest: &mut Guest<'_>,
        channel: Option<(u16, u16)>,
        presence: &mut Presence,
    ) -> Result<Vec<u8>, ToolError> {
        let written = self.written.as_deref();
        let mut client = client(self.node_id, channel);
        let answer = guest.transfer(&mut client, self.place, written, |frame| {
            presence.on_frame(frame)
        });
        Ok(answer??)
    }
}

/// Arguments of `sdo`.
#[derive(Args, Debug)]
pub(crate) struct SdoArgs {
    /// Action on the object.
    #[command(subcommand)]
    pub action: SdoAction,
}

/// Action on an object.
#[derive(Debug, Subcommand)]
#[command(after_help = NUMBERS)]
pub(crate) enum SdoAction {
    /// Read an object
    #[command(after_help = NUMBERS)]
    Read(ObjectArgs),
    /// Write an object
    #[command(after_help = NUMBERS)]
    Write {
        #[command(flatten)]
        object: ObjectArgs,
        /// The value: a number (decimal, 0x, 0b), text, or pairs of hexadecimal digits; without an EDS 0x and all
        /// digits (0x0032)
        #[arg(allow_hyphen_values = true)]
        value: String,
        /// Write the controlword (0x6040) or a PDO table (0x1400 to 0x1BFF) although a controller is running
        #[arg(long)]
        force: bool,
    },
}

/// An object of a node.
#[derive(Args, Debug)]
pub(crate) struct ObjectArgs {
    /// The node: its number (16, 0x10), or `controller`, `drive`, `disturbance`; with --rig, a node's name there
    pub node: String,
    /// The object: index and sub-index in hexadecimal (6064, 1018:02), or its name in the EDS ("Statusword")
    pub object: String,
    /// The EDS of a node that is none of `controller`, `drive` and `disturbance`
    #[arg(long, value_name = "FILE")]
    pub eds: Option<PathBuf>,
    #[command(flatten)]
    pub names: NamesArgs,
    #[command(flatten)]
    pub bus: ToolBusArgs,
}

/// Reads or writes an object, and prints its value.
pub(crate) fn sdo(args: &SdoArgs) -> Result<Exit, Failure> {
    print(&match &args.action {
        SdoAction::Read(target) => transferred(target, None, false)?,
        SdoAction::Write {
            object,
            value,
            force,
        } => transferred(object, Some(value), *force)?,
    });
    Ok(Exit::Pass)
}

/// Returns the bytes of a value in an object's type.
fn to_write(entry: Option<&Entry>, place: (u16, u8), text: &str) -> Result<Vec<u8>, Failure> {
    if let Some(entry) = entry {
        return value::parse(entry, text).map_err(|error| Exit::Usage.because(error));
    }
    value::parse_untyped(text).ok_or_else(|| {
        Exit::Usage.because(format!(
            "no EDS gives the type of 0x{:04X}:{:02X}, so the size of \"{text}\" is not known: write 0x with two digits \
             for each byte (0x0032 for 16 bits) or the bytes as they are sent (\"32 00\"), or name the node's EDS with --eds",
            place.0, place.1
        ))
    })
}

/// Asks for a confirmation to write on a bus that the user did not name.
///
/// # Errors
/// There is no such bus, there is no terminal to ask on, or the answer is no.
fn confirm(node: &str, (index, sub_index): (u16, u8)) -> Result<(), Failure> {
    let bus = address(&None)?;
    if !io::stdin().is_terminal() {
        let reason = format!(
            "`sdo write` without --bus asks first, and its input is no terminal: name the bus, --bus {bus}"
        );
        return Err(Exit::Usage.because(reason));
    }
    print_error(&format!(
        "write 0x{index:04X}:{sub_index:02X} of {node} on {bus}? y or n"
    ));
    let mut answer = String::new();
    let read = io::stdin().read_line(&mut answer);
    match read.map(|_| answer.trim().to_ascii_lowercase()) {
        Ok(answer) if ["y", "yes"].contains(&answer.as_str()) => Ok(()),
        _ => Err(Exit::BenchFailed.because("nothing is written")),
    }
}

/// Reads an object, or writes it if there is a value. Returns the line to print.
fn transferred(
    target: &ObjectArgs,
    value: Option<&str>,
    is_forced: bool,
) -> Result<String, Failure> {
    let mut sheets = target.names.nodes()?.sheets;
    let node_id = data_sheet::node_id(&target.node, &sheets)?;
    if let Some(path) = &target.eds {
        sheets.insert(0, DataSheet::load(path, node_id)?);
    }
    let unknown = DataSheet {
        name: format!("node {node_id} (no EDS is known; name one with --eds)"),
        node_name: String::new(),
        node_id,
        dictionary: canopen::ObjectDictionary::new(),
    };
    let is_asked = |sheet: &&DataSheet| sheet.node_id == node_id;
    let sheet = sheets.iter().find(is_asked).unwrap_or(&unknown);
    let place = sheet.find(&target.object)?;
    let entry = sheet.dictionary.get(place.0, place.1).cloned();
    let written = value
        .map(|text| to_write(entry.as_ref(), place, text))
        .transpose()?;
    if written.is_some() && target.bus.bus.is_none() {
        confirm(&target.node, place)?;
    }
    let asked = Target {
        node_id,
        place,
        written,
        is_forced,
        sheets,
    };
    let read = asked.transfer(&mut guest(&target.bus.chosen())?)?;
    let bytes = asked.written.as_ref().unwrap_or(&read);
    let name = entry.as_ref().map_or_else(String::new, |entry| {
        format!("  {} ({})", entry.name, value::type_name(entry.data_type))
    });
    let mut line = format!(
        "0x{:04X}:{:02X}{name} = {}",
        place.0,
        place.1,
        value::show(entry.as_ref(), bytes)
    );
    if asked.written.is_some() {
        line += "  written";
    }
    if let Some(entry) = &entry {
        let meanings = value::meaning(Database::shipped(), entry, bytes);
        meanings
            .iter()
            .for_each(|meaning| line += &format!("\n  {meaning}"));
    }
    Ok(line)
}

#[cfg(test)]
mod tests {
    use can::CanFrame;
    use plan::data_sheet::rig_data_sheets;

    use super::*;

    const HEARTBEAT_OF_THE_CONTROLLER: (u16, &[u8]) = (0x701, &[5]);
    const SYNC: (u16, &[u8]) = (0x080, &[1]);

    /// Returns why a write is refused after these frames were heard.
    fn refusal(node_id: u8, index: u16, is_forced: bool, heard: &[(u16, &[u8])]) -> Option<String> {
        let bytes = vec![0x0F, 0];
        let target = Target {
            node_id,
            place: (index, 0),
            written: Some(bytes),
            is_forced,
            sheets: rig_data_sheets(),
        };
        let mut presence = Presence::default();
        for (id, data) in heard {
            presence.on_frame(&CanFrame::new(*id, data));
        }
        let channel = target.second_channel();
        assert!(channel.is_none_or(|channel| channel == (0x690, 0x6D0)));
        let on_default = || target.may_ask_on_default(&presence);
        let asked = target
            .may_ask(&presence)
            .and_then(|()| channel.map_or_else(on_default, |_| Ok(())));
        let failure = Failure::from(asked.err()?);
        assert_eq!(failure.exit, Exit::BenchFailed);
        Some(failure.reason)
    }

    #[test]
    fn what_is_the_running_controllers_is_written_by_force_only() {
        for index in [0x6040, 0x1400, 0x17FF, 0x1800, 0x1BFF] {
            for heard in [HEARTBEAT_OF_THE_CONTROLLER, SYNC] {
                let text = refusal(0x10, index, false, &[heard]).unwrap();
                let place = format!("0x{index:04X}:00 of node 16 was not written");
                assert!(text.contains(&place) && text.contains("--force"), "{text}");
                assert_eq!(refusal(0x10, index, true, &[heard]), None);
            }
            let no_controller = refusal(0x10, index, false, &[(0x710, &[5])]);
            assert_eq!(no_controller, None);
        }
    }

    #[test]
    fn other_objects_are_written_beside_a_controller() {
        for index in [0x1017, 0x13FF, 0x1C00, 0x6060, 0x6071] {
            assert_eq!(refusal(0x10, index, false, &[SYNC]), None, "0x{index:04X}");
        }
    }

    #[test]
    fn force_does_not_take_the_controllers_sdo_channel() {
        for is_forced in [false, true] {
            let text = refusal(0x11, 0x1400, is_forced, &[SYNC]).unwrap();
            assert!(text.contains("default SDO channel") && !text.contains("--force"));
        }
        // No manager leads the controller, so its channel is free; its PDOs are still guarded.
        let text = refusal(0x01, 0x1800, false, &[SYNC]).unwrap();
        assert!(text.contains("--force"), "{text}");
    }
}
