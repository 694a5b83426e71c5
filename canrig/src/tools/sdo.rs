//! `canrig sdo`: reads or writes one object of a node.
//!
//! The second SDO channel of the node's data sheet is used where it answers, so a running controller is never disturbed.
//! Else the tool listens, and uses the default channel only where no controller shows: nobody else speaks on it, no SYNC
//! and no manager's heartbeat comes.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;

use canopen::sdo_client::{SdoClient, SdoError, SdoFailure};
use canopen::{CanFrame, Filter, Node, Progress};
use clap::{Args, Subcommand};
use dbc::Database;

use super::{ToolBusArgs, ToolError, ended, value};
use rig::data_sheet::{self, DataSheet, of_the_rig};
use rig::presence::Presence;
use runner::exit::Exit;

/// How long the tool listens before it uses the default channel: longer than usual heartbeat periods.
pub(crate) const LISTEN_TIME: Duration = Duration::from_secs(1);
/// Time for each answer.
pub(crate) const ANSWER_TIME: Duration = Duration::from_secs(1);

/// How numbers are read, for people.
const NUMBERS: &str = "\
Numbers:
  Index and sub-index are hexadecimal, with or without 0x: 1017, 1017:00, 0x1018:02. Without a
  sub-index it is 00. Values and node numbers are decimal; with 0x they are hexadecimal.

Example, a heartbeat of node 16 every 50 ms:
  canrig sdo write 16 1017:00 50
  canrig sdo write 0x10 0x1017:00 0x32     means the same";

/// What to do with an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// Upload.
    Read,
    /// Download of these bytes.
    Write(Vec<u8>),
}

#[derive(Debug)]
enum Phase {
    Start,
    Transfer { is_second_channel: bool },
    Listening { until: Duration },
    Done,
}

/// One transfer with the channel's choice, a node without node-ID.
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
    result: Option<Result<Vec<u8>, SdoError>>,
    refusal: Option<String>,
}

impl Transfer {
    /// A transfer with a node; `sheets` say where its channels are and who manages.
    #[must_use]
    pub(crate) fn new(
        node_id: u8,
        place: (u16, u8),
        request: Request,
        sheets: Vec<DataSheet>,
    ) -> Self {
        let mut of_node = sheets.iter().filter(|sheet| sheet.node_id == node_id);
        let second_channel = of_node.find_map(DataSheet::second_channel);
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
            refusal: None,
        }
    }

    /// The value read (nothing after writing).
    ///
    /// # Errors
    /// The transfer failed, or was not made since the channel is the controller's.
    pub(crate) fn into_result(self) -> Result<Vec<u8>, ToolError> {
        match (self.result, self.refusal) {
            (Some(result), _) => Ok(result?),
            (None, Some(refusal)) => Err(ToolError::Refused(refusal)),
            (None, None) => Err(ToolError::Refused("interrupted".to_owned())),
        }
    }

    fn begin(&mut self, now: Duration) {
        match self.second_channel {
            Some((request, response)) => {
                let client = SdoClient::new(self.node_id).with_channel(request, response);
                self.client = client.with_timeout(ANSWER_TIME);
                self.transfer(now, true);
            }
            None => self.listen(now),
        }
    }

    fn listen(&mut self, now: Duration) {
        self.phase = Phase::Listening {
            until: now + LISTEN_TIME,
        };
    }

    fn transfer(&mut self, now: Duration, is_second_channel: bool) {
        let (index, sub_index) = self.place;
        let started = match &self.request {
            Request::Read => self.client.start_upload(now, index, sub_index),
            Request::Write(bytes) => self.client.start_download(now, index, sub_index, bytes),
        };
        self.phase = Phase::Transfer { is_second_channel };
        if let Err(error) = started {
            self.finish(Err(error));
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
        self.refusal = Some(format!(
            "{why_default}{reason}; try again when it has ended"
        ));
        self.phase = Phase::Done;
    }

    fn advance(&mut self, now: Duration) {
        self.drain();
        let Some(result) = self.client.take_result() else {
            return;
        };
        let is_silent =
            matches!(&result, Err(error) if matches!(error.failure, SdoFailure::TimedOut(_)));
        match self.phase {
            // A node that has no second channel after all. What came meanwhile counts as listening.
            Phase::Transfer {
                is_second_channel: true,
            } if is_silent => self.use_default_channel(now),
            _ => self.finish(result),
        }
        self.drain();
    }

    fn finish(&mut self, result: Result<Vec<u8>, SdoError>) {
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
            Phase::Listening { until } if now >= until => self.use_default_channel(now),
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
    /// What to do with the object.
    #[command(subcommand)]
    pub action: SdoAction,
}

/// What to do with an object.
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
        /// The value, in the object's type: a number (decimal; hexadecimal with 0x, binary with 0b), text, or for
        /// strings of bytes pairs of hexadecimal digits. Of a node without EDS: 0x with two digits for each byte
        /// (0x0032 for 16 bits), or the bytes as they are sent ("32 00")
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
}

/// An object of a node.
#[derive(Args, Debug)]
pub(crate) struct ObjectArgs {
    /// The node: its number (16, 0x10), or `controller`, `drive`, `disturbance`
    pub node: String,
    /// The object: index and sub-index in hexadecimal (6064, 1018:02), or its name in the EDS ("Statusword")
    pub object: String,
    /// The EDS of a node that is none of `controller`, `drive` and `disturbance`
    #[arg(long, value_name = "FILE")]
    pub eds: Option<PathBuf>,
    #[command(flatten)]
    pub bus: ToolBusArgs,
}

/// Reads or writes an object, and prints what it holds.
#[must_use]
pub(crate) fn sdo(args: &SdoArgs) -> Exit {
    ended(match &args.action {
        SdoAction::Read(target) => transferred(target, None),
        SdoAction::Write { object, value } => transferred(object, Some(value)),
    })
}

/// Reads an object, or writes it when there is a value; the line for people.
fn transferred(target: &ObjectArgs, text: Option<&str>) -> Result<String, ToolError> {
    let mut sheets = of_the_rig();
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
    let request = match (text, &entry) {
        (None, _) => Request::Read,
        (Some(text), Some(entry)) => {
            Request::Write(value::parse(entry, text).map_err(ToolError::Usage)?)
        }
        (Some(text), None) => Request::Write(value::parse_untyped(text).ok_or_else(|| {
            ToolError::Usage(format!(
                "no EDS gives the type of 0x{:04X}:{:02X}, so the size of \"{text}\" is not known: write 0x with two digits \
                 for each byte (0x0032 for 16 bits) or the bytes as they are sent (\"32 00\"), or name the node's EDS with --eds",
                place.0, place.1
            ))
        })?),
    };
    let written = match &request {
        Request::Read => None,
        Request::Write(bytes) => Some(bytes.clone()),
    };
    let mut transfer = Transfer::new(node_id, place, request, sheets);
    super::run(&mut transfer, &target.bus.bus)?;
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
