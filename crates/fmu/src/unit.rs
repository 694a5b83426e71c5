//! Units: the definitions in an FMU, and the units at the ends of ports' names.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

/// Base units.
pub(crate) const BASE_UNITS: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

/// Exponents of the base units: kg, m, s, A, K, mol, cd and rad.
pub type Exponents = [i32; 8];

/// A unit in terms of the base units: `base = factor · value + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Base {
    /// Exponents of the base units.
    pub exponents: Exponents,
    /// Factor to the base unit.
    pub factor: f64,
    /// Offset in the base unit.
    pub offset: f64,
}

/// Conversion of a value: `factor · value + offset`.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
pub struct Conversion {
    /// Factor.
    pub factor: f64,
    /// Offset, in the target's unit.
    pub offset: f64,
}

impl Conversion {
    /// The identity.
    pub const NONE: Self = Self {
        factor: 1.0,
        offset: 0.0,
    };

    /// Returns the converted value. The identity keeps every bit.
    pub fn of(self, value: f64) -> f64 {
        if self == Self::NONE {
            value
        } else {
            self.factor * value + self.offset
        }
    }

    /// Returns the value whose conversion is `value`.
    pub fn back(self, value: f64) -> f64 {
        if self == Self::NONE {
            value
        } else {
            (value - self.offset) / self.factor
        }
    }
}

impl Base {
    /// Returns the conversion to another unit of the same quantity; `None` if the quantities differ.
    pub fn to(&self, target: &Self) -> Option<Conversion> {
        if self.exponents != target.exponents {
            return None;
        }
        Some(Conversion {
            factor: self.factor / target.factor,
            offset: (self.offset - target.offset) / target.factor,
        })
    }
}

/// A unit by its name at the end of a port's name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Name of the unit, such as `metres_per_second`; empty for a number without a unit.
    pub word: &'static str,
    /// Symbol of the unit in FMUs and tables.
    pub symbol: &'static str,
    /// Definition by the base units.
    pub base: Base,
}

const fn known(
    word: &'static str,
    symbol: &'static str,
    exponents: Exponents,
    factor: f64,
) -> Known {
    Known {
        word,
        symbol,
        base: Base {
            exponents,
            factor,
            offset: 0.0,
        },
    }
}

const CELSIUS: Known = {
    let mut celsius = known("celsius", "degC", [0, 0, 0, 0, 1, 0, 0, 0], 1.0);
    celsius.base.offset = 273.15;
    celsius
};

