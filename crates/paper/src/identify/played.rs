//! Scenarios that play an identified plant.

use dbc::CommandRange;
use plan::ControlLoop;
use scenario::Trial;
use scenario::plant::Sma;
use toml::{Table, Value};

/// The shipped rig, which emulates the plant whatever rig it was identified on; then its plant and its loop.
const RIG: &str = "sma_actuator";
pub(super) const PLANT: &str = "wire";
const LOOP: &str = "position";
/// Io node of that rig.
const IO: &str = "disturbance";

/// Returns the text of a scenario of one loop with this plant, on the rig that ships.
///
/// # Errors
/// The text is not TOML, or TOML cannot express a value.
pub fn text_on_shipped_rig(
    text: &str,
    control_loop: &ControlLoop,
    plant: &Sma,
) -> Result<String, Box<dyn std::error::Error>> {
    let mut table: Table = text.parse()?;
    table.remove("plant");
    table.remove("node");
    table.insert("rig".to_owned(), RIG.into());
    let bus = Value::try_from(&control_loop.trial.run.bus)?;
    table.insert("bus".to_owned(), bus);
    let names = names(control_loop);
    for section in ["controller", "expect"] {
        if let Some(Value::Table(by_loop)) = table.get_mut(section)
            && let Some(table) = by_loop.remove(&control_loop.trial.wiring.loop_name)
        {
            by_loop.insert(LOOP.to_owned(), table);
        }
    }
    for section in ["reference", "disturbance", "fault"] {
        if let Some(value) = table.get_mut(section) {
            rename(value, &names);
        }
    }
    let Trial {
        sensor, amplifier, ..
    } = &control_loop.trial;
    let (span, resolution_bits) = (sensor.span(), sensor.resolution_bits());
    let (noise_rms, amplifier_bits) = (sensor.noise_rms(), amplifier.resolution_bits());
    let (rated, CommandRange { min, max, .. }) = (amplifier.rated(), amplifier.range());
    let table = toml::to_string(&table)?;
    let plant = plant.to_file_text(PLANT)?;
    Ok(format!(
        "{table}\n[node.drive.sensor]\nmax = {span:?}\nresolution_bits = {resolution_bits}\nnoise_rms = {noise_rms:?}\n\n\
         [node.drive.amplifier]\nrated = {rated:?}\nmin = {min:?}\nmax = {max:?}\nresolution_bits = {amplifier_bits}\n\n{plant}"
    ))
}

/// Returns the names of the loop and its nodes, each with the corresponding name of the rig that ships.
fn names(control_loop: &ControlLoop) -> Vec<(&str, String)> {
    let wiring = &control_loop.trial.wiring;
    let named = wiring.all_nodes().map(|node| {
        let node = wiring.node(node);
        let shipped = Some(node.word()).filter(|_| !node.is_io());
        (node.name.as_str(), shipped.unwrap_or(IO).to_owned())
    });
    let loop_name = (wiring.loop_name.as_str(), LOOP.to_owned());
    [loop_name].into_iter().chain(named).collect()
}

/// Replaces the names in a value by those of the rig that ships.
fn rename(value: &mut Value, names: &[(&str, String)]) {
    match value {
        Value::String(text) => {
            if let Some((_, shipped)) = names.iter().find(|(name, _)| name == text) {
                text.clone_from(shipped);
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| rename(value, names)),
        Value::Table(table) => {
            table.iter_mut().for_each(|(_, value)| rename(value, names));
        }
        _ => {}
    }
}
