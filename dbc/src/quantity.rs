//! Physical quantities: what a sensor measures and an amplifier gives, and the names of keys and signals that follow from them.

use std::collections::BTreeSet;

use crate::port::{Port, local_name};
use crate::unit::{SHARE, Unit, find, known_units, singular, unit_in};

/// Name of what a sensor measures unless it says otherwise.
const POSITION: &str = "position";
/// A current is always in amperes, even at a port in milliamperes, because the rated current (0x6075), I²t and a real drive's
/// limits are in amperes.
const CURRENT: &str = "current";
const AMPERES: &str = "amperes";
/// Names of values that are computed for each loop.
const COMPUTED: [&str; 2] = ["set_point", "error"];
/// Names that a recording has for its cycles and times, and for the temperature of a plant.
const RECORDED: [&str; 3] = ["cycle", "time_seconds", "peak_temperature_celsius"];
/// Name of what an amplifier gives to a port that is called like its unit alone.
const SHARE_NAME: &str = "share";

/// Places in the names of keys, metrics and signals, which each loop fills with its quantities: see [`Quantities::name`].
pub const UNIT: &str = "{unit}";
const COMMAND_UNIT: &str = "{command_unit}";
const GAIN: &str = "{gain}";
const GAIN_SECONDS: &str = "{gain_seconds}";
/// Stands between the two units of a gain.
const PER: &str = "_per_";

/// Physical quantity in a unit: "position" in millimetres.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Quantity {
    /// Name of its signal, in words with underscores.
    pub name: String,
    /// Unit of the values; the word is empty for a plain number.
    pub unit: Unit,
}

impl Default for Quantity {
    fn default() -> Self {
        Self::position(Unit::default())
    }
}

impl Quantity {
    /// Makes a position in a unit.
    pub fn position(unit: Unit) -> Self {
        Self::new(POSITION, unit)
    }

    /// Makes a quantity.
    pub fn new(name: &str, unit: Unit) -> Self {
        let name = name.to_owned();
        Self { name, unit }
    }

    /// Returns the current that an amplifier gives unless its port says otherwise.
    pub fn current() -> Self {
        Self::new(CURRENT, Unit::Other(AMPERES.to_owned()))
    }

    /// Returns what an amplifier gives to a port of a plant. Its unit is the end of the port's name, and its name is the quantity
    /// of this unit: a mass, in kilograms, for `motor.added_load_kilograms`. A percentage or a number without a unit takes the
    /// port's name: `valve_percent` is `valve`, in percent.
    pub fn of_port(port: &str) -> Self {
        let port = local_name(port);
        let unit = unit_in(port);
        match find(unit) {
            Some((.., CURRENT, _)) => Self::current(),
            Some((.., quantity, _)) if *quantity != SHARE => {
                Self::new(&quantity.replace(' ', "_"), Unit::from_word(unit))
            }
            _ => {
                let name = port.strip_suffix(unit).unwrap_or(port);
                let name = match name.trim_end_matches('_') {
                    "" => SHARE_NAME,
                    name => name,
                };
                Self::new(name, Unit::from_word(unit))
            }
        }
    }

    /// Returns the quantities that amplifiers give to ports in the known units, without shares.
    pub fn known() -> impl Iterator<Item = Self> {
        let ports = known_units().filter(|unit| find(unit).is_some_and(|known| known.2 != SHARE));
        let quantities = ports.map(Self::of_port);
        quantities
            .filter(|one| one.name != CURRENT)
            .chain([Self::current()])
    }

    /// Returns its name and its unit, as keys and signals have them: `position_millimetres`.
    pub fn key(&self) -> String {
        with_unit(&self.name, self.unit.word())
    }

    /// Returns its name in words.
    pub fn words(&self) -> String {
        self.name.replace('_', " ")
    }

    /// Returns its name in words, as the title of a plot.
    pub fn title(&self) -> String {
        let words = self.words();
        let mut letters = words.chars();
        let first = letters.next().into_iter().flat_map(char::to_uppercase);
        first.chain(letters).collect()
    }

    /// Checks whether its name is also the name of a value that is computed, or of a column that each recording has.
    pub fn is_ambiguous(&self) -> bool {
        COMPUTED.contains(&&*self.name) || RECORDED.contains(&&*self.key())
    }
}

/// Joins a name and a unit; a number without a unit has only a name, and a gain of such a number only a unit.
fn with_unit(name: &str, unit: &str) -> String {
    let joint = if name.is_empty() || unit.is_empty() {
        ""
    } else {
        "_"
    };
    format!("{name}{joint}{unit}")
}

/// Quantities of a loop's feedback and command.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Quantities {
    /// Quantity of its feedback and its set-point.
    pub feedback: Quantity,
    /// Quantity of its command: the target of its drive.
    pub output: Quantity,
}

