//! Checks of the drive and the other expected nodes on the bus: their presence, their identity, and their objects.
//!
//! The interview is a node without node-ID. It listens for another manager, sends the manager's heartbeat from then on, resets
//! the drive's communication, and asks by SDO, one object after the other. No current can flow: a drive that was reset is not
//! enabled.

use std::collections::VecDeque;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress, earlier};
use canopen::object_dictionary::{AbortCode, Entry};
use canopen::sdo_client::{SdoClient, SdoError, SdoFailure};
use canopen::{NmtCommand, NodeId, ObjectDictionary, cia402};
use scenario::rig::ObjectAddress;

use super::checklist::Check;
use crate::bus_place::ManagerHeartbeat;
use plan::data_sheet::{DataSheet, data_sheets_led_by};
use plan::loaded_drive::LoadedDrive;
use plan::presence::Presence;

/// Time to listen for another manager, longer than the period of its SYNC.
const LISTEN_TIME: Duration = Duration::from_millis(300);
/// Time between two calls to a node that has not answered.
const CALL_PERIOD: Duration = Duration::from_millis(100);
/// Standard objects that a controller uses, if the drive has them.
const USED: [(u16, u8); 5] = [
    (cia402::CONTROLWORD, 0),
    (cia402::STATUSWORD, 0),
    (cia402::MODES_OF_OPERATION, 0),
    (0x1016, 1),
    (0x1017, 0),
];
const DEVICE_TYPE: (u16, u8) = (0x1000, 0);
const IDENTITY: [(u16, u8); 3] = [DEVICE_TYPE, (0x1018, 1), (0x1018, 2)];

const OTHER_MANAGER: &str = "other manager";

/// SDO transfer.
#[derive(Clone, Debug)]
struct Question {
    entry: Entry,
    /// Bytes to write; a read if `None`.
    written: Option<Vec<u8>>,
}

impl Question {
    fn address(&self) -> (u16, u8) {
        (self.entry.index, self.entry.sub_index)
    }

    fn name(&self) -> String {
        let (index, sub_index) = self.address();
        format!("0x{index:04X}:{sub_index:02X} ({})", self.entry.name)
    }
}

type Answer = (Question, Result<Vec<u8>, SdoError>);

#[derive(Debug)]
enum Phase {
    Start,
    Listening { until: Duration },
    Calling { until: Duration, again: Duration },
    Asking,
    Done,
}

/// Questions to the nodes of a rig, with their answers.
#[derive(Debug)]
pub(super) struct Interview {
    dictionary: ObjectDictionary,
    patience: Duration,
    phase: Phase,
    /// Nodes that have not answered yet, the drive first, each with its name.
    to_call: VecDeque<(NodeId, String)>,
    present: Vec<(NodeId, String)>,
    client: SdoClient,
    answer_time: Duration,
    /// Questions on the identity, then on the objects that a run uses.
    questions: VecDeque<Question>,
    answers: Vec<Answer>,
    presence: Presence,
    sheets: Vec<DataSheet>,
    heartbeat: ManagerHeartbeat,
    output: VecDeque<CanFrame>,
}

impl Interview {
    /// Makes the interview of a drive by a manager with this node-ID. It calls all `nodes`, of which the drive is the first.
    pub(super) fn new(
        drive: &LoadedDrive,
        dictionary: ObjectDictionary,
        nodes: VecDeque<(NodeId, String)>,
        manager: u8,
    ) -> Self {
        let timeouts = &drive.real.timeouts;
        let used = used_objects(drive);
        let answer_time = Duration::from_millis(timeouts.sdo_answer_milliseconds.into());
        let entry = |(index, sub_index): (u16, u8)| {
            let handle = dictionary.find(index, sub_index).ok()?;
            Some(dictionary.entry(handle).clone())
        };
        let known = IDENTITY
            .into_iter()
            .filter(|(index, sub_index)| dictionary.unsigned(*index, *sub_index).is_some());
        let identity = known.filter_map(entry).map(|entry| Question {
            entry,
            written: None,
        });
        let used = used.into_iter().filter_map(entry);
        Self {
            patience: timeouts.bring_up(),
            phase: Phase::Start,
            to_call: nodes,
            present: Vec::new(),
            client: SdoClient::new(drive.layout.node_id.get()).with_timeout(answer_time),
            answer_time,
            questions: identity.chain(used.flat_map(questions)).collect(),
            answers: Vec::new(),
            presence: Presence::default(),
            sheets: data_sheets_led_by(manager),
            heartbeat: ManagerHeartbeat::of(manager),
            output: VecDeque::new(),
            dictionary,
        }
    }

