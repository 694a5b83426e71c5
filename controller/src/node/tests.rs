//! The controller against a simulated drive, in virtual time on a bus without delays.

mod played;
mod several;

use can::{CanFrame, Node, Progress};
use canopen::cia402::{OptionCodes, State, StateMachine, Status};
use canopen::emcy::ErrorCode;
use canopen::nmt::{NmtCommand, NmtState};
use canopen::object_dictionary::{AbortCode, Preset};
use canopen::pdo::WaitingPdo;
use canopen::sync::Sync;
use canopen::{Application, CommunicationLoss, Services, eds};
use proptest::prelude::*;
use scenario::wiring::IoWiring;
use scenario::{Asked, Beside, Scenario};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use scenario::node::{Node as RigNode, Nodes, Profile};

use super::*;
use crate::cause::Cause;

const MILLISECOND: Duration = Duration::from_millis(1);
/// Node-ID of the drive unless a rig file has another one.
const DRIVE: NodeId = NodeId::new(0x10).unwrap();

/// A drive whose position follows the current at once: 2 mm at 1 A.
#[derive(Default)]
struct TestDrive {
    machine: StateMachine,
    /// Whether a fault stays.
    is_broken: bool,
    /// Object whose writes it refuses.
    refuses: Option<(u16, AbortCode)>,
    /// Command at the latest SYNC.
    torque_permille: i128,
    /// Error of the position in micrometres.
    position_error: i128,
}

impl TestDrive {
    fn is_heating(&self) -> bool {
        self.torque_permille != 0
    }

    fn update(&mut self, services: &mut Services) {
        if !self.machine.is_current_allowed() {
            self.torque_permille = 0;
        }
        let status = Status {
            is_voltage_enabled: true,
            is_remote: true,
            ..Status::default()
        };
        let statusword = self.machine.statusword(&status);
        let dictionary = services.dictionary_mut();
        dictionary
            .set_integer(0x6041, 0, i128::from(statusword))
            .unwrap();
        dictionary
            .set_integer(0x6064, 0, self.torque_permille * 2 + self.position_error)
            .unwrap();
    }
}

impl Application for TestDrive {
    fn on_reset(&mut self, services: &mut Services, reset: NmtCommand) {
        if reset == NmtCommand::ResetNode {
            self.machine = StateMachine::default();
        }
        self.update(services);
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if state != NmtState::Operational {
            self.machine.disable();
        }
        self.update(services);
    }

    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {
        let dictionary = services.dictionary();
        let wanted = dictionary.find(0x6040, 0).unwrap();
        let controlword = waiting.integer(dictionary, wanted).unwrap();
        let controlword = u16::try_from(controlword).unwrap();
        self.machine
            .on_waiting_controlword(controlword, &OptionCodes::default());
        self.update(services);
    }

    fn on_rpdo(&mut self, services: &mut Services, _: u16) {
        let controlword = services.dictionary().unsigned(0x6040, 0).unwrap();
        let controlword = u16::try_from(controlword).unwrap();
        self.machine
            .on_controlword(controlword, &OptionCodes::default(), self.is_broken);
    }

    fn on_sync(&mut self, services: &mut Services, _: &Sync) {
        self.torque_permille = services.dictionary().integer(0x6071, 0).unwrap();
        self.update(services);
    }

    fn on_write(&mut self, _: &mut Services, index: u16, _: u8, _: &[u8]) -> Result<(), AbortCode> {
        match self.refuses {
            Some((refused, code)) if refused == index => Err(code),
            _ => Ok(()),
        }
    }

    fn on_communication_loss(&mut self, services: &mut Services, _: CommunicationLoss) {
        self.machine.on_communication_loss(&OptionCodes::default());
        self.update(services);
    }
}

struct Module;

impl Application for Module {}

/// A bus with controller, drive and disturbance module. Frames arrive at once.
struct Bus {
    now: Duration,
    controller: ControllerNode,
    drive: Option<Device<TestDrive>>,
    second: Option<Device<TestDrive>>,
    module: Option<Device<Module>>,
    log: Vec<(Duration, CanFrame)>,
    /// Identifier of frames that are lost.
    lost: Option<u16>,
}

