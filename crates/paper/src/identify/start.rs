//! Start values of the search.

use std::path::Path;

use scenario::plant::Sma;

use super::fit::{Fit, mean_square};
use super::parameter::find;

/// Smallest rise of the load in the simulation that counts as lifted.
const LIFT_METRES_MIN: f64 = 1e-3;
/// Number of points of a scan.
const SCAN_POINTS: u32 = 96;
/// Bases of the Halton sequence, one per parameter.
const PRIMES: [u32; 23] = [
    2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83,
];
/// The paper's a-priori values, its Sec. 3.
const SECTION_3: [(&str, f64); 6] = [
    ("C", 0.4),
    ("h", 6.55),
    ("As", 68.0),
    ("Af", 78.0),
    ("Ms", 52.0),
    ("Mf", 42.0),
];

/// Reads the plant of a file from its table `[plant.NAME]`, as in a scenario; other tables are ignored.
///
/// # Errors
/// The file cannot be read or has no such table.
pub fn read_plant(path: &Path) -> Result<Sma, String> {
    let fault = |reason: &str| format!("`{}` gives no plant: {reason}", path.display());
    let text = scenario::read_text(path, plan::FILE_BYTES_MAX)
        .map_err(|error| fault(&error.to_string()))?;
    Sma::from_file_text(&text)
        .map_err(|error| fault(error.message()))?
        .map(|(_, plant)| plant)
        .ok_or_else(|| fault("it has no table [plant.NAME]"))
}

/// Returns the plant with the start values: those of `section3`, those of the `nominal` plant, which are the paper's identified
/// values, or those of a file.
///
/// # Errors
/// The file cannot be used.
pub fn plant(start: &Path) -> Result<Sma, String> {
    match start.to_str() {
        Some("section3") => Ok(section_3()),
        Some("nominal") => Ok(Sma::default()),
        _ => read_plant(start),
    }
}

/// Returns the plant with the paper's a-priori values, and nominal ones for the other parameters.
pub fn section_3() -> Sma {
    let mut plant = Sma::default();
    for (symbol, value) in SECTION_3 {
        if let Some(parameter) = find(symbol) {
            parameter.set(&mut plant, value);
        }
    }
    plant
}

/// Returns whether the load of the simulated plant leaves its stop. If it does not, all derivatives are zero and show
/// no direction.
pub fn lifts(fit: &Fit<'_>, values: &[f64]) -> bool {
    let positions = fit.simulated_metres(values).unwrap_or_default();
    positions.iter().any(|position| *position > LIFT_METRES_MIN)
}

/// Returns the admissible point with the smallest residual among points spread evenly over the bounds (Halton's
/// sequence).
pub fn scan(fit: &Fit<'_>) -> Option<Vec<f64>> {
    let coarse = fit.coarse();
    let points = (1..)
        .map(|index| point(&coarse, index))
        .take(100 * SCAN_POINTS as usize)
        .filter(|values| coarse.admits(values))
        .take(SCAN_POINTS as usize);
    let rated =
        points.filter_map(|values| Some((mean_square(&coarse.residual_metres(&values)?), values)));
    rated
        .min_by(|left, right| left.0.total_cmp(&right.0))
        .map(|(_, values)| values)
}

/// Returns a point of Halton's sequence within the bounds.
fn point(fit: &Fit<'_>, index: u32) -> Vec<f64> {
    let coordinates = fit.parameters.iter().zip(PRIMES);
    coordinates
        .map(|(parameter, base)| parameter.lower + parameter.range() * radical_inverse(index, base))
        .collect()
}

/// Returns the digits of `index` mirrored at the point.
fn radical_inverse(mut index: u32, base: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while index > 0 {
        value += digit * f64::from(index % base);
        digit /= f64::from(base);
        index /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_of_base_2_halves_and_halves() {
        let values: Vec<f64> = (1..6).map(|index| radical_inverse(index, 2)).collect();
        assert_eq!(values, [0.5, 0.25, 0.75, 0.125, 0.625]);
    }

    #[test]
    fn a_scenario_has_its_plant_under_a_name() {
        let text = |table| format!("name = \"t\"\n[{table}.mechanics]\nload_kilograms = 0.05\n");
        let read = |table| Sma::from_file_text(&text(table));
        let (name, plant) = read("plant.wire").unwrap().unwrap();
        assert_eq!((&*name, plant.mechanics.load_kilograms), ("wire", 0.05));
        assert!(read("plant").is_err());
    }

    #[test]
    fn section_3_is_the_papers() {
        let plant = section_3();
        assert_eq!(plant.heat.conduction_watts_per_metre_kelvin, 0.4);
        assert_eq!(plant.phase.martensite_finish_celsius, 42.0);
        assert_eq!(plant.mechanics, Sma::default().mechanics);
    }
}
