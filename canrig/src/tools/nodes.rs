//! `canrig nodes`: lists the nodes on a bus.
//!
//! First the tool listens: heartbeats show nodes and their states, SYNC and heartbeats show whether a manager runs.
//! Without a manager it then calls every node-ID on its default SDO channel, so that nodes without a heartbeat show
//! too. At last it asks each node for its identity. It uses the second SDO channel if the node's data sheet has one and
//! the node answers there, else the default channel. It does not ask on a default channel that belongs to a running
//! controller.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use canopen::NmtState;
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID};
use canopen::sdo_client::{SdoClient, SdoError, SdoFailure};
use clap::Args;

use super::{NamesArgs, ToolBusArgs, ToolError, ended, seconds};
use plan::data_sheet::DataSheet;
use plan::presence::Presence;
use report::table::Table;
use runner::exit::Exit;

/// Default time for which the tool listens before it speaks: longer than usual heartbeat periods.
pub(crate) const LISTEN_SECONDS: f64 = 1.0;
/// Pause between two calls; it leaves room for the answers on a slow bus.
const CALL_PERIOD: Duration = Duration::from_millis(2);
/// Longest time to the answer of the last node called.
const CALL_PATIENCE: Duration = Duration::from_millis(500);
/// Time for each answer of a node that is present.
const ANSWER_TIME: Duration = Duration::from_secs(1);
const NODE_IDS: std::ops::RangeInclusive<u8> = 1..=127;

const DEVICE_TYPE: (u16, u8) = (0x1000, 0);
const DEVICE_NAME: (u16, u8) = (0x1008, 0);
/// Objects that each node is asked for.
const QUESTIONS: [(u16, u8); 6] = [
    DEVICE_TYPE,
    (0x1018, 1),
    (0x1018, 2),
    (0x1018, 3),
    (0x1018, 4),
    DEVICE_NAME,
];

/// Answers of a node; `None` for an object that it aborted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Identity {
    /// 0x1000
    pub device_type: Option<u32>,
    /// 0x1018:01 to :04
    pub identity: [Option<u32>; 4],
    /// 0x1008
    pub name: Option<String>,
}

/// Facts about one node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NodeOnBus {
    /// The state in its last heartbeat; `None` without heartbeat.
    pub state: Option<NmtState>,
    /// Identity by the node's own answers, or the reason why it is unknown.
    pub identity: Result<Identity, String>,
    /// Name of the data sheet that describes it.
    pub data_sheet: String,
}

/// The questions to one node, and its answers.
#[derive(Debug)]
struct IdentityQuestions {
    node_id: u8,
    client: SdoClient,
    /// Whether the default channel has not been tried yet.
    may_change_channel: bool,
    next: usize,
    identity: Identity,
}

#[derive(Debug)]
enum Phase {
    Listening { until: Option<Duration> },
    Calling { next: u8, at: Duration },
    Awaiting { until: Duration },
    Asking(Box<IdentityQuestions>),
    Done,
}

/// The roll call of a bus, a node without node-ID.
#[derive(Debug)]
pub(crate) struct RollCall {
    sheets: Vec<DataSheet>,
    /// Names of the nodes in the user's rig.
    names: BTreeMap<u8, String>,
    listen: Duration,
    presence: Presence,
    phase: Phase,
    /// Nodes that answered a call.
    called: Vec<u8>,
    /// Nodes that have not been asked yet.
    waiting: VecDeque<u8>,
    identities: BTreeMap<u8, Result<Identity, String>>,
    output: VecDeque<CanFrame>,
}

impl RollCall {
    /// Makes a roll call that listens for a time first. The report shows a node by its name, and lists each named node
    /// that is missing.
    fn new(sheets: Vec<DataSheet>, names: BTreeMap<u8, String>, listen: Duration) -> Self {
        Self {
            sheets,
            names,
            listen,
            presence: Presence::default(),
            phase: Phase::Listening { until: None },
            called: Vec::new(),
            waiting: VecDeque::new(),
            identities: BTreeMap::new(),
            output: VecDeque::new(),
        }
    }

    /// Returns the nodes that were found, by node-ID.
    pub(crate) fn nodes(&self) -> BTreeMap<u8, NodeOnBus> {
        let states = self.presence.states();
        let ids = states.keys().chain(&self.called);
        let node = |node_id: &u8| {
            let unasked = || Err("not asked: interrupted".to_owned());
            let identity = self
                .identities
                .get(node_id)
                .cloned()
                .unwrap_or_else(unasked);
            let node = NodeOnBus {
                state: states.get(node_id).copied(),
                data_sheet: self.data_sheet(*node_id, identity.as_ref().ok()),
                identity,
            };
            (*node_id, node)
        };
        ids.map(node).collect()
    }

    /// Returns the sign of a running manager, if one was heard.
    pub(crate) fn manager(&self) -> Option<String> {
        self.presence.manager(&self.sheets)
    }

    /// Returns the text for a node: `18 (0x12) y`.
    fn node(&self, node_id: u8) -> String {
        let name = self.names.get(&node_id);
        let name = name.map_or_else(String::new, |name| format!(" {name}"));
        format!("{node_id} (0x{node_id:02X}){name}")
    }

