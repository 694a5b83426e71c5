//! The text of a scenario that plays an identified plant.

use scenario::Scenario;
use scenario::plant::{Amplifier, Sensor};
use toml::Table;

/// The rig that emulates the plant, whatever rig it was identified on.
const RIG: &str = "sma_actuator";

/// The scenario of one loop with its plant, sensor and amplifier, on the rig that ships.
///
/// # Errors
/// A value has no form in TOML.
pub fn text_on_shipped_rig(scenario: &Scenario) -> Result<String, toml::ser::Error> {
    let plant = &scenario.plant;
    let Sensor {
        resolution_bits,
        span_millimetres,
        noise_millimetres_rms,
    } = plant.sensor;
    let Amplifier {
        current_amperes_min,
        current_amperes_max,
        resolution_bits: amplifier_bits,
    } = plant.amplifier;
    let mut table = Table::try_from(scenario)?;
    table.remove("plant");
    table.insert("rig".to_owned(), RIG.into());
    let table = toml::to_string(&table)?;
    let heat = toml::to_string(&plant.heat)?;
    let phase = toml::to_string(&plant.phase)?;
    let mechanics = toml::to_string(&plant.mechanics)?;
    Ok(format!(
        "{table}\n[node.drive.sensor]\nmax = {span_millimetres:?}\nresolution_bits = {resolution_bits}\n\
         noise_rms = {noise_millimetres_rms:?}\n\n[node.drive.amplifier]\nmin = {current_amperes_min:?}\n\
         max = {current_amperes_max:?}\nresolution_bits = {amplifier_bits}\n\n[plant.wire.heat]\n{heat}\n\
         [plant.wire.phase]\n{phase}\n[plant.wire.mechanics]\n{mechanics}"
    ))
}
