//! `canrig sdo`: reads or writes one object of a node.
//!
//! The tool uses the second SDO channel of the node's data sheet if the node answers there, so it never disturbs a
//! running controller. Else the tool listens. It uses the default channel only if no controller shows: no other client
//! speaks on it, and no SYNC and no manager's heartbeat comes. A write that would take the drive away from a running
//! controller (its controlword, or a mapping of PDOs) needs the same silence, or `--force`.

use std::collections::VecDeque;
use std::io::{self, IsTerminal};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use canopen::cia402::CONTROLWORD;
use canopen::object_dictionary::Entry;
use canopen::sdo_client::{SdoClient, SdoFailure};
use clap::{Args, Subcommand};
use dbc::Database;

use super::{NamesArgs, ToolBus, ToolBusArgs, ToolError, address, ended, value};
use plan::data_sheet::{self, DataSheet};
use plan::presence::Presence;
use runner::console::print_error;
use runner::exit::Exit;

/// Time for which the tool listens before it uses the default channel: longer than usual heartbeat periods.
pub(crate) const LISTEN_TIME: Duration = Duration::from_secs(1);
/// Time for each answer.
pub(crate) const ANSWER_TIME: Duration = Duration::from_secs(1);

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

/// Action on an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// Upload.
    Read,
    /// Download of these bytes.
    Write {
        bytes: Vec<u8>,
        /// The user accepts that a controller may be running.
        is_forced: bool,
    },
}

impl Request {
    /// Returns whether a write must not happen while a controller runs.
    fn needs_silence(&self, index: u16) -> bool {
        let is_guarded = index == CONTROLWORD || PDO_TABLES.contains(&index);
        match self {
            Self::Write { is_forced, .. } => is_guarded && !is_forced,
            Self::Read => false,
        }
    }
}

#[derive(Debug)]
enum Phase {
    Start,
    Transfer {
        is_second_channel: bool,
    },
    /// Listens before a transfer on the default channel, or before a write that needs silence.
    Listening {
        until: Duration,
    },
    Done,
}

/// One transfer, with its choice of a channel; a node without node-ID.
#[derive(Debug)]
pub(crate) struct Transfer {
    node_id: u8,
    place: (u16, u8),
    request: Request,
    sheets: Vec<DataSheet>,
    second_channel: Option<(u16, u16)>,
    client: SdoClient,
    presence: Presence,
    phase: Phase,
    output: VecDeque<CanFrame>,
    result: Option<Result<Vec<u8>, ToolError>>,
}

impl Transfer {
    /// Makes a transfer with a node. `sheets` give its channels and the manager.
    pub(crate) fn new(
        node_id: u8,
        place: (u16, u8),
        request: Request,
        sheets: Vec<DataSheet>,
    ) -> Self {
        let mut sheets_of_node = sheets.iter().filter(|sheet| sheet.node_id == node_id);
        let second_channel = sheets_of_node.find_map(DataSheet::second_channel);
        Self {
            node_id,
            place,
            request,
            sheets,
            second_channel,
            client: SdoClient::new(node_id).with_timeout(ANSWER_TIME),
            presence: Presence::default(),
            phase: Phase::Start,
            output: VecDeque::new(),
            result: None,
        }
    }

    /// Returns the value that was read, or no bytes after a write.
    ///
    /// # Errors
    /// The transfer failed, or was not made because the channel belongs to the controller.
    pub(crate) fn into_result(self) -> Result<Vec<u8>, ToolError> {
        let interrupted = || Err(ToolError::Refused("interrupted".to_owned()));
        self.result.unwrap_or_else(interrupted)
    }

    fn begin(&mut self, now: Duration) {
        match self.second_channel {
            Some(channel) if !self.request.needs_silence(self.place.0) => {
                self.use_second_channel(now, channel);
            }
            _ => {
                self.phase = Phase::Listening {
                    until: now + LISTEN_TIME,
                };
            }
        }
    }

    fn use_second_channel(&mut self, now: Duration, (request, response): (u16, u16)) {
        let client = SdoClient::new(self.node_id).with_channel(request, response);
        self.client = client.with_timeout(ANSWER_TIME);
        self.transfer(now, true);
    }

    /// Ends listening: makes the transfer, or refuses it if a controller was heard.
    fn end_listening(&mut self, now: Duration) {
        let (index, sub_index) = self.place;
        let taken = self
            .presence
            .why_not_default_channel(self.node_id, &self.sheets);
        let has_channel = self.second_channel.is_some() || taken.is_none();
        let needs_silence = has_channel && self.request.needs_silence(index);
        let manager = self.presence.manager(&self.sheets);
        match (manager.filter(|_| needs_silence), self.second_channel) {
            (Some(heard), _) => self.refuse(format!(
                "0x{index:04X}:{sub_index:02X} of node {} was not written: a controller is running ({heard} was heard), \
                 and this object is the controller's while it runs; write it when the controller has ended, or with --force",
                self.node_id
            )),
            (None, Some(channel)) => self.use_second_channel(now, channel),
            (None, None) => self.use_default_channel(now),
        }
    }