    /// Returns the data sheet that matches the node's identity. Without an identity it is the sheet of this node-ID,
    /// with a question mark.
    fn data_sheet(&self, node_id: u8, identity: Option<&Identity>) -> String {
        // Drives of one product differ in their node-IDs only.
        let (with_id, others): (Vec<_>, Vec<_>) =
            (self.sheets.iter()).partition(|sheet| sheet.node_id == node_id);
        let Some(identity) = identity else {
            let expected = with_id.first();
            return expected.map_or_else(String::new, |sheet| format!("{}?", sheet.name));
        };
        let mut sheets = with_id.into_iter().chain(others);
        let found = match (identity.device_type, identity.identity) {
            (Some(device_type), [Some(vendor), Some(product), ..]) => {
                sheets.find(|sheet| sheet.describes(device_type, vendor, product))
            }
            _ => None,
        };
        let Some(sheet) = found else {
            return "none".to_owned();
        };
        let expected = sheet.dictionary.unsigned(0x1018, 3);
        match identity.identity[2] {
            revision if revision == expected => sheet.name.clone(),
            Some(revision) => format!("{}, but revision 0x{revision:08X}", sheet.name),
            None => format!("{}, but no revision", sheet.name),
        }
    }

    fn on_answer_to_call(&mut self, frame: &CanFrame) {
        let node_id = frame
            .standard_id()
            .and_then(|id| id.checked_sub(DEFAULT_RESPONSE_ID))
            .and_then(|id| u8::try_from(id).ok())
            .filter(|id| NODE_IDS.contains(id));
        let is_about_device_type = frame.data().get(1..4) == Some(&[0x00, 0x10, 0x00]);
        if let Some(node_id) = node_id.filter(|_| is_about_device_type)
            && !self.called.contains(&node_id)
        {
            self.called.push(node_id);
        }
    }

    /// Ends listening. It calls every node-ID, or only asks the known nodes while a manager runs.
    fn begin(&mut self, now: Duration) {
        if self.manager().is_some() {
            self.ask_all(now);
        } else {
            let next = *NODE_IDS.start();
            self.phase = Phase::Calling { next, at: now };
            self.call(now);
        }
    }

    fn call(&mut self, now: Duration) {
        let Phase::Calling { next, at } = self.phase else {
            return;
        };
        if now < at {
            return;
        }
        let request = [0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0];
        self.output.push_back(CanFrame::new(
            DEFAULT_REQUEST_ID + u16::from(next),
            &request,
        ));
        self.phase = if next == *NODE_IDS.end() {
            Phase::Awaiting {
                until: now + CALL_PATIENCE,
            }
        } else {
            Phase::Calling {
                next: next + 1,
                at: now + CALL_PERIOD,
            }
        };
    }

    fn ask_all(&mut self, now: Duration) {
        let mut ids: Vec<u8> = self.presence.states().keys().copied().collect();
        ids.extend(&self.called);
        ids.sort_unstable();
        ids.dedup();
        self.waiting = ids.into();
        self.ask_next(now);
    }

    fn ask_next(&mut self, now: Duration) {
        self.phase = Phase::Done;
        while let Some(node_id) = self.waiting.pop_front() {
            let mut sheets = self.sheets.iter().filter(|sheet| sheet.node_id == node_id);
            let channel = sheets.find_map(DataSheet::second_channel);
            let taken = self.presence.why_not_default_channel(node_id, &self.sheets);
            let reason = match (self.presence.states().get(&node_id), channel, taken) {
                (Some(NmtState::Stopped), ..) => "not asked: a stopped node answers no SDO",
                (_, None, Some(_)) => "not asked: its only SDO channel is the controller's",
                _ => "",
            };
            if !reason.is_empty() {
                self.identities.insert(node_id, Err(reason.to_owned()));
                continue;
            }
            let mut client = SdoClient::new(node_id);
            if let Some((request, response)) = channel {
                client = client.with_channel(request, response);
            }
            let mut questions = Box::new(IdentityQuestions {
                node_id,
                client: client.with_timeout(ANSWER_TIME),
                may_change_channel: channel.is_some(),
                next: 0,
                identity: Identity::default(),
            });
            questions.ask(now);
            self.phase = Phase::Asking(questions);
            return;
        }
    }

    /// Keeps the answer of the node that is being asked, and asks the next question.
    fn advance(&mut self, now: Duration) {
        let Phase::Asking(questions) = &mut self.phase else {
            return;
        };
        if let Some(result) = questions.client.take_result() {
            let node_id = questions.node_id;
            match questions.on_result(&result) {
                Ok(()) if questions.next < QUESTIONS.len() => questions.ask(now),
                Ok(()) => {
                    let identity = std::mem::take(&mut questions.identity);
                    self.identities.insert(node_id, Ok(identity));
                    self.drain();
                    self.ask_next(now);
                }
                Err(error) => self.no_answer(now, error),
            }
        }
        self.drain();
    }

