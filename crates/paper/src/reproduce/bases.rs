//! Scenario files that the experiments start from. They are part of the program, so it needs no checkout.

use std::path::Path;

use scenario::controller::Controller;
use scenario::plant::PlantModel;
use scenario::{Beside, Trial};

use campaigns::sweep::sweep_cases::SweepCases;
use plan::Plan;
use worlds::catalogue::catalogue;

macro_rules! bases {
    ($($name:ident),*) => {
        $(
            #[doc = concat!("`scenarios/", stringify!($name), ".toml`.")]
            pub(super) fn $name() -> Trial {
                let name = concat!(stringify!($name), ".toml");
                let text = include_str!(concat!("../../../../scenarios/", stringify!($name), ".toml"));
                parse(name, text)
            }
        )*

        #[test]
        fn every_base_is_valid() {
            for base in [$($name),*] {
                assert!(!base().run.name.is_empty());
            }
        }
    };
}

bases!(
    bandwidth,
    fan,
    fan_open_loop,
    hysteresis,
    identify_excitation,
    infeasible,
    load,
    ramp,
    sine_20s,
    sine_5s,
    step,
    step_cold,
    step_other_truth
);

/// Returns the cases of `scenarios/sweeps/plants.toml`: the step on plants that the controller does not know.
pub(super) fn plants() -> SweepCases {
    let text = include_str!("../../../../scenarios/sweeps/plants.toml");
    SweepCases::new(&sweep("plants.toml", text)).expect("a test plays every plant")
}

/// Returns the PID of `scenarios/sweeps/pid.toml`, which is tuned over plants.
pub(super) fn pid_over_plants() -> Controller {
    let text = include_str!("../../../../scenarios/sweeps/pid.toml");
    only(&sweep("pid.toml", text)).controller.clone()
}

fn sweep(name: &str, text: &str) -> Plan {
    let beside = Beside::new(Path::new(name));
    let plan = Plan::parse_beside(&beside, text.to_owned(), catalogue());
    plan.expect("a test plays every plant")
}

/// Returns the only loop of a case.
pub(super) fn only(plan: &Plan) -> &Trial {
    &plan.only_loop().expect("a rig with one loop").trial
}

/// Returns a plant that is no law's model: the first of [`plants`].
pub(super) fn twin() -> PlantModel {
    let plan = plants().case(1).plan().expect("a test plays every plant");
    only(&plan).plant().clone()
}

fn parse(name: &str, text: &str) -> Trial {
    let no_table = |_: &str| Err(std::io::ErrorKind::NotFound.into());
    Trial::parse(text, name, no_table).expect("a test parses every base")
}
