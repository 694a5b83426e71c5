//! The plants that scenarios can choose, by name: those that ship, and those that a bench of somebody else's brings.

use std::sync::{LazyLock, OnceLock};

use canopen::Node;
use dbc::loops::LoopPlace;
use dbc::scenario_clock::ScenarioClock;
use dbc::{Database, PlantSignal, Range};
use scenario::Scenario;
use scenario::own::{OwnTable, Parameters, Section, is_name};
use scenario::port::Ports;
use scenario::registration::{InvalidOwn, register};

use crate::dc_motor::DcMotor;
use crate::plant::{Plant, SIGNALS_MAX, Signal};
use crate::ports::{PlantWithPorts, PortedPlant, SingleAxis};
use crate::sma::Actuator;
use crate::sma::pair::SmaPair;
use crate::wires::Wires;
use crate::{DriveOf, InvalidEmulator, PlantEmulator};

/// Name of the actuator of the paper.
pub const SMA_ACTUATOR: &str = Actuator::NAME;

/// What makes a plant of a scenario's table.
type Make = Box<dyn Fn(&Scenario) -> Result<Box<dyn PortedPlant>, InvalidEmulator> + Send + Sync>;

/// What says which ports a plant will have, where to make it is much more.
type FindPorts = fn(&Scenario) -> Result<Ports, InvalidEmulator>;

/// A plant by its name, and what makes it.
pub struct Kind {
    name: &'static str,
    /// What a drive publishes of a plant of one axis, which never changes.
    signals: Option<Vec<PlantSignal>>,
    make: Make,
    /// None where the plant is made to see its ports.
    ports: Option<FindPorts>,
}

impl Kind {
    /// A plant of one axis; `config` gives its parameters in a scenario.
    fn of<P: Plant>(config: fn(&Scenario) -> Result<P::Config, InvalidEmulator>) -> Self {
        Self {
            name: P::NAME,
            signals: Some(P::SIGNALS.iter().map(described).collect()),
            make: Box::new(move |scenario| {
                let plant = P::new(&config(scenario)?)?;
                Ok(Box::new(SingleAxis::new(plant)))
            }),
            ports: None,
        }
    }

    /// A plant whose code is not the emulator's: `ports` says which ports it will have, `make` makes it.
    #[must_use]
    pub fn elsewhere(
        name: &'static str,
        ports: FindPorts,
        make: fn(&Scenario) -> Result<Box<dyn PortedPlant>, InvalidEmulator>,
    ) -> Self {
        Self {
            name,
            signals: None,
            make: Box::new(make),
            ports: Some(ports),
        }
    }

    /// A plant with ports of its own.
    fn with_ports<P: PlantWithPorts>(
        config: fn(&Scenario) -> Result<P::Config, InvalidEmulator>,
    ) -> Self {
        Self {
            name: P::NAME,
            signals: None,
            make: Box::new(move |scenario| Ok(Box::new(P::new(&config(scenario)?)?))),
            ports: None,
        }
    }

    /// The plant's name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// What a drive publishes of a plant of one axis; none for a plant with ports of its own, where the parameters may say.
    #[must_use]
    pub fn signals(&self) -> Option<&[PlantSignal]> {
        self.signals.as_deref()
    }
}

/// A plant from outside, with the table that it has in a scenario.
pub struct OwnPlant {
    kind: Kind,
    table: OwnTable,
}

impl OwnPlant {
    /// The plant `P`, which is one of one axis.
    #[must_use]
    pub fn of<P: Plant>() -> Self {
        Self {
            kind: Kind::of::<P>(|scenario| own_parameters(scenario, P::NAME)),
            table: OwnTable::new::<P::Config>(P::NAME).with_faults(P::FAULTS),
        }
    }

    /// The plant `P`, which has ports of its own.
    #[must_use]
    pub fn with_ports<P: PlantWithPorts>() -> Self {
        Self {
            kind: Kind::with_ports::<P>(|scenario| own_parameters(scenario, P::NAME)),
            table: OwnTable::new::<P::Config>(P::NAME).with_faults(P::FAULTS),
        }
    }
}

fn own_parameters<C: Parameters>(scenario: &Scenario, name: &str) -> Result<C, InvalidEmulator> {
    let own = scenario
        .plant
        .own
        .as_ref()
        .ok_or_else(|| InvalidEmulator::UnknownPlant(name.to_owned()))?;
    Ok(own.parameters::<C>()?)
}

