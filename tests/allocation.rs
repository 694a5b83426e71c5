//! Tests that count allocations. The real nodes make none in their cycle (SYNC, PDOs, heartbeats, the law and the
//! physics), and the work until an oversized file is refused grows linearly.

use std::collections::VecDeque;
use std::fs;
use std::time::Duration;

use can::{CanFrame, Node};
use controller::{ControllerNode, controller_node};
use plan::Plan;
use plant_emulator::{PlantEmulator, catalogue};
use scenario::without_colours;

use crate::counting_allocator::allocations;
use crate::support::scenario;

const SYNC: u16 = 0x080;
const COMMAND: u16 = 0x210;
const FEEDBACK: u16 = 0x190;

/// A node with the number of its allocations.
struct Counted<N> {
    node: N,
    allocations: u64,
}

impl<N: Node> Counted<N> {
    fn new(node: N) -> Self {
        Self {
            node,
            allocations: 0,
        }
    }

    /// Calls the node and takes its frames.
    fn call(&mut self, bus: &mut VecDeque<CanFrame>, call: impl FnOnce(&mut N)) {
        let before = allocations();
        call(&mut self.node);
        while let Some(frame) = self.node.next_frame() {
            bus.push_back(frame);
        }
        self.allocations += allocations() - before;
    }
}

/// Controller and rig on a bus without delay.
struct World {
    controller: Counted<ControllerNode>,
    rig: Counted<PlantEmulator>,
    now: Duration,
    to_controller: VecDeque<CanFrame>,
    to_rig: VecDeque<CanFrame>,
    frames: [u64; 3],
    last_command: Option<CanFrame>,
}

impl World {
    fn new() -> Self {
        let text = fs::read_to_string(scenario("step.toml")).unwrap();
        let scenario = testing::part(&text, "drive");
        let view = scenario.controller_view();
        Self {
            controller: Counted::new(controller_node(&view).unwrap()),
            rig: Counted::new(catalogue::emulator(&scenario).unwrap()),
            now: Duration::ZERO,
            // The bus itself must not allocate.
            to_controller: VecDeque::with_capacity(4096),
            to_rig: VecDeque::with_capacity(4096),
            frames: [0; 3],
            last_command: None,
        }
    }

    fn run_until(&mut self, end: Duration) {
        while self.now < end {
            let due = |deadline: Option<Duration>| deadline.unwrap_or(end).max(self.now);
            let (controller, rig) = (&self.controller.node, &self.rig.node);
            let next = due(controller.next_deadline()).min(due(rig.next_deadline()));
            self.now = next.min(end);
            self.tick();
            self.deliver();
        }
    }

    fn tick(&mut self) {
        let now = self.now;
        let is_due = |deadline: Option<Duration>| deadline.is_some_and(|deadline| deadline <= now);
        if is_due(self.controller.node.next_deadline()) {
            self.controller
                .call(&mut self.to_rig, |node| node.on_tick(now));
        }
        if is_due(self.rig.node.next_deadline()) {
            self.rig
                .call(&mut self.to_controller, |node| node.on_tick(now));
        }
    }

    fn deliver(&mut self) {
        let now = self.now;
        while !(self.to_controller.is_empty() && self.to_rig.is_empty()) {
            if let Some(frame) = self.to_rig.pop_front() {
                self.note(frame);
                self.rig
                    .call(&mut self.to_controller, |node| node.on_frame(now, &frame));
            }
            if let Some(frame) = self.to_controller.pop_front() {
                self.note(frame);
                self.controller
                    .call(&mut self.to_rig, |node| node.on_frame(now, &frame));
            }
        }
    }

    fn note(&mut self, frame: CanFrame) {
        for (count, id) in self.frames.iter_mut().zip([SYNC, COMMAND, FEEDBACK]) {
            *count += u64::from(frame.standard_id() == Some(id));
        }
        if frame.standard_id() == Some(COMMAND) {
            self.last_command = Some(frame);
        }
    }
}

#[test]
fn the_cycle_of_controller_and_rig_allocates_nothing() {
    let before = allocations();
    let mut world = World::new();
    assert!(allocations() > before, "the count counts");
    world.run_until(Duration::from_secs(1));
    let is_led = |world: &World| {
        let command = world.last_command.unwrap();
        command.data()[0] == 0x0F && command.data()[2..] != [0, 0]
    };
    assert!(
        is_led(&world),
        "the wire is heated: {:?}",
        world.last_command
    );
    let started = [world.controller.allocations, world.rig.allocations];
    let frames = world.frames;
    world.run_until(Duration::from_secs(12));
    for (now, then) in world.frames.iter().zip(frames) {
        assert!(now - then >= 10_990, "11 000 cycles: {:?}", world.frames);
    }
    assert!(is_led(&world));
    let ended = [world.controller.allocations, world.rig.allocations];
    assert_eq!(ended, started, "allocations of controller and rig");
}

/// Returns the allocations until a rig file with this number of entries in each of its tables is refused.
fn allocations_to_refuse(entries: usize) -> u64 {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenario.toml");
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"s\"\nduration_seconds = 1.0\n";
    fs::write(&path, text).unwrap();
    let mut rig = "schema = 1\nname = \"r\"\n".to_owned();
    for table in ["node", "plant", "loop"] {
        rig += &format!("[{table}]\n");
        rig.extend((0..entries).map(|number| format!("n{number}={{}}\n")));
    }
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let catalogue = worlds::catalogue::catalogue();
    let before = allocations();
    let refused = Plan::load(&path, catalogue);
    let count = allocations() - before;
    let error = without_colours(&refused.unwrap_err());
    assert!(error.contains("entries in [plant]"), "{error}");
    count
}

#[test]
fn a_rig_with_too_many_nodes_is_refused_after_work_that_grows_as_their_number() {
    let [one, two, four] = [5_000, 10_000, 20_000].map(allocations_to_refuse);
    assert!(one < two && two < four, "the count counts");
    let (first, second) = (two - one, four - two);
    assert!(second <= 2 * first + first / 10, "{one} {two} {four}");
}