    /// Returns the evidence of another manager, if one was heard: its own frames do not come back.
    pub(super) fn manager(&self) -> Option<String> {
        self.presence.manager(&self.sheets)
    }

    /// Returns the results of the interview.
    pub(super) fn checks(&self) -> Vec<Check> {
        if let Some(manager) = self.manager() {
            let found = format!(
                "{manager} is heard: end the other controller, or name it with --external controller"
            );
            return vec![Check::failed(OTHER_MANAGER, found)];
        }
        let mut checks = vec![Check::passed(OTHER_MANAGER, "none is heard"), self.nodes()];
        if !self.to_call.is_empty() {
            return checks;
        }
        let is_of_identity = |(question, _): &&Answer| IDENTITY.contains(&question.address());
        let (identity, objects): (Vec<_>, Vec<_>) = self.answers.iter().partition(is_of_identity);
        checks.push(self.check_identity(&identity));
        checks.push(check_objects(&objects));
        checks
    }

    fn nodes(&self) -> Check {
        let named = |(node, name): &(NodeId, String)| format!("{name} (node {node})");
        match self.to_call.front() {
            None => {
                let present: Vec<String> = self.present.iter().map(named).collect();
                Check::passed("nodes", format!("found: {}", present.join(", ")))
            }
            Some(absent) => Check::failed(
                "nodes",
                format!(
                    "{} answered no SDO for {} s: is it switched on, is that its node-ID, and its bit rate that of the bus?",
                    named(absent),
                    self.patience.as_secs_f64()
                ),
            ),
        }
    }

    fn check_identity(&self, answers: &[&Answer]) -> Check {
        let mut shown = Vec::new();
        for (question, answer) in answers {
            let (index, sub_index) = question.address();
            let read = match answer {
                Err(error) => return Check::failed("identity", error.to_string()),
                Ok(bytes) => unsigned(bytes),
            };
            let wanted = self.dictionary.unsigned(index, sub_index);
            let [read, wanted] = [read, wanted].map(|number| {
                number.map_or("no number".to_owned(), |number| format!("0x{number:X}"))
            });
            if read != wanted {
                let name = question.name();
                let text =
                    format!("{name} is {read}, in the EDS {wanted}: another drive, or another EDS");
                return Check::failed("identity", text);
            }
            shown.push(wanted);
        }
        let text = format!(
            "as in the EDS: device type, vendor, product {}",
            shown.join(", ")
        );
        Check::passed("identity", text)
    }

    fn call(&mut self, now: Duration, until: Duration) {
        let Some((node, _)) = self.to_call.front() else {
            return self.ask_next(now);
        };
        let node = node.get();
        self.phase = Phase::Calling {
            until,
            again: now + CALL_PERIOD,
        };
        self.start(now, node, DEVICE_TYPE, None);
    }

    fn ask_next(&mut self, now: Duration) {
        let Some(question) = self.questions.front().cloned() else {
            self.phase = Phase::Done;
            return;
        };
        self.phase = Phase::Asking;
        let drive = self.present.first().map_or(1, |(node, _)| node.get());
        let written = question.written.as_deref();
        self.start(now, drive, question.address(), written);
    }

    /// Starts a transfer with a node.
    fn start(
        &mut self,
        now: Duration,
        node: u8,
        (index, sub_index): (u16, u8),
        written: Option<&[u8]>,
    ) {
        self.client = SdoClient::new(node).with_timeout(self.answer_time);
        let started = match written {
            None => self.client.start_upload(now, index, sub_index),
            Some(bytes) => self.client.start_download(now, index, sub_index, bytes),
        };
        debug_assert!(
            started.is_ok(),
            "a new client is idle, and numbers are short"
        );
        self.drain();
    }

    fn advance(&mut self, now: Duration) {
        self.drain();
        let Some(result) = self.client.take_result() else {
            return;
        };
        match self.phase {
            // An abort is an answer, too; silence is not.
            Phase::Calling { .. } if has_answered(&result) => {
                self.present.extend(self.to_call.pop_front());
                self.call(now, now + self.patience);
            }
            Phase::Asking => {
                let asked = self.questions.pop_front();
                self.answers
                    .extend(asked.map(|question| (question, result)));
                self.ask_next(now);
            }
            _ => {}
        }
    }

    fn drain(&mut self) {
        let frames = std::iter::from_fn(|| self.client.next_frame());
        self.output.extend(frames);
    }
}