/// Why a plant from outside cannot be registered.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
pub enum InvalidOwnPlant {
    /// Its table cannot be one.
    #[error(transparent)]
    Table(#[from] InvalidOwn),
    /// Too many signals.
    #[error("the plant `{plant}` has {count} signals of its own (limit {SIGNALS_MAX})")]
    TooManySignals {
        /// The plant.
        plant: &'static str,
        /// How many.
        count: usize,
    },
    /// A signal that the bus cannot carry.
    #[error("the signal `{signal}` of the plant `{plant}` {reason}")]
    Signal {
        /// The plant.
        plant: &'static str,
        /// The signal.
        signal: String,
        /// Why not.
        reason: &'static str,
    },
}

static SHIPPED: LazyLock<[Kind; 3]> = LazyLock::new(|| {
    [
        Kind::of::<Actuator>(|scenario| Ok(scenario.plant.clone())),
        Kind::of::<DcMotor>(|scenario| Ok(scenario.plant.dc_motor.clone().unwrap_or_default())),
        Kind::with_ports::<SmaPair>(|scenario| {
            Ok(scenario.plant.sma_pair.clone().unwrap_or_default())
        }),
    ]
});

static OWN: OnceLock<Vec<Kind>> = OnceLock::new();

static FMU: OnceLock<Kind> = OnceLock::new();

/// Hands in what plays FMUs, which takes processes. Where nobody does, there is no such plant. Later ones change nothing.
pub fn register_fmu(kind: Kind) {
    FMU.get_or_init(|| kind);
}

/// Registers the plants from outside, once and before any scenario is read.
///
/// # Errors
/// One of them has a name, parameters or signals that it cannot have.
pub fn register_plants(plants: Vec<OwnPlant>) -> Result<(), InvalidOwnPlant> {
    plants.iter().try_for_each(|plant| {
        check_signals(plant.kind.name, plant.kind.signals().unwrap_or_default())
    })?;
    let (kinds, tables) = plants
        .into_iter()
        .map(|plant| (plant.kind, plant.table))
        .unzip();
    register(Section::Plant, tables)?;
    OWN.set(kinds)
        .map_err(|_| InvalidOwnPlant::Table(InvalidOwn::RegisteredAlready))
}

/// Whether the bus can carry a plant's signals.
fn check_signals(plant: &'static str, signals: &[PlantSignal]) -> Result<(), InvalidOwnPlant> {
    let count = signals.len();
    if count > SIGNALS_MAX {
        return Err(InvalidOwnPlant::TooManySignals { plant, count });
    }
    for (place, signal) in signals.iter().enumerate() {
        let is_double = signals[..place]
            .iter()
            .any(|other| other.name == signal.name);
        if let Some(reason) = flaw(signal).or(is_double.then_some("is there twice")) {
            let signal = signal.name.clone();
            return Err(InvalidOwnPlant::Signal {
                plant,
                signal,
                reason,
            });
        }
    }
    Ok(())
}

/// What is wrong with a signal by itself.
fn flaw(signal: &PlantSignal) -> Option<&'static str> {
    let Range { minimum, maximum } = signal.range;
    // As the bus rounds: -32.768 in steps of 0.001 are -32768.
    let steps = [minimum, maximum].map(|limit| libm::round(limit / signal.resolution));
    let fits = match minimum < 0.0 {
        true => steps[0] >= f64::from(i16::MIN) && steps[1] <= f64::from(i16::MAX),
        false => steps[1] <= f64::from(u16::MAX),
    };
    if !is_name(&signal.name) {
        return Some("needs a name of at most 64 small letters, digits and underscores");
    }
    if !(signal.resolution > 0.0 && signal.resolution.is_finite()) {
        return Some("needs a number of steps per unit above 0");
    }
    let is_range = minimum < maximum;
    if !is_range {
        return Some("has an empty range");
    }
    (!fits).then_some("does not fit 16 bits over its range: take fewer steps per unit")
}

/// All plants, the shipped ones first.
pub fn kinds() -> impl Iterator<Item = &'static Kind> {
    let own = OWN.get().into_iter().flatten();
    SHIPPED.iter().chain(FMU.get()).chain(own)
}

/// The plant that a scenario chooses.
///
/// # Errors
/// It makes no sense.
pub fn plant(scenario: &Scenario) -> Result<Box<dyn PortedPlant>, InvalidEmulator> {
    (kind_of(scenario)?.make)(scenario)
}

/// Looks whether the plant that a scenario chooses makes sense and, where no rig file wires it, has the ports of a plant of one axis.
///
/// # Errors
/// It makes none, or has others.
pub fn check(scenario: &Scenario) -> Result<(), InvalidEmulator> {
    let ports = ports(scenario)?;
    // What a rig file wires is checked with it; a drive that is somebody else's has no port.
    let is_wired = !scenario.wiring.loops.is_empty();
    if !is_wired {
        Wires::new(&ports, &scenario.wiring)?;
    }
    Ok(())
}

/// The ports of the plant that a scenario chooses.
///
/// # Errors
/// It makes no sense.
pub fn ports(scenario: &Scenario) -> Result<Ports, InvalidEmulator> {
    if let Some(find) = kind_of(scenario)?.ports {
        return find(scenario);
    }
    let plant = plant(scenario)?;
    Ok(Ports {
        inputs: plant.inputs().to_vec(),
        outputs: plant.outputs().to_vec(),
    })
}

