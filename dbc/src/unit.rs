//! Units: words at the end of names, symbols, conversions within a quantity.

use std::fmt;

use canopen::object_dictionary::Preset;

/// Known unit: its word, its symbol, its quantity, and its size in the first unit of that.
type Known = (&'static str, &'static str, &'static str, f64);

/// Quantity of a number without a unit: 100 percent are 1.
pub(crate) const SHARE: &str = "share";

/// Degrees of a radian.
const RADIAN: f64 = 180.0 / std::f64::consts::PI;

/// Units in which names end.
const KNOWN: [Known; 31] = [
    ("metres", "m", "length", 1.0),
    ("millimetres", "mm", "length", 1e-3),
    ("micrometres", "um", "length", 1e-6),
    ("degrees", "deg", "angle", 1.0),
    ("revolutions", "rev", "angle", 360.0),
    ("radians", "rad", "angle", RADIAN),
    ("kilograms", "kg", "mass", 1.0),
    ("grams", "g", "mass", 1e-3),
    ("amperes", "A", "current", 1.0),
    ("milliamperes", "mA", "current", 1e-3),
    ("volts", "V", "voltage", 1.0),
    ("ohms", "Ohm", "resistance", 1.0),
    ("watts", "W", "power", 1.0),
    ("joules", "J", "energy", 1.0),
    ("newtons", "N", "force", 1.0),
    ("newton_metres", "Nm", "torque", 1.0),
    ("pascals", "Pa", "pressure", 1.0),
    ("bar", "bar", "pressure", 1e5),
    ("celsius", "degC", "temperature", 1.0),
    ("kelvins", "K", "temperature difference", 1.0),
    ("seconds", "s", "time", 1.0),
    ("hertz", "Hz", "frequency", 1.0),
    ("percent", "%", SHARE, 1e-2),
    ("litres", "l", "volume", 1.0),
    ("metres_per_second", "m/s", "speed", 1.0),
    ("millimetres_per_second", "mm/s", "speed", 1e-3),
    ("degrees_per_second", "deg/s", "turning speed", 1.0),
    ("revolutions_per_minute", "rpm", "turning speed", 6.0),
    ("revolutions_per_second", "rev/s", "turning speed", 360.0),
    ("radians_per_second", "rad/s", "turning speed", RADIAN),
    ("litres_per_minute", "l/min", "flow", 1.0),
];

/// Returns the words of all units in which names end.
pub fn known_units() -> impl Iterator<Item = &'static str> {
    KNOWN.iter().map(|(word, ..)| *word)
}

pub(crate) fn find(word: &str) -> Option<&'static Known> {
    KNOWN.iter().find(|(known, ..)| *known == word)
}

/// Returns the unit at the end of a name; empty if there is none.
pub fn unit_in(name: &str) -> &str {
    let is_end = |word: &&str| {
        let before = name.strip_suffix(word);
        before.is_some_and(|before| before.is_empty() || before.ends_with('_'))
    };
    let longest = known_units().filter(is_end).max_by_key(|word| word.len());
    longest.map_or("", |word| &name[name.len() - word.len()..])
}

/// Returns the singular of a unit, in words.
pub fn singular(word: &str) -> String {
    let (of, per) = word.split_at(word.find("_per_").unwrap_or(word.len()));
    let one = match of {
        "celsius" | "hertz" => of,
        _ => of.strip_suffix('s').unwrap_or(of),
    };
    format!("{one}{per}")
}

/// Returns a unit as the DBC writes it; the word itself if it has no other form.
pub fn symbol_of(word: &str) -> &str {
    find(word).map_or(word, |(_, symbol, ..)| symbol)
}

/// Returns the factor from the unit `from` to the unit `to`; `None` if they are of different quantities. A number without a unit
/// is a share, or has a unit that only its user knows.
pub fn conversion(from: &str, to: &str) -> Option<f64> {
    if from == to {
        return Some(1.0);
    }
    let kind = |word: &str| match word {
        "" => Some((SHARE, 1.0)),
        word => find(word).map(|(_, _, of, size)| (*of, *size)),
    };
    match (kind(from), kind(to)) {
        (Some((from, size)), Some((to, other))) => (from == to).then_some(size / other),
        _ => (from.is_empty() || to.is_empty()).then_some(1.0),
    }
}

/// Unit in which a loop counts its position: in its set-points, its limits, and its recorded signals.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub enum Unit {
    /// Millimetres.
    #[default]
    Millimetres,
    /// Degrees.
    Degrees,
    /// Revolutions.
    Revolutions,
    /// Any other unit, by its word.
    Other(String),
}

impl Unit {
    /// Units of lengths and angles, which a sensor can have whatever the unit of its port.
    pub const NAMED: [Self; 3] = [Self::Millimetres, Self::Degrees, Self::Revolutions];

    /// Returns the unit of a word.
    pub fn from_word(word: &str) -> Self {
        let named = Self::NAMED.into_iter().find(|unit| unit.word() == word);
        named.unwrap_or_else(|| Self::Other(word.to_owned()))
    }