/// Returns every object of the drive that a run uses.
fn used_objects(drive: &LoadedDrive) -> Vec<(u16, u8)> {
    let drive = &drive.real.drive;
    let named = [
        &drive.command.object,
        &drive.position.object,
        &drive.current.object,
    ];
    let addresses = named
        .into_iter()
        .filter_map(|text| text.parse().ok())
        .map(|address: ObjectAddress| (address.index, address.sub_index));
    addresses.chain(USED).collect()
}

/// Reads objects that are readable by the EDS, and writes 0 to writable ones: that removes a command or switches a watch off.
fn questions(entry: Entry) -> Vec<Question> {
    let mut questions = Vec::new();
    if entry.access.is_readable() {
        questions.push(Question {
            entry: entry.clone(),
            written: None,
        });
    }
    // 0 is no mode of some drives; the object is written with its right value later.
    let may_be_zero = entry.index != cia402::MODES_OF_OPERATION;
    if let Some(bytes) = entry.data_type.size_bytes()
        && entry.access.is_writable()
        && may_be_zero
    {
        questions.push(Question {
            written: Some(vec![0; bytes]),
            entry,
        });
    }
    questions
}

fn check_objects(answers: &[&Answer]) -> Check {
    let (mut read, mut written) = (0, 0);
    for (question, answer) in answers {
        let wanted = question.entry.data_type.size_bytes();
        match (answer, &question.written) {
            (Err(error), None) => {
                let text = format!("{} cannot be read: {error}", question.name());
                return Check::failed("objects", text);
            }
            (Err(error), Some(_)) if waits_for_operational(question, error) => {}
            (Err(error), Some(_)) => {
                let text = format!("{} does not take 0: {error}", question.name());
                return Check::failed("objects", text);
            }
            (Ok(bytes), None) if wanted.is_some_and(|wanted| wanted != bytes.len()) => {
                let text = format!(
                    "{} has {} bytes, in the EDS {}",
                    question.name(),
                    bytes.len(),
                    wanted.unwrap_or_default()
                );
                return Check::failed("objects", text);
            }
            (Ok(_), None) => read += 1,
            (Ok(_), Some(_)) => written += 1,
        }
    }
    Check::passed(
        "objects",
        format!("{read} read, {written} written, as the EDS says"),
    )
}

/// Returns whether the drive refused its controlword before NMT state operational, as some do; the object then has no effect.
fn waits_for_operational(question: &Question, error: &SdoError) -> bool {
    let states = [AbortCode::DEVICE_STATE, AbortCode::LOCAL_CONTROL];
    question.entry.index == cia402::CONTROLWORD
        && matches!(error.failure, SdoFailure::Aborted(code) if states.contains(&code))
}

fn has_answered(result: &Result<Vec<u8>, SdoError>) -> bool {
    !matches!(result, Err(error) if matches!(error.failure, SdoFailure::TimedOut(_)))
}

/// Decodes a little-endian number of one to four bytes.
fn unsigned(bytes: &[u8]) -> Option<u32> {
    let mut buffer = [0; 4];
    buffer.get_mut(..bytes.len())?.copy_from_slice(bytes);
    (!bytes.is_empty()).then_some(u32::from_le_bytes(buffer))
}

impl Node for Interview {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::ALL]
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.presence.on_frame(frame);
        if self.manager().is_some() {
            self.phase = Phase::Done;
            return;
        }
        self.client.on_frame(now, frame);
        self.advance(now);
    }

    fn on_tick(&mut self, now: Duration) {
        match self.phase {
            Phase::Start => {
                let until = now + LISTEN_TIME;
                self.phase = Phase::Listening { until };
            }
            Phase::Listening { until } if now >= until => {
                self.heartbeat.start(now);
                let drive = self.to_call.front().map(|(node, _)| *node);
                self.output
                    .push_back(NmtCommand::ResetCommunication.frame(drive));
                self.call(now, now + self.patience);
            }
            Phase::Calling { until, .. } if now >= until => self.phase = Phase::Done,
            Phase::Calling { until, again } if now >= again => self.call(now, until),
            Phase::Asking => {
                self.client.on_tick(now);
                self.advance(now);
            }
            _ => {}
        }
        self.output.extend(self.heartbeat.due(now));
    }

    fn on_stop(&mut self, _now: Duration) {
        self.phase = Phase::Done;
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.output.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        let deadline = match self.phase {
            Phase::Start => Some(Duration::ZERO),
            Phase::Listening { until } => Some(until),
            Phase::Calling { until, again } => Some(until.min(again)),
            Phase::Asking => self.client.next_deadline(),
            Phase::Done => return None,
        };
        earlier(deadline, self.heartbeat.next_deadline())
    }

    fn progress(&self) -> Progress {
        match self.phase {
            Phase::Done => Progress::Stopped,
            _ => Progress::Running,
        }
    }
}
