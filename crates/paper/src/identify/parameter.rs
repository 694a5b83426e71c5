//! Parameters of the plant by name, with the bounds of the search.

use scenario::plant::Sma;

/// Smallest difference between start and finish of a transformation.
const TRANSFORMATION_KELVINS_MIN: f64 = 1.0;

/// One parameter of the plant.
pub struct Parameter {
    /// Letter of the parameter in the paper.
    pub symbol: &'static str,
    /// Table and key below `[plant.NAME]`.
    pub path: &'static str,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Lower bound of the search.
    pub lower: f64,
    /// Upper bound of the search.
    pub upper: f64,
    field: fn(&mut Sma) -> &mut f64,
}

impl Parameter {
    /// Returns its value in a plant.
    pub fn get(&self, plant: &Sma) -> f64 {
        // The accessor needs `&mut`; a plant is a hundred numbers, and this is not called in loops.
        *(self.field)(&mut plant.clone())
    }

    /// Sets its value in a plant.
    pub fn set(&self, plant: &mut Sma, value: f64) {
        *(self.field)(plant) = value;
    }

    /// Returns the width of its range.
    pub fn range(&self) -> f64 {
        self.upper - self.lower
    }

    /// Returns the key in its table.
    pub fn key(&self) -> &'static str {
        self.path.split_once('.').map_or(self.path, |(_, key)| key)
    }
}

macro_rules! parameter {
    ($symbol:literal, $table:ident.$key:ident, $unit:literal, $lower:literal, $upper:literal) => {
        Parameter {
            symbol: $symbol,
            path: concat!(stringify!($table), ".", stringify!($key)),
            unit: $unit,
            lower: $lower,
            upper: $upper,
            field: |plant| &mut plant.$table.$key,
        }
    };
}

/// All parameters of heat, phase and mechanics. The ranges of the first six are from PAPER, "identification"; the
/// others are assumed.
pub static ALL: [Parameter; 23] = [
    parameter!(
        "C",
        heat.conduction_watts_per_metre_kelvin,
        "W/(m K)",
        0.05,
        1.0
    ),
    parameter!(
        "h",
        heat.convection_watts_per_square_metre_kelvin,
        "W/(m² K)",
        1.0,
        30.0
    ),
    parameter!("As", phase.austenite_start_celsius, "°C", 30.0, 90.0),
    parameter!("Af", phase.austenite_finish_celsius, "°C", 60.0, 120.0),
    parameter!("Ms", phase.martensite_start_celsius, "°C", 45.0, 90.0),
    parameter!("Mf", phase.martensite_finish_celsius, "°C", 20.0, 60.0),
    parameter!("m", heat.mass_kilograms_per_metre, "kg/m", 5e-5, 1e-3),
    parameter!(
        "cp",
        heat.specific_heat_joules_per_kilogram_kelvin,
        "J/(kg K)",
        200.0,
        3000.0
    ),
    parameter!("R", heat.resistance_ohms_per_metre, "Ω/m", 5.0, 100.0),
    parameter!(
        "A",
        heat.surface_square_metres_per_metre,
        "m²/m",
        1e-4,
        2e-3
    ),
    parameter!("Tamb", heat.ambient_celsius, "°C", -10.0, 45.0),
    parameter!("Tp", heat.cooling_element_celsius, "°C", -10.0, 45.0),
    parameter!("EA", mechanics.austenite_modulus_pascals, "Pa", 1e10, 2e11),
    parameter!("EM", mechanics.martensite_modulus_pascals, "Pa", 5e9, 1e11),
    parameter!("eps_my", mechanics.martensite_yield_strain, "1", 5e-4, 2e-2),
    parameter!("d", mechanics.wire_diameter_metres, "m", 5e-5, 5e-4),
    parameter!("l_wire", mechanics.wire_length_metres, "m", 0.05, 0.5),
    parameter!("delta", mechanics.recoverable_strain, "1", 0.01, 0.08),
    parameter!("r1", mechanics.inner_pulley_radius_metres, "m", 1e-3, 2e-2),
    parameter!("r2", mechanics.outer_pulley_radius_metres, "m", 2e-2, 1e-1),
    parameter!(
        "J",
        mechanics.pulley_inertia_kilogram_square_metres,
        "kg m²",
        1e-6,
        1e-3
    ),
    parameter!("mL", mechanics.load_kilograms, "kg", 5e-3, 0.2),
    parameter!(
        "c",
        mechanics.damping_newton_seconds_per_metre,
        "N s/m",
        0.01,
        10.0
    ),
];

/// Pairs of the colder and the hotter end of a transformation.
const ORDERED: [(&str, &str); 2] = [("As", "Af"), ("Mf", "Ms")];

fn names() -> String {
    let symbols: Vec<&str> = ALL.iter().map(|parameter| parameter.symbol).collect();
    format!("{} (or the keys of the plant)", symbols.join(", "))
}