    /// Returns the word of the unit.
    pub fn word(&self) -> &str {
        match self {
            Self::Millimetres => "millimetres",
            Self::Degrees => "degrees",
            Self::Revolutions => "revolutions",
            Self::Other(word) => word,
        }
    }

    /// Returns the word of the unit in which a law of one loop reads: metres in a loop in millimetres.
    pub fn law_word(&self) -> &str {
        match self {
            Self::Millimetres => "metres",
            unit => unit.word(),
        }
    }

    /// Returns the unit as plots and the DBC write it.
    pub fn symbol(&self) -> &str {
        symbol_of(self.word())
    }

    /// Returns the symbol as [`Unit::symbol`] if the unit is known, else an empty text.
    pub fn known_symbol(&self) -> &'static str {
        find(self.word()).map_or("", |(_, symbol, ..)| symbol)
    }

    /// Returns the units in which a port of this unit can be measured, the best known first.
    pub fn fitting_port(port_unit: &str) -> Vec<Self> {
        let fits = |unit: &Self| conversion(port_unit, unit.word()).is_some();
        let mut fitting = Vec::from_iter(Self::NAMED.into_iter().filter(fits));
        if fitting.is_empty() {
            let word = Some(port_unit).filter(|word| !word.is_empty());
            fitting.push(Self::Other(word.unwrap_or("percent").to_owned()));
        }
        fitting
    }

    /// Returns the counts of the drive's position object (0x6064) for one unit: micrometres, thousandths of a degree, millionths
    /// of a revolution.
    pub fn counts(&self) -> f64 {
        match self {
            Self::Revolutions => 1e6,
            _ => 1e3,
        }
    }

    /// Returns the SI unit of the drive's positions (0x60A8, CiA 303-2): prefix and unit; 0 for a unit without a code.
    pub fn si_position(&self) -> u32 {
        let (prefix, unit): (u32, u32) = match self {
            Self::Millimetres => (0xFA, 0x01),
            Self::Degrees => (0xFD, 0x41),
            Self::Revolutions => (0xFA, 0xB4),
            Self::Other(word) if word == "celsius" => (0xFD, 0x2D),
            Self::Other(_) => return 0,
        };
        prefix << 24 | unit << 16
    }

    /// Returns the same for the drive's data sheet, together with the unit of velocities (0x60A9).
    pub fn presets(&self) -> [Preset; 2] {
        let position = self.si_position();
        let velocity = match position {
            0 => 0,
            code => code | BY_SECOND,
        };
        [
            Preset::new(SI_UNIT_POSITION, 0, position.into()),
            Preset::new(SI_UNIT_VELOCITY, 0, velocity.into()),
        ]
    }
}

/// Objects of a drive (CiA 402-2).
const SI_UNIT_POSITION: u16 = 0x60A8;
const SI_UNIT_VELOCITY: u16 = 0x60A9;
/// "Per second" in the code of an SI unit (CiA 303-2).
const BY_SECOND: u32 = 0x0300;

impl fmt::Display for Unit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_the_end_of_a_name() {
        for (name, unit) in [
            ("current_amperes", "amperes"),
            (
                "motor_speed_revolutions_per_minute",
                "revolutions_per_minute",
            ),
            ("spindle_revolutions", "revolutions"),
            ("brake_newton_metres", "newton_metres"),
            ("martensite_fraction", ""),
            ("metres", "metres"),
            ("parametres", ""),
        ] {
            assert_eq!(unit_in(name), unit, "{name}");
        }
    }

    #[test]
    fn units_of_one_kind_are_converted_and_others_are_not() {
        assert_eq!(conversion("metres", "millimetres"), Some(1000.0));
        assert_eq!(conversion("degrees", "revolutions"), Some(1.0 / 360.0));
        assert_eq!(conversion("degrees", "millimetres"), None);
        assert_eq!(conversion("bogus", "bogus"), Some(1.0));
        assert_eq!(
            Unit::fitting_port("radians"),
            [Unit::Degrees, Unit::Revolutions]
        );
        let celsius = Unit::Other("celsius".to_owned());
        assert_eq!(Unit::fitting_port("celsius"), [celsius]);
        let percent = Unit::Other("percent".to_owned());
        assert_eq!(Unit::fitting_port(""), [percent]);
        assert_eq!(conversion("", "percent"), Some(100.0));
        assert_eq!(conversion("", "fraction"), Some(1.0));
        assert_eq!(conversion("", "celsius"), None);
        assert_eq!(conversion("celsius", "fraction"), None);
    }

    #[test]
    fn the_codes_are_those_of_cia_303_2() {
        assert_eq!(Unit::Millimetres.si_position(), 0xFA01_0000);
        assert_eq!(Unit::Degrees.si_position(), 0xFD41_0000);
        assert_eq!(Unit::Other("litres".to_owned()).si_position(), 0);
    }
}
