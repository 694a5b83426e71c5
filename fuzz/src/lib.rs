//! From a fuzzer's bytes to frames in time.

use std::sync::LazyLock;
use std::time::Duration;

use can::{frame::{ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG}};
use can::{CanFrame, Node};
use scenario::Trial;

/// A scenario for the nodes of the rig.
pub static SCENARIO: LazyLock<Trial> = LazyLock::new(|| {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"fuzz\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
                [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
    let no_table = |_: &str| Err(std::io::ErrorKind::NotFound.into());
    Trial::parse(text, "fuzz.toml", no_table).expect("the scenario is valid")
});

/// Bytes of one step: pause (16 bits, 2 microseconds each), identifier (11 bits and three flags), length, data.
pub const STEP_BYTES: usize = 13;
/// Steps of one input at most.
const STEPS_MAX: usize = 400;
/// Ticks in a pause at most; a node may be configured to wake each microsecond.
const TICKS_MAX: u32 = 2_000;
/// Ticks at one deadline at most.
const TICKS_PER_DEADLINE_MAX: u32 = 8;

/// A frame and the pause before it.
pub struct Step {
    /// Time since the step before.
    pub pause: Duration,
    /// The frame.
    pub frame: CanFrame,
}

/// The steps that bytes spell.
pub fn steps(bytes: &[u8]) -> impl Iterator<Item = Step> {
    bytes.chunks_exact(STEP_BYTES).take(STEPS_MAX).map(|chunk| {
        let word = |place: usize| u16::from_le_bytes([chunk[place], chunk[place + 1]]);
        let id = word(2);
        let flags = [
            (0x0800, REMOTE_FLAG),
            (0x1000, EXTENDED_FLAG),
            (0x2000, ERROR_FLAG),
        ].iter().filter(|(bit, _)| id & bit != 0);
        let raw_id = flags.fold(u32::from(id & 0x7FF), |raw_id, (_, flag)| raw_id | flag);
        let data = chunk[5..].try_into().expect("8 bytes are left");
        Step {
            pause: Duration::from_micros(2 * u64::from(word(0))),
            frame: CanFrame::from_raw(raw_id, chunk[4] % 9, data).expect("at most 8 bytes"),
        }
    })
}

/// A node on its way through time.
pub struct Journey<N> {
    /// The node.
    pub node: N,
    /// The time.
    pub now: Duration,
}

impl<N: Node> Journey<N> {
    /// A node at its start.
    pub fn new(node: N) -> Self {
        let mut journey = Self {
            node,
            now: Duration::ZERO,
        };
        journey.pass(Duration::ZERO);
        journey
    }

    /// Lets time pass; returns the frames that the node sent.
    ///
    /// # Panics
    /// When the node's deadline does not move.
    pub fn pass(&mut self, pause: Duration) -> Vec<CanFrame> {
        let end = self.now + pause;
        let mut sent = Vec::new();
        let (mut last, mut repeated) = (None, 0);
        for _ in 0..TICKS_MAX {
            let deadline = self.node.next_deadline();
            let Some(due) = deadline.filter(|deadline| *deadline <= end) else {
                break;
            };
            repeated = if deadline == last { repeated + 1 } else { 0 };
            assert!(
                repeated < TICKS_PER_DEADLINE_MAX,
                "the deadline {due:?} does not move"
            );
            last = deadline;
            self.now = self.now.max(due);
            self.node.on_tick(self.now);
            sent.extend(self.drain());
        }
        self.now = end;
        sent
    }

    /// Delivers a frame; returns the frames that the node answered.
    pub fn deliver(&mut self, frame: &CanFrame) -> Vec<CanFrame> {
        self.node.on_frame(self.now, frame);
        self.drain()
    }

    /// Plays the steps that bytes spell.
    pub fn travel(&mut self, bytes: &[u8]) {
        for step in steps(bytes) {
            self.pass(step.pause);
            self.deliver(&step.frame);
        }
    }

    fn drain(&mut self) -> Vec<CanFrame> {
        let mut sent = Vec::new();
        while let Some(frame) = self.node.next_frame() {
            sent.push(frame);
            assert!(sent.len() < 10_000, "the node never stops talking");
        }
        sent
    }
}

/// The node must obey an NMT reset and answer an SDO read with the device type.
pub fn expect_alive<N: Node>(journey: &mut Journey<N>, node_id: u8, device_type: u32) {
    let sent = journey.deliver(&CanFrame::new(0, &[129, node_id]));
    let boot_up = CanFrame::new(0x700 + u16::from(node_id), &[0]);
    assert!(
        sent.contains(&boot_up),
        "no boot-up after NMT reset: {sent:?}"
    );
    let request = CanFrame::new(0x600 + u16::from(node_id), &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    let [a, b, c, d] = device_type.to_le_bytes();
    let answer = CanFrame::new(0x580 + u16::from(node_id), &[0x43, 0, 0x10, 0, a, b, c, d]);
    let sent = journey.deliver(&request);
    assert!(sent.contains(&answer), "no answer to an SDO read: {sent:?}");
}