    fn refuse(&mut self, reason: String) {
        self.finish(Err(ToolError::Refused(reason)));
    }

    fn transfer(&mut self, now: Duration, is_second_channel: bool) {
        let (index, sub_index) = self.place;
        let started = match &self.request {
            Request::Read => self.client.start_upload(now, index, sub_index),
            Request::Write { bytes, .. } => {
                self.client.start_download(now, index, sub_index, bytes)
            }
        };
        self.phase = Phase::Transfer { is_second_channel };
        if let Err(error) = started {
            self.finish(Err(error.into()));
        }
        self.drain();
    }

    fn use_default_channel(&mut self, now: Duration) {
        let refusal = self
            .presence
            .why_not_default_channel(self.node_id, &self.sheets);
        let Some(reason) = refusal else {
            self.client = SdoClient::new(self.node_id).with_timeout(ANSWER_TIME);
            self.transfer(now, false);
            return;
        };
        let why_default = match self.second_channel {
            Some((request, _)) => format!(
                "node {} does not answer on its second SDO channel (0x{request:03X}), and ",
                self.node_id
            ),
            None => String::new(),
        };
        self.refuse(format!(
            "{why_default}{reason}; try again when it has ended"
        ));
    }

    fn advance(&mut self, now: Duration) {
        self.drain();
        let Some(result) = self.client.take_result() else {
            return;
        };
        let is_silent =
            matches!(&result, Err(error) if matches!(error.failure, SdoFailure::TimedOut(_)));
        match self.phase {
            // The node has no second channel after all. The tool has listened in the meantime.
            Phase::Transfer {
                is_second_channel: true,
            } if is_silent => self.use_default_channel(now),
            _ => self.finish(result.map_err(ToolError::from)),
        }
        self.drain();
    }

    fn finish(&mut self, result: Result<Vec<u8>, ToolError>) {
        self.result = Some(result);
        self.phase = Phase::Done;
    }

    fn drain(&mut self) {
        while let Some(frame) = self.client.next_frame() {
            self.output.push_back(frame);
        }
    }
}

