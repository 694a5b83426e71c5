//! The signals that a loop measures and commands, and the names that follow from them.

use crate::port::Port;
use crate::unit::{Unit, conversion, find, known_units, singular};

/// Name of the signal of a sensor without a name.
const POSITION: &str = "position";
/// Names of values that are computed for each loop.
const COMPUTED: [&str; 2] = ["set_point", "error"];

/// Places in the names of keys, metrics and signals, which each loop fills with its quantities: see [`Measurand::name`].
pub const UNIT: &str = "{unit}";
const COMMAND_UNIT: &str = "{command_unit}";
const GAIN: &str = "{gain}";
const GAIN_SECONDS: &str = "{gain_seconds}";

/// Output quantity of an amplifier: a signal in a unit.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub enum Command {
    /// A current, in amperes.
    #[default]
    Current,
    /// A voltage, in volts.
    Voltage,
    /// A force, in newtons.
    Force,
    /// A torque, in newton metres.
    Torque,
}

impl Command {
    /// All quantities.
    pub const ALL: [Self; 4] = [Self::Current, Self::Voltage, Self::Torque, Self::Force];

    /// Returns the name of the signal: the quantity of its unit.
    pub fn signal(self) -> &'static str {
        find(self.word()).map_or("", |(_, _, quantity, _)| quantity)
    }

    /// Returns the word of its unit.
    pub fn word(self) -> &'static str {
        match self {
            Self::Current => "amperes",
            Self::Voltage => "volts",
            Self::Force => "newtons",
            Self::Torque => "newton_metres",
        }
    }

    /// Returns its unit as the DBC writes it.
    pub fn symbol(self) -> &'static str {
        find(self.word()).map_or("", |(_, symbol, ..)| symbol)
    }

    /// Returns the signal as the title of a plot.
    pub fn title(self) -> String {
        title(self.signal())
    }

    /// Returns the output quantity of an amplifier that drives a port in this unit; `None` if no amplifier can.
    pub fn in_port_unit(unit: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter();
        all.find(|command| conversion(command.word(), unit).is_some())
    }
}

/// Signal that a loop measures and controls, with its unit, and the quantity that it commands.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Measurand {
    /// Name of the signal.
    pub signal: String,
    /// Unit of the signal.
    pub unit: Unit,
    /// Output quantity of the amplifier of the loop's drive.
    pub command: Command,
}

impl Default for Measurand {
    fn default() -> Self {
        Self::position(Unit::default())
    }
}

impl Measurand {
    /// Makes a position in a unit.
    pub fn position(unit: Unit) -> Self {
        Self {
            signal: POSITION.to_owned(),
            unit,
            command: Command::default(),
        }
    }

    /// Sets another command of the loop.
    #[must_use]
    pub fn commanding(self, command: Command) -> Self {
        Self { command, ..self }
    }

    /// Fills the places of a pattern, or of a text with patterns: `{signal}_{unit}` becomes `speed_revolutions_per_minute`, and
    /// `{command}_{command_unit}` becomes `voltage_volts`. In names of gains, `{gain}` is one unit of the command by one of the
    /// position as laws read it, as `amperes_per_metre`, and `{gain_seconds}` the same times a second.
    pub fn name(&self, pattern: &str) -> String {
        if !is_pattern(pattern) {
            return pattern.to_owned();
        }
        let (command, by) = (self.command.word(), singular(self.unit.law_word()));
        let places = [
            ("{signal}", self.signal.clone()),
            (UNIT, self.unit.word().to_owned()),
            ("{command}", self.command.signal().to_owned()),
            (COMMAND_UNIT, command.to_owned()),
            (GAIN, format!("{command}_per_{by}")),
            (
                GAIN_SECONDS,
                format!("{}_seconds_per_{by}", singular(command)),
            ),
        ];
        let mut name = pattern.to_owned();
        for (place, word) in &places {
            if name.contains(place) {
                name = name.replace(place, word);
            }
        }
        name
    }

    /// Checks whether its name is also that of a value that is computed.
    pub fn is_ambiguous(&self) -> bool {
        COMPUTED.contains(&&*self.signal)
    }

    /// Returns name and symbol of a term of a law in this loop.
    pub fn term(&self, name: &str, port: &Port) -> (String, String) {
        let symbol = match name.split_once(UNIT) {
            Some((_, "_per_second")) => format!("{}/s", self.unit.symbol()),
            Some(_) => self.unit.symbol().to_owned(),
            None => port.symbol.clone(),
        };
        (self.name(name), symbol)
    }