impl Default for Quantities {
    fn default() -> Self {
        Self::of_position(Unit::default())
    }
}

impl Quantities {
    /// Makes the quantities of a loop that measures a position in this unit and commands a current.
    pub fn of_position(unit: Unit) -> Self {
        Self {
            feedback: Quantity::position(unit),
            output: Quantity::current(),
        }
    }

    /// Fills the places of a pattern, or of a text with patterns: `{signal}_{unit}` becomes `speed_revolutions_per_minute`, and
    /// `{command}_{command_unit}` becomes `voltage_volts`. In gain names, `{gain}` is the command's unit per feedback unit as
    /// laws read it (`amperes_per_metre`); `{gain_seconds}` is that gain times seconds (`ampere_seconds_per_metre`).
    pub fn name(&self, pattern: &str) -> String {
        if !is_pattern(pattern) {
            return pattern.to_owned();
        }
        let Self { feedback, output } = self;
        let (command, by) = (output.unit.word(), singular(feedback.unit.law_word()));
        let seconds = with_unit(&singular(command), "seconds");
        let places = [
            ("{signal}", feedback.name.clone()),
            (UNIT, feedback.unit.word().to_owned()),
            ("{command}", output.name.clone()),
            (COMMAND_UNIT, command.to_owned()),
            (GAIN, with_unit(command, &format!("per_{by}"))),
            (GAIN_SECONDS, format!("{seconds}_per_{by}")),
        ];
        let mut name = pattern.to_owned();
        if command.is_empty() {
            name = name.replace(&format!("_{COMMAND_UNIT}"), "");
        }
        for (place, word) in &places {
            if name.contains(place) {
                name = name.replace(place, word);
            }
        }
        name
    }

    /// Returns name and symbol of a term of a law in this loop.
    pub fn term(&self, name: &str, port: &Port) -> (String, String) {
        let unit = &self.feedback.unit;
        let symbol = match name.split_once(UNIT) {
            Some((_, "_per_second")) => format!("{}/s", unit.symbol()),
            Some(_) => unit.symbol().to_owned(),
            None => port.symbol.clone(),
        };
        (self.name(name), symbol)
    }
}

/// Checks whether a name has places for the quantities of a loop.
pub fn is_pattern(name: &str) -> bool {
    name.contains('{')
}

/// Checks whether a name is a gain name, which may be per another unit of the loop's quantity.
pub fn is_gain(name: &str) -> bool {
    name.contains(GAIN) || name.contains(GAIN_SECONDS)
}

/// Checks whether two names mean the same gain per different units.
pub fn is_same_gain(one: &str, other: &str) -> bool {
    // Most names differ before the unit already.
    let [before, too] = [one, other].map(|name| name.split_once(PER).map(|(before, _)| before));
    before.is_some() && before == too && !gains_of(one).is_disjoint(&gains_of(other))
}