const CLOSED_LOOP: &str =
    "[controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
const OPEN_LOOP: &str = "[[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.25\n\
    [[controller.open_loop.step]]\nat_seconds = 0.01\ncurrent_amperes = 0.5\n";

fn controller(tables: &str) -> ControllerNode {
    controller_node(&view(tables)).unwrap()
}

fn view(tables: &str) -> ControllerView {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n{tables}"
    );
    let beside = Beside::new(Path::new("t.toml"));
    let mut none = |_: &str| Err(std::io::ErrorKind::NotFound.into());
    let scenario = Scenario::parse(&beside, text, &mut none, &Asked::default()).unwrap();
    scenario.loops.first().unwrap().controller_view()
}

fn drive(node_id: NodeId) -> Device<TestDrive> {
    let dictionary = eds::parse(dbc::DRIVE_EDS, node_id.get()).unwrap();
    Device::new(node_id, dictionary, TestDrive::default()).unwrap()
}

/// The io node of the rig that ships.
const DISTURBANCE: NodeId = NodeId::new(0x11).unwrap();

fn module() -> Device<Module> {
    let dictionary = eds::parse(dbc::DISTURBANCE_EDS, DISTURBANCE.get()).unwrap();
    Device::new(DISTURBANCE, dictionary, Module).unwrap()
}

impl Bus {
    fn new(tables: &str) -> Self {
        Self {
            now: Duration::ZERO,
            controller: controller(tables),
            drive: Some(drive(DRIVE)),
            second: None,
            module: Some(module()),
            log: Vec::new(),
            lost: None,
        }
    }

    fn nodes(&mut self) -> Vec<&mut dyn Node> {
        let mut nodes: Vec<&mut dyn Node> = vec![&mut self.controller];
        nodes.extend(self.drive.as_mut().map(|node| node as &mut dyn Node));
        nodes.extend(self.second.as_mut().map(|node| node as &mut dyn Node));
        nodes.extend(self.module.as_mut().map(|node| node as &mut dyn Node));
        nodes
    }

    /// Delivers frames until no node has any.
    fn settle(&mut self) {
        let now = self.now;
        for _ in 0..10_000 {
            let nodes = self.nodes();
            let sent = nodes
                .into_iter()
                .enumerate()
                .find_map(|(place, node)| Some((place, node.next_frame()?)));
            let Some((sender, frame)) = sent else { return };
            self.log.push((now, frame));
            if self.lost.is_some() && frame.standard_id() == self.lost {
                continue;
            }
            for (place, node) in self.nodes().into_iter().enumerate() {
                let is_wanted = node.filters().iter().any(|filter| filter.accepts(&frame));
                if place != sender && is_wanted {
                    node.on_frame(now, &frame);
                }
            }
        }
        panic!("the bus does not come to rest");
    }

    fn run_until(&mut self, end: Duration) {
        loop {
            let deadlines = self
                .nodes()
                .into_iter()
                .filter_map(|node| node.next_deadline());
            let next = deadlines.min().unwrap_or(end).max(self.now);
            if next > end {
                self.now = end;
                return;
            }
            self.now = next;
            for place in 0..self.nodes().len() {
                let node = self.nodes().swap_remove(place);
                if node
                    .next_deadline()
                    .is_some_and(|deadline| deadline <= next)
                {
                    node.on_tick(next);
                }
                self.settle();
            }
        }
    }

    fn run_for(&mut self, time: Duration) {
        self.run_until(self.now + time);
    }

    /// Returns whether scenario time has begun.
    fn is_running(&self) -> bool {
        matches!(self.controller.application().phase, Phase::Running(_))
    }

    /// Returns the number of cycles from a time on in which a drive got no command.
    fn cycles_without_command(&self, id: u16, from: Duration) -> usize {
        self.frames(0x080, from).len() - self.frames(id, from).len()
    }

    /// Runs until the law steps.
    fn run_until_running(&mut self) {
        for _ in 0..12_000 {
            if self.is_running() {
                return;
            }
            self.run_for(MILLISECOND);
        }
        panic!("not running: {:?}", self.controller.progress());
    }