    /// Returns the signal in words, as the title of a plot.
    pub fn title(&self) -> String {
        title(&self.signal)
    }
}

/// Checks whether a name has places for the quantities of a loop.
pub fn is_pattern(name: &str) -> bool {
    name.contains('{')
}

/// Checks whether a name is that of a gain, which may be by another unit of the loop's quantity.
pub fn is_gain(name: &str) -> bool {
    name.contains(GAIN) || name.contains(GAIN_SECONDS)
}

/// Checks whether two names are those of one gain, by two units.
pub fn is_same_gain(one: &str, other: &str) -> bool {
    // Most names differ before the unit already.
    let [before, too] = [one, other].map(|name| name.split_once("_per_").map(|(before, _)| before));
    let is_by = |gain: &str, command| {
        let words = known_units().map(|unit| {
            let unit = Unit::Other(unit.to_owned());
            Measurand::position(unit).commanding(command).name(gain)
        });
        let words = Vec::from_iter(words);
        let mut parts = words
            .iter()
            .filter_map(|word| one.split_once(word.as_str()));
        parts.any(|(before, after)| {
            let mut names = words.iter().map(|word| format!("{before}{word}{after}"));
            names.any(|name| name == other)
        })
    };
    let mut gains = [GAIN, GAIN_SECONDS].into_iter();
    let mut is_gain = |gain| Command::ALL.into_iter().any(|command| is_by(gain, command));
    before.is_some() && before == too && gains.any(&mut is_gain)
}

/// Returns the name of a signal in words, as the title of a plot.
fn title(signal: &str) -> String {
    let words = signal.replace('_', " ");
    let mut letters = words.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).collect()
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
            "derivative_ampere_seconds_per_metre",
            "derivative_ampere_seconds_per_degree"
        ));
    }

    #[test]
    fn names_have_the_quantities_of_their_loop() {
        let shipped = Measurand::default();
        let torque_of_a_joint = Measurand::position(Unit::Degrees).commanding(Command::Torque);
        let force_of_a_torque =
            Measurand::position(Unit::Other("newton_metres".to_owned())).commanding(Command::Force);
        let oven = Measurand {
            signal: "temperature".to_owned(),
            unit: Unit::Other("celsius".to_owned()),
            command: Command::Voltage,
        };
        for (pattern, names) in [
            (
                "{signal}_{unit}_max",
                [
                    "position_millimetres_max",
                    "position_degrees_max",
                    "position_newton_metres_max",
                    "temperature_celsius_max",
                ],
            ),
            (
                "{command}_ripple_{command_unit}_rms",
                [
                    "current_ripple_amperes_rms",
                    "torque_ripple_newton_metres_rms",
                    "force_ripple_newtons_rms",
                    "voltage_ripple_volts_rms",
                ],
            ),
            (
                "integral_{gain}_second",
                [
                    "integral_amperes_per_metre_second",
                    "integral_newton_metres_per_degree_second",
                    "integral_newtons_per_newton_metre_second",
                    "integral_volts_per_celsius_second",
                ],
            ),
            (
                "`derivative_{gain_seconds}` is missing",
                [
                    "`derivative_ampere_seconds_per_metre` is missing",
                    "`derivative_newton_metre_seconds_per_degree` is missing",
                    "`derivative_newton_seconds_per_newton_metre` is missing",
                    "`derivative_volt_seconds_per_celsius` is missing",
                ],
            ),
            ("overshoot_percent", ["overshoot_percent"; 4]),
        ] {
            let loops = [&shipped, &torque_of_a_joint, &force_of_a_torque, &oven];
            assert_eq!(loops.map(|one| one.name(pattern)), names);
        }
        assert_eq!(
            Command::in_port_unit("milliamperes"),
            Some(Command::Current)
        );
        assert_eq!(
            Command::in_port_unit("newton_metres"),
            Some(Command::Torque)
        );
        assert_eq!(Command::in_port_unit("kilograms"), None);
    }

    #[test]
    fn a_term_that_is_a_position_has_the_unit_of_its_loop() {
        let term = |pattern: &str, unit: Unit| {
            Measurand::position(unit).term(pattern, &Port::position_term(pattern))
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
            Measurand::default().term("sum_amperes", &plain),
            named("sum_amperes", "A")
        );
    }
}