/// Units for ports' names, and for units that an FMU does not define.
#[rustfmt::skip]
pub const KNOWN: [Known; 53] = [
    known("amperes", "A", [0, 0, 0, 1, 0, 0, 0, 0], 1.0),
    known("milliamperes", "mA", [0, 0, 0, 1, 0, 0, 0, 0], 1e-3),
    known("volts", "V", [1, 2, -3, -1, 0, 0, 0, 0], 1.0),
    known("ohms", "Ohm", [1, 2, -3, -2, 0, 0, 0, 0], 1.0),
    known("watts", "W", [1, 2, -3, 0, 0, 0, 0, 0], 1.0),
    known("joules", "J", [1, 2, -2, 0, 0, 0, 0, 0], 1.0),
    known("metres", "m", [0, 1, 0, 0, 0, 0, 0, 0], 1.0),
    known("millimetres", "mm", [0, 1, 0, 0, 0, 0, 0, 0], 1e-3),
    known("micrometres", "um", [0, 1, 0, 0, 0, 0, 0, 0], 1e-6),
    known("metres_per_second", "m/s", [0, 1, -1, 0, 0, 0, 0, 0], 1.0),
    known("millimetres_per_second", "mm/s", [0, 1, -1, 0, 0, 0, 0, 0], 1e-3),
    known("metres_per_second_squared", "m/s2", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
    known("square_metres", "m2", [0, 2, 0, 0, 0, 0, 0, 0], 1.0),
    known("cubic_metres", "m3", [0, 3, 0, 0, 0, 0, 0, 0], 1.0),
    known("cubic_metres_per_second", "m3/s", [0, 3, -1, 0, 0, 0, 0, 0], 1.0),
    known("litres", "l", [0, 3, 0, 0, 0, 0, 0, 0], 1e-3),
    known("litres_per_minute", "l/min", [0, 3, -1, 0, 0, 0, 0, 0], 1e-3 / 60.0),
    known("radians", "rad", [0, 0, 0, 0, 0, 0, 0, 1], 1.0),
    known("degrees", "deg", [0, 0, 0, 0, 0, 0, 0, 1], PI / 180.0),
    known("revolutions", "rev", [0, 0, 0, 0, 0, 0, 0, 1], 2.0 * PI),
    known("radians_per_second", "rad/s", [0, 0, -1, 0, 0, 0, 0, 1], 1.0),
    known("degrees_per_second", "deg/s", [0, 0, -1, 0, 0, 0, 0, 1], PI / 180.0),
    known("revolutions_per_minute", "rpm", [0, 0, -1, 0, 0, 0, 0, 1], PI / 30.0),
    known("revolutions_per_second", "rev/s", [0, 0, -1, 0, 0, 0, 0, 1], 2.0 * PI),
    known("kilograms", "kg", [1, 0, 0, 0, 0, 0, 0, 0], 1.0),
    known("grams", "g", [1, 0, 0, 0, 0, 0, 0, 0], 1e-3),
    known("kilograms_per_second", "kg/s", [1, 0, -1, 0, 0, 0, 0, 0], 1.0),
    known("newtons", "N", [1, 1, -2, 0, 0, 0, 0, 0], 1.0),
    known("newton_metres", "N.m", [1, 2, -2, 0, 0, 0, 0, 0], 1.0),
    known("newtons_per_metre", "N/m", [1, 0, -2, 0, 0, 0, 0, 0], 1.0),
    known("newton_metres_per_ampere", "N.m/A", [1, 2, -2, -1, 0, 0, 0, 0], 1.0),
    known("newtons_per_ampere", "N/A", [1, 1, -2, -1, 0, 0, 0, 0], 1.0),
    known("joules_per_kelvin", "J/K", [1, 2, -2, 0, -1, 0, 0, 0], 1.0),
    known("watts_per_kelvin", "W/K", [1, 2, -3, 0, -1, 0, 0, 0], 1.0),
    known("newton_metre_seconds", "N.m.s", [1, 2, -1, 0, 0, 0, 0, 0], 1.0),
    known("newton_seconds_per_metre", "N.s/m", [1, 0, -1, 0, 0, 0, 0, 0], 1.0),
    known("kilogram_square_metres", "kg.m2", [1, 2, 0, 0, 0, 0, 0, 0], 1.0),
    known("kilograms_per_metre", "kg/m", [1, -1, 0, 0, 0, 0, 0, 0], 1.0),
    known("joules_per_kilogram", "J/kg", [0, 2, -2, 0, 0, 0, 0, 0], 1.0),
    known("joules_per_kilogram_kelvin", "J/(kg.K)", [0, 2, -2, 0, -1, 0, 0, 0], 1.0),
    known("ohms_per_metre", "Ohm/m", [1, 1, -3, -2, 0, 0, 0, 0], 1.0),
    known("square_metres_per_metre", "m2/m", [0, 1, 0, 0, 0, 0, 0, 0], 1.0),
    known("watts_per_square_metre_kelvin", "W/(m2.K)", [1, 0, -3, 0, -1, 0, 0, 0], 1.0),
    known("watts_per_metre_kelvin", "W/(m.K)", [1, 1, -3, 0, -1, 0, 0, 0], 1.0),
    known("kelvins_per_watt", "K/W", [-1, -2, 3, 0, 1, 0, 0, 0], 1.0),
    known("pascals", "Pa", [1, -1, -2, 0, 0, 0, 0, 0], 1.0),
    known("bar", "bar", [1, -1, -2, 0, 0, 0, 0, 0], 1e5),
    known("kelvins", "K", [0, 0, 0, 0, 1, 0, 0, 0], 1.0),
    known("seconds", "s", [0, 0, 1, 0, 0, 0, 0, 0], 1.0),
    known("hertz", "Hz", [0, 0, -1, 0, 0, 0, 0, 0], 1.0),
    known("percent", "%", [0; 8], 1e-2),
    known("factor", "1", [0; 8], 1.0),
    CELSIUS,
];

/// Returns the unit at the end of a port's name, the longest that fits; `None` for a number without a unit.
pub fn unit_in_name(name: &str) -> Option<&'static Known> {
    let fits = |known: &&Known| {
        let head = name.strip_suffix(known.word);
        head.is_some_and(|head| head.is_empty() || head.ends_with('_'))
    };
    KNOWN
        .iter()
        .filter(fits)
        .max_by_key(|known| known.word.len())
}

/// Returns the unit of a symbol, in the spellings of different tools.
pub fn unit_by_symbol(symbol: &str) -> Option<&'static Known> {
    let symbol = match symbol {
        "°C" | "Celsius" => "degC",
        "°" => "deg",
        "Nm" | "N*m" => "N.m",
        "m/s^2" => "m/s2",
        "m^2" => "m2",
        "r/min" | "rev/min" => "rpm",
        "-" | "" => "1",
        other => other,
    };
    KNOWN.iter().find(|known| known.symbol == symbol)
}

