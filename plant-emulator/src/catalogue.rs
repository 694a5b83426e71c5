//! The plants that scenarios can choose, by name.

use std::sync::LazyLock;

use canopen::Node;
use dbc::{Database, PlantSignal, Range};
use scenario::Scenario;

use crate::dc_motor::DcMotor;
use crate::plant::{Plant, Signal};
use crate::sma::Actuator;
use crate::{InvalidEmulator, PlantEmulator};

/// What only an emulated plant tells; a real drive knows none of it, and may use the identifiers for something else.
pub const TRUTH_MESSAGES: [&str; 3] = ["drive_tpdo2", "drive_tpdo3", "plant_truth"];

/// A plant by its name: the emulator round it, and the frames that it puts on the bus.
struct Kind {
    name: &'static str,
    emulator: fn(&Scenario) -> Result<Box<dyn Node>, InvalidEmulator>,
    database: LazyLock<Database>,
    without_truth: LazyLock<Database>,
}

impl Kind {
    const fn of<P: Plant>(name: &'static str) -> Self {
        Self {
            name,
            without_truth: LazyLock::new(|| database_of::<P>().with_silent(&TRUTH_MESSAGES)),
            emulator: |scenario| Ok(Box::new(PlantEmulator::<P>::new(scenario)?)),
            database: LazyLock::new(database_of::<P>),
        }
    }
}

/// Name of the actuator of the paper.
pub const SMA_ACTUATOR: &str = "sma_actuator";

static KINDS: [Kind; 2] = [
    Kind::of::<Actuator>(SMA_ACTUATOR),
    Kind::of::<DcMotor>("dc_motor"),
];

fn kind(scenario: &Scenario) -> Result<&'static Kind, InvalidEmulator> {
    let name = scenario.plant.name();
    let found = KINDS.iter().find(|kind| kind.name == name);
    found.ok_or(InvalidEmulator::UnknownPlant(name))
}

/// The emulator of the plant that a scenario chooses.
///
/// # Errors
/// The plant makes no sense.
pub fn emulator(scenario: &Scenario) -> Result<Box<dyn Node>, InvalidEmulator> {
    (kind(scenario)?.emulator)(scenario)
}

/// The frames of the rig with the plant that a scenario chooses.
#[must_use]
pub fn database(scenario: &Scenario) -> &'static Database {
    kind(scenario).map_or_else(|_| Database::sma_actuator(), |kind| &*kind.database)
}

/// As [`database`] beside a drive that is not the emulator: nobody tells the truth.
#[must_use]
pub fn database_without_truth(scenario: &Scenario) -> &'static Database {
    kind(scenario).map_or_else(|_| Database::sma_actuator(), |kind| &*kind.without_truth)
}

/// The names of all plants, each with the frames of its rig.
pub fn databases() -> impl Iterator<Item = (&'static str, &'static Database)> {
    KINDS.iter().map(|kind| (kind.name, &*kind.database))
}

fn database_of<P: Plant>() -> Database {
    let signals: Vec<_> = P::SIGNALS.iter().map(described).collect();
    Database::with_plant(&signals)
}

fn described<P>(signal: &Signal<P>) -> PlantSignal {
    let [minimum, maximum] = signal.range;
    PlantSignal {
        name: signal.name.to_owned(),
        unit: signal.unit.to_owned(),
        comment: signal.comment.to_owned(),
        resolution: 1.0 / signal.steps_per_unit,
        range: Range { minimum, maximum },
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use canopen::CanFrame;

    use super::*;

    #[test]
    fn the_actuator_s_frames_are_those_of_the_shipped_dbc() {
        let kind = KINDS.iter().find(|kind| kind.name == SMA_ACTUATOR);
        let kind = kind.unwrap();
        assert_eq!(&*kind.database, Database::sma_actuator());
    }

    #[test]
    fn the_motor_tells_its_third_signal_in_tpdo3() {
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n\
                    [controller.open_loop]\n[plant.dc_motor]\nambient_celsius = 31.0\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let mut node = emulator(&scenario).unwrap();
        let started = [(0x000, &[1, 0][..]), (0x080, &[1])];
        node.on_tick(Duration::ZERO);
        for (id, data) in started {
            while node.next_frame().is_some() {}
            node.on_frame(Duration::from_millis(1), &CanFrame::new(id, data));
        }
        let told: Vec<_> = std::iter::from_fn(|| node.next_frame()).collect();
        let value = |path| {
            let signal = database(&scenario).require(path).unwrap();
            told.iter().find_map(|frame| signal.decode(frame))
        };
        assert_eq!(value("drive_tpdo2.winding_temperature_celsius"), Some(31.0));
        assert_eq!(
            value("drive_tpdo2.motor_speed_revolutions_per_minute"),
            Some(0.0)
        );
        assert_eq!(value("drive_tpdo3.spring_force_newtons"), Some(0.0));
    }
}