/// Finds parameters by the paper's letters or the keys of the plant in a scenario, separated by commas.
///
/// # Errors
/// A name is unknown or is listed twice, or the list is empty.
pub fn parse_list(text: &str) -> Result<Vec<&'static Parameter>, String> {
    let mut list: Vec<&'static Parameter> = Vec::new();
    for name in text
        .split(',')
        .map(str::trim)
        .filter(|name| !name.is_empty())
    {
        let parameter = find(name).ok_or_else(|| {
            let name = name.chars().take(60).collect::<String>();
            format!(
                "there is no plant parameter \"{name}\"; there are {}",
                names()
            )
        })?;
        if list.iter().any(|other| other.symbol == parameter.symbol) {
            let symbol = parameter.symbol;
            return Err(format!("the plant parameter {symbol} is named twice"));
        }
        list.push(parameter);
    }
    if list.is_empty() {
        return Err(format!(
            "no plant parameter is named; there are {}",
            names()
        ));
    }
    Ok(list)
}

/// Finds a parameter by the paper's letter or its key.
pub(super) fn find(name: &str) -> Option<&'static Parameter> {
    ALL.iter().find(|parameter| {
        parameter.symbol == name || parameter.key() == name || parameter.path == name
    })
}

/// A linear inequality `coefficients · values ≤ limit`.
#[derive(Clone, Debug, PartialEq)]
pub struct Inequality {
    /// Coefficients, one per parameter.
    pub coefficients: Vec<f64>,
    /// Right-hand side.
    pub limit: f64,
}

/// Returns the order of the transformation temperatures, `As < Af` and `Mf < Ms`. A temperature that is not among the
/// parameters has its value in `plant`.
pub fn ordering(parameters: &[&Parameter], plant: &Sma) -> Vec<Inequality> {
    ORDERED
        .iter()
        .filter_map(|(cold, hot)| order(parameters, plant, cold, hot))
        .collect()
}

fn order(parameters: &[&Parameter], plant: &Sma, cold: &str, hot: &str) -> Option<Inequality> {
    let mut inequality = Inequality {
        coefficients: vec![0.0; parameters.len()],
        limit: -TRANSFORMATION_KELVINS_MIN,
    };
    let mut is_free = false;
    for (symbol, sign) in [(cold, 1.0), (hot, -1.0)] {
        match parameters
            .iter()
            .position(|parameter| parameter.symbol == symbol)
        {
            Some(place) => {
                inequality.coefficients[place] = sign;
                is_free = true;
            }
            None => inequality.limit -= sign * find(symbol)?.get(plant),
        }
    }
    is_free.then_some(inequality)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_papers_letters_or_the_keys() {
        let list = parse_list("C, load_kilograms,phase.austenite_start_celsius").unwrap();
        let symbols: Vec<&str> = list.iter().map(|parameter| parameter.symbol).collect();
        assert_eq!(symbols, ["C", "mL", "As"]);
        assert_eq!(
            parse_list("c").unwrap()[0].key(),
            "damping_newton_seconds_per_metre"
        );
    }

    #[test]
    fn wrong_lists_are_named() {
        let message = |text| parse_list(text).err().unwrap().to_string();
        assert!(message("C,Q").starts_with("there is no plant parameter \"Q\"; there are C, h,"));
        assert_eq!(
            message("C,conduction_watts_per_metre_kelvin"),
            "the plant parameter C is named twice"
        );
        assert!(message(" ,").starts_with("no plant parameter is named"));
    }

    #[test]
    fn every_parameter_reads_and_writes_its_field() {
        let nominal = toml::Table::try_from(Sma::default()).unwrap();
        for parameter in &ALL {
            let value = parameter.get(&Sma::default());
            assert!(
                (parameter.lower..=parameter.upper).contains(&value),
                "{}",
                parameter.symbol
            );
            let (table, key) = parameter.path.split_once('.').unwrap();
            assert_eq!(
                nominal[table][key].as_float(),
                Some(value),
                "{}",
                parameter.path
            );
            let mut changed = Sma::default();
            parameter.set(&mut changed, 2.0 * value);
            assert_eq!(parameter.get(&changed), 2.0 * value);
        }
    }

    #[test]
    fn the_order_binds_free_temperatures_to_fixed_ones() {
        let plant = Sma::default();
        let both = ordering(&parse_list("C,As,Af").unwrap(), &plant);
        assert_eq!(both.len(), 1);
        assert_eq!(both[0].coefficients, [0.0, 1.0, -1.0]);
        // Ms is 66 °C and fixed: Mf ≤ 65 °C.
        let one = ordering(&parse_list("Mf").unwrap(), &plant);
        assert_eq!((one[0].coefficients[0], one[0].limit), (1.0, 65.0));
        assert!(ordering(&parse_list("C,h").unwrap(), &plant).is_empty());
    }
}
