//! Subjects of the benchmarks: a drive in Operation enabled, ready for one event, and control laws ready for one cycle.

use std::time::Duration;

use can::{CanFrame, Node};
use controller::catalogue;
use controller::law::{AnyLaw, Cycle, LoopReads};
use controller::process_law::Window;
use gungraun::{Callgrind, EventKind, LibraryBenchmarkConfig};
use plant_emulator::PlantEmulator;
use plant_emulator::plant::CURRENT;
use scenario::Trial;
use scenario::controller::Controller;
use scenario::reference::SetPoint;

const SCENARIO: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"bench\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
                        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
const PERIOD: Duration = Duration::from_millis(1);

/// Returns a configuration that fails above this many instructions: about a third more than were counted when the limit was set,
/// unless the benchmark says otherwise.
pub fn limit(instructions: u64) -> LibraryBenchmarkConfig {
    let mut callgrind = Callgrind::default();
    callgrind.hard_limits([(EventKind::Ir, instructions)]);
    let mut config = LibraryBenchmarkConfig::default();
    config.tool(callgrind);
    config
}

/// Law with its inputs in one cycle.
pub struct HeldLaw {
    law: AnyLaw,
    cycle: Cycle,
    reads: LoopReads,
    /// Values that it has written.
    pub writes: Vec<f64>,
}

impl HeldLaw {
    /// Runs the law for one cycle.
    pub fn step(&mut self) {
        let Self {
            law,
            cycle,
            reads,
            writes,
        } = self;
        law.step(cycle, &Window::default(), &reads.values(), writes);
    }
}

/// Makes a law that has held 25 mm for a second, and the cycle in which 26 mm are wanted.
///
/// # Panics
/// If the table holds no law, or the law takes the load to rest on its stop.
pub fn law_in_a_hold(controller: &Controller) -> Box<HeldLaw> {
    let law = catalogue::law(controller, &scenario::wiring::Wiring::default())
        .expect("the table holds one law");
    let outputs = &law.ports().outputs;
    let on_stop = outputs
        .iter()
        .position(|port| port.name == "saturation_on_stop");
    let hold = |position| LoopReads {
        position: 0.025,
        set_point: SetPoint {
            position,
            ..SetPoint::default()
        },
    };
    let mut held = HeldLaw {
        writes: vec![0.0; outputs.len()],
        law,
        cycle: Cycle {
            scenario_time_seconds: 0.0,
            period_seconds: PERIOD.as_secs_f64(),
        },
        reads: hold(0.025),
    };
    for number in 0..1000 {
        held.cycle.scenario_time_seconds = f64::from(number) * PERIOD.as_secs_f64();
        held.step();
        let on_stop = on_stop.is_some_and(|place| held.writes[place] > 0.0);
        assert!(number < 10 || !on_stop, "the load has lifted");
    }
    held.cycle.scenario_time_seconds = 1.0;
    held.reads = hold(0.026);
    Box::new(held)
}

/// Rig with its drive, and the time of its latest event.
pub struct Bench {
    emulator: PlantEmulator,
    now: Duration,
    counter: u8,
}

impl Bench {
    /// Makes a drive that has been heating its wire for 100 cycles.
    ///
    /// # Panics
    /// If the drive cannot be brought there.
    pub fn heated() -> Self {
        let no_table = |_: &str| Err(std::io::ErrorKind::NotFound.into());
        let scenario = Trial::parse(SCENARIO, "bench.toml", no_table).expect("it is valid");
        let emulator = plant_emulator::catalogue::emulator(&scenario).expect("the plant is valid");
        let mut bench = Self {
            emulator,
            now: Duration::ZERO,
            counter: 0,
        };
        bench.emulator.on_tick(Duration::ZERO);
        bench.deliver(&CanFrame::new(0x610, &[0x2F, 0x60, 0x60, 0, 10, 0, 0, 0]));
        bench.deliver(&CanFrame::new(0x000, &[1, 0]));
        for controlword in [6, 7, 15].into_iter().chain([15; 100]) {
            bench.deliver(&CanFrame::new(0x210, &[controlword, 0, 0xF4, 0x01]));
            bench.wait();
            bench.sync();
        }
        assert!(
            bench.emulator.inputs()[CURRENT] > 0.4,
            "the drive is enabled"
        );
        bench
    }

    /// Waits for a period, with the ticks that are due in it.
    pub fn wait(&mut self) {
        let end = self.now + PERIOD;
        while let Some(deadline) = self.emulator.next_deadline().filter(|due| *due <= end) {
            self.emulator.on_tick(deadline);
            while self.emulator.next_frame().is_some() {}
        }
        self.now = end;
    }

    /// Sends a SYNC; returns the drive's first TPDO.
    pub fn sync(&mut self) -> Option<CanFrame> {
        self.counter = self.counter % 240 + 1;
        let sync = CanFrame::new(0x080, &[self.counter]);
        self.deliver(&sync)
    }

    /// Delivers a frame; returns the first answer.
    pub fn deliver(&mut self, frame: &CanFrame) -> Option<CanFrame> {
        self.emulator.on_frame(self.now, frame);
        let first = self.emulator.next_frame();
        while self.emulator.next_frame().is_some() {}
        first
    }
}
