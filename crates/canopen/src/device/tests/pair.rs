//! A manager and a drive, both devices, on one bus: configuration, start, torque, and the manager's death.

use super::*;
use crate::cia402::{OptionCodes, State, StateMachine, Status};
use crate::sdo_client::SdoClient;

/// Smallest drive: the state machine between controlword and statusword.
#[derive(Default)]
struct Drive {
    machine: StateMachine,
    target: i128,
    latest_sync: Duration,
    /// Time at which the current was last taken away.
    off_at: Option<Duration>,
}

impl Drive {
    fn settle(&mut self, services: &mut Services) {
        let status = Status {
            is_voltage_enabled: true,
            is_remote: services.nmt_state() == NmtState::Operational,
            mode: 10,
            ..Status::default()
        };
        let statusword = self.machine.statusword(&status);
        let dictionary = services.dictionary_mut();
        dictionary
            .set_integer(STATUSWORD, 0, statusword.into())
            .unwrap();
        if self.machine.is_current_allowed() {
            self.target = dictionary.integer(TARGET, 0).unwrap();
        } else if self.target != 0 {
            self.target = 0;
            self.off_at = Some(services.now());
        }
    }
}

impl Application for Drive {
    fn on_sync(&mut self, services: &mut Services, _: &Sync) {
        self.latest_sync = services.now();
        let controlword = services.dictionary().unsigned(CONTROLWORD, 0).unwrap();
        let controlword = u16::try_from(controlword).unwrap();
        self.machine
            .on_controlword(controlword, &OptionCodes::default(), false);
        self.settle(services);
    }

    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {
        let dictionary = services.dictionary();
        let wanted = dictionary.find(CONTROLWORD, 0).unwrap();
        let controlword = waiting.integer(dictionary, wanted);
        let controlword = u16::try_from(controlword.unwrap()).unwrap();
        self.machine
            .on_waiting_controlword(controlword, &OptionCodes::default());
        self.settle(services);
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if state != NmtState::Operational {
            self.machine.disable();
        }
        self.settle(services);
    }

    fn on_communication_loss(&mut self, services: &mut Services, _: CommunicationLoss) {
        self.machine.on_communication_loss(&OptionCodes::default());
        self.settle(services);
    }
}

/// Manager: waits for the drive's boot-up, configures it by SDO, starts it, produces SYNC and commands torque.
struct Manager {
    client: SdoClient,
    downloads: Vec<(u16, u8, Vec<u8>)>,
    commands_quick_stop: bool,
}

impl Manager {
    fn new() -> Self {
        let downloads = vec![
            (0x1006, 0, 1000_u32.to_le_bytes().to_vec()),
            (0x1016, 1, vec![100, 0, 1, 0]),
            (0x1017, 0, vec![50, 0]),
        ];
        Self {
            client: SdoClient::new(ID),
            downloads,
            commands_quick_stop: false,
        }
    }

    /// Starts the next download, or both nodes if there is none.
    fn go_on(&mut self, services: &mut Services) {
        let now = services.now();
        if let Some((index, sub_index, bytes)) = self.downloads.pop() {
            let started = self.client.start_download(now, (index, sub_index), &bytes);
            started.unwrap();
        } else {
            services.request_nmt(NmtCommand::Start);
            services.send_nmt(NmtCommand::Start, NodeId::new(ID));
            let period = 1000_u32.to_le_bytes();
            services.write(0x1006, 0, &period).unwrap();
            let producer = 0x4000_0080_u32.to_le_bytes();
            services.write(0x1005, 0, &producer).unwrap();
        }
        self.drain(services);
    }

    fn drain(&mut self, services: &mut Services) {
        while let Some(frame) = self.client.next_frame() {
            services.send(frame);
        }
    }
}

impl Application for Manager {
    fn on_heartbeat(&mut self, services: &mut Services, node_id: NodeId, state: NmtState) {
        if (node_id.get(), state) == (ID, NmtState::Initialising) {
            self.go_on(services);
        }
    }

    fn on_frame(&mut self, services: &mut Services, frame: &CanFrame) {
        self.client.on_frame(services.now(), frame);
        self.drain(services);
        if let Some(result) = self.client.take_result() {
            result.unwrap();
            self.go_on(services);
        }
    }

