//! A small manager with its own clock, which plays the bus and the controller for the emulator.

use std::time::Duration;

use can::{CanFrame, Node, Progress};
use canopen::AbortCode;
use canopen::cia402::State;
use plant_emulator::plant::Inputs;
use plant_emulator::plants::sma::Actuator;
use plant_emulator::{PlantEmulator, catalogue};
use scenario::Trial;

pub(crate) const DRIVE: u16 = 0x10;
pub(crate) const DISTURBANCE: u16 = 0x11;

const PERIOD: Duration = Duration::from_millis(1);

/// Returns a time in milliseconds.
pub(crate) fn milliseconds(number: u64) -> Duration {
    Duration::from_millis(number)
}

/// Returns a scenario on the actuator of the paper.
pub(crate) fn scenario() -> Trial {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"nodes\"\nseed = 42\nduration_seconds = 1.0\n[controller.open_loop]\n";
    testing::part(text, "drive")
}

/// The content of TPDO1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) statusword: u16,
    pub(crate) state: State,
    pub(crate) position_micrometres: i32,
    pub(crate) current_permille: i16,
}

pub(crate) struct Manager {
    emulator: PlantEmulator,
    now: Duration,
    frames: Vec<CanFrame>,
    counter: u8,
    /// Time of the manager's next heartbeat; `None` while it is silent.
    next_heartbeat: Option<Duration>,
}

impl Manager {
    pub(crate) fn new() -> Self {
        Self::with(&scenario())
    }

    pub(crate) fn with(scenario: &Trial) -> Self {
        Self {
            emulator: catalogue::emulator(scenario).expect("the default plant is valid"),
            now: Duration::ZERO,
            frames: Vec::new(),
            counter: 0,
            next_heartbeat: None,
        }
    }

    /// Makes a manager whose drive is in Operation enabled.
    pub(crate) fn enabled() -> Self {
        let mut manager = Self::new();
        manager.configure();
        manager.enable();
        manager
    }

    /// Configures by SDO as the controller does, then sends NMT start.
    pub(crate) fn configure(&mut self) {
        self.run_for(milliseconds(2));
        self.restore_heartbeat();
        self.write(DRIVE, 0x1016, 1, &0x0001_0064_u32.to_le_bytes());
        self.write(DRIVE, 0x1006, 0, &1000_u32.to_le_bytes());
        self.write(DRIVE, 0x6060, 0, &[10]);
        self.send(0, &[1, 0]);
    }

    /// Executes the 402 sequence.
    pub(crate) fn enable(&mut self) {
        for controlword in [0x06, 0x07, 0x0F] {
            self.cycle(controlword, 0);
        }
        assert_eq!(self.cycle(0x0F, 0).state, State::OperationEnabled);
    }

    pub(crate) fn now(&self) -> Duration {
        self.now
    }

    /// Returns all frames that the emulator has sent.
    pub(crate) fn frames(&self) -> &[CanFrame] {
        &self.frames
    }

    /// Returns the payload of the latest frame with an identifier.
    pub(crate) fn last(&self, id: u16) -> Option<&[u8]> {
        let mut frames = self.frames.iter().rev();
        frames
            .find(|frame| frame.standard_id() == Some(id))
            .map(CanFrame::data)
    }

    /// Advances the actuator, and returns it.
    pub(crate) fn actuator_now(&mut self) -> &Actuator {
        self.emulator.on_tick(self.now);
        self.drain();
        self.actuator()
    }

    pub(crate) fn actuator(&self) -> &Actuator {
        self.emulator.plant().expect("the plant is the actuator")
    }

    pub(crate) fn inputs(&self) -> Inputs {
        Inputs::of(self.emulator.inputs())
    }

    pub(crate) fn current_amperes(&self) -> f64 {
        self.inputs().current_amperes
    }

    pub(crate) fn progress(&self) -> Progress {
        self.emulator.progress()
    }

    pub(crate) fn stop(&mut self) {
        self.emulator.on_stop(self.now);
        self.drain();
    }

    /// Sends the manager's heartbeat every 20 ms from now on.
    pub(crate) fn restore_heartbeat(&mut self) {
        self.next_heartbeat = Some(self.now);
    }

    /// Confirms [`Manager::restore_heartbeat`] in tests where only SYNCs are lost.
    pub(crate) fn keep_heartbeat_alive(&mut self) {
        assert!(self.next_heartbeat.is_some());
    }

    pub(crate) fn lose_heartbeat(&mut self) {
        self.next_heartbeat = None;
    }

    pub(crate) fn send_frame(&mut self, frame: &CanFrame) {
        let filters = self.emulator.filters();
        if filters.iter().any(|filter| filter.accepts(frame)) {
            self.emulator.on_frame(self.now, frame);
        }
        self.drain();
    }

    pub(crate) fn send(&mut self, id: u16, data: &[u8]) {
        self.send_frame(&CanFrame::new(id, data));
    }

    pub(crate) fn send_rpdo(&mut self, controlword: u16, target_permille: i16) {
        let [a, b] = controlword.to_le_bytes();
        let [c, d] = target_permille.to_le_bytes();
        self.send(0x210, &[a, b, c, d]);
    }

