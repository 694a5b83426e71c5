//! Senders on an embedded bus, whose hub knows the process of each frame: which process is which node, and which frames others
//! sent in a node's name.
//!
//! A node is the process that sent its boot-up or, before one, its first frame. Another process takes its place once that one has
//! ended. The bench plays nodes too, so its own frames are never foreign. Nor are those of an SDO client that only reads.

use std::time::Duration;

use can::CanFrame;
use canopen::NmtState;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::sdo::DEFAULT_REQUEST_ID as SDO_REQUESTS;
use plan::Plan;
use platform::process::is_running;
use platform::recorder::ReceivedFrame;
use recording::foreign::Foreign;

/// SDO command of a client that begins to write an object (CiA 301, 7.2.4.3.3).
const SDO_DOWNLOAD: u8 = 1;
/// Number of node-IDs, with 0.
const NODES: u16 = 0x80;
/// Largest number of foreign frames that are kept; more of them say nothing new.
const FOREIGN_MAX: usize = 100_000;

/// Senders of the frames of a run.
pub(super) struct Senders {
    /// Nodes that send, with their processes.
    nodes: Vec<Sender>,
    /// Place of the node that sends a message, by the message's identifier, in the order of these.
    places: Vec<(u32, usize)>,
    /// Process of the bench.
    bench: u32,
    /// Times and identifiers of foreign frames, on the clock of the recording.
    foreign: Vec<(Duration, u16)>,
}

struct Sender {
    name: String,
    process: Option<u32>,
    has_booted: bool,
}

impl Senders {
    pub(super) fn new(plan: &Plan) -> Self {
        let mut senders = Self {
            nodes: Vec::new(),
            places: Vec::new(),
            bench: std::process::id(),
            foreign: Vec::new(),
        };
        for message in plan.database().messages() {
            if let Some(name) = &message.sender {
                let place = senders.place_of(name);
                senders.places.push((message.raw_id, place));
            }
        }
        senders
    }

    /// Returns the place of a node, which is added if it is new.
    fn place_of(&mut self, name: &str) -> usize {
        let known = self.nodes.iter().position(|node| node.name == name);
        known.unwrap_or_else(|| {
            self.nodes.push(Sender {
                name: name.to_owned(),
                process: None,
                has_booted: false,
            });
            self.nodes.len() - 1
        })
    }

    /// Returns the process of a node, once it was heard.
    pub(super) fn process_of(&self, node: &str) -> Option<u32> {
        let mut nodes = self.nodes.iter();
        nodes.find(|one| one.name == node)?.process
    }

    /// Takes a frame, with its time on the clock of the recording.
    pub(super) fn hear(&mut self, time: Duration, received: &ReceivedFrame) {
        let frame = &received.frame;
        let Some(process) = received.process.filter(|process| *process != self.bench) else {
            return;
        };
        let raw_id = frame.raw_id();
        let Ok(place) = self.places.binary_search_by_key(&raw_id, |(id, _)| *id) else {
            return;
        };
        let Some(sender) = self.nodes.get_mut(self.places[place].1) else {
            return;
        };
        let is_first_boot = is_boot_up(frame) && !sender.has_booted;
        let is_sender = match sender.process {
            Some(known) if known == process => true,
            Some(known) => is_first_boot || !is_running(known),
            None => true,
        };
        if is_sender {
            sender.has_booted |= is_boot_up(frame);
            sender.process = Some(process);
            return;
        }
        let is_kept = !is_sdo_reading(frame) && self.foreign.len() < FOREIGN_MAX;
        let identifier = frame.standard_id().filter(|_| is_kept);
        self.foreign
            .extend(identifier.map(|identifier| (time, identifier)));
    }

    /// Forgets the foreign frames so far, not who is which node.
    pub(super) fn forget_foreign(&mut self) {
        self.foreign.clear();
    }

    /// Returns the identifier of the first foreign frame.
    pub(super) fn first_foreign(&self) -> Option<u16> {
        self.foreign.first().map(|(_, identifier)| *identifier)
    }