    /// Handles a node that is silent on its second channel. The node may not have one, so the default channel is tried
    /// if it is free.
    fn no_answer(&mut self, now: Duration, error: SdoError) {
        let Phase::Asking(questions) = &mut self.phase else {
            return;
        };
        let node_id = questions.node_id;
        let refusal = self.presence.why_not_default_channel(node_id, &self.sheets);
        let is_silent = questions.may_change_channel && questions.next == 0;
        if is_silent && refusal.is_none() {
            questions.may_change_channel = false;
            questions.client = SdoClient::new(node_id).with_timeout(ANSWER_TIME);
            questions.ask(now);
            return;
        }
        let reason = if is_silent {
            "no answer on its second SDO channel; the first is the controller's".to_owned()
        } else {
            error.to_string()
        };
        self.identities.insert(node_id, Err(reason));
        self.ask_next(now);
    }

    fn drain(&mut self) {
        if let Phase::Asking(questions) = &mut self.phase {
            while let Some(frame) = questions.client.next_frame() {
                self.output.push_back(frame);
            }
        }
    }
}

impl IdentityQuestions {
    fn ask(&mut self, now: Duration) {
        let (index, sub_index) = QUESTIONS[self.next];
        let started = self.client.start_upload(now, index, sub_index);
        debug_assert!(started.is_ok(), "one question at a time");
    }

    /// Keeps an answer. An abort counts as an answer.
    fn on_result(&mut self, result: &Result<Vec<u8>, SdoError>) -> Result<(), SdoError> {
        let bytes = match result {
            Ok(bytes) => Some(bytes.as_slice()),
            Err(error) if matches!(error.failure, SdoFailure::Aborted(_)) => None,
            Err(error) => return Err(*error),
        };
        let number = bytes
            .and_then(|bytes| bytes.try_into().ok())
            .map(u32::from_le_bytes);
        match QUESTIONS[self.next] {
            DEVICE_TYPE => self.identity.device_type = number,
            (_, sub_index @ 1..=4) => self.identity.identity[usize::from(sub_index) - 1] = number,
            _ => {
                self.identity.name = bytes.map(|bytes| String::from_utf8_lossy(bytes).into_owned());
            }
        }
        self.next += 1;
        Ok(())
    }
}

impl Node for RollCall {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::ALL]
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        match &mut self.phase {
            // Later frames may be answers to this tool itself.
            Phase::Listening { .. } => self.presence.on_frame(frame),
            Phase::Calling { .. } | Phase::Awaiting { .. } => self.on_answer_to_call(frame),
            Phase::Asking(questions) => {
                questions.client.on_frame(now, frame);
                self.advance(now);
            }
            Phase::Done => {}
        }
    }

    fn on_tick(&mut self, now: Duration) {
        match &mut self.phase {
            Phase::Listening {
                until: until @ None,
            } => *until = Some(now + self.listen),
            Phase::Listening { until: Some(until) } if now >= *until => self.begin(now),
            Phase::Calling { .. } => self.call(now),
            Phase::Awaiting { until } if now >= *until => self.ask_all(now),
            Phase::Asking(questions) => {
                questions.client.on_tick(now);
                self.advance(now);
            }
            _ => {}
        }
        self.drain();
    }

    fn on_stop(&mut self, _now: Duration) {
        self.phase = Phase::Done;
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.output.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        match &self.phase {
            Phase::Listening { until } => Some(until.unwrap_or_default()),
            Phase::Calling { at, .. } => Some(*at),
            Phase::Awaiting { until } => Some(*until),
            Phase::Asking(questions) => questions.client.next_deadline(),
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
pub(crate) fn nodes(args: &NodesArgs) -> Exit {
    ended(called(args))
}

/// Calls every node on a bus, and returns the table.
fn called(args: &NodesArgs) -> Result<String, ToolError> {
    let mut sheets = args.names.nodes()?.sheets;
    let mut names = BTreeMap::new();
    if args.names.rig.is_some() {
        names.extend((sheets.iter()).map(|sheet| (sheet.node_id, sheet.node_name.clone())));
    }
    for path in &args.eds {
        // The sheet is used for its identity only; the node-ID is not known yet.
        let sheet = DataSheet::load(path, 127)?;
        sheets.push(DataSheet {
            node_id: 0,
            ..sheet
        });
    }
    let listen = Duration::from_secs_f64(args.listen);
    let mut roll_call = RollCall::new(sheets, names, listen);
    super::run(&mut roll_call, &args.bus.chosen())?;
    Ok(report(&roll_call))
}

/// Returns the nodes as a table.
pub(crate) fn report(roll_call: &RollCall) -> String {
    let nodes = roll_call.nodes();
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
    for (node_id, node) in &nodes {
        let state = node.state.map_or("no heartbeat", state_name).to_owned();
        let [device_type, identity, name] = match &node.identity {
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
            state,
            device_type,
            identity,
            name,
            node.data_sheet.clone(),
        ]);
    }
    let mut text = table.to_string();
    let absent = roll_call.names.keys().filter(|id| !nodes.contains_key(id));
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
