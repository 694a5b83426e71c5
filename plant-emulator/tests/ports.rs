//! A plant with ports behind its drives.

use std::sync::Arc;
use std::time::Duration;

use can::{CanFrame, Node as _, Progress};
use dbc::{Database, Quantity, Unit};
use plant_emulator::plant::{InvalidPlant, Plant, Port, Ports};
use plant_emulator::{InvalidEmulator, PlantEmulator};
use scenario::Trial;
use scenario::node::{Node, Nodes, Profile};
use scenario::wiring::{Measured, SharedWiring, Wiring};

/// An arm whose angle integrates the sum of two currents; after a time it becomes another value.
#[derive(Debug)]
struct Arm {
    angle: f64,
    seconds: f64,
    breaks_at_seconds: f64,
    broken: f64,
}

impl Arm {
    fn sound() -> Self {
        Self::breaking(f64::INFINITY, 0.0)
    }

    /// Makes an arm whose angle is `broken` after a time.
    fn breaking(breaks_at_seconds: f64, broken: f64) -> Self {
        Self {
            angle: 0.0,
            seconds: 0.0,
            breaks_at_seconds,
            broken,
        }
    }
}

impl Plant for Arm {
    type Config = ();

    fn name() -> &'static str {
        "arm"
    }

    fn new((): &()) -> Result<Self, InvalidPlant> {
        Ok(Self::sound())
    }

    fn ports(&self) -> Ports {
        let inputs = ["left_current_amperes", "right_current_amperes"];
        Ports {
            inputs: inputs.map(|name| Port::input(name, [-1.0, 1.0])).into(),
            outputs: vec![Port::output("angle_degrees", [-90.0, 90.0])],
        }
    }

    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        self.angle += (inputs[0] - inputs[1]) * duration_seconds;
        self.seconds += duration_seconds;
    }

    fn read(&self, outputs: &mut [f64]) {
        let is_broken = self.seconds > self.breaks_at_seconds;
        outputs[0] = if is_broken { self.broken } else { self.angle };
    }
}

fn scenario(input: &str) -> Trial {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
    let mut scenario = testing::part(text, "drive");
    scenario.sensor.max = Some(180.0);
    scenario.sensor.resolution_bits = Some(20);
    let id = if input == "left" { 0x10 } else { 0x12 };
    let controller = Node::canopen("controller", 0x01, Profile::Manager);
    let nodes = Nodes::new([controller, Node::canopen("drive", id, Profile::Drive)])
        .expect("it has a controller");
    let drive = nodes.find("drive").expect("it is one of them");
    scenario.wiring = Wiring {
        drive,
        followed: drive,
        shared: Arc::new(SharedWiring {
            nodes,
            ..SharedWiring::default()
        }),
        input: format!("arm.{input}_current_amperes"),
        output: "arm.angle_degrees".to_owned(),
        sensor: Measured {
            quantity: Quantity::position(Unit::Degrees),
            min: -90.0,
            max: Some(90.0),
            ..Measured::default()
        },
        ..Wiring::default()
    };
    scenario
}

fn emulator(arm: Arm, scenarios: &[Trial; 2]) -> Result<PlantEmulator, InvalidEmulator> {
    let [left, right] = scenarios;
    let plants: Vec<(String, Box<dyn Plant>)> = vec![("arm".to_owned(), Box::new(arm))];
    PlantEmulator::of(plants, &[right, left], Database::shipped())
}

/// An emulator whose drives are enabled and have these currents, and the last position of each.
struct Bench {
    emulator: PlantEmulator,
    now: Duration,
    counter: u8,
}

impl Bench {
    fn enabled(arm: Arm) -> Self {
        let emulator = emulator(arm, &["left", "right"].map(scenario)).expect("it is valid");
        let mut bench = Self {
            emulator,
            now: Duration::ZERO,
            counter: 0,
        };
        bench.emulator.on_tick(Duration::ZERO);
        for id in [0x610, 0x612] {
            bench.deliver(&CanFrame::new(id, &[0x2F, 0x60, 0x60, 0, 10, 0, 0, 0]));
        }
        bench.deliver(&CanFrame::new(0x000, &[1, 0]));
        for controlword in [6, 7, 15] {
            bench.cycle(controlword, [0, 0]);
        }
        bench
    }

    fn deliver(&mut self, frame: &CanFrame) -> Vec<CanFrame> {
        self.emulator.on_frame(self.now, frame);
        std::iter::from_fn(|| self.emulator.next_frame()).collect()
    }

    /// Sends commands in permille, then a SYNC, and returns the positions in thousandths of a degree.
    fn cycle(&mut self, controlword: u8, permille: [i16; 2]) -> Vec<i32> {
        for (id, permille) in [0x210, 0x212].into_iter().zip(permille) {
            let [low, high] = permille.to_le_bytes();
            self.deliver(&CanFrame::new(id, &[controlword, 0, low, high]));
        }
        self.now += Duration::from_millis(1);
        self.counter = self.counter % 240 + 1;
        let frames = self.deliver(&CanFrame::new(0x080, &[self.counter]));
        let position = |id| {
            let frame = frames
                .iter()
                .find(|frame| frame.standard_id() == Some(id))?;
            let bytes = <[u8; 4]>::try_from(&frame.data()[2..6]).ok()?;
            Some(i32::from_le_bytes(bytes))
        };
        [0x190, 0x192].into_iter().filter_map(position).collect()
    }
}

#[test]
fn two_drives_move_one_plant_and_measure_the_same() {
    let mut bench = Bench::enabled(Arm::sound());
    let mut positions = Vec::new();
    for _ in 0..2001 {
        positions = bench.cycle(15, [800, 300]);
    }
    assert_eq!(bench.emulator.inputs(), [0.8, 0.3]);
    let [left, right] = positions[..] else {
        panic!("{positions:?}");
    };
    // Half an ampere for two seconds gives one degree, to a count of the sensor.
    assert!((left - 1000).abs() <= 1, "{left}");
    assert_eq!(left, right);
    assert_eq!(bench.emulator.progress(), Progress::Running);
}

#[test]
fn a_plant_that_is_no_number_ends_the_run_by_name_and_has_no_current() {
    for (broken, said) in [
        (f64::NAN, "NaN"),
        (f64::INFINITY, "inf"),
        (f64::NEG_INFINITY, "-inf"),
    ] {
        let mut bench = Bench::enabled(Arm::breaking(0.5, broken));
        for _ in 0..400 {
            bench.cycle(15, [800, 300]);
        }
        assert_eq!(bench.emulator.progress(), Progress::Running);
        for _ in 0..200 {
            bench.cycle(15, [800, 300]);
        }
        assert_eq!(bench.emulator.inputs(), [0.0, 0.0]);
        let Progress::Failed(text) = bench.emulator.progress() else {
            panic!("it goes on");
        };
        let start =
            format!("the plant `arm` cannot go on: its port `angle_degrees` is {said} after");
        assert!(text.starts_with(&start), "{text}");
    }
}

#[test]
fn a_drive_that_is_wired_to_nothing_is_refused() {
    let error = emulator(Arm::sound(), &["left", "middle"].map(scenario)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the plant has no port `arm.middle_current_amperes`"
    );
}