    /// Returns the foreign frames of a scenario that began at a time and took this long; all of one that never began.
    pub(super) fn foreign(&self, zero: Option<Duration>, duration: Duration) -> Foreign {
        let mut foreign = Foreign::default();
        let zero = zero.or(self.foreign.first().map(|(time, _)| *time));
        let zero = zero.unwrap_or_default();
        for (time, identifier) in &self.foreign {
            let seconds = time.as_secs_f64() - zero.as_secs_f64();
            if seconds < duration.as_secs_f64() {
                foreign.note(seconds, *identifier);
            }
        }
        foreign
    }
}

fn is_boot_up(frame: &CanFrame) -> bool {
    let is_heartbeat = frame.standard_id().is_some_and(|identifier| {
        (ERROR_CONTROL_ID..ERROR_CONTROL_ID + NODES).contains(&identifier)
    });
    is_heartbeat && frame.data() == [NmtState::Initialising.number()]
}

/// Returns whether a frame is an SDO client's that does not begin to write.
fn is_sdo_reading(frame: &CanFrame) -> bool {
    let is_request = frame
        .standard_id()
        .is_some_and(|identifier| (SDO_REQUESTS..SDO_REQUESTS + NODES).contains(&identifier));
    let command = frame.data().first().map(|byte| byte >> 5);
    is_request && command != Some(SDO_DOWNLOAD)
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use plan::catalogue::Catalogue;
    use scenario::Trial;

    use super::*;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n\
                        [controller.open_loop]\n";

    fn plan() -> Plan {
        let trial = Trial::parse(TEXT, "s.toml", |_| unreachable!("no table")).unwrap();
        Plan::new(trial, &Catalogue::shipped())
    }

    /// Sends each of these frames, 0.1 s apart, by the process named with it, and returns the foreign ones.
    fn heard(frames: &[(u32, CanFrame)]) -> Vec<(f64, u16)> {
        let mut senders = Senders::new(&plan());
        let times = (1..).map(|number| Duration::from_millis(100 * number));
        for (time, (process, frame)) in times.zip(frames) {
            let process = Some(*process);
            let received = ReceivedFrame {
                time,
                frame: *frame,
                process,
            };
            senders.hear(time, &received);
        }
        let foreign = senders.foreign(Some(Duration::ZERO), Duration::from_secs(1));
        let rows = foreign.iter().map(|row| (row.at_seconds, row.identifier));
        rows.collect()
    }

    #[test]
    fn a_node_is_the_process_that_booted_until_that_has_ended() {
        let mut ended = Command::new("true").spawn().unwrap();
        ended.wait().unwrap();
        let mut running = Command::new("sleep").arg("60").spawn().unwrap();
        let (ended, node, bench) = (ended.id(), running.id(), std::process::id());
        let [boot, heartbeat] = [0x00, 0x05].map(|state| CanFrame::new(0x710, &[state]));
        let other = 1;
        let position = CanFrame::new(0x190, &[0; 8]);
        let foreign = heard(&[
            // The process that boots replaces the first one; frames of the bench do not count.
            (other, heartbeat),
            (node, boot),
            (bench, heartbeat),
            (node, position),
            (other, position),
            (other, boot),
        ]);
        assert_eq!(foreign, [(0.5, 0x190), (0.6, 0x710)]);
        assert_eq!(
            heard(&[(ended, boot), (node, position), (node, heartbeat)]),
            []
        );
        running.kill().unwrap();
        running.wait().unwrap();
    }

    #[test]
    fn a_client_that_reads_by_sdo_is_not_foreign_and_one_that_writes_is() {
        let [read, write] =
            [0x40, 0x2B].map(|command| CanFrame::new(0x610, &[command, 0x17, 0x10, 0, 0, 0, 0, 0]));
        let mut manager = Command::new("sleep").arg("60").spawn().unwrap();
        let foreign = heard(&[
            (manager.id(), write),
            (1, read),
            (1, write),
            (1, CanFrame::new(0x333, &[])),
        ]);
        manager.kill().unwrap();
        manager.wait().unwrap();
        assert_eq!(foreign, [(0.3, 0x610)]);
    }
}