/// Returns the unit that equals this one, else one of the same quantity; `None` for a number without a unit.
pub fn unit_by_base(base: &Base) -> Option<&'static Known> {
    let same = KNOWN.iter().find(|known| known.base == *base);
    let alike =
        |known: &&Known| known.base.exponents == base.exponents && known.base.exponents != [0; 8];
    same.or_else(|| KNOWN.iter().find(alike))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_unit_at_the_end_of_a_name_counts() {
        assert_eq!(
            unit_in_name("speed_metres_per_second").unwrap().symbol,
            "m/s"
        );
        assert_eq!(unit_in_name("metres").unwrap().symbol, "m");
        assert_eq!(unit_in_name("current_milliamperes").unwrap().symbol, "mA");
        assert_eq!(unit_in_name("parametres"), None);
        assert_eq!(unit_in_name("valve"), None);
    }

    #[test]
    fn no_two_units_share_word_or_symbol() {
        for (place, one) in KNOWN.iter().enumerate() {
            for other in &KNOWN[..place] {
                assert_ne!(one.word, other.word);
                assert_ne!(one.symbol, other.symbol);
            }
        }
    }

    #[test]
    fn values_are_converted_by_the_base_units() {
        let to = |from: &str, to: &str| {
            let [from, to] = [from, to].map(|symbol| unit_by_symbol(symbol).unwrap().base);
            from.to(&to)
        };
        assert!((to("mm", "m").unwrap().of(20.0) - 0.02).abs() < 1e-15);
        assert!((to("K", "degC").unwrap().of(300.0) - 26.85).abs() < 1e-12);
        assert!((to("degC", "K").unwrap().of(26.85) - 300.0).abs() < 1e-12);
        assert!((to("rpm", "rad/s").unwrap().of(60.0) - 2.0 * PI).abs() < 1e-12);
        assert_eq!(to("m", "s"), None);
        let conversion = to("degC", "K").unwrap();
        assert!((conversion.back(conversion.of(21.0)) - 21.0).abs() < 1e-12);
    }

    /// Returns exponents and factor of a product of units, such as `W/(m2.K)`.
    fn product(symbol: &str) -> (Exponents, f64) {
        let parts = symbol.split('/').zip([1, -1]);
        let units = parts.flat_map(|(part, sign)| {
            let part = part.trim_matches(['(', ')']);
            part.split('.').map(move |unit| (unit, sign))
        });
        units.fold(([0; 8], 1.0), |(mut exponents, factor), (unit, sign)| {
            let name = unit.trim_end_matches(char::is_numeric);
            let power = sign * unit[name.len()..].parse().unwrap_or(1);
            let (name, times) = if name == "min" {
                ("s", 60.0)
            } else {
                (name, 1.0)
            };
            let base = unit_by_symbol(name).unwrap().base;
            for (exponent, one) in exponents.iter_mut().zip(base.exponents) {
                *exponent += power * one;
            }
            (exponents, factor * (base.factor * times).powi(power))
        })
    }

    #[test]
    fn a_unit_is_the_product_that_its_symbol_says() {
        let is_product = |symbol: &str| symbol.contains(['/', '.', '2', '3']);
        let products = KNOWN.iter().map(|known| known.symbol);
        let derived = [
            ("N", "kg.m/s2"),
            ("J", "N.m"),
            ("W", "J/s"),
            ("V", "W/A"),
            ("Ohm", "V/A"),
            ("Pa", "N/m2"),
        ];
        let said = products.filter(|symbol| is_product(symbol));
        for (symbol, said) in said.map(|symbol| (symbol, symbol)).chain(derived) {
            let base = unit_by_symbol(symbol).unwrap().base;
            let (exponents, factor) = product(said);
            assert_eq!(base.exponents, exponents, "{symbol}");
            assert!((base.factor / factor - 1.0).abs() < 1e-12, "{symbol}");
        }
    }

    #[test]
    fn units_with_factor_and_offset_are_converted() {
        let kelvins = unit_by_symbol("K").unwrap().base;
        let fahrenheit = Base {
            factor: 5.0 / 9.0,
            offset: 459.67 * 5.0 / 9.0,
            ..kelvins
        };
        let celsius = unit_by_symbol("degC").unwrap().base;
        let [up, down] =
            [(fahrenheit, celsius), (celsius, fahrenheit)].map(|(from, to)| from.to(&to).unwrap());
        assert!((up.of(212.0) - 100.0).abs() < 1e-9);
        assert!((down.of(100.0) - 212.0).abs() < 1e-9);
    }
}