/// Returns the parts of a gain's name before and after the unit by which it is, once for each unit that it may be.
fn gains_of(name: &str) -> BTreeSet<(&str, &str)> {
    let gains = name.match_indices(PER).flat_map(|(place, _)| {
        let by = &name[place + PER.len()..];
        let after = known_units().filter_map(move |unit| by.strip_prefix(&*singular(unit)));
        after.map(move |after| (&name[..place], after))
    });
    gains.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_gain_has_a_name_by_each_unit() {
        for (other, is_same) in [
            ("integral_amperes_per_metre_second", true),
            ("integral_amperes_per_millimetre_second", true),
            ("integral_amperes_per_revolution_per_minute_second", true),
            ("integral_volts_per_degree_second", false),
            ("integral_amperes_per_degree", false),
            ("proportional_amperes_per_degree_second", false),
            ("integral_amperes", false),
        ] {
            assert_eq!(
                is_same_gain("integral_amperes_per_degree_second", other),
                is_same,
                "{other}"
            );
            assert_eq!(
                is_same_gain(other, "integral_amperes_per_degree_second"),
                is_same,
                "{other}"
            );
        }
        assert!(is_same_gain(
            "proportional_metres_per_second_per_metre",
            "proportional_metres_per_second_per_millimetre"
        ));
        assert!(is_same_gain(
            "proportional_per_metre",
            "proportional_per_degree"
        ));
        assert!(is_same_gain(
            "derivative_ampere_seconds_per_metre",
            "derivative_ampere_seconds_per_degree"
        ));
    }

    #[test]
    fn names_have_the_quantities_of_their_loop() {
        let quantities = |feedback: Quantity, port: &str| Quantities {
            feedback,
            output: Quantity::of_port(port),
        };
        let position = |unit: &str| Quantity::position(Unit::from_word(unit));
        let shipped = Quantities::default();
        let torque_of_a_joint = quantities(position("degrees"), "a.brake_newton_metres");
        let force_of_a_torque = quantities(position("newton_metres"), "a.push_newtons");
        let oven = quantities(
            Quantity::new("temperature", Unit::from_word("celsius")),
            "oven.heater_volts",
        );
        let hanger = quantities(position("millimetres"), "motor.added_load_kilograms");
        let cooled = quantities(position("millimetres"), "wire.convection_factor");
        for (pattern, names) in [
            (
                "{signal}_{unit}_max",
                [
                    "position_millimetres_max",
                    "position_degrees_max",
                    "position_newton_metres_max",
                    "temperature_celsius_max",
                    "position_millimetres_max",
                    "position_millimetres_max",
                ],
            ),
            (
                "{command}_ripple_{command_unit}_rms",
                [
                    "current_ripple_amperes_rms",
                    "torque_ripple_newton_metres_rms",
                    "force_ripple_newtons_rms",
                    "voltage_ripple_volts_rms",
                    "mass_ripple_kilograms_rms",
                    "convection_factor_ripple_rms",
                ],
            ),
            (
                "integral_{gain}_second",
                [
                    "integral_amperes_per_metre_second",
                    "integral_newton_metres_per_degree_second",
                    "integral_newtons_per_newton_metre_second",
                    "integral_volts_per_celsius_second",
                    "integral_kilograms_per_metre_second",
                    "integral_per_metre_second",
                ],
            ),
            (
                "`derivative_{gain_seconds}` is missing",
                [
                    "`derivative_ampere_seconds_per_metre` is missing",
                    "`derivative_newton_metre_seconds_per_degree` is missing",
                    "`derivative_newton_seconds_per_newton_metre` is missing",
                    "`derivative_volt_seconds_per_celsius` is missing",
                    "`derivative_kilogram_seconds_per_metre` is missing",
                    "`derivative_seconds_per_metre` is missing",
                ],
            ),
            ("overshoot_percent", ["overshoot_percent"; 6]),
        ] {
            let loops = [
                &shipped,
                &torque_of_a_joint,
                &force_of_a_torque,
                &oven,
                &hanger,
                &cooled,
            ];
            assert_eq!(loops.map(|one| one.name(pattern)), names);
        }
    }

    #[test]
    fn an_amplifier_gives_what_its_port_takes() {
        for (port, name, unit, key) in [
            (
                "joint.flexor_current_amperes",
                "current",
                "amperes",
                "current_amperes",
            ),
            (
                "motor.current_milliamperes",
                "current",
                "amperes",
                "current_amperes",
            ),
            ("oven.heater_volts", "voltage", "volts", "voltage_volts"),
            (
                "motor.added_load_kilograms",
                "mass",
                "kilograms",
                "mass_kilograms",
            ),
            (
                "spindle.speed_revolutions_per_minute",
                "turning_speed",
                "revolutions_per_minute",
                "turning_speed_revolutions_per_minute",
            ),
            ("tank.valve_percent", "valve", "percent", "valve_percent"),
            ("tank.percent", "share", "percent", "share_percent"),
            (
                "wire.convection_factor",
                "convection_factor",
                "",
                "convection_factor",
            ),
        ] {
            let quantity = Quantity::of_port(port);
            assert_eq!(
                (quantity.name.as_str(), quantity.unit.word()),
                (name, unit),
                "{port}"
            );
            assert_eq!(quantity.key(), key);
        }
        for (port, is_ambiguous) in [("a.dwell_seconds", true), ("a.cycle", true), ("a.b", false)] {
            assert_eq!(
                Quantity::of_port(port).is_ambiguous(),
                is_ambiguous,
                "{port}"
            );
        }
        let known = Vec::from_iter(Quantity::known().map(|quantity| quantity.key()));
        assert!(
            known.contains(&"mass_grams".to_owned())
                && !known.contains(&"share_percent".to_owned())
        );
        assert_eq!(
            known
                .iter()
                .filter(|key| key.starts_with("current_"))
                .count(),
            1
        );
    }

    #[test]
    fn a_term_that_is_a_position_has_the_unit_of_its_loop() {
        let term = |pattern: &str, unit: Unit| {
            Quantities::of_position(unit).term(pattern, &Port::position_term(pattern))
        };
        let named = |name: &str, symbol: &str| (name.to_owned(), symbol.to_owned());
        let velocity = "reference_velocity_{unit}_per_second";
        assert_eq!(
            term(velocity, Unit::Millimetres),
            named("reference_velocity_millimetres_per_second", "mm/s")
        );
        assert_eq!(
            term("reference_{signal}_{unit}", Unit::Degrees),
            named("reference_position_degrees", "deg")
        );
        let plain = Port::term("sum_amperes");
        assert_eq!(
            Quantities::default().term("sum_amperes", &plain),
            named("sum_amperes", "A")
        );
    }
}
