//! Plants and laws of this program: the shipped ones and those that an external bench registered.

use std::sync::LazyLock;

use controller::catalogue as laws;
use plant_emulator::catalogue::PlantRow;
use plant_emulator::{InvalidEmulator, catalogue as plants};
use scenario::plant::PlantModel;
use scenario::{Objection, Trial};

use plan::catalogue::Catalogue;

use crate::fmu_plant::{self, FmuPlant};
use crate::law_worker;

/// Returns every plant and every law that a scenario may choose. Custom plants and laws must be registered before the first call.
pub fn catalogue() -> &'static Catalogue {
    static CATALOGUE: LazyLock<Catalogue> = LazyLock::new(|| {
        plants::register_fmu(PlantRow::of::<FmuPlant>());
        Catalogue {
            find_ports: Some(plants::ports),
            plant_objection,
            find_terms: |trial| laws::terms(&trial.controller, &trial.wiring),
            law_objection,
        }
    });
    &CATALOGUE
}

fn law_objection(trial: &Trial) -> Option<Objection> {
    let objection = laws::objection(&trial.controller, &trial.wiring);
    objection.or_else(|| law_worker::objection(trial.controller.fmu.as_ref()?))
}

fn plant_objection(model: &PlantModel) -> Option<Objection> {
    let plant = model.name();
    if let Some(fmu) = &model.fmu {
        return fmu_plant::objection(fmu);
    }
    // Errors in its wiring are reported at the rig.
    let Err(InvalidEmulator::Plant(invalid)) = plants::check(model) else {
        return None;
    };
    let path = match invalid.parameter() {
        Some(parameter) => format!("plant.{plant}.{parameter}"),
        None => format!("plant.{plant}"),
    };
    let message = format!("the plant `{plant}` makes no physical sense");
    Some(Objection::new(path, message, invalid.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_whose_model_lifts_nothing_is_objected_to() {
        let objection = |law: &str, modulus: &str| {
            let text = format!(
                "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.{law}.nominal_model]\n\
                 austenite_modulus_pascals = {modulus}\n\
                 [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 20.0\n"
            );
            let trial = testing::part(&text, "drive");
            law_objection(&trial).map(|objection| objection.path)
        };
        for law in ["sliding_mode", "sliding_mode_paper"] {
            assert_eq!(objection(law, "28e9"), None);
            let path = format!("controller.{law}.nominal_model");
            for modulus in ["1e-9", "1e6", "1e9"] {
                assert_eq!(objection(law, modulus).as_ref(), Some(&path), "{modulus}");
            }
        }
    }

    #[test]
    fn every_column_of_the_shipped_plants_and_laws_has_another_name() {
        let gains = "proportional_amperes_per_metre = 64.8\nintegral_amperes_per_metre_second = 489.0\n\
                     derivative_ampere_seconds_per_metre = 3.74\n";
        for (rig, law, gains) in [
            ("sma_actuator", "sliding_mode", ""),
            ("dc_motor", "pid", gains),
        ] {
            let text = format!(
                "schema = 1\nrig = \"{rig}\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.{law}]\n{gains}\
                 [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 20.0\n"
            );
            let trial = testing::part(&text, "drive");
            assert_eq!(catalogue().objections(&trial), []);
        }
    }
}