    /// Runs until the controller ends, and returns its result.
    #[track_caller]
    fn ending(&mut self) -> Progress {
        for _ in 0..20_000 {
            match self.controller.progress() {
                Progress::Running => self.run_for(MILLISECOND),
                ending => return ending,
            }
        }
        panic!("the controller does not end");
    }

    #[track_caller]
    fn fails_with(&mut self, expected: &str) {
        assert_eq!(self.ending(), Progress::Failed(expected.to_owned()));
        if let Some(drive) = &self.drive {
            assert!(
                !drive.application().is_heating(),
                "the wire is still heated"
            );
        }
        assert!(
            self.has_sent(&NmtCommand::Stop.frame(Some(DRIVE))),
            "the drive was not stopped"
        );
    }

    fn has_sent(&self, frame: &CanFrame) -> bool {
        self.log.iter().any(|(_, sent)| sent == frame)
    }

    fn drive(&mut self) -> &mut Device<TestDrive> {
        self.drive.as_mut().unwrap()
    }

    /// Returns the frames with an identifier, in order, from a time on.
    fn frames(&self, id: u16, from: Duration) -> Vec<CanFrame> {
        let log = self
            .log
            .iter()
            .filter(|(time, frame)| *time >= from && frame.standard_id() == Some(id));
        log.map(|(_, frame)| *frame).collect()
    }

    /// Returns the downloads to the drive: index, sub-index and value.
    fn downloads(&self) -> Vec<(u16, u8, u32)> {
        let requests = self.frames(0x610, Duration::ZERO);
        let downloads = requests
            .iter()
            .filter(|frame| frame.data()[0] & 0xE0 == 0x20);
        let decode = |frame: &CanFrame| {
            let [_, low, high, sub_index, value @ ..] = frame.buffer();
            (
                u16::from_le_bytes([low, high]),
                sub_index,
                u32::from_le_bytes(value),
            )
        };
        downloads.map(decode).collect()
    }
}

#[test]
fn the_drive_is_configured_started_and_led_to_operation_enabled() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    let expected = [
        (0x1016, 1, 0x0001_0064),
        (0x1017, 0, 20),
        (0x6060, 0, 10),
        (0x1006, 0, 1000),
    ];
    assert_eq!(
        bus.downloads(),
        expected,
        "a mapping that agrees is not written"
    );
    assert_eq!(bus.drive().services().nmt_state(), NmtState::Operational);
    let controlwords: Vec<u8> = bus
        .frames(0x210, Duration::ZERO)
        .iter()
        .map(|frame| frame.data()[0])
        .collect();
    assert_eq!(controlwords[..4], [0x06, 0x07, 0x0F, 0x0F]);
    assert_eq!(bus.controller.progress(), Progress::Running);
}

#[test]
fn the_module_is_started_when_it_boots_and_its_absence_is_no_failure() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    assert_eq!(
        bus.module.as_ref().unwrap().services().nmt_state(),
        NmtState::Operational
    );

    let mut bus = Bus::new(OPEN_LOOP);
    bus.module = None;
    bus.run_until_running();
    bus.run_for(300 * MILLISECOND);
    bus.module = Some(module());
    bus.run_for(300 * MILLISECOND);
    assert_eq!(
        bus.module.as_ref().unwrap().services().nmt_state(),
        NmtState::Operational
    );
    bus.module = None;
    bus.run_for(300 * MILLISECOND);
    assert_eq!(bus.controller.progress(), Progress::Running);
}

