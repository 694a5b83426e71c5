//! The plants that scenarios can choose, by name: the shipped ones in [`plants`](crate::plants), and the custom ones of
//! a bench.

use std::sync::OnceLock;

use dbc::Database;
use scenario::Trial;
use scenario::custom::{CustomTable, Section, defaults};
use scenario::plant::{PlantModel, is_built_in};
use scenario::registration::{InvalidRegistration, register};

use crate::plant::{Plant, Ports};
use crate::plants::SHIPPED;
use crate::{InvalidEmulator, PlantEmulator};

/// A plant that a scenario can choose by the table with its name.
#[derive(Clone, Copy)]
pub struct PlantRow {
    name: fn() -> &'static str,
    table: fn() -> CustomTable,
    make: fn(&PlantModel) -> Result<Box<dyn Plant>, InvalidEmulator>,
    ports: fn(&PlantModel) -> Result<Ports, InvalidEmulator>,
    /// Ports for default parameters; `None` if some parameters have no default.
    default_ports: fn() -> Option<Ports>,
}

impl PlantRow {
    /// Returns the row of the plant `P`.
    pub const fn of<P: Plant>() -> Self {
        Self {
            name: P::name,
            table: || CustomTable::new::<P::Config>(P::name()).with_faults(P::faults()),
            make: |plant| Ok(Box::new(plant.with_parameters(P::new)??)),
            ports: |plant| Ok(plant.with_parameters(P::ports_by)??),
            default_ports: || P::ports_by(&defaults().ok()?).ok(),
        }
    }
}

static OWN: OnceLock<Vec<PlantRow>> = OnceLock::new();

static FMU: OnceLock<PlantRow> = OnceLock::new();

/// Registers the plant that plays FMUs. It needs processes, so it is absent without this call. Later calls have no
/// effect.
pub fn register_fmu(row: PlantRow) {
    FMU.get_or_init(|| row);
}

/// Registers the custom plants, once and before any scenario is read. It also registers the shipped plants that are not
/// in the format of scenarios.
///
/// # Errors
/// A plant has an invalid name, parameters or ports.
pub fn register_plants(plants: Vec<PlantRow>) -> Result<(), InvalidRegistration> {
    plants.iter().try_for_each(check_ports)?;
    let shipped = SHIPPED.iter().filter(|row| !is_built_in((row.name)()));
    let tables = shipped.chain(&plants).map(|row| (row.table)());
    register(Section::Plant, tables.collect())?;
    OWN.set(plants).map_err(|_| InvalidRegistration::again())
}

/// Checks that the bus can carry the ports.
fn check_ports(row: &PlantRow) -> Result<(), InvalidRegistration> {
    let ports = (row.default_ports)().unwrap_or_default();
    match ports.flaw() {
        None => Ok(()),
        Some((port, reason)) => Err(InvalidRegistration(format!(
            "the port `{}` of the plant `{}` {reason}",
            port.name,
            (row.name)()
        ))),
    }
}

/// Makes a plant.
///
/// # Errors
/// The plant is invalid.
pub fn plant(model: &PlantModel) -> Result<Box<dyn Plant>, InvalidEmulator> {
    (find_row(model)?.make)(model)
}

/// Checks a plant.
///
/// # Errors
/// The plant is invalid.
pub fn check(model: &PlantModel) -> Result<(), InvalidEmulator> {
    (find_row(model)?.ports)(model).map(drop)
}

/// Returns the ports of a plant. If its parameters are invalid, these are the default ports, so that the rest of the scenario
/// can be checked. `None` if neither are known.
pub fn ports(model: &PlantModel) -> Option<Ports> {
    let row = find_row(model).ok()?;
    (row.ports)(model).ok().or_else(row.default_ports)
}

/// Makes the emulator of the plant that a scenario chooses.
///
/// # Errors
/// The plant is invalid.
pub fn emulator(trial: &Trial) -> Result<PlantEmulator, InvalidEmulator> {
    joint_emulator(&[trial], Database::shipped())
}

/// Makes the emulator of the drives of these loops, and of their plants, on a bus with these frames.
///
/// # Errors
/// As [`emulator`], or a port that the plants lack.
pub fn joint_emulator(
    loops: &[&Trial],
    database: &Database,
) -> Result<PlantEmulator, InvalidEmulator> {
    let models = loops.first().into_iter().flat_map(|first| &first.plants);
    let plants = models.map(|(name, model)| Ok((name.to_owned(), plant(model)?)));
    let made = plants.collect::<Result<_, InvalidEmulator>>()?;
    PlantEmulator::of(made, loops, database)
}

fn find_row(model: &PlantModel) -> Result<&'static PlantRow, InvalidEmulator> {
    let name = model.name();
    let custom = OWN.get().into_iter().flatten();
    let mut rows = SHIPPED.iter().chain(FMU.get()).chain(custom);
    let row = rows.find(|row| (row.name)() == name);
    row.ok_or_else(|| InvalidEmulator::Other(format!("there is no plant `{name}`")))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use can::{CanFrame, Node};

    use super::*;

    fn scenario(rig: &str, plant: &str) -> Trial {
        let text = format!(
            "schema = 1\nrig = \"{rig}\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n{plant}"
        );
        testing::part(&text, "drive")
    }

    #[test]
    fn the_motor_publishes_its_third_signal_in_tpdo3() {
        let scenario = scenario("dc_motor", "[plant.motor]\nambient_celsius = 31.0\n");
        let mut node = emulator(&scenario).unwrap();
        let started = [(0x000, &[1, 0][..]), (0x080, &[1])];
        node.on_tick(Duration::ZERO);
        for (id, data) in started {
            while node.next_frame().is_some() {}
            node.on_frame(Duration::from_millis(1), &CanFrame::new(id, data));
        }
        let frames: Vec<_> = std::iter::from_fn(|| node.next_frame()).collect();
        let field = |id, place: usize| {
            let frame = frames.iter().find(|frame| frame.standard_id() == Some(id));
            frame.map(|frame| i16::from_le_bytes([frame.data()[place], frame.data()[place + 1]]))
        };
        let [tpdo2, tpdo3] = [0x290, 0x390];
        assert_eq!(field(tpdo2, 0), Some(3100), "hundredths of a degree");
        assert_eq!(field(tpdo2, 2), Some(0), "revolutions per minute");
        assert_eq!(field(tpdo3, 0), Some(0), "hundredths of a newton");
    }

    #[test]
    fn the_shipped_plants_could_come_from_outside() {
        for row in &SHIPPED {
            assert_eq!(check_ports(row), Ok(()), "{}", (row.name)());
        }
    }

    #[test]
    fn ports_are_those_by_default_where_parameters_make_no_sense() {
        let wrong = scenario(
            "dc_motor",
            "[plant.motor]\nload_kilograms = 0.0\nspring_newtons_per_metre = 1e6\n\
            rotor_inertia_kilogram_square_metres = 1e-12\ngear_inertia_kilogram_square_metres = 0.0\n",
        );
        assert!(matches!(
            check(wrong.plant()),
            Err(InvalidEmulator::Plant(_))
        ));
        let right = scenario("dc_motor", "");
        assert_eq!(ports(wrong.plant()), ports(right.plant()));
    }
}