impl Node for Transfer {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::ALL]
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.presence.on_frame(frame);
        self.client.on_frame(now, frame);
        self.advance(now);
    }

    fn on_tick(&mut self, now: Duration) {
        match self.phase {
            Phase::Start => self.begin(now),
            Phase::Listening { until } if now >= until => self.end_listening(now),
            Phase::Transfer { .. } => {
                self.client.on_tick(now);
                self.advance(now);
            }
            _ => {}
        }
    }

    fn on_stop(&mut self, _now: Duration) {
        self.phase = Phase::Done;
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.output.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        match self.phase {
            Phase::Start => Some(Duration::ZERO),
            Phase::Listening { until } => Some(until),
            Phase::Transfer { .. } => self.client.next_deadline(),
            Phase::Done => None,
        }
    }

    fn progress(&self) -> Progress {
        match self.phase {
            Phase::Done => Progress::Stopped,
            _ => Progress::Running,
        }
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
pub(crate) fn sdo(args: &SdoArgs) -> Exit {
    ended(match &args.action {
        SdoAction::Read(target) => transferred(target, None),
        SdoAction::Write {
            object,
            value,
            force,
        } => transferred(object, Some((value, *force))),
    })
}

/// Returns the bytes of a value in an object's type.
fn to_write(entry: Option<&Entry>, place: (u16, u8), text: &str) -> Result<Vec<u8>, ToolError> {
    if let Some(entry) = entry {
        return value::parse(entry, text).map_err(ToolError::Usage);
    }
    value::parse_untyped(text).ok_or_else(|| {
        ToolError::Usage(format!(
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
fn confirm(node: &str, (index, sub_index): (u16, u8)) -> Result<(), ToolError> {
    let bus = address(&ToolBus::Running)?;
    if !io::stdin().is_terminal() {
        return Err(ToolError::Usage(format!(
            "`sdo write` without --bus asks first, and its input is no terminal: name the bus, --bus {bus}"
        )));
    }
    print_error(&format!(
        "write 0x{index:04X}:{sub_index:02X} of {node} on {bus}? y or n"
    ));
    let mut answer = String::new();
    let read = io::stdin().read_line(&mut answer);
    match read.map(|_| answer.trim().to_ascii_lowercase()) {
        Ok(answer) if ["y", "yes"].contains(&answer.as_str()) => Ok(()),
        _ => Err(ToolError::Refused("nothing is written".to_owned())),
    }
}

/// Reads an object, or writes it if there is a value (with whether that is forced). Returns the line to print.
fn transferred(target: &ObjectArgs, value: Option<(&str, bool)>) -> Result<String, ToolError> {
    let mut sheets = target.names.nodes()?.sheets;
    let node_id = data_sheet::node_id(&target.node, &sheets)?;
    if let Some(path) = &target.eds {
        sheets.insert(0, DataSheet::load(path, node_id)?);
    }
    let sheet = sheets.iter().find(|sheet| sheet.node_id == node_id);
    let place = match sheet {
        Some(sheet) => sheet.find(&target.object)?,
        None => DataSheet {
            name: format!("node {node_id} (no EDS is known; name one with --eds)"),
            node_name: String::new(),
            node_id,
            dictionary: canopen::ObjectDictionary::new(),
        }
        .find(&target.object)?,
    };
    let entry = sheet
        .and_then(|sheet| sheet.entry(place.0, place.1))
        .cloned();
    let written = value
        .map(|(text, _)| to_write(entry.as_ref(), place, text))
        .transpose()?;
    let request = match (&written, value) {
        (Some(bytes), Some((_, is_forced))) => Request::Write {
            bytes: bytes.clone(),
            is_forced,
        },
        _ => Request::Read,
    };
    let mut transfer = Transfer::new(node_id, place, request, sheets);
    if written.is_some() && target.bus.bus.is_none() {
        confirm(&target.node, place)?;
    }
    super::run(&mut transfer, &target.bus.chosen())?;
    let read = transfer.into_result()?;
    let bytes = written.as_ref().unwrap_or(&read);
    let name = entry.as_ref().map_or_else(String::new, |entry| {
        format!("  {} ({})", entry.name, value::type_name(entry.data_type))
    });
    let mut line = format!(
        "0x{:04X}:{:02X}{name} = {}",
        place.0,
        place.1,
        value::show(entry.as_ref(), bytes)
    );
    if written.is_some() {
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
    use super::*;
    use plan::data_sheet::rig_data_sheets;

    const HEARTBEAT_OF_THE_CONTROLLER: (u16, &[u8]) = (0x701, &[5]);
    const SYNC: (u16, &[u8]) = (0x080, &[1]);

    /// Writes an object after the given frames were heard; returns the first frame sent, and the error at the end.
    fn written(
        node_id: u8,
        index: u16,
        is_forced: bool,
        heard: &[(u16, &[u8])],
    ) -> (Option<CanFrame>, String) {
        let bytes = vec![0x0F, 0];
        let request = Request::Write { bytes, is_forced };
        let mut transfer = Transfer::new(node_id, (index, 0), request, rig_data_sheets());
        transfer.on_tick(Duration::ZERO);
        for (id, data) in heard {
            transfer.on_frame(Duration::ZERO, &CanFrame::new(*id, data));
        }
        let first = transfer.next_frame();
        transfer.on_tick(LISTEN_TIME);
        let first = first.or_else(|| transfer.next_frame());
        let text = transfer.into_result().unwrap_err();
        assert_eq!(text.exit(), Exit::BenchFailed);
        (first, text.to_string())
    }

    #[test]
    fn what_is_the_running_controllers_is_written_by_force_only() {
        for index in [0x6040, 0x1400, 0x17FF, 0x1800, 0x1BFF] {
            for heard in [HEARTBEAT_OF_THE_CONTROLLER, SYNC] {
                let (sent, text) = written(0x10, index, false, &[heard]);
                assert_eq!(sent, None, "0x{index:04X}");
                let place = format!("0x{index:04X}:00 of node 16 was not written");
                assert!(text.contains(&place) && text.contains("--force"), "{text}");
                let (sent, _) = written(0x10, index, true, &[heard]);
                assert_eq!(sent.unwrap().standard_id(), Some(0x690));
            }
            let (sent, _) = written(0x10, index, false, &[(0x710, &[5])]);
            let sent = sent.map(|frame| frame.standard_id());
            assert_eq!(sent, Some(Some(0x690)), "no controller runs");
        }
    }

    #[test]
    fn other_objects_are_written_beside_a_controller() {
        for index in [0x1017, 0x13FF, 0x1C00, 0x6060, 0x6071] {
            let (sent, _) = written(0x10, index, false, &[SYNC]);
            assert_eq!(sent.unwrap().standard_id(), Some(0x690), "0x{index:04X}");
        }
    }

    #[test]
    fn force_does_not_take_the_controllers_sdo_channel() {
        for is_forced in [false, true] {
            let (sent, text) = written(0x11, 0x1400, is_forced, &[SYNC]);
            assert_eq!(sent, None);
            assert!(text.contains("default SDO channel") && !text.contains("--force"));
        }
        // No manager leads the controller, so its channel is free; its PDOs are still guarded.
        let (sent, text) = written(0x01, 0x1800, false, &[SYNC]);
        assert_eq!(sent, None);
        assert!(text.contains("--force"), "{text}");
    }
}