#[test]
fn time_zero_is_the_first_sync_after_operation_enabled_and_commands_follow_the_scenario() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.run_for(50 * MILLISECOND);
    let is_enabled =
        |frame: &CanFrame| frame.standard_id() == Some(0x190) && frame.data()[0] & 0x6F == 0x27;
    let enabled = bus
        .log
        .iter()
        .position(|(_, frame)| is_enabled(frame))
        .unwrap();
    let is_sync = |entry: &&(Duration, CanFrame)| entry.1.standard_id() == Some(0x080);
    let start = bus.log[enabled..].iter().find(is_sync).unwrap().0;
    // The command of cycle 0 is computed from its sample, so it is the first RPDO after the SYNC.
    let commands = bus.frames(0x210, start);
    let torque = |frame: &CanFrame| i16::from_le_bytes([frame.data()[2], frame.data()[3]]);
    assert!(
        commands[..10].iter().all(|frame| torque(frame) == 250),
        "{commands:?}"
    );
    assert!(
        commands[10..].iter().all(|frame| torque(frame) == 500),
        "{commands:?}"
    );
    let before = bus
        .log
        .iter()
        .filter(|(time, frame)| *time < start && frame.standard_id() == Some(0x210));
    assert!(before.into_iter().all(|(_, frame)| torque(frame) == 0));
}

#[test]
fn each_sync_brings_one_command_and_every_tenth_the_terms() {
    let mut bus = Bus::new(CLOSED_LOOP);
    bus.run_until_running();
    let from = bus.now + MILLISECOND / 2;
    bus.run_for(Duration::from_secs(1));
    let syncs = bus.frames(0x080, from);
    assert_eq!(syncs.len(), 1000);
    assert_eq!(bus.frames(0x190, from).len(), 1000);
    assert_eq!(bus.frames(0x210, from).len(), 1000);
    for (id, count) in [(0x181, 100), (0x281, 100), (0x381, 0), (0x481, 0)] {
        assert_eq!(bus.frames(id, from).len(), count, "{id:#x}");
    }
    let counters: Vec<u8> = syncs.iter().map(|frame| frame.data()[0]).collect();
    assert!(counters.windows(2).all(|pair| pair[1] == pair[0] % 240 + 1));
}

#[test]
fn a_mapping_that_differs_is_written_by_the_full_procedure() {
    let mut bus = Bus::new(OPEN_LOOP);
    // A drive of the same kind that maps position before statusword.
    let text = dbc::DRIVE_EDS
        .replace("0x60410010", "swapped")
        .replace("0x60640020", "0x60410010")
        .replace("swapped", "0x60640020");
    let dictionary = eds::parse(&text, DRIVE.get()).unwrap();
    bus.drive = Some(Device::new(DRIVE, dictionary, TestDrive::default()).unwrap());
    bus.run_until_running();
    let is_pdo = |(index, ..): &(u16, u8, u32)| (0x1400..0x1C00).contains(index);
    let mapping: Vec<_> = bus.downloads().into_iter().filter(is_pdo).collect();
    let expected = [
        (0x1800, 1, 0xC000_0190),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x6041_0010),
        (0x1A00, 2, 0x6064_0020),
        (0x1A00, 3, 0x6078_0010),
        (0x1800, 2, 1),
        (0x1A00, 0, 3),
        (0x1800, 1, 0x4000_0190),
    ];
    assert_eq!(mapping, expected);
}

#[test]
fn an_abort_names_object_value_and_reason() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive().application_mut().refuses = Some((0x6060, AbortCode::INVALID_VALUE));
    bus.fails_with(
        "the drive did not accept 10 for Modes of operation: object 0x6060:00 of node 0x10: abort 0x0609_0030: invalid value for parameter",
    );
}

#[test]
fn another_device_is_not_driven() {
    let mut bus = Bus::new(OPEN_LOOP);
    let text = dbc::DRIVE_EDS.replace("DefaultValue=0x00020192", "DefaultValue=0x00020191");
    let dictionary = eds::parse(&text, DRIVE.get()).unwrap();
    bus.drive = Some(Device::new(DRIVE, dictionary, TestDrive::default()).unwrap());
    bus.fails_with(
        "the node is not the drive of the EDS: Device type (0x1000:00) is 0x00020191 instead of 0x00020192",
    );
}

