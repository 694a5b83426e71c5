//! A device and a bench around it: each test plays the other side of the bus, frame by frame.

mod emcy;
mod fuzz;
mod heartbeat;
mod nmt;
mod pair;
mod pdo;
mod sdo;
mod sync;

use super::*;
use crate::object_dictionary::{AbortCode, Access as Rights, DataType, Entry};
use crate::pdo::WaitingPdo;

/// Node-ID of the drive.
const ID: u8 = 0x10;
const CONTROLWORD: u16 = 0x6040;
const STATUSWORD: u16 = 0x6041;
const TARGET: u16 = 0x6071;

/// Events of an application, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Heard {
    Reset(NmtCommand),
    State(NmtState),
    Sync(Option<u8>, i128),
    Rpdo(u16, i128),
    Waiting(u16, i128, i128),
    Write(u16, u8),
    Loss(CommunicationLoss),
    Recovery(CommunicationLoss),
    Heartbeat(u8, NmtState),
    Emergency(u8, ErrorCode),
    Frame(u16),
}

/// Application that notes its events; at each SYNC it copies the target into the statusword, so that TPDOs show when it ran.
#[derive(Default)]
struct Listener {
    heard: Vec<Heard>,
    /// Number of SYNCs before whose TPDOs it was asked for fresh values, which are this number; `None` if it has none.
    samplings: Option<i128>,
}

impl Application for Listener {
    fn on_reset(&mut self, _: &mut Services, reset: NmtCommand) {
        self.heard.push(Heard::Reset(reset));
    }

    fn on_nmt_state(&mut self, _: &mut Services, state: NmtState) {
        self.heard.push(Heard::State(state));
    }

    fn on_sync(&mut self, services: &mut Services, sync: &Sync) {
        let target = services.dictionary().integer(TARGET, 0).unwrap_or(-1);
        self.heard.push(Heard::Sync(sync.counter, target));
        let dictionary = services.dictionary_mut();
        dictionary.set_integer(STATUSWORD, 0, target & 0xFFFF).ok();
    }

    fn on_sampling(&mut self, services: &mut Services) {
        if let Some(samplings) = &mut self.samplings {
            *samplings += 1;
            let dictionary = services.dictionary_mut();
            dictionary.set_integer(0x2300, 0, *samplings).ok();
        }
    }

    fn on_rpdo(&mut self, services: &mut Services, number: u16) {
        let target = services.dictionary().integer(TARGET, 0).unwrap_or(-1);
        self.heard.push(Heard::Rpdo(number, target));
    }

    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {
        let dictionary = services.dictionary();
        let wanted = dictionary.find(CONTROLWORD, 0).unwrap();
        let controlword = waiting.integer(dictionary, wanted).unwrap_or(-1);
        let current = dictionary.integer(CONTROLWORD, 0).unwrap_or(-1);
        self.heard
            .push(Heard::Waiting(waiting.number, controlword, current));
    }

    fn on_write(
        &mut self,
        _: &mut Services,
        index: u16,
        sub_index: u8,
        bytes: &[u8],
    ) -> Result<(), AbortCode> {
        self.heard.push(Heard::Write(index, sub_index));
        if index == TARGET && bytes == [0xFF, 0x7F] {
            return Err(AbortCode::LOCAL_CONTROL);
        }
        Ok(())
    }

    fn on_communication_loss(&mut self, _: &mut Services, loss: CommunicationLoss) {
        self.heard.push(Heard::Loss(loss));
    }

    fn on_communication_recovery(&mut self, _: &mut Services, loss: CommunicationLoss) {
        self.heard.push(Heard::Recovery(loss));
    }

    fn on_heartbeat(&mut self, _: &mut Services, node_id: NodeId, state: NmtState) {
        self.heard.push(Heard::Heartbeat(node_id.get(), state));
    }

    fn on_emergency(&mut self, _: &mut Services, node_id: NodeId, message: &EmergencyMessage) {
        self.heard
            .push(Heard::Emergency(node_id.get(), message.code));
    }

    fn on_frame(&mut self, _: &mut Services, frame: &CanFrame) {
        self.heard
            .push(Heard::Frame(frame.standard_id().unwrap_or(0xFFFF)));
    }
}