/// The emulator of the plant that a scenario chooses.
///
/// # Errors
/// The plant makes no sense.
pub fn emulator(scenario: &Scenario) -> Result<Box<dyn Node>, InvalidEmulator> {
    let database = Database::shipped();
    let only = DriveOf {
        scenario,
        place: LoopPlace::SHIPPED,
        database,
        clock: &ScenarioClock::new(database, ["drive"])?,
    };
    emulator_of(scenario.plant.name(), &[only])
}

/// The emulator of a plant with these drives, all of which choose the same one; errors call it `name`.
///
/// # Errors
/// As [`emulator`], and a port that the plant has not.
pub fn emulator_of(name: &str, drives: &[DriveOf<'_>]) -> Result<Box<dyn Node>, InvalidEmulator> {
    let first = drives.first().map(|drive| drive.scenario);
    let first = first.ok_or_else(|| InvalidEmulator::UnknownPlant(name.to_owned()))?;
    let emulator = PlantEmulator::of(name, plant(first)?, drives)?;
    Ok(Box::new(emulator))
}

fn kind_of(scenario: &Scenario) -> Result<&'static Kind, InvalidEmulator> {
    let name = scenario.plant.name();
    let kind = kinds().find(|kind| kind.name == name);
    kind.ok_or_else(|| InvalidEmulator::UnknownPlant(name.to_owned()))
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

    fn scenario(plant: &str) -> Scenario {
        let head = "schema = 1\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let text = format!("{head}{plant}");
        Scenario::parse(&text, "t.toml", |_| unreachable!("no table")).unwrap()
    }

    fn signals(plant: &str) -> Vec<PlantSignal> {
        let scenario = scenario(plant);
        let kind = kind_of(&scenario).unwrap();
        kind.signals().unwrap().to_vec()
    }

    fn database(plant: &str) -> Database {
        let composer = dbc::Composer::new("controller", 1);
        let signals = signals(plant);
        composer
            .with_drive(("drive", 0x10), Some(&signals), None, None)
            .finish()
    }

    #[test]
    fn the_actuator_s_frames_are_those_of_the_shipped_dbc() {
        let (ours, shipped) = (database(""), Database::shipped());
        let ours = Vec::from_iter(ours.plant_messages("drive"));
        assert_eq!(ours, Vec::from_iter(shipped.plant_messages("drive")));
    }

    #[test]
    fn the_motor_publishes_its_third_signal_in_tpdo3() {
        let scenario = scenario("[plant.dc_motor]\nambient_celsius = 31.0\n");
        let mut node = emulator(&scenario).unwrap();
        let started = [(0x000, &[1, 0][..]), (0x080, &[1])];
        node.on_tick(Duration::ZERO);
        for (id, data) in started {
            while node.next_frame().is_some() {}
            node.on_frame(Duration::from_millis(1), &CanFrame::new(id, data));
        }
        let frames: Vec<_> = std::iter::from_fn(|| node.next_frame()).collect();
        let database = database("[plant.dc_motor]\n");
        let value = |path| {
            let signal = database.require(path).unwrap();
            frames.iter().find_map(|frame| signal.decode(frame))
        };
        assert_eq!(value("drive_tpdo2.winding_temperature_celsius"), Some(31.0));
        assert_eq!(
            value("drive_tpdo2.motor_speed_revolutions_per_minute"),
            Some(0.0)
        );
        assert_eq!(value("drive_tpdo3.spring_force_newtons"), Some(0.0));
    }

    #[test]
    fn the_shipped_plants_could_come_from_outside() {
        for table in ["", "[plant.dc_motor]\n"] {
            let signals = signals(table);
            assert_eq!(check_signals("shipped", &signals), Ok(()), "{table}");
        }
    }

    #[test]
    fn a_signal_that_the_bus_cannot_carry_is_refused() {
        let signal = |name: &str, resolution, minimum, maximum| PlantSignal {
            name: name.to_owned(),
            unit: String::new(),
            comment: String::new(),
            resolution,
            range: Range { minimum, maximum },
        };
        assert_eq!(flaw(&signal("angle_degrees", 0.01, -180.0, 180.0)), None);
        assert_eq!(flaw(&signal("speed", 0.001, -32.768, 32.767)), None);
        for (wrong, reason) in [
            (signal("Angle (°)", 1.0, 0.0, 1.0), "name"),
            (signal("angle", 0.0, 0.0, 1.0), "above 0"),
            (signal("angle", f64::NAN, 0.0, 1.0), "above 0"),
            (signal("angle", 1.0, 1.0, 1.0), "empty"),
            (signal("angle", 1.0, f64::NAN, 1.0), "empty"),
            (signal("angle", 0.001, -180.0, 180.0), "16 bits"),
            (signal("angle", 1.0, 0.0, 65_536.0), "16 bits"),
        ] {
            assert!(flaw(&wrong).unwrap().contains(reason), "{wrong:?}");
        }
    }
}