#[test]
fn what_the_eds_leaves_blank_is_asked_and_not_compared() {
    let mut bus = Bus::new(OPEN_LOOP);
    // The vendor in the EDS is 0.
    let mut dictionary = eds::parse(dbc::DRIVE_EDS, DRIVE.get()).unwrap();
    dictionary.preset(&Preset::new(0x1018, 1, 0x2FE));
    bus.drive = Some(Device::new(DRIVE, dictionary, TestDrive::default()).unwrap());
    bus.run_until_running();
    let asked = CanFrame::new(0x610, &[0x40, 0x18, 0x10, 1, 0, 0, 0, 0]);
    assert!(bus.has_sent(&asked));
}

#[test]
fn a_drive_that_boots_twice_is_led_whenever_the_second_boot_comes() {
    let start = NmtCommand::Start.frame(Some(DRIVE));
    let mut was_started = false;
    for quarters in 1..160 {
        let mut bus = Bus::new(OPEN_LOOP);
        bus.run_until(quarters * MILLISECOND / 4);
        // The drive would boot at the SYNC of time 0, from which on the laws lead it.
        if bus.is_running() || bus.controller.application().is_ready() {
            break;
        }
        was_started |= bus.has_sent(&start);
        let drive = bus.drive().services_mut();
        drive.request_nmt(NmtCommand::ResetNode);
        bus.run_until_running();
    }
    assert!(was_started);
}

#[test]
fn without_a_drive_the_controller_gives_up_after_ten_seconds() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive = None;
    bus.fails_with(
        "no drive: node 16 sent no boot-up message or heartbeat and answered no SDO for 10 s",
    );
    assert_eq!(bus.now, Timeouts::default().bring_up());
    assert_eq!(bus.frames(0x610, Duration::ZERO).len(), 100);
}

#[test]
fn a_drive_that_appears_late_is_found() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive = None;
    bus.run_until(Duration::from_secs(9));
    bus.drive = Some(drive(DRIVE));
    bus.run_until_running();
}

#[test]
fn a_silent_drive_that_only_answers_sdo_is_found_and_reset() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive().on_tick(Duration::ZERO);
    bus.drive().write(0x1017, 0, &[0, 0]).unwrap();
    while bus.drive().next_frame().is_some() {}
    bus.run_until_running();
    assert!(bus.has_sent(&NmtCommand::ResetCommunication.frame(Some(DRIVE))));
}

#[test]
fn a_restarted_controller_takes_over_a_drive_that_was_left_operational() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.run_for(20 * MILLISECOND);
    assert!(bus.drive().application().is_heating());
    bus.controller = controller(OPEN_LOOP);
    bus.log.clear();
    bus.run_until_running();
    assert!(bus.has_sent(&NmtCommand::ResetCommunication.frame(Some(DRIVE))));
    assert_eq!(
        bus.drive().application().machine.state(),
        State::OperationEnabled
    );
}

#[test]
fn a_fault_from_before_is_reset_and_one_that_stays_is_reported() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive().on_tick(Duration::ZERO);
    bus.drive().application_mut().machine.on_fault();
    bus.run_until_running();

    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive().on_tick(Duration::ZERO);
    bus.drive().application_mut().machine.on_fault();
    bus.drive().application_mut().is_broken = true;
    bus.fails_with(
        "the drive (node 16) did not reach Operation enabled within 2 s; its last statusword was 0x0218 (Fault)",
    );
}

#[test]
fn a_fault_whose_cause_goes_late_is_reset_all_the_same() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.drive().on_tick(Duration::ZERO);
    bus.drive().application_mut().machine.on_fault();
    bus.drive().application_mut().is_broken = true;
    bus.run_for(100 * MILLISECOND);
    bus.drive().application_mut().is_broken = false;
    bus.run_until_running();
}

#[test]
fn a_second_sample_in_a_cycle_brings_no_second_command() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    let from = bus.now + MILLISECOND / 2;
    bus.run_until(from);
    let sample = *bus.frames(0x190, Duration::ZERO).last().unwrap();
    bus.controller.on_frame(bus.now, &sample);
    bus.settle();
    assert!(bus.frames(0x210, from).is_empty());
}

