//! What is counted: a drive in Operation enabled, ready for one event, and control laws ready for one cycle.

use std::time::Duration;

use canopen::{CanFrame, Node};
use controller::catalogue;
use controller::law::{Command, Law, Measurement};
use gungraun::{Callgrind, EventKind, LibraryBenchmarkConfig};
use plant_emulator::PlantEmulator;
use plant_emulator::ports::CURRENT;
use plant_emulator::sma::Actuator;
use scenario::Scenario;
use scenario::controller::Controller;
use scenario::reference::SetPoint;

const SCENARIO: &str = "schema = 1\nname = \"bench\"\nduration_seconds = 1.0\n\n[controller.sliding_mode]\n\n\
                        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
const PERIOD: Duration = Duration::from_millis(1);

/// Fails above so many instructions: about a third more than were counted when the limit was set, unless the benchmark says otherwise.
#[must_use]
pub fn limit(instructions: u64) -> LibraryBenchmarkConfig {
    let mut callgrind = Callgrind::default();
    callgrind.hard_limits([(EventKind::Ir, instructions)]);
    let mut config = LibraryBenchmarkConfig::default();
    config.tool(callgrind);
    config
}

/// What a law receives in one cycle.
#[derive(Clone, Copy)]
pub struct Cycle {
    measurement: Measurement,
    set_point: SetPoint,
}

impl Cycle {
    fn new(number: u32, measured_metres: f64, wanted_metres: f64) -> Self {
        Self {
            measurement: Measurement {
                scenario_time_seconds: f64::from(number) * PERIOD.as_secs_f64(),
                position_metres: measured_metres,
            },
            set_point: SetPoint {
                position_metres: wanted_metres,
                ..SetPoint::default()
            },
        }
    }

    /// The law's answer.
    pub fn step(&self, law: &mut Law) -> Command {
        law.step(&self.measurement, &self.set_point, PERIOD.as_secs_f64())
    }
}

/// A law that has held 25 mm for a second, and the cycle in which 26 mm are wanted.
///
/// # Panics
/// When the table holds no law, or the law takes the load to rest on its stop.
#[must_use]
pub fn law_in_a_hold(controller: &Controller) -> (Law, Cycle) {
    let mut law = catalogue::law(controller).expect("the table holds one law");
    for number in 0..1000 {
        let command = Cycle::new(number, 0.025, 0.025).step(&mut law);
        let on_stop = command.explanation.saturation.on_stop;
        assert!(number < 10 || !on_stop, "the load has lifted");
    }
    (law, Cycle::new(1000, 0.025, 0.026))
}

/// The rig with its drive, and the time of its latest event.
pub struct Bench {
    emulator: PlantEmulator,
    now: Duration,
    counter: u8,
}

impl Bench {
    /// A drive that has been heating its wire for 100 cycles.
    ///
    /// # Panics
    /// When the drive cannot be led there.
    pub fn heated() -> Self {
        let no_table = |_: &str| Err(std::io::ErrorKind::NotFound.into());
        let scenario = Scenario::parse(SCENARIO, "bench.toml", no_table).expect("it is valid");
        let emulator =
            PlantEmulator::new::<Actuator>(&scenario, &scenario.plant).expect("the plant is valid");
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

    /// Lets a period pass, with the ticks that are due in it.
    pub fn wait(&mut self) {
        let end = self.now + PERIOD;
        while let Some(deadline) = self.emulator.next_deadline().filter(|due| *due <= end) {
            self.emulator.on_tick(deadline);
            while self.emulator.next_frame().is_some() {}
        }
        self.now = end;
    }

    /// A SYNC; the drive's first TPDO.
    pub fn sync(&mut self) -> Option<CanFrame> {
        self.counter = self.counter % 240 + 1;
        let sync = CanFrame::new(0x080, &[self.counter]);
        self.deliver(&sync)
    }

    /// Delivers a frame; the first answer.
    pub fn deliver(&mut self, frame: &CanFrame) -> Option<CanFrame> {
        self.emulator.on_frame(self.now, frame);
        let first = self.emulator.next_frame();
        while self.emulator.next_frame().is_some() {}
        first
    }
}