    fn on_rpdo(&mut self, services: &mut Services, _: u16) {
        let dictionary = services.dictionary_mut();
        let statusword = dictionary.unsigned(0x2000, 0).unwrap();
        let state = State::from_statusword(u16::try_from(statusword).unwrap()).unwrap();
        let controlword = if self.commands_quick_stop {
            0x02
        } else {
            state.controlword_towards_operation()
        };
        dictionary
            .set_integer(0x2002, 0, controlword.into())
            .unwrap();
        dictionary.set_integer(0x2003, 0, 500).unwrap();
        services.request_tpdo(1);
    }
}

/// Returns the manager's dictionary: the drive's TPDO1 comes in, its RPDO1 goes out.
fn manager_dictionary() -> ObjectDictionary {
    use DataType::{Integer16, Integer32, Unsigned8, Unsigned16, Unsigned32};
    let rw = Rights::ReadWrite;
    let mut all = ObjectDictionary::new();
    add(&mut all, 0x1001, 0, Unsigned8, Rights::ReadOnly, 0);
    add(&mut all, 0x1005, 0, Unsigned32, rw, 0x80);
    add(&mut all, 0x1006, 0, Unsigned32, rw, 0);
    add(&mut all, 0x1017, 0, Unsigned16, rw, 50);
    add(&mut all, 0x1019, 0, Unsigned8, rw, 240);
    add_pdo(&mut all, 0x1400, 0x190, 255, &[0x2000_0010, 0x2001_0020]);
    add_pdo(
        &mut all,
        0x1800,
        0x4000_0210,
        255,
        &[0x2002_0010, 0x2003_0010],
    );
    add(&mut all, 0x2000, 0, Unsigned16, rw, 0x40);
    add(&mut all, 0x2001, 0, Integer32, rw, 0);
    add(&mut all, 0x2002, 0, Unsigned16, rw, 0);
    add(&mut all, 0x2003, 0, Integer16, rw, 0);
    all
}

/// Both nodes and a bus that takes 100 microseconds for a frame.
struct Pair {
    manager: Device<Manager>,
    drive: Device<Drive>,
    now: Duration,
    is_manager_dead: bool,
}

impl Pair {
    fn new() -> Self {
        let manager = Device::new(
            NodeId::new(1).unwrap(),
            manager_dictionary(),
            Manager::new(),
        );
        let drive = Device::new(NodeId::new(ID).unwrap(), dictionary(), Drive::default());
        Self {
            manager: manager.unwrap(),
            drive: drive.unwrap(),
            now: Duration::ZERO,
            is_manager_dead: false,
        }
    }

    fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            if !self.is_manager_dead {
                tick(&mut self.manager, self.now);
            }
            tick(&mut self.drive, self.now);
            self.now += Duration::from_micros(100);
            if !self.is_manager_dead {
                exchange(self.now, &mut self.manager, &mut self.drive);
            }
            exchange(self.now, &mut self.drive, &mut self.manager);
        }
    }

    fn drive(&self) -> &Drive {
        self.drive.application()
    }
}

fn tick(node: &mut dyn Node, now: Duration) {
    if node.next_deadline().is_some_and(|deadline| deadline <= now) {
        node.on_tick(now);
    }
}

fn exchange(now: Duration, from: &mut dyn Node, to: &mut dyn Node) {
    while let Some(frame) = from.next_frame() {
        to.on_frame(now, &frame);
    }
}

#[test]
fn a_manager_configures_starts_and_drives_by_the_services_alone() {
    let mut pair = Pair::new();
    pair.run(milliseconds(100));
    assert_eq!(pair.drive().machine.state(), State::OperationEnabled);
    assert_eq!(pair.drive().target, 500);
    assert_eq!(pair.manager.services().sync_overruns(), 0);
}

#[test]
fn the_current_ends_within_two_periods_of_the_managers_last_sync() {
    let mut pair = Pair::new();
    pair.run(milliseconds(100));
    pair.is_manager_dead = true;
    let death = pair.now;
    pair.run(milliseconds(200));
    let off_at = pair.drive().off_at.unwrap();
    assert!(off_at - death <= milliseconds(2), "{:?}", off_at - death);
    assert_eq!(pair.drive().machine.state(), State::Fault);
    assert_eq!(
        pair.drive.services().nmt_state(),
        NmtState::PreOperational,
        "heartbeat lost"
    );
}

#[test]
fn quick_stop_acts_before_the_next_sync() {
    let mut pair = Pair::new();
    pair.run(milliseconds(100));
    pair.manager.application_mut().commands_quick_stop = true;
    while pair.drive().off_at.is_none() {
        pair.run(Duration::from_micros(100));
    }
    assert!(pair.drive().off_at.unwrap() > pair.drive().latest_sync);
    assert_eq!(pair.drive().machine.state(), State::SwitchOnDisabled);
}