#[test]
fn a_drive_that_falls_silent_is_a_lost_heartbeat_or_lost_positions() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.run_for(20 * MILLISECOND);
    bus.drive = None;
    bus.fails_with("no position from the drive (node 16, frame 0x190) in 21 cycles (limit 20)");

    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.lost = Some(0x710);
    bus.fails_with("heartbeat from the drive (node 16) missing for 100 ms (limit 100 ms)");
}

#[test]
fn a_few_lost_positions_hold_the_last_command() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.run_for(20 * MILLISECOND + MILLISECOND / 2);
    let from = bus.now;
    bus.lost = Some(0x190);
    let missing_max = Timeouts::default().missing_positions_cycles;
    bus.run_for(missing_max * MILLISECOND);
    assert_eq!(bus.drive().application().torque_permille, 500);
    bus.lost = None;
    bus.run_for(100 * MILLISECOND);
    assert_eq!(bus.controller.progress(), Progress::Running);
    assert_eq!(
        bus.cycles_without_command(0x210, from),
        missing_max as usize
    );
}

#[test]
fn faults_emergencies_and_states_of_the_drive_end_the_run() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.drive().application_mut().machine.on_fault();
    bus.fails_with("the drive (node 16) left Operation enabled: statusword 0x0218 (Fault)");

    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.drive()
        .services_mut()
        .raise_error(ErrorCode::THERMAL_OVERLOAD, [0; 5]);
    bus.fails_with("the drive (node 16) reports emergency 0x2350, error register 0x03");

    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.drive()
        .services_mut()
        .request_nmt(NmtCommand::EnterPreOperational);
    bus.fails_with("the drive (node 16) left NMT state Operational: it is PreOperational");

    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.drive()
        .services_mut()
        .request_nmt(NmtCommand::ResetNode);
    bus.fails_with("the drive (node 16) restarted while it was led");
}

#[test]
fn stopping_takes_the_energy_away_before_the_drive_is_stopped() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    bus.run_for(20 * MILLISECOND);
    assert!(bus.drive().application().is_heating());
    let stop = bus.now;
    bus.controller.on_stop(stop);
    bus.settle();
    assert!(
        !bus.drive().application().is_heating(),
        "quick stop is obeyed at once"
    );
    assert_eq!(bus.ending(), Progress::Stopped);
    assert!(bus.now - stop <= 5 * MILLISECOND);
    let quick_stop = CanFrame::new(0x210, &[0x02, 0, 0, 0]);
    let place = |wanted: CanFrame| {
        bus.log
            .iter()
            .position(|(time, frame)| *time >= stop && *frame == wanted)
            .unwrap()
    };
    let stops = [DRIVE, DISTURBANCE].map(|node| place(NmtCommand::Stop.frame(Some(node))));
    assert!(stops.iter().all(|stop| place(quick_stop) < *stop));
    assert_eq!(bus.drive().services().nmt_state(), NmtState::Stopped);
    let frames = bus.log.len();
    bus.run_for(10 * MILLISECOND);
    assert!(
        bus.frames(0x080, bus.now - 8 * MILLISECOND).is_empty(),
        "SYNC has ended"
    );
    assert!(bus.log.len() < frames + 5);
}

#[test]
fn stopping_works_in_every_phase() {
    for milliseconds in 0..20 {
        let mut bus = Bus::new(OPEN_LOOP);
        bus.run_until(milliseconds * MILLISECOND);
        bus.controller.on_stop(bus.now);
        bus.settle();
        assert_eq!(bus.ending(), Progress::Stopped, "after {milliseconds} ms");
        assert!(!bus.drive().application().is_heating());
        assert_eq!(bus.drive().services().nmt_state(), NmtState::Stopped);
    }
}

#[test]
fn a_controller_ordered_about_by_another_master_takes_the_energy_away() {
    for (command, expected) in [
        (
            NmtCommand::Stop,
            "the controller was ordered to NMT state Stopped over the bus",
        ),
        (
            NmtCommand::ResetNode,
            "the controller was reset over the bus",
        ),
    ] {
        let mut bus = Bus::new(OPEN_LOOP);
        bus.run_until_running();
        bus.run_for(20 * MILLISECOND);
        bus.controller
            .on_frame(bus.now, &command.frame(NodeId::new(1)));
        bus.settle();
        bus.fails_with(expected);
    }
}