/// Adds an object.
fn add(
    dictionary: &mut ObjectDictionary,
    index: u16,
    sub_index: u8,
    data_type: DataType,
    access: Rights,
    default: i128,
) {
    let size = data_type.size_bytes().unwrap();
    let bytes = default.to_le_bytes()[..size].to_vec();
    let mut entry = Entry::new(index, sub_index, "object", data_type, access, bytes);
    entry.is_pdo_mappable = index >= 0x2000;
    dictionary.insert(entry);
}

/// Adds a PDO with its mapping.
fn add_pdo(dictionary: &mut ObjectDictionary, index: u16, cob_id: u32, kind: u8, mapped: &[u32]) {
    use DataType::{Unsigned8, Unsigned16, Unsigned32};
    let rw = Rights::ReadWrite;
    add(dictionary, index, 0, Unsigned8, Rights::Constant, 6);
    add(dictionary, index, 1, Unsigned32, rw, cob_id.into());
    add(dictionary, index, 2, Unsigned8, rw, kind.into());
    add(dictionary, index, 3, Unsigned16, rw, 0);
    add(dictionary, index, 5, Unsigned16, rw, 0);
    if index >= 0x1800 {
        add(dictionary, index, 6, Unsigned8, rw, 0);
    }
    let mapping = index + 0x200;
    add(dictionary, mapping, 0, Unsigned8, rw, mapped.len() as i128);
    for sub_index in 1..=8_u8 {
        let entry = mapped.get(usize::from(sub_index) - 1).copied().unwrap_or(0);
        add(dictionary, mapping, sub_index, Unsigned32, rw, entry.into());
    }
}

/// Returns a drive-like dictionary: RPDO1 type 1 (controlword, target), RPDO2 type 255 (0x2301), TPDO1 type 1 (statusword,
/// 0x2300), TPDO2 type 255 (0x2301), and every service's objects.
fn dictionary() -> ObjectDictionary {
    use DataType::{Integer16, Integer32, Unsigned8, Unsigned16, Unsigned32};
    let (ro, rw) = (Rights::ReadOnly, Rights::ReadWrite);
    let mut all = ObjectDictionary::new();
    let objects = &mut all;
    add(objects, 0x1000, 0, Unsigned32, ro, 0x0002_0192);
    add(objects, 0x1001, 0, Unsigned8, ro, 0);
    add(objects, 0x1003, 0, Unsigned8, rw, 0);
    for sub_index in 1..=4 {
        add(objects, 0x1003, sub_index, Unsigned32, ro, 0);
    }
    add(objects, 0x1005, 0, Unsigned32, rw, 0x80);
    add(objects, 0x1006, 0, Unsigned32, rw, 0);
    add(objects, 0x1007, 0, Unsigned32, rw, 0);
    add(objects, 0x1014, 0, Unsigned32, rw, 0x80 + i128::from(ID));
    add(objects, 0x1015, 0, Unsigned16, rw, 0);
    add(objects, 0x1016, 0, Unsigned8, Rights::Constant, 3);
    for sub_index in 1..=3 {
        add(objects, 0x1016, sub_index, Unsigned32, rw, 0);
    }
    add(objects, 0x1017, 0, Unsigned16, rw, 0);
    add(objects, 0x1019, 0, Unsigned8, rw, 240);
    add(objects, 0x1029, 0, Unsigned8, Rights::Constant, 1);
    add(objects, 0x1029, 1, Unsigned8, rw, 0);
    add(objects, 0x1201, 0, Unsigned8, Rights::Constant, 2);
    add(objects, 0x1201, 1, Unsigned32, rw, 0x8000_0000);
    add(objects, 0x1201, 2, Unsigned32, rw, 0x8000_0000);
    add_pdo(objects, 0x1400, 0x210, 1, &[0x6040_0010, 0x6071_0010]);
    add_pdo(objects, 0x1401, 0x310, 255, &[0x2301_0020]);
    add_pdo(objects, 0x1800, 0x4000_0190, 1, &[0x6041_0010, 0x2300_0020]);
    add_pdo(objects, 0x1801, 0xC000_0290, 255, &[0x2301_0020]);
    add(objects, 0x2300, 0, Integer32, ro, 0);
    add(objects, 0x2301, 0, Integer32, rw, 0);
    add(objects, 0x2302, 0, Integer32, Rights::WriteOnly, 0);
    add(objects, 0x603F, 0, Unsigned16, ro, 0);
    add(objects, CONTROLWORD, 0, Unsigned16, rw, 0);
    add(objects, STATUSWORD, 0, Unsigned16, ro, 0);
    add(objects, TARGET, 0, Integer16, rw, 0);
    all
}