    /// Sends one SYNC, a period after the latest.
    pub(crate) fn sync(&mut self) {
        self.run_for(PERIOD);
        self.counter = self.counter % 240 + 1;
        self.send(0x080, &[self.counter]);
    }

    /// Sends RPDO1, then SYNC, and returns the content of TPDO1.
    pub(crate) fn cycle(&mut self, controlword: u16, target_permille: i16) -> Sample {
        self.send_rpdo(controlword, target_permille);
        self.frames
            .retain(|frame| frame.standard_id() != Some(0x190));
        self.sync();
        let Some(&[a, b, c, d, e, f, g, h]) = self.last(0x190) else {
            // The drive is no longer Operational, so this is the value for an SDO client.
            let statusword = u16::try_from(self.read(DRIVE, 0x6041, 0)).expect("16 bits");
            return Self::sample(statusword, 0, 0);
        };
        Self::sample(
            u16::from_le_bytes([a, b]),
            i32::from_le_bytes([c, d, e, f]),
            i16::from_le_bytes([g, h]),
        )
    }

    fn sample(statusword: u16, position_micrometres: i32, current_permille: i16) -> Sample {
        Sample {
            statusword,
            state: State::from_statusword(statusword).expect("a state of CiA 402"),
            position_micrometres,
            current_permille,
        }
    }

    /// Advances the time.
    pub(crate) fn run_for(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.next_event() <= end {
            self.tick();
        }
        self.now = end;
    }

    fn next_event(&self) -> Duration {
        let deadline = self.emulator.next_deadline().unwrap_or(Duration::MAX);
        deadline.min(self.next_heartbeat.unwrap_or(Duration::MAX))
    }

    /// Executes the next spontaneous event: a heartbeat of the manager or a deadline of the emulator.
    pub(crate) fn tick(&mut self) {
        self.now = self.now.max(self.next_event());
        if self.next_heartbeat.is_some_and(|due| due <= self.now) {
            self.next_heartbeat = Some(self.now + milliseconds(20));
            self.send(0x701, &[5]);
            return;
        }
        self.emulator.on_tick(self.now);
        self.drain();
    }

    fn drain(&mut self) {
        while let Some(frame) = self.emulator.next_frame() {
            self.frames.push(frame);
        }
    }

    /// Executes an expedited SDO upload.
    pub(crate) fn read(&mut self, node: u16, index: u16, sub_index: u8) -> u32 {
        let [low, high] = index.to_le_bytes();
        self.send(0x600 + node, &[0x40, low, high, sub_index, 0, 0, 0, 0]);
        match self.last(0x580 + node) {
            Some(&[command, l, h, s, ref data @ ..]) if command & 0xE0 == 0x40 => {
                assert_eq!((l, h, s), (low, high, sub_index));
                u32::from_le_bytes(<[u8; 4]>::try_from(data).expect("4 bytes"))
            }
            answer => panic!("read {index:#06x}:{sub_index}: {answer:02X?}"),
        }
    }

    /// Executes an expedited SDO download that must be accepted.
    pub(crate) fn write(&mut self, node: u16, index: u16, sub_index: u8, bytes: &[u8]) {
        let written = self.try_write(node, index, sub_index, bytes);
        assert_eq!(written, Ok(()), "write {index:#06x}:{sub_index}");
    }

    /// Executes an expedited SDO download; the abort code is the error.
    pub(crate) fn try_write(
        &mut self,
        node: u16,
        index: u16,
        sub_index: u8,
        bytes: &[u8],
    ) -> Result<(), AbortCode> {
        let [low, high] = index.to_le_bytes();
        let unused = u8::try_from(4 - bytes.len()).expect("at most 4 bytes");
        let mut data = [0x23 | unused << 2, low, high, sub_index, 0, 0, 0, 0];
        data[4..4 + bytes.len()].copy_from_slice(bytes);
        self.send(0x600 + node, &data);
        match self.last(0x580 + node) {
            Some([0x60, ..]) => Ok(()),
            Some(&[0x80, _, _, _, a, b, c, d]) => Err(AbortCode(u32::from_le_bytes([a, b, c, d]))),
            answer => panic!("write {index:#06x}:{sub_index}: {answer:02X?}"),
        }
    }

    /// Gives RPDO or TPDO 1 these parameters and objects by the standard's procedure; the PDO's COB-ID stays.
    pub(crate) fn remap(&mut self, index: u16, transmission_type: u8, mapped: &[u32]) {
        let cob_id = self.read(DRIVE, index, 1);
        self.write(DRIVE, index, 1, &(cob_id | 1 << 31).to_le_bytes());
        self.write(DRIVE, index, 2, &[transmission_type]);
        self.write(DRIVE, index + 0x200, 0, &[0]);
        for (sub_index, entry) in (1..).zip(mapped) {
            self.write(DRIVE, index + 0x200, sub_index, &entry.to_le_bytes());
        }
        let count = u8::try_from(mapped.len()).expect("at most 8");
        self.write(DRIVE, index + 0x200, 0, &[count]);
        self.write(DRIVE, index, 1, &cob_id.to_le_bytes());
    }
}