#[test]
fn late_ticks_skip_syncs_and_keep_scenario_time() {
    let mut bus = Bus::new(OPEN_LOOP);
    bus.run_until_running();
    let start = bus.now;
    let overruns = bus.controller.services().sync_overruns();
    // The controller's process sleeps through five SYNCs. The step of the profile at 10 ms is still on time.
    bus.now += 5 * MILLISECOND + MILLISECOND / 2;
    bus.run_until(start + 30 * MILLISECOND);
    assert!(bus.controller.services().sync_overruns() >= overruns + 4);
    let stepped = bus.log.iter().find(|(time, frame)| {
        *time > start
            && frame.standard_id() == Some(0x210)
            && frame.data()[2..] == 500_i16.to_le_bytes()
    });
    let delay = stepped.unwrap().0 - start;
    assert!(
        delay >= 9 * MILLISECOND && delay <= 11 * MILLISECOND,
        "{delay:?}"
    );
}

#[test]
fn the_terms_are_in_the_objects_of_the_dbc() {
    let mut bus = Bus::new(CLOSED_LOOP);
    bus.run_until_running();
    bus.run_for(500 * MILLISECOND);
    let frame = *bus.frames(0x181, Duration::ZERO).last().unwrap();
    let micrometres = i32::from_le_bytes(frame.data()[..4].try_into().unwrap());
    assert_eq!(micrometres, 10_000);
}

proptest! {
    #[test]
    fn arbitrary_frames_never_panic(
        frames in prop::collection::vec((0_u32..0x800, 0_u8..9, any::<[u8; 8]>(), 0_u64..3_000), 0..200),
        running in any::<bool>(),
    ) {
        let mut bus = Bus::new(CLOSED_LOOP);
        if running {
            bus.run_until_running();
        }
        for (id, length, data, microseconds) in frames {
            let frame = CanFrame::from_raw(id, length, data).unwrap();
            bus.controller.on_frame(bus.now, &frame);
            bus.settle();
            bus.run_for(Duration::from_micros(microseconds));
        }
        bus.controller.on_stop(bus.now);
        bus.settle();
        prop_assert!(bus.ending() != Progress::Running);
    }
}

/// Returns the EMCYs of the controller: code and number of the cause.
fn emergencies(bus: &Bus) -> Vec<(u16, u8)> {
    let emergencies = bus.frames(0x081, Duration::ZERO);
    let content = |frame: &CanFrame| {
        let data = frame.data();
        (u16::from_le_bytes([data[0], data[1]]), data[4])
    };
    emergencies.iter().map(content).collect()
}

#[test]
fn an_implausible_position_ends_the_run_and_the_bus_shows_why() {
    let mut bus = Bus::new(CLOSED_LOOP);
    bus.run_until_running();
    bus.run_for(50 * MILLISECOND);
    bus.drive().application_mut().position_error = 30_000;
    bus.run_for(40 * MILLISECOND);
    assert!(matches!(bus.controller.progress(), Progress::Failed(_)));
    assert_eq!(emergencies(&bus), [(0x7300, 3)]);
    assert!(!bus.drive().application().is_heating());
}

#[test]
fn a_single_spike_costs_a_cycle_only() {
    let mut bus = Bus::new(CLOSED_LOOP);
    bus.run_until_running();
    bus.run_for(50 * MILLISECOND + MILLISECOND / 2);
    let from = bus.now;
    bus.drive().application_mut().position_error = 30_000;
    bus.run_for(MILLISECOND);
    bus.drive().application_mut().position_error = 0;
    bus.run_for(50 * MILLISECOND);
    assert_eq!(bus.controller.progress(), Progress::Running);
    assert_eq!(bus.cycles_without_command(0x210, from), 1);
    assert_eq!(emergencies(&bus), []);
}