/// A device with the time and the frames that it sent.
struct Bench {
    device: Device<Listener>,
    now: Duration,
}

impl Bench {
    /// Returns a booted device in Pre-operational; its boot-up frame is taken.
    fn new() -> Self {
        Self::with(dictionary())
    }

    fn with(dictionary: ObjectDictionary) -> Self {
        let device = Device::new(NodeId::new(ID).unwrap(), dictionary, Listener::default());
        let mut bench = Self {
            device: device.unwrap(),
            now: Duration::ZERO,
        };
        assert_eq!(bench.tick(), ["710#00"]);
        bench.device.application.heard.clear();
        bench
    }

    /// Returns a device in Operational; the frames that it sent on the way are taken.
    fn operational() -> Self {
        let mut bench = Self::new();
        bench.send(0, &[1, ID]);
        bench.device.application.heard.clear();
        bench
    }

    fn drain(&mut self) -> Vec<String> {
        let frames = std::iter::from_fn(|| self.device.next_frame());
        frames.map(|frame| frame.to_string()).collect()
    }

    fn tick(&mut self) -> Vec<String> {
        self.device.on_tick(self.now);
        self.drain()
    }

    /// Delivers a frame at the present time, and returns the answers.
    fn send(&mut self, id: u16, data: &[u8]) -> Vec<String> {
        self.send_frame(&CanFrame::new(id, data))
    }

    fn send_frame(&mut self, frame: &CanFrame) -> Vec<String> {
        self.device.on_frame(self.now, frame);
        self.drain()
    }

    /// Lets time pass as a runner does: ticks at each deadline. Returns the frames that were sent, with their milliseconds.
    fn pass(&mut self, time: Duration) -> Vec<(f64, String)> {
        let end = self.now + time;
        let mut sent = Vec::new();
        while let Some(deadline) = self.device.next_deadline().filter(|next| *next <= end) {
            self.now = self.now.max(deadline);
            let frames = self.tick();
            let milliseconds = self.now.as_secs_f64() * 1e3;
            sent.extend(frames.into_iter().map(|frame| (milliseconds, frame)));
            assert!(
                self.device
                    .next_deadline()
                    .is_none_or(|next| next > self.now),
                "a tick does what is due"
            );
        }
        self.now = end;
        sent
    }

    fn heard(&mut self) -> Vec<Heard> {
        std::mem::take(&mut self.device.application.heard)
    }

    /// Sends an SDO request and returns the answer's payload.
    fn request(&mut self, request: &[u8]) -> [u8; 8] {
        let answers = self.send(0x600 + u16::from(ID), request);
        let answer = answers.iter().find_map(|frame| frame.strip_prefix("590#"));
        let answer = u64::from_str_radix(answer.expect("the server answers"), 16).unwrap();
        answer.to_be_bytes()
    }

    /// Writes by SDO, expedited; the abort code is the error.
    fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Result<(), AbortCode> {
        let command = 0x23 | u8::try_from(4 - bytes.len()).unwrap() << 2;
        let [low, high] = index.to_le_bytes();
        let mut request = [command, low, high, sub_index, 0, 0, 0, 0];
        request[4..4 + bytes.len()].copy_from_slice(bytes);
        match self.request(&request) {
            [0x60, ..] => Ok(()),
            [.., a, b, c, d] => Err(AbortCode(u32::from_le_bytes([a, b, c, d]))),
        }
    }

    /// Reads up to four bytes by SDO as an integer.
    fn read(&mut self, index: u16, sub_index: u8) -> Result<u32, AbortCode> {
        let [low, high] = index.to_le_bytes();
        let [command, _, _, _, a, b, c, d] =
            self.request(&[0x40, low, high, sub_index, 0, 0, 0, 0]);
        let value = u32::from_le_bytes([a, b, c, d]);
        match command {
            0x80 => Err(AbortCode(value)),
            _ => Ok(value),
        }
    }
}

fn milliseconds(count: u64) -> Duration {
    Duration::from_millis(count)
}