/// Returns a real drive as node 0x20 with these limits of the position.
fn real_drive(min: f64, max: f64) -> RealDrive {
    let limits = Limits {
        current_amperes: 0.3,
        min,
        max,
        rate_max: 1e4,
    };
    let timeouts = Timeouts {
        drive_heartbeat_milliseconds: 50,
        drive_lost_milliseconds: 200,
        ..Timeouts::default()
    };
    RealDrive {
        node_id: 32,
        timeouts,
        ..RealDrive::new(limits)
    }
}

/// Makes a bus with that drive, and an io node of this number.
fn bus_of(real: &RealDrive, io: Option<u8>) -> Bus {
    let mut bus = Bus::new(OPEN_LOOP);
    let node_id = real.node_id;
    let tables = format!("{OPEN_LOOP}[bus]\nsync_period_milliseconds = 5.0\n");
    let mut view = view(&tables);
    let controller = RigNode::canopen("controller", 0x01, Profile::Manager);
    let drive = RigNode::canopen("drive", node_id, Profile::Drive);
    let module = io.map(|id| RigNode::canopen("module", id, Profile::Io));
    let nodes = Nodes::new([controller, drive].into_iter().chain(module)).unwrap();
    let io = nodes.find("module").map(|node| IoWiring {
        node,
        outputs: BTreeMap::new(),
    });
    let drive = nodes.find("drive").unwrap();
    (view.wiring.drive, view.wiring.followed) = (drive, drive);
    view.wiring.set_nodes(&nodes);
    Arc::make_mut(&mut view.wiring.shared).io = io.into_iter().collect();
    let dictionary = eds::parse(dbc::DRIVE_EDS, node_id).unwrap();
    let layout = DriveLayout::new(dictionary.clone(), real).unwrap();
    let loops = [(&view, Some((real, &layout)))];
    bus.controller = controller_node_of_loops(loops, &no_player).unwrap();
    let node = NodeId::new(node_id).unwrap();
    bus.drive = Some(Device::new(node, dictionary, TestDrive::default()).unwrap());
    bus
}

#[test]
fn a_real_drive_is_led_at_its_cycle_and_within_its_current() {
    let mut bus = bus_of(&real_drive(-1.0, 45.0), None);
    bus.run_until_running();
    let from = bus.now + MILLISECOND / 2;
    bus.run_for(Duration::from_secs(1));
    assert_eq!(bus.frames(0x080, from).len(), 200);
    // The scenario's 0.5 A exceed the limit of the rig.
    assert_eq!(bus.drive().application().torque_permille, 300);
    assert_eq!(bus.controller.progress(), Progress::Running);
    bus.lost = Some(0x720);
    assert_eq!(
        bus.ending(),
        Progress::Failed(
            "heartbeat from the drive (node 32) missing for 200 ms (limit 200 ms)".to_owned()
        )
    );
}

#[test]
fn the_io_node_of_a_rig_is_started_and_stopped_under_its_number() {
    let mut bus = bus_of(&real_drive(-1.0, 45.0), Some(64));
    bus.run_until_running();
    let fan = NodeId::new(64);
    assert!(!bus.has_sent(&NmtCommand::Start.frame(fan)));
    bus.controller
        .on_frame(bus.now, &CanFrame::new(0x740, &[0x00]));
    bus.settle();
    assert!(bus.has_sent(&NmtCommand::Start.frame(fan)));
    bus.controller.on_stop(bus.now);
    assert_eq!(bus.ending(), Progress::Stopped);
    assert!(bus.has_sent(&NmtCommand::Stop.frame(fan)));
}

#[test]
fn a_position_beyond_the_rigs_limits_ends_the_run() {
    let mut bus = bus_of(&real_drive(-1.0, 0.55), None);
    let expected = "limit of the rig: the position is 0.60 mm (limits -1 to 0.55 mm)";
    assert_eq!(bus.ending(), Progress::Failed(expected.to_owned()));
    assert!(!bus.drive().application().is_heating());
    assert!(bus.has_sent(&NmtCommand::Stop.frame(NodeId::new(32))));
    let emergencies = bus.frames(0x081, Duration::ZERO);
    assert_eq!(emergencies.last().unwrap().data()[4], Cause::RigLimit as u8);
}
